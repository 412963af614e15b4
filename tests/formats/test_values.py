"""Files of joblib.dump, torch.save and numpy: read as those libraries read them, without running anything."""

import io
import pickle
import zipfile
import zlib
from functools import partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pytest
import torch

from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError
from dancedata.core.motion import Motion
from dancedata.datasets.folder import Folder
from dancedata.formats.values import load_values
from tests.messages import raises_message, refused_file
from tests.video_files import joblib_bytes, torch_file, wham, wham_person

COMPRESSIONS = [0, 3, ("gzip", 3), ("bz2", 1), ("lzma", 1), ("xz", 1)]
CONTENT = {
    0: {"pose": np.random.default_rng(0).normal(size=(5000, 3)).astype(np.float32), "one": np.float32(3)},
    7: {
        "fortran": np.asfortranarray(np.arange(20.0).reshape(5, 4)), "big": np.arange(4, dtype=">f8"),
        "objects": np.array([None, {"a": 1}, "x"], dtype=object), "names": np.array(["a", "bcd"]),
        "empty": np.zeros((0, 3)), "single": np.array(2.5), "after": np.arange(6, dtype=np.uint8)[::2],
    },
}  # fmt: skip


refused = partial(refused_file, load_values)


@pytest.mark.parametrize("protocol", [2, 3, 4, 5])
@pytest.mark.parametrize("compress", COMPRESSIONS, ids=str)
def test_joblib_files_are_read_as_joblib_reads_them(tmp_path: Path, compress: Any, protocol: int) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(joblib_bytes(CONTENT, compress, protocol))
    same(load_values(path), CONTENT)
    with path.open("rb") as file:
        same(joblib.load(file, ensure_native_byte_order=False), CONTENT)


def test_arrays_without_alignment(tmp_path: Path) -> None:
    # joblib before 1.2 wrote no padding, and a wrapper without its attribute.
    data = joblib_bytes({"a": np.arange(4.0)}, 0, 2)
    cut = data.index(b"numpy_array_alignment_bytes")
    at = data.rindex(b"X", 0, cut)
    end = data.index(b"K\x10", cut) + 2
    tail = data.index(b"b", end)
    pad = data[tail + 1]
    old = data[:at] + data[end : tail + 1] + data[tail + 2 + pad :]
    path = tmp_path / "a.pkl"
    path.write_bytes(old)
    assert np.array_equal(load_values(path)["a"], np.arange(4.0))  # type: ignore[index]


def planted(code: bytes = b"cos\nsystem\n(S'touch PWNED'\ntR") -> list[bytes]:
    """Return files of each format with a call in them that nothing may make."""
    plain = pickle.dumps({0: {"pose_world": 1}}, 2).removesuffix(b".")
    pickled = plain + b"X\x01\x00\x00\x00x" + code + b"s."
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("a/data.pkl", pickled)
        file.writestr("a/version", "3")
    good = wham({0: wham_person(3, vertices=4)})
    return [pickled, good[:-1] + b"X\x01\x00\x00\x00x" + code + b"s.", zlib.compress(pickled), archive.getvalue()]


def test_planted_code_does_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for data in planted():
        text = refused(tmp_path / "wham_output.pkl", data, "unsafe_pickle")
        assert "os.system" in text
        assert "publisher" not in text
    assert not (tmp_path / "PWNED").exists()


