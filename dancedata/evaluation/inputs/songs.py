"""Names of the songs of clips, and the sources of their beats."""

import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dancedata.core.errors import UsageError
from dancedata.core.text import csv_text, listed, quoted
from dancedata.datasets.files import AUDIO_SUFFIXES, best_audio, group_by_stem
from dancedata.datasets.folder import MUSIC_FOLDERS
from dancedata.store import Store

_MAX_CSV_BYTES = 1 << 24


@dataclass(frozen=True, eq=False)
class MusicSources:
    """Sources of beats; for each clip the first one that has them counts.

    Attributes
    ----------
    beats
        Beats of the caller by the id of a clip: `MusicBeats`, or frames at the protocol's rate.
    files
        Music files, by song.
    like
        Dataset that has them where the dataset of a clip does not.
    songs
        Songs that the caller names, by the id of a clip.
    """

    beats: Mapping[str, Any] = field(default_factory=dict)
    files: Mapping[str, Path] = field(default_factory=dict)
    like: Store | None = None
    songs: Mapping[str, str] = field(default_factory=dict)


def song_files(folder: Path) -> dict[str, Path]:
    """Return the music of a folder, or of its folder of music, by name without suffix; UsageError for none."""
    for place in (folder, *(folder / name for name in MUSIC_FOLDERS)):
        by_stem = group_by_stem([place], AUDIO_SUFFIXES) if place.is_dir() else []
        if by_stem:
            return {stem: best_audio(paths)[0] for stem, paths in by_stem}
    raise UsageError(
        "no music in the folder", where=folder,
        allowed=f"files {', '.join(AUDIO_SUFFIXES)}, here or in {listed(f'{name}/' for name in MUSIC_FOLDERS)}",
    )  # fmt: skip


def song_name(text: str) -> str:
    """Return the name of a song: that of a music file without folder and suffix, any other text as it is."""
    path = Path(text.strip())
    return path.stem if path.suffix.lower() in AUDIO_SUFFIXES else path.name


def read_songs(path: Path) -> dict[str, str]:
    """Read clip and song from a CSV file with these two columns; a heading "clip,song" may come first.

    Columns are separated by commas, semicolons or tabulators, whichever make two of the first line.

    UsageError if it cannot be read, a line has another number of columns or no song, or two lines have one clip.
    """
    try:
        if path.stat().st_size > _MAX_CSV_BYTES:
            raise UsageError("the list of songs is too large", where=path, allowed=f"{_MAX_CSV_BYTES:,} bytes")
        text = path.read_bytes().decode("utf-8-sig")
        head = text.lstrip().partition("\n")[0]
        between = next((c for c in ",;\t" if len(next(csv.reader([head], delimiter=c), [])) == 2), ",")
        lines = list(csv.reader(io.StringIO(text, newline=""), delimiter=between))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise UsageError("the list of songs cannot be read", where=path, found=str(error)) from error
    songs: dict[str, str] = {}
    for number, line in enumerate(lines, start=1):
        if not line or (number == 1 and [cell.strip().lower() for cell in line] == ["clip", "song"]):
            continue
        where = f"{path}, line {number}"
        if len(line) != 2:
            raise UsageError("a line does not have two columns", where=where, found=len(line), allowed="clip,song")
        clip, song = csv_text(line[0].strip()), song_name(csv_text(line[1].strip()))
        if not song:
            raise UsageError("a line without a song", where=where, found=quoted(line[1]), allowed="clip,song")
        if songs.setdefault(clip, song) != song:
            raise UsageError("a clip has two songs", where=where, found=listed([songs[clip], song]), fix="delete one")
    return songs
