"""Names of Motorica's recordings, the lists of LDA's repository, and the split by song."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

#: Genre of each code in the names (README of the dataset).
GENRES: Mapping[str, str] = MappingProxyType(
    {
        "LH": "hiphop",
        "KR": "krump",
        "PO": "popping",
        "LO": "locking",
        "JZ": "jazz",
        "CH": "charleston",
        "TP": "tap",
        "CA": "casual",
    }
)
#: Recordings of LDA's `dance_test_files.txt`, without the suffixes of its two interleaved takes; STREAM's as well.
TEST = (
    "kthjazz_gCH_sFM_cAll_d02_mCH_ch01_whitemanpaulandhisorchestraloisiana_006",
    "kthjazz_gJZ_sFM_cAll_d02_mJZ_ch01_bennygoodmansugarfootstomp_003",
    "kthjazz_gTP_sFM_sngl_d02_015",
    "kthmisc_gCA_sFM_cAll_d01_mCA_ch24",
    "kthstreet_gKR_sFM_cAll_d01_mKR_ch01_chargedcableupyour_001",
    "kthstreet_gLH_sFM_cAll_d01_mLH_ch01_thisisit_001",
    "kthstreet_gLH_sFM_cAll_d02_mLH_ch01_lala_001",
    "kthstreet_gLO_sFM_cAll_d02_mLO_ch01_arethafranklinrocksteady_002",
    "kthstreet_gPO_sFM_cAll_d01_mPO_ch01_bombom_002",
    "kthstreet_gPO_sFM_cAll_d02_mPO_ch01_bombom_001",
)
#: Test recordings that LDA's list of train names too.
IN_BOTH = ("kthmisc_gCA_sFM_cAll_d01_mCA_ch24",)
#: Recordings that LDA's list of train names.
TRAIN_COUNT = 112

_GENRE = re.compile(r"g([A-Z]{2})")
_MUSIC = re.compile(r"m([A-Z]{2})([0-9]*)")
_DANCER = re.compile(r"d[0-9]{2}")
_TAKE = re.compile(r"[0-9]{3}")
_OTHER = re.compile(r"s[A-Z]{2}|c[A-Z][a-z]+|sngl|ch[0-9]+")


@dataclass(frozen=True)
class RecordingName:
    """What the name of a recording states; a name in any form is a valid one.

    `song`: Recordings with one song have one value: its slug; without one the code of the music with its number
        ("mLH4"); else the whole name.
    `genre`: One of GENRES' values, or "".
    `dancer`: Session and dancer, "kthjazz_d02"; "" if the name has no dancer. Numbers of different sessions need not
        be the same people.
    """

    id: str
    song: str
    genre: str = ""
    dancer: str = ""


def parse_name(stem: str) -> RecordingName:
    """Read the tokens of a name, each by its form and not by its place."""
    session, *tokens = stem.split("_")
    if not session.startswith("kth"):
        tokens, session = [session, *tokens], ""
    genre = dancer = music = ""
    slug = []
    for k, token in enumerate(tokens):
        if match := _GENRE.fullmatch(token):
            genre = genre or GENRES.get(match[1], "")
        elif match := _MUSIC.fullmatch(token):
            music = music or (token if match[2] else "")
        elif _DANCER.fullmatch(token):
            dancer = dancer or token
        elif not _OTHER.fullmatch(token) and not (k == len(tokens) - 1 and _TAKE.fullmatch(token)):
            slug.append(token)
    who = "_".join(part for part in (session, dancer) if part) if dancer else ""
    return RecordingName(stem, "_".join(slug) or music or stem, genre, who)


def shared_songs(names: Iterable[RecordingName]) -> dict[str, list[str]]:
    """Return the songs that official test and train share: song -> recordings of train that test does not list."""
    names = list(names)
    test = {name.song for name in names if name.id in TEST}
    shared: dict[str, list[str]] = {}
    for name in names:
        if name.song in test and name.id not in TEST:
            shared.setdefault(name.song, []).append(name.id)
    return shared
