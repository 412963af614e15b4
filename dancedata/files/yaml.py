"""YAML without surprises: plain data only, and no key twice."""

from pathlib import Path
from typing import Any

import yaml

from dancedata.core.resources import resource, resources
from dancedata.core.text import is_unicode, quoted, shown
from dancedata.files.regular_file import read_regular

#: Of PyYAML, which takes 20 microseconds a character.
_MAX_CHARACTERS = 1 << 15
_MAX_NODES = 2_000
MAX_DEPTH = 40


class _Loader(yaml.SafeLoader):
    """SafeLoader that refuses a mapping which names a key twice (plain YAML loaders keep the last silently).

    It stops at the limits while it reads: PyYAML takes seconds for ten thousand brackets.
    """

    _n_nodes = 0

    def fetch_flow_collection_start(self, TokenClass: Any) -> None:  # noqa: N803 -- PyYAML's name
        if self.flow_level >= MAX_DEPTH:
            raise yaml.YAMLError(f"it is nested deeper than {MAX_DEPTH} levels")
        super().fetch_flow_collection_start(TokenClass)

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        self._n_nodes += 1
        if self._n_nodes > _MAX_NODES:
            raise yaml.YAMLError(f"more than {_MAX_NODES:,} values")
        return super().compose_node(parent, index)


def _mapping(loader: _Loader, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
    seen = set()
    for key_node, _ in node.value:
        key = loader.construct_object(key_node, deep=True)
        if isinstance(key, str | int) and key in seen:
            raise yaml.constructor.ConstructorError("while reading a mapping", node.start_mark,
                                                    f"duplicate key {quoted(key)}", key_node.start_mark)  # fmt: skip
        seen.add(key if isinstance(key, str | int) else id(key_node))
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _mapping)


def read_yaml(path: Path) -> Any:
    """Read a YAML file; raises yaml.YAMLError as `load_yaml` does, OSError and UnicodeDecodeError."""
    # A character has up to four bytes.
    return load_yaml(read_regular(path, 4 * _MAX_CHARACTERS).decode("utf-8"))


def load_yaml(text: str) -> Any:
    """Read YAML; yaml.YAMLError also for length, depth, numbers and aliases of hostile files."""
    if len(text) > _MAX_CHARACTERS:
        raise yaml.YAMLError(f"{len(text):,} characters; at most {_MAX_CHARACTERS:,} are read")
    try:
        loaded = yaml.load(text, Loader=_Loader)  # noqa: S506 -- a SafeLoader
        if _size(loaded, 0) > _MAX_NODES:
            raise yaml.YAMLError(f"more than {_MAX_NODES:,} values, aliases followed")
    except RecursionError as error:
        raise yaml.YAMLError("it is nested too deep") from error
    # Numbers and dates that look like ones and are none.
    except (ValueError, OverflowError, TypeError, AttributeError, KeyError) as error:
        raise yaml.YAMLError(f"a value cannot be read: {shown(error)}") from error
    return loaded


def _size(value: Any, depth: int) -> int:
    """Count values, shared ones as often as they are named, but not far beyond the limit."""
    if depth > MAX_DEPTH:
        raise yaml.YAMLError(f"it is nested deeper than {MAX_DEPTH} levels, or in itself")
    if isinstance(value, int) and abs(value) >= 1 << 64:
        raise yaml.YAMLError("a whole number of more than 64 bits")
    if isinstance(value, str) and not is_unicode(value):
        raise yaml.YAMLError(f"text that is not valid Unicode: {quoted(value)}")
    inside = (
        (*value, *value.values())
        if isinstance(value, dict)
        else value
        if isinstance(value, list | tuple | set)
        else ()
    )
    total = 1
    for item in inside:
        total += _size(item, depth + 1)
        if total > _MAX_NODES:
            break
    return total


def recipes_with(field: str) -> tuple[str, ...]:
    """Return the names of the shipped recipes that compute a field, sorted."""
    names = []
    for file in resources("pipelines"):
        recipe = yaml.safe_load(resource("pipelines", file).read_text(encoding="utf-8"))
        if any(field in (recipe.get(slot) or {}) for slot in ("motion", "audio", "keymotion")):
            names.append(recipe["name"])
    return tuple(sorted(names))
