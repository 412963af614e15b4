"""The dataset reader folder from end to end: real BVH files, an AMASS file and words down to a sound store."""

import shutil
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.building.build import build
from dancedata.building.describe import describe_store
from dancedata.building.plan import make_plan
from dancedata.core.errors import SourceError, StoreError
from dancedata.datasets.folder import Folder
from dancedata.recipes.parse import parse_recipe
from dancedata.store import open_store, verify_store
from tests.messages import raises_message

READER = Folder


def document(dataset: dict[str, Any] | None = None, **keys: Any) -> dict[str, Any]:
    return {
        "recipe": 1, "name": "own", "dataset": {"folder": dataset or {}}, "fps": 30,
        "windows": {"length_s": 2, "stride_s": 1}, "motion": {"joints": {}}, **keys,
    }  # fmt: skip


@pytest.mark.parametrize("transforms", [[], [{"slices": {"length_s": 2, "stride_s": 1}}]])
def test_real_and_made_files_build(
    shared: Path, source: Path, tmp_path: Path, cache: Path, transforms: list[Any]
) -> None:
    """The three real BVH files and an AMASS file, two seconds windows, down to a sound store."""
    rows = ["motion,audio,split,up,unit", "motions/amass_poses.npz,music/fast.wav,test,,"]
    for name, up, unit in (("rokoko_jesse_dance", "", "cm"), ("cmu_01_01", "", "cmu"), ("fair1_dab", "z", "guess")):
        shutil.copy(shared / "realdata" / "bvh" / f"{name}.bvh", source / "motions")
        rows.append(f"motions/{name}.bvh,music/slow.wav,train,{up},{unit}")
    (source / "manifest.csv").write_text("\n".join(rows))
    recipe = parse_recipe(document(motion={"edge151": {}}, transforms=transforms))
    result = build(recipe, source, tmp_path / "out", cache=cache)
    notes = "\n".join(result.notes)
    for words in ("120 FPS (Frame Time: .0083333)", "100 FPS", "+Z up (declared in the manifest)", "GUESSED"):
        assert words in notes
    assert not [str(p) for p in verify_store(tmp_path / "out") if p.severity == "error"]
    with open_store(tmp_path / "out") as store:
        assert {clip.original for clip in store} == {"amass_poses", "rokoko_jesse_dance", "cmu_01_01", "fair1_dab"}
        assert np.isfinite(store.read(store.windows("train")[0], "edge151")).all()
        assert all(c.height_m is not None and 1.2 < c.height_m < 2.2 for c in store)
    # Output for people: rates, axes, unit and height.
    about = describe_store(tmp_path / "out")
    stated = "+Z up (declared in the manifest)"
    for words in ("100 per second: ", "120 per second: ", stated, "GUESSED", "+Z up, metres"):
        assert words in about, about


def _height(source: Path, out: Path, **dataset: object) -> float:
    """Build without music, every time into another folder by one cache, and return the only clip's height, metres."""
    recipe = parse_recipe(document({"music": "optional", **dataset}))
    build(recipe, source, out, cache=source.parent / "cache")
    with open_store(out) as store:
        (clip,) = store.clips()
        height = np.median(np.ptp(clip.read("joints").reshape(-1, 24, 3)[..., 1], axis=1))
        assert height == pytest.approx(clip.height_m, abs=1e-3)
        return float(height)


def test_declarations_are_part_of_the_key(example: Any, tmp_path: Path) -> None:
    """One file, one cache: another unit in the manifest, or in the recipe, is another motion."""
    source = tmp_path / "source"
    source.mkdir()
    (bvh,) = example("folder").rglob("*.bvh")
    shutil.copy(bvh, source / "one.bvh")
    heights = []
    for k, (declared, recipe) in enumerate((("cm", {}), ("inch", {}), ("", {"unit": "cm"}), ("", {"unit": "inch"}))):
        (source / "manifest.csv").write_text(f"motion,unit\none.bvh,{declared}\n")
        heights.append(_height(source, tmp_path / f"out{k}", **recipe))
    np.testing.assert_allclose(heights, np.array([1, 2.54, 1, 2.54]) * heights[0], atol=1e-3)


