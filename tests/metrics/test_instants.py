"""The same dance at four rates has the same beats at the same instants, and the same numbers of protocol dancedata.

Dancers, songs and scores are of the numpy of this file.
"""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata.audio.librosa35.feature import Librosa35
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.dance import Dance, MusicBeats
from dancedata.core.grid import FrameGrid
from dancedata.datasets.aistpp import AistPP
from dancedata.evaluation.measuring import measure_pose
from dancedata.evaluation.music import ClipMusic
from dancedata.evaluation.protocol import PROTOCOLS
from dancedata.metrics import motion_beat_times, motion_beats
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.set_statistics import STATISTICS, frechet
from dancedata.scene.poses import Pose
from dancedata.store.schema import Field
from tests.datasets.scans import load

RATES = (20, 24, 30, 60)
SECONDS = 5


def planted(
    beats: np.ndarray, fps: float, *, seed: int = 0, noise: float = 0.0, seconds: float = SECONDS
) -> np.ndarray:
    """Return (T, 22, 3) of a dancer who goes from pose to pose by a polynomial of degree 5, at rest on each beat."""
    rng = np.random.default_rng(seed)
    period = np.diff(beats).mean()
    keys = np.concatenate([beats[0] - period * np.arange(4, 0, -1), beats, beats[-1] + period * np.arange(1, 5)])
    poses = rng.normal(0, 0.25, (len(keys), 22, 3))
    instants = np.arange(round(seconds * fps)) / fps
    here = np.searchsorted(keys, instants, side="right") - 1
    part = ((instants - keys[here]) / (keys[here + 1] - keys[here]))[:, None, None]
    moved = part**3 * (10 - 15 * part + 6 * part**2)
    joints = poses[here] * (1 - moved) + poses[here + 1] * moved
    return np.asarray(joints + noise * np.random.default_rng([seed, round(fps)]).normal(size=joints.shape))


def songs(n: int) -> list[np.ndarray]:
    rng = np.random.default_rng(7)
    return [np.arange(rng.uniform(0, 0.4), SECONDS, 60 / rng.uniform(80, 130)) for _ in range(n)]


def score(heard: np.ndarray, danced: np.ndarray) -> float:
    """Return the mean over beats that are heard 1/6 s or more from the ends."""
    inside = heard[(heard >= 1 / 6) & (heard <= SECONDS - 1 / 20 - 1 / 6)]
    return float(np.exp(-(np.abs(inside[:, None] - danced).min(axis=1) ** 2) / (2 * 0.05**2)).mean())


def at(seconds: np.ndarray, fps: int = 1000) -> MusicBeats:
    return MusicBeats(np.rint(seconds * fps).astype(np.int64), FrameGrid.of(fps), seconds)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_perfect_dancer_is_perfect_at_each_rate(noise: float) -> None:
    means = []
    for fps in RATES:
        scores = []
        for seed, beats in enumerate(songs(12)):
            joints = planted(beats, fps, seed=seed, noise=noise)
            scores.append(score(beats, motion_beat_times(joints, fps)))
            bas, chance = BeatAlignment(joints=22).measure(Dance(joints, FrameGrid.of(fps), at(beats)))
            assert bas == pytest.approx(scores[-1], abs=0.02)  # a beat near the end may count at one rate only
            assert chance < 0.4 < 0.95 < bas
        means.append(np.mean(scores))
    assert min(means) >= 0.98
    assert np.ptp(means) <= 0.005


@pytest.mark.parametrize("fps", [*RATES, 29.97])
def test_beats_that_fall_on_frames_have_two_equal_steps_and_count(fps: float) -> None:
    beats = np.arange(round(fps / 2), 5 * fps, round(fps / 2)) / fps
    found = motion_beat_times(planted(beats, fps), fps)
    near = np.abs(beats[:-1, None] - found).min(axis=1)
    assert near.max() < 0.02
    assert len(found) <= len(beats) + 1


