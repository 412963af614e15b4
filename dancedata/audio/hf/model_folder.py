"""A folder with a model: where it is, its config, its weights and their hash. Needs no torch."""

import os
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from dancedata.core.errors import SourceError, UsageError
from dancedata.core.hashing import json_sha256
from dancedata.core.text import listed, shown
from dancedata.files.regular_file import read_regular
from dancedata.files.strict_json import read_json

#: Names the model unless a recipe does.
ENVIRONMENT = "DANCEDATA_HF_MODEL"
#: Files of a model that are read, and that `snapshot_download` gets: never code.
FILES = (
    "config.json", "preprocessor_config.json", "processor_config.json", "README.md",
    "model.safetensors", "model-*.safetensors", "model.safetensors.index.json",
    "pytorch_model.bin", "pytorch_model-*.bin", "pytorch_model.bin.index.json",
)  # fmt: skip
#: File of `dancedata pull hf://...` with the origin of a folder: id, revision, licence.
PROVENANCE = "dancedata-hf.json"
#: Configs with lists of labels and mel filters have a few MB.
_MAX_JSON = 1 << 25
#: Keys of config.json that shape no number.
_IDLE_KEYS = (
    "_name_or_path", "_commit_hash", "architectures", "auto_map", "dtype", "torch_dtype", "transformers_version",
)  # fmt: skip
_COMMIT = re.compile(r"[0-9a-f]{40}")
_HUB_ID = re.compile(r"[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*")
UNKNOWN = "unknown, see the model's page"
_MAX_CARD = 1 << 22
_MAX_LICENCE = 200


@dataclass(frozen=True)
class ModelFolder:
    """A folder in the layout that transformers saves models in.

    `extractor`: preprocessor_config.json, or the feature extractor of processor_config.json; else empty.
    `source`: The hub id, or the folder's name where that is not known.
    `revision`: The commit on the hub; "" where it is not known.
    `from_hub`: Whether it was named by its id, and found in the cache of the hub.
    """

    path: Path
    config: Mapping[str, Any]
    extractor: Mapping[str, Any]
    source: str
    revision: str = ""
    from_hub: bool = False

    def weight_files(self) -> tuple[Path, ...]:
        """Return the files of the weights: safetensors where there are any, or else pickles of torch."""
        if (self.path / "adapter_config.json").exists():
            raise SourceError("hf: the folder holds an adapter, which changes the network when it is loaded",
                              where=self.path, found="adapter_config.json",
                              fix="use the folder of a whole model")  # fmt: skip
        for name in ("model.safetensors", "pytorch_model.bin"):
            if (self.path / name).is_file():
                return (self.path / name,)
            if (self.path / f"{name}.index.json").is_file():
                return self._shards(self.path / f"{name}.index.json")
        raise SourceError("hf: the folder has no weights", where=self.path,
                          found=listed(sorted(p.name for p in self.path.iterdir())) or "an empty folder",
                          allowed="model.safetensors, pytorch_model.bin, or one of their indexes")  # fmt: skip

    def _shards(self, index: Path) -> tuple[Path, ...]:
        weight_map = _read_document(index).get("weight_map")
        names = {str(name) for name in weight_map.values()} if isinstance(weight_map, dict) else set()
        missing = sorted(names - {path.name for path in self.path.iterdir()})
        if missing or not names:
            problem, found = "hf: the index of the weights names files that are not in the folder", listed(missing)
            raise SourceError(problem, where=index, found=found or "no file", fix="fetch the model again")
        return tuple(self.path / name for name in sorted(names))

    def sha256(self, hash_file: Callable[[Path], str]) -> str:
        """Return the hash of what shapes the numbers: the weights, the config, the extractor's parameters."""
        return json_sha256(
            {
                "files": {path.name: hash_file(path) for path in self.weight_files()},
                "config": _shaping(self.config),
                "extractor": _shaping(self.extractor),
            }
        )


