"""dancedata init: a folder of captures with the manifest and the recipe that a build needs."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from dancedata.core.errors import StoreError, UsageError
from dancedata.core.tables import csv_cell
from dancedata.core.text import counted, listed, shown
from dancedata.datasets.folder.propose import propose
from dancedata.files.atomic import write_text
from dancedata.files.regular_file import read_regular

MANIFEST, RECIPE = "manifest.csv", "recipe.yaml"
#: Columns that a second run fills where they are empty; the others of a row are the user's.
_FILLED = ("audio", "fps", "up", "unit", "audio_start_s")
_MAX_BYTES = 1 << 24
#: Songs, and clips, below which splits by them would leave one empty.
_FEW = 3
_RECIPE = """# Built by: dancedata build {folder}
recipe: 1
name: {name}
dataset: {{folder: {{{split}}}}}
windows: {{length_s: 5, stride_s: 0.5}}
motion: {{edge151: {{}}}}
audio: {{librosa35: {{}}}}
"""


@dataclass(frozen=True)
class Prepared:
    """A folder that is ready for `build`, or whose manifest has rows to look at: counts, names of clips and songs."""

    manifest: Path
    recipe: Path
    clips: int
    added: int
    filled: int
    guessed: tuple[str, ...]
    without_music: tuple[str, ...]
    unused: tuple[str, ...]
    offsets: str = ""

    @property
    def warnings(self) -> list[str]:
        """What to look at before a build."""
        sentences = []
        if self.guessed:
            sentences.append(
                f"{counted(len(self.guessed), 'row')} with guesses ({listed(self.guessed, 3)}): check them in "
                f"{self.manifest}, and empty their column guessed"
            )
        if self.without_music:
            without = f"{counted(len(self.without_music), 'dance')} without a song ({listed(self.without_music, 3)})"
            sentences.append(f"{without}: fill in their column audio, or they are left out")
        if self.unused:
            sentences.append(f"{counted(len(self.unused), 'song')} that no dance has: {listed(self.unused, 3)}")
        return sentences

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {name: str(value) if isinstance(value, Path) else value for name, value in asdict(self).items()}

    def __str__(self) -> str:
        added = f", {self.added} of them new, {counted(self.filled, 'cell')} filled in"
        lines = [f"{shown(self.manifest)}: {counted(self.clips, 'dance')}{added}", shown(self.recipe)]
        lines += [self.offsets] if self.offsets else []
        next_step = "the warnings above first; then " if self.warnings else ""
        lines += [f"warning: {warning}" for warning in self.warnings]
        return "\n".join([*lines, f"next: {next_step}dancedata build {shown(self.recipe.parent)}"])


def prepare(folder: str | Path, out: str | Path | None = None) -> Prepared:
    """Write manifest.csv and recipe.yaml of a folder; of a manifest that is there, only empty cells are filled."""
    source = Path(folder).expanduser()
    target = source if out is None else Path(out).expanduser()
    proposal = propose(source)
    path, recipe = target / MANIFEST, target / RECIPE
    table = _Table.of(path)
    rows = table.rows
    known = {row.get("motion", "") for row in rows}
    filled = sum(_fill(row, new.cells) for row in rows for new in proposal.rows if new.motion == row.get("motion"))
    new = [row.cells for row in proposal.rows if row.motion not in known]
    rows += new
    songs = {row.get("audio") for row in rows} - {"", None}
    if not recipe.exists():
        name = re.sub(r"[^A-Za-z0-9_.+-]+", "-", source.absolute().name).strip("-.+") or "mine"
        by = "music" if len(songs) >= _FEW else "clip"
        split = f"split: {{val: 0.2, test: 0.2, by: {by}, balance: true}}" if len(rows) >= _FEW else "split: train"
        _write(recipe, _RECIPE.format(folder=shown(str(folder)), name=name, split=split))
    if filled or new:
        _write(path, table.text(() if known else proposal.comments))
    return Prepared(
        path, recipe, len(rows), len(new), filled, tuple(row["id"] for row in rows if row.get("guessed")),
        tuple(row["id"] for row in rows if not row.get("audio")),
        tuple(song for song in proposal.unused if song not in songs),
    )  # fmt: skip


def fill_starts(prepared: Prepared, starts: Mapping[str, object], about: str) -> Prepared:
    """Fill the empty cells of audio_start_s of a manifest, by the id of a clip; `about` says how they were found."""
    table = _Table.of(prepared.manifest)
    rows = [row for row in table.rows if row.get("id") in starts]
    filled = sum(_fill(row, {"audio_start_s": str(csv_cell(str(starts[row["id"]])))}) for row in rows)
    if filled:
        _write(prepared.manifest, table.text(()))
    return replace(prepared, filled=prepared.filled + filled, offsets=about)


@dataclass(frozen=True)
class _Table:
    """A manifest as it is written: its comments, what separates its columns, and its cells, unread."""

    comments: list[str]
    separator: str
    rows: list[dict[str, str]]

    @classmethod
    def of(cls, path: Path) -> _Table:
        """Read a manifest; an empty table if there is none."""
        if path.with_suffix(".jsonl").exists():
            raise UsageError("the folder has a manifest", where=path.with_suffix(".jsonl"),
                             fix="edit it, or remove it and call this again")  # fmt: skip
        if not path.exists():
            return cls([], ",", [])
        lines = read_regular(path, _MAX_BYTES).decode("utf-8-sig").splitlines(keepends=True)
        comments = [line for line in lines if line.lstrip('"').startswith("#")]
        table = [line for line in lines if line not in comments]
        separator = max(",;\t", key="".join(table[:1]).count)
        rows = [dict(row) for row in csv.DictReader(table, delimiter=separator)]
        if any(None in row for row in rows):
            raise UsageError(
                "a row has more cells than the heading", where=path, fix="correct it, and call this again"
            )
        return cls([line.rstrip("\r\n") for line in comments], separator, rows)

    def text(self, comments: Sequence[str]) -> str:
        """Return the text of the file, with further `comments`."""
        names = list(dict.fromkeys(name for row in self.rows for name in row))
        cells = [[row.get(name) or "" for name in names] for row in self.rows]
        text = io.StringIO()
        writer = csv.writer(text, delimiter=self.separator, lineterminator="\n")
        writer.writerows([*([comment] for comment in comments), names, *cells])
        return "".join(f"{line}\n" for line in self.comments) + text.getvalue()


def _fill(row: dict[str, str], cells: Mapping[str, str]) -> int:
    """Fill empty cells of a row, and say which of them are guesses; return their number."""
    empty = [name for name in _FILLED if not row.get(name) and cells.get(name)]
    row.update({name: cells[name] for name in empty})
    if guesses := [name for name in empty if name in cells.get("guessed", "").split()]:
        row["guessed"] = " ".join(dict.fromkeys([*(row.get("guessed") or "").split(), *guesses]))
        row["evidence"] = cells.get("evidence", "")
    return len(empty)


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, text)
    except OSError as error:
        raise StoreError("the file cannot be written", where=path, found=str(error),
                         fix="choose another folder: --out DIR") from error  # fmt: skip