def test_a_pause_is_one_beat_in_its_middle() -> None:
    for fps in RATES:
        moving = planted(np.array([1.0, 2.0]), fps)[: fps + 1]
        still = np.repeat(moving[-1:], fps, axis=0)
        pause = np.concatenate([moving, still, moving[::-1]])  # at rest from 1 to 2 s and a frame
        rounded = pause + 1e-14 * np.random.default_rng(fps).normal(size=pause.shape)
        for joints in (pause, rounded, pause.astype(np.float32)):
            found = motion_beat_times(joints, fps)
            inside = found[(found > 0.9) & (found < 2.2)]
            assert len(inside) == 1
            assert inside[0] == pytest.approx(1.5 + 0.5 / fps, abs=0.03 if joints.dtype == np.float64 else 0.5)
    assert not len(motion_beat_times(np.repeat(moving[:1], 60, axis=0), 30))
    assert not len(motion_beat_times(moving[:1], 30))


def test_programs_are_half_a_frame_off_as_their_notes_say() -> None:
    beats = np.arange(0.5, 20, 0.61)
    for name in PROTOCOLS.names():
        protocol = PROTOCOLS.get(name)()
        detectors = [m.metric.detector for m in protocol.measures if isinstance(m.metric, BeatAlignment)]
        if not detectors or name in ("dancedata", "groups"):
            continue
        fps = protocol.motion.fps or 30
        joints = planted(beats, fps, seconds=20)
        found = motion_beats(joints, fps, detector=detectors[0]) / fps
        late = 1000 * np.median([found[np.abs(found - beat).argmin()] - beat for beat in beats[2:-2]])
        (note,) = [note for note in protocol.notes if note.startswith("beats are the program's")]
        assert abs(late) == pytest.approx(500 / fps, abs=4)
        assert f"half a frame ({500 / fps:.1f} ms" in note
        assert f"{'late' if late > 0 else 'early'}, of music" in note
        rows = protocol.music.fps or fps if protocol.music else fps
        assert f"a row ({1000 / rows:.1f} ms) late" in note


def clicks(beats: np.ndarray, seconds: float, rate: int = 48_000) -> AudioSignal:
    rng = np.random.default_rng(0)
    samples = 0.001 * rng.standard_normal(round(seconds * rate))
    burst = 0.5 * np.exp(-np.arange(2400) / 300) * rng.standard_normal(2400)
    for beat in beats:
        start = round(beat * rate)
        samples[start : start + 2400] += burst[: len(samples) - start]
    return AudioSignal(samples.astype(np.float32), rate)


@pytest.mark.parametrize("fps", RATES)
def test_beats_of_music_are_read_at_their_instants(fps: int) -> None:
    """Clicks on frames of all four rates, and 0.4 of a row after one of each rate."""
    for first in (0.5, 0.5 + 0.4 / fps):
        beats = first + 0.5 * np.arange(18)
        rows = dancedata.features(clicks(beats, 10), "librosa35", fps=fps, bpm=120)
        stored = np.flatnonzero(rows[:, -1]) / fps
        assert len(stored) >= 16
        late = stored - beats[np.abs(stored[:, None] - 1 / fps - beats).argmin(axis=1)]
        if first == 0.5:
            assert late == pytest.approx(1 / fps, abs=1e-9)  # 33.3 ms at 30, 16.7 at 60
        columns = Librosa35().columns
        found = Field("librosa35", "audio", columns, FrameGrid.of(fps).rate).beats(rows).seconds
        assert np.abs(found[:, None] - beats).min(axis=1).max() < 0.25 / fps
        alone = Field("librosa35.own", "audio", columns, FrameGrid.of(fps).rate).beats(rows[:, -1]).seconds
        assert alone == pytest.approx(stored - 1 / fps)


def test_pieces_and_cache_keys_have_the_instants() -> None:
    beats = MusicBeats(np.array([10, 40, 70]), FrameGrid.of(30), np.array([0.31, 1.32, 2.3]))
    assert beats.after(30, FrameGrid.of(60)).seconds == pytest.approx([0.82, 1.8])
    same = MusicBeats(beats.frames, beats.grid)
    assert same.seconds == pytest.approx(beats.frames / 30)
    assert ClipMusic(beats).identity(instants=False) == ClipMusic(same).identity(instants=False)
    assert ClipMusic(beats).identity(instants=True) != ClipMusic(same).identity(instants=True)
    pieces = [ClipMusic(same, by_piece={0: b}).identity(instants=True) for b in (beats, same)]
    assert pieces[0] != pieces[1]


