"""Files that dancedata did not make: no command removes or changes them, under any name."""

import json
import math
import os
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from dancedata.building import build as build_module
from dancedata.cli.app import app
from dancedata.core.errors import StoreError
from dancedata.execution import cache_admin
from dancedata.execution.cache import Cache
from dancedata.execution.cache_admin import cache_json
from dancedata.files import cache_files
from dancedata.files.regular_file import sha256_file
from tests import warm
from tests.messages import raises_message

MINE = "somebody's"
HEX = "0123456789abcdef" * 4
#: Builds of these tests: motion only, which is quick.
QUICK = ["audio={}"]

#: In the cache: names that look like its own, and others.
IN_CACHE = [
    "notes.txt", ".hidden", "data.npy", f"{HEX}.npy", "dancedata-notes.txt", "project/tmp/a.tmp",
    "tmp/notes.txt", "tmp/a.tmp", "tmp/.dancedata-abcd1234.tmp", f"tmp/{HEX[:32]}.tmp", f"tmp/{HEX[:32]}.token",
    f"tmp/{HEX[:32]}-3.unit", f"tmp/dancedata-{HEX[:31]}.tmp", f"tmp/dancedata-{HEX[:32]}.npy",
    f"tmp/dancedata-{HEX[:32]}.tmp.bak", f"tmp/my-dancedata-{HEX[:32]}.tmp", "tmp/joblib_memmapping_folder_7/array",
    "locks/notes.txt", "locks/a.lock", "locks/features-old", "locks/build-notes", "locks/build-0",
    f"locks/features-{HEX[:63]}", f"locks/layers-{HEX}", f"locks/features-{HEX}.bak", f"locks/build-{HEX[:31]}",
    "features/mine.npy", f"features/{HEX}.npy", "features/01/mine.npy", f"features/01/{HEX}.txt",
    f"features/02/{HEX}.npy", f"features/01/{HEX.upper()}.npy", f"features/01/{HEX}.npy/inner", "motion/notes.txt",
    f"layers/01/{HEX}.npy", f"objects/01/{HEX}.json", f"clips/01/{HEX}.json.bak",
]  # fmt: skip
#: In OUT.
IN_OUT = [
    "thesis.tex", "README.md", "stats.json", "quality.jsonl", ".hidden", ".lock", ".stats.json.x1.tmp",
    "features-00000-of-00010.h5", "train-00000-of-00001.h5", ".dancedata-abcd1234.tmp", ".dancedata-out.lock",
    ".dancedata-dataset.json", ".dancedata-unfinished", ".dancedata-unfinished/notes.txt",
    ".dancedata-unfinished/train-00000-of-00001.h5", ".dancedata-unfinished/dataset.json", "models/weights.pt",
]  # fmt: skip
#: Those that a dataset has as well.
DATASET_FILES = ("README.md", "stats.json", "quality.jsonl", "train-00000-of-00001.h5")
#: Beside OUT, which is called "out".
BESIDE = [
    "notes.txt", "dataset.json", ".lock", "out.lock", ".out.lock", ".out.new/thesis.tex", ".out.old/thesis.tex",
    ".out.new/dataset.json", ".out.old/train-00000-of-00001.h5", "out.old/notes.txt", ".dancedata-out.lock",
    ".dancedata-out.new/thesis.tex", ".dancedata-out.new-0123abcd/thesis.tex",
    ".dancedata-out.old-0123abcd/thesis.tex", ".dancedata-out.old-0123abcd/dataset.json",
    ".dancedata-out.new-11111111/train-00000-of-00001.h5",
    ".dancedata-out.new-22222222", ".dancedata-out.new-notes", ".dancedata-abcd1234.tmp",
]  # fmt: skip


