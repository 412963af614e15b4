"""Files that hypothesis builds piece by piece: the right grammar around unexpected values."""

from __future__ import annotations

import copy
import io
import json
import pickle
import pickletools
import struct
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import h5py
import numpy as np
import yaml
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from mutations import MAX_BYTES
from programs import AROUND, ATOMS, programs
from targets import TARGETS
from valid_files import MANIFEST, RECIPE, TABLES, npy, pickles, store

Draw = Callable[[st.SearchStrategy[Any]], Any]

_NUMBERS = st.one_of(
    st.integers(),
    st.floats(),
    st.sampled_from([0, 1, -1, 2**31, 2**63 - 1, 2**63, 10**30, 1e308, 5e-324, float("inf"), float("nan"), True]),
)
_NAMES = st.sampled_from(
    [
        "poses",
        "trans",
        "smpl_poses",
        "smpl_trans",
        "smpl_scaling",
        "fps",
        "mocap_framerate",
        "betas",
        "gender",
        "hands",
    ]
)
_TEXTS = st.one_of(
    st.text(max_size=20),
    st.sampled_from(
        ["", "..", "../x", "/etc/passwd", "a/b.bvh", "a\x00b", "\ud800", "x" * 5000, "1e999", "30/0", ".h"]
    ),
)
_JSON = st.recursive(
    st.one_of(st.none(), st.booleans(), _NUMBERS, _TEXTS),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(_TEXTS, inner, max_size=4)),
    max_leaves=8,
)


def _places(document: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """All paths in a document."""
    items: Sequence[tuple[Any, Any]] = ()
    if isinstance(document, dict):
        items = list(document.items())
    elif isinstance(document, list):
        items = list(enumerate(document))
    return [at, *(place for key, value in items for place in _places(value, (*at, key)))]


def _edited(draw: Draw, document: Any) -> Any:
    """Replace, take out or add values of a document, up to three."""
    document = copy.deepcopy(document)
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.sampled_from(_places(document)))
        if not place:
            if draw(st.integers(0, 30)) == 0:
                document = draw(_JSON)
            continue
        parent = document
        for key in place[:-1]:
            parent = parent[key]
        kind = draw(st.sampled_from(["replace", "replace", "remove", "add"]))
        if kind == "remove":
            del parent[place[-1]]
        elif kind == "add" and isinstance(parent, dict):
            parent[draw(_TEXTS)] = draw(_JSON)
        else:
            parent[place[-1]] = draw(_JSON)
    return document


def _as_json(document: Any) -> bytes:
    return json.dumps(document).encode()


def _documents(target: str) -> st.SearchStrategy[bytes]:
    @st.composite
    def made(draw: Draw) -> bytes:
        return _as_json(_edited(draw, json.loads(TARGETS[target].seeds()[0])))

    return made()


@st.composite
def _recipes(draw: Draw) -> bytes:
    document = _edited(draw, yaml.safe_load(RECIPE))
    # As JSON, which YAML takes too and which writes any value; or with YAML's own ways to write the same.
    if draw(st.booleans()):
        return _as_json(document)
    return yaml.dump(document, default_flow_style=draw(st.booleans()), allow_unicode=True).encode("utf-8", "replace")


def _cells() -> st.SearchStrategy[str]:
    # Valid cells most of the time, so that parsing reaches the invalid one.
    return st.one_of(st.sampled_from([c for line in MANIFEST.split("\n") for c in line.split(",")]), _TEXTS)


@st.composite
def _csv(draw: Draw) -> bytes:
    columns = draw(st.permutations(["id", *MANIFEST.split("\n")[0].split(","), "layout", "gender", "music"]))
    rows = draw(st.lists(st.lists(_cells(), min_size=len(columns), max_size=len(columns)), max_size=5))
    for row in rows:
        row[columns.index("motion")] = draw(st.sampled_from(["a/b.bvh", "d.npy", "a/c.npz"]) | _TEXTS)
    lines = [columns, *rows]
    delimiter = draw(st.sampled_from(",;\t"))
    text = "\n".join(delimiter.join(json.dumps(c) if '"' in c else f'"{c}"' for c in line) for line in lines)
    return text.encode("utf-8", "surrogatepass")


@st.composite
def _jsonl(draw: Draw) -> bytes:
    row = st.dictionaries(
        st.sampled_from(["id", "motion", "audio", "split", "tempo_bpm", "fps", "unit", "music", "genre"]),
        st.one_of(_cells(), _cells(), _JSON),
        max_size=6,
    )
    rows = draw(st.lists(row, min_size=1, max_size=4))
    return b"\n".join(_as_json({"motion": f"{k}.bvh", **row}) for k, row in enumerate(rows))


