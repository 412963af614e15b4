"""The dataset card: README.md of a built dataset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from dancedata.audio.networks.feature import NetworkFeature
from dancedata.core.clip import Scan
from dancedata.pipeline.clips import ComputedClips
from dancedata.recipes.recipe import Recipe
from dancedata.store import StoredClip
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


def dataset_card(recipe: Recipe, scan: Scan, found: ComputedClips, songs: Mapping[str, str]) -> str:
    """Return the card's Markdown: what the dataset holds, where from, under which terms, what was left out.

    Parameters
    ----------
    songs
        Song of each clip, by the clip's id.
    """
    splits = sort_splits({c.split for c in found.clips})
    parts = [
        f"# {recipe.name}\n\n{recipe.description or 'Built by dancedata.'}\n",
        _splits_table(recipe, found.clips, splits, songs),
        _fields_list(recipe),
        _FIRST_LOOK.format(split=splits[0], field=recipe.motion[0].name),
        _source(recipe, scan),
        _left_out(found),
    ]
    return "\n".join(parts)


def _splits_table(
    recipe: Recipe, clips: Sequence[StoredClip], splits: Sequence[str], songs: Mapping[str, str]
) -> str:
    rows = ["| split | clips | windows | songs | minutes |", "|---|---|---|---|---|"]
    for split in splits:
        mine = [c for c in clips if c.split == split]
        minutes = float(recipe.grid.seconds(sum(c.n_frames for c in mine)) / 60)
        n_songs = len({songs[c.id] for c in mine if c.id in songs})
        rows.append(f"| {split} | {len(mine)} | {sum(len(c.starts) for c in mine)} | {n_songs} | {minutes:.1f} |")
    length_s, stride_s = recipe.windows.length_s, recipe.windows.stride_s
    windows = f"Windows of {length_s:g} s every {stride_s:g} s"
    about = f"{windows} at {recipe.grid} frames per second, scope: {recipe.scope}."
    return "\n".join(["## Splits", "", *rows, "", about, ""])


def _fields_list(recipe: Recipe) -> str:
    lines = ["## Fields", ""]
    for own in recipe.motion:
        rule = f", contacts by {own.contacts.name}" if own.contacts is not None else ""
        lines.append(f"- `{own.name}`: {own.columns.width} columns, {own.representation.axes}{rule}")
    for finder in recipe.keymotion:
        lines.append(f"- `{finder.name}`: key motions, {', '.join(finder.columns.labels)}")
    for job in recipe.audio:
        about = job.feature.about if isinstance(job.feature, NetworkFeature) else {}
        made = f", by {about['model']}, licence of its weights: {about['licence']}" if "licence" in about else ""
        lines.append(f"- `{job.name}`: {job.columns.width} columns{made}")
    return "\n".join([*lines, ""])


def _source(recipe: Recipe, scan: Scan) -> str:
    notes = "\n".join(f"- {note}" for note in scan.notes)
    return (
        f"## Source\n\nDataset `{recipe.dataset.name}`, layout {scan.layout}.\n\n{notes}\n\n"
        f"Licence: {recipe.dataset.licence}\n\nCite: {recipe.dataset.citation}\n"
    )


def _left_out(found: ComputedClips) -> str:
    counts = Counter(r.reason for r in found.rejects)
    lines = [f"- {reason}: {n}" for reason, n in sorted(counts.items())] or ["- nothing"]
    flags = f"{len(found.quality)} quality flags in quality.jsonl; what they point at was not repaired."
    return "\n".join(["## Left out (rejects.jsonl)", "", *lines, "", flags, ""])
