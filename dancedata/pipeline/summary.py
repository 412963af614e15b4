"""The summary at the end of a build: what was built, what was left out and why, what to do next."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dancedata.audio.networks.feature import NetworkFeature
from dancedata.core.clip import Reject, Scan
from dancedata.core.quality import OF_CLIPS
from dancedata.core.text import counted, shown, size_text
from dancedata.pipeline.clips import ComputedClips
from dancedata.pipeline.rejects import describe_implausible, left_out_lines
from dancedata.recipes.recipe import Recipe
from dancedata.store import Store, StoredClip, open_store
from dancedata.store.schema import sort_splits

_FIRST_LOOK = """## How to read it

```python
import dancedata

ds = dancedata.open("PATH OF THIS FOLDER")
window = ds.windows("{split}")[0]
ds.read(window, "{field}").shape
```

It is plain HDF5: any tool that reads HDF5 reads it.
"""


def dataset_card(recipe: Recipe, scan: Scan, computed: ComputedClips, songs: Mapping[str, str]) -> str:
    """Return the card's Markdown: what the dataset holds, where from, under which terms, what was left out.

    Parameters
    ----------
    songs
        Song of each clip, by the clip's id.
    """
    splits = sort_splits({c.split for c in computed.clips})
    parts = [
        f"# {recipe.name}\n\n{recipe.description or 'Built by dancedata.'}\n",
        _splits_table(recipe, computed.clips, splits, songs),
        _fields_list(recipe),
        _FIRST_LOOK.format(split=splits[0], field=recipe.motion[0].name),
        _source(recipe, scan),
        _card_left_out(computed),
    ]
    return "\n".join(parts)


def _splits_table(
    recipe: Recipe, clips: Sequence[StoredClip], splits: Sequence[str], songs: Mapping[str, str]
) -> str:
    rows = ["| split | clips | windows | songs | minutes |", "|---|---|---|---|---|"]
    for split in splits:
        of_split = [c for c in clips if c.split == split]
        minutes = float(recipe.grid.seconds(sum(c.n_frames for c in of_split)) / 60)
        n_songs = len({songs[c.id] for c in of_split if c.id in songs})
        rows.append(
            f"| {split} | {len(of_split)} | {sum(len(c.starts) for c in of_split)} | {n_songs} | {minutes:.1f} |"
        )
    length_s, stride_s = recipe.windows.length_s, recipe.windows.stride_s
    windows = f"Windows of {length_s:g} s every {stride_s:g} s"
    text = f"{windows} at {recipe.grid} frames per second, scope: {recipe.scope}."
    return "\n".join(["## Splits", "", *rows, "", text, ""])


def _fields_list(recipe: Recipe) -> str:
    lines = ["## Fields", ""]
    for motion_field in recipe.motion:
        rule = f", contacts by {motion_field.contacts.name}" if motion_field.contacts is not None else ""
        lines.append(
            f"- `{motion_field.name}`: {motion_field.columns.width} columns, {motion_field.representation.axes}{rule}"
        )
    for finder in recipe.keymotion:
        lines.append(f"- `{finder.name}`: key motions, {', '.join(finder.columns.labels)}")
    for job in recipe.audio:
        network = job.feature.about if isinstance(job.feature, NetworkFeature) else {}
        origin = (
            f", by {network['model']}, licence of its weights: {network['licence']}" if "licence" in network else ""
        )
        lines.append(f"- `{job.name}`: {job.columns.width} columns{origin}")
    return "\n".join([*lines, ""])


def _source(recipe: Recipe, scan: Scan) -> str:
    notes = "\n".join(f"- {note}" for note in scan.notes)
    return (
        f"## Source\n\nDataset `{recipe.dataset.name}`, layout {scan.layout}.\n\n{notes}\n\n"
        f"Licence: {recipe.dataset.licence}\n\nCite: {recipe.dataset.citation}\n"
    )


def _card_left_out(computed: ComputedClips) -> str:
    counts = Counter(r.reason for r in computed.rejects)
    lines = [f"- {reason}: {n}" for reason, n in sorted(counts.items())] or ["- nothing"]
    flags = f"{len(computed.quality)} quality flags in quality.jsonl; what they point at was not repaired."
    return "\n".join(["## Left out (rejects.jsonl)", "", *lines, "", flags, ""])


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
    return f"next: dancedata check {folder}; details: dancedata info {folder}"


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
    kinds = ", ".join(f"{kind} in {counted(len(of_kind), 'clip')}" for kind, of_kind in sorted(clips.items()))
    return [f"  flagged, not repaired (quality.jsonl): {kinds}"]
