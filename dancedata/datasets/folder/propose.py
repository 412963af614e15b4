"""Proposes a manifest of a folder: which music belongs to which motion, and facts that the files do not state.

What is not certain is a guess: its column is named in the row's ``guessed``, with the reason in ``evidence``. Whoever
has checked a row empties its ``guessed``; until then readers of the manifest name it.
"""

from __future__ import annotations

import os
import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.audio_signal import AUDIO_SUFFIXES
from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError, SourceError
from dancedata.core.tables import csv_cell
from dancedata.core.text import counted, listed, shown
from dancedata.datasets.files import relative, require_folder
from dancedata.datasets.folder.facts import GUESS, Declared
from dancedata.datasets.folder.load import Reading, bvh_facts, describe, load_motion
from dancedata.datasets.folder.manifest import id_problem
from dancedata.datasets.folder.people import open_person
from dancedata.datasets.folder.up import judge_up
from dancedata.files.listing import best_audio, stem_of
from dancedata.formats.arrays import ArrayFile
from dancedata.formats.bvh.parse import read_bvh_header
from dancedata.formats.stated import UPRIGHT
from dancedata.formats.values import MOTION_SUFFIXES

#: A shorter name within another one is not evidence.
_MIN_PART = 3
_PARTS = re.compile(r"[^\W\d_]+|[0-9]+")
#: Lengths of motion and music that count as equal, seconds; a guessed rate has to give such a length, too.
_SAME_S = 0.5
#: Rates that are tried against the length of the music, the usual one first.
_RATES = (30, 60, 120, 24, 25, 50, 100)
_HEAD = "# Proposed by dancedata init: check the rows whose column guessed is not empty and then empty that cell."
#: Words of names of files that are compared: letters, without numbers of takes.
_WORD = re.compile(r"[^\W\d_]{3,}")
#: Arrays with fewer columns are no pose of a body: 12 joints in space have 36.
_LEAST_COLUMNS = 36
_ASKED = re.compile(r"[Dd]eclare (fps|up|unit):(?: (\S+))?")


@dataclass(frozen=True)
class Name:
    """A file name, split into letters and numbers; "001" is "1". `row`: All in a row, to search one in another."""

    text: str
    parts: tuple[str, ...]
    row: str

    @classmethod
    def of(cls, text: str) -> Name:
        """Split a name."""
        words = _PARTS.findall(text.lower())
        parts = tuple(part.lstrip("0") or "0" if part.isdigit() else part for part in words)
        return cls(text, parts, f" {' '.join(parts)} ")

    def near(self, other: Name) -> bool:
        """Return whether the other name may be this one, written differently."""
        if self.parts == other.parts:
            return bool(self.parts)
        return self._has(other) or other._has(self)

    def _has(self, part: Name) -> bool:
        # "mBR0 (1)" and "mBR0_48k" contain "mBR0".
        return len(part.text) >= _MIN_PART and part.row in self.row


@dataclass(frozen=True)
class ProposedRow:
    """A row of a proposed manifest, the columns that are guesses, how each was found, lengths in seconds."""

    id: str
    motion: str
    audio: str = ""
    fps: str = ""
    up: str = ""
    unit: str = ""
    guessed: tuple[str, ...] = ()
    evidence: tuple[str, ...] = ()
    motion_s: float | None = None
    audio_s: float | None = None

    @property
    def cells(self) -> dict[str, str]:
        """The row as the manifest has it, by column."""
        cells = asdict(self) | {"guessed": " ".join(self.guessed), "evidence": "; ".join(self.evidence)}
        return {name: str(csv_cell(value)) for name, value in cells.items() if name not in ("motion_s", "audio_s")}

    def with_guess(self, column: str, value: str, why: str) -> ProposedRow:
        """Return the row with a guess."""
        stated: dict[str, Any] = {column: value, "guessed": (*self.guessed, column)}
        return replace(self, **stated).told(f"{column}: {why}")

    def told(self, why: str) -> ProposedRow:
        """Return the row with a further sentence of evidence."""
        return replace(self, evidence=(*self.evidence, why))


