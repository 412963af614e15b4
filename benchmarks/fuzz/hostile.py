"""Small files that cost a reader much: pickles as programs, and sound with rates that no sound has.

Most pickles have AIST++'s layout, with the hurtful part where a value, a key or a state is. `python
benchmarks/fuzz/hostile.py` reads each file in a process of its own and prints what became of it.
"""

from __future__ import annotations

import io
import pickle
import struct
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
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


def _repeated(made: bytes, call: bytes, count: int) -> bytes:
    """A list of what a call makes of one value, each time anew."""
    return made + b"q\x630](" + call * count + b"e"


def _many_numbers(count: int) -> bytes:
    return b"](" + b"".join(b"M" + struct.pack("<H", k) for k in range(count)) + b"e"


def _arrays_within_lists(depth: int) -> bytes:
    """An array of a list of such an array, and so on."""
    return b"N" + (b"q\x630" + _array(b"K\x01\x85", b"](](hcee")) * depth


def _joblib(count: int) -> bytes:
    """Arrays of objects as joblib writes them, each a pickle that makes bytes of one text of 100 kB ten times."""
    wrapper = (
        b"cjoblib.numpy_pickle\nNumpyArrayWrapper\n)\x81}(\x8c\x08subclass" + _NDARRAY + b"\x8c\x05shapeK\x0a\x85"
        b"\x8c\x05order\x8c\x01C\x8c\x05dtype" + _DTYPE + b"\x8c\x02O8\x89\x88\x87Rub"
    )
    text = _long(b"a" * 100_000) + b"q\x630c_codecs\nencode\nqd0"
    inner = text + _array(b"K\x0a\x85", b"](" + b"hdhc\x85R" * 10 + b"e") + b"."
    return b"\x80\x04](" + (wrapper + inner) * count + b"e."


def _torch(pickled: bytes, storage: bytes = bytes(16), method: int = zipfile.ZIP_STORED) -> bytes:
    """A file of torch.save with this pickle and one storage."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as archive:
        for name, data in (("data.pkl", b"\x80\x02" + pickled + b"."), ("version", b"3"), ("data/0", storage)):
            archive.writestr(f"a/{name}", data)
    return file.getvalue()


def _storage(count: int) -> bytes:
    text = lambda value: b"X" + struct.pack("<I", len(value)) + value  # noqa: E731
    return b"(" + text(b"storage") + b"ctorch\nFloatStorage\n" + text(b"0") + text(b"cpu") + _whole(count)


def _tensor(count: int, rows: int, step: int) -> bytes:
    layout = b"K\x00" + _whole(rows) + b"\x85" + _whole(step) + b"\x85\x89ccollections\nOrderedDict\n)R"
    return b"ctorch._utils\n_rebuild_tensor_v2\n(" + _storage(count) + b"tQ" + layout + b"tR"


def _torch_before_1_6(count: int) -> bytes:
    head = b"".join(pickle.dumps(n, 2) for n in (0x1950A86A20F9469CFC6C, 1001, {"little_endian": True}))
    tensor = _tensor(count, 4, 1).replace(b"tQ", b"NtQ")
    return head + b"\x80\x02" + tensor + b"." + pickle.dumps(["0"], 2) + struct.pack("<q", count) + bytes(16)


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
    "sets_of_one_list": lambda: _value(_repeated(_many_numbers(60_000), b"c__builtin__\nset\nhc\x85R", 3000)),
    "arrays_of_one_list": lambda: _value(_repeated(_many_numbers(60_000), _array(b"M\x60\xea\x85", b"hc"), 3000)),
    "arrays_within_lists": lambda: _value(_arrays_within_lists(30_000)),
    "packed_sets": lambda: zlib.compress(b"\x80\x04](" + b"\x8f" * 30_000_000 + b"e.", 1),
    "pickles_in_a_pickle": lambda: _joblib(50),
    "view_of_an_array_that_is_filled": lambda: _value(_RECONSTRUCT + _NDARRAY + b"K\x00\x85C\x01b\x87R\x98"),
    "control_characters": lambda: b"\x80\x04c\x1b[2J\x9b1m\n\x07name\r\n.",
}
TORCH: dict[str, Callable[[], bytes]] = {
    "bytes_of_a_number": lambda: _torch(b"c__builtin__\nbytearray\nJ\xff\xff\xff\x7f\x85R"),
    "tensor_of_a_number": lambda: _torch(b"ctorch\nFloatTensor\nJ\xff\xff\xff\x7f\x85R"),
    "torch_key_that_holds_itself": lambda: _torch(b"}" + _DOUBLED + b"Ns"),
    "one_number_for_a_billion": lambda: _torch(_tensor(4, 500_000_000, 0)),
    "storage_of_a_terabyte": lambda: _torch_before_1_6(1 << 38),
    "packed_storage": lambda: _torch(_tensor(75_000_000, 4, 1), bytes(300_000_000), zipfile.ZIP_DEFLATED),
    "array_of_addresses": lambda: _torch(
        _RECONSTRUCT + _NDARRAY + b"K\x00\x85U\x01b\x87R(K\x01K\x01\x85" + _DTYPE
        + b"U\x02O8\x89\x88\x87R(K\x03U\x01|NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89U\x08AAAAAAAAtb"
    ),
}  # fmt: skip
SOUNDS: dict[str, Callable[[], bytes]] = {
    "1_hertz": lambda: _wav(1),
    "7_hertz": lambda: _wav(7),
    "3999_hertz": lambda: _wav(3999),
    "2_gigahertz": lambda: _wav(2_000_000_000),
}


def main() -> int:
    """Print a table; exit code 1 if a file runs something, hangs, dies, or takes more than the limits of child.py."""
    from hunt import run_batch

    print("| file | bytes | outcome | seconds | MB more |\n|---|---|---|---|---|")
    found = 0
    with tempfile.TemporaryDirectory() as folder:
        for target, made in (("pickle", PICKLES), ("torch_zip", TORCH), ("wav", SOUNDS)):
            for name, make in made.items():
                path = Path(folder) / name
                path.write_bytes(make())
                report = run_batch(target, seed=0, first=0, count=0, files=[path])
                found += len(report["findings"])
                outcome = "; ".join(report["outcomes"])
                size = path.stat().st_size
                print(f"| {name} | {size:,} | {outcome} | {report['slowest_s']} | {report['peak_growth_mb']} |")
                path.unlink()
    print(f"{len(PICKLES) + len(TORCH)} pickles and files of torch, {len(SOUNDS)} sounds, {found} findings")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
