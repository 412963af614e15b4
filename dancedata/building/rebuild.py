"""A build from a publication: its recipe, which executes nothing, and whether the bytes are those published."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dancedata.building.differences import source_differences
from dancedata.building.source_record import SourceRecord
from dancedata.core.arguments import Overrides
from dancedata.core.clip import Reject
from dancedata.core.errors import RecipeError, StoreError, UsageError
from dancedata.core.hashing import self_hash, sha256_bytes
from dancedata.core.registry import CONTACTS, FILTERS
from dancedata.core.text import listed, quoted, shown
from dancedata.execution.progress import Progress
from dancedata.files.addresses import is_address, local_folder, origin_of, require_file
from dancedata.files.regular_file import read_regular, sha256_file
from dancedata.files.strict_json import parse_json
from dancedata.recipes.parse import load_recipe
from dancedata.recipes.plugins import SLOTS
from dancedata.recipes.recipe import Recipe
from dancedata.store import open_store
from dancedata.store.dataset_json import MAX_BYTES, MAX_LINES_BYTES, json_rejects
from dancedata.store.listing import DatasetFiles
from dancedata.store.schema import REJECTS_FILE, STATS_FILE

#: Files of the recipe's publication that a build does not read from the source.
_CLIPS_FILE = "clips.jsonl"
_WRITTEN = ("recipe.yaml", _CLIPS_FILE, REJECTS_FILE, STATS_FILE)


@dataclass(frozen=True)
class Publication:
    """A publication: of a recipe, or of a dataset with its data."""

    place: str  # its address, that of a hub with the commit; or its folder
    folder: Path  # where its files are, or come
    dataset: Mapping[str, Any]  # its dataset.json
    files: Mapping[str, str]  # hashes of the files of a recipe's publication

    @classmethod
    def at(cls, recipe: str | Path) -> Publication | None:
        """Return the publication at an address or in a folder; None if that names a recipe."""
        if not is_address(recipe) and not DatasetFiles.path(Path(recipe).expanduser()).is_file():
            return None
        folder = local_folder(recipe)
        origin = origin_of(folder)
        path = DatasetFiles.path(folder)
        try:
            document = _sealed(parse_json(read_regular(path, MAX_BYTES).decode("utf-8")))
            DatasetFiles.of(document, path)
            files = {}
            if "publication" in document:
                if document["publication"] != 1:
                    raise ValueError(f"publication {quoted(document['publication'], 20)} of a later dancedata")
                files = {name: entry["sha256"] for name, entry in document["files"].items()}
                document = _sealed(document["dataset"])
                DatasetFiles.of(document, path)
            if not isinstance(document["recipe"], dict) or not isinstance(document["source"]["sha256"], str):
                raise ValueError("recipe")
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            found = f"{type(error).__name__}: {quoted(str(error), 120)}"
            raise StoreError("not a publication of dancedata, or a damaged one", where=path, found=found) from error
        return cls(str(folder) if origin is None else origin.address, folder, document, files)

    def recipe(self, overrides: Overrides) -> Recipe:
        """Return its recipe, with keys changed: its files are not executed, and paths in it are refused."""
        document = deepcopy(dict(self.dataset["recipe"]))
        strange = ["plugins"] if "plugins" in document else list(_paths(document))
        if strange:
            raise RecipeError("a published recipe names no files or models of this machine; nothing was executed",
                              where=self.place, found=listed(strange),
                              fix="copy the recipe to a file, read it, and build that")  # fmt: skip
        try:
            return load_recipe(document, overrides)
        except UsageError as error:
            local = self.dataset.get("versions", {}).get("plugins")
            if not isinstance(local, Mapping) or not local:
                raise
            raise self._not_loaded(local, error) from error

    def _not_loaded(self, local: Mapping[str, Any], error: UsageError) -> UsageError:
        lines = []
        for name, file in local.items():
            stated = file.get("file") if isinstance(file, Mapping) else None
            path = self.folder / str(stated)
            if stated in self.files:
                require_file(path)
            where = f"published, here as {path}" if stated in self.files else f"{shown(stated)}, not published"
            lines.append(f"  - {shown(name)}: {where}")
        return UsageError("its local plug-ins are files, which a build from a publication does not execute by itself",
                          where=self.place, found="\n".join([str(error), *lines, ""]),
                          fix="read each file, and name it if you trust it: --plugin FILE, or "
                          "dancedata.load_plugins(FILE)")  # fmt: skip

    def record(self) -> SourceRecord:
        """Return the hashes of its source, clip by clip."""
        if not self.files:
            with open_store(self.folder) as store:
                return SourceRecord.of_store(store)
        try:
            rows = [parse_json(line) for line in self._read(_CLIPS_FILE).split("\n") if line]
            clips = dict(self.dataset["source"]["clips"])
            clips |= {str(row["id"]): str(row["made_of"]) for row in rows if row["made_of"]}
            about = {str(row["id"]): {**row, "lists": tuple(row["lists"])} for row in rows}
            rejects = tuple(Reject.from_json(row) for row in json_rejects(self._read(REJECTS_FILE)))
            content = {str(key): str(value) for key, value in self.dataset["source"].get("content", {}).items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            found = f"{type(error).__name__}: {quoted(str(error), 120)}"
            raise StoreError("a file of the publication is damaged", where=self.place, found=found) from error
        return SourceRecord(clips or None, rejects, content, about)

    def missing_beside(self, source: Path) -> Iterator[str]:
        """Yield a note for each file that was published beside the recipe and that the source does not have."""
        for name, sha256 in self.files.items():
            path = source / name
            is_there = path.is_file() and sha256_file(path) == sha256
            if name not in _WRITTEN and not name.endswith(".py") and not is_there:
                fetch = f"dancedata pull {self.place} fetches it; copy it to the source"
                yield f"the publication has {name}, and {source} does not: {fetch}"

    def _read(self, name: str) -> str:
        path = self.folder / name
        require_file(path)
        data = read_regular(path, MAX_LINES_BYTES)
        if sha256_bytes(data) != self.files[name]:
            raise StoreError("a file of the publication has other bytes than when it was published", where=path)
        return data.decode("utf-8")

    def warn(self, source_sha256: str, record: SourceRecord, progress: Progress) -> None:
        """Print the differences between a source and the published one, before anything is computed."""
        if source_sha256 != self.dataset["source"]["sha256"]:
            for difference in source_differences(self.record(), record, "in the publication", "in your source"):
                progress.write(f"another source than that of the publication: {difference}")

    def same(self, out: Path) -> bool:
        """Return whether a dataset has the same bytes: every shard, table and list."""
        with open_store(out) as store:
            return set(DatasetFiles(self.dataset).files()) == set(DatasetFiles(store.info).files())


def _sealed(document: Any) -> dict[str, Any]:
    """Return a document; ValueError unless its self_sha256 is that of its content."""
    stated, content = document["self_sha256"], self_hash(document)
    if stated != content:
        raise ValueError(f"self_sha256 {str(stated)[:12]}..., content {content[:12]}...")
    return dict(document)


def _paths(document: Any, at: str = "") -> Iterator[str]:
    """Yield the keys of a recipe that are paths of a machine, or settings of one: a dataset's recipe has none."""
    for key, value in document.items() if isinstance(document, Mapping) else ():
        name = f"{at}.{key}" if at else str(key)
        if isinstance(value, Mapping):
            for registry in (*SLOTS.values(), CONTACTS, FILTERS):
                plugin, _ = registry.split(str(key))
                if plugin in registry:
                    fields = dataclasses.fields(registry.get(plugin))
                    yield from (f"{name}.{f.name}" for f in fields if f.metadata.get("path") and f.name in value)
        yield from _paths(value, name)
