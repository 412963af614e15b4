"""Small files that cost a reader much: pickles as programs, and sound with rates that no sound has.

All pickles but the first few have AIST++'s layout, with the hurtful part where a value, a key or a state is.
"""

from __future__ import annotations

import pickle
import struct
from collections.abc import Callable

from valid_files import pickles

_HASH = (1 << 61) - 1
_RECONSTRUCT = b"cnumpy.core.multiarray\n_reconstruct\n"
_NDARRAY = b"cnumpy\nndarray\n"
_DTYPE = b"cnumpy\ndtype\n"
_OBJECTS = _DTYPE + b"\x8c\x02O8\x89\x88\x87R(K\x03\x8c\x01|NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK?tb"
#: A tuple that holds itself twice, and that one itself twice, 59 levels deep: 2^59 ends.
_DOUBLED = b"K\x01" + b"2\x86" * 59


def _key(key: bytes) -> bytes:
    """AIST++'s dict with one key more."""
    return _motion() + key + b"Ns."


def _value(value: bytes) -> bytes:
    """AIST++'s dict with other poses."""
    return _motion() + b"\x8c\x0asmpl_poses" + value + b"s."


def _motion() -> bytes:
    return pickle.dumps(pickle.loads(pickles()[0]), 2).removesuffix(b".")


def _whole(number: int) -> bytes:
    return pickle.dumps(number, 2)[2:-1]


def _colliding(count: int, after: bytes = b"") -> bytes:
    """Whole numbers of one hash, each followed by something."""
    return b"".join(_whole(k * _HASH) + after for k in range(1, count + 1))


def _list_of_lists(depth: int, width: int) -> bytes:
    """A list that repeats one list, which repeats another, and so on."""
    return b"](" + b"K\x01" * width + b"e" + (b"q\x630](" + b"hc" * width + b"e") * (depth - 1)


def _array(shape: bytes, data: bytes, dtype: bytes = _OBJECTS) -> bytes:
    return _RECONSTRUCT + _NDARRAY + b"K\x00\x85C\x01b\x87R(K\x01" + shape + dtype + b"\x89" + data + b"tb"


def _nested_arrays(depth: int) -> bytes:
    """An array of an object that is such an array, and so on."""
    array = _array(b"K\x01\x85", b"](hce")
    return b"N" + (b"q\x630" + array) * depth


def _copies(count: int) -> bytes:
    """A list of copies of one text of a megabyte."""
    text = b"\x8d" + struct.pack("<Q", 1 << 20) + b"a" * (1 << 20)
    return text + b"q\x630c_codecs\nencode\nqd0](" + b"hdhc\x85R" * count + b"e"


def _long(text: bytes) -> bytes:
    return b"\x8d" + struct.pack("<Q", len(text)) + text


def _wav(rate: int, n_samples: int = 100_000) -> bytes:
    fmt = struct.pack("<HHIIHH", 1, 1, rate, rate, 1, 8)
    data = b"data" + struct.pack("<I", n_samples) + bytes(n_samples)
    return b"RIFF" + struct.pack("<I", 36 + n_samples) + b"WAVEfmt " + struct.pack("<I", 16) + fmt + data


PICKLES: dict[str, Callable[[], bytes]] = {
    "key_that_holds_itself": lambda: _key(_DOUBLED),
    "dtype_of_what_holds_itself": lambda: _value(_DTYPE + _DOUBLED + b"\x85R"),
    "encoding_that_holds_itself": lambda: _value(b"c_codecs\nencode\n\x8c\x01a" + _DOUBLED + b"\x86R"),
    "shape_of_huge_numbers": lambda: _value(
        _array(b"(" + _whole(1 << 2030) + b"q\x63" + b"hc" * 200_000 + b"t", b"]")
    ),
    "set_of_one_hash": lambda: _value(b"\x8f(" + _colliding(60_000) + b"\x90"),
    "called_set_of_one_hash": lambda: _value(b"c__builtin__\nset\n](" + _colliding(60_000) + b"e\x85R"),
    "frozenset_of_one_hash": lambda: _value(b"(" + _colliding(60_000) + b"\x91"),
    "keys_of_one_hash": lambda: _value(b"}(" + _colliding(60_000, b"N") + b"u"),
    "pairs_of_one_hash": lambda: _value(
        b"ccollections\nOrderedDict\n](" + _colliding(60_000, b"K\x01\x86") + b"e\x85R"
    ),
    "memory_of_one_hash": lambda: b"".join(b"Np%d\n0" % (k * _HASH) for k in range(1, 60_001)) + b"N.",
    "shared_lists_2": lambda: _value(_list_of_lists(2, 11_000)),
    "shared_lists_3": lambda: _value(_list_of_lists(3, 2500)),
    "deep_key": lambda: _key(b")" + b"\x85" * 300_000),
    "deep_value": lambda: _value(b")" + b"\x85" * 300_000),
    "deep_lists": lambda: _value(b"]" * 300_000 + b"a" * 299_999),
    "deep_arrays": lambda: _value(_nested_arrays(30_000)),
    "array_filled_twice": lambda: _value(
        _array(b"K\x00\x85", b"]") + b"q\x63(K\x01K\x01\x85" + _OBJECTS + b"\x89](hcetb"
    ),
    "list_in_itself": lambda: _value(b"]q\x63hca"),
    "copies_of_a_text": lambda: _value(_copies(2000)),
    "array_with_an_item_set": lambda: _value(_array(b"K\x00\x85", b"]") + b"K\x00Ns"),
    "long_name": lambda: _value(b"\x8d" + struct.pack("<Q", 10 << 20) + b"a" * (10 << 20) + b"\x8c\x01b\x93"),
    "long_type": lambda: _value(_DTYPE + _long(b"f4," * 500_000) + b"\x85R"),
    "half_characters": lambda: b"\x80\x04\x8c\x03\xed\xa0\x80\x8c\x03\xed\xa0\x80\x93.",
    "half_characters_as_keys": lambda: b"\x80\x04}\x8c\x03\xed\xa0\x80Ns.",
    "many_keys": lambda: b"\x80\x04}(" + b"".join(b"\x8c\x06%06dN" % k for k in range(50_000)) + b"u.",
    "control_characters": lambda: b"\x80\x04c\x1b[2J\x9b1m\n\x07name\r\n.",
}
SOUNDS: dict[str, Callable[[], bytes]] = {
    "1_hertz": lambda: _wav(1),
    "7_hertz": lambda: _wav(7),
    "3999_hertz": lambda: _wav(3999),
    "2_gigahertz": lambda: _wav(2_000_000_000),
}
