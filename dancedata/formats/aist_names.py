"""Names of AIST++'s sequences and songs: the dancer, the genre, the music and its tempo in them."""

import re
from dataclasses import dataclass

from dancedata.core.resources import manifest

# Explicit ranges: \d would accept digits of other scripts. Other cameras than "All", and other situations than
# sBM and sFM, occur in AIST, from which AIST++ was derived.
_SEQUENCE = re.compile(r"(g[A-Z]{2})_(s[A-Z]{2})_(c(?:All|[0-9]{2}))_(d[0-9]{2})_(m[A-Z]{2}[0-9]+)_(ch[0-9]{2})")
SONG = re.compile(r"m([A-Z]{2})([0-9]+)")


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


def tempo_bpm(music: str) -> float | None:
    """Return the tempo in BPM of a music id such as ``mBR2``, one of ten genres' six songs; None without a rule."""
    facts, match = manifest("aistpp"), SONG.fullmatch(music)
    if match is None or match[1] not in facts["tempo_bpm"] or len(match[2]) > 1:
        return None
    tempo, n = facts["tempo_bpm"][match[1]], int(match[2])
    return float(tempo["base"] + tempo["step"] * n) if n < facts["songs_per_genre"] else None
