"""Foreign pickles: what is read, and what is refused without being run."""

from __future__ import annotations

import os
import pickle
import struct
from collections import Counter, OrderedDict
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy._core.multiarray import _reconstruct, scalar

from dancedata.core.errors import DataError
from dancedata.core.safe_pickle import load_pickle


class Call:
    """Pickles as a call of `function`, with a state set on its result."""

    def __init__(self, function: Any, *args: Any, state: Any = None) -> None:
        self.parts = (function, args) if state is None else (function, args, state)

    def __reduce__(self) -> Any:
        return self.parts


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "ä clip.pkl"


def refused(path: Path, data: bytes, reason: str) -> str:
    path.write_bytes(data)
    with pytest.raises(DataError) as error:
        load_pickle(path)
    assert error.value.reason == reason
    assert str(path) in str(error.value)
    return str(error.value)


@pytest.mark.parametrize("protocol", range(6))
def test_arrays_scalars_and_containers(path: Path, protocol: int) -> None:
    content = {
        "smpl_poses": np.arange(72, dtype=np.float32).reshape(3, 24),
        "fortran": np.asfortranarray(np.arange(6).reshape(2, 3)),
        "big": np.arange(4, dtype=">f8"),
        "empty": np.zeros((0, 3)),
        "text": np.array(["a", "длинный"]),
        "raw": np.array([b"x", b"yz"]),
        "flags": np.array([True, False]),
        "objects": np.array([None, "x", [1]], dtype=object),
        "scalar": np.float32(0.5),
        "big scalar": np.array([2.5], ">f4")[0],
        "plain": [1, 2.5, "x", b"\xff", b"", None, True, (1, (2,)), {3, 4}, frozenset({5}), 10**30],
        "ordered": OrderedDict(a=1),
    }
    path.write_bytes(pickle.dumps(content, protocol))
    back = load_pickle(path)
    plain = pickle.loads(path.read_bytes())  # numpy turns big-endian arrays to native ones
    assert list(back) == list(content)
    for name, value in content.items():
        if isinstance(value, np.ndarray | np.generic):
            assert type(back[name]) is type(value)
            assert back[name].dtype == plain[name].dtype
            np.testing.assert_array_equal(back[name], value)
        else:
            assert back[name] == value


def test_pickle_of_python_2(path: Path) -> None:
    """Array bytes as text, numpy under its old name, as AIST++'s own files have them."""
    values = np.array([1.5, -2.25])
    text = values.tobytes()
    data = (
        b"\x80\x02}q\x00U\nsmpl_transq\x01cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R"
        b"(K\x01K\x02\x85cnumpy\ndtype\nU\x02f8K\x00K\x01\x87R(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89"
        b"U" + bytes([len(text)]) + text + b"tbs."
    )
    path.write_bytes(data)
    np.testing.assert_array_equal(load_pickle(path)["smpl_trans"], values)


@pytest.mark.parametrize("protocol", range(6))
def test_code_is_not_run(path: Path, protocol: int, tmp_path: Path) -> None:
    target = tmp_path / "was_here"
    text = refused(path, pickle.dumps(Call(os.system, f"touch {target}"), protocol), "unsafe_pickle")
    assert "system" in text
    assert not target.exists()


@pytest.mark.parametrize(
    "value",
    [
        Counter("x"),
        Path("x"),
        Call(eval, "1"),
        Call(getattr, "", "x"),
        Call(bytearray, 10**12),
        Call(np.ndarray, (10**12,)),
        Call(np.lib.npyio.DataSource, "x"),
    ],
    ids=lambda v: type(v).__name__,
)
def test_names_that_are_not_on_the_list(path: Path, value: Any) -> None:
    refused(path, pickle.dumps(value), "unsafe_pickle")


@pytest.mark.parametrize("data", [b"ios\nsystem\n", b"(S'true'\nios\nsystem\n.", b"cos\nsystem\n(S'true'\ntR."])
def test_code_in_old_opcodes(path: Path, data: bytes) -> None:
    refused(path, data if data.startswith((b"(", b"c")) else b"(" + data + b".", "unsafe_pickle")


