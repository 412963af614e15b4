"""Copies at another speed: beats, contacts and key motions stay aligned, and a build recomputes everything."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.augment.tempo import Tempo
from dancedata.building.build import build
from dancedata.building.part import Part, build_part
from dancedata.building.plan import make_plan
from dancedata.building.transforms.copy import Copy
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import DataError, RecipeError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import CONTACTS, FEATURES, KEYMOTIONS
from dancedata.core.skeleton import SMPL24
from dancedata.files.regular_file import sha256_file
from dancedata.music.signal import load_audio
from dancedata.music.stretch import stretched, stretched_length
from dancedata.pages.numbers import splits
from dancedata.recipes.parse import parse_recipe
from dancedata.store import verify_store
from dancedata.store.songs import songs_of
from dancedata.testing.examples import FPS
from tests.augment.conftest import RECIPE
from tests.messages import raises_message

SPEEDS = [Fraction(4, 5), Fraction(9, 10), Fraction(11, 10), Fraction(5, 4)]
RATE = 44100
HALF_A_FRAME_S = 1 / 60


def hits(bpm: float, seconds: float = 12.0, first_s: float = 0.5) -> tuple[AudioSignal, np.ndarray]:
    """Return drum hits over a tone, and their instants in seconds."""
    time_s = np.arange(int(seconds * RATE)) / RATE
    samples = 0.02 * np.sin(2 * np.pi * 220 * time_s)
    hit = np.random.default_rng(0).normal(0, 0.4, RATE // 16) * np.exp(-80 * time_s[: RATE // 16])
    at = np.arange(first_s, seconds - 0.3, 60 / bpm)
    for second in at:
        first = round(second * RATE)
        samples[first : first + len(hit)] += hit
    return AudioSignal(samples.astype(np.float32), RATE), at


def rises(signal: AudioSignal, near: np.ndarray) -> np.ndarray:
    """Return the instants at which the power first exceeds half of its largest value around each of `near`."""
    power = np.convolve(signal.samples.astype(np.float64) ** 2, np.ones(64) / 64, "same")
    found = []
    for second in near:
        first = int((second - 0.1) * RATE)
        part = power[first : first + RATE // 4]
        found.append((first + np.argmax(part > part.max() / 2)) / RATE)
    return np.array(found)


@pytest.mark.parametrize("speed", SPEEDS[::3], ids=str)
def test_beats_of_stretched_music_are_within_half_a_frame_of_where_they_belong(speed: Fraction) -> None:
    signal, at = hits(120)
    faster = stretched(signal, speed)
    assert faster.n_samples == stretched_length(signal.n_samples, speed)
    late = rises(faster, at / float(speed)) - rises(signal, at) / float(speed)
    assert np.abs(late).max() < HALF_A_FRAME_S
    # librosa finds the same beats as in music played at that tempo, to one row.
    bpm = 120 * float(speed)
    played, when = hits(bpm, 12 / float(speed), 0.5 / float(speed))
    feature = FEATURES.get("librosa35")()
    rows, wanted = (feature.extract(s, FPS, start_bpm=bpm) for s in (faster, played))
    own, other = (np.flatnonzero(found[:, 34]) / 30 for found in (rows, wanted))
    beats, same = (np.array([f[np.argmin(np.abs(f - second))] for second in when[2:-2]]) for f in (own, other))
    assert np.abs(beats - same).max() < 1.5 / 30
    assert abs((beats - same).mean()) < HALF_A_FRAME_S
    # The pitch stays: the tone is at 220 Hz.
    spectrum = np.abs(np.fft.rfft(faster.samples[: 2 * RATE] * np.hanning(2 * RATE)))
    assert np.argmax(spectrum[300:600]) + 300 == pytest.approx(440, abs=2)


def test_stretching_short_and_silent_signals() -> None:
    for n in (1, 7, 100, 5000):
        signal = AudioSignal(np.zeros(n, np.float32), 16000)
        for speed in SPEEDS:
            assert stretched(signal, speed).n_samples == stretched_length(n, speed)
    same = AudioSignal(np.ones(10, np.float32), 16000)
    assert stretched(same, Fraction(1)) is same
    with raises_message(DataError, "stretched", reason="short_audio"):
        stretched(AudioSignal(np.zeros(1, np.float32), 16000), Fraction(4))


def dance(place: np.ndarray) -> Motion:
    """Return a stiff dancer at 60 frames per second, who is moved along x."""
    translation = np.zeros((len(place), 3))
    translation[:, 0] = place
    return Motion(translation, np.zeros((len(place), 24, 3)), FrameGrid.of(60), SMPL24)


def at_speed(motion: Motion, speed: Fraction) -> Motion:
    return Copy("tempo", Tempo(speeds=(float(speed),))).motion_of(motion, "clip").resampled(FPS)


@pytest.mark.parametrize("speed", SPEEDS, ids=str)
def test_key_motions_are_within_half_a_frame_of_where_they_belong(speed: Fraction) -> None:
    turns_s = 0.837 * np.arange(1, 11)  # a swing that stops at instants that are not frames
    time_s = np.arange(540) / 60
    rows = KEYMOTIONS.get("lodge")().analyse(at_speed(dance(np.cos(np.pi * time_s / 0.837)), speed))
    minima = (np.flatnonzero(rows[:, 1]) + 0.5) / 30  # value m is the way from frame m to m + 1
    assert len(minima) == len(turns_s)
    assert np.abs(minima - turns_s / float(speed)).max() <= HALF_A_FRAME_S + 1e-9


@pytest.mark.parametrize("speed", SPEEDS, ids=str)
def test_contacts_are_within_half_a_frame_of_where_they_belong(speed: Fraction) -> None:
    time_s = np.arange(601) / 60
    steps = np.floor(time_s) + np.clip(2 * (time_s % 1) - 1, 0, 1)  # stands half a second, goes 2 m/s for another
    motion = at_speed(dance(steps), speed)
    labels = CONTACTS.get("velocity")()(motion.joints(), FPS, SMPL24)[:-1, 0]
    between = (np.arange(len(labels)) + 0.5) / 30  # a label is of the way to the next frame
    for label, second in zip(labels, between, strict=True):
        near = np.array([second - HALF_A_FRAME_S, second + HALF_A_FRAME_S]) * float(speed)
        stands = near % 1 < 0.5
        assert bool(label) in stands or near[0] // 0.5 != near[1] // 0.5


def document(**keys: Any) -> dict[str, Any]:
    return {
        **RECIPE, "name": "tempo", "motion": {"edge151": {}, "lodge139": {}},
        "augment": {"tempo": {"speeds": [1.25]}, "tempo.slow": {"speeds": [0.9]}, "mirror": True}, **keys,
    }  # fmt: skip


def test_copies_are_those_of_faster_motion_and_music(source: Path, cache: Path, tmp_path: Path) -> None:
    recipe = parse_recipe(document())
    build(recipe, source, tmp_path / "out", cache=cache)
    store = dancedata.open(tmp_path / "out")
    assert [p for p in verify_store(store.path) if p.severity == "error"] == []
    refs = {ref.id: ref for ref in recipe.dataset.scan(source).clips}
    train = [clip for clip in store if clip.split == "train" and not clip.source]
    assert train
    for clip in train:
        for name, speed in (("tempo", Fraction(5, 4)), ("tempo.slow", Fraction(9, 10))):
            copy, ref = store[f"{clip.id}__{name}"], refs[clip.id]
            whole = recipe.dataset.load(ref)
            assert copy.source == clip.id
            assert copy.n_frames == FrameGrid(60 * speed).resampled_length(whole.n_frames, FPS)
            assert copy.tempo_bpm == pytest.approx(clip.tempo_bpm * float(speed))
            assert (copy.music, copy.source_rate, copy.n_flags) == (
                f"{clip.music}__{float(speed):g}x", clip.source_rate, clip.n_flags,
            )  # fmt: skip
            music = stretched(load_audio(ref.audio_path), speed)
            windows = [w for w in store.windows("train") if w.clip == copy.id]
            assert [w.start for w in windows] == list(range(0, 15 * len(windows), 15))
            motion = Motion(
                whole.translation, whole.rotations, FrameGrid(60 * speed), whole.skeleton, whole.trim_start
            )
            for field in (field for field in recipe.fields if field not in recipe.audio):
                (rows,) = field.encoded([motion.resampled(FPS)], [0], in_group=False)
                np.testing.assert_array_equal(copy.read(field.name), rows)
            rows = recipe.audio[0].feature.extract(music, FPS, start_bpm=copy.tempo_bpm)
            np.testing.assert_array_equal(copy.read("librosa35"), rows[: copy.n_frames])


def test_plan_parts_and_jobs_see_the_same_copies(source: Path, tmp_path: Path) -> None:
    recipe = parse_recipe(document())
    plan = make_plan(recipe, source, cache=tmp_path / "cache").to_json()
    assert plan["cached"]["librosa35"]["cached"] == 0
    for number in (1, 2):
        build_part(recipe, source, Part(number, 2), cache=tmp_path / "cache")
    full = make_plan(recipe, source, cache=tmp_path / "cache").to_json()["cached"]
    assert all(held["cached"] == held["of"] for held in full.values()), full
    build(recipe, source, tmp_path / "a", cache=tmp_path / "cache", jobs=2)
    build(recipe, source, tmp_path / "b", cache=tmp_path / "other")
    shards = [sorted(p.name for p in (tmp_path / name).glob("*.h5")) for name in "ab"]
    assert shards[0] == shards[1]
    assert all(sha256_file(tmp_path / "a" / s) == sha256_file(tmp_path / "b" / s) for s in shards[0])
    store = dancedata.open(tmp_path / "a")
    # Stretched copies of a song are not counted as songs, nor shared by another split.
    songs = songs_of(store.clips())
    assert all(songs[clip.id] == songs[clip.source] for clip in store if clip.source)
    assert {split: own["songs"] for split, own in store.info["splits"].items()} == {
        split: own["songs"] for split, own in plan["splits"].items()
    }
    assert splits(store).songs.counts["train"]["train"] == plan["splits"]["train"]["songs"] == 1
    for split, counts in plan["splits"].items():
        frames = sum(clip.n_frames for clip in store.clips(split))
        assert (counts["clips"], counts["windows"], counts["frames"]) == (
            len(store.clips(split)), len(store.windows(split)), frames,
        )  # fmt: skip


def test_copies_too_short_for_a_window_are_rejects(source: Path, cache: Path, tmp_path: Path) -> None:
    keys = {"windows": {"length_s": 4.5, "stride_s": 0.5}, "motion": {"joints": {}}, "keymotion": {}, "audio": {}}
    recipe = parse_recipe(document(augment={"tempo": {"speeds": [1.25]}}, **keys))
    build(recipe, source, tmp_path / "out", cache=cache)
    store = dancedata.open(tmp_path / "out")
    train = [clip.id for clip in store if clip.split == "train"]
    assert {(r["clip"], r["reason"]) for r in store.rejects} == {(f"{clip}__tempo", "too_short") for clip in train}


def test_an_augmentation_of_samples_makes_no_copy() -> None:
    with raises_message(RecipeError, "max_degrees", where="recipe"):
        parse_recipe(
            document(augment={"crop": True, "drop": {}, "tempo": {"speeds": []}, "yaw": {"max_degrees": 400}})
        )
