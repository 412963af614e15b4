"""Files made to do harm: each is refused by name within a second and 200 MB, and a build with all of them runs."""

import json
import os
import resource
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

RECIPE = """recipe: 1
name: hostile
dataset: {folder: {unit: m, up: y, fps: 30}}
windows: {length_s: 2, stride_s: 1}
motion: {edge151: {}}
audio: {librosa35: {}}
"""
#: Far above what a build of one clip takes, far below unrestricted reading. Processor time.
CPU_S, ADDRESS_SPACE = 120, 6 << 30


@pytest.mark.parametrize(("target", "kind"), [("pickle", "PICKLES"), ("torch_zip", "TORCH"), ("wav", "SOUNDS")])
def test_each_is_refused_by_name(hunt, hostile, tmp_path, target, kind):
    made = getattr(hostile, kind)
    files = [tmp_path / name for name in made]
    for path, make in zip(files, made.values(), strict=True):
        path.write_bytes(make())
    report = hunt.run_batch(target, seed=0, first=0, count=0, files=files)
    assert [f"{f['what']} {f['where']} {f['error']}" for f in report["findings"]] == []
    assert report["cases"] == len(files)
    assert "valid" not in report["outcomes"], report["outcomes"]


def limited() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S))
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))


def test_a_build_stores_the_good_clip_among_all_of_them(hostile: ModuleType, tmp_path: Path) -> None:
    from dancedata.datasets.folder import Folder

    source, out = tmp_path / "source", tmp_path / "out"
    Folder().make_example(source)
    (source / "manifest.csv").unlink()
    motions, music = source / "motions", source / "music"
    for path in motions.iterdir():
        if path.name != "smpl.npz":
            path.unlink()
    song = (music / "fast.wav").read_bytes()
    (music / "smpl.wav").write_bytes(song)
    for name, make in hostile.PICKLES.items():
        (motions / f"{name}.pkl").write_bytes(make())
        (music / f"{name}.wav").hardlink_to(music / "smpl.wav")
    for name, make in hostile.SOUNDS.items():
        (motions / f"{name}.npz").write_bytes((motions / "smpl.npz").read_bytes())
        (music / f"{name}.wav").write_bytes(make())
    (tmp_path / "recipe.yaml").write_text(RECIPE)
    build = [sys.executable, "-m", "dancedata", "build", str(tmp_path / "recipe.yaml"), "--jobs", "1", "-q"]
    ended = subprocess.run(
        [*build, str(source), "--out", str(out)],
        capture_output=True,
        preexec_fn=limited,
        env={**os.environ, "DANCEDATA_CACHE": str(tmp_path / "cache"), "OPENBLAS_NUM_THREADS": "1"},
    )
    assert ended.returncode == 0, ended.stderr.decode(errors="replace")[-3000:]
    text = ended.stdout.decode()
    assert all(c.isprintable() or c == "\n" for c in text)
    rejects: list[dict[str, Any]] = [json.loads(line) for line in (out / "rejects.jsonl").read_bytes().splitlines()]
    left_out = {r["clip"]: r for r in rejects if r["reason"] not in ("no_audio", "unused_music")}
    assert set(left_out) == {*hostile.PICKLES, *hostile.SOUNDS}
    for name, reject in left_out.items():
        assert name in reject["detail"]
        assert len(reject["detail"]) < 1000
    import dancedata

    with dancedata.open(out) as ds:
        assert [c.id for c in ds] == ["smpl"]
        assert len(ds.windows("train")) > 1
