"""Offsets of music against motion: planted ones against those found, and songs that do not belong to the dance.

    python benchmarks/align.py                  7 minutes
    python benchmarks/align.py --clips 8

Synthetic dancers (11 songs of 80 to 130 beats per minute, four clips of each) with their own song, which is moved by
0, 40, 80 and 200 ms, in clips of 6 to 32 s; all clips of a song together; 200 shuffles of clips and songs. With
$DANCEDATA_SHARED, or ../shared, also the real motions of AIST++: their songs may not be passed on, so that synthetic
songs of the tempo of their names take their place at eight phases of the beat, and it is compared by how much the
offset moves when the song does. All draws are seeded.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dancedata.alignment.onsets import onset_strength
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.clip import ClipRef
from dancedata.datasets.aistpp import AistPP
from dancedata.metrics.offsets import RATE, Offset, RhythmPiece, find_offset, music_rhythm, rhythm_curves
from dancedata.music.signal import load_audio
from dancedata.synthetic import synthesise_motion, synthesise_song
from dancedata.synthetic.plan import CATALOGUE, make_plan, tempo_bpm

Rows = npt.NDArray[np.float32]
LENGTHS_S, PLANTED_MS, FRAME_MS = (6.0, 9.6, 13.5, 20.0, 32.0), (0, 40, 80, 200), 1000 / 60
N_SONGS, SHUFFLES, PHASES, HZ = 11, 200, 8, 24_000


@cache
def song(music: str, ms: float = 0) -> Rows:
    """Return the rhythm of a synthetic song of 34 s that begins `ms` later in its file, to the sample."""
    samples = synthesise_song(music, length_s=34, sample_rate=HZ, n_channels=1).signal.samples
    late = np.concatenate([np.zeros(round(ms * HZ / 1000), np.float32), samples])
    return music_rhythm(onset_strength(AudioSignal(late, HZ), RATE))


@cache
def dance(clip: str) -> Rows:
    """Return the curves of a synthetic dancer, 32 s."""
    motion = synthesise_motion(clip, n_frames=60 * 32)[0]
    return rhythm_curves(motion.joints(), 60, motion.skeleton.joints)


def find(clips: list[Rows], music: str, rows: Rows, *, test_songs: bool = False, seed: int = 0) -> Offset:
    """Return the offset of clips with the rhythm of a song; other songs are those of the catalogue's first."""
    others = [song(name) for name in CATALOGUE[:N_SONGS] if name != music]
    return find_offset([RhythmPiece(clip, rows) for clip in clips], others, test_songs=test_songs, seed=seed)


def row(name: str, offsets: list[Offset], errors_ms: list[float]) -> str:
    """Return a line of the table of planted offsets."""
    reasons = Counter(o.unknown for o in offsets if o.unknown)
    worst = max(map(abs, errors_ms), default=float("nan"))
    middle = float(np.median(errors_ms)) if errors_ms else float("nan")
    beyond = sum(abs(error) >= FRAME_MS for error in errors_ms)
    unknown = ", ".join(f"{reason} {n}" for reason, n in sorted(reasons.items())) or "-"
    return f"{name:24} {len(errors_ms):4} of {len(offsets):3} {middle:+7.1f} {worst:7.1f} {beyond:6}   {unknown}"


def planted(clips: list[str]) -> None:
    """Print what is found of planted offsets, by length of the clips, and for all clips of a song."""
    print(f"{'planted, synthetic':24} {'known':>11} {'median':>7} {'worst':>7} {'>frame':>6}   unknown")
    by_music: dict[str, list[str]] = {}
    for clip in clips:
        by_music.setdefault(clip.split("_m")[1][:3], []).append(clip)
    for seconds in LENGTHS_S:
        for ms in PLANTED_MS:
            offsets = [
                find([dance(clip)[: round(seconds * RATE)]], music, song(music, ms))
                for music, of_music in by_music.items()
                for clip in of_music
            ]
            print(row(f"{seconds:4g} s, {ms:3} ms", offsets, errors(offsets, ms)))
    for ms in PLANTED_MS:
        offsets = [
            find([dance(clip)[: 6 * RATE] for clip in of_music], music, song(music, ms))
            for music, of_music in by_music.items()
        ]
        print(row(f"songs, 6 s clips, {ms:3} ms", offsets, errors(offsets, ms)))


