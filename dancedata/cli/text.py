"""Text and JSON about datasets, plans and plug-ins, for the command line."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dancedata.core.clip import Reject
from dancedata.core.quality import OF_CLIPS
from dancedata.core.text import counted, shown, size_text, table
from dancedata.pipeline.rejects import NOTED, describe_implausible, left_out_lines
from dancedata.store import Problem, Store, open_store
from dancedata.store.clip_columns import CLIP_COLUMNS

_NAMED = 3
#: Columns of the table of clips that come first; the others follow in the order of CLIP_COLUMNS.
_FIRST_COLUMNS = ("clip", "split", "music", "frames", "windows")
#: Most characters that are shown of a sentence or list from a dataset.
_NOTE = 2000


def store_json(path: Path) -> dict[str, Any]:
    """Return the output of `info --json` for a built dataset."""
    with open_store(path) as store:
        keys = ("name", "scope", "fps", "windows", "counts", "rejects", "quality_flags", "licence", "citation")
        info = {key: store.meta[key] for key in keys if key in store.meta}
        fields = {name: _field_json(store, name) for name in store.fields}
        size = sum(int(shard["size"]) for shard in store.meta["shards"])
        recipe = store.meta.get("recipe_sha256")
        sources = _sources_json(store)
        info |= {**sources, "fields": fields, "bytes": size, "recipe_sha256": recipe, "weights": store.weights}
        return {"path": str(path), **info}


def _sources_json(store: Store) -> dict[str, Any]:
    """Return facts about the source: frame rates of its files, and the range of heights."""
    heights = [c.height_m for c in store.clips if c.height_m is not None]
    return {
        "source_rates": dict(sorted(Counter(c.source_rate for c in store.clips if c.source_rate).items())),
        "height_m": {"min": min(heights), "max": max(heights)} if heights else None,
        "notes": list(store.meta.get("source", {}).get("notes", [])),
    }


def _field_json(store: Store, name: str) -> dict[str, Any]:
    field = store.field(name)
    return {
        "kind": field.kind,
        "columns": field.columns.width,
        "groups": list(field.columns.names),
        "rate": str(field.rate),
        "dtype": field.dtype,
        "axes": store.meta.get("axes", {}).get(name),
    }


#: Where the music of a window has to end: the scopes differ where the music ends within the last frame of a window.
_MUSIC_OF_WINDOWS = {
    "track": "a frame is an instant: a window has music up to its last frame, not up to the next one after it",
    "window": "a window has music for its whole length, in samples, as EDGE counts",
}


def describe_store(path: Path) -> str:
    """Return the output of `info` for a built dataset."""
    info = store_json(path)
    windows = info["windows"]
    lines = [
        f"{shown(info.get('name', path.name))}: {shown(path)} ({size_text(info['bytes'])})",
        f"  {info['scope']} scope, {shown(info['fps'])} frames per second, "
        f"windows of {windows['length']} frames every {windows['stride']}",
        f"  {_MUSIC_OF_WINDOWS[info['scope']]}",
        *table(
            ["split", "clips", "windows", "songs", "minutes"],
            [
                [split, n["clips"], n["windows"], n["songs"], f"{round(n['hours'] * 60, 6):.1f}"]
                for split, n in info.get("counts", {}).items()
            ],
        ),
    ]
    for name, field in info["fields"].items():
        groups = shown(", ".join(map(shown, field["groups"])), _NOTE)
        axes = f"; {shown(field['axes'])}" if field["axes"] else ""
        lines.append(
            f"  {name}: {field['columns']} columns ({groups}), {field['rate']} per second, {field['dtype']}{axes}"
        )
    lines += _describe_sources(info)
    with open_store(path) as store:
        lines += _describe_rejects(store.rejects)
        lines += describe_implausible(store.quality)
        lines += _describe_quality([f for f in store.quality if f.get("kind") not in OF_CLIPS])
    lines.append(f"  licence: {shown(info.get('licence', 'unknown'), _NOTE)}")
    lines += [f"  weights of {shown(name)}: {weights}" for name, weights in info["weights"].items()]
    return "\n".join(lines)


def _describe_sources(info: Mapping[str, Any]) -> list[str]:
    lines = []
    if info["source_rates"]:
        rates = ", ".join(f"{rate} per second: {n}" for rate, n in info["source_rates"].items())
        lines.append(f"  clips by their source's frame rate: {shown(rates, _NOTE)}")
    if info["height_m"]:
        low, high = info["height_m"]["min"], info["height_m"]["max"]
        lines.append(f"  lowest to highest joint, +Y up, median of a clip: {low:.2f} to {high:.2f} m")
    return lines + [f"  source: {shown(note, _NOTE)}" for note in info["notes"]]


def _describe_rejects(rejects: Sequence[Mapping[str, Any]]) -> list[str]:
    if not rejects:
        return ["  nothing was left out"]
    lines = left_out_lines([Reject.from_json(row) for row in rejects], details=True)
    return ["  left out (rejects.jsonl):", *(f"    {line}" for line in lines)]


def _grouped(rows: Sequence[Mapping[str, Any]], key: str) -> dict[str, list[Mapping[str, Any]]]:
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(row[key], []).append(row)
    return groups


def _describe_quality(flags: Sequence[Mapping[str, Any]]) -> list[str]:
    if not flags:
        return ["  no quality flags"]
    lines = ["  quality flags (quality.jsonl), not repaired:"]
    for clip, of_clip in _grouped(flags, "clip").items():
        worst = max(of_clip, key=lambda f: float(f.get("value", 0)))
        frames = len({f.get("frame") for f in of_clip})
        kind, joint, unit = (shown(worst.get(key, "?")) for key in ("kind", "joint", "unit"))
        lines.append(
            f"    {shown(clip)}: {len(of_clip)} in {frames} frame steps, the worst {kind} of {joint} "
            f"at source frame {worst.get('frame')}: {worst.get('value', 0):.1f} {unit}"
        )
    return lines


def describe_clips(path: Path) -> str:
    """Return a table of every clip."""
    with open_store(path) as store:
        rows = [
            {column.heading: column.show(getattr(clip, column.name)) for column in CLIP_COLUMNS if column.heading}
            | {"split": clip.split, "windows": len(store.windows_of(clip.id))}
            for clip in store.clips
        ]
    head = list(dict.fromkeys([*_FIRST_COLUMNS, *(heading for row in rows[:1] for heading in row)]))
    return "\n".join(table(head, [[row[heading] for heading in head] for row in rows]))


def describe_problems(path: Path, problems: Sequence[Problem]) -> str:
    """Return the output of `check`: every error; of notes with the same reason the first few, and a count."""
    errors = [p for p in problems if p.severity == "error"]
    lines = [str(p) for p in errors]
    kinds: dict[str, list[Problem]] = {}
    for problem in problems:
        if problem.severity == "note":
            reason = problem.message.split(":")[0]
            kinds.setdefault(reason if reason in NOTED else problem.message, []).append(problem)
    for kind, notes in kinds.items():
        lines += [str(p) for p in notes[:_NAMED]]
        if len(notes) > _NAMED:
            lines.append(f"note: {kind}: {len(notes) - _NAMED} more (all with --json)")
    return "\n".join(
        [*lines, f"{shown(path)}: {counted(len(errors), 'error')}, {counted(len(problems) - len(errors), 'note')}"]
    )
