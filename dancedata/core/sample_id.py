"""SampleId: which part of which clip a sample is, as a text that is a safe file name by itself."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import lru_cache
from hashlib import sha256
from typing import Self
from unicodedata import normalize
from urllib.parse import unquote

from dancedata.core.errors import UsageError
from dancedata.core.text import shown

_FORM = re.compile(
    r"(?:(?P<source>[^=]*)=)?(?P<clip>.+?)(?:@(?P<start>[0-9]{1,18})\+(?P<length>[0-9]{1,18}))?(?P<marks>(?:~[^~]+)*)",
    re.DOTALL,
)
_DRAW = re.compile(r"draw([0-9]+)\.([0-9]+)\.([0-9]+)")
#: Characters that a shell, Windows or the form of an id takes for something else; a point or blank at an end, "-" at
#: the beginning, and the first letter of the names of devices.
_UNSAFE = re.compile(
    r"""[%@~=+<>:"/\\|?*,;'$!#&`\x00-\x1f\x7f-\x9f]|^[. -]|[. ]$"""
    r"""|^(?=(?:con|prn|aux|nul|(?:com|lpt)[0-9¹²³])(?:\.|$))[a-z]""",
    re.IGNORECASE,
)
#: Most bytes of the name of a clip in an id: with start, length and marks it is below 180.
_MOST = 120


@lru_cache(maxsize=4096)
def safe_name(name: str) -> str:
    """Return a name that every file system takes, as ids have it: ``%XX`` for a character, a hash for a long end."""
    composed = normalize("NFC", name)
    safe = _quoted(composed)
    if len(safe.encode()) <= _MOST and composed == name:
        return safe
    digits, cut = f"_{sha256(name.encode()).hexdigest()[:12]}", composed[:_MOST]
    while len((safe := _quoted(cut + digits)).encode()) > _MOST:
        cut = cut[:-1]
    return safe


def _quoted(name: str) -> str:
    return _UNSAFE.sub(lambda unsafe: "".join(f"%{byte:02X}" for byte in unsafe[0].encode()), name)


def id_text(clip: str, start: int | None = None, length: int | None = None, marks: str = "", source: str = "") -> str:
    """Return the text of an id; `marks` each begin with ``~``."""
    window = "" if start is None else f"@{start}+{length}"
    return f"{safe_name(source)}={safe_name(clip)}{window}{marks}" if source else f"{safe_name(clip)}{window}{marks}"


@dataclass(frozen=True)
class SampleId:
    """Which part of which clip a sample is: ``[SOURCE=]CLIP[@START+LENGTH][~MARK...]``.

    ``batch["id"]`` is this text. It is a safe file name: `safe_name` says how names are written.

    Attributes
    ----------
    clip
        Id of the clip, or of the group. A stored copy has its own.
    start, length
        Frames of the dataset, from the clip's frame 0; None: the whole clip.
    source
        Name of the dataset in a `Mix`; "" without one.
    changes
        Names of what changed the sample when it was read: ``~mirror``, ``~yaw``.
    draw
        Seed, epoch and index of the draw of these changes, or of a text: ``~draw0.2.17``; None without one.
    dancer
        Number in the source of a dancer of a group, its `member`: ``~p0``; None: all.
    take
        Number of the model's sample of the same window: ``~s3``; 0: the first.

    Examples
    --------
    >>> from dancedata.core.sample_id import SampleId
    >>> sample = SampleId.parse("val=gBR_sBM_cAll_d04_mBR4_ch03@105+150~mirror~draw0.2.17")
    >>> sample.clip, sample.start, sample.mirrored, sample.draw
    ('gBR_sBM_cAll_d04_mBR4_ch03', 105, True, (0, 2, 17))
    >>> str(sample)
    'val=gBR_sBM_cAll_d04_mBR4_ch03@105+150~mirror~draw0.2.17'
    """

    clip: str
    start: int | None = None
    length: int | None = None
    source: str = ""
    changes: tuple[str, ...] = ()
    draw: tuple[int, int, int] | None = None
    dancer: int | None = None
    take: int = 0

    @classmethod
    def parse(cls, text: str | SampleId) -> Self:
        """Return the id that a text is, else that of a clip of this name; UsageError for an empty text."""
        parsed = _FORM.fullmatch(str(text))
        if parsed is None:
            raise UsageError("not the id of a sample", found=shown(text), allowed="CLIP, or CLIP@START+LENGTH~MARK")
        start, length = (None if parsed[name] is None else int(parsed[name]) for name in ("start", "length"))
        of = cls(unquote(parsed["clip"]), start, length, unquote(parsed["source"] or ""))
        for mark in parsed["marks"].split("~")[1:]:
            if drawn := _DRAW.fullmatch(mark):
                of = replace(of, draw=(int(drawn[1]), int(drawn[2]), int(drawn[3])))
            elif mark[0] in "ps" and mark[1:].isdecimal() and mark.isascii():
                of = replace(of, dancer=int(mark[1:])) if mark[0] == "p" else replace(of, take=int(mark[1:]))
            else:
                of = replace(of, changes=(*of.changes, mark))
        return of

    def __str__(self) -> str:
        marks = [*self.changes]
        marks += [] if self.draw is None else ["draw" + ".".join(map(str, self.draw))]
        marks += [] if self.dancer is None else [f"p{self.dancer}"]
        marks += [f"s{self.take}"] if self.take else []
        return id_text(self.clip, self.start, self.length, "".join(f"~{mark}" for mark in marks), self.source)

    @property
    def mirrored(self) -> bool:
        """Whether the sample is the mirror image of the stored dance."""
        return self.changes.count("mirror") % 2 == 1