_ARRAYS = hnp.arrays(
    st.one_of(
        hnp.floating_dtypes(),
        hnp.integer_dtypes(),
        hnp.boolean_dtypes(),
        hnp.complex_number_dtypes(),
        hnp.unicode_string_dtypes(max_len=8),
        hnp.datetime64_dtypes(),
    ),
    st.one_of(
        hnp.array_shapes(min_dims=0, max_dims=4, min_side=0, max_side=5),
        st.sampled_from([(4, 72), (4, 24, 3), (4, 156), (4, 165), (4, 3), (4, 315), (1,), (), (0, 72), (0, 3)]),
    ),
    fill=st.nothing(),
)


_KEYS = st.one_of(st.integers(), _TEXTS, st.floats(), st.none(), st.binary(max_size=3), st.tuples(st.integers()))
_SETS = st.one_of(
    st.sets(_KEYS, max_size=4),
    st.frozensets(_KEYS, max_size=4),
    st.dictionaries(_KEYS, st.integers(), max_size=3),
    st.dictionaries(_KEYS, st.integers(), max_size=3).map(OrderedDict),
)


@st.composite
def _pickles(draw: Draw) -> bytes:
    content = dict(pickle.loads(pickles()[0]))
    leaves = st.one_of(_NUMBERS, _TEXTS, st.binary(max_size=9), _ARRAYS, st.none())
    value = st.recursive(
        leaves | _SETS, lambda inner: st.lists(inner, max_size=4) | st.tuples(inner, inner), max_leaves=5
    )
    if draw(st.booleans()):
        return draw(programs())
    content |= draw(st.dictionaries(_NAMES, value, min_size=1, max_size=3))
    for name in draw(st.lists(st.sampled_from(sorted(content)), max_size=1)):
        del content[name]
    data = pickle.dumps(content, draw(st.integers(0, 5)))
    # Opcodes that build what numpy never writes.
    at = draw(st.integers(0, len(data)))
    codes = st.lists(
        st.sampled_from([b"(", b"0", b"2", b"R", b"b", b"t", b"]", b"}", b"e", b"u", b"\x81", b"\x93"]), max_size=4
    )
    return data[:at] + b"".join(draw(codes)) + data[at:] if draw(st.booleans()) else data


_SHAPES = st.one_of(
    st.sampled_from(
        [(4, 315), (1 << 20, 315), (1 << 40, 315), (1 << 62, 4), (0, 315), (315,), (), (-1, 315), (4, 72), (10**80,)]
    ),
    st.lists(st.integers(-1, 1 << 33), max_size=40).map(tuple),
)
_DTYPES = st.sampled_from(
    ["<f4", ">f8", "<f2", "|b1", "<i8", "|u1", "|O", "<U9", "|S4", "<c8", "<M8[s]", "|V9", [("a", "<f4")], "<f0", "f",
     ("<f4", (2,)), "<U999999999", "|S0", "zz", 7, None, [("a", "<f4", (1 << 30,))]]
)  # fmt: skip


def _npy(draw: Draw) -> bytes:
    """A header that says anything before data that may fit."""
    header = {"descr": draw(_DTYPES), "fortran_order": draw(st.booleans()), "shape": draw(_SHAPES)}
    text = repr(header)
    if draw(st.integers(0, 5)) == 0:
        text = draw(
            st.sampled_from(["(" * 300, "-" * 9000 + "1", "{'shape': (1,)", "{" * 99, "1e999", "[[" * 5000, "{}"])
        )
    version = draw(st.sampled_from([(1, 0), (1, 0), (2, 0), (3, 0), (9, 9)]))
    raw = text.encode() + b"\n"
    size = struct.pack("<H" if version == (1, 0) else "<I", draw(st.sampled_from([len(raw), len(raw), 0, 60_000])))
    data = draw(st.one_of(st.binary(max_size=40), st.just(npy()[0][128:])))
    return b"\x93NUMPY" + bytes(version) + size + raw + data


@st.composite
def _npys(draw: Draw) -> bytes:
    if draw(st.booleans()):
        return _npy(draw)
    file = io.BytesIO()
    np.save(file, draw(_ARRAYS))
    return file.getvalue()


def _npzs(target: str) -> st.SearchStrategy[bytes]:
    @st.composite
    def made(draw: Draw) -> bytes:
        with zipfile.ZipFile(io.BytesIO(draw(st.sampled_from(TARGETS[target].seeds())))) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        for _ in range(draw(st.integers(1, 2))):
            name = draw(
                st.sampled_from(sorted(members)) | _NAMES.map(lambda n: f"{n}.npy") | st.text("a./\\", max_size=9)
            )
            members[name] = draw(_npys())
        packing = st.sampled_from([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA])
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w", draw(packing)) as out:
            for name, content in members.items():
                out.writestr(name or "x", content)
        return file.getvalue()

    return made()


