"""What can be wrong with a motion file of any published dataset: each reader names the file and the same reasons."""

import io
import json
import os
import pickle
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.errors import DataError
from dancedata.core.registry import DATASETS
from tests.conftest import Once
from tests.messages import raises_message

Content = dict[str, Any]


def read_npy(path: Path) -> Content:
    array = np.load(path, allow_pickle=True)
    return dict(array[()]) if array.dtype == object else {"": array}


def write_npy(path: Path, content: Content) -> None:
    array = content.get("")
    if array is None:
        array = np.empty((), object)
        array[()] = content
    np.save(path, array, allow_pickle=True)


def read_dcm(path: Path) -> Content:
    frames = json.loads(path.read_text())["BoneKeyFrameTransformRecord"]
    return {"": np.array([frame["Transform"] for frame in frames])}


def write_dcm(path: Path, content: Content) -> None:
    frames = [{"Transform": frame} for frame in content[""].tolist()]
    path.write_text(json.dumps({"BoneKeyFrameTransformRecord": frames}))


FORMS: dict[str, tuple[Callable[[Path], Content], Callable[[Path, Content], Any]]] = {
    ".pkl": (lambda path: dict(pickle.loads(path.read_bytes())), lambda path, c: path.write_bytes(pickle.dumps(c))),
    ".npy": (read_npy, write_npy),
    ".json": (
        lambda path: {k: np.asarray(v) if k != "bone_name" else v for k, v in json.loads(path.read_text()).items()},
        lambda path, c: path.write_text(json.dumps({k: getattr(v, "tolist", lambda v=v: v)() for k, v in c.items()})),
    ),
}


@dataclass(frozen=True)
class Kind:
    """Arrays of a motion file: `places` and `turns` by name, with time on axis `time`; parameters of the reader."""

    places: str
    turns: str
    time: int = 0
    keys: Content | None = None
    #: Reasons of its own, by fault.
    reasons: dict[str, str] | None = None


KINDS = {
    "aioz-gdance": Kind("root_trans", "smpl_poses", 1, reasons={"two numbers": "length_mismatch"}),
    "aist++": Kind("smpl_trans", "smpl_poses"),
    "dd100": Kind("transl", "poses"),
    "i-dancers": Kind(
        "smpl_trans", "smpl_poses", 1, reasons={"a frame less": "bad_shape", "degrees": "bad_rotation"}
    ),
    "infinitedance": Kind("transl", "body_pose"),
    "phantomdance": Kind("root_positions", "rotations", reasons={"degrees": "bad_rotation", "nan": "broken_file"}),
    "popdanceset": Kind("transl", "pred_thetas"),
}
#: One array: columns in `places`.
COLUMNS = {
    "finedance": Kind("", "", keys={"labels": "optional"}, reasons={"degrees": "bad_rotation"}),
    "infinitedance": Kind("", "", keys={"motion": "columns"}),
    "dcm": Kind("", "", reasons={"infinite": "broken_file", "text": "broken_file"}),
}


def put(array: Any, time: int, value: float) -> Any:
    array = np.array(array, dtype=np.float64)
    array[(slice(None),) * time + (3,)] = value
    return array


def cut(content: Content, key: str, kind: Kind, frames: slice) -> Content:
    return {**content, key: content[key][(slice(None),) * kind.time + (frames,)]}


def emptied(content: Content, kind: Kind) -> Content:
    """Return arrays without frames: all that have frames, however many axes they have."""
    n = content[kind.places].shape[kind.time]
    has = {k for k, v in content.items() if np.ndim(v) > kind.time and np.shape(v)[kind.time] == n}
    for key in has:
        content = cut(content, key, kind, slice(0))
    return content


