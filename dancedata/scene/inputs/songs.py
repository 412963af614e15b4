"""Names of the songs of clips, and the sources of their beats."""

import csv
import io
from collections import Counter
from collections.abc import Container, Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path, PurePosixPath
from typing import Any, Self, TypeAlias

from dancedata.core.audio_signal import AUDIO_SUFFIXES, MUSIC_FOLDERS
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import as_fraction
from dancedata.core.tables import csv_text
from dancedata.core.text import listed, quoted
from dancedata.files.listing import best_audio, group_by_stem
from dancedata.kernel import Store

_MAX_CSV_BYTES = 1 << 24
_HEADS = tuple([name, "song", "start_s"][:n] for name in ("sample", "clip") for n in (2, 3))
#: What a caller may name as music; see `MusicSources.of`.
MusicLike: TypeAlias = "str | Path | Mapping[str, Any] | None"


class Song(str):
    """The name of a clip's song."""

    __slots__ = ("start",)
    start: Fraction | None  # second of the song at the clip's first frame; None where it is not stated

    @classmethod
    def of(cls, name: str, start: Fraction | None = None) -> Self:
        """Return a song, from a second on."""
        song = cls(name)
        song.start = start
        return song


@dataclass(frozen=True, eq=False)
class MusicSources:
    """Sources of beats; for each clip the first one that has them counts."""

    # beats of the caller by the id of a clip: `MusicBeats`, or frames at the protocol's rate
    beats: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, Path] = field(default_factory=dict)  # music files, by song
    like: Store | None = None  # dataset that has them where the dataset of a clip does not
    # songs that the caller names, by the id of a clip; a `Song` may state where the clip begins in it
    songs: Mapping[str, str] = field(default_factory=dict)
    song: str = ""  # the song of all clips; "" for none

    @classmethod
    def of(cls, music: MusicLike, like: Store | None = None) -> Self:
        """Return the sources that a caller names."""
        if music is None:
            return cls(like=like)
        if isinstance(music, Mapping):
            songs = {clip: _song(value) for clip, value in music.items() if _names_song(value)}
            beats = {clip: value for clip, value in music.items() if clip not in songs}
            return cls(beats, _files_of(Path(), songs.values()), like, songs)
        path = Path(music).expanduser().absolute()
        if path.suffix.lower() in AUDIO_SUFFIXES and not path.is_dir():
            if not path.is_file():
                raise UsageError("there is no such music file", where=path)
            return cls(files={path.stem: path}, like=like, song=path.stem)
        if path.is_dir():
            return cls(files=song_files(path), like=like)
        named = read_songs(path)
        return cls(files=_files_of(path.parent, named.values()), like=like, songs=named)


def _names_song(value: Any) -> bool:
    return isinstance(value[0] if isinstance(value, tuple) and len(value) == 2 else value, str | Path)


def _song(value: Any) -> Song:
    name, start = value if isinstance(value, tuple) else (value, None)
    return Song.of(song_name(str(name)), None if start is None else as_fraction(start, "music"))


def _files_of(folder: Path, songs: Iterable[str]) -> dict[str, Path]:
    """Return the files of songs in a folder or its folder of music, by file name; by path where two have one name."""
    places = (*(folder / name for name in reversed(MUSIC_FOLDERS)), folder)
    files = {
        song: file
        for song in songs for place in places for suffix in reversed(AUDIO_SUFFIXES)
        if (file := place / f"{song}{suffix}").is_file()
    }  # fmt: skip
    n = Counter(Path(song).name for song in files)
    return {Path(song).name if n[Path(song).name] == 1 else song: file for song, file in files.items()}


def song_files(folder: Path) -> dict[str, Path]:
    """Return the music of a folder, of its folder of music, or else below it, by name; UsageError without any."""
    for place in (folder, *(folder / name for name in MUSIC_FOLDERS)):
        by_stem = group_by_stem([place], AUDIO_SUFFIXES) if place.is_dir() else []
        if by_stem:
            return {stem: best_audio(paths)[0] for stem, paths in by_stem}
    below: dict[PurePosixPath, list[Path]] = {}
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() in AUDIO_SUFFIXES and path.is_file():
            below.setdefault(PurePosixPath(path.relative_to(folder).with_suffix("").as_posix()), []).append(path)
    if below:
        n = Counter(song.name for song in below)
        return {song.name if n[song.name] == 1 else str(song): best_audio(below[song])[0] for song in below}
    raise UsageError(
        "no music in the folder", where=folder,
        allowed=f"files {', '.join(AUDIO_SUFFIXES)}, here or in {listed(f'{name}/' for name in MUSIC_FOLDERS)}",
    )  # fmt: skip


def song_name(text: str) -> str:
    """Return the name of a song: of a music file without suffix, any other text as it is; see `of_known`."""
    path = PurePosixPath(text.strip().replace("\\", "/"))
    return str(path.with_suffix("") if path.suffix.lower() in AUDIO_SUFFIXES else path) if path.name else ""


def of_known(songs: Mapping[str, str], known: Container[str]) -> dict[str, Song]:
    """Return songs by the names that are known: the longest end of the path that is one, else the file's name."""
    named = {}
    for clip, song in songs.items():
        parts = song.split("/")
        ends = ["/".join(parts[k:]) for k in range(len(parts))]
        named[clip] = Song.of(next((end for end in ends if end in known), parts[-1]), getattr(song, "start", None))
    return named


def read_songs(path: Path) -> dict[str, Song]:
    """Read sample, song and, where it is not 0, its second at the clip's first frame from the columns of a CSV file.

    A heading "sample,song" or "sample,song,start_s" may come first. Columns are separated by commas, semicolons or
    tabulators, whichever make two or three of the first line.

    DataError if it cannot be read; UsageError if a line has another number of columns or no song, or two lines have
    one clip.
    """
    try:
        if path.stat().st_size > _MAX_CSV_BYTES:
            raise UsageError("the list of songs is too large", where=path, allowed=f"{_MAX_CSV_BYTES:,} bytes")
        text = path.read_bytes().decode("utf-8-sig")
        head = next(iter(text.lstrip().splitlines()), "")
        between = next((c for c in ",;\t" if len(next(csv.reader([head], delimiter=c), [])) in (2, 3)), ",")
        lines = list(csv.reader(io.StringIO(text, newline=""), delimiter=between))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(
            "the list of songs cannot be read", reason="broken_file", where=path, found=str(error)
        ) from error
    songs: dict[str, Song] = {}
    for number, line in enumerate(lines, start=1):
        if not line or (number == 1 and [cell.strip().lower() for cell in line] in _HEADS):
            continue
        where = f"{path}, line {number}"
        if len(line) not in (2, 3):
            allowed = "sample,song or sample,song,start_s"
            raise UsageError("a line does not have two columns", where=where, found=len(line), allowed=allowed)
        clip, name = csv_text(line[0].strip()), song_name(csv_text(line[1].strip()))
        stated = line[2].strip() if len(line) == 3 else ""
        song = Song.of(name, as_fraction(stated, f"{where}: the third of its columns, start_s,") if stated else None)
        if not song:
            raise UsageError("a line without a song", where=where, found=quoted(line[1]), allowed="sample,song")
        if songs.setdefault(clip, song) != song or songs[clip].start != song.start:
            raise UsageError("a clip has two songs", where=where, found=listed([songs[clip], song]), fix="delete one")
    return songs
