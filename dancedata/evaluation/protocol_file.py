"""Protocols as YAML files, for ``evaluate --protocol FILE.yaml``."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.registry import METRICS
from dancedata.core.text import shown
from dancedata.evaluation.protocol import PROTOCOLS, Measure, MotionRule, MusicRule, PaperResult, Pieces, Protocol
from dancedata.files.yaml import read_yaml
from dancedata.kernel import make_dataclass

_TEXTS = ("name", "citation", "source", "licence_note", "pool_split")
_REQUIRED = ("protocol", "name", "version", "citation", "source", "motion", "measures")
_PARTS: dict[str, type[Any]] = {"motion": MotionRule, "truth": Pieces, "generated": Pieces, "music": MusicRule}
_KEYS = (*_REQUIRED, "licence_note", "pool_split", "truth", "generated", "music", "published", "notes")


class FileProtocol(Protocol):
    """A protocol that a file describes."""


def read_protocol(path: Path) -> Protocol:
    """Read a protocol; UsageError with all problems of the file.

    Its keys are the members of `Protocol`. ``measures`` is a list of mappings: the name of a metric with its
    parameters, and further keys of `Measure`.
    """
    try:
        document = read_yaml(path)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise UsageError("the protocol cannot be read", where=path, found=shown(str(error), 600)) from error
    if not isinstance(document, dict):
        raise UsageError("a protocol is a mapping of keys", where=path, found=type(document).__name__)
    problems = [f"{key}: missing" for key in _REQUIRED if key not in document]
    problems += [
        f"{shown(key)}: unknown key; {did_you_mean(str(key), _KEYS)}" for key in document if key not in _KEYS
    ]
    members = _members(document, problems)
    if problems:
        listed = "\n".join(f"  - {problem}" for problem in problems)
        raise UsageError(f"{len(problems)} problem{'s' * (len(problems) != 1)} in the protocol\n{listed}", where=path)
    # `name` and the others are members of the class for protocols in code, and of the object for those of files.
    protocol = object.__new__(FileProtocol)
    for key, value in members.items():
        object.__setattr__(protocol, key, value)
    return protocol


def _members(document: Mapping[str, Any], problems: list[str]) -> dict[str, Any]:
    members: dict[str, Any] = {key: document[key] for key in (*_TEXTS, "version") if key in document}
    for key in (key for key in _TEXTS if not isinstance(members.get(key, ""), str)):
        problems.append(f"{key}: must be a text; found {shown(repr(members[key]))}")
    for key, least in (("protocol", 1), ("version", 1)):
        value = document.get(key, 1)
        if type(value) is not int or value < least or (key == "protocol" and value != 1):
            allowed = "1" if key == "protocol" else "a whole number of at least 1"
            problems.append(f"{key}: found {shown(repr(value))}; allowed: {allowed}")
    if isinstance(members.get("name"), str) and members["name"] in PROTOCOLS:
        problems.append(f"name: {members['name']} is a protocol already; choose another name")
    parts = {key: make_dataclass(cls, key, document[key], problems) for key, cls in _PARTS.items() if key in document}
    if "truth" in parts:
        parts.setdefault("generated", parts["truth"])
    rows = _list(document, "published", problems)
    published = [make_dataclass(PaperResult, f"published[{k}]", row, problems) for k, row in enumerate(rows)]
    measures = [
        _measure(f"measures[{k}]", entry, problems) for k, entry in enumerate(_list(document, "measures", problems))
    ]
    problems += _repeated(measures)
    notes = _list(document, "notes", problems)
    problems += [f"notes: must be texts; found {shown(repr(note))}" for note in notes if not isinstance(note, str)]
    if "measures" in document and not measures:
        problems.append("measures: name at least one, such as [{pfc: {}}]")
    needs_music = any(measure is not None and measure.metric.needs_music for measure in measures)
    if needs_music and "music" not in document:
        problems.append("music: missing; a metric needs the beats of music, such as music: {features: [librosa35]}")
    lists = {"published": tuple(published), "measures": tuple(measures), "notes": tuple(notes)}
    return members | parts | lists | {"not_computable": MappingProxyType({})}


def _repeated(measures: Sequence[Measure | None]) -> list[str]:
    """Return problems of measures whose scores have the names of others: a report has one of each name."""
    first: dict[str, int] = {}
    problems = []
    for k, measure in enumerate(measures):
        names = () if measure is None else (measure.metric.better or (measure.metric.name,))
        other = next((name for name in names if name in first), None)
        if other is not None:
            problems.append(f"measures[{k}]: measures[{first[other]}] has a score {other} already; keep one of them")
        first |= {name: k for name in names if name not in first}
    return problems


def _list(document: Mapping[str, Any], key: str, problems: list[str]) -> list[Any]:
    value = document.get(key, [])
    if isinstance(value, list):
        return value
    problems.append(f"{key}: must be a list; found {shown(repr(value))}")
    return []


def _measure(where: str, entry: Any, problems: list[str]) -> Measure | None:
    entry = {entry: {}} if isinstance(entry, str) else entry
    keys = set(Measure.__dataclass_fields__) - {"metric"}
    names = [name for name in entry if name not in keys] if isinstance(entry, dict) else []
    if len(names) != 1:
        problems.append(f"{where}: name one metric, such as {{pfc: {{variant: code}}}}; found {shown(repr(entry))}")
        return None
    name = str(names[0])
    if name not in METRICS:
        problems.append(f"{where}: unknown metric {shown(repr(name))}; {did_you_mean(name, METRICS.names())}")
        return None
    metric = make_dataclass(METRICS.get(name), f"{where}.{name}", entry[name], problems)
    others = {key: value for key, value in entry.items() if key in keys}
    for key, value in others.items():
        if not (isinstance(value, bool) if key == "steady" else type(value) is int and value > 0):
            problems.append(f"{where}.{key}: found {shown(repr(value))}")
            return None
    return None if metric is None else Measure(metric, **others)