@dataclass(frozen=True)
class Proposal:
    """A proposed manifest: a row per clip, music that no clip has, and files without motion."""

    rows: tuple[ProposedRow, ...]
    unused: tuple[str, ...] = field(default=())
    others: tuple[str, ...] = field(default=())

    @property
    def comments(self) -> list[str]:
        """The lines above the columns of the manifest."""
        unused = [f"# Music that no motion has: {listed(self.unused)}"] if self.unused else []
        without = [f"# Files without motion: {listed(self.others)}"] if self.others else []
        return [_HEAD, *unused, *without]


def propose(source: Path) -> Proposal:
    """Propose a manifest; reads every motion file, and the lengths of music. SourceError without motion."""
    source = Path(source)
    require_folder("folder", source, "motion files and music")
    motions, songs = _files(source, MOTION_SUFFIXES), _files(source, AUDIO_SUFFIXES)
    if not motions:
        raise SourceError("folder: no motion found", where=str(source), allowed=", ".join(MOTION_SUFFIXES))
    lengths = {song: _seconds(song) for song in songs}
    without = [path for path in motions if _has_no_motion(path)]
    motions = [path for path in motions if path not in without] or motions
    ids = _ids(motions, source)
    rows = _as_others_stand([_paired(path, ids[path], source, lengths) for path in motions], source)
    rows = _by_length(rows, source, lengths)
    used = {row.audio for row in rows}
    unused = tuple(name for song in songs if (name := relative(song, source)) not in used)
    others = tuple(relative(path, source) for path in without if path not in motions)
    return Proposal(tuple(rows), unused, others)


def _files(source: Path, suffixes: Sequence[str]) -> list[Path]:
    paths = (path for path in source.rglob("*") if path.suffix.lower() in suffixes)
    return sorted(p for p in paths if p.is_file() and not any(n.startswith(".") for n in p.relative_to(source).parts))


def _seconds(song: Path) -> float | None:
    from dancedata.kernel import audio_length

    try:
        samples, rate = audio_length(song)
    except DataError:
        return None
    return samples / rate


def _has_no_motion(path: Path) -> bool:
    """Whether a file has arrays, and none of them can be the rotations or positions of a body over time."""
    if path.suffix.lower() == ".bvh":
        return False
    try:
        with open_person(path, None) as arrays:
            return not any(_may_be_poses(arrays, name) for name in arrays.names)
    except DataError:
        return False


def _may_be_poses(arrays: ArrayFile, name: str) -> bool:
    try:
        first, *rest = arrays.shape(name) or (0,)
    except DataError:
        return False  # not numbers
    return first > 1 and bool(rest) and int(np.prod(rest)) >= _LEAST_COLUMNS


def _ids(motions: Sequence[Path], source: Path) -> dict[Path, str]:
    """Return an id for each file: its name, or its path where names are equal; without points, as tar files need."""
    stems = Counter(stem_of(path) for path in motions)
    paths = Counter(path.with_suffix("") for path in motions)
    ids = {}
    for path in motions:
        name = stem_of(path)
        if stems[name] > 1 or id_problem(name) is not None:
            whole = path if paths[path.with_suffix("")] > 1 else path.with_suffix("")
            name = unicodedata.normalize("NFC", relative(whole, source))
        ids[path] = re.sub(r"[^\w+ -]+", "_", name) if "." in name or "/" in name else name
    twice = Counter(ids.values())
    return {
        path: re.sub(r"[^\w+-]+", "_", relative(path, source)) if twice[name] > 1 else name
        for path, name in ids.items()
    }


