"""A proposed manifest: pairs and facts with their evidence; unconfirmed guesses are named when it is read."""

import csv
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
from dancedata.datasets.folder.propose import ProposedRow, propose
from dancedata.recipes.parse import load_recipe
from dancedata.synthetic import synthesise_motion
from tests.commands import as_json
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
    assert any(why.startswith("the motion cannot be read: ") for why in rows["eva"].evidence)
    assert not rows["eva"].guessed


@pytest.mark.parametrize("confirmed", [False, True])
def test_it_is_read_as_a_manifest_and_names_its_guesses(source, tmp_path, rows, confirmed):
    folder = shutil.copytree(source, tmp_path / "copy")
    with (folder / "manifest.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows["dora"].cells)
        writer.writeheader()
        writer.writerows(replace(row, guessed=() if confirmed else row.guessed).cells for row in rows.values())
    scan = Folder(music="optional").scan(folder)
    assert {clip.id for clip in scan.clips} == set(rows)
    guesses = [note for note in scan.notes if note.startswith("UNCONFIRMED GUESSES")]
    expected = (
        "UNCONFIRMED GUESSES in 4 rows of the manifest (audio of 2, fps of 1, unit of 4, up of 1; the first in "
    )
    assert guesses == [] if confirmed else guesses[0].startswith(expected)
    assert Folder().load(next(clip for clip in scan.clips if clip.id == "dora")).n_frames == 120


def test_a_folder_is_prepared_and_what_is_filled_in_stays(source: Path, tmp_path: Path) -> None:
    """A second run fills empty cells only; what was confirmed stays, and so does the recipe."""
    made = shutil.copytree(source, tmp_path / "made")
    manifest, recipe = made / "manifest.csv", made / "recipe.yaml"
    proposal = propose(made)
    as_json("init", made)
    assert load_recipe(recipe).name == "made"
    lines = manifest.read_text().splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.lstrip('"').startswith("#")))
    assert rows == [row.cells for row in proposal.rows]
    assert [next(csv.reader([line])) for line in lines[:2]] == [[comment] for comment in proposal.comments]
    rows[0] |= {"audio": "songs/long.wav", "guessed": ""}
    rows[1]["audio"] = ""
    with manifest.open("w", newline="") as file:
        writer = csv.DictWriter(file, [*rows[0], "dancer"], delimiter=";")
        writer.writeheader()
        writer.writerows(rows[:-1])
    recipe.write_text("mine")
    about = as_json("init", made)
    again = list(csv.DictReader(manifest.read_text().splitlines(), delimiter=";"))
    assert recipe.read_text() == "mine"
    assert (about["added"], about["filled"]) == (1, int(bool(proposal.rows[1].audio)))
    assert "songs/long.wav" not in about["unused"]
    assert (again[0]["audio"], again[0]["guessed"]) == ("songs/long.wav", "")
    assert again[1]["audio"] == proposal.rows[1].audio
    assert again[-1]["motion"] == rows[-1]["motion"]
    assert as_json("init", made)["added"] == 0


def test_music_by_a_word_that_no_other_song_has(tmp_path: Path) -> None:
    """Numbers of takes, words of several songs, and two songs at once tell nothing."""
    with raises_message(SourceError, "empty"):
        propose(tmp_path)
    motions = dict.fromkeys(("anna_RED_1.npz", "ben_final_2.npz", "carl_red_blue.npz", "dora_03.npz"), 1)
    rows = captures(tmp_path, motions, dict.fromkeys(("red (final).wav", "Blue final.wav", "03 green.wav"), 9))
    assert [row.audio for row in rows.values()] == ["red (final).wav", "", "", ""]
    assert "audio" in rows["anna_RED_1.npz"].guessed
    assert any("'red' is in both names" in why for why in rows["anna_RED_1.npz"].evidence)


def test_the_rate_of_arrays_that_do_not_state_it(tmp_path: Path) -> None:
    arrays = {"smpl_poses": np.full((120, 72), 0.01), "smpl_trans": np.zeros((120, 3))}
    np.savez(tmp_path / "aist.npz", **arrays, smpl_scaling=np.array([94.0]))
    np.savez(tmp_path / "other.npz", **arrays)
    rows = {row.id: row for row in propose(tmp_path).rows}
    assert (rows["aist"].fps, rows["other"].fps) == ("60", "30")
    assert "fps: nothing states it; 60 is usual for AIST++'s arrays, by smpl_scaling" in rows["aist"].evidence
    assert "fps: nothing states it; 30 is usual" in rows["other"].evidence


@pytest.mark.parametrize(("clips", "songs", "by"), [(2, 2, None), (3, 2, "clip"), (3, 3, "music")])
def test_splits_that_would_leave_one_empty_are_not_proposed(clips, songs, by, tmp_path):
    captures(tmp_path, {f"a{k}.npz": 2 for k in range(clips)}, {f"a{k}.wav": 2 for k in range(songs)})
    as_json("init", tmp_path)
    split = load_recipe(tmp_path / "recipe.yaml").dataset.split
    assert (split if by is None else split["by"]) == (by or "train")


