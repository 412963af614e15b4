"""A proposed manifest: pairs and facts with their evidence; unconfirmed guesses are named when it is read."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import soundfile
from scipy.spatial.transform import Rotation

from dancedata.core.errors import SourceError
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.folder import Folder
from dancedata.datasets.folder.propose import Proposal, ProposedRow, propose
from dancedata.synthetic import synthesise_motion
from tests.commands import as_json, run
from tests.formats.test_bvh_retarget import MIXAMO, write_as
from tests.messages import raises_message

FRAMES = {"anna": 120, "ben_take2": 150, "carl": 180}
SONGS = {"anna": 2.0, "ben_take_02": 2.6, "blue": 3.1, "long": 9.0}


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captures")
    for place in ("takes", "songs"):
        (folder / place).mkdir()
    motion = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=180)[0]
    for name, frames in FRAMES.items():
        write_as(folder / "takes" / f"{name}.bvh", motion.part(0, frames), SMPL24, Rotation.identity(24),
                 names=MIXAMO.split())  # fmt: skip
    part = motion.part(0, 120)
    np.savez(folder / "takes" / "dora.npz", poses=part.rotations.reshape(120, 72), trans=part.translation)
    for name, seconds in SONGS.items():
        samples = np.random.default_rng(0).normal(0, 0.1, int(seconds * 8000))
        soundfile.write(folder / "songs" / f"{name}.wav", samples, 8000)
    soundfile.write(folder / "songs" / "dora.wav", np.zeros(16000) + 0.1, 8000)
    (folder / "takes" / "eva.bvh").write_text("HIERARCHY\n")
    return folder


@pytest.fixture(scope="module")
def rows(source: Path) -> dict[str, ProposedRow]:
    return {row.id: row for row in propose(source).rows}


def test_music_by_name_and_by_length(source: Path, rows: dict[str, ProposedRow]) -> None:
    assert {name: row.audio for name, row in rows.items()} == {
        "anna": "songs/anna.wav", "ben_take2": "songs/ben_take_02.wav", "carl": "songs/blue.wav",
        "dora": "songs/dora.wav", "eva": "",
    }  # fmt: skip
    assert {name for name, row in rows.items() if "audio" in row.guessed} == {"ben_take2", "carl"}
    assert "audio: equal name" in rows["anna"].evidence
    assert "motion 3.00 s, music 3.10 s" in rows["carl"].evidence
    assert propose(source).unused == ("songs/long.wav",)


def test_facts_that_files_do_not_state(rows: dict[str, ProposedRow]) -> None:
    anna, dora = rows["anna"], rows["dora"]
    assert (anna.fps, anna.up, anna.unit, anna.guessed) == ("", "", "cm", ("unit",))
    assert any("m from toes to head at rest" in why for why in anna.evidence)
    # 120 frames and music of 2 s: 60 FPS.
    assert (dora.fps, dora.up, dora.unit) == ("60", "y", "m")
    assert set(dora.guessed) == {"fps", "up", "unit"}
    assert dora.motion_s == 2.0


def test_what_cannot_be_read_is_named(rows: dict[str, ProposedRow]) -> None:
    assert any(why.startswith("the motion cannot be read: ") for why in rows["eva"].evidence)
    assert not rows["eva"].guessed


@pytest.mark.parametrize("confirmed", [False, True])
def test_it_is_read_as_a_manifest_and_names_its_guesses(
    source: Path, tmp_path: Path, rows: dict[str, ProposedRow], confirmed: bool
) -> None:
    text = propose(source).to_csv()
    if confirmed:
        text = Proposal(tuple(replace(row, guessed=()) for row in rows.values())).to_csv()
    folder = shutil.copytree(source, tmp_path / "copy")
    (folder / "manifest.csv").write_text(text)
    scan = Folder(music="optional").scan(folder)
    assert {clip.id for clip in scan.clips} == set(rows)
    guesses = [note for note in scan.notes if note.startswith("UNCONFIRMED GUESSES")]
    expected = (
        "UNCONFIRMED GUESSES in 4 rows of the manifest (audio of 2, fps of 1, unit of 4, up of 1; the first in "
    )
    assert guesses == [] if confirmed else guesses[0].startswith(expected)
    assert Folder().load(next(clip for clip in scan.clips if clip.id == "dora")).n_frames == 120


def test_the_command(source: Path) -> None:
    assert run("manifest", source).stdout == propose(source).to_csv()
    assert as_json("manifest", source)["rows"][0]["audio"] == "songs/anna.wav"


def test_a_folder_without_motion(tmp_path: Path) -> None:
    with raises_message(SourceError, "empty"):
        propose(tmp_path)


def test_music_by_a_word_that_no_other_song_has(tmp_path: Path) -> None:
    """Numbers of takes, words of several songs, and two songs at once tell nothing."""
    motion = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=60)[0]
    (tmp_path / "takes").mkdir()
    for name in ("anna_RED_1", "ben_final_2", "carl_red_blue", "dora_03"):
        write_as(tmp_path / "takes" / f"{name}.bvh", motion, SMPL24, Rotation.identity(24), names=MIXAMO.split())
    for name in ("red (final)", "Blue final", "03 green"):
        soundfile.write(tmp_path / f"{name}.wav", np.zeros(72000) + 0.1, 8000)
    rows = {row.id: row for row in propose(tmp_path).rows}
    assert {name: row.audio for name, row in rows.items()} == {
        "anna_RED_1": "red (final).wav", "ben_final_2": "", "carl_red_blue": "", "dora_03": "",
    }  # fmt: skip
    assert "audio" in rows["anna_RED_1"].guessed
    assert any("'red' is in both names" in why for why in rows["anna_RED_1"].evidence)


def test_the_rate_of_arrays_that_do_not_state_it(tmp_path: Path) -> None:
    arrays = {"smpl_poses": np.full((120, 72), 0.01), "smpl_trans": np.zeros((120, 3))}
    np.savez(tmp_path / "aist.npz", **arrays, smpl_scaling=np.array([94.0]))
    np.savez(tmp_path / "other.npz", **arrays)
    rows = {row.id: row for row in propose(tmp_path).rows}
    assert (rows["aist"].fps, rows["other"].fps) == ("60", "30")
    assert "fps: nothing states it; 60 is usual for AIST++'s arrays, by smpl_scaling" in rows["aist"].evidence
    assert "fps: nothing states it; 30 is usual" in rows["other"].evidence
