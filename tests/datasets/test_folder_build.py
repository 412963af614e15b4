"""The dataset reader folder from end to end: its example, real BVH files and an AMASS file down to a sound store."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from dancedata.datasets.folder import Folder


def test_the_example_says_what_it_is(tmp_path: Path) -> None:
    Folder().make_example(tmp_path / "x")
    scan = Folder().scan(tmp_path / "x")
    assert scan.layout == "manifest (csv)"
    notes = "\n".join(scan.notes)
    for words in (
        "layout amass on smplh's 52 joints: 60 FPS (mocap_framerate); +Z up (AMASS's definition), turned to +Y; m",
        "BVH: 60 FPS (Frame Time: 0.016667); +Y up (BVH's convention, nothing was declared); cm (declared",
        "pelvis = Hips, left_hip = LeftUpLeg",
        "layout smpl: 60 FPS (declared in the manifest)",
    ):
        assert words in notes
    heights = {}
    for clip in scan.clips:
        assert any(note in f"{text}." or text in note for text in clip.notes for note in scan.notes)
        joints = Folder().load(clip).joints()
        heights[clip.id] = np.median(np.ptp(joints[..., 1], axis=1))
    assert all(1.2 < height < 2.2 for height in heights.values())


@pytest.mark.parametrize("scope", ["track", "window"])
def test_real_and_made_files_build(shared: Path, tmp_path: Path, scope: str) -> None:
    """The three real BVH files and an AMASS file, two seconds windows, down to a sound store."""
    from dancedata.pipeline.build import build
    from dancedata.pipeline.recipe import parse_recipe
    from dancedata.store import open_store, verify_store

    source = tmp_path / "source"
    Folder().make_example(source)
    rows = ["motion,audio,split,up,unit", "motions/amass_poses.npz,music/fast.wav,test,,"]
    for name, up, unit in (("rokoko_jesse_dance", "", "cm"), ("cmu_01_01", "", "cmu"), ("fair1_dab", "z", "guess")):
        shutil.copy(shared / "realdata" / "bvh" / f"{name}.bvh", source / "motions")
        rows.append(f"motions/{name}.bvh,music/slow.wav,train,{up},{unit}")
    (source / "manifest.csv").write_text("\n".join(rows))
    document = {
        "recipe": 1,
        "name": "own",
        "dataset": {"folder": {}},
        "scope": scope,
        "fps": 30,
        "windows": {"length_s": 2, "stride_s": 1},
        "motion": {"edge151": {}},
    }
    result = build(parse_recipe(document), source, tmp_path / "out", cache=tmp_path / "cache")
    notes = "\n".join(result.scan_notes)
    for words in ("120 FPS (Frame Time: .0083333)", "100 FPS", "+Z up (declared in the manifest)", "GUESSED"):
        assert words in notes
    assert not [str(p) for p in verify_store(tmp_path / "out") if p.severity == "error"]
    with open_store(tmp_path / "out") as store:
        assert {clip.id for clip in store.clips} == {"amass_poses", "rokoko_jesse_dance", "cmu_01_01", "fair1_dab"}
        assert np.isfinite(store.read(store.windows("train")[0], "edge151")).all()
