"""The dataset card: README.md of a built dataset."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from dancedata.pipeline.gathered import Gathered
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


def dataset_card(recipe: Recipe, gathered: Gathered, clips: Sequence[StoredClip]) -> str:
    """Return the card's Markdown: what the dataset holds, where from, under which terms, what was left out."""
    splits = sort_splits({c.split for c in clips})
    parts = [
        f"# {recipe.name}\n\n{recipe.description or 'Built by dancedata.'}\n",
        _splits_table(recipe, clips, splits),
        _fields_list(recipe),
        _FIRST_LOOK.format(split=splits[0], field=recipe.motion[0].name),
        _source(recipe, gathered),
        _left_out(gathered),
    ]
    return "\n".join(parts)


def _splits_table(recipe: Recipe, clips: Sequence[StoredClip], splits: Sequence[str]) -> str:
    rows = ["| split | clips | windows | songs | minutes |", "|---|---|---|---|---|"]
    for split in splits:
        mine = [c for c in clips if c.split == split]
        minutes = float(sum(c.n_frames for c in mine) / recipe.fps / 60)
        songs = len({c.music for c in mine})
        rows.append(f"| {split} | {len(mine)} | {sum(len(c.starts) for c in mine)} | {songs} | {minutes:.1f} |")
    length, stride = (float(n / recipe.fps) for n in (recipe.windows.length, recipe.windows.stride))
    about = f"Windows of {length:g} s every {stride:g} s at {recipe.grid} frames a second, scope: {recipe.scope}."
    return "\n".join(["## Splits", "", *rows, "", about, ""])


def _fields_list(recipe: Recipe) -> str:
    lines = ["## Fields", ""]
    for slot in recipe.motion:
        rule = f", contacts by {slot.contacts.name}" if slot.contacts is not None else ""
        lines.append(
            f"- `{slot.name}`: {slot.representation.columns.width} columns, {slot.representation.axes}{rule}"
        )
    for plugin in recipe.keymotion:
        lines.append(f"- `{plugin.name}`: key motions, {', '.join(plugin.columns.labels)}")
    lines += [f"- `{feature.name}`: {feature.columns.width} columns" for feature in recipe.audio]
    return "\n".join([*lines, ""])


def _source(recipe: Recipe, gathered: Gathered) -> str:
    notes = "\n".join(f"- {note}" for note in gathered.scan.notes)
    return (
        f"## Source\n\nDataset `{recipe.dataset.name}`, layout {gathered.scan.layout}.\n\n{notes}\n\n"
        f"Licence: {recipe.dataset.licence}\n\nCite: {recipe.dataset.citation}\n"
    )


def _left_out(gathered: Gathered) -> str:
    counts = Counter(r.reason for r in gathered.rejects)
    lines = [f"- {reason}: {n}" for reason, n in sorted(counts.items())] or ["- nothing"]
    flags = f"{len(gathered.quality)} quality flags in quality.jsonl; what they point at was not repaired."
    return "\n".join(["## Left out (rejects.jsonl)", "", *lines, "", flags, ""])