def captures(folder: Path, motions: dict[str, float], songs: dict[str, float]) -> dict[str, ProposedRow]:
    """Write AMASS's files and songs of some seconds; return the proposed rows by motion."""
    for name, seconds in motions.items():
        path, frames = folder / name, int(60 * seconds)
        path.parent.mkdir(parents=True, exist_ok=True)
        poses = np.zeros((frames, 156))
        poses[:, 0], poses[:, 3] = np.pi / 2, 0.3 * np.sin(np.arange(frames) / 30)
        np.savez(path, poses=poses, trans=np.zeros((frames, 3)), mocap_framerate=60)
    for name, seconds in songs.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        soundfile.write(folder / name, np.random.default_rng(0).normal(0, 0.1, int(seconds * 8000)), 8000)
    return {row.motion: row for row in propose(folder).rows}


@pytest.mark.parametrize(
    ("motions", "songs", "audio", "guessed"),
    [
        # Folders of sessions, subjects or days.
        (("s1/t.npz", "s2/t.npz"), {"s1/t.wav": 2, "s2/t.wav": 3}, ("s1/t.wav", "s2/t.wav"), (False, True)),
        (("a/m/1.npz", "b/m/1.npz"), {"a/w/1.wav": 2, "b/w/1.wav": 2}, ("a/w/1.wav", "b/w/1.wav"), (False, False)),
        (("x/y/1.npz",), {"1.wav": 2, "x/1.mp3.wav": 2, "x/1.flac": 2}, ("x/1.flac",), (False,)),
        # A similar name in the folder comes before an equal one elsewhere.
        (("b/take_02.npz",), {"a/take_02.wav": 2, "b/take_2.wav": 2}, ("b/take_2.wav",), (True,)),
        # One of several that are as near, by its length.
        (("m/1.npz",), {"u/1.wav": 9, "v/1.wav": 2}, ("v/1.wav",), (True,)),
        # Equal names of two formats are one song; another length is a guess.
        (("1.npz",), {"1.wav": 2, "1.flac": 2}, ("1.wav",), (False,)),
        (("mocap/01.npz",), {"music/01.wav": 2.4}, ("music/01.wav",), (False,)),
        (("mocap/01.npz",), {"music/01.wav": 2.6}, ("music/01.wav",), (True,)),
        # Names that are equal to the eye.
        (("zo\u00eb.npz",), {"zoe\u0308.wav": 2}, ("zoe\u0308.wav",), (False,)),
    ],
)
def test_songs_of_folders(tmp_path, motions, songs, audio, guessed):
    rows = captures(tmp_path, dict.fromkeys(motions, 2.0), songs)
    assert tuple(rows[name].audio for name in motions) == audio
    assert tuple("audio" in rows[name].guessed for name in motions) == guessed


def test_ids_are_names_of_files_in_an_archive(tmp_path: Path) -> None:
    """AMASS's tree: equal names in folders, shapes beside them; and names with points, or of two formats."""
    rows = captures(tmp_path, dict.fromkeys(("s1/take_poses.npz", "s2/take_poses.npz", "v1.2.npz"), 1.0), {})
    for folder in ("s1", "s2"):
        np.savez(tmp_path / folder / "shape.npz", betas=np.zeros(16), gender="female")
    np.savez(tmp_path / "s1" / "stagei.npz", betas=np.zeros((1, 16)), markers=np.zeros((46, 3)), labels=["a"])
    shutil.copy(tmp_path / "v1.2.npz", tmp_path / "s1" / "v1.2.npz")
    proposed = propose(tmp_path)
    assert [row.id for row in proposed.rows] == ["s1_take_poses", "s1_v1_2", "s2_take_poses", "v1_2"]
    assert proposed.others == ("s1/shape.npz", "s1/stagei.npz", "s2/shape.npz")
    assert "s1/shape.npz" in proposed.comments[1]
    assert [row.id for row in rows.values()] == ["s1_take_poses", "s2_take_poses", "v1_2"]


def test_the_up_axis_of_short_files_is_that_of_the_others(tmp_path: Path) -> None:
    motion = synthesise_motion("gHO_sBM_cAll_d20_mHO3_ch05", n_frames=600)[0]
    for name, first, last in (("a", 0, 300), ("b", 300, 600), ("c", 100, 120)):
        poses = np.pad(motion.rotations[first:last].reshape(last - first, -1)[:, :66], ((0, 0), (0, 99)))
        np.savez(tmp_path / f"{name}.npz", poses=poses, trans=motion.translation[first:last], mocap_frame_rate=60)
    assert {row.id: (row.up, row.guessed) for row in propose(tmp_path).rows} == dict.fromkeys("abc", ("y", ("up",)))
