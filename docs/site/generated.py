"""Tables of the pages that the code knows: python docs/site/generated.py writes them into their pages.

A page has the place of a table between the comments ``<!-- generated: NAME -->`` and ``<!-- end -->``.
"""

from __future__ import annotations

import dataclasses
import json
import re
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from dancedata.cli.plugins import documented
from dancedata.core.registry import (
    ANNOTATORS,
    AUGMENTATIONS,
    CONTACTS,
    DATASETS,
    FEATURES,
    FILTERS,
    KEYMOTIONS,
    REPRESENTATIONS,
    RULES,
    TRANSFORMS,
    Registry,
)
from dancedata.core.resources import resources
from dancedata.evaluation.protocol_text import protocols_json
from dancedata.evaluation.report import LABELS
from dancedata.exports.base.job import EXPORTS
from dancedata.formats.bvh.producers import Producer, producers
from dancedata.recipes.parse import load_recipe

ROOT = Path(__file__).resolve().parents[2]
_PLACE = re.compile(r"(<!-- generated: ([\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)
#: Words of a cell at most, and of what stands before a list that is cut.
_WORDS, _LEAD = 20, 3
#: Most values of a key that stand beside its default.
_CHOICES = 5
#: Keys of a recipe that take plug-ins, in the order of a build.
SLOTS: dict[str, Registry[Any]] = {
    "dataset": DATASETS, "transforms": TRANSFORMS, "motion": REPRESENTATIONS, "contacts": CONTACTS, "audio": FEATURES,
    "keymotion": KEYMOTIONS, "augment": AUGMENTATIONS, "annotators": ANNOTATORS, "rules": RULES,
    "window filters": FILTERS,
}  # fmt: skip


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a table of Markdown; cells are one line each."""
    lines = [list(head), ["---"] * len(tuple(head)), *(list(row) for row in rows)]
    escaped = ([cell.replace("|", "\\|") for cell in line] for line in lines)
    return "".join(f"| {' | '.join(line)} |\n" for line in escaped)


def _with_default(field: dataclasses.Field[Any]) -> str:
    value = field.default if field.default is not dataclasses.MISSING else None
    if field.default_factory is not dataclasses.MISSING:
        value = field.default_factory()
    value = list(value) if isinstance(value, tuple) else value
    literal = re.search(r"Literal\[(.*?)\]", str(field.type), re.DOTALL)
    choices = [choice for choice in re.findall(r"[\"'](.+?)[\"']", literal[1] if literal else "") if choice != value]
    key = f"`{field.name}`" if value in (None, "", []) else f"`{field.name}: {json.dumps(value).strip(chr(34))}`"
    is_listed = 0 < len(choices) <= _CHOICES and not isinstance(value, list)
    return f"{key} (`{'`, `'.join(choices)}`)" if is_listed else key


def brief(text: str) -> str:
    """Return the first sentences and clauses of a text, at most 20 words; `dancedata info` has all."""
    parts = re.split(r"(?<=[.;])\s+", text)
    while len(parts) > 1 and len(" ".join(parts).split()) > _WORDS:
        parts.pop()
    short = " ".join(parts).rstrip(".;")
    head, _, values = short.partition(": ")
    is_cut = short != text.rstrip(".") and len(parts) == 1 and len(head.split()) > _LEAD and not head.count("`") % 2
    return f"{head if values and (is_cut or len(short.split()) > _WORDS) else short}."


def _keys(registry: Registry[Any]) -> Iterator[tuple[str, ...]]:
    """Give plug-in, key with its default, and meaning; of datasets all keys in a row, as their pages say the rest."""
    shared = {"music", "music_dir"} if registry is DATASETS else set()
    for name in shipped(registry):
        plugin, label = registry.get(name), f"`{name}`"
        texts = documented(plugin)
        fields = [field for field in dataclasses.fields(plugin) if field.init and field.name in texts.keys() - shared]
        if registry is DATASETS:
            yield label, ", ".join(map(_with_default, fields)), ""
            continue
        for field in fields:
            yield label, _with_default(field), brief(texts[field.name])
            label = ""


def shipped(registry: Registry[Any]) -> list[str]:
    """Return the names of the plug-ins that come with the package, not of those that files have registered since."""
    return [name for name in registry.names() if registry.get(name).__module__.startswith("dancedata.")]


def _by_plugins(rows: Iterable[tuple[str, ...]]) -> dict[str, list[str]]:
    """Return keys with their texts by the plug-ins that have them; what several have alike comes last."""
    labels: dict[str, list[str]] = {}
    label = ""
    for name, key, text in rows:
        label = name or label
        labels.setdefault(f"{key}: {text}", []).append(label)
    keys: dict[str, list[str]] = {}
    for line, names in sorted(labels.items(), key=lambda item: len(item[1]) > 1):
        keys.setdefault(", ".join(names), []).append(line)
    return keys


def plugins() -> str:
    """Return the keys of the plug-ins of each slot, and the plug-ins that have none."""
    parts = []
    for slot, registry in SLOTS.items():
        rows = list(_keys(registry))
        without = [f"`{name}`" for name in shipped(registry) if f"`{name}`" not in {row[0] for row in rows}]
        parts.append(f"### {slot}\n")
        if registry is DATASETS:
            parts.append("\n".join(_wrapped(f"- {name}: {keys}") for name, keys, _ in rows) + "\n")
        else:
            for names, keys in _by_plugins(rows).items():
                parts += [f"{names}\n", "\n".join(_wrapped(f"- {key}") for key in keys) + "\n"]
        parts += [_wrapped(f"Without keys: {', '.join(without)}.") + "\n"] if without else []
    return "\n".join(parts)


def _wrapped(text: str) -> str:
    indent = "  " if text.startswith("- ") else ""
    return textwrap.fill(text, 120, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def recipes() -> str:
    """Return the recipes that come with the package: what they read, and what they make of it."""
    rows = []
    for name in (file.removesuffix(".yaml") for file in resources("pipelines")):
        document = load_recipe(name).document
        windows = document["windows"]
        fields = (", ".join(f"`{field}`" for field in document[kind]) for kind in ("motion", "audio"))
        cells = (document["fps"], f"{windows['length_frames']} every {windows['stride_frames']}", *fields)
        rows.append((f"`{name}`", *(f"`{dataset}`" for dataset in document["dataset"]), *map(str, cells)))
    return table(("recipe", "dataset", "rate", "windows", "motion", "audio"), rows)


def _groups(columns: Any) -> str:
    parts, first = [], 0
    for group in columns.groups:
        last = first + group.width - 1
        place = f"{first}" if group.width == 1 else f"{first} - {last}"
        unit = "" if group.unit == "1" else f", {group.unit}"
        parts.append(f"{place} `{group.name}`{unit}")
        first = last + 1
    return "; ".join(parts)


def representations() -> str:
    """Return the columns of every representation, with its world, rate and contacts."""
    rows = []
    for name in shipped(REPRESENTATIONS):
        plugin = REPRESENTATIONS.get(name)()
        rate = str(getattr(plugin, "fps", None) or getattr(plugin, "rate", None) or "any")
        world = plugin.axes.removeprefix("right-handed, ")
        rows.append((f"`{name}`", str(plugin.columns.width), _groups(plugin.columns), world, rate))
    return table(("name", "width", "columns, unit", "world", "rate"), rows)


def features() -> str:
    """Return the columns of the audio features whose columns do not depend on files, and of key motions."""
    rows = []
    for registry in (FEATURES, KEYMOTIONS):
        for name in shipped(registry):
            if name not in ("file", "hf"):  # their columns are those of the files and of the model
                columns = registry.get(name)().columns
                rows.append((f"`{name}`", str(columns.width), _groups(columns)))
    return table(("name", "width", "columns, unit"), rows)


def protocols() -> str:
    """Return what the numbers of each protocol depend on, and the published ones of the ground truth."""
    rows = []
    for name, protocol in protocols_json().items():
        motion = protocol["motion"]
        joints = f"{motion['body']}, {motion['fps'] or 'any'}, {motion['up']} up"
        pieces = str(protocol["generated"])
        pieces += "" if protocol["truth"] == pieces else f"; truth: {protocol['truth']}"
        published = (
            ", ".join(f"{LABELS.get(key, key)} {value:g}" for key, value in row["values"].items())
            for row in protocol["published"]
        )
        rows.append((f"`{name}` {protocol['version']}", joints, pieces, "; ".join(published), protocol["source"]))
    return table(("protocol, version", "joints, rate", "pieces", "published", "after"), rows)


def exports() -> str:
    """Return the keys of the targets of `export`."""
    return table(("target", "key: default", ""), _keys(EXPORTS))


def commands() -> str:
    """Return what `--help` prints of every command; options of several commands are described once."""
    from typer.main import get_command

    from dancedata.cli.app import app
    from dancedata.cli.help import SEVERAL, describe_options, help_text
    from dancedata.cli.options import SHARED

    group: Any = get_command(app)
    texts: list[str] = []
    shared: dict[str, Any] = {}
    for name, command in group.commands.items():
        for option in command.params:
            if (
                option.name in SHARED
                and option.param_type_name == "option"
                and option.help.startswith(_about(option))
            ):
                option.rich_help_panel = SEVERAL
                shared[option.name] = option
        context = command.make_context(name, [], resilient_parsing=True)
        texts.append(f"## {name}\n\n```text\n{help_text(context, command, full=True)}\n```\n")
    about = describe_options(SEVERAL, [shared[name] for name in SHARED])
    return "\n".join([*texts, f"## Options of several commands\n\n```text\n{about}\n```\n"])


def _about(option: Any) -> str:
    """Return what is said of an option that several commands have."""
    from dancedata.cli.options import SHARED

    _, about = SHARED[option.name]
    text = about if isinstance(about, str) else about[1]
    return text.split(": ", 1)[1] if option.metavar and not option.is_flag else text


#: Joints of SMPL by whose names a producer is recognised.
_JOINTS = ("pelvis", "left_hip", "left_knee")


def joint_names() -> str:
    """Return some names of joints by producer of BVH files; producers of equal names in one row."""
    rows: dict[str, list[Producer]] = {}
    for producer in producers().values():
        names = "; ".join(" or ".join(producer.joints.get(joint, ("-",))) for joint in _JOINTS)
        rows.setdefault(names, []).append(producer)
    cells = ((", ".join(f"`{one.name}`" for one in row), names) for names, row in rows.items())
    return table(("producer", "pelvis; left hip; left knee"), cells)


#: What a place in a page gets, by its name.
TABLES: dict[str, Callable[[], str]] = {
    "representations": representations, "features": features, "protocols": protocols, "commands": commands,
    "exports": exports, "plugins": plugins, "recipes": recipes, "joint-names": joint_names,
}  # fmt: skip


def filled(text: str) -> str:
    """Return a page with its tables as the code has them now."""
    return _PLACE.sub(lambda place: f"{place[1]}\n{TABLES[place[2]]()}\n{place[3]}", text)


def main() -> int:
    """Write the tables into the pages; returns 0."""
    for path in sorted((ROOT / "docs").rglob("*.md")):
        text = path.read_text(encoding="utf-8")
        if (new := filled(text)) != text:
            path.write_text(new, encoding="utf-8")
            print(path.relative_to(ROOT))
    return 0


if __name__ == "__main__":
    sys.exit(main())
