"""The content of the synthetic corpus: songs, clips, splits, beats. Names follow AIST++.

This module needs only numpy; motion and music are generated in the sibling modules.
"""

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import UsageError

#: Frames per second of AIST++ motion.
MOTION_RATE = 60

#: A song is this much longer than the clips danced to it, seconds.
_SONG_TAIL_S = 1.0

#: Two dancers of each AIST++ genre.
DANCERS: dict[str, tuple[int, int]] = {
    "BR": (4, 5), "PO": (10, 11), "LO": (13, 14), "MH": (22, 23), "LH": (17, 18),
    "HO": (19, 20), "WA": (25, 26), "KR": (28, 29), "JS": (1, 2), "JB": (8, 9),
}  # fmt: skip

#: Music of the crossmodal val and test splits (AIST++).
TEST_MUSIC = frozenset(("BR0", "PO1", "LO2", "MH3", "LH4", "HO5", "WA0", "KR2", "JS3", "JB5"))

# First a mix with three test songs, all ten genres and many tempos, then the rest of the sixty.
_FIRST = ("BR0", "HO3", "PO4", "LO2", "MH1", "WA3", "KR5", "JS1", "LH4", "JB2", "BR4")
CATALOGUE: tuple[str, ...] = _FIRST + tuple(
    f"{genre}{n}" for n in range(6) for genre in DANCERS if f"{genre}{n}" not in _FIRST
)

# (situation, dancer 0 or 1, choreography). Val is sBM ch01 and test sBM ch02 of a test song; ch01 and ch02 of
# a train song belong to no split, and neither do all other clips of a test song.
_TEST_SONG = (("sBM", 0, 1), ("sBM", 1, 2), ("sBM", 1, 1), ("sBM", 0, 2), ("sFM", 0, 3), ("sBM", 1, 4))
_TRAIN_SONG = (("sBM", 0, 3), ("sFM", 1, 1), ("sBM", 1, 4), ("sFM", 0, 2), ("sBM", 0, 5), ("sBM", 1, 2))

#: A train song with a basic choreography 1 among its first four clips, which belongs to no split.
UNASSIGNED = "WA3"


@dataclass(frozen=True)
class ClipPlan:
    """One clip to generate: AIST++ name, song, length in frames at 60 per second, split."""

    name: str
    music: str
    n_frames: int
    split: str


@dataclass(frozen=True)
class SongPlan:
    """One song to generate: music id without the ``m``, sample rate in Hz, channels, length in seconds."""

    music: str
    sample_rate: int
    n_channels: int
    length_s: float


@dataclass(frozen=True)
class Plan:
    """All songs and clips of a corpus, and the names on its ignore list."""

    songs: tuple[SongPlan, ...]
    clips: tuple[ClipPlan, ...]
    ignored: tuple[str, ...]

    def names(self, split: str) -> list[str]:
        """Return the clip names of one split ("train", "val", "test", or "" for those in none)."""
        return [clip.name for clip in self.clips if clip.split == split]


def tempo_bpm(music: str) -> float:
    """Return the tempo of an AIST++ music id such as ``BR0``: 80 + 10 n, house 110 + 5 n."""
    n = int(music[2:])
    return 110.0 + 5.0 * n if music[:2] == "HO" else 80.0 + 10.0 * n


def music_of(name: str) -> str:
    """Return the music id (``BR0``) of a clip name, a file stem (``mBR0``) or a bare id."""
    part = name.split("_")[4] if name.count("_") >= 5 else name
    music = part.removeprefix("m")
    if music[:2] not in DANCERS or not music[2:].isdigit():
        raise UsageError("not an AIST++ music id", found=name, allowed="m + genre + digit, e.g. mBR0")
    return music


def crossmodal_split(name: str) -> str:
    """Return the split of a clip name by the AIST++ crossmodal rule; "" if it is in none."""
    _, situation, _, _, music, choreography = name.split("_")
    choreography = choreography.removeprefix("ch")
    basic_first = situation == "sBM" and choreography in ("01", "02")
    if music.removeprefix("m") not in TEST_MUSIC:
        return "" if basic_first else "train"
    if not basic_first:
        return ""
    return "val" if choreography == "01" else "test"


def generator(seed: int, *words: str) -> np.random.Generator:
    """Return a random generator that depends only on the seed and the words."""
    digest = hashlib.sha256("/".join((str(seed), *words)).encode()).digest()
    return np.random.Generator(np.random.PCG64(int.from_bytes(digest[:16], "little")))


def beat_times(music: str, seed: int, length_s: float) -> NDArray[np.float64]:
    """Return the beats (B,) of a song in [0, length_s), seconds: first_beat + k * 60 / tempo."""
    period = 60.0 / tempo_bpm(music)
    first = float(generator(seed, "beat", music).uniform(0.15, 0.3))
    count = max(0, int(np.ceil((length_s - first) / period)))
    return first + period * np.arange(count, dtype=np.float64)


def make_plan(songs: int, clips_per_song: int, clip_s: float) -> Plan:
    """Plan a corpus; UsageError if a number is outside the range of the names."""
    _check("songs", songs, 2, len(CATALOGUE))
    _check("clips_per_song", clips_per_song, 2, 40)
    _check("clip_s", clip_s, 2.0, 600.0)
    chosen = CATALOGUE[:songs]
    length = round(clip_s * MOTION_RATE)
    named = sorted((_clip_name(music, k), music) for music in chosen for k in range(clips_per_song))
    splits = [crossmodal_split(name) for name, _ in named]
    # One clip has 29 (mod 30) frames, where counts before and after decimation differ.
    shortened = max(k for k, split in enumerate(splits) if split == "train")
    lengths = [length - (length - 29) % 30 if k == shortened else length for k in range(len(named))]
    clips = tuple(
        ClipPlan(name, music, n, split) for (name, music), n, split in zip(named, lengths, splits, strict=True)
    )
    song_plans = tuple(
        SongPlan(music, 44_100 if k == 1 else 48_000, 1 if k == 1 else 2, clip_s + _SONG_TAIL_S)
        for k, music in enumerate(chosen)
    )
    train = [clip.name for clip in clips if clip.split == "train"]
    return Plan(song_plans, clips, tuple(train[4:5]) if len(train) > 8 else ())


def _clip_name(music: str, k: int) -> str:
    pattern = _TEST_SONG if music in TEST_MUSIC else _TRAIN_SONG
    situation, dancer, choreography = pattern[k] if k < len(pattern) else ("sFM", k % 2, 4 + k)
    if music == UNASSIGNED and k == 3:
        situation, dancer, choreography = "sBM", 1, 1
    genre = music[:2]
    return f"g{genre}_{situation}_cAll_d{DANCERS[genre][dancer]:02d}_m{music}_ch{choreography:02d}"


def _check(what: str, value: Any, low: float, high: float) -> None:
    if not low <= value <= high:
        raise UsageError(
            f"synthetic: {what} is out of range", found=value, allowed=f"{low} to {high}", fix=f"set {what}"
        )