@pytest.mark.parametrize("rate", ["30", "30000/1001", "60000/1001", "24000/1001", "22.5", "60"])
def test_pieces_begin_at_one_instant_at_all_rates(rate: str) -> None:
    """Every 2.5 s, less than a frame early: a stride that was rounded down is off by 0.7 s after a minute."""
    grid, pieces = FrameGrid.of(rate), PROTOCOLS.get("dancedata")().truth
    cuts = pieces.of(int(120 * grid.rate), grid)
    assert len(cuts) == 47
    for k, (start, length) in enumerate(cuts):
        assert 0 <= Fraction(5, 2) * k - grid.seconds(start) < grid.seconds(1)
        assert 0 <= 5 - grid.seconds(length) < grid.seconds(1)
    assert cuts[-1][0] + cuts[-1][1] <= int(120 * grid.rate)


def numbers(joints: np.ndarray, fps: int, music: MusicBeats) -> list[np.ndarray]:
    """Return the rows of each measure of the protocol for one clip; NaN where one is undefined."""
    protocol = PROTOCOLS.get("dancedata")()
    pose = Pose.of_joints(joints, FrameGrid.of(fps), "smplx22")
    found = measure_pose(protocol, "truth", range(len(protocol.measures)), pose, ClipMusic(music))
    widths = [len(measure.metric.columns) for measure in protocol.measures]
    return [
        np.array([[np.nan] * width if isinstance(row, str) else row for row in found[k][3]])  # type: ignore[index]
        for k, width in enumerate(widths)
    ]


def same_numbers(dances: list[dict[int, np.ndarray]], music: list[MusicBeats]) -> None:
    rows = [{f: numbers(d[f], f, b) for f in RATES} for d, b in zip(dances, music, strict=True)]
    # A dance has as many pieces at all rates, up to a frame at its end.
    counts = [min(len(of[f][0]) for f in RATES) for of in rows]
    found = {
        f: [np.concatenate([of[f][k][:n] for of, n in zip(rows, counts, strict=True)]) for k in range(5)]
        for f in RATES
    }
    for fps in RATES:
        for k, limit in ((0, 1.0), (1, 0.1)):  # version 1: 14 to 40, and 134 to 624
            pool, of_rate = STATISTICS["varying"](found[60][k], found[fps][k])
            assert frechet(of_rate, pool) < limit
        for k, limits in ((2, {"abs": 0.02}), (3, {"rel": 0.15}), (4, {"abs": 0.02})):  # BAS, PFC, FSR
            here, there = found[fps][k], found[60][k]
            assert (np.isnan(here) == np.isnan(there)).all()
            if not np.isnan(here).all():
                assert np.nanmean(here[:, 0]) == pytest.approx(np.nanmean(there[:, 0]), **limits)


def test_the_same_dances_have_the_same_numbers_at_four_rates() -> None:
    beats = [np.arange(first, 12, period) for first, period in ((0.2, 0.5), (0.3, 0.61), (0.1, 0.7), (0.25, 0.46))]
    dances = [{f: planted(b, f, seed=k, seconds=12) for f in RATES} for k, b in enumerate(beats)]
    same_numbers(dances, [at(b) for b in beats])


def test_real_dances_have_the_same_numbers_at_four_rates(shared: Path) -> None:
    paths = sorted((shared / "realdata/aistpp/motions").glob("*.pkl"))
    paths += sorted((shared / "golden/peers/inputs/edge_aistpp/motions").glob("*.pkl"))
    motions = [load(AistPP(), path) for path in paths]
    dances = [{f: m.resampled(FrameGrid.of(f)).joints()[:, :22] for f in RATES} for m in motions]
    # Music that is danced to: the beats of the motion at 60, which are not on frames.
    same_numbers(dances, [at(motion_beat_times(dance[60], 60)) for dance in dances])
