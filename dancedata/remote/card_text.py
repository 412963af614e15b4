"""The text of a card: content, terms, and how to build the dataset again. No path and no user name is in it."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from dancedata.core.hashing import dataset_hashes
from dancedata.core.terms import clips_by_terms, terms_text
from dancedata.core.text import counted, shown
from dancedata.formats.hub_head import OTHER, HubPlace, citations, head, strictest
from dancedata.kernel import Store

#: Found in files that this module wrote, and only there.
MARK = "<!-- written by dancedata export --to card; changes are lost when it is written again -->"
#: Paths of a machine: absolute ones, and those in a home folder.
_PATH = re.compile(r"(?<![\w:/.~<])(?:~|[A-Za-z]:)?[/\\](?:[^\s/\\:;,'\"()]+[/\\])+[^\s/\\:;,'\"()]*")
_MARKDOWN = re.compile(r"([\\`*_\[\]<>|#])")


def without_paths(text: str) -> str:
    """Return a text with PATH in place of the paths of a machine.

    Examples
    --------
    >>> without_paths("Read from /home/ann/aist/x.pkl; see https://example.org/a/b")
    'Read from PATH; see https://example.org/a/b'
    """
    return _PATH.sub("PATH", text)


def card_text(store: Store, pictures: Mapping[str, str], place: HubPlace | None = None) -> str:
    """Return the README.md of a dataset; `pictures` are addresses and descriptions."""
    meta, splits = store.info, tuple(store.splits)
    name = _text(str(meta.get("name", "dataset")))
    description = _text(str(meta.get("recipe", {}).get("description") or "Built by dancedata."))
    images = "\n".join(f"![{_text(what)}]({address})\n" for address, what in pictures.items())
    return "\n".join(
        [head(store, splits, _files(place), place=place), MARK, "", f"# {name}", "", description, "", images,
         _splits(store, splits), _fields(store), _terms(store, place), _reading(splits, store, place),
         _again(store, place)]
    )  # fmt: skip


def _text(text: str) -> str:
    """Return a text of a dataset for Markdown: one line, without markup and paths."""
    return _MARKDOWN.sub(r"\\\1", shown(without_paths(" ".join(text.split())), 2000))


def _table(head_row: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = [head_row, ["---"] * len(head_row), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines) + "\n"


def _files(place: HubPlace | None) -> dict[str, str]:
    """Return the files that hubs show: none where a recipe alone is published."""
    return {} if place is not None and place.recipe_only else {"default": "{}-*.h5"}


def _splits(store: Store, splits: Sequence[str]) -> str:
    rows = []
    for split in splits:
        clips = [clip for clip in store if clip.split == split and not clip.source]
        copies = sum(clip.split == split and bool(clip.source) for clip in store)
        minutes = float(store.grid.seconds(sum(clip.n_frames for clip in clips)) / 60)
        songs = len({clip.music for clip in clips if clip.music})
        n_windows = len(store.windows(split, fields=store.required_fields))
        rows.append((_text(split), len(clips), copies, n_windows, songs, f"{minutes:.1f}"))
    genres = sorted({clip.genre for clip in store if clip.genre})
    windows = store.info["windows"]
    about = (
        f"Windows of {windows['length']} frames every {windows['stride']}, at {store.info['fps']} frames per second; "
        f"skeleton {_text(store.skeleton.name)}, {counted(store.skeleton.n_joints, 'joint')}."
    )
    genre_line = f"\nGenres: {', '.join(map(_text, genres))}.\n" if genres else ""
    table = _table(("split", "clips", "copies", "windows", "songs", "minutes"), rows)
    left = len(store.rejects)
    return f"## Content\n\n{table}\n{about}\n{genre_line}\nLeft out: {left}.\n"


def _fields(store: Store) -> str:
    rows = []
    for name in store.fields:
        field = store.field(name)
        groups = ", ".join(f"{_text(g.name)} ({g.width})" for g in field.columns.groups)
        rows.append((f"`{name}`", field.kind, field.columns.width, str(field.rate), field.dtype, groups))
    stated = "".join(f"- weights of `{name}`: {_text(text)}\n" for name, text in store.weights.items())
    table = _table(("field", "kind", "columns", "rows per second", "type", "groups"), rows)
    return f"## Features\n\n{table}\n{stated}"


def _terms(store: Store, place: HubPlace | None) -> str:
    name, licence = strictest(store)
    hub = "not one that hubs have a name for" if name == OTHER else name
    lines = [f"Strictest licence of its clips: {_text(licence.text)} ({hub})."]
    lines += [f"- {_text(text)}" for text in terms_text(clips_by_terms(store))]
    notes = [f"- {_text(note)}" for note in store.info.get("source", {}).get("notes", [])]
    cite = citations(store)
    of_dataset = _text(str(store.info.get("licence") or "unknown"))
    parts = ["## Licence and citation", "", *lines, "", f"Dataset: {of_dataset}"]
    parts += ["", "Cite:", "", *(f"> {_text(text)}\n" for text in cite)] if cite else []
    if place is not None and place.rights:
        parts += ["", "These licences do not allow the data to be passed on:", ""]
        parts += [f"- {_text(clause)}" for clause in place.overridden]
        parts += ["", f"The publisher states the right to do so: {_text(place.rights)}", ""]
    return "\n".join([*parts, *(["", "## Source", "", *notes] if notes else []), ""])


def _reading(splits: Sequence[str], store: Store, place: HubPlace | None) -> str:
    if place is not None and place.recipe_only:
        return (
            "## How to get the data\n\nThis publication has no motion, music or features. It has the recipe, the "
            "clips with their splits and the hashes of their source files, the scaler, and the hashes of the dataset."
            f"\n\n{_command(place.address)}\n"
            "With your own copy of the source this builds the dataset, and reports that its bytes are the same, or "
            "which clips differ.\n"
        )
    where, field = "FOLDER" if place is None else place.address, next(iter(store.fields))
    return (
        f"## How to read it\n\n```python\nimport dancedata\n\nds = dancedata.open({where!r})\n"
        f"window = ds.windows({splits[0]!r})[0]\nds.read(window, {field!r}).shape\n```\n\n"
        f"The files are plain HDF5. `dancedata check {where}` verifies them, `dancedata view {where}` plays them.\n"
    )


def _command(recipe: str) -> str:
    return f"```sh\ndancedata build {recipe} FOLDER_OF_THE_SOURCE --out FOLDER\n```\n"


def _again(store: Store, place: HubPlace | None) -> str:
    meta = store.info
    recipe = yaml.safe_dump(plain_recipe(store), sort_keys=False, allow_unicode=True, width=100)
    rows = [(key.removesuffix("_sha256"), f"`{value}`") for key, value in dataset_hashes(meta).items()]
    rows += [(f"`{shard['file']}`", f"`{shard['sha256']}`") for shard in meta.get("shards", [])]
    versions = dict(meta.get("versions", {}))
    made_by = _text(str(versions.pop("dancedata", "")))
    packages = ", ".join(f"{name} {version}" for name, version in versions.items() if isinstance(version, str))
    fence = "`" * max(3, 1 + max((len(run) for run in re.findall(r"`+", recipe)), default=0))
    used = f" ({_text(packages)})" if packages else ""
    return (
        f"## How to build it again\n\nWith dancedata {made_by}{used}, and this recipe "
        f"as recipe.yaml:\n\n{fence}yaml\n{recipe}{fence}\n\n"
        f"{_command('recipe.yaml' if place is None else place.address)}\n"
        f"{_table(('', 'SHA-256'), rows)}"
    )


def plain_recipe(store: Store) -> Any:
    """Return the recipe of a dataset without the paths of a machine."""
    return _plain(store.info.get("recipe", {}))


def _plain(value: Any) -> Any:
    """Return a recipe without the paths of a machine."""
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return without_paths(value) if isinstance(value, str) else value
