"""dancedata build --part K/N: the same keys as the build that collects, for any feature. Bytes: tests/fault."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from dancedata.audio.librosa35.feature import Librosa35
from dancedata.building.part import Part, build_part
from dancedata.core.errors import DataError, UsageError
from dancedata.datasets.aistpp import AistPP
from dancedata.recipes.parse import load_recipe
from tests.messages import raises_message


def entries(cache: Path) -> set[str]:
    return {str(path.relative_to(cache)) for stage in ("features", "motion") for path in (cache / stage).rglob("*.*")}


def refuse(*args: Any, **options: Any) -> Any:
    raise AssertionError("a unit was computed")


def test_texts_of_parts():
    assert str(Part.parse(" 3/16 ")) == "3/16"
    for text in ("0/4", "5/4", "1", "1/0", "a/b", "-1/4", "1/4/2", "1 /4", ""):
        with raises_message(UsageError, "such as 1/16"):
            Part.parse(text)


@pytest.mark.parametrize("name", ["aist++", "aist++-edge-exact"])
def test_parts_leave_all_that_a_build_computes_in_the_cache(run_build, corpus, out, tmp_path, monkeypatch, name):
    recipe, cache = load_recipe(name), tmp_path / "cache"
    results = [build_part(recipe, corpus, Part(k, 3), cache=cache) for k in (1, 2, 3)]
    # Two songs: one part has nothing to do, which is not an error.
    assert [r.clips for r in results] == [2, 2, 0]
    assert "part 3/3: 0 of 4 clips, 0 songs" in str(results[2])
    assert not out.exists()
    whole = tmp_path / "cache of a build"
    run_build(corpus, out.parent / "other", name, cache=whole)
    assert entries(cache) == entries(whole)
    for target, what in ((AistPP, "load"), (Librosa35, "extract"), (Librosa35, "extract_windows")):
        monkeypatch.setattr(target, what, refuse)
    assert run_build(corpus, out, name, cache=cache).built


def test_a_part_repairs_the_same_entries_as_a_build(corpus, out, tmp_path, run_build, monkeypatch):
    """As jukebox fixes its precision and the hash of its weights."""
    monkeypatch.setattr(Librosa35, "resolved", lambda self, hash_file: replace(self, tightness=7.0), raising=False)
    build_part(load_recipe("aist++"), corpus, Part(1, 1), cache=tmp_path)
    before = entries(tmp_path)
    run_build(corpus, out, cache=tmp_path)
    assert entries(tmp_path) == before
    monkeypatch.delattr(Librosa35, "resolved")
    run_build(corpus, out.parent / "other", set=["audio.librosa35.tightness=7"], cache=tmp_path)
    assert entries(tmp_path) == before


def test_broken_clips_are_counted_and_stop_a_strict_part(source: Path, tmp_path: Path):
    (broken, *_) = sorted((source / "motions").glob("*.pkl"))
    broken.write_bytes(b"")
    recipe = load_recipe("aist++")
    parts = [build_part(recipe, source, Part(k, 2), cache=tmp_path) for k in (1, 2)]
    assert sorted(tuple(part.left_out.items()) for part in parts) == [(), (("broken_file", 1),)]
    stopped = 0
    for k in (1, 2):
        try:
            build_part(recipe, source, Part(k, 2), strict=True, cache=tmp_path)
        except DataError as error:
            stopped += error.reason == "broken_file"
    assert stopped == 1
