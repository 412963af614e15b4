"""The summary at the end of a build: what was built, what was left out and why, what to do next."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dancedata.core.clip import Reject
from dancedata.core.quality import OF_CLIPS
from dancedata.core.text import counted, shown, size_text
from dancedata.pipeline.implausible import describe_implausible
from dancedata.pipeline.left_out import left_out_lines
from dancedata.store import Store, open_store


@dataclass(frozen=True)
class BuildResult:
    """What a build did, as dataset.json has it.

    Attributes
    ----------
    path
        Folder of the dataset.
    built
        False if the dataset was there already and nothing had to be done.
    counts
        Per split the numbers of clips, windows and songs, and the hours of motion.
    left_out
        How many files, clips and windows were left out, by reason; rejects.jsonl lists each.
    notes
        What the dataset's reader found in the source.
    summary
        The text that the command line prints.
    """

    path: Path
    built: bool
    counts: Mapping[str, Mapping[str, Any]]
    left_out: Mapping[str, int]
    notes: tuple[str, ...]
    summary: str

    @classmethod
    def of(cls, path: Path, built: bool) -> BuildResult:
        """Describe a finished dataset."""
        with open_store(path) as store:
            counts, left_out = dict(store.meta["counts"]), dict(store.meta["rejects"])
            notes = tuple(store.meta.get("source", {}).get("notes", ()))
        summary = describe_built(path) if built else describe_unchanged(path)
        return cls(path, built, counts, left_out, notes, summary)

    def __repr__(self) -> str:
        """Show where the dataset is and how large; `summary` has the rest."""
        clips, windows = (sum(n[key] for n in self.counts.values()) for key in ("clips", "windows"))
        size = f"{counted(clips, 'clip')}, {counted(windows, 'window')}, {sum(self.left_out.values()):,} left out"
        return f"BuildResult({str(self.path)!r}, {size}, built={self.built})"

    def open(self) -> Store:
        """Open the dataset, as `dancedata.open` does."""
        return open_store(self.path)


def describe_built(path: Path) -> str:
    """Return what `build` prints of the dataset that it made."""
    with open_store(path) as store:
        name = shown(store.meta.get("name", path.name))
        lines = [
            f"{name}: {_size(store)} in {shown(path)} ({size_text(_bytes(store))})",
            f"  {'; '.join(_split(split, n) for split, n in store.meta['counts'].items())}",
            f"  {_windows(store)}; {_fields(store)}",
            *_left_out([Reject.from_json(row) for row in store.rejects]),
            *describe_implausible(store.quality),
            *_flagged([flag for flag in store.quality if flag["kind"] not in OF_CLIPS]),
        ]
    return "\n".join([*lines, next_steps(path)])


def describe_unchanged(path: Path) -> str:
    """Return what `build` prints if the dataset was there already: two lines."""
    with open_store(path) as store:
        text = (
            f"nothing to do: {shown(path)} is this dataset already, from the same recipe and source ({_size(store)})"
        )
    return f"{text}\n{next_steps(path)}"


def next_steps(path: Path) -> str:
    """Return the commands that come after a build."""
    folder = shlex.quote(shown(path))
    return f"next: dancedata check {folder}; all about it: dancedata info {folder}"


def _size(store: Store) -> str:
    clips, windows = (sum(n[key] for n in store.meta["counts"].values()) for key in ("clips", "windows"))
    return f"{counted(clips, 'clip')}, {counted(windows, 'window')}"


def _bytes(store: Store) -> int:
    return sum(int(shard["size"]) for shard in store.meta["shards"])


def _split(split: str, n: Mapping[str, Any]) -> str:
    return f"{shown(split)} {counted(n['clips'], 'clip')}, {counted(n['windows'], 'window')}"


def _windows(store: Store) -> str:
    windows = store.meta["windows"]
    return f"windows of {windows['length']} frames every {windows['stride']} at {store.fps} per second"


def _fields(store: Store) -> str:
    return ", ".join(f"{name} ({counted(columns.width, 'column')})" for name, columns in store.fields.items())


def _left_out(rejects: Sequence[Reject]) -> list[str]:
    if not rejects:
        return ["  nothing was left out"]
    return ["  left out (rejects.jsonl):", *(f"    {line}" for line in left_out_lines(rejects))]


def _flagged(flags: Sequence[Mapping[str, Any]]) -> list[str]:
    """Say how many clips have flags of each kind."""
    clips: dict[str, set[str]] = {}
    for flag in flags:
        clips.setdefault(str(flag["kind"]), set()).add(str(flag["clip"]))
    if not clips:
        return []
    kinds = ", ".join(f"{kind} in {counted(len(own), 'clip')}" for kind, own in sorted(clips.items()))
    return [f"  flagged, not repaired (quality.jsonl): {kinds}"]
