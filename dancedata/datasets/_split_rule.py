"""Splits by a rule: the split of a clip depends only on the name of its song (or dancer) and a seed.

The name, in Unicode's form NFC, is hashed to a number in [0, 1): the first 8 bytes of the SHA-256 of the UTF-8 text
``SEED``, a line break, ``NAME``, as a big-endian integer, divided by 2**64. Below the fraction of test the clip is
test, from 1 - the fraction of val on it is val, else train. No clip changes its split when the dataset grows; the
fractions are met only on average. Songs with equal samples are one song, under the first of their names.

With ``balance`` the groups in the order of these numbers are dealt out so that the clips of val and test come close
to their fractions, for datasets of a few groups; a clip that is added may then move others.
"""

from __future__ import annotations

import hashlib
import unicodedata
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from dancedata.core.clip import ClipRef, union_find
from dancedata.core.errors import DataError, SourceError, UsageError, did_you_mean
from dancedata.core.grid import as_fraction
from dancedata.core.hashing import sha256_bytes
from dancedata.core.text import counted, listed
from dancedata.files.regular_file import open_regular
from dancedata.kernel import load_audio

#: The attributes that can define groups, and their nouns in messages.
_NOUNS = {"music": "song", "dancer": "dancer", "genre": "genre", "clip": "clip"}
_TRAIN, _VAL, _TEST = "train", "val", "test"
_KEYS = (_VAL, _TEST, "by", "seed", "balance")
_FIX = "write it as {val: 0.1, test: 0.1, by: music}; the rest is train"
#: Samples at the beginning of songs that are compared before whole songs are.
_BEGINNING = 1 << 15


@dataclass(frozen=True)
class SplitRule:
    """A rule that assigns groups of clips with one value of `by` to splits: fractions in [0, 1); the rest is train.

    `balance`: Whether groups are dealt out by their numbers of clips, and not each by its name alone.
    """

    val: Fraction
    test: Fraction
    by: str
    seed: int
    balance: bool = False

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> SplitRule:
        """Parse a rule of a recipe; UsageError with all its problems."""
        problems = [f"unknown key {key!r}; {did_you_mean(str(key), _KEYS)}" for key in document if key not in _KEYS]
        parts = {name: _fraction(name, document.get(name, 0), problems) for name in (_VAL, _TEST)}
        by, seed = document.get("by"), document.get("seed", 0)
        if not isinstance(by, str) or by not in _NOUNS:
            found = "missing" if by is None else f"{by!r}"
            problems.append(f"by is {found}; allowed: {', '.join(_NOUNS)}")
        if not isinstance(seed, int) or isinstance(seed, bool) or not 0 <= seed < 2**63:
            problems.append(f"seed is {seed!r}; allowed: an integer from 0 on")
        balance = document.get("balance", False)
        if not isinstance(balance, bool):
            problems.append(f"balance is {str(balance)[:40]!r}; allowed: true or false")
        rest = 1 - sum(parts.values())
        if not problems and not (0 < rest < 1):
            problems.append(f"the sum of val and test is {float(1 - rest):g}; allowed: above 0 and below 1")
        if problems:
            raise UsageError("folder: invalid rule for splits", found="; ".join(problems), fix=_FIX)
        return cls(parts[_VAL], parts[_TEST], str(by), seed, balance)

    def document(self) -> dict[str, Any]:
        """Return the rule as stored in recipes; equal rules give equal documents, however they were written."""
        fractions = {_VAL: str(self.val), _TEST: str(self.test)}
        return {**fractions, "by": self.by, "seed": self.seed, "balance": self.balance}

    def _text(self) -> str:
        texts = {key: str(value).lower() if key == "balance" else value for key, value in self.document().items()}
        return f"{{{', '.join(f'{key}: {value}' for key, value in texts.items())}}}"

    def split(self, group: str) -> str:
        """Return the split of a group by its name."""
        place = self._place(group)
        return _TEST if place < self.test else _VAL if place >= 1 - self.val else _TRAIN

    def _place(self, group: str) -> Fraction:
        """Return the number of a group, in [0, 1)."""
        text = f"{self.seed}\n{unicodedata.normalize('NFC', group)}"
        digest = hashlib.sha256(text.encode("utf-8", "surrogatepass")).digest()
        return Fraction(int.from_bytes(digest[:8], "big"), 2**64)

    def _splits(self, sizes: Mapping[str, int], fixed: Mapping[str, str]) -> dict[str, str]:
        """Return the split of every group; `sizes` are their numbers of clips, `fixed` splits of the manifest."""
        if not self.balance:
            return {group: fixed.get(group) or self.split(group) for group in sizes}
        splits = {group: fixed.get(group) or _TRAIN for group in sizes}
        free = sorted((group for group in sizes if not fixed.get(group)), key=lambda g: (self._place(g), g))
        n = sum(sizes.values())
        for name, part, groups in ((_TEST, self.test, free), (_VAL, self.val, free[::-1])):
            left, target = [g for g in groups if splits[g] == _TRAIN], part * n
            size_of_split = sum(size for g, size in sizes.items() if splits[g] == name)
            for group in left if part else ():
                if abs(size_of_split + sizes[group] - target) < abs(size_of_split - target):
                    splits[group], size_of_split = name, size_of_split + sizes[group]
            if part and not size_of_split and len(left) > 1:
                splits[min(left, key=lambda g: sizes[g])] = name
        return splits

    def group(self, clip: ClipRef) -> str:
        """Return the name of a clip's group; a clip without music is a group by itself."""
        name = {"music": clip.music, "dancer": clip.dancer, "genre": clip.genre, "clip": clip.id}[self.by]
        return name or (clip.id if self.by == "music" else "")

    def apply(self, clips: Sequence[ClipRef]) -> tuple[list[ClipRef], list[str]]:
        """Return the clips, those without a split in their group's, and notes; SourceError if a split stays empty."""
        nameless = [clip.id for clip in clips if not self.group(clip)]
        if nameless:
            raise SourceError(
                f"folder: splits by {self.by} require the {self.by} of every clip",
                found=f"{counted(len(nameless), 'clip')} without: {listed(nameless)}",
                fix=f"fill in the column {self.by} of the manifest, or split by music or clip",
            )
        fixed = self._fixed_splits(clips)
        splits = self._splits(Counter(self.group(clip) for clip in clips), fixed)
        assigned = [replace(clip, split=splits[self.group(clip)]) for clip in clips]
        self._require_all(assigned)
        return assigned, [self._note(assigned)]

    def _fixed_splits(self, clips: Iterable[ClipRef]) -> dict[str, str]:
        fixed: dict[str, ClipRef] = {}
        for clip in clips:
            first = fixed.setdefault(self.group(clip), clip) if clip.split else clip
            if first.split != clip.split:
                raise SourceError(
                    f"folder: {self.by} {self.group(clip)!r} is in two splits, but the recipe splits by {self.by}",
                    found=f"{first.id} in {first.split}, {clip.id} in {clip.split}",
                    fix="assign one split in the manifest, or leave the column empty",
                )
        return {group: clip.split for group, clip in fixed.items()}

    def _requested(self) -> dict[str, Fraction]:
        requested = {_TRAIN: 1 - self.val - self.test, _VAL: self.val, _TEST: self.test}
        return {name: part for name, part in requested.items() if part}

    def _require_all(self, clips: Sequence[ClipRef]) -> None:
        splits = Counter(clip.split for clip in clips)
        empty = [name for name in self._requested() if not splits[name]]
        if not empty or not clips:
            return
        enough = len({self.group(clip) for clip in clips}) >= len(self._requested())
        balance = "set balance: true, " if enough and not self.balance else ""
        larger = "use larger fractions" if enough else f"ask for fewer splits than {len(self._requested())}"
        by_clip = "" if self.by == "clip" else ", split by clip"
        raise SourceError(f"folder: no clip is in {' and '.join(empty)} by the rule {self._text()}",
                          found=self._count(clips),
                          fix=f"{balance}{larger}{by_clip}, or write splits into a manifest")  # fmt: skip

    def _count(self, clips: Sequence[ClipRef]) -> str:
        text = counted(len(clips), "clip")
        if self.by == "clip":
            return text
        return f"{text} of {counted(len({self.group(clip) for clip in clips}), _NOUNS[self.by])}"

    def _note(self, clips: Sequence[ClipRef]) -> str:
        if not clips:
            return f"Splits by {self.by}: no clip is left."
        requested, parts = self._requested(), []
        for name in [*requested, *sorted({clip.split for clip in clips} - set(requested))]:
            of_split = [clip for clip in clips if clip.split == name]
            origin = f"requested {float(requested[name]):.1%}" if name in requested else "from the manifest"
            parts.append(f"{name} {len(of_split) / len(clips):.1%} ({origin}; {self._count(of_split)})")
        balanced = ", balanced: a clip that is added may move others" if self.balance else ""
        return f"Splits by {self.by}, seed {self.seed}{balanced}: {', '.join(parts)}."


