"""librosa35 against what EDGE, FACT and Lodge themselves computed.

Gates are those of the golden outputs' own README: just above what independent float32 reruns reached
(envelope 4.8e-5; MFCC 7.0e-4 at values to 509, where float32 resolves 3e-5; chroma 6e-8) and far below what
a wrong setting does (rounding the 16-bit wav instead of truncating it moves MFCC by up to 0.26). This version
was measured at 3.8e-6, 9.2e-5 and 0. Peaks and beats are decisions: equal or wrong.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.audio.librosa35.feature import Librosa35
from dancedata.core.audio_signal import pcm16
from dancedata.core.grid import FrameGrid
from dancedata.music.signal import load_audio
from tests.features import LIBROSA35, assert_within

FEATURE = Librosa35()


def _json(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def _song(peers: Any, clip: str) -> Path:
    (path,) = (peers / "inputs" / "edge_aistpp" / "wavs").glob(f"{clip}.*")
    return path


def _bpm(clip: str) -> float:
    """AIST++: 80 + 10 n by the music id, house 110 + 5 n."""
    music = clip.split("_")[4]
    return 110 + 5 * int(music[-1]) if music.startswith("mHO") else 80 + 10 * int(music[-1])


@pytest.mark.parametrize(("split", "n_windows"), [("train", 47), ("test", 15)])
def test_edge_windows(peers: Any, split: str, n_windows: int) -> None:
    names = _json(peers / f"edge_windows_{split}.json")
    golden = peers.load(f"edge_{split}.npz")
    expected, windows_there = golden["baseline35"], golden.index("baseline35")
    assert (len(names), 150, 35) == golden.shape("baseline35")
    assert len(names) == n_windows
    assert len(expected) >= 2
    rows: dict[str, list[tuple[int, int]]] = {}
    for row, name in enumerate(names[k] for k in windows_there):
        clip, _, k = name.rpartition("_slice")
        rows.setdefault(clip, []).append((row, int(k)))
    for clip, windows in rows.items():
        signal = load_audio(_song(peers, clip))
        starts = np.array([k * signal.sample_rate // 2 for _, k in windows])
        features = FEATURE.extract_windows(
            signal, starts, 5 * signal.sample_rate, FrameGrid.of(30), 150, start_bpm=_bpm(clip)
        )
        assert_within(LIBROSA35, FEATURE.columns, features, expected[[row for row, _ in windows]])


def test_edge_slice_samples(peers: Any) -> None:
    arrays = peers.load("edge_slice_pcm.npz")
    name, expected = str(arrays["name"]), arrays["pcm"]
    clip, _, k = name.removesuffix(".wav").rpartition("_slice")
    signal = load_audio(_song(peers, clip))
    start = int(k) * signal.sample_rate // 2
    steps = pcm16(signal.samples[start : start + len(expected)]) * 32768
    assert np.array_equal(steps, expected)


def test_fact_tracks_at_60_fps(peers: Any) -> None:
    sources = _json(peers / "fact_audio_source.json")
    expected = peers.load("fact_audio35_60fps.npz")
    assert set(expected) == set(sources)
    for music, clip in sources.items():
        signal = load_audio(_song(peers, clip))
        features = FEATURE.extract(signal, FrameGrid.of(60), start_bpm=_bpm(clip))
        assert_within(LIBROSA35, FEATURE.columns, features, expected[music])


def test_lodge_tracks_without_a_known_tempo(peers: Any) -> None:
    expected = peers.load("lodge_music35.npz")
    assert len(expected)
    for track, rows in expected.items():
        (path,) = (peers / "inputs" / "finedance" / "music_wav").glob(f"{track}.*")
        assert_within(LIBROSA35, FEATURE.columns, FEATURE.extract(load_audio(path), FrameGrid.of(30)), rows)
