"""Foreign pickles: what is read, and what is refused without being run."""

import os
import pickle
import struct
from collections import Counter, OrderedDict
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy._core.multiarray import _reconstruct, scalar

from dancedata.core.errors import DataError
from dancedata.formats.safe_pickle import as_array, load_pickle
from tests.messages import raises_message, refused_file


class Call:
    """Pickles as a call of `function`, with a state set on its result."""

    def __init__(self, function: Any, *args: Any, state: Any = None) -> None:
        self.parts = (function, args) if state is None else (function, args, state)

    def __reduce__(self) -> Any:
        return self.parts


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "ä clip.pkl"


refused = partial(refused_file, load_pickle)


@pytest.mark.parametrize("protocol", range(6))
def test_arrays_scalars_and_containers(path: Path, protocol: int) -> None:
    content = {
        "smpl_poses": np.arange(72, dtype=np.float32).reshape(3, 24),
        "fortran": np.asfortranarray(np.arange(6).reshape(2, 3)), "big": np.arange(4, dtype=">f8"),
        "empty": np.zeros((0, 3)), "text": np.array(["a", "длинный"]), "raw": np.array([b"x", b"yz"]),
        "flags": np.array([True, False]), "objects": np.array([None, "x", [1]], dtype=object),
        "scalar": np.float32(0.5), "big scalar": np.array([2.5], ">f4")[0],
        "plain": [1, 2.5, "x", b"\xff", b"", None, True, (1, (2,)), {3, 4}, frozenset({5}), 10**30],
        "ordered": OrderedDict(a=1),
    }  # fmt: skip
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


#: Names that are not on the list, code in old opcodes, states and objects that are made in other ways.
UNSAFE = [
    *map(pickle.dumps, (
        Counter("x"), Path("x"), Call(eval, "1"), Call(getattr, "", "x"), Call(bytearray, 10**12),
        Call(np.ndarray, (10**12,)), Call(np.lib.npyio.DataSource, "x"),
    )),
    b"(ios\nsystem\n.", b"(S'true'\nios\nsystem\n.", b"cos\nsystem\n(S'true'\ntR.",
    # c _codecs encode, then its defaults set by BUILD with a tuple (None, {...})
    b"c_codecs\nencode\n(N}U\x0c__defaults__U\x04utf8\x85stb.",
    b"\x80\x02c__builtin__\nset\n)\x81.", b"(c__builtin__\nset\no.", b"(i__builtin__\nset\n.", b"\x80\x02NNR.",
    b"\x80\x05\x97.", b"\x80\x05C\x01a\x98.",
]  # fmt: skip


def forged(dtype: str, state: Any, shape: Any, data: Any) -> Call:
    return Call(
        _reconstruct,
        np.ndarray,
        (0,),
        b"b",
        state=(1, shape, Call(np.dtype, dtype, False, True, state=state), False, data),
    )


