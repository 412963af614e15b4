"""README.md and the licence of an export."""

from __future__ import annotations

from collections.abc import Sequence

from dancedata.core.text import shown
from dancedata.exports.base.job import Export, ExportJob
from dancedata.store import Store

_TEXT = 5000


def readme_text(target: Export, job: ExportJob, notes: Sequence[str]) -> str:
    """Return the README: what this is, how it is used, what to know, where it comes from."""
    name = shown(job.store.meta.get("name", job.store.path.name))
    reads = f" Files as `{target.reference}` reads them." if target.reference else ""
    listed = ", ".join(f"`{folder}/`" for folder in target.listed_folders)
    parts = [
        f"# {name}, exported as {target.name}\n",
        f"Written by `dancedata export --to {target.name}`.{reads} `export.json` has the parameters, the hash of the "
        f"dataset, and every file with its size and SHA-256.\n",
        target.guide(job).strip() + "\n",
    ]
    if listed:
        parts.append(f"The loader opens every file in {listed}: put nothing else there.\n")
    if notes:
        parts.append("## What to know\n\n" + "\n".join(f"- {shown(note, _TEXT)}" for note in notes) + "\n")
    parts.append(_origin(job.store))
    return "\n".join(parts)


def licence_text(store: Store) -> str:
    """Return the licence and the citations of the source; "" if they are unknown."""
    licence, citation = (shown(store.meta.get(key) or "", _TEXT) for key in ("licence", "citation"))
    if not licence:
        return ""
    return (
        f"These files were made from a dataset with this licence; it holds for them too:\n\n{licence}\n\n"
        f"Cite: {citation or 'see the dataset'}\n"
    )


def _origin(store: Store) -> str:
    licence, citation = (shown(store.meta.get(key) or "unknown", _TEXT) for key in ("licence", "citation"))
    return f"## Origin\n\nLicence of the data: {licence}\n\nCite: {citation}\n"
