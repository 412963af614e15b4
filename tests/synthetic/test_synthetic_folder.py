"""The folder that the synthetic corpus is written to, and the plug-in that reads it."""

import hashlib
import inspect
import json
import wave
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.clip import ClipRef
from dancedata.core.errors import SourceError
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.synthetic import Synthetic
from dancedata.formats.safe_pickle import load_pickle
from dancedata.synthetic import corpus as synthetic
from dancedata.synthetic import motion, music, synthesise_motion, write_synthetic
from dancedata.synthetic.plan import crossmodal_split, make_plan, tempo_bpm
from tests.messages import raises_message

FEET = [SMPL24.index(name) for name in ("left_ankle", "right_ankle", "left_foot", "right_foot")]


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_synthetic(tmp_path_factory.mktemp("a") / "corpus", songs=3, clips_per_song=2, clip_s=6.0)


def digests(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(f.relative_to(folder)): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


def test_layout(corpus: Path) -> None:
    plan = make_plan(3, 2, 6.0)
    names = {clip.name for clip in plan.clips}
    assert {path.stem for path in (corpus / "motions").glob("*.pkl")} == names
    assert {path.stem for path in (corpus / "wavs").glob("*.wav")} == {f"m{s.music}" for s in plan.songs}
    mapping = (corpus / "cameras" / "mapping.txt").read_text().splitlines()
    assert {line.split()[0] for line in mapping} == names
    for split in ("train", "val", "test"):
        listed = (corpus / "splits" / f"crossmodal_{split}.txt").read_text().split()
        assert listed
        assert listed == [name for name in sorted(names) if crossmodal_split(name) == split]
    for name in (*names, *(f"m{song.music}" for song in plan.songs)):
        assert (corpus / "truth" / f"{name}.npz").is_file()


def test_pickles_hold_the_synthesised_motion(corpus: Path) -> None:
    for clip in make_plan(3, 2, 6.0).clips:
        content = load_pickle(corpus / "motions" / f"{clip.name}.pkl")
        assert isinstance(content, dict)
        motion, truth = synthesise_motion(clip.name, n_frames=clip.n_frames)
        assert content["smpl_poses"].shape == (clip.n_frames, 72)
        assert {content[key].dtype for key in content if key != "smpl_loss"} == {np.dtype("float32")}
        assert 89 <= content["smpl_scaling"][0] <= 99
        metres = content["smpl_trans"] / content["smpl_scaling"]
        np.testing.assert_allclose(metres, motion.translation, atol=1e-6)
        np.testing.assert_allclose(content["smpl_poses"].reshape(-1, 24, 3), motion.rotations, atol=1e-6)
        stored = np.load(corpus / "truth" / f"{clip.name}.npz")
        np.testing.assert_array_equal(stored["planted"], truth.planted)
        np.testing.assert_array_equal(stored["key_frames"], truth.key_frames)


def test_float32_does_not_unplant_the_feet(corpus: Path) -> None:
    name = make_plan(3, 2, 6.0).clips[0].name
    motion = Synthetic(songs=3, clips_per_song=2, clip_s=6.0).load(_ref(corpus, name))
    feet = motion.joints()[:, FEET]
    planted = np.load(corpus / "truth" / f"{name}.npz")["planted"]
    step = np.linalg.norm(np.diff(feet, axis=0), axis=2)
    assert step[planted[1:] & planted[:-1]].max() < 1e-5


def _ref(corpus: Path, name: str) -> ClipRef:
    scan = Synthetic(songs=3, clips_per_song=2, clip_s=6.0).scan(corpus)
    return next(ref for ref in scan.clips if ref.id == name)


def test_wavs_are_pcm_longer_than_the_motion(corpus: Path) -> None:
    shapes = {}
    for path in sorted((corpus / "wavs").glob("*.wav")):
        with wave.open(str(path)) as file:
            assert file.getsampwidth() == 2
            assert file.getnframes() / file.getframerate() > 6.0
            shapes[path.stem] = (file.getframerate(), file.getnchannels())
    assert shapes == {"mBR0": (48_000, 2), "mHO3": (44_100, 1), "mPO4": (48_000, 2)}


def test_same_seed_same_bytes_and_clips_do_not_depend_on_one_another(corpus, tmp_path, monkeypatch):
    # Generated each time, not kept as in other tests.
    monkeypatch.setattr(music, "make_song", inspect.unwrap(music.make_song))
    monkeypatch.setattr(motion, "make_motion", inspect.unwrap(motion.make_motion))
    before = digests(corpus)
    assert digests(write_synthetic(tmp_path / "again", songs=3, clips_per_song=2, clip_s=6.0)) == before
    more = digests(write_synthetic(tmp_path / "more", songs=4, clips_per_song=2, clip_s=6.0))
    # The clip with 29 (mod 30) frames is another one there; the rest is the same.
    same = [name for name in before if name.startswith(("motions", "wavs")) and more[name] == before[name]]
    assert len(same) >= 8
    other = digests(write_synthetic(tmp_path / "other", songs=3, clips_per_song=2, clip_s=6.0, seed=1))
    assert not any(before[name] == other[name] for name in before if name.startswith(("motions", "wavs")))


def test_a_second_call_writes_nothing(corpus: Path) -> None:
    times = {path: path.stat().st_mtime_ns for path in corpus.rglob("*")}
    write_synthetic(corpus, songs=3, clips_per_song=2, clip_s=6.0)
    assert {path: path.stat().st_mtime_ns for path in corpus.rglob("*")} == times


def test_other_parameters_are_an_error_that_shows_them(corpus: Path) -> None:
    before = digests(corpus)
    with raises_message(SourceError, "clips_per_song", where="corpus/synthetic.json"):
        write_synthetic(corpus, songs=3, clips_per_song=2, clip_s=6.0, seed=7)
    assert digests(corpus) == before


@pytest.mark.parametrize(("file", "source", "word", "where"), [
    ("thesis.txt", ".", "separate", ""), (synthetic.MARKER, ".", "clips_per_song", "synthetic.json"),
    ("file", "file", "synthetic", "file"), ("file", "file/below", "enough", "file/below"),
])  # fmt: skip
def test_sources_that_cannot_be_written(tmp_path: Path, file: str, source: str, word: str, where: str) -> None:
    (tmp_path / file).write_text("{")
    for make in (write_synthetic, Synthetic().scan):
        with raises_message(SourceError, word, where=where):
            make(tmp_path / source)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(file, "{")]