def _paired(path: Path, name: str, source: Path, lengths: dict[Path, float | None]) -> ProposedRow:
    """Return the row of a motion file, with its music: of the nearest folder, then by name, then by length."""
    row = ProposedRow(name, relative(path, source))
    songs, word = _songs_of(path, lengths)
    row = _measured(path, row, lengths[songs[0]] if len(songs) == 1 else None)
    if not songs:
        return row
    song = min(songs, key=lambda s: _difference(row.motion_s, lengths[s])) if len(songs) > 1 else songs[0]
    shown_name, seconds = relative(song, source), lengths[song]
    similar = stem_of(song) != stem_of(path)
    if similar and len(songs) > 1:
        near = listed([relative(n, source) for n in songs])
        return _side_by_side(row.told(f"audio: several similar names, {near}"), None)
    if len(songs) > 1:
        row = row.with_guess("audio", shown_name, f"one of {listed([relative(s, source) for s in songs])}")
    elif similar:
        why = f"{word!r} is in both names, and in no other song's" if word else "similar name, the only one"
        row = row.with_guess("audio", shown_name, why)
    elif _difference(row.motion_s, seconds) > _SAME_S and seconds is not None and row.motion_s is not None:
        row = row.with_guess("audio", shown_name, "equal name, but another length")
    else:
        row = replace(row, audio=shown_name).told("audio: equal name")
    return _side_by_side(row, seconds)


def _songs_of(path: Path, lengths: Iterable[Path]) -> tuple[list[Path], str]:
    """Return songs that may be a motion's: the nearest of equal or similar name, or with a common word, and it."""
    stem, name = stem_of(path), Name.of(path.stem)
    equal = [song for song in lengths if stem_of(song) == stem]
    near = [song for song in lengths if song not in equal and Name.of(song.stem).near(name)]
    nearest = min((_steps(path, song) for song in (*equal, *near)), default=0)
    for alike in (equal, near):
        songs = [song for song in alike if _steps(path, song) == nearest]
        if songs:
            by_file: dict[Path, list[Path]] = {}
            for song in songs:
                by_file.setdefault(song.with_suffix(""), []).append(song)
            return [best_audio(of_one)[0] for of_one in by_file.values()], ""
    word, named = _by_word(path, lengths)
    return ([named] if named else []), word


def _steps(path: Path, song: Path) -> int:
    folders = path.parent, song.parent
    return sum(len(folder.relative_to(os.path.commonpath(folders)).parts) for folder in folders)


def _difference(one: float | None, other: float | None) -> float:
    return np.inf if one is None or other is None else abs(one - other)


def _as_others_stand(rows: list[ProposedRow], source: Path) -> list[ProposedRow]:
    """Guess the up axis of short files, as that of the others of their format."""
    files = []
    for row in rows:
        path = source / row.motion
        reading = Reading(Declared(), Declared(fps=row.fps or None, up="y", unit=row.unit or None))
        try:
            up = describe(path, reading)[2].up
        except DataError:
            continue
        files.append((ClipRef(row.id, path, None, "train"), reading, up, path.suffix.lower()))
    axis = {}
    for reject in judge_up(files):
        match = _ASKED.search(reject.detail)
        axis[reject.clip] = match[2] if match else ""
    return [
        row.with_guess("up", axis[row.id], "along it other files of this format stand")
        if axis.get(row.id) in UPRIGHT and not row.up
        else row
        for row in rows
    ]


def _by_word(path: Path, songs: Iterable[Path]) -> tuple[str, Path | None]:
    """Return the word that a motion's name shares with one song alone, and the song; None if there is no such one."""
    words = {song: set(_WORD.findall(song.stem.casefold())) for song in songs}
    n_songs = Counter(word for of_song in words.values() for word in of_song)
    unique = {word for word in _WORD.findall(path.stem.casefold()) if n_songs[word] == 1}
    shared = {song: sorted(unique & of_song) for song, of_song in words.items() if unique & of_song}
    if len(shared) != 1:
        return "", None
    ((song, common),) = shared.items()
    return max(common, key=len), song