#: The first clip of an example, by dataset and parameters.
SCANNED: dict[tuple[str, str], Any] = {}
Change = Callable[[Content, Kind], Content]
FAULTS: dict[str, tuple[str, Change]] = {
    "no places": ("missing_key", lambda c, k: {key: v for key, v in c.items() if key != k.places}),
    "no turns": ("missing_key", lambda c, k: {key: v for key, v in c.items() if key != k.turns}),
    "two numbers": ("bad_shape", lambda c, k: {**c, k.places: c[k.places][..., :2]}),
    "other joints": ("bad_shape", lambda c, k: {**c, k.turns: np.zeros((*np.shape(c[k.turns])[: k.time + 1], 150))}),
    "a frame less": ("length_mismatch", lambda c, k: cut(c, k.places, k, slice(1, None))),
    "empty": ("empty", emptied),
    "nan": ("nan", lambda c, k: {**c, k.places: put(c[k.places], k.time, np.nan)}),
    "degrees": ("not_rotations", lambda c, k: {**c, k.turns: np.degrees(c[k.turns])}),
}
OF_COLUMNS: dict[str, tuple[str, Change]] = {
    "a column less": ("bad_shape", lambda c, k: {"": c[""][:, 1:]}),
    "one row": ("bad_shape", lambda c, k: {"": c[""][0]}),
    "text": ("bad_shape", lambda c, k: {"": np.full((2, c[""].shape[1]), "a")}),
    "empty": ("empty", lambda c, k: {"": c[""][:0]}),
    "infinite": ("nan", lambda c, k: {"": put(c[""], 0, np.inf)}),
}
CASES = [(name, fault, kind, *FAULTS[fault]) for name, kind in KINDS.items() for fault in FAULTS]
CASES += [(name, fault, kind, *OF_COLUMNS[fault]) for name, kind in COLUMNS.items() for fault in OF_COLUMNS]


@pytest.fixture
def first(once: Once, tmp_path: Path) -> Callable[..., tuple[Any, Any, Path]]:
    """A reader, the first clip of its example, and a copy of its motion file in a folder of its own."""

    def copy(name: str, keys: Content | None = None) -> tuple[Any, Any, Path]:
        reader: Any = DATASETS.get(name)(**keys or {})
        source = once(f"{name}-example", lambda folder: reader.make_example(folder / "source")) / "source"
        if (name, str(keys)) not in SCANNED:
            SCANNED[name, str(keys)] = reader.scan(source).clips[0]
        ref = SCANNED[name, str(keys)]
        return reader, ref, Path(shutil.copy(ref.motion_path, tmp_path))

    return copy


def load(reader: Any, ref: Any, path: Path) -> None:
    reader.load(replace(ref, motion_path=path))


@pytest.mark.parametrize(("name", "fault", "kind", "reason", "change"), CASES, ids=[f"{c[0]}-{c[1]}" for c in CASES])
def test_faults(first: Any, name: str, fault: str, kind: Kind, reason: str, change: Change) -> None:
    reader, ref, path = first(name, kind.keys)
    read, write = (read_dcm, write_dcm) if name == "dcm" else FORMS[path.suffix]
    write(path, change(read(path), kind))
    with raises_message(DataError, re.escape(path.name), reason=(kind.reasons or {}).get(fault, reason)):
        load(reader, ref, path)


NAMES = [name for name in DATASETS.names() if name not in ("folder", "synthetic")]


@pytest.mark.parametrize("data", [b"", b"no motion at all", b"\x80\x04", b"[" * 100_000])
@pytest.mark.parametrize("name", NAMES)
def test_broken_files(first: Any, name: str, data: bytes) -> None:
    reader, ref, path = first(name)
    path.write_bytes(data)
    with raises_message(DataError, re.escape(path.name), reason="broken_file"):
        load(reader, ref, path)
    path.unlink()
    for make in (lambda path: None, os.mkfifo):
        make(path)
        with raises_message(DataError, re.escape(path.name), reason="broken_file"):
            load(reader, ref, path)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("in_array", [False, True])
def test_pickles_that_run_code_are_refused(first: Any, name: str, in_array: bool, unpickled_marker: Any) -> None:
    reader, ref, path = first(name)
    marker, attack = unpickled_marker
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "|O", "fortran_order": False, "shape": ()})
    is_read = path.suffix == (".npy" if in_array else ".pkl")
    path.write_bytes(head.getvalue() * in_array + attack())
    with raises_message(DataError, re.escape(path.name), reason="unsafe_pickle" if is_read else "broken_file"):
        load(reader, ref, path)
    assert not marker.exists()
