"""docs/reference/store.md: its snippets read a dataset, and write one, without this package and without JSON."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.store import open_store, verify_store
from dancedata.testing.stores import RandomStore, random_fields, write_random_store
from dancedata.torch import WindowDataset

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "store.md"
READ, PANDAS, WRITE = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
SHOWN = "train_c00 motion/edge151 (30, 151)\ntrain_c00 audio/librosa35 (60, 35)\n"


@pytest.fixture
def made(tmp_path: Path) -> RandomStore:
    """Two fields of the page's names, music with two rows a frame."""
    fields = random_fields({"edge151": 151}, {"librosa35": 35}, librosa35=60)
    return write_random_store(tmp_path / "made", fields=fields)


def run(code: str, folder: Path) -> dict[str, Any]:
    """Run a snippet; nothing of it needs this package."""
    assert "dancedata" not in code
    names: dict[str, Any] = {"OUT": str(folder)}
    exec(code, names)
    return names


def test_a_window_is_read_with_h5py_alone(made: RandomStore, capsys: Any) -> None:
    names = run(READ, made.path)
    names["tables"].close()
    assert capsys.readouterr().out == SHOWN
    np.testing.assert_array_equal(names["window"], made.rows("train_c00", "librosa35", 0, 30))


def windows_by_h5py(folder: Path, field: str) -> list[np.ndarray]:
    """Read every window of a dataset as the page reads the first one."""
    code = READ.replace('("motion/edge151", "audio/librosa35")', f'("{field}",)')
    with dancedata.open(folder) as store:
        n = sum(len(store.windows(split)) for split in store.splits)
    rows = []
    for number in range(n):
        names = run(code.replace('{name}"][0]', f'{{name}}"][{number}]'), folder)
        names["tables"].close()
        rows.append(names["window"])
    return rows


@pytest.mark.parametrize("field", ["motion/edge151", "audio/librosa35"])
def test_h5py_reads_the_windows_that_dancedata_reads(made: RandomStore, field: str) -> None:
    theirs = windows_by_h5py(made.path, field)
    with open_store(made.path) as store:
        ours = [store.read(w, field.split("/")[1]) for split in store.splits for w in store.windows(split)]
    assert len(ours) == len(theirs) > 20
    assert all(np.array_equal(a, b) for a, b in zip(ours, theirs, strict=True))


def test_columns_with_pandas(made: RandomStore) -> None:
    pytest.importorskip("pandas")
    names = run(READ + PANDAS.replace("print(", "frame = ("), made.path)
    names["tables"].close()
    assert names["frame"]["id"].tolist() == [clip.id for clip in made.clips]
    assert set(names["frame"]["split"]) == {"train", "val", "test"}


def test_a_dataset_that_h5py_wrote_is_opened_checked_and_read(tmp_path: Path) -> None:
    names = run(WRITE, tmp_path / "own")
    rows = np.random.default_rng(0).normal(size=(90, 15)).astype(np.float32)
    assert verify_store(tmp_path / "own") == []
    with open_store(tmp_path / "own") as store:
        assert names["document"]["splits"]["train"]["windows"] == len(store.windows("train")) == 5
        assert store.rejects == store.quality == []
        for window in store.windows("train"):
            np.testing.assert_array_equal(store.read(window, "points"), rows[window.start : window.start + 30])
        np.testing.assert_array_equal(store["walk"]["points"], rows)
    samples = WindowDataset(tmp_path / "own", "train", scale=None)
    np.testing.assert_array_equal(samples[2]["points"].numpy(), rows[30:60])


@pytest.mark.nightly
@pytest.mark.parametrize("version", ["==3.11.*", ""])
def test_the_page_where_this_package_is_not_installed(made: RandomStore, tmp_path: Path, version: str) -> None:
    packages = tmp_path / "packages"
    install = [sys.executable, "-m", "pip", "install", "-q", "--target", str(packages), f"h5py{version}", "pandas"]
    subprocess.run(install, check=True)
    code = f"import sys; sys.path.insert(0, {str(packages)!r}); OUT = {str(made.path)!r}\n{READ}{PANDAS}"
    code += f"OUT = {str(tmp_path / 'own')!r}\n{WRITE}import importlib.util as i\nprint(i.find_spec('dancedata'))\n"
    done = subprocess.run([sys.executable, "-I", "-S", "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.startswith(SHOWN)
    assert done.stdout.endswith("None\n")
    assert verify_store(tmp_path / "own") == []