#: State of float64 in native order.
F8 = (3, "<", None, None, None, -1, -1, 0)
#: Arrays that numpy never writes, whose shapes and types are looked at before numpy sees them.
FORGED = [
    # "No objects in here": numpy would take the bytes for pointers.
    forged("O8", (3, "|", None, None, None, -1, -1, 0), (1,), b"A" * 8),
    forged("f8", (3, "<", None, None, None, -1, -1, 63), (1,), [1]),
    forged("S8", (3, "|", None, None, None, -8, 1, 0), (1,), b"A" * 8),
    forged("f8", (3, "<", (np.dtype("O"), (1,)), None, None, -1, -1, 0), (1,), b"A" * 8),
    forged("O8", (3, "|", None, None, None, -1, -1, 63), (10**12,), [1]),
    forged("f8", (3, "<", None, None, None, (-1,), -1, 0), (1,), b"A" * 8), forged("f8", (), (1,), b"A" * 8),
    *(forged("f8", F8, shape, b"A" * 8) for shape in ((10**12,), (2,) * 40, (1 << 70,), [1], (True,))),
    Call(_reconstruct, np.ndarray, (10**12,), b"b"), Call(scalar, np.dtype("O"), b"A" * 8),
    np.zeros(2, dtype=[("a", "O")]), np.zeros(2, dtype="M8[s]"),
    Call(np.dtype, "f8,f8", False, True), Call(np.dtype, ("f8", "<"), False, True),
    Call(np._core.numeric._frombuffer, b"A" * 8, np.dtype("f8"), (1,), "A"),
    Call(np._core.numeric._frombuffer, b"A" * 8, np.dtype("f8"), (1,), "K", [0]),
    # A view of an array that is then refilled would read freed memory.
    Call(np._core.numeric._frombuffer, np.arange(9.0), np.dtype("f8"), (9,), "C"),
]  # fmt: skip
BROKEN = [
    *(pickle.dumps(value, 2) for value in FORGED),
    # Containers that are filled in other ways, and sizes that are announced: they take no memory.
    b"\x80\x02]K\x00Ns.", b"\x80\x02}Na.", b"\x80\x04\x8f(K\x01e.",
    *(b"\x80\x05" + opcode + struct.pack("<Q", 1 << 50) + b"x."
      for opcode in (pickle.BYTEARRAY8, pickle.BINBYTES8, pickle.BINUNICODE8, pickle.FRAME)),
    # Containers are counted: an empty set is one byte of a file and 216 of memory.
    *(b"\x80\x04](" + code * 200_000 + b"e." for code in (b"\x8f", b"]", b"}", b"(\x91", b")\x85", b"(")),
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(UNSAFE)))
def test_what_could_run_is_refused(path: Path, number: int) -> None:
    refused(path, UNSAFE[number], "unsafe_pickle")


@pytest.mark.parametrize("number", range(len(BROKEN)))
def test_what_no_program_writes_is_refused(path: Path, number: int) -> None:
    refused(path, BROKEN[number], "broken_file")


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


def test_flipped_bytes_do_not_crash(path: Path) -> None:
    data = bytearray(pickle.dumps({"a": np.arange(3.0), "b": np.array([b"xy"]), "c": np.float32(1)}, 4))
    for position in range(len(data)):
        for bit in (1, 8, 128):
            data[position] ^= bit
            path.write_bytes(data)
            with suppress(DataError):
                load_pickle(path)
            data[position] ^= bit


def test_a_missing_file_and_a_pipe(path: Path) -> None:
    for make in (lambda path: None, os.mkfifo):
        make(path)
        with raises_message(DataError, "pickle", where="ä clip.pkl", reason="broken_file"):
            load_pickle(path)


@pytest.mark.parametrize(
    "value",
    [
        {(1, 2): 3}, {1 << 63: 3}, {"a": {np.longdouble(1): 3}}, OrderedDict({(): 1}), {frozenset()},
        [frozenset({(1,)})],
    ],
)  # fmt: skip
@pytest.mark.parametrize("protocol", range(6))
def test_keys_have_hashes_that_are_short_and_differ(path: Path, protocol: int, value: Any) -> None:
    assert "a key" in refused(path, pickle.dumps(value, protocol), "broken_file")


@pytest.mark.parametrize("protocol", range(6))
def test_keys_of_numpy_are_those_of_python(path: Path, protocol: int) -> None:
    """WHAM names its people by the numbers of numpy.unique."""
    kinds = (np.int64, np.int32, np.uint8, np.uint64, np.str_, np.bytes_, np.float64, np.bool_)
    for kind in kinds:
        path.write_bytes(pickle.dumps({kind(1): {kind(0): "x"}}, protocol))
        key = kind(1).item()
        back = load_pickle(path)
        assert back == {key: {kind(0).item(): "x"}}
        assert [type(name) for name in back] == [type(key)]
    plain = {2.5: 1, None: 2, True: 3, "a": 4, 5: 6, -(1 << 62): 7}
    path.write_bytes(pickle.dumps(plain, protocol))
    assert load_pickle(path) == plain


