"""check with a recipe finds what a build leaves out: the same clips, for the same reasons."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from scipy.spatial.transform import Rotation

import dancedata
from dancedata.alignment.align import align
from dancedata.core.skeleton import SMPL24
from dancedata.curation.quality import quality
from dancedata.synthetic import synthesise_motion
from tests.commands import run
from tests.formats.test_bvh_retarget import MIXAMO, write_as

RECIPE: dict[str, Any] = {
    "recipe": 1, "name": "mixed", "dataset": {"folder": {"unit": "cm"}}, "windows": {"length_s": 2, "stride_s": 1},
    "motion": {"joints": {}}, "audio": {"librosa35": {}},
}  # fmt: skip


@pytest.fixture(scope="module")
def mixed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Captures of several producers, and what may be wrong with them."""
    folder = tmp_path_factory.mktemp("mixed")
    motion = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=240)[0]
    smpl = " ".join(SMPL24.joints)
    bones = {"mixamo": MIXAMO, "smpl": smpl, "short": MIXAMO, "silent": smpl, "brief_song": smpl, "no_song": smpl}
    for name, names in bones.items():
        part = motion.part(0, 60) if name == "short" else motion
        write_as(folder / f"{name}.bvh", part, SMPL24, Rotation.identity(24), names=names.split())
    swapped = MIXAMO.replace("Left", "?").replace("Right", "Left").replace("?", "Right")
    write_as(folder / "swapped.bvh", motion, SMPL24, Rotation.identity(24), names=swapped.split())
    bones_only = [f"Bone{k}" for k in range(24)]
    write_as(folder / "unknown.bvh", motion, SMPL24, Rotation.identity(24), names=bones_only)
    (folder / "broken.bvh").write_text("HIERARCHY\n")
    part = motion.part(0, 120)
    np.savez(folder / "no_rate.npz", poses=part.rotations.reshape(120, 72), trans=part.translation)
    for path in sorted(folder.iterdir()):
        seconds = 1 if path.stem == "brief_song" else 4
        if path.stem != "no_song":
            noise = np.random.default_rng(0).normal(0, 0.1, seconds * 16000)
            soundfile.write(folder / f"{path.stem}.wav", noise, 16000)
    (folder / "silent.wav").write_bytes(b"RIFF")
    (folder / "notes.txt").write_text("")
    return folder


def test_check_finds_what_a_build_leaves_out(mixed: Path, tmp_path: Path) -> None:
    result = dancedata.build(RECIPE, mixed, tmp_path / "out", cache=tmp_path / "cache", progress=False, jobs=1)
    with result.open() as store:
        built = {(row.get("clip") or row["file"], row["reason"]) for row in store.rejects}
        assert {clip.id for clip in store} == {"mixamo", "smpl"}
    problems = dancedata.check(mixed, recipe=RECIPE, progress=False)
    found = {(p.where, p.message.partition(":")[0]) for p in problems if p.where != str(mixed)}
    assert found == built
    reasons = {"too_short", "short_audio", "missing_music", "swapped_sides", "unknown_joints", "undeclared"}
    assert reasons <= {reason for _, reason in built}
    assert {p.where for p in problems if p.severity == "error"} == {
        "short", "silent", "brief_song", "no_song", "swapped", "unknown", "broken", "no_rate",
    }  # fmt: skip


def test_the_recipe_of_a_prepared_folder_is_the_default(mixed: Path, tmp_path: Path) -> None:
    shutil.copy(mixed / "mixamo.bvh", tmp_path)
    (tmp_path / "manifest.csv").write_text("id,motion\na,mixamo.bvh\n")  # its unit stands in the recipe alone
    recipe = {**RECIPE, "dataset": {"folder": {"unit": "cm", "music": "optional"}}, "audio": {}}
    (tmp_path / "recipe.yaml").write_text(json.dumps(recipe))

    def errors(**how: Any) -> list[str]:
        problems = dancedata.check(tmp_path, progress=False, **how)
        return [p.message.partition(":")[0] for p in problems if p.severity == "error" and p.where == "a"]

    assert not errors()
    assert errors(overrides={"dataset.folder.music": "required"}) == ["missing_music"]
    assert errors(dataset="folder")
    how: dict[str, Any] = {"cache": tmp_path / "cache", "progress": False}
    assert [row.clip for row in quality(tmp_path, **how).clips] == ["a"]
    assert [reject.reason for reject in quality(tmp_path, dataset="folder", **how).rejects] == ["undeclared"]
    assert [reject.reason for reject in align(tmp_path, **how).rejects] == ["missing_music"]
    run("check", tmp_path, "--faults", "--cache", tmp_path / "cache")
    run("check", tmp_path, "--offsets", "--cache", tmp_path / "cache", code=1)  # there is nothing to compare


@pytest.mark.parametrize("recipe", [None, RECIPE])
def test_lengths_of_motion_and_music_stand_side_by_side(mixed, tmp_path, recipe):
    for name in ("mixamo.bvh", "mixamo.wav", "brief_song.wav"):
        shutil.copy(mixed / name, tmp_path)
    rows = "id,motion,audio,unit\na,mixamo.bvh,mixamo.wav,cm\nb,mixamo.bvh,brief_song.wav,cm\n"
    (tmp_path / "manifest.csv").write_text(rows)
    dataset = None if recipe else "folder"
    problems = dancedata.check(tmp_path, dataset=dataset, recipe=recipe, progress=False)
    notes = [p.message for p in problems if p.message.startswith("Seconds of motion and music")]
    # A build leaves b out, which has a reject with its lengths.
    of_b = "" if recipe else "b 4.00 and 1.00, "
    assert notes == [f"Seconds of motion and music, the largest differences first: {of_b}a 4.00 and 4.00."]


@pytest.mark.parametrize(
    "break_it",
    [
        lambda source: (source / "manifest.csv").write_text("motion\nother.npz\n"),  # none is there
        lambda source: (source / "manifest.csv").write_text("motion,fps,audio\na.npz,30,a.wav\n"),  # no unit
        lambda source: (source / "a.wav").unlink(),
        lambda source: (source / "a.npz").write_bytes(b"no motion"),
    ],
)
def test_a_source_without_a_usable_clip_is_an_error(tmp_path: Path, break_it: Callable[[Path], object]) -> None:
    np.savez(tmp_path / "a.npz", poses=np.zeros((90, 72)), trans=np.zeros((90, 3)))
    soundfile.write(tmp_path / "a.wav", np.random.default_rng(0).normal(0, 0.1, 24_000), 8000)
    break_it(tmp_path)
    recipe = {
        "recipe": 1, "name": "t", "fps": 30, "dataset": {"folder": {"up": "y"}}, "motion": {"joints": {}},
        "windows": {"length_s": 1, "stride_s": 1}, "audio": {},
    }  # fmt: skip
    (tmp_path / "recipe.yaml").write_text(json.dumps(recipe))
    for options in ({"dataset": "folder"}, {"recipe": str(tmp_path / "recipe.yaml")}):
        problems = dancedata.check(tmp_path, **options)
        assert "no clip is left" in [p for p in problems if p.severity == "error"][-1].message