def open_model(model: str, revision: str | None = None) -> ModelFolder:
    """Find a model by its folder, or by its hub id in this machine's cache; read its config. No download."""
    named = model or os.environ.get(ENVIRONMENT, "")
    if not named:
        raise UsageError(
            "hf: the model is unknown", fix=f"set audio.hf.model in the recipe, or {ENVIRONMENT}, to its folder"
        )
    folder = Path(named).expanduser()
    if folder.is_dir():
        if revision:
            raise UsageError("hf: a revision is a commit of a model on the hub, and this is a folder", where=folder,
                             found=revision,
                             fix="omit revision; the weights are identified by their hash")  # fmt: skip
        provenance = _provenance_of(folder)
        return _read(
            folder.absolute(), provenance.get("id") or folder.absolute().name, provenance.get("revision", "")
        )
    if not _HUB_ID.fullmatch(named) or named.startswith((".", "/")):
        raise UsageError(
            "hf: the folder of the model does not exist", where=folder, fix="check the path, or give an id OWNER/NAME"
        )
    if revision is not None and not _COMMIT.fullmatch(revision):
        problem = "hf: a revision is a commit, as branches and tags move"
        raise UsageError(problem, where=named, found=revision, allowed="40 hexadecimal digits")
    from huggingface_hub import snapshot_download
    from huggingface_hub.errors import LocalEntryNotFoundError

    try:
        path = Path(snapshot_download(named, revision=revision, local_files_only=True, allow_patterns=list(FILES)))
    except (LocalEntryNotFoundError, ValueError) as error:
        raise UsageError(
            "hf: the model is not on this machine, and builds download nothing",
            where=named,
            fix=f"fetch it where there is a network: dancedata pull hf://{named}@{revision or 'COMMIT'} "
            "--out DIR; then set model to DIR, also on a cluster to which the folder was copied",
        ) from error
    return replace(_read(path, named, path.name), from_hub=True)


# `columns` is read once per clip.
@lru_cache(maxsize=16)
def _parsed(path: Path, state: tuple[int, int]) -> dict[str, Any]:
    try:
        document = read_json(path, _MAX_JSON)
    except (OSError, ValueError) as error:
        raise SourceError("hf: the file cannot be read", where=path, found=shown(error)) from error
    if not isinstance(document, dict):
        raise SourceError("hf: not a JSON object", where=path, found=shown(document))
    return document


def _read_document(path: Path) -> dict[str, Any]:
    """Read a JSON object of a model's folder; SourceError if it is not one."""
    try:
        status = path.stat()
    except OSError as error:
        raise SourceError("hf: the file does not exist", where=path) from error
    return _parsed(path, (status.st_mtime_ns, status.st_size))


def _provenance_of(folder: Path) -> dict[str, str]:
    """Return what PROVENANCE says: id, revision and licence, texts; empty without such a file."""
    if not (folder / PROVENANCE).is_file():
        return {}
    record = _read_document(folder / PROVENANCE)
    return {key: shown(value) for key, value in record.items() if isinstance(value, str)}


def _read(folder: Path, source: str, revision: str) -> ModelFolder:
    if not (folder / "config.json").is_file():
        raise SourceError("hf: the folder has no config.json, so it is not a model", where=folder,
                          found=listed(sorted(p.name for p in folder.iterdir())) or "an empty folder")  # fmt: skip
    extractor: dict[str, Any] = {}
    if (folder / "preprocessor_config.json").is_file():
        extractor = _read_document(folder / "preprocessor_config.json")
    elif (folder / "processor_config.json").is_file():
        inner = _read_document(folder / "processor_config.json").get("feature_extractor")
        extractor = inner if isinstance(inner, dict) else {}
    return ModelFolder(folder, _read_document(folder / "config.json"), extractor, source, revision)


def _shaping(document: Mapping[str, Any]) -> dict[str, Any]:
    return {
        key: _shaping(value) if isinstance(value, Mapping) else value
        for key, value in document.items()
        if key not in _IDLE_KEYS
    }


def licence_of(folder: Path) -> str:
    """Return the licence that the front matter of a folder's README.md states, or `pull` noted, or UNKNOWN."""
    licence = None
    with suppress(OSError, ValueError, yaml.YAMLError):
        text = read_regular(folder / "README.md", _MAX_CARD).decode("utf-8-sig", "replace")
        if text.lstrip().startswith("---"):
            from huggingface_hub import ModelCard

            card: Any = ModelCard(text, ignore_metadata_errors=True).data
            named = [str(part) for part in (card.get("license_name"), card.get("license_link")) if part]
            licence = card.license if card.license not in (None, "other") or not named else " ".join(named)
    return shown(licence or _provenance_of(folder).get("licence") or UNKNOWN, _MAX_LICENCE)
