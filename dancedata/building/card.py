"""The card of a dataset: README.md in its folder, from the recipe, the scan and what was computed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from dancedata.building.stored import BuiltClips
from dancedata.core.clip import Scan
from dancedata.core.licence import Licence
from dancedata.core.quality import REPAIRED
from dancedata.recipes.recipe import Recipe
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


def dataset_card(
    recipe: Recipe, scan: Scan, computed: BuiltClips, songs: Mapping[str, str], networks: Mapping[str, Any]
) -> str:
    """Return the card's Markdown; `songs` are by clip, statements of audio fields on their networks by field."""
    splits = sort_splits({c.split for c in computed.clips})
    notes = "\n".join(f"- {note}" for note in scan.notes)
    counts = Counter(r.reason for r in computed.rejects)
    reasons = [f"- {reason}: {n}" for reason, n in sorted(counts.items())] or ["- nothing"]
    changed = sum(flag["kind"] in REPAIRED for flag in computed.quality)
    repaired = f", {changed} of them of repaired frames." if changed else "; what they point at was not repaired."
    flags = f"{len(computed.quality)} quality flags among the segments{repaired}"
    parts = [
        f"# {recipe.name}\n\n{recipe.description or 'Built by dancedata.'}\n",
        _splits_table(recipe, computed, splits, songs),
        _fields_list(recipe, networks),
        _FIRST_LOOK.format(split=splits[0], field=recipe.fields[0].name),
        f"## Source\n\nDataset `{recipe.dataset.name}`, layout {scan.layout}.\n\n{notes}\n\n"
        f"Licence: {recipe.dataset.licence}\n\nCite: {recipe.dataset.citation}\n{_terms_list(computed)}",
        "\n".join(["## Left out (rejects.jsonl)", "", *reasons, "", flags, ""]),
    ]
    return "\n".join(parts)


def _terms_list(computed: BuiltClips) -> str:
    counts = Counter(c.terms for c in computed.clips if not c.source)
    if set(counts) <= {None}:
        return ""
    from dancedata.core.terms import terms_text  # few datasets have any

    terms = {k: counts[k] for k in sorted(counts, key=lambda k: (k is None, k or Licence("")))}
    return "\nClips have terms of their own:\n\n" + "".join(f"- {line}\n" for line in terms_text(terms))


def _splits_table(recipe: Recipe, computed: BuiltClips, splits: Sequence[str], songs: Mapping[str, str]) -> str:
    rows = ["| split | clips | windows | songs | minutes |", "|---|---|---|---|---|"]
    for split in splits:
        clips = [c for c in computed.clips if c.split == split]
        minutes = float(recipe.grid.seconds(sum(c.n_frames for c in clips)) / 60)
        n_songs = len({songs[c.id] for c in clips if c.id in songs})
        rows.append(f"| {split} | {len(clips)} | {sum(len(c.starts) for c in clips)} | {n_songs} | {minutes:.1f} |")
    windows = f"Windows of {recipe.windows.length_s:g} s every {recipe.windows.stride_s:g} s"
    text = f"{windows} at {recipe.grid} frames per second."
    return "\n".join(["## Splits", "", *rows, "", text, ""])


def _fields_list(recipe: Recipe, networks: Mapping[str, Any]) -> str:
    lines = ["## Fields", ""]
    for field in recipe.fields:
        about = networks.get(field.name, {})
        origin = f", by {about['model']}, licence of its weights: {about['licence']}" if "licence" in about else ""
        lines.append(f"- `{field.name}`: {field.description}{origin}")
    return "\n".join([*lines, ""])