def _side_by_side(row: ProposedRow, audio_s: float | None) -> ProposedRow:
    if audio_s is None or row.motion_s is None:
        return replace(row, audio_s=audio_s)
    lengths = f"motion {row.motion_s:.2f} s, music {audio_s:.2f} s"
    return replace(row, audio_s=audio_s).told(lengths)


def _by_length(rows: list[ProposedRow], source: Path, lengths: dict[Path, float | None]) -> list[ProposedRow]:
    """Pair motions without music of their name with unused songs, each the other's only one of its length."""
    used = {row.audio for row in rows}
    free = {relative(s, source): n for s, n in lengths.items() if n is not None and relative(s, source) not in used}
    alone = [row for row in rows if not row.audio and row.motion_s is not None and "fps" not in row.guessed]
    fits = {
        row.id: [s for s, n in free.items() if row.motion_s is not None and abs(n - row.motion_s) <= _SAME_S]
        for row in alone
    }
    n_motions = Counter(song for songs in fits.values() for song in songs)
    paired = []
    for row in rows:
        songs = fits.get(row.id, [])
        if len(songs) == 1 and n_motions[songs[0]] == 1:
            row = row.with_guess("audio", songs[0], "the only music of this length, of another name")
            row = _side_by_side(row, free[songs[0]])
        elif not row.audio:
            row = row.told(f"audio: {'several of this length' if songs else 'no music of its name or length'}")
        paired.append(row)
    return paired


def _measured(path: Path, row: ProposedRow, audio_s: float | None) -> ProposedRow:
    """Read a motion file, and guess what it does not state until it can be read."""
    guess: dict[str, str] = {}
    for _ in range(8):
        try:
            motion = load_motion(path, Reading(Declared(), Declared(**guess)))
        except DataError as error:
            match = _ASKED.search(error.fix or "")
            key, value = match.groups() if match else ("", "")
            fps = "60" if "smpl_scaling" in str(error.found) else "30"  # AIST++'s arrays, else usual
            usual = {"fps": fps, "up": "y", "unit": GUESS if path.suffix.lower() == ".bvh" else "m"}
            if not key or (key in guess and value not in UPRIGHT) or guess.get(key) == value:
                return row.told(f"the motion cannot be read: {error.reason}: {shown(error.problem, 200)}")
            guess[key] = value if value in UPRIGHT else usual[key]
            continue
        seconds, rate = motion.n_frames / float(motion.grid.rate), str(motion.grid)
        if "fps" in guess:
            fitting = [r for r in _RATES if audio_s is not None and abs(motion.n_frames / r - audio_s) <= _SAME_S]
            kind = " for AIST++'s arrays, by smpl_scaling" if guess["fps"] == "60" else ""
            usual_rate = f"nothing states it; {guess['fps']} is usual{kind}"
            why = "its length is then the music's" if fitting else usual_rate
            rate = str(fitting[0]) if fitting else guess["fps"]
            row, seconds = row.with_guess("fps", rate, why), motion.n_frames / float(rate)
        if "unit" in guess:
            row = _unit(path, row, guess)
        if "up" in guess:
            row = row.with_guess("up", guess["up"], "along it the body stands")
        return replace(row, motion_s=seconds).told(f"{counted(motion.n_frames, 'frame')} at {rate} FPS")
    return row.told("the motion cannot be read")


def _unit(path: Path, row: ProposedRow, guess: dict[str, str]) -> ProposedRow:
    if guess["unit"] != GUESS:
        return row.with_guess("unit", guess["unit"], "nothing states it; metres are usual")
    facts, _ = bvh_facts(read_bvh_header(path), Reading(Declared(), Declared(**guess)))
    why = facts.unit.where.partition(": ")[2]
    return row.with_guess("unit", facts.unit.value or f"{facts.metres:.6g}", why)
