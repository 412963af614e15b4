"""Files as programs for motion from video write them, and SMPL's published models, in their real layout.

Written by joblib, pickle and torch's format. chumpy and scipy's private modules are stand-ins that exist only while
the file is written: the pickle then names what the published files name.
"""

import io
import pickle
import sys
import types
import zipfile
from collections import OrderedDict, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import joblib
import numpy as np
from scipy import sparse
from scipy.spatial.transform import Rotation

from dancedata.core.skeleton import SMPL24

__all__ = ["dance", "gvhmr", "in_camera", "joblib_bytes", "phalp", "smpl_pickle", "torch_file", "wham", "wham_person"]


def dance(n_frames: int, seed: int = 0, joints: int = 24) -> tuple[Any, Any]:
    """Return smooth rotations (T, J, 3) and a translation (T, 3) of a standing body, +Y up, metres, 30 FPS."""
    rng = np.random.default_rng(seed)
    time = np.arange(n_frames)[:, None, None] / 30
    rotations = 0.3 * np.sin(
        2 * np.pi * rng.uniform(0.3, 1, (1, joints, 3)) * time + rng.uniform(0, 6, (1, joints, 3))
    )
    path = 0.2 * np.sin(2 * np.pi * rng.uniform(0.2, 0.5, (1, 3)) * time[:, 0] + rng.uniform(0, 6, (1, 3)))
    rotations[:, 0] *= 0.2
    return rotations, path * [1, 0.1, 1] + [0, 1, 0]


def in_camera(path: Any) -> Any:
    """Return a translation (..., 3) with +Y down and +Z away: the pelvis turns, which is at rest + translation."""
    rest = np.array(SMPL24.offsets[0])
    return (rest + path) * [1, -1, -1] - rest


def wham_person(n_frames: int, first: int = 0, seed: int = 0, vertices: int = 6890) -> dict[str, Any]:
    """Return one person of WHAM's demo.py; trans and pose are in the camera's axes."""
    rotations, path = dance(n_frames, seed)
    pose = rotations.reshape(n_frames, 72).astype(np.float32)
    camera = pose.copy()
    camera[:, :3] = (Rotation.from_euler("x", np.pi) * Rotation.from_rotvec(pose[:, :3])).as_rotvec()
    return {
        "pose": camera,
        "trans": np.add(in_camera(path), [0, 0, 4]).astype(np.float32),
        "pose_world": pose,
        "trans_world": path.astype(np.float32),
        "betas": np.random.default_rng(seed).normal(0, 0.1, (n_frames, 10)).astype(np.float32),
        "verts": np.zeros((n_frames, vertices, 3), np.float32),
        "frame_ids": np.arange(first, first + n_frames),
    }


def joblib_bytes(content: Any, compress: Any = 0, protocol: int | None = None) -> bytes:
    """Return what joblib.dump writes."""
    file = io.BytesIO()
    joblib.dump(content, file, compress=compress, protocol=protocol)
    return file.getvalue()


def wham(people: dict[int, dict[str, Any]], compress: Any = 0, protocol: int | None = None) -> bytes:
    """Return wham_output.pkl: a defaultdict by person."""
    found: dict[int, dict[str, Any]] = defaultdict(dict)
    found.update(people)
    return joblib_bytes(found, compress, protocol)


def phalp(people: dict[int, Any], compress: Any = 3, protocol: int | None = None) -> bytes:
    """Return results/demo_NAME.pkl of 4D-Humans.

    Parameters
    ----------
    people : by id, (rotations (T, 24, 3), translation (T, 3), frames (T,)) with +Y up. In the frames between where
        the person is not seen, PHALP keeps it with an old pose and tracked_time above 0.
    """
    n_frames = 1 + max(int(frames[-1]) for _, _, frames in people.values())
    turn = np.diag([1.0, -1.0, -1.0])
    content: dict[str, Any] = {}
    for frame in range(n_frames):
        name = f"outputs/_DEMO/clip/img/{frame + 1:06d}.jpg"
        row: dict[str, Any] = {"time": frame, "shot": 0, "frame_path": name, "mask": [], "appe": [], "conf": []}
        row |= {key: [] for key in ("tid", "tracked_time", "tracked_ids", "smpl", "camera", "3d_joints", "size")}
        for person, (rotations, path, frames) in people.items():
            if not frames[0] <= frame <= frames[-1]:
                continue
            at = int(np.searchsorted(frames, frame, side="right")) - 1
            matrices = Rotation.from_rotvec(rotations[at]).as_matrix()
            matrices[0] = turn @ matrices[0]
            late = frame - int(frames[at])
            row["tid"].append(person)
            row["tracked_time"].append(late)
            row["tracked_ids"] += [person] * (late == 0)
            smpl = {"global_orient": matrices[:1], "body_pose": matrices[1:], "betas": np.full(10, 0.1 * person)}
            row["smpl"].append({key: value.astype(np.float32) for key, value in smpl.items()})
            row["camera"].append(in_camera(path[at]).astype(np.float32))
            row["conf"].append(np.float32(0.9))
            row["3d_joints"].append(np.zeros((45, 3), np.float32))
            row["mask"].append([{"size": [480, 640], "counts": b"abc"}])
            row["appe"].append(np.zeros(64, np.float32))
            row["size"].append([480, 640])
        content[name] = row
    return joblib_bytes(content, compress, protocol)