def same_songs(clips: Iterable[ClipRef]) -> dict[str, str]:
    """Return the names of songs with equal samples -> the first name, by the alphabet, of those that have them."""
    names: dict[Path, set[str]] = {}
    for clip in clips:
        if clip.audio_path is not None and clip.music:
            names.setdefault(clip.audio_path, set()).add(clip.music)
    same: list[set[str]] = []
    for alike in _grouped(names, _beginning):
        if len(set().union(*(names[path] for path in alike))) > 1:
            same += [{name for path in equal for name in names[path]} for equal in _grouped(alike, _samples)]
    groups = [sorted(group) for group in union_find(same)]
    return {name: group[0] for group in sorted(groups) for name in group[1:]}


def _grouped(paths: Iterable[Path], key: Callable[[Path], Hashable]) -> list[list[Path]]:
    """Return lists of files with equal keys; files that cannot be read are left to the build, which rejects them."""
    groups: dict[Hashable, list[Path]] = {}
    for path in paths:
        with suppress(DataError, OSError):
            groups.setdefault(key(path), []).append(path)
    return list(groups.values())


def _samples(path: Path) -> str:
    """Return the hash of all samples; -0.0 is 0.0."""
    signal = load_audio(path)
    return replace(signal, samples=signal.samples + 0).sha256


def _beginning(path: Path) -> tuple[int, int, str]:
    """Return rate and length by the file's header, and a hash of the first samples' mean over channels."""
    import soundfile

    with open_regular(path) as file:
        try:
            with soundfile.SoundFile(file) as sound:
                start = sound.read(_BEGINNING, dtype="float32", always_2d=True)
                return sound.samplerate, sound.frames, sha256_bytes((start.mean(axis=1) + 0).tobytes())
        except (soundfile.LibsndfileError, TypeError) as error:
            raise OSError(str(error)) from error


#: A tenth of the groups each is val and test.
TENTHS = SplitRule(Fraction(1, 10), Fraction(1, 10), "music", 0)


def _fraction(name: str, value: Any, problems: list[str]) -> Fraction:
    try:
        if isinstance(value, bool):
            raise UsageError("not a number")
        part = as_fraction(value, name)
    except UsageError:
        part = Fraction(-1)
    if not 0 <= part < 1:
        problems.append(f"{name} is {str(value)[:40]!r}; allowed: a fraction in [0, 1), such as 0.1")
        return Fraction(0)
    return part