@pytest.mark.parametrize("compress", [0, 3])
def test_cut_files(tmp_path: Path, compress: int) -> None:
    data = joblib_bytes(CONTENT, compress)
    for end in (len(data) - 1, len(data) // 2, 50_000, 200, 3):
        refused(tmp_path / "a.pkl", data[:end], "broken_file")


def wrapper(shape: bytes, dtype: bytes = b"f4", order: bytes = b"C", extra: bytes = b"") -> bytes:
    """Return the opcodes of joblib's description of an array."""
    text = lambda value: b"X" + len(value).to_bytes(4, "little") + value  # noqa: E731
    return (
        b"\x80\x02cjoblib.numpy_pickle\nNumpyArrayWrapper\n)\x81}("
        + text(b"subclass") + b"cnumpy\nndarray\n"
        + text(b"shape") + shape
        + text(b"order") + text(order)
        + text(b"dtype") + b"cnumpy\ndtype\n" + text(dtype) + b"\x89\x88\x87R"
        + extra + b"ub"
    )  # fmt: skip


def test_crafted_descriptions(tmp_path: Path) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(wrapper(b"K\x02\x85") + b"\0" * 8 + b".")
    assert np.array_equal(load_values(path), np.zeros(2))
    for shape in (b"J\xff\xff\xff\x1f\x85", b"J\xff\xff\xff\xff\x85", b"K\x02", b"X\x01\0\0\0a\x85", b"K\x09\x85"):
        refused(path, wrapper(shape) + b"\0" * 8 + b".", "broken_file")
    refused(path, wrapper(b"K\x02\x85", order=b"K") + b"\0" * 8 + b".", "broken_file")
    # An array of objects that is not one, and one that holds another description.
    refused(path, wrapper(b"K\x01\x85", dtype=b"O8") + b"K\x01.", "broken_file")
    refused(path, wrapper(b"K\x01\x85", dtype=b"O8") + wrapper(b"K\x00\x85") + b"..", "broken_file")
    # A class that is called, and one whose state is set twice.
    refused(path, b"cjoblib.numpy_pickle\nNumpyArrayWrapper\n)R.", "unsafe_pickle")
    refused(path, b"cjoblib.numpy_pickle\nNumpyArrayWrapper\nK\x01\x85\x81.", "unsafe_pickle")
    refused(path, b"ccollections\ndefaultdict\ncbuiltins\ndict\n)R\x85R.", "unsafe_pickle")


def test_files_that_unpack_to_too_much(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dancedata.formats.safe_pickle.BOMB_BYTES", 1 << 20)
    bomb = zlib.compress(b"\x80\x04" + b"\0" * (2 << 20))
    assert "unpack to more than" in refused(tmp_path / "a.pkl", bomb, "broken_file")
    assert "lz4" in refused(tmp_path / "a.pkl", b"\x04\x22\x4d\x18" + bytes(20), "broken_file")


def test_torch_tensors_in_a_pickle_are_explained(tmp_path: Path) -> None:
    data = b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\n."
    assert "tensor.cpu().numpy()" in refused(tmp_path / "a.pkl", data, "unsafe_pickle")
    data = b"\x80\x02cchumpy.ch\nCh\n)\x81."
    assert "dataset.folder.body_model" in refused(tmp_path / "a.pkl", data, "unsafe_pickle")


TENSORS = {
    "rows": np.arange(12, dtype=np.float32).reshape(4, 3),
    "half": np.arange(3, dtype=np.float16),
    "inner": {"double": np.arange(4.0), "long": np.arange(3), "n": 3, "none": np.zeros((0, 3), np.float32)},
}


@pytest.mark.parametrize("order", ["little", "big"])
def test_torch_files(tmp_path: Path, order: str) -> None:
    path = tmp_path / "a.pt"
    path.write_bytes(torch_file(TENSORS, order))
    same(load_values(path), TENSORS)


def saved(content: Any, legacy: bool = False) -> bytes:
    """Return what torch.save writes, also in its format of before 1.6."""
    file = io.BytesIO()
    torch.save(content, file, _use_new_zipfile_serialization=not legacy)
    return file.getvalue()


def _with_attribute(rows: Any) -> Any:
    made = torch.nn.Parameter(rows)
    made.fps = 30
    return made


def motions() -> dict[str, Any]:
    """Return motions as programs save them, above what is small enough never to be counted."""
    rows = torch.arange(60_000.0).reshape(600, 100) / 7
    return {
        "bfloat16": rows.bfloat16(),
        "parameter": torch.nn.Parameter(rows),
        "requires grad": rows.clone().requires_grad_(),
        "two views": {"x": rows, "y": rows[:], "z": rows.T},
        "slices": [rows[k : k + 20] for k in range(0, 600, 20)],
        "windows": rows.unfold(0, 60, 10),
        "bfloat16 windows": rows.bfloat16().unfold(0, 60, 10),
        "list of windows": [rows[k : k + 60] for k in range(0, 540, 10)],
        "expanded": {"poses": rows, "betas": torch.arange(10.0).expand(20_000, 10)},
        "one number": torch.tensor(2.5).expand(300, 300),
        "same twice": [rows] * 20,
        "state dict": torch.nn.BatchNorm1d(9000).state_dict(),
        "numpy": {"poses": rows.numpy(), "names": np.array(["a", "b"], object), "n": np.int64(3), "size": rows.shape},
        "attributes": {"x": _with_attribute(rows), "dtype": torch.float32, "device": "cpu", "shape": rows[:7].shape},
        "integers": {np.int64(3): rows.long(), "half": rows.half(), "flags": rows > 3, "none": rows[:0]},
    }


def same(found: Any, expected: Any) -> None:
    if isinstance(expected, dict):
        assert list(found) == list(expected)
        for key in expected:
            same(found[key], expected[key])
    elif isinstance(expected, list | tuple):
        assert len(found) == len(expected)
        for one, other in zip(found, expected, strict=True):
            same(one, other)
    elif isinstance(expected, torch.Tensor):
        tensor = expected.detach()
        exact = tensor.float() if tensor.dtype == torch.bfloat16 else tensor
        assert found.dtype == exact.numpy().dtype
        assert np.array_equal(found, exact.numpy())
    else:
        assert np.array_equal(found, expected) or found == expected
        assert np.asarray(found).dtype == np.asarray(expected).dtype


@pytest.mark.parametrize("legacy", [False, True], ids=["zip", "before 1.6"])
@pytest.mark.parametrize("kind", motions())
def test_torch_files_are_read_as_torch_reads_them(tmp_path: Path, kind: str, legacy: bool) -> None:
    path = tmp_path / "a.pt"
    path.write_bytes(saved(motions()[kind], legacy))
    same(load_values(path), motions()[kind])


def test_views_that_are_copied_are_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dancedata.formats.torch_file._VIEWED_BYTES", 1 << 20)
    refused(tmp_path / "a.pt", saved(torch.zeros(1).expand(1 << 20)), "broken_file")
    refused(tmp_path / "a.pt", saved([torch.zeros(1).expand(1 << 17) for _ in range(3)]), "broken_file")


def test_a_torch_file_without_torch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from dancedata.core import packages

    (tmp_path / "a.pt").write_bytes(saved({"poses": torch.zeros(3, 72)}))
    monkeypatch.setattr(packages, "find_spec", lambda name: None)
    with raises_message(DataError, "pip install", where="a.pt", reason="broken_file"):
        load_values(tmp_path / "a.pt")


def changed(data: bytes, **members: bytes) -> bytes:
    """Return a torch file with other members; None leaves one out."""
    file = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(file, "w") as new:
        for name in old.namelist():
            short = name.partition("/")[2].replace("/", "_").replace(".", "_")
            new.writestr(name, members.get(short, old.read(name)))
    return file.getvalue()


def test_broken_torch_files(tmp_path: Path) -> None:
    path, data = tmp_path / "a.pt", torch_file(TENSORS)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        pickled = archive.read("hmr4d_results/data.pkl")
    refused(path, data[: len(data) // 2], "broken_file")
    refused(path, changed(data, data_0=b"short"), "broken_file")
    # Sizes and strides that reach beyond the storage: K\x04K\x03 is the shape (4, 3), K\x03K\x01 its stride.
    for old, new in ((b"K\x04K\x03\x86", b"K\x05K\x03\x86"), (b"K\x03K\x01\x86", b"K\x09K\x01\x86")):
        assert old in pickled
        refused(path, changed(data, data_pkl=pickled.replace(old, new)), "broken_file")
    text = refused(path, changed(data, data_pkl=b"cos\nsystem\n(S'false'\ntR."), "unsafe_pickle")
    assert "os.system" in text
    refused(path, changed(data, data_pkl=pickled.replace(b"storage", b"storagf")), "broken_file")
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a/data.pkl", pickled)
    refused(path, file.getvalue(), "broken_file")


# ---- numpy's files that hold a dict, a table or people as an array of objects


T = 60
POSES = np.random.default_rng(0).normal(0, 0.2, (T, 72))
DANCER = {"poses": POSES, "trans": np.linspace((0, 1, 0), (1, 1, 0), T)}
ROMP = {"smpl_thetas": POSES, "cam_trans": DANCER["trans"], "center_preds": np.zeros((T, 2))}


def boxed(*values: Any) -> Any:
    array = np.empty(len(values), dtype=object)
    array[:] = values
    return array


def load(path: Path, person: str = "", **options: Any) -> Motion:
    declared = (("person", person),) if person else ()
    ref = ClipRef("a", path, None, "train", declared=declared)
    return Folder(fps=30, up="y", unit="m", music="optional", **options).load(ref)


@pytest.mark.parametrize(
    ("name", "content", "person"),
    [
        ("a.npy", DANCER, ""), ("a.npy", boxed(DANCER), ""), ("a.npy", boxed(DANCER).reshape(1, 1), ""),
        ("a.npy", boxed(DANCER, DANCER), "1"), ("a.npz", {"results": DANCER}, ""),
        ("a.npz", {"results": boxed(DANCER), "fps": 30}, ""), ("a.npz", {"anna": DANCER, "ben": DANCER}, "ben"),
        ("a.npz", {**DANCER, "labels": {"poses": "other"}}, ""), ("a.pkl", boxed(DANCER), ""),
        ("a.pkl", [DANCER, DANCER], "0"), ("a.pkl", {**DANCER, "poses": POSES.astype(object)}, ""),
        ("a.npy", {**DANCER, "trans": DANCER["trans"].astype(object)}, ""),
    ],
)  # fmt: skip
def test_dicts_in_arrays_of_objects_are_read(tmp_path: Path, name: str, content: Any, person: str) -> None:
    path = tmp_path / name
    if name.endswith(".npy"):
        np.save(path, content, allow_pickle=True)
    elif name.endswith(".npz"):
        np.savez(path, **content)
    else:
        path.write_bytes(pickle.dumps(content))
    motion = load(path, person)
    np.testing.assert_allclose(motion.rotations.reshape(T, 72), POSES, atol=1e-12)
    np.testing.assert_allclose(motion.translation, DANCER["trans"], atol=1e-12)


def test_arrays_of_an_unknown_dict_are_named_by_keys(tmp_path: Path) -> None:
    np.savez_compressed(tmp_path / "romp.npz", results=ROMP)  # type: ignore[arg-type]
    with raises_message(DataError, "smpl_thetas.*keys", where="romp.npz", reason="missing_key"):
        load(tmp_path / "romp.npz")
    motion = load(tmp_path / "romp.npz", keys={"rotation": "smpl_thetas", "translation": "cam_trans"})
    np.testing.assert_allclose(motion.rotations.reshape(T, 72), POSES, atol=1e-12)


@pytest.mark.parametrize("content", [boxed(1.0, None, "x"), boxed(POSES[:3], POSES[:2]), {"poses": None}, boxed()])
def test_other_objects_are_named(tmp_path: Path, content: Any) -> None:
    np.save(tmp_path / "a.npy", content, allow_pickle=True)
    np.savez(tmp_path / "a.npz", results=content)
    for name in ("a.npy", "a.npz"):
        with raises_message(DataError, "array", where="") as error:
            load(tmp_path / name)
        assert name in str(error.value)
        assert error.value.reason in ("bad_shape", "missing_key")