@pytest.fixture
def plant() -> Callable[..., Callable[[], None]]:
    """Return a function that plants files in a folder, and returns one that sees that they are as they were."""

    def identity(path: Path) -> tuple[Any, ...]:
        found = path.lstat()
        return found.st_ino, found.st_size, found.st_mtime_ns, path.read_text()

    def plant(folder: Path, names: list[str]) -> Callable[[], None]:
        for name in names:
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(f"{MINE} {name}")
        before = {name: identity(folder / name) for name in names}

        def check() -> None:
            for name, was in before.items():
                assert (folder / name).exists(), f"{name} was removed"
                assert identity(folder / name) == was, f"{name} was changed"

        return check

    return plant


def cli(*arguments: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == code, result.output
    return result.output


#: Builds, and dies at the n-th time that a file or folder is renamed, or before a file is unlinked.
DYING = """
import os, signal, sys
from pathlib import Path
left = int(sys.argv[4])
def dying(original):
    def call(*args, **options):
        global left
        left -= 1
        if left == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        return original(*args, **options)
    return call
for name in ("replace", "rename", "unlink", "rmdir"):
    setattr(os, name, dying(getattr(os, name)))
from dancedata.building.build import build
from dancedata.recipes.parse import load_recipe
recipe = load_recipe("aist++", ["audio={}", *sys.argv[5:]])
build(recipe, Path(sys.argv[1]), Path(sys.argv[2]), cache=Path(sys.argv[3]), overwrite=True)
"""


def killed(corpus: Path, out: Path, cache: Path, n: int, *overrides: str) -> bool:
    """Build and be killed; tells whether that came about before the end."""
    command = [sys.executable, "-c", DYING, str(corpus), str(out), str(cache), str(n), *overrides]
    code = warm.run(command).returncode
    assert code in (0, -signal.SIGKILL)
    return code != 0


@pytest.mark.parametrize("used", ["for the first time", "before"])
def test_no_command_touches_foreign_files_in_the_cache_or_next_to_out(
    run_build: Any, corpus: Path, out: Path, tmp_path: Path, plant: Any, built: Path, used: str
):
    cache = tmp_path / "scratch"
    if used != "for the first time":
        run_build(corpus, tmp_path / "before", set=QUICK, cache=cache)
    checks = [plant(cache, IN_CACHE), plant(out.parent, BESIDE)]

    def unharmed() -> None:
        for check in checks:
            check()

    assert run_build(corpus, out, set=QUICK, cache=cache).built
    unharmed()
    assert not run_build(corpus, out, set=QUICK, cache=cache).built
    assert run_build(corpus, out, set=[*QUICK, "windows.stride_s=1"], cache=cache, overwrite=True).built
    unharmed()
    for n in (3, 12, 21) if used == "before" else ():
        killed(corpus, out, cache, n)
        unharmed()
    run_build(corpus, out, set=QUICK, cache=cache, overwrite=True)
    unharmed()
    assert cache_json(cache)["entries"] > 0
    cli("cache", "verify", "--remove", "--cache", cache)
    cli("cache", "prune", "--max-size", "0B", "--cache", cache)
    unharmed()
    assert cache_json(cache)["entries"] == 0
    own = {*BESIDE, *(str(parent) for name in BESIDE for parent in Path(name).parents), "out"}
    assert {str(p.relative_to(out.parent)) for p in out.parent.rglob("*") if out not in p.parents} <= own
    left = [p for name in ("tmp", "locks") for p in (cache / name).iterdir()]
    assert {str(p.relative_to(cache)) for p in left if p.is_file()} <= set(IN_CACHE)


@pytest.mark.parametrize(("name", "overwrite"), [(name, k % 2 == 1) for k, name in enumerate(IN_OUT)])
def test_a_folder_with_foreign_files_is_refused(run_build, corpus, out, plant, name, overwrite):
    # A shard and a card are what a killed build of the first release left, and what others may have as well.
    names = [name, "README.md"] if name.endswith(".h5") else [name]
    check = plant(out, names)
    with raises_message(StoreError, "holds") as caught:
        run_build(corpus, out, set=QUICK, overwrite=overwrite)
    check()
    assert any(part in str(caught.value) for part in Path(name).parts)
    assert sorted(str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()) == sorted(names)
    assert [p.name for p in out.parent.iterdir()] == ["out"]


@pytest.mark.parametrize("name", [n for n in IN_OUT if n not in DATASET_FILES])
def test_a_dataset_with_foreign_files_is_not_replaced(run_build, corpus, built_copy, plant, name):
    check = plant(built_copy, [name])
    with raises_message(StoreError, "holds"):
        run_build(corpus, built_copy, set=["windows.stride_s=1", *QUICK], overwrite=True)
    check()


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("text", ["{}", '{"name": "mine", "format": 1}', "no JSON", "[]", '{"splits": {"train": 3}}'])
def test_a_dataset_json_of_another_program_is_refused(run_build, corpus, out, text, overwrite):
    out.mkdir(parents=True)
    (out / "dataset.json").write_text(text)
    (out / "train-00000-of-00001.h5").write_text(MINE)
    with pytest.raises(StoreError, match=r"a dataset\.json that dancedata cannot read as its own") as caught:
        run_build(corpus, out, set=QUICK, overwrite=overwrite)
    assert "Choose another --out" in str(caught.value)
    assert (out / "dataset.json").read_text() == text
    assert (out / "train-00000-of-00001.h5").read_text() == MINE


def test_a_card_that_somebody_wrote_into_is_not_removed(run_build: Any, corpus: Path, built_copy: Path):
    card = built_copy / "README.md"
    card.write_text(card.read_text() + MINE)
    with raises_message(StoreError, "since", where="outs/out"):
        run_build(corpus, built_copy, set=["windows.stride_s=1", *QUICK], overwrite=True)
    assert MINE in card.read_text()
    card.rename(card.with_name("aside").parent.parent / "card")
    assert run_build(corpus, built_copy, set=["windows.stride_s=1", *QUICK], overwrite=True).built


@pytest.mark.parametrize("name", ["notes.txt", "README.md"])
@pytest.mark.parametrize("overwrite", [False, True])
def test_files_that_come_into_out_during_a_build(run_build, corpus, out, built, monkeypatch, name, overwrite):
    write = build_module.write_store
    if overwrite:
        shutil.copytree(built, out)
        before = {p.name: sha256_file(p) for p in out.iterdir()}

    def meanwhile(folder: Path, *args: Any, **options: Any) -> None:
        write(folder, *args, **options)
        (out / name).write_text(MINE)

    monkeypatch.setattr(build_module, "write_store", meanwhile)
    if not overwrite and name == "notes.txt":  # does not conflict with any file
        assert run_build(corpus, out, set=QUICK).built
    else:
        with raises_message(StoreError, "move", where="outs/out"):
            run_build(corpus, out, set=[*QUICK, "windows.stride_s=1"], overwrite=overwrite)
        if overwrite:
            assert {p.name: sha256_file(p) for p in out.iterdir() if p.name != name}.items() <= before.items()
        else:
            assert [p.name for p in out.iterdir()] == [name]
    assert (out / name).read_text() == MINE
    assert [p.name for p in out.parent.iterdir()] == ["out"]


#: A build of these tests renames, or removes, a file or folder some 24 times.
MOMENTS = [pytest.param(n, marks=() if n in (9, 13, 20) else pytest.mark.nightly) for n in range(1, 26)]


@pytest.mark.parametrize("n", MOMENTS)
@pytest.mark.parametrize("overwrite", [False, True])
def test_killed_at_any_rename_or_removal(run_build, corpus, out, cache, hashes, n, overwrite):
    """OUT is whole, with nothing else in it, or has no dataset.json; and the next build makes it right."""
    run_build(corpus, out, set=QUICK)
    first = hashes(out)
    if overwrite:
        run_build(corpus, out, set=[*QUICK, "windows.stride_s=1"], overwrite=True)
        second = hashes(out)
    else:
        shutil.rmtree(out)
    assert killed(corpus, out, cache, n) or n > 20
    if overwrite and not out.exists():  # in the midst of the swap: the next build puts the dataset back
        assert not run_build(corpus, out, set=[*QUICK, "windows.stride_s=1"]).built
    if overwrite:
        assert hashes(out) in (first, second)
    else:
        assert not (out / "dataset.json").exists() or hashes(out) == first
    run_build(corpus, out, set=QUICK, overwrite=True)
    assert hashes(out) == first
    assert [p.name for p in out.parent.iterdir()] == ["out"]


def test_a_folder_that_is_not_a_cache_is_not_pruned_or_verified(tmp_path: Path, plant: Any):
    check = plant(tmp_path / "scratch", ["tmp/a.tmp", "notes.txt", f"objects/01/{HEX}.npy"])
    for arguments in (["prune", "--max-size", "0B"], ["verify", "--remove"], []):
        output = cli("cache", *arguments, "--cache", tmp_path / "scratch", code=2)
        assert "not a cache of dancedata" in output
        assert "notes.txt" in output
    check()


def test_a_cache_is_marked_when_it_is_first_used(tmp_path: Path):
    cache = Cache(tmp_path / "cache")
    assert cache.json("files", HEX) is None
    assert not cache.root.exists()
    cache.put_json("files", HEX, 1)
    assert cache_files.is_cache(cache.root)
    assert "may be deleted" in (cache.root / cache_files.MARKER).read_text()


@pytest.mark.parametrize("there", [MINE, "directory", "link"])
def test_a_file_with_the_markers_name_is_left_as_it_is(tmp_path: Path, there: str):
    root = tmp_path / "cache"
    root.mkdir()
    marker = root / cache_files.MARKER
    if there == "directory":
        marker.mkdir()
    elif there == "link":
        marker.symlink_to(tmp_path / "elsewhere")
    else:
        marker.write_text(there)
    Cache(root).put_json("files", HEX, 1)
    assert cache_files.sweep(root) == 0
    assert not cache_files.is_cache(root)
    assert not (tmp_path / "elsewhere").exists()
    assert marker.is_symlink() or marker.is_dir() or marker.read_text() == there


def test_links_in_the_cache_are_not_followed(tmp_path: Path):
    cache = Cache(tmp_path / "cache")
    cache.put_json("files", HEX, 1)
    target = tmp_path / "target"
    target.write_text(MINE)
    link = cache.root / "tmp" / f"dancedata-{HEX[:32]}.tmp"
    link.symlink_to(target)
    os.mkfifo(cache.root / "tmp" / f"dancedata-{HEX[32:]}.token")
    (cache.root / "locks").mkdir(exist_ok=True)
    (cache.root / "locks" / f"build-{HEX[:32]}").mkdir()
    assert cache_files.sweep(cache.root) == 0
    assert cache_admin.oldest_running(cache.root) == math.inf or link.is_symlink()
    assert target.read_text() == MINE


def test_a_folder_of_a_swap_that_is_a_link_is_not_followed(run_build, corpus, built_copy, built, tmp_path, hashes):
    precious = shutil.copytree(built, tmp_path / "precious")
    for which in ("new", "old"):
        (built_copy.parent / f".dancedata-out.{which}-0123abcd").symlink_to(precious)
    assert run_build(corpus, built_copy, set=[*QUICK, "windows.stride_s=1"], overwrite=True).built
    assert hashes(precious) == hashes(built)


def test_dataset_json_names_no_file_elsewhere(run_build: Any, corpus: Path, built_copy: Path, tmp_path: Path):
    """Side files that dataset.json lists are removed with a dataset, if their names are those that builds give."""
    document = json.loads((built_copy / "dataset.json").read_text())
    document["files"]["../notes.txt"] = {"size": 1, "sha256": ""}
    (built_copy / "dataset.json").write_text(json.dumps(document))
    (built_copy.parent / "notes.txt").write_text(MINE)
    assert run_build(corpus, built_copy, set=[*QUICK, "windows.stride_s=1"], overwrite=True).built
    assert (built_copy.parent / "notes.txt").read_text() == MINE