def test_an_interrupted_write_resumes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "corpus"
    size: dict[str, Any] = {"songs": 2, "clips_per_song": 2, "clip_s": 3.0}
    with monkeypatch.context() as patch:
        patch.setattr(synthetic, "_write_clip", _interrupt)
        with pytest.raises(KeyboardInterrupt):
            write_synthetic(folder, **size)
    assert not (folder / synthetic.MARKER).exists()
    write_synthetic(folder, **size)
    assert json.loads((folder / synthetic.MARKER).read_text())["songs"] == 2
    assert digests(folder) == digests(write_synthetic(tmp_path / "whole", **size))


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


# --- the plug-in ------------------------------------------------------------------------------------------------


def test_scan_writes_and_lists(tmp_path: Path) -> None:
    dataset = Synthetic(songs=2, clips_per_song=2, clip_s=3.0)
    scan = dataset.scan(tmp_path / "new")
    assert [ref.id for ref in scan.clips] == [clip.name for clip in make_plan(2, 2, 3.0).clips]
    assert not scan.rejects
    for ref in scan.clips:
        assert ref.split == crossmodal_split(ref.id)
        assert ref.audio_path is not None
        assert ref.audio_path.is_file()
        assert ref.tempo_bpm == tempo_bpm(ref.music.removeprefix("m"))
        assert dataset.load(ref).n_frames in (179, 180)


def test_example_covers_the_splits(tmp_path: Path) -> None:
    Synthetic().make_example(tmp_path / "example")
    scan = Synthetic().scan(tmp_path / "example")
    assert {ref.split for ref in scan.clips} == {"train", "val", "test"}
    assert any("example" in note for note in scan.notes)
    with raises_message(SourceError, "clips_per_song", where="example/synthetic.json"):
        Synthetic(seed=1).scan(tmp_path / "example")
    with raises_message(SourceError, "clips_per_song", where="example/synthetic.json"):
        write_synthetic(tmp_path / "example")  # it requires the whole corpus
