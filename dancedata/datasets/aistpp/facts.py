"""Facts about AIST++, from ``manifests/aistpp.yaml``, and the genre, dancer, music, tempo and split in its names."""

import functools
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dancedata.core.resources import resource

# Explicit ranges: \d would accept digits of other scripts. Other cameras than "All", and other situations than
# sBM and sFM, occur in AIST, from which AIST++ was derived.
_SEQUENCE = re.compile(r"(g[A-Z]{2})_(s[A-Z]{2})_(c(?:All|[0-9]{2}))_(d[0-9]{2})_(m[A-Z]{2}[0-9]+)_(ch[0-9]{2})")
_MUSIC = re.compile(r"m([A-Z]{2})([0-9]+)")


@dataclass(frozen=True)
class Facts:
    """The content of the manifest."""

    sequences: int
    frame_rate: int
    get_music: str
    genres: Mapping[str, str]
    genre_ids: Mapping[str, int]
    songs_per_genre: int
    tempo: Mapping[str, tuple[float, float]]
    test_music: frozenset[str]
    situation: str
    val_choreography: str
    test_choreography: str
    copies: Mapping[int, str]
    ignored: frozenset[str]


@functools.cache
def facts() -> Facts:
    """Read the manifest of AIST++, once."""
    import yaml

    text = resource("manifests", "aistpp.yaml").read_text(encoding="utf-8")
    raw: dict[str, Any] = yaml.safe_load(text)
    rule = raw["crossmodal"]
    return Facts(
        sequences=raw["sequences"],
        frame_rate=raw["frame_rate"],
        get_music=raw["get_it"]["music"],
        genres=raw["genres"],
        genre_ids=raw["lodge_genre_ids"],
        songs_per_genre=raw["songs_per_genre"],
        tempo={letters: (t["base"], t["step"]) for letters, t in raw["tempo_bpm"].items()},
        test_music=frozenset(rule["test_music"]),
        situation=rule["situation"],
        val_choreography=rule["val_choreography"],
        test_choreography=rule["test_choreography"],
        copies=raw["copies"],
        ignored=frozenset(raw["ignored"]),
    )


@dataclass(frozen=True)
class SequenceName:
    """The parts of a name such as ``gBR_sBM_cAll_d04_mBR2_ch08``, each with its letters."""

    id: str
    genre: str
    situation: str
    camera: str
    dancer: str
    music: str
    choreography: str


def parse_name(stem: str) -> SequenceName | None:
    """Return the parts of an AIST++ sequence name; None if `stem` is not such a name."""
    match = _SEQUENCE.fullmatch(stem)
    return None if match is None else SequenceName(stem, *match.groups())


def sequence_problem(stem: str) -> str:
    """Return why `stem` is not a sequence name, "" if it is one."""
    return "" if parse_name(stem) else "not named as an AIST++ sequence (gBR_sBM_cAll_d04_mBR2_ch08)"


def music_problem(stem: str) -> str:
    """Return why `stem` is not the name of an audio file, "" if it is: that of a sequence or of a song."""
    named = _MUSIC.fullmatch(stem) or parse_name(stem)
    return "" if named else "named neither as an AIST++ sequence nor as a song (mBR2)"


def tempo_bpm(music: str) -> float | None:
    """Return the tempo in BPM of a music id such as ``mBR2``; None where no rule is known.

    80 + 10 n, house (``mHOn``) 110 + 5 n, for the six songs n = 0..5 of each of the ten genres.
    """
    match = _MUSIC.fullmatch(music)
    if match is None or match[1] not in facts().tempo:
        return None
    n = int(match[2]) if len(match[2]) == 1 else facts().songs_per_genre
    if n >= facts().songs_per_genre:
        return None
    base, step = facts().tempo[match[1]]
    return float(base + step * n)


def crossmodal_split(name: SequenceName) -> str:
    """Return the split of a sequence by the crossmodal rule: "train", "val", "test", or "" for none.

    It agrees with the published lists on all 1,408 names: 980 / 20 / 20, and 388 in no split.
    """
    rule = facts()
    held_out = name.situation == rule.situation and name.choreography in (
        rule.val_choreography,
        rule.test_choreography,
    )
    if name.music not in rule.test_music:
        return "" if held_out else "train"
    if not held_out:
        return ""
    return "val" if name.choreography == rule.val_choreography else "test"