def forged(dtype: str, state: Any, shape: Any, data: Any) -> Call:
    return Call(
        _reconstruct,
        np.ndarray,
        (0,),
        b"b",
        state=(1, shape, Call(np.dtype, dtype, False, True, state=state), False, data),
    )


@pytest.mark.parametrize(
    "value",
    [
        # "No objects in here": numpy would take the bytes for pointers.
        forged("O8", (3, "|", None, None, None, -1, -1, 0), (1,), b"A" * 8),
        forged("f8", (3, "<", None, None, None, -1, -1, 63), (1,), [1]),
        forged("S8", (3, "|", None, None, None, -8, 1, 0), (1,), b"A" * 8),
        forged("f8", (3, "<", (np.dtype("O"), (1,)), None, None, -1, -1, 0), (1,), b"A" * 8),
        forged("f8", (3, "<", None, None, None, -1, -1, 0), (10**12,), b"A" * 8),
        forged("O8", (3, "|", None, None, None, -1, -1, 63), (10**12,), [1]),
        forged("f8", (), (1,), b"A" * 8),
        Call(_reconstruct, np.ndarray, (10**12,), b"b"),
        Call(scalar, np.dtype("O"), b"A" * 8),
        np.zeros(2, dtype=[("a", "O")]),
        np.zeros(2, dtype="M8[s]"),
    ],
)
def test_arrays_that_numpy_never_writes(path: Path, value: Any) -> None:
    refused(path, pickle.dumps(value, 2), "broken_file")


def test_array_of_an_arrays_memory(path: Path) -> None:
    """A view of an array that is then filled anew would read memory that is gone."""
    call = Call(np._core.numeric._frombuffer, np.arange(9.0), np.dtype("f8"), (9,), "C")
    refused(path, pickle.dumps(call, 2), "broken_file")


def test_state_of_anything_else(path: Path) -> None:
    # c _codecs encode, then its defaults set by BUILD with a tuple (None, {...})
    data = b"c_codecs\nencode\n(N}U\x0c__defaults__U\x04utf8\x85stb."
    refused(path, data, "unsafe_pickle")


@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_truncated_anywhere(path: Path, protocol: int) -> None:
    data = pickle.dumps({"a": np.arange(5.0), "b": [1, "x"]}, protocol)
    for length in range(len(data) - 1):
        path.write_bytes(data[:length])
        with pytest.raises(DataError) as error:
            load_pickle(path)
        # A name that is cut is another name.
        assert error.value.reason in ("broken_file", "unsafe_pickle")


@pytest.mark.parametrize(
    "data", [b"", b"no pickle", b"PK\x03\x04", b"\x80\x05.", b"<html>", b"\x82\x01.", b"\x80\x63."]
)
def test_no_pickle(path: Path, data: bytes) -> None:
    path.write_bytes(data)
    with pytest.raises(DataError):
        load_pickle(path)


def test_announced_sizes_take_no_memory(path: Path) -> None:
    for opcode in (pickle.BYTEARRAY8, pickle.BINBYTES8, pickle.BINUNICODE8, pickle.FRAME):
        refused(path, b"\x80\x05" + opcode + struct.pack("<Q", 1 << 50) + b"x.", "broken_file")


def test_flipped_bytes_do_not_crash(path: Path) -> None:
    data = bytearray(pickle.dumps({"a": np.arange(3.0), "b": np.array([b"xy"]), "c": np.float32(1)}, 4))
    for position in range(len(data)):
        for bit in (1, 8, 128):
            data[position] ^= bit
            path.write_bytes(data)
            with suppress(DataError):
                load_pickle(path)
            data[position] ^= bit


def test_missing_file(path: Path) -> None:
    with pytest.raises(DataError, match="cannot be read") as error:
        load_pickle(path)
    assert error.value.reason == "broken_file"