def test_nesting_is_read_and_freed(path: Path) -> None:
    depth = 90_000
    for data in (b"]" * depth + b"a" * (depth - 1), b")" + b"\x85" * depth, b"NNN" + b"}NNs" + b"\x85" * depth):
        path.write_bytes(b"\x80\x02" + data + b".")
        back, n = load_pickle(path), 0
        while back and isinstance(back, list | tuple):
            back, n = back[0], n + 1
        assert n >= depth - 1
    path.write_bytes(b"\x80\x02]q\x00h\x00a.")
    back = load_pickle(path)
    assert back[0] is back


def test_an_array_with_axes_in_another_order(path: Path) -> None:
    values = np.arange(24.0).reshape(2, 3, 4).transpose(2, 0, 1)
    for protocol in range(6):
        path.write_bytes(pickle.dumps(values, protocol))
        np.testing.assert_array_equal(load_pickle(path), values)


def test_arrays_of_objects_do_not_hold_each_other(path: Path) -> None:
    inner = np.array([None, "x"], dtype=object)
    ragged = np.array([np.arange(2.0), np.arange(3.0)], dtype=object)
    path.write_bytes(pickle.dumps(ragged, 4))
    assert [len(row) for row in load_pickle(path)] == [2, 3]
    outer = np.empty(1, dtype=object)
    outer[0] = inner
    refused(path, pickle.dumps(outer, 4), "broken_file")


def test_a_pickle_builds_no_more_than_it_holds(path: Path) -> None:
    """One text of 100 kB, made to bytes or to an array a hundred times; one list, made to a set or to an array."""
    text = b"X" + struct.pack("<I", 100_000) + b"a" * 100_000 + b"q\x000"
    ints = b"](" + b"".join(b"M" + struct.pack("<H", k) for k in range(30_000)) + b"eq\x000"
    empty = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85U\x01b\x87R(K\x01"
    kind = b"\x85cnumpy\ndtype\nU\x02%s\x89\x88\x87R(K\x03U\x01|NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK%stb\x89h\x00tb"
    for content, call in (
        (text, b"c_codecs\nencode\nh\x00\x85R"),
        (text, empty + b"J" + struct.pack("<I", 100_000) + kind % (b"i1", b"\x00")),
        (ints, b"c__builtin__\nset\nh\x00\x85R"),
        (ints, empty + b"M" + struct.pack("<H", 30_000) + kind % (b"O8", b"?")),
    ):
        path.write_bytes(b"\x80\x02" + content + b"](" + call + b"e.")
        assert len(load_pickle(path)) == 1
        calls = b"](" + call * 100 + b"e."
        assert "builds far more than its own size" in refused(path, b"\x80\x02" + content + calls, "broken_file")
    # Whatever numpy writes is far below that.
    for protocol in range(6):
        path.write_bytes(pickle.dumps([np.full(10, n) for n in range(300)], protocol))
        assert len(load_pickle(path)) == 300


@pytest.mark.parametrize(
    ("value", "dtype"),
    [
        (np.arange(3.0), "float64"), (np.float32(1.5), "float32"), ([1, 2.5, np.float32(2)], "float64"),
        ((1, 2), "int64"), (7, "int64"), ([], "float64"),
        *((value, None) for value in ([[1.0]], [[1], [2]], "text", None, [True], {1: 2}, [1, None])),
    ],
)  # fmt: skip
def test_values_that_are_arrays(value: Any, dtype: str | None) -> None:
    assert getattr(as_array(value), "dtype", None) == dtype


def test_a_pickle_that_is_too_large(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dancedata.formats.safe_pickle.MAX_PICKLE_BYTES", 100)
    assert "larger than 100 bytes" in refused(path, pickle.dumps("x" * 200), "broken_file")
