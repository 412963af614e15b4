"""FeatureCache: equal to builds and shared with them, computed once for all processes, and the page's dataset."""

import pickle
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.audio.librosa35.feature import Librosa35
from dancedata.cache import FeatureCache
from dancedata.core.errors import DataError, UsageError
from tests.commands import in_processes
from tests.messages import raises_message

VAL = "gBR_sBM_cAll_d04_mBR0_ch01"


@pytest.fixture
def song(corpus: Path) -> Path:
    """A song of 6 s."""
    return corpus / "wavs" / "mBR0.wav"


@pytest.fixture
def own(tmp_path: Path) -> FeatureCache:
    """A cache of the test's own."""
    return FeatureCache(tmp_path / "cache")


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[], int]:
    """Count computations, also those of forked processes; each takes a moment, so that calls overlap."""
    log = tmp_path / "log"
    log.touch()

    def counted(original: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **options: Any) -> Any:
            with log.open("a") as file:
                file.write("call\n")
            time.sleep(0.2)
            return original(*args, **options)

        return call

    for name in ("extract", "extract_windows"):
        monkeypatch.setattr(Librosa35, name, counted(getattr(Librosa35, name)))
    return lambda: log.read_text().count("call")


@pytest.mark.parametrize("windows", [None, (150, 15)])
def test_ranks_that_ask_at_once_compute_once(own: FeatureCache, song: Path, calls: Callable[[], int], windows: Any):
    found = in_processes(6, lambda: np.array(own(song, "librosa35", fps=30, bpm=120, windows=windows)))
    assert calls() == 1
    assert all(np.array_equal(rows, found[0]) for rows in found)
    assert found[0].shape[-2:] == ((found[0].shape[0], 35) if windows is None else (150, 35))
    assert list((own.root / "locks").iterdir()) == list((own.root / "tmp").iterdir()) == []
    # Another object, another process by and by.
    FeatureCache(own.root)(song, "librosa35", fps=30, bpm=120, windows=windows)
    assert calls() == 1


@pytest.mark.parametrize("scope", ["track", "window"])
def test_results_of_a_build_are_found_and_equal(built_in, cache, song, calls, scope):
    with dancedata.open(built_in[scope]) as ds:
        bpm = next(c.tempo_bpm for c in ds if c.original == VAL)
        features = FeatureCache(cache)
        if scope == "track":
            rows = features(song, "librosa35", fps=30, bpm=bpm)
            np.testing.assert_array_equal(rows[:150], ds[VAL].read("librosa35")[:150])
        else:
            windows = features(song, "librosa35", windows=(150, 15), fps=30, bpm=bpm)
            for clip in (clip for clip in ds if clip.slice_of == VAL):
                np.testing.assert_array_equal(windows[clip.slice_start // 15], clip.read("librosa35"))
    # The song is longer than the dance: its last windows are in no dataset.
    assert calls() == {"track": 0, "window": 1}[scope]


def test_any_number_of_damaged_windows_are_computed_again(own: FeatureCache, song: Path, calls: Callable[[], int]):
    wanted = own(song, "librosa35", windows=(60, 3), fps=30, bpm=120)
    entries = list((own.root / "features").rglob("*.npy"))
    assert len(entries) == len(wanted) > 35
    for path in entries:
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 1
        path.write_bytes(data)
    found = own(song, "librosa35", windows=(60, 3), fps=30, bpm=120)
    np.testing.assert_array_equal(found, wanted)
    assert calls() == 2, "all of them at once"


def test_a_song_shorter_than_a_window_has_none(own: FeatureCache, song: Path):
    assert own(song, "librosa35", windows=(300, 15), bpm=120).shape == (0, 300, 35)


def test_results_are_read_only_and_it_is_picklable(own: FeatureCache, song: Path):
    wanted = own(song, "librosa35", bpm=120)
    with pytest.raises(ValueError, match="read-only"):
        wanted[0] = 0
    other = pickle.loads(pickle.dumps(own))
    assert repr(other) == repr(own)
    np.testing.assert_array_equal(other(song, "librosa35", bpm=120), wanted)


def test_errors_say_what_is_wrong(own: FeatureCache, song: Path, tmp_path: Path):
    with raises_message(UsageError, "bailando55"):
        own(song, "librosa")
    with raises_message(UsageError, "tightness"):
        own(song, "librosa35", tightnes=1)
    with raises_message(UsageError, "exist"):
        own(tmp_path / "none.wav", "librosa35")
    with raises_message(UsageError, "stride"):
        own(song, "librosa35", windows=(150, 0))
    (tmp_path / "broken.wav").write_bytes(b"RIFF")
    with pytest.raises(DataError, match=r"broken\.wav"):
        own(tmp_path / "broken.wav", "librosa35")
    assert not own.root.joinpath("features").exists()


def test_a_feature_is_made_ready_as_in_a_build(own, song, calls, monkeypatch):
    """As jukebox fixes its precision and the hash of its weights."""
    own(song, "librosa35", tightness=7)
    monkeypatch.setattr(Librosa35, "resolved", lambda self, hash_file: replace(self, tightness=7.0), raising=False)
    FeatureCache(own.root)(song, "librosa35")
    assert calls() == 1
