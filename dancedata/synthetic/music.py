"""The synthetic music: drums on the beat grid, bass and chords that change every bar, a melody, some noise."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dancedata.core.audio_signal import AudioSignal
from dancedata.synthetic.plan import SongPlan, beat_times, generator, tempo_bpm

Floats = NDArray[np.float64]

# Four bars of chords each: semitones of the root above the key, and whether it is minor (vi IV I V and similar).
_PROGRESSIONS = (
    ((0, True), (8, False), (3, False), (10, False)),
    ((0, True), (5, True), (8, False), (7, False)),
    ((0, False), (7, False), (9, True), (5, False)),
    ((0, False), (9, True), (2, True), (7, False)),
)


@dataclass(frozen=True)
class SyntheticSong:
    """A song and its ground truth.

    `pcm`: (n, channels) int16, of which `signal` is the mean. `beat_times_s`: (B,), kick or snare on each.
    `downbeat_times_s`, `chord_roots`: (M,) first beats of bars, and the pitch class 0..11 of their chords.
    """

    signal: AudioSignal
    pcm: NDArray[np.int16]
    beat_times_s: Floats
    downbeat_times_s: Floats
    chord_roots: NDArray[np.int64]
    tempo_bpm: float


def make_song(plan: SongPlan, seed: int) -> SyntheticSong:
    """Generate the song that `plan` describes."""
    rng = generator(seed, "song", plan.music)
    beats = beat_times(plan.music, seed, plan.length_s)
    n_bars = -(-len(beats) // 4)
    key = int(rng.integers(12))
    progression = _PROGRESSIONS[int(rng.integers(len(_PROGRESSIONS)))]
    chords = [progression[bar % 4] for bar in range(n_bars)]
    mix = _Mix(plan, 60.0 / tempo_bpm(plan.music))
    _drums(mix, beats, plan.music.startswith("HO"), rng)
    for bar, (root, minor) in enumerate(chords):
        _bar(mix, beats[4 * bar : 4 * bar + 4], (key + root) % 12, minor, rng)
    mix.samples += 0.002 * rng.standard_normal(mix.samples.shape)
    peak = float(np.abs(mix.samples).max())
    pcm = np.round(mix.samples * (0.85 / peak) * 32767.0).astype(np.int16)
    mono = (pcm.astype(np.float64).mean(axis=1) / 32768.0).astype(np.float32)
    return SyntheticSong(
        signal=AudioSignal(mono, plan.sample_rate),
        pcm=pcm,
        beat_times_s=beats,
        downbeat_times_s=beats[::4],
        chord_roots=np.array([(key + root) % 12 for root, _ in chords], dtype=np.int64),
        tempo_bpm=tempo_bpm(plan.music),
    )


class _Mix:
    def __init__(self, plan: SongPlan, period_s: float) -> None:
        self.rate = plan.sample_rate
        self.period_s = period_s
        shape = (round(plan.length_s * plan.sample_rate), plan.n_channels)
        self.samples = np.zeros(shape, order="F")
        self._tones: dict[tuple[int, float, int], Floats] = {}

    def time(self, length_s: float) -> Floats:
        """Return the times (m,) of a sound of this length, seconds."""
        return np.arange(int(length_s * self.rate)) / self.rate

    def tone(self, note: int, length_s: float, partials: int) -> Floats:
        """Return a note (MIDI number) with partials falling off as 1 / k^1.5; notes repeat, so they are cached."""
        key = (note, length_s, partials)
        if key not in self._tones:
            angle = 2 * np.pi * 440.0 * 2.0 ** ((note - 69) / 12.0) * self.time(length_s)
            # sin k a = 2 cos a sin (k - 1) a - sin (k - 2) a
            twice_cos, last, now = 2.0 * np.cos(angle), np.zeros_like(angle), np.sin(angle)
            tone = now.copy()
            for k in range(2, partials + 1):
                last, now = now, twice_cos * now - last
                tone += now / k**1.5
            self._tones[key] = tone
        return self._tones[key]

    def add(self, at_s: float, sound: Floats, pan: float = 0.0) -> None:
        """Add a sound at a time; pan -1 is left, 1 is right. Samples beyond the end are cut."""
        start = round(at_s * self.rate)
        sound = sound[: max(0, len(self.samples) - start)]
        gains = [1.0] if self.samples.shape[1] == 1 else [1.0 - 0.5 * pan, 1.0 + 0.5 * pan]
        for channel, gain in enumerate(gains):
            self.samples[start : start + len(sound), channel] += gain * sound


def _drums(mix: _Mix, beats: Floats, house: bool, rng: np.random.Generator) -> None:
    """Add kick on one and three (house: on all four), snare on two and four, hats on the eighths."""
    t = mix.time(0.22)
    kick = 0.9 * np.sin(2 * np.pi * (50 * t + 5.0 * (1 - np.exp(-t / 0.025)))) * np.exp(-t / 0.07)
    t = mix.time(0.16)
    noise = rng.standard_normal(len(t))
    snare = (0.4 * noise + 0.35 * np.sin(2 * np.pi * 190 * t)) * np.exp(-t / 0.045)
    t = mix.time(0.05)
    hat = 0.22 * np.diff(rng.standard_normal(len(t) + 1)) * np.exp(-t / 0.012)
    for k, beat in enumerate(beats):
        if house or k % 2 == 0:
            mix.add(beat, kick)
        if k % 2 == 1:
            mix.add(beat, snare, 0.1)
        mix.add(beat, 0.8 * hat, 0.4)
        mix.add(beat + mix.period_s / 2, 0.5 * hat, -0.4)


def _bar(mix: _Mix, beats: Floats, root: int, minor: bool, rng: np.random.Generator) -> None:
    """Add one bar: a held chord, bass on the beats, melody of chord notes on the beats and some eighths."""
    triad = np.array([0, 3 if minor else 4, 7])
    length = mix.period_s * 4
    t = mix.time(length)
    pad = 0.07 * np.minimum(1.0, t / 0.02) * np.minimum(1.0, (length - t) / 0.05)
    for note, pan in zip(48 + root + triad, (-0.6, 0.0, 0.6), strict=True):
        mix.add(beats[0], pad * mix.tone(int(note), length, 5), pan)
    t = mix.time(0.9 * mix.period_s)
    pluck = 0.3 * np.exp(-t / 0.25) * np.minimum(1.0, t / 0.004)
    bass = pluck * mix.tone(36 + root, 0.9 * mix.period_s, 3)
    t = mix.time(0.45 * mix.period_s)
    ping = 0.12 * np.exp(-t / 0.12) * np.minimum(1.0, t / 0.005)
    for beat in beats:
        mix.add(beat, bass)
        for late in (0.0, 0.5):
            if rng.random() < (0.7 if late == 0.0 else 0.35):
                note = 60 + root + int(rng.choice(triad)) + 12 * int(rng.random() < 0.3)
                sound = ping * mix.tone(note, 0.45 * mix.period_s, 4)
                mix.add(beat + late * mix.period_s, sound, float(rng.uniform(-0.5, 0.5)))