def torch_file(content: Any, order: str = "little") -> bytes:
    """Return the bytes of torch.save, with numpy arrays for tensors, without torch."""
    storages: list[bytes] = []
    kinds = {"f2": "HalfStorage", "f4": "FloatStorage", "f8": "DoubleStorage", "i8": "LongStorage"}

    def names(module: str, *classes: str) -> Any:
        made = types.ModuleType(module)
        for name in classes:
            setattr(made, name, type(name, (), {"__module__": module}))
        return made

    torch, utils = names("torch", *kinds.values()), names("torch._utils")

    def rebuild(*_: Any) -> None:
        raise AssertionError

    rebuild.__module__, rebuild.__qualname__, rebuild.__name__ = "torch._utils", *["_rebuild_tensor_v2"] * 2
    utils._rebuild_tensor_v2 = rebuild

    class Storage:
        def __init__(self, array: Any) -> None:
            self.array = array

    class Tensor:
        def __init__(self, array: Any) -> None:
            self.array = array

        def __reduce__(self) -> Any:
            array = np.ascontiguousarray(self.array)
            stride = tuple(s // array.itemsize for s in array.strides)
            return rebuild, (Storage(array), 0, array.shape, stride, False, OrderedDict())

    class Pickler(pickle._Pickler):
        def persistent_id(self, value: Any) -> Any:
            if not isinstance(value, Storage):
                return None
            array = value.array
            storages.append(array.astype(array.dtype.newbyteorder("<" if order == "little" else ">")).tobytes())
            kind = getattr(torch, kinds[array.dtype.str[1:]])
            return "storage", kind, str(len(storages) - 1), "cpu", array.size

    def wrapped(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: wrapped(inner) for key, inner in value.items()}
        return Tensor(value) if isinstance(value, np.ndarray) else value

    data = io.BytesIO()
    with _modules(torch=torch, **{"torch._utils": utils}):
        Pickler(data, 2).dump(wrapped(content))
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("hmr4d_results/data.pkl", data.getvalue())
        archive.writestr("hmr4d_results/byteorder", order)
        for key, raw in enumerate(storages):
            archive.writestr(f"hmr4d_results/data/{key}", raw)
        archive.writestr("hmr4d_results/version", "3\n")
    return file.getvalue()


def gvhmr(n_frames: int, seed: int = 0) -> dict[str, Any]:
    """Return the content of GVHMR's hmr4d_results.pt."""
    rotations, path = dance(n_frames, seed, 22)
    rows = rotations.reshape(n_frames, 66).astype(np.float32)
    world = {"body_pose": rows[:, 3:], "betas": np.zeros((n_frames, 10), np.float32)}
    world |= {"global_orient": rows[:, :3], "transl": path.astype(np.float32)}
    camera = {**world, "transl": in_camera(path).astype(np.float32)}
    return {
        "smpl_params_global": world,
        "smpl_params_incam": camera,
        "K_fullimg": np.tile(np.eye(3, dtype=np.float32), (n_frames, 1, 1)),
        "net_outputs": {"static_conf_logits": np.zeros((1, n_frames, 6), np.float16), "n": 3},
    }


@contextmanager
def _modules(**made: Any) -> Iterator[None]:
    before = {name: sys.modules.get(name) for name in made}
    sys.modules.update(made)
    try:
        yield
    finally:
        for name, module in before.items():
            sys.modules.pop(name)
            if module is not None:
                sys.modules[name] = module


def smpl_pickle(
    arrays: dict[str, Any],
    chumpy: tuple[str, ...] = ("shapedirs", "posedirs"),
    protocol: int = 2,
    *,
    regressor: dict[str, Any] | None = None,
) -> bytes:
    """Return a SMPL model as it is published: a pickle of Python 2 with chumpy arrays and a sparse regressor.

    Parameters
    ----------
    arrays : name -> array; J_regressor becomes a csc_matrix, those in `chumpy` become chumpy arrays.
    regressor : attributes of the csc_matrix that are to differ.
    """
    names = ("chumpy", "chumpy.ch", "chumpy.reordering", "scipy.sparse.csc")
    modules: dict[str, Any] = {name: types.ModuleType(name) for name in names}
    ch, reordering, csc = (modules[name] for name in names[1:])
    ch.Ch = type("Ch", (), {"__module__": "chumpy.ch"})
    reordering.Select = type("Select", (ch.Ch,), {"__module__": "chumpy.reordering"})
    csc.csc_matrix = type("csc_matrix", (), {"__module__": "scipy.sparse.csc"})

    def value(name: str, array: Any) -> Any:
        if name == "J_regressor":
            made, matrix = csc.csc_matrix(), sparse.csc_matrix(array)
            made.__dict__ = {"_shape": matrix.shape, "maxprint": 50, "indices": matrix.indices, "format": "csc"}
            made.__dict__ |= {"indptr": matrix.indptr, "data": matrix.data, **(regressor or {})}
            return made
        if name not in chumpy:
            return array
        made = ch.Ch()
        made.__dict__ = {"x": array, "_dirty_vars": {"x"}, "_itr": None, "_status": "new"}
        if name == "shapedirs":  # the released file has the first ten of more shapes
            more = np.concatenate([array, array[..., :2] + 1], axis=2)
            made.x = more
            index = np.arange(more.size).reshape(more.shape)[..., : array.shape[2]]
            chosen = reordering.Select()
            chosen.__dict__ = {"a": made, "idxs": index.ravel(), "preferred_shape": array.shape}
            return chosen
        return made

    with _modules(**modules):
        content = {name: value(name, array) for name, array in arrays.items()}
        data = pickle.dumps({**content, "bs_type": "lrotmin", "bs_style": "lbs"}, protocol)
    return data
