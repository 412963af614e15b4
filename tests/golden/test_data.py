"""The compact set of reference outputs: small, described, the reference's own bits; and one line for the rest."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import DATA, Arrays, unpack


def test_it_is_small_and_its_files_are_described() -> None:
    files = [path for path in DATA.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) <= 10_000_000
    readme = (DATA / "README.md").read_text()
    for path in files:
        name = path.relative_to(DATA).as_posix()
        known = re.findall(r"`((?:peers|metrics|jukebox|bailando438|humanml263|beat_this|crowd)[^`]*)`", readme)
        assert name == "README.md" or any(name.startswith(k.rstrip("*")) for k in known), name


@pytest.mark.parametrize("part", ["peers", "metrics", "bailando438", "humanml263"])
def test_arrays_are_the_references_own(shared: Path, tmp_path: Path, part: str) -> None:
    files = sorted(unpack(DATA / part, tmp_path).glob("*.npz"))
    assert len(files) >= {"peers": 12, "metrics": 3}.get(part, 1)
    for path in files:
        compact = Arrays(path)
        with np.load(shared / "golden" / part / path.name) as whole:
            for key in compact:  # windows/ has those of the dances that are here
                if whole[key].dtype.kind in "fiub" and whole[key].ndim and not key.startswith("windows/"):
                    index = np.ix_(*(compact.index(key, axis) for axis in range(whole[key].ndim)))
                    np.testing.assert_array_equal(whole[key][index], compact[key], err_msg=f"{path.name} {key}")
                    assert compact.shape(key) == whole[key].shape


@pytest.mark.parametrize("peers", ["compact"], indirect=True)
def test_inputs_are_the_references_own(shared: Path, peers: Any) -> None:
    inputs = shared / "golden" / "peers" / "inputs"
    for path in sorted((peers / "inputs").rglob("*")):
        other = inputs / path.relative_to(peers / "inputs")
        if path.suffix == ".npy":
            columns, wanted = np.load(path), np.load(other)
            body = slice(None) if path.stem == "001" else slice(3 + 22 * 6)
            np.testing.assert_array_equal(columns[:, body], wanted[:, body])
            assert columns.shape == wanted.shape
        elif path.suffix in (".pkl", ".json", ".txt"):
            assert path.read_bytes() == other.read_bytes()
