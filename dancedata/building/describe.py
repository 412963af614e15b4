"""Text and JSON about built datasets: the summary of a build, the output of `info` and `check`."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dancedata.building.left_out import NOTED, reasons
from dancedata.core.clip import Reject
from dancedata.core.hashing import recipe_hash
from dancedata.core.implausible import describe_implausible
from dancedata.core.left_out import left_out_lines
from dancedata.core.licence import Licence
from dancedata.core.quality import OF_CLIPS, REPAIRED
from dancedata.core.tables import table
from dancedata.core.terms import clips_by_terms, terms_text
from dancedata.core.text import counted, listed, shown, size_text
from dancedata.files.addresses import path_text
from dancedata.store import Store, open_store
from dancedata.store.clip_columns import CLIP_COLUMNS

if TYPE_CHECKING:
    from dancedata.store import Problem

#: Notes of one kind that `check` prints.
_NAMED = 3
#: Columns of the table of clips that come first; the others follow in the order of CLIP_COLUMNS.
_FIRST_COLUMNS = ("clip", "split", "music", "frames", "windows")
#: Most characters that are shown of a sentence or list from a dataset.
_NOTE = 2000
#: The end of a window's music: slices differ where the music ends within the last frame of a window.
_MUSIC_OF_WINDOWS = "a frame is an instant: a window has music up to its last frame, not up to the next one after it"
_MUSIC_OF_SLICES = "clips are slices: each has music for its whole length, in samples, as EDGE counts"


def rate_text(fps: str, length: int, stride: int) -> str:
    """Return the line on frame rate and windows that a plan and `info` print."""
    return f"  {shown(fps)} frames per second, windows of {length} frames every {stride}"


# After a build


def describe_built(path: Path, checked: Sequence[str]) -> str:
    """Return the text that `build` prints of the dataset that it made; `checked` says what its splits share."""
    with open_store(path) as store:
        windows = store.info["windows"]
        fields = (f"{name} ({counted(columns.width, 'column')})" for name, columns in store.fields.items())
        name = shown(store.info.get("name", path.name))
        lines = [
            f"{name}: {_size(store)} in {shown(path)} ({size_text(_bytes(store))})",
            *_splits(store.info["splits"]),
            f"{rate_text(str(store.fps), windows['length'], windows['stride'])}; {', '.join(fields)}",
            *_left_out(store, details=False),
            *describe_implausible(store.quality),
            *_repaired(store.quality),
            *_flagged(store.quality),
            *checked,
        ]
    return "\n".join([*lines, _next_steps(path)])


def describe_unchanged(path: Path, checked: Sequence[str]) -> str:
    """Return what `build` prints if the dataset was there already; `checked` says what its splits share."""
    with open_store(path) as store:
        size = _size(store)
    done = f"nothing to do: {shown(path)} is this dataset already, from the same recipe and source ({size})"
    return "\n".join([done, *checked, _next_steps(path)])


def _next_steps(path: Path) -> str:
    folder = shlex.quote(shown(path))
    return f"next: dancedata view {folder}; dancedata check {folder}; details: dancedata info {folder}"


def _size(store: Store) -> str:
    counts = store.info["splits"].values()
    return ", ".join(counted(sum(n[f"{noun}s"] for n in counts), noun) for noun in ("clip", "window"))


def _splits(counts: Mapping[str, Mapping[str, Any]]) -> list[str]:
    grouped = ["groups"] if any("groups" in n for n in counts.values()) else []
    return table(
        ["split", "clips", *grouped, "windows", "songs", "minutes"],
        [
            [split, n["clips"], *(n.get("groups", 0) for _ in grouped), n["windows"], n["songs"],
             f"{round(n['hours'] * 60, 6):.1f}"]
            for split, n in counts.items()
        ],
    )  # fmt: skip


def _bytes(store: Store) -> int:
    return sum(int(shard["size"]) for shard in store.info["shards"])


def _left_out(store: Store, *, details: bool) -> list[str]:
    lines = left_out_lines([Reject.from_json(row) for row in store.rejects], details=details)
    head = "left out (rejects.jsonl):" if lines else "nothing was left out"
    return [f"  {head}", *(f"    {line}" for line in lines)]


def _flagged(flags: Sequence[Mapping[str, Any]]) -> list[str]:
    """Count the clips that have flags of each kind, but flags of whole clips and of what was repaired."""
    pairs = {(str(flag.get("kind")), str(flag["clip"])) for flag in flags}
    clips = Counter(kind for kind, _ in pairs if kind not in (*OF_CLIPS, *REPAIRED))
    kinds = ", ".join(f"{shown(kind)} in {counted(n, 'clip')}" for kind, n in sorted(clips.items()))
    return [f"  flagged, not repaired: {kinds}"] if kinds else []


# info


def store_json(path: Path) -> dict[str, Any]:
    """Return the output of `info --json` for a built dataset."""
    with open_store(path) as store:
        return _store_json(store, path)


def _store_json(store: Store, path: Path) -> dict[str, Any]:
    keys = ("name", "fps", "windows", "splits", "licence", "citation")
    heights = [c.height_m for c in store if c.height_m is not None]
    return {
        "path": path_text(path),
        **{key: store.info[key] for key in keys if key in store.info},
        "rejects": reasons(store),
        "quality_flags": len(store.quality),
        "slices": store.slice_length is not None,
        "source_rates": dict(sorted(Counter(c.source_rate for c in store if c.source_rate).items())),
        "height_m": {"min": min(heights), "max": max(heights)} if heights else None,
        "notes": list(store.info.get("source", {}).get("notes", [])),
        "fields": {name: _field_json(store, name) for name in store.fields},
        "bytes": _bytes(store),
        "recipe_sha256": recipe_hash(store.info["recipe"]) if "recipe" in store.info else None,
        "weights": store.weights,
        **({"columns": [vars(column) for column in columns]} if (columns := store.free_columns()) else {}),
        **(
            {"licences": [{**(Licence("") if k is None else k).to_json(), "clips": n} for k, n in terms.items()]}
            if (terms := clips_by_terms(store))
            else {}
        ),
    }


def _field_json(store: Store, name: str) -> dict[str, Any]:
    field = store.field(name)
    return {
        "kind": field.kind,
        "columns": field.columns.width,
        "groups": list(field.columns.names),
        "rate": str(field.rate),
        "dtype": field.dtype,
        **({"without": sum(name not in clip for clip in store)} if field.optional else {}),
        **({} if field.codebook is None else {"codebook": field.codebook.to_json()}),
        "axes": field.axes or None,
    }


def describe_store(path: Path) -> str:
    """Return the output of `info` for a built dataset."""
    with open_store(path) as store:
        info = _store_json(store, path)
        left_out, implausible = _left_out(store, details=True), describe_implausible(store.quality)
        columns, terms = store.free_columns(), terms_text(clips_by_terms(store))
        quality = [*_repaired(store.quality), *(_flagged(store.quality) or ["  no quality flags"])]
    lines = [
        f"{shown(info.get('name', path.name))}: {shown(path_text(path))} ({size_text(info['bytes'])})",
        rate_text(info["fps"], info["windows"]["length"], info["windows"]["stride"]),
        f"  {_MUSIC_OF_SLICES if info['slices'] else _MUSIC_OF_WINDOWS}",
        *_splits(info["splits"]),
    ]
    for name, field in info["fields"].items():
        groups = shown(", ".join(map(shown, field["groups"])), _NOTE)
        axes = f"; {shown(field['axes'])}" if field["axes"] else ""
        if book := field.get("codebook"):
            sizes = " x ".join(map(str, book["sizes"]))
            axes += f"; codes of {shown(book['name'], _NOTE)}, {shown(sizes, _NOTE)}, pad {book['pad']}"
        axes += f"; optional, {counted(field['without'], 'clip')} without it" if "without" in field else ""
        lines.append(
            f"  {name}: {field['columns']} columns ({groups}), {field['rate']} per second, {field['dtype']}{axes}"
        )
    if info["source_rates"]:
        rates = ", ".join(f"{rate} per second: {n}" for rate, n in info["source_rates"].items())
        lines.append(f"  clips by their source's frame rate: {shown(rates, _NOTE)}")
    if info["height_m"]:
        low, high = info["height_m"]["min"], info["height_m"]["max"]
        lines.append(f"  lowest to highest joint, +Y up, median of a clip: {low:.2f} to {high:.2f} m")
    lines += [f"  {shown(str(column), _NOTE)}" for column in columns]
    lines += [f"  source: {shown(note, _NOTE)}" for note in info["notes"]]
    lines += [*left_out, *implausible, *quality]
    lines.append(f"  licence: {shown(info.get('licence', 'unknown'), _NOTE)}")
    lines += [f"  licence of {shown(line, _NOTE)}" for line in terms]
    return "\n".join([*lines, *(f"  weights of {shown(name)}: {text}" for name, text in info["weights"].items())])


def _repaired(flags: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a line for each kind of repair: in how many frames, or whole clips."""
    lines = []
    for kind in REPAIRED:
        of_kind = [flag for flag in flags if flag.get("kind") == kind]
        frames = len({(flag["clip"], flag["frame"]) for flag in of_kind if "frame" in flag})
        clips = counted(len({flag["clip"] for flag in of_kind}), "clip")
        where = f"{counted(frames, 'frame')} of {clips}" if frames else clips
        lines += [f"  repaired: {kind.removeprefix('repaired_')} in {where}"] if of_kind else []
    return lines


