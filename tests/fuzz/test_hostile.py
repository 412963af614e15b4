"""Files made to do harm, each refused by name, within a second and 200 MB; and files broken by chance."""

import io
import json
import os
import resource
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import h5py
import numpy as np
import pytest

from dancedata.core.errors import StoreError
from dancedata.core.hashing import self_hash, sha256_bytes
from dancedata.store import open_store
from tests.fuzz.conftest import TOOLS, tool


def npy_header(shape: tuple[int, ...], descr: str = "<f4") -> bytes:
    text = repr({"descr": descr, "fortran_order": False, "shape": shape}).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


def inflated(n_bytes: int) -> bytes:
    """A zip with `n_bytes` of zeros and a header that fits them."""
    packed = io.BytesIO()
    with (
        zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive,
        archive.open("poses.npy", "w", force_zip64=True) as member,
    ):
        member.write(npy_header((n_bytes // 288, 72)))
        for _ in range(n_bytes // 288 * 288 // (288 << 12)):
            member.write(bytes(288 << 12))
        member.write(bytes(n_bytes // 288 * 288 % (288 << 12)))
    return packed.getvalue()


def flac(n_samples: int) -> bytes:
    import soundfile

    file = io.BytesIO()
    soundfile.write(file, np.zeros(5000, np.float32), 48_000, format="FLAC")
    data = bytearray(file.getvalue())
    # STREAMINFO: the last 36 bits of eight are the number of samples.
    data[21] = data[21] & 0xF0 | n_samples >> 32
    data[22:26] = struct.pack(">I", n_samples & 0xFFFFFFFF)
    return bytes(data)


def shard(name: str, n_rows: int, *, chunked: bool) -> Callable[[bytes], bytes]:
    def changed(whole: bytes) -> bytes:
        memory = io.BytesIO(whole)
        with h5py.File(memory, "r+") as file:
            shape, dtype = file[name].shape, file[name].dtype
            del file[name]
            options = {"chunks": (1 << 16, *shape[1:]), "compression": "gzip"} if chunked else {}
            file.create_dataset(name, (n_rows, *shape[1:]), dtype, **options)
        return memory.getvalue()

    return changed


def linked(target: object) -> Callable[[bytes], bytes]:
    def changed(whole: bytes) -> bytes:
        memory = io.BytesIO(whole)
        with h5py.File(memory, "r+") as file:
            del file["windows/start"]
            if target == "virtual":
                layout = h5py.VirtualLayout((6,), "<i4")
                layout[:] = h5py.VirtualSource("/etc/passwd", "x", (6,))
                file.create_virtual_dataset("windows/start", layout)
            elif target == "external":
                file.create_dataset("windows/start", (6,), "<i4", external=[("/etc/passwd", 0, 24)])
            else:
                file["windows/start"] = target
        return memory.getvalue()

    return changed


HEADER = (
    "HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation\n"
)
END = "End Site\n{\nOFFSET 0 1 0\n}\n}\nMOTION\n"
DEEP = 100_000

BOMBS: dict[str, list[Callable[[], bytes]]] = {
    "npy": [
        lambda: npy_header((1 << 40, 315)),
        lambda: npy_header((1 << 62, 315)),
        lambda: npy_header((10**30, 315)),
        lambda: npy_header((0, 315) * 4000),
        lambda: npy_header((4,), "<U999999999"),
        lambda: b"\x93NUMPY\x02\x00\xff\xff\xff\xff{}",
        lambda: b"\x93NUMPY\x01\x00\x10\x27" + b"(" * 10_000,
    ],
    "npz": [lambda: inflated(1 << 30), lambda: inflated(300 << 20)],
    "body_model": [lambda: inflated(1 << 30)],
    "bvh": [
        lambda: (HEADER + END + "Frames: 1000000000\nFrame Time: 0.03\n0 0 0 0 0 0\n").encode(),
        lambda: (HEADER + "JOINT a\n{\nOFFSET 0 1 0\nCHANNELS 0\n" * DEEP).encode(),
        lambda: b"HIERARCHY" + b"{" * DEEP,
        lambda: (HEADER + "CHANNELS 999999999 " + "Xposition " * DEEP + "\n" + END).encode(),
        lambda: (HEADER + END + "Frames: 1\nFrame Time: 1e-999999999\n0 0 0 0 0 0\n").encode(),
    ],
    "flac": [lambda: flac(2**31), lambda: flac(2**36 - 1)],
    "label": [lambda: b"[" * DEEP, lambda: b'{"style2": ' * DEEP, lambda: b'{"style2": %s}' % (b"9" * DEEP)],
    "dataset_json": [
        lambda: b"[" * DEEP,
        lambda: b'{"format": 1, "fps": "1e999999999", "skeleton": {}}',
        lambda: b'{"format": %s}' % (b"9" * DEEP),
    ],
    "stats": [lambda: b'{"fields":' * DEEP],
    "jsonl": [lambda: b"[" * DEEP, lambda: b'{"motion": ' * DEEP, lambda: b" " * (100 << 20)],
    "csv": [lambda: b"motion,audio\n" + b"x" * (100 << 20), lambda: b"motion,audio\n" + b"x," * (7 << 20)],
    "recipe": [
        lambda: b"[" * DEEP,
        lambda: b"a: " + b"[" * 200 + b"]" * 200,
        lambda: b"- " * DEEP,
        lambda: b"#" * (100 << 20),
    ],
    "names": [lambda: b"x\n" * (50 << 20)],
    "pickle": [
        lambda: b"\x80\x04\x8e\xff\xff\xff\xff\xff\xff\xff\x0f.",
        lambda: b"\x80\x05\x96\xff\xff\xff\xff\xff\xff\xff\x0f.",
        lambda: b"(" * DEEP + b".",
        lambda: b"\x80\x02]" + b"q\x00]h\x00a" * (DEEP // 10) + b".",
    ],
}


#: Each takes five to ten seconds.
LONG = ("body_model", "flac", "npz")


@pytest.mark.parametrize(
    "target", [pytest.param(name, marks=pytest.mark.nightly if name in LONG else ()) for name in BOMBS]
)
def test_small_files_that_want_much(hunt: ModuleType, tmp_path: Path, target: str) -> None:
    files = [tmp_path / str(k) for k in range(len(BOMBS[target]))]
    for path, make in zip(files, BOMBS[target], strict=True):
        path.write_bytes(make())
    report = hunt.run_batch(target, seed=0, first=0, count=0, files=files)
    assert findings([report]) == []
    # An invalid label is not an error, but reported.
    assert target == "label" or "valid" not in report["outcomes"], report["outcomes"]


def test_tables_that_want_much_or_look_elsewhere(hunt: ModuleType, tmp_path: Path) -> None:
    from fractions import Fraction

    from dancedata.store.schema import Field
    from dancedata.testing.stores import random_columns, write_random_store

    fields = (
        Field("pose", "motion", random_columns(3), Fraction(30)),
        Field("music", "audio", random_columns(2, mirror=False), Fraction(30), "float16"),
    )
    made = write_random_store(tmp_path / "store", fields=fields, clips={"train": 2}, n_frames=(40, 60), length=20)
    whole = (made.path / "tables.h5").read_bytes()
    changes = [
        shard("clips/id", 1 << 30, chunked=False),
        shard("clips/lists/values", 1 << 55, chunked=True),
        shard("clips/lists/offset", 1 << 40, chunked=True),
        shard("windows/start", 1 << 30, chunked=False),
        linked(h5py.ExternalLink("other.h5", "/windows/start")),
        linked(h5py.SoftLink("/windows/clip")),
        linked(h5py.SoftLink("/windows/start")),
        linked("virtual"),
        linked("external"),
    ]
    files = [tmp_path / str(k) for k in range(len(changes))]
    for path, change in zip(files, changes, strict=True):
        path.write_bytes(change(whole))
    report = hunt.run_batch("hdf5", seed=0, first=0, count=0, files=files)
    assert findings([report]) == []
    assert report["outcomes"] == {"StoreError": len(changes)}


def test_a_long_silence_is_read(tmp_path: Path) -> None:
    """Packed far below its length, but not beyond what is read of any file."""
    import soundfile

    from dancedata.music.signal import load_audio

    path = tmp_path / "a.flac"
    soundfile.write(path, np.zeros(5_000_000, np.int16), 48_000)
    assert path.stat().st_size * 100 < 4 * 5_000_000
    assert load_audio(path).n_samples == 5_000_000


def test_json_that_python_reads_is_not_refused(tmp_path: Path) -> None:
    from dancedata.files.yaml import load_yaml

    assert load_yaml("a: &x [1, 2]\nb: *x\n") == {"a": [1, 2], "b": [1, 2]}
    assert load_yaml(json.dumps({"a": [[[]]], "b": 2**63})) == {"a": [[[]]], "b": 2**63}


RECIPE = """recipe: 1
name: hostile
dataset: {folder: {unit: m, up: y, fps: 30}}
windows: {length_s: 2, stride_s: 1}
motion: {edge151: {}}
audio: {librosa35: {}}
"""
#: Far above what a build of one clip takes, far below unrestricted reading. Processor time.
CPU_S, ADDRESS_SPACE = 120, 6 << 30


@pytest.mark.parametrize(("target", "kind"), [("pickle", "PICKLES"), ("torch_zip", "TORCH"), ("wav", "SOUNDS")])
def test_each_is_refused_by_name(hunt, hostile, tmp_path, target, kind):
    made = getattr(hostile, kind)
    files = [tmp_path / name for name in made]
    for path, make in zip(files, made.values(), strict=True):
        path.write_bytes(make())
    report = hunt.run_batch(target, seed=0, first=0, count=0, files=files)
    assert findings([report]) == []
    assert report["cases"] == len(files)
    assert "valid" not in report["outcomes"], report["outcomes"]


def limited() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S))
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))


def test_a_build_stores_the_good_clip_among_all_of_them(hostile: ModuleType, tmp_path: Path) -> None:
    from dancedata.datasets.folder import Folder

    source, out = tmp_path / "source", tmp_path / "out"
    Folder().make_example(source)
    (source / "manifest.csv").unlink()
    motions, music = source / "motions", source / "music"
    for path in motions.iterdir():
        if path.name != "smpl.npz":
            path.unlink()
    song = (music / "fast.wav").read_bytes()
    (music / "smpl.wav").write_bytes(song)
    for name, make in hostile.PICKLES.items():
        (motions / f"{name}.pkl").write_bytes(make())
        (music / f"{name}.wav").hardlink_to(music / "smpl.wav")
    for name, make in hostile.SOUNDS.items():
        (motions / f"{name}.npz").write_bytes((motions / "smpl.npz").read_bytes())
        (music / f"{name}.wav").write_bytes(make())
    (tmp_path / "recipe.yaml").write_text(RECIPE)
    build = [sys.executable, "-m", "dancedata", "build", str(tmp_path / "recipe.yaml"), "--jobs", "1", "-q"]
    ended = subprocess.run(
        [*build, str(source), "--out", str(out)],
        capture_output=True,
        preexec_fn=limited,
        env={**os.environ, "DANCEDATA_CACHE": str(tmp_path / "cache"), "OPENBLAS_NUM_THREADS": "1"},
    )
    assert ended.returncode == 0, ended.stderr.decode(errors="replace")[-3000:]
    text = ended.stdout.decode()
    assert all(c.isprintable() or c == "\n" for c in text)
    rejects: list[dict[str, Any]] = [json.loads(line) for line in (out / "rejects.jsonl").read_bytes().splitlines()]
    left_out = {r["clip"]: r for r in rejects if r["reason"] not in ("no_audio", "unused_music")}
    assert set(left_out) == {*hostile.PICKLES, *hostile.SOUNDS}
    for name, reject in left_out.items():
        assert name in reject["detail"]
        assert len(reject["detail"]) < 1000
    import dancedata

    with dancedata.open(out) as ds:
        assert [c.id for c in ds] == ["smpl"]
        assert len(ds.windows("train")) > 1


# ---- 1,000 broken files here, 100,000 in the nightly run; what was found once; tables


HERE = Path(__file__).resolve().parent
#: A child of drawn cases takes seconds to begin with: by default one of each family of formats.
STRUCTURED = ("pickle", "npz", "bvh", "dataset_json", "recipe", "hdf5", "model_pickle")
FOUND = sorted(folder.name for folder in (HERE / "corpus").iterdir())


def findings(reports: list[dict[str, Any]]) -> list[str]:
    return [
        f"{r['target']}: {f['what']} {f['where']} {f['error']}\n{f['data'][:2000]}"
        for r in reports
        for f in r["findings"]
    ]


def targets(hunt: ModuleType) -> list[str]:
    run = subprocess.run(
        [sys.executable, str(TOOLS / "hunt.py"), "--list"], capture_output=True, text=True, check=True
    )
    return run.stdout.split()


def test_broken_files_are_read_or_refused(hunt: ModuleType) -> None:
    names = targets(hunt)
    cases, seed = hunt.RUNS["tests"]
    reports = hunt.hunt(cases, seed, names, workers=2, without_structure=set(names) - set(STRUCTURED))
    assert findings(reports) == []
    assert sum(report["cases"] for report in reports) >= cases
    for report in reports:
        # Cases that are all refused, or all fine, would try nothing.
        # Nearly every change of a dataset.json is one of its structure.
        assert len(report["outcomes"]) > 1 or report["target"] in ("label", "dataset_json"), report


@pytest.mark.parametrize("target", FOUND)
def test_earlier_findings(hunt: ModuleType, target: str) -> None:
    files = sorted((HERE / "corpus" / target).iterdir())
    report = hunt.run_batch(target, seed=0, first=0, count=0, files=files)
    assert findings([report]) == []
    assert report["cases"] == len(files)
    assert "valid" not in report["outcomes"], report["outcomes"]


def test_the_harness_detects_planted_defects(hunt: ModuleType, tmp_path: Path) -> None:
    words = {
        "spins": "more than 1 s",
        "grows": "MemoryError",
        "calls": "foreign code",
        "write": "foreign code",
        "dies!": "died, status -11",
        "index": "IndexError",
    }
    files = [tmp_path / word.strip("!") for word in words]
    for path, word in zip(files, words, strict=True):
        path.write_text(word)
    report = hunt.run_batch("defect", seed=0, first=0, count=0, files=files)
    assert {f["what"] for f in report["findings"]} == set(words.values())
    assert report["cases"] == len(files)
    assert {bytes.fromhex(f["data"]).decode() for f in report["findings"]} == set(words)


@pytest.mark.nightly
def test_a_hundred_thousand_broken_files(hunt: ModuleType) -> None:
    cases, seed = hunt.RUNS["nightly"]
    reports = hunt.hunt(cases, seed, targets(hunt), workers=2)
    assert findings(reports) == []


CORPUS = Path(__file__).parent / "corpus" / "hdf5"
#: Column and a word of the error, by file.
ERRORS = {
    "a-column-in-another-file": ("windows/start", "not contiguous"),
    "a-compound-of-columns": ("clips/genre", "type"),
    "a-link-to-a-column": ("clips/music", "SoftLink"),
    "a-table-elsewhere": ("clips", "ExternalLink"),
    "a-virtual-column": ("windows/start", "not contiguous"),
    "columns-of-another-length": ("clips/n_frames", "number of rows"),
    "gigabytes-of-ids": ("clips/id", "not contiguous"),
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