@st.composite
def _bvhs(draw: Draw) -> bytes:
    lines = TARGETS["bvh"].seeds()[0].decode().split("\n")
    statements = st.one_of(
        st.tuples(
            st.sampled_from(["OFFSET", "CHANNELS 3", "Frames:", "Frame Time:", ""]), _NUMBERS, _NUMBERS, _NUMBERS
        ).map(lambda parts: " ".join(map(str, parts))),
        st.sampled_from(
            ["{", "}", "MOTION", "ROOT a", "JOINT Hips", "End Site", "CHANNELS 0", "HIERARCHY", "OFFSET"]
        ),
        _NUMBERS.map(lambda n: f"Frames: {n}"),
        _NUMBERS.map(lambda n: f"Frame Time: {n}"),
        _TEXTS,
    )
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(lines) - 1))
        lines[at : at + draw(st.integers(0, 2))] = [draw(statements)]
    return "\n".join(lines).encode("utf-8", "replace")


@st.composite
def _wavs(draw: Draw) -> bytes:
    word = st.sampled_from([0, 1, 2, 7, 1000, 3999, 4000, 47_999, 48_000, 400_001, 2**31 - 1, 2**31, 2**32 - 1])
    kind, channels, bits = 1, 1, 8
    align = 1
    if draw(st.booleans()):  # else all but the rate, the length and the chunks is right
        kind = draw(st.sampled_from([1, 1, 1, 3, 2, 6, 17, 85, 0xFFFE]))
        channels = draw(st.sampled_from([0, 1, 2, 8, 255, 1024, 1025, 65_535]))
        bits = draw(st.sampled_from([0, 1, 4, 8, 16, 24, 32, 64, 65_535]))
        align = draw(st.sampled_from([channels * bits // 8 % 65_536, 0, 1, 65_535]))
    rate = draw(word)
    fmt = struct.pack("<HHIIHH", kind, channels, rate, draw(word), align, bits) + draw(st.binary(max_size=30))
    data = draw(st.binary(max_size=200)) * draw(st.sampled_from([1, 1, 1, 4000]))
    chunks = [(b"fmt ", fmt), (b"data", data)]
    extra = st.tuples(
        st.sampled_from([b"fact", b"LIST", b"cue ", b"bext", b"smpl", b"PEAK", b"data", b"fmt "]),
        st.binary(max_size=60),
    )
    chunks[1:1] = draw(st.lists(extra, max_size=2))
    body = b"WAVE"
    for name, content in chunks:
        body += name + struct.pack("<I", draw(word) if draw(st.integers(0, 3)) == 0 else len(content)) + content
    return draw(st.sampled_from([b"RIFF", b"RIFF", b"RIFX", b"RF64"])) + struct.pack("<I", len(body)) + body


_DATASETS = st.sampled_from(
    ["clips/id", "clips/file", "clips/lists/offset", "clips/lists/values", "clips/x/says/offset",
     "clips/x/says/values", "clips/n_frames", "clips/tempo_bpm", "clips/motion/pose/start",
     "clips/audio/music/offset", "windows/clip", "windows/start"]
)  # fmt: skip


@st.composite
def _shards(draw: Draw) -> bytes:
    """Tables with a dataset that is another, by h5py's own means."""
    memory = io.BytesIO(store()[TABLES])
    with h5py.File(memory, "r+") as file:
        for _ in range(draw(st.integers(1, 2))):
            name = draw(_DATASETS)
            kind = draw(st.sampled_from(["values", "values", "replace", "replace", "link", "remove", "huge"]))
            if not isinstance(file.get(name, getlink=True), h5py.HardLink) or not isinstance(
                file[name], h5py.Dataset
            ):
                continue  # changed already
            if kind == "values" and file[name].dtype.kind in "if" and file[name].shape and file[name].size:
                row = draw(st.integers(0, file[name].shape[0] - 1))
                big = np.iinfo(np.int64)
                value = draw(st.sampled_from([0, 1, -1, 2**31, big.max, big.min, 10**6]) | st.integers(-9, 99))
                file[name][row] = np.int64(value).astype(file[name].dtype)
                continue
            shape, dtype = file[name].shape or (), file[name].dtype
            del file[name]
            if kind == "link":
                links = [h5py.SoftLink("/clips"), h5py.SoftLink(f"/{name}"), h5py.ExternalLink("/etc/passwd", "/x")]
                file[name] = draw(st.sampled_from([*links, h5py.ExternalLink("dataset.json", "/")]))
            elif kind == "huge":
                packed = draw(st.booleans())
                n_rows = draw(st.sampled_from([1 << 30, 1 << 40, 1 << 55]))
                options = {"chunks": (1 << 10, *shape[1:])} if packed else {}
                file.create_dataset(name, (n_rows if packed else 1 << 30, *shape[1:]), dtype, **options)
            elif kind == "replace":
                _replace(draw, file, name, shape, dtype)
    # libhdf5 may have made room for what was only announced.
    return memory.getvalue() if memory.getbuffer().nbytes < MAX_BYTES else store()[TABLES]


def _replace(draw: Draw, file: h5py.File, name: str, shape: tuple[int, ...], dtype: Any) -> None:
    dtypes = [dtype, "<f4", "<i8", "S3", h5py.string_dtype(), "bool", ">i8", [("a", "<f4")], "<c8", h5py.ref_dtype]
    shapes = [shape, (), (0,), (1, *shape[1:]), (*shape, 2), None]
    chosen = draw(st.sampled_from(dtypes)), draw(st.sampled_from(shapes))
    if draw(st.integers(0, 6)) == 0:
        file.create_group(name)
    elif chosen[1] is None:
        file[name] = h5py.Empty("f4")
    else:
        packed = {"compression": "gzip"} if draw(st.booleans()) and chosen[1] and 0 not in chosen[1] else {}
        file.create_dataset(name, chosen[1], chosen[0], **packed)


def _lines(target: str) -> st.SearchStrategy[bytes]:
    @st.composite
    def made(draw: Draw) -> bytes:
        rows = [json.loads(line) for line in TARGETS[target].seeds()[0].splitlines()]
        edited = _edited(draw, rows * draw(st.sampled_from([1, 1, 50])))
        return b"\n".join(map(_as_json, edited if isinstance(edited, list) else [edited]))

    return made()


#: Names left by archives of other systems, or made to do harm.
_RAW_NAMES = st.one_of(
    st.sampled_from(
        [b"\xff", b"caf\xe9", b"\x82\xa0\x82\xa2", b"\xed\xa0\x80", b"\x1b[2J", b"a\nb", b"-rf", b"\xe2\x80\xae"]
    ),
    st.binary(max_size=12),
    st.text(max_size=8).map(lambda text: text.encode("utf-8", "surrogatepass")),
    st.sampled_from(
        [b"001", b"manifest.csv", b"motions", b"wavs", b"M001", b"gBR_sBM_cAll_d04_mBR2_ch08", b"x" * 400]
    ),
)


@st.composite
def _torch(draw: Draw) -> bytes:
    """A torch file around a pickle that no torch writes."""
    data = TARGETS["torch_old"].seeds()[0]
    at = draw(st.integers(60, data.index(b"u.")))
    return data[:at] + draw(ATOMS) + b"".join(draw(st.lists(AROUND, max_size=2))) + b"0" + data[at:]


@st.composite
def _opcodes(draw: Draw, name: str) -> bytes:
    """A pickle of protocol 2, with opcodes between its own that push something and drop it."""
    data = next(seed for seed in TARGETS[name].seeds() if seed.startswith(b"\x80\x02"))
    return _with_more(draw, data)


def _with_more(draw: Draw, data: bytes) -> bytes:
    ends = []
    with suppress(Exception):  # the bytes of joblib's first array are not opcodes
        ends.extend(position for _, _, position in pickletools.genops(data) if position is not None)
    at = draw(st.sampled_from(ends[1:]))
    return data[:at] + draw(ATOMS) + b"".join(draw(st.lists(AROUND, max_size=2))) + b"0" + data[at:]


@st.composite
def _torch_zips(draw: Draw) -> bytes:
    """An archive of torch around such a pickle."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(TARGETS["torch_zip"].seeds()[0])) as old, zipfile.ZipFile(made, "w") as new:
        for member in old.namelist():
            data = old.read(member)
            new.writestr(member, _with_more(draw, data) if member.endswith("data.pkl") else data)
    return made.getvalue()


STRATEGIES: dict[str, st.SearchStrategy[bytes]] = {
    "pickle": _pickles(),
    "npy": _npys(),
    "npz": _npzs("npz"),
    "body_model": _npzs("body_model"),
    "bvh": _bvhs(),
    "wav": _wavs(),
    "label": _documents("label"),
    "dataset_json": _documents("dataset_json"),
    "stats": _documents("stats"),
    "rejects": _lines("rejects"),
    "recipe": _recipes(),
    "csv": _csv(),
    "jsonl": _jsonl(),
    "names": _TEXTS.map(lambda text: text.encode("utf-8", "surrogatepass")),
    "file_names": st.lists(_RAW_NAMES, max_size=3).map(b"\0".join),
    "torch_old": _torch(),
    "joblib": _opcodes("joblib"),
    "phalp": _opcodes("phalp"),
    "model_pickle": _opcodes("model_pickle"),
    "torch_zip": _torch_zips(),
    "hdf5": _shards(),
}