def clip_rows(path: Path) -> list[dict[str, Any]]:
    """Return a row for each clip."""
    with open_store(path) as store:
        return [
            {column.heading: column.show(getattr(clip, column.name)) for column in CLIP_COLUMNS if column.heading}
            | {"split": clip.split, "windows": len(store[clip.id].windows())}
            for clip in store.clips()
        ]


def describe_clips(path: Path) -> str:
    """Return a table of all clips."""
    rows = clip_rows(path)
    head = list(dict.fromkeys([*_FIRST_COLUMNS, *(heading for row in rows[:1] for heading in row)]))
    return "\n".join(table(head, [[row[heading] for heading in head] for row in rows]))


# check


def describe_problems(path: Path | str, problems: Sequence[Problem]) -> str:
    """Return the output of `check`: all errors; many notes with the same reason are one line."""
    errors = [p for p in problems if p.severity == "error"]
    lines = [str(p) for p in errors]
    kinds: dict[str, list[Problem]] = {}
    for problem in problems:
        if problem.severity == "note":
            reason = problem.message.split(":")[0]
            kinds.setdefault(reason if reason in NOTED else problem.message, []).append(problem)
    for kind, notes in kinds.items():
        detail = notes[0].message.removeprefix(kind).removeprefix(": ")
        example = f"; the first: {detail}" if detail else ""
        folded = f"note: {len(notes):,} {kind}: {listed([p.where for p in notes], _NAMED)} (all with --json){example}"
        lines += [folded] if len(notes) > _NAMED else [str(p) for p in notes]
    numbers = f"{counted(len(errors), 'error')}, {counted(len(problems) - len(errors), 'note')}"
    return "\n".join([*lines, f"{shown(path_text(path))}: {numbers}"])
