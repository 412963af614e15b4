"""The package's front door: extract, encode, decode."""

from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import DataError, RecipeError, UsageError
from dancedata.core.skeleton import SMPL24
from dancedata.music.signal import load_audio
from dancedata.testing.examples import random_motion, random_signal
from tests.messages import raises_message


def test_extract_takes_a_file_or_a_signal(corpus: Path):
    path = corpus / "wavs" / "mHO3.wav"
    rows = dancedata.features(path, "librosa35", fps=30, bpm=120)
    assert rows.dtype == np.float32
    assert rows.shape[1] == 35
    assert np.array_equal(rows, dancedata.features(str(path), "librosa35", fps=30, bpm=120))
    assert np.array_equal(rows, dancedata.features(load_audio(path), "librosa35", bpm=120))


def test_extract_at_another_rate_and_with_parameters():
    signal = random_signal(3, 16_000)
    assert (
        len(dancedata.features(signal, "librosa35", fps=60)) == 2 * len(dancedata.features(signal, "librosa35")) - 1
    )
    assert dancedata.features(signal, "librosa35", bpm=120, tightness=50).shape == (91, 35)
    with raises_message(RecipeError, r"audio\.librosa35"):
        dancedata.features(signal, "librosa35", tightness=-1)


def test_a_value_without_rotations_is_a_usage_error():
    with raises_message(UsageError, "SMPL24"):
        dancedata.encode(np.zeros((90, 72)), "edge151")  # type: ignore[arg-type]
    positions = dancedata.encode(random_motion(SMPL24, 30), "joints")
    with raises_message(UsageError, "turns"):
        dancedata.decode(positions, "joints")


def test_encode_takes_another_contact_rule():
    motion = random_motion(SMPL24, 30, turn_rad=0.01, step_m=0.001)
    usual = dancedata.encode(motion, "edge151")
    assert np.array_equal(dancedata.encode(motion, "edge151", contacts="velocity"), usual)
    wide = dancedata.encode(motion, "edge151", contacts={"velocity": {"max_speed_m_s": 100}})
    assert wide[:, :4].all()
    assert not usual[:, :4].all()


def test_misspelt_names_are_explained(tmp_path: Path):
    motion = random_motion(SMPL24, 3)
    with raises_message(UsageError, "bailando55"):
        dancedata.features(random_signal(1, 16_000), "librosa")
    with raises_message(RecipeError, "tightness"):
        dancedata.features(random_signal(1, 16_000), "librosa35", tight=1)
    with raises_message(UsageError, "root_place"):
        dancedata.encode(motion, "edge")
    with raises_message(RecipeError, "height"):
        dancedata.encode(motion, "edge151", contacts="velo")
    with raises_message(DataError, "exist", where="none.wav", reason="missing_file"):
        dancedata.features(tmp_path / "none.wav", "librosa35")
    with pytest.raises(AttributeError, match="no attribute 'encoder'"):
        _ = dancedata.encoder
