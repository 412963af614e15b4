"""Tables of the corpus: the error names file and column, before HDF5 reads what is there."""

import json
from pathlib import Path

import pytest

from dancedata.core.errors import StoreError
from dancedata.core.hashing import self_hash, sha256_bytes
from dancedata.store import open_store
from tests.fuzz.conftest import tool

CORPUS = Path(__file__).parent / "corpus" / "hdf5"
#: Column and a word of the error, by file.
ERRORS = {
    "a-column-in-another-file": ("windows/start", "virtual or external"),
    "a-compound-of-columns": ("clips/genre", "type"),
    "a-link-to-a-column": ("clips/music", "SoftLink"),
    "a-table-elsewhere": ("clips", "ExternalLink"),
    "a-virtual-column": ("windows/start", "virtual or external"),
    "columns-of-another-length": ("clips/n_frames", "number of rows"),
    "gigabytes-of-ids": ("clips/id", "compression ratio"),
    "lists-in-a-circle": ("clips/lists/values/values", "Group"),
    "negative-frames": ("clips/n_frames", "out of bounds"),
    "no-such-clip": ("windows/clip", "out of bounds"),
    "no-texts-of-utf-8": ("clips/id", "UTF-8"),
    "numbers-for-texts": ("clips/genre", "type"),
    "offsets-below-0": ("clips/lists/offset", "ascend"),
    "offsets-outside-their-values": ("clips/lists/offset", "ascend"),
    "rows-outside-the-shard": ("clips/motion/pose", "outside"),
    "texts-of-variable-length": ("clips/id", "type"),
}


def test_every_file_has_its_error() -> None:
    assert {path.stem for path in CORPUS.iterdir()} == ERRORS.keys()


@pytest.mark.parametrize("name", ERRORS)
def test_errors_name_file_and_column(tmp_path: Path, name: str) -> None:
    files = {**tool("valid_files").store(), "tables.h5": (CORPUS / f"{name}.h5").read_bytes()}
    document = json.loads(files["dataset.json"])
    tables = files["tables.h5"]
    document["files"]["tables.h5"] = {"size": len(tables), "sha256": sha256_bytes(tables)}
    files["dataset.json"] = json.dumps({**document, "self_sha256": self_hash(document)}).encode()
    for file, data in files.items():
        (tmp_path / file).write_bytes(data)
    column, word = ERRORS[name]
    with open_store(tmp_path) as store, pytest.raises(StoreError, match=word) as error:
        list(store.clips())
    assert str(error.value.where) == f"{tmp_path / 'tables.h5'}, /{column}"