def errors(offsets: list[Offset], ms: float) -> list[float]:
    """Return the errors of known offsets, milliseconds."""
    return [1000 * o.offset_s - ms for o in offsets if not o.unknown and o.offset_s is not None]


def shuffled(clips: list[str]) -> None:
    """Print how often an offset is found with a song of another dance."""
    rng = np.random.default_rng(0)
    print(f"\n{'shuffled':40} {'known':>6} {'of':>5}   with --test-songs")
    for seconds in (9.6, 13.5, 32.0):
        counts: dict[bool, list[tuple[bool, bool]]] = {False: [], True: []}
        for _ in range(SHUFFLES):
            clip = clips[int(rng.integers(len(clips)))]
            own = clip.split("_m")[1][:3]
            others = [name for name in CATALOGUE[:N_SONGS] if name != own]
            other = others[int(rng.integers(len(others)))]
            rows = song(other, float(rng.integers(0, 10)) * 60)
            curves = dance(clip)[: round(seconds * RATE)]
            found = [find([curves], other, rows, test_songs=test) for test in (False, True)]
            same = tempo_bpm(own) == tempo_bpm(other)
            counts[same].append((not found[0].unknown, not found[1].unknown))
        for same, results in counts.items():
            known, tested = (sum(each[k] for each in results) for k in range(2))
            name = f"synthetic, {seconds:g} s, {'the same tempo' if same else 'another tempo'}"
            print(f"{name:40} {known:6} {len(results):5}   {tested}")


def real(shared: Path) -> None:
    """Print the same of real motions."""
    songs = {path.stem: music_rhythm(onset_strength(load_audio(path), RATE)) for path in shared.glob("music/*.ogg")}
    print(f"\n{'real motion':30} {'phases known':>12} {'moves by, worst error':>22}   songs of another tempo, known")
    total = Counter[str]()
    for path in sorted(shared.glob("aistpp/motions/*.pkl")):
        motion = AistPP().load(ClipRef(path.stem, path, None, "all"))
        curves = rhythm_curves(motion.joints(), 60, motion.skeleton.joints)
        music = path.stem.split("_m")[1][:3]
        worst, known, n = 0.0, 0, 0
        for phase in np.arange(PHASES) / PHASES * 60_000 / tempo_bpm(music):
            places = {ms: find([curves], music, song(music, round(phase + ms, 3))) for ms in PLANTED_MS}
            n += len(places)
            found = {ms: o.offset_s for ms, o in places.items() if not o.unknown and o.offset_s is not None}
            known += len(found)
            for ms, place in found.items():
                for other, reference in found.items():
                    beat = 60 / tempo_bpm(music)
                    off = (place - reference - (ms - other) / 1000 + beat / 2) % beat - beat / 2
                    worst = max(worst, 1000 * abs(off))
        wrong = [(name, song(name)) for name in CATALOGUE if tempo_bpm(name) != tempo_bpm(music)]
        alarms = [not find([curves], name, rows).unknown for name, rows in [*wrong, *songs.items()]]
        total["alarms"] += sum(alarms)
        total["of"] += len(alarms)
        moves = f"{worst:.1f} ms" if known else "-"
        print(f"{path.stem:30} {known:6} of {n:3} {moves:>22}   {sum(alarms)} of {len(alarms)}")
    print(f"{'together':66}   {total['alarms']} of {total['of']}")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clips", type=int, default=44)
    arguments = parser.parse_args()
    clips = [clip.name for clip in make_plan(N_SONGS, 4, 32).clips][: arguments.clips]
    planted(clips)
    shuffled(clips)
    shared = Path(os.environ.get("DANCEDATA_SHARED", Path(__file__).parents[2] / "shared")) / "realdata"
    if shared.is_dir():
        real(shared)


if __name__ == "__main__":
    main()
