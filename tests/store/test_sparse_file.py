"""SparseFile behaves as a file does."""

import io
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from dancedata.store.hdf5 import SparseFile


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 300_000), st.binary(min_size=1, max_size=200), st.integers(1, 900)), max_size=8)
)
def test_same_as_bytes_io(writes: list[tuple[int, bytes, int]]) -> None:
    sparse, plain = SparseFile(), io.BytesIO()
    for position, data, repeats in writes:
        for file in (sparse, plain):
            file.seek(position)
            assert file.write(data * repeats) == len(data) * repeats
    size = sparse.seek(0, io.SEEK_END)
    assert size == len(plain.getvalue())
    for position, data, _ in writes:
        sparse.seek(position)
        assert sparse.read(100) == plain.getvalue()[position : position + 100], data
    sparse.seek(0)
    assert sparse.readall() == plain.getvalue()


def test_copy_leaves_holes_and_keeps_the_size(tmp_path: Path) -> None:
    sparse = SparseFile()
    sparse.seek(10_000_000)
    sparse.write(b"end")
    sparse.truncate(20_000_000)
    with open(tmp_path / "f", "wb") as file:
        sparse.copy_to(file)
    data = (tmp_path / "f").read_bytes()
    assert len(data) == 20_000_000
    assert data[10_000_000:10_000_003] == b"end"
    assert data.count(0) == len(data) - 3
    assert len(sparse._pages) == 1
