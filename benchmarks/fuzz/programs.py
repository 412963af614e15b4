"""Pickles as programs: values wrapped in each other in ways that no pickler writes."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

from hypothesis import strategies as st
from valid_files import pickles

Draw = Callable[[st.SearchStrategy[Any]], Any]

_TEXTS = st.one_of(st.text(max_size=9), st.sampled_from(["\ud800", "\x1b[2J", "latin1", "f8", "O", "x" * 5000]))
_KEYS_OF_MOTION = st.sampled_from(["smpl_poses", "smpl_trans", "smpl_scaling", "poses", "trans", "fps"])


def _code(name: str) -> bytes:
    return bytes(getattr(pickle, name))


def _named(module: str, name: str) -> bytes:
    return _code("GLOBAL") + f"{module}\n{name}\n".encode("utf-8", "surrogatepass")


def _whole(number: int) -> bytes:
    return pickle.dumps(number, 2)[2:-1]


def _short_text(text: str) -> bytes:
    return pickle.dumps(text, 2)[2:-1]


#: Whole numbers with one hash.
_COLLIDING = st.integers(1, 2000).map(lambda k: _whole(k * ((1 << 61) - 1)))
ATOMS = st.one_of(
    st.sampled_from([b"N", b")", b"]", b"}", b"\x88", b"K\x01", _code("EMPTY_SET"), b"C\x04abcd", b"G" + bytes(8)]),
    st.integers().map(_whole),
    _TEXTS.map(_short_text),
    _COLLIDING,
    st.sampled_from([1 << 62, 1 << 64, (1 << 2000) - 1, -(1 << 70)]).map(_whole),
)
_CALLABLES = st.sampled_from(
    [
        ("numpy", "ndarray"),
        ("numpy", "dtype"),
        ("_codecs", "encode"),
        ("collections", "OrderedDict"),
        ("numpy.core.multiarray", "_reconstruct"),
        ("numpy._core.multiarray", "scalar"),
        ("numpy._core.numeric", "_frombuffer"),
        ("builtins", "set"),
        ("builtins", "frozenset"),
        ("__builtin__", "bytes"),
        ("os", "system"),
        ("\ud800\x1b[2J", "x" * 900),
    ]
)
#: What a value on the stack becomes: held twice by a tuple, repeated in lists, nested, a key, a member, an argument.
AROUND = st.one_of(
    st.integers(1, 60).map(lambda n: b"2\x86" * n),
    st.tuples(st.integers(1, 3), st.sampled_from([5, 100, 2000])).map(lambda d: _doubled(*d)),
    st.sampled_from([1, 45, 3000, 30_000]).map(lambda n: b"\x85" * n),
    st.sampled_from([1, 45, 3000]).map(lambda n: b"".join(b"q\x07" + b"0]h\x07a" for _ in range(n))),
    st.sampled_from([1, 45, 3000]).map(lambda n: _object_array(b"K\x01\x85") * n),
    st.sampled_from(
        [b"q\x070}h\x07Ns", b"q\x070\x8f(h\x07\x90", b"q\x070(h\x07\x91", b"q\x070(h\x07Nd", b"\x85R", b"b", b"p7\n"]
    ),
    _CALLABLES.map(lambda name: b"q\x070" + _named(*name) + b"h\x07\x85R"),
    _CALLABLES.map(lambda name: b"q\x070" + _named(*name) + b"K\x01h\x07\x86R"),
    st.sampled_from([b"h\x07", b"K\x05" * 30_000]).map(lambda entry: _object_array(b"(" + entry + b"t")),
    st.integers(2, 3000).map(lambda n: b"q\x070](" + b"h\x07" * n + b"e"),
)


def _doubled(depth: int, width: int) -> bytes:
    """A list that repeats one list, which repeats another, and so on."""
    return b"".join(b"q\x070](" + b"h\x07" * width + b"e" for _ in range(depth))


def _object_array(shape: bytes) -> bytes:
    """The value on the stack in an array of objects of this shape."""
    array = b"q\x070" + _named("numpy.core.multiarray", "_reconstruct") + _named("numpy", "ndarray")
    dtype = (
        _named("numpy", "dtype") + b"\x8c\x02O8\x89\x88\x87R(K\x03\x8c\x01|NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK?tb"
    )
    return array + b"K\x00\x85C\x01b\x87R(K\x01" + shape + dtype + b"\x89](h\x07etb"


@st.composite
def programs(draw: Draw) -> bytes:
    """Pickles as programs: values wrapped in each other in ways that no pickler writes."""
    value = draw(ATOMS) + b"".join(draw(st.lists(AROUND, min_size=1, max_size=3)))
    if draw(st.integers(0, 5)) == 0:
        many = draw(st.lists(_COLLIDING, min_size=200, max_size=400)) * draw(st.sampled_from([1, 50]))
        value = draw(st.sampled_from([b"\x8f(%s\x90", b"(%s\x91", b"](%s)\x85", b"(%sd", b"(%st"])) % b"".join(many)
    names = draw(st.lists(_KEYS_OF_MOTION, min_size=1, max_size=3))
    items = b"".join(_short_text(name) + value for name in names)
    start = pickle.dumps(pickle.loads(pickles()[0]), 2)[:-1]
    ending = draw(st.sampled_from([b"(" + items + b"u.", value + b"Ns.", value + b"."]))
    return start + ending