def test_audio_features_of_clips_that_are_kept_without_music(source: Path, tmp_path: Path, cache: Path) -> None:
    """`music: optional` and audio features contradict each other where a clip has no music."""
    lines = (source / "manifest.csv").read_text().splitlines()
    place = lines[0].split(",").index("audio")
    cells = lines[1].split(",")
    cells[place] = ""
    (source / "manifest.csv").write_text("\n".join([lines[0], ",".join(cells), *lines[2:]]))
    contradictory = document({"music": "optional"}, audio={"librosa35": {}})
    words = (
        r"audio features need the music of every clip; found 1 of 3 clips without music: .*librosa35.*--set 'audio"
    )
    for run in (
        lambda: make_plan(parse_recipe(contradictory), source, cache=cache),
        lambda: build(parse_recipe(contradictory), source, tmp_path / "out", cache=cache),
    ):
        with pytest.raises(SourceError, match=words):
            run()
    kept = make_plan(parse_recipe({**contradictory, "audio": {}}), source, cache=cache).to_json()
    left = make_plan(parse_recipe(document(audio={"librosa35": {}})), source, cache=cache).to_json()
    assert [plan["splits"]["train"]["clips"] for plan in (kept, left)] == [2, 1]
    assert left["left_out"]["missing_music"] == 1


RECIPE = document({"fps": 30, "unit": "m", "up": "y", "language": "en"}, audio={}, augment={"mirror": True})


def ids(source: Path) -> list[str]:
    return [clip.id for clip in Folder().scan(source).clips]


def test_words_go_from_the_source_into_the_dataset(source: Path, tmp_path: Path, cache: Path) -> None:
    first, second, *_ = ids(source)
    before = {r.file for r in Folder().scan(source).rejects}
    (source / "texts").mkdir()
    (source / "texts" / f"{first}.txt").write_text("turns left#turn/VERB left/ADJ#0.0#0.0\n")
    (source / "texts" / "nobody.txt").write_text("x#x/X#0.0#0.0\n")
    (source / "texts" / f"{second}.txt").write_text("broken\n")
    rows = f"{first},0.5,1.5,moves,left spin\nnobody,0,1,moves,\n{second},9999,10000,moves,x\n"
    (source / "segments.csv").write_text(f"clip,start,end,layer,label\n{rows}")
    scan = Folder(language="en").scan(source)
    left_out = {(r.reason, r.clip or r.file) for r in scan.rejects if r.file not in before}
    assert left_out == {
        ("unused_segments", "segments.csv"), ("unused_segments", "texts/nobody.txt"), ("bad_segment", second),
    }  # fmt: skip
    assert any("Captions: texts/" in note for note in scan.notes)
    store = dancedata.build(RECIPE, source, tmp_path / "out", jobs=1, cache=cache, progress=False).open()
    words, move = store.segments(first)
    length = store.grid.seconds(store[first].n_frames)
    assert (words.texts, words.texts_mirrored, words.end) == (("turns left",), ("turns right",), length)
    assert (move.label, move.start, move.layer.sided) == ("left spin", Fraction(1, 2), "mirrored")
    assert sum(layer["empty"] for layer in store.info["layers"]) >= 1
    words, move = store.segments(f"{first}__mirror")
    assert (words.texts, words.tokens, move.label) == (("turns right",), ("turn/VERB right/ADJ",), "right spin")


def test_changed_words_are_another_source(source: Path, tmp_path: Path, cache: Path) -> None:
    first = ids(source)[0]
    (source / "segments.jsonl").write_text(f'{{"clip": "{first}", "start": 0, "end": "end", "layer": "w"}}\n')
    build = {"jobs": 1, "cache": cache, "progress": False}
    assert dancedata.build(RECIPE, source, tmp_path / "out", **build).built
    assert not dancedata.build(RECIPE, source, tmp_path / "out", **build).built
    (source / "segments.jsonl").write_text(f'{{"clip": "{first}", "start": 0, "end": 1, "layer": "w"}}\n')
    with pytest.raises(StoreError, match="another source"):
        dancedata.build(RECIPE, source, tmp_path / "out", **build)


def test_two_files_and_partners_that_are_not_there(source: Path) -> None:
    first = ids(source)[0]
    (source / "segments.csv").write_text(f"clip,start,end,layer,other\n{first},0,1,contacts,{first}x\n")
    with raises_message(SourceError, "amass_poses", where="мой dänce/segments.csv, line 2"):
        Folder().scan(source)
    (source / "segments.jsonl").write_text("")
    with raises_message(SourceError, "segments", where="мой dänce"):
        Folder().scan(source)
