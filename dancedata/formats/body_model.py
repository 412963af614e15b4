"""Skeletons from the user's body model: SMPL-X, SMPL-H or SMPL, as .npz or .pkl.

The rest joints are J_regressor @ (v_template + shapedirs @ betas) (Loper et al. 2015, eq. 10; Pavlakos et al. 2019).
The smplx library gives the same joints (a test compares the two), but runs the code in the file (allow_pickle=True).
In published .pkl files chumpy arrays and scipy's sparse matrices are read as stand-ins; no class is imported.
"""

import hashlib
from contextlib import nullcontext
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dancedata.core.bodies import SMPLH52, SMPLX55
from dancedata.core.errors import DataError, UsageError
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.text import listed, shown
from dancedata.formats.arrays import ValueArrays, open_arrays
from dancedata.formats.bvh.hierarchy import MAX_VALUE
from dancedata.formats.checked_unpickler import ClassName, StandIn, make
from dancedata.formats.numpy_pickle import is_shape
from dancedata.formats.safe_pickle import ARRAY_NAMES, Names, as_array, load_pickle

GENDERS = ("neutral", "male", "female")
#: SMPL-X files with at least this many shapes hold 300 of the body, then those of the face; older ones 10 and 10.
_SHAPES = 300
#: Bound of betas, which are in standard deviations.
_MAX_BETA = 1000.0
_SUFFIXES = (".npz", ".pkl")
#: Beginnings of the names of SMPL's first published files, such as basicModel_f_lbs_10_207_0_v1.0.0.pkl.
_BASIC = {"neutral": "basicmodel_neutral_", "male": "basicmodel_m_", "female": "basicmodel_f_"}
_BODIES = {55: SMPLX55, 52: SMPLH52, 24: SMPL24}
_KINDS = {"smplx": 55, "smplh": 52, "smpl": 24}

Floats = NDArray[np.float64]


def body_model_skeleton(
    path: Path, *, joints: Skeleton = SMPLX55, betas: ArrayLike | None = None, gender: str = "neutral"
) -> Skeleton:
    """Return a skeleton with the bones of a body model.

    Parameters
    ----------
    path
        A model file (SMPLX_NEUTRAL.npz, SMPL_MALE.pkl), or a folder of models, where `gender` and the number of
        joints select one: SMPLX_MALE.npz, smplx/SMPLX_MALE.npz, smplh/male/model.npz, ..., or the same as .pkl.
    joints
        The joints of the result: all of the model's or a subset (SMPLX52 of a SMPL-X model).
    betas
        (n,) shape of the body; None for the model's mean. Missing ones are 0.
    gender
        "neutral", "male" or "female". Not used for a model file, which has a single gender.

    Returns
    -------
    Skeleton
        Metres; joint 0's offset is its rest position. Its name identifies the body: "smplx55:1a2b3c4d".

    Raises
    ------
    UsageError
        If the model does not exist, is neither .npz nor .pkl, lacks an array, or has other joints or fewer betas.
    """
    file = find_model(path, joints=joints, gender=gender)
    model = _model(file, file.stat().st_size, file.stat().st_mtime_ns)
    body = _BODIES[len(model[0])]
    if not set(joints.joints) <= set(body.joints):
        raise UsageError(
            f"the body model does not have the joints of {joints.name}",
            where=str(file),
            found=f"{body.n_joints} joints ({body.name})",
            allowed=f"a model with {', '.join(j for j in joints.joints if j not in body.joints)}",
            fix="set body_model to the model that the motion was made with",
        )
    rest = model[0] + model[1] @ _shape(file, betas, model[1].shape[2])
    offsets = rest.copy()
    offsets[1:] -= rest[list(body.parents[1:])]
    whole = Skeleton(body.name, body.joints, body.parents, offsets, body.pairs, body.feet)
    part = whole if joints.joints == body.joints else whole.subset(joints.name, joints.joints)
    digest = hashlib.sha256((np.round(part.offsets, 6) + 0.0).astype("<f8").tobytes()).hexdigest()
    name = f"{joints.name.partition(':')[0]}:{digest[:8]}"
    return Skeleton(name, part.joints, part.parents, part.offsets, part.pairs, part.feet)


def find_model(path: Path, *, joints: Skeleton = SMPLX55, gender: str = "neutral") -> Path:
    """Return the model's file: `path` itself, or the one with that gender and joints in a folder.

    Raises
    ------
    UsageError
        If it does not exist; lists the expected files.
    """
    if gender not in GENDERS:
        raise UsageError("invalid gender of a body model", found=repr(gender), allowed=", ".join(GENDERS))
    path = Path(path).expanduser()
    if not path.is_dir():
        if path.is_file():
            return path
        raise UsageError("the body model does not exist", where=str(path), fix="correct body_model")
    kinds = [kind for kind, n in _KINDS.items() if set(joints.joints) <= set(_BODIES[n].joints)]
    if joints.name.startswith("smplh"):
        kinds = ["smplh"]
    tried = []
    for kind in kinds:
        for suffix in _SUFFIXES:
            name, model = f"{kind.upper()}_{gender.upper()}{suffix}", f"model{suffix}"
            tried += [path / name, path / kind / name, path / gender / model, path / kind / gender / model]
        tried += [] if kind != "smpl" else _basic_models(path, gender)
    model_file = next((file for file in tried if file.is_file()), None)
    if model_file is None:
        raise UsageError(
            f"the folder has no {gender} body model for {joints.name}",
            where=str(path),
            found=listed(sorted(p.name for p in path.iterdir())) or "nothing",
            allowed=" or ".join(str(file.relative_to(path)) for file in tried if file.suffix == ".npz")
            + " (or .pkl)",
            fix="set body_model to a folder with the models, or to the model's file",
        )
    return model_file


def _basic_models(path: Path, gender: str) -> list[Path]:
    """Return SMPL's first published files in a folder, or in models/ or smpl/ below it."""
    folders = [
        folder for folder in (path, path / "models", path / "smpl", path / "smpl" / "models") if folder.is_dir()
    ]
    files = [file for folder in folders for file in sorted(folder.iterdir())]
    return [file for file in files if file.suffix == ".pkl" and file.name.lower().startswith(_BASIC[gender])]


def gender_of(file: Path) -> str | None:
    """Return the gender that the name of a body model states; None if it states none."""
    stem = file.stem.lower()
    basic = next((gender for gender, head in _BASIC.items() if stem.startswith(head)), None)
    return basic or next((gender for gender in ("female", "male", "neutral") if gender in stem), None)


@lru_cache(maxsize=8)
def _model(file: Path, size: int, changed_ns: int) -> tuple[Floats, Floats]:
    """Return the rest joints of the mean body (J, 3) and their change with each shape (J, 3, B)."""
    if file.suffix.lower() not in _SUFFIXES:
        raise UsageError(
            "the body model is neither an .npz nor a .pkl file",
            where=str(file),
            found=file.suffix or "no suffix",
            allowed="SMPLX_NEUTRAL.npz, SMPL_MALE.pkl, ...",
            fix="set body_model to the model's file as published, or to the folder with it",
        )
    try:
        pickled = file.suffix.lower() == ".pkl"
        with nullcontext(_open_pickle(file)) if pickled else open_arrays(file) as arrays:
            missing = [name for name in ("v_template", "shapedirs", "J_regressor") if name not in arrays.names]
            if missing:
                raise _not_a_model(file, f"no {' and no '.join(missing)}", "v_template, shapedirs and J_regressor")
            template, regressor = arrays.read("v_template"), arrays.read("J_regressor")
            shapes = arrays.read("shapedirs")
            parents = arrays.read("kintree_table") if "kintree_table" in arrays.names else None
    except DataError as error:
        raise UsageError(
            f"the body model cannot be read: {error.problem}",
            where=str(file),
            found=error.found,
            allowed=error.allowed,
            fix="set body_model to a SMPL-X, SMPL-H or SMPL model as published (.npz or .pkl)",
        ) from error
    _check(file, template, regressor, shapes, parents)
    if len(regressor) == 55:
        shapes = shapes[..., : _SHAPES if shapes.shape[2] >= _SHAPES else min(shapes.shape[2], 10)]
    return regressor @ template, np.einsum("jv,vcb->jcb", regressor, shapes)


def _check(file: Path, template: Floats, regressor: Floats, shapes: Floats, parents: Floats | None) -> None:
    vertices = template.shape[0] if template.ndim else 0
    valid = (
        template.shape == (vertices, 3)
        and regressor.ndim == 2
        and regressor.shape[1] == vertices
        and shapes.ndim == 3
        and shapes.shape[:2] == (vertices, 3)
    )
    if not valid:
        found = f"v_template {template.shape}, J_regressor {regressor.shape}, shapedirs {shapes.shape}"
        raise _not_a_model(file, found, "(V, 3), (J, V) and (V, 3, B)")
    if len(regressor) not in _BODIES:
        raise _not_a_model(file, f"{len(regressor)} joints", "55 (SMPL-X), 52 (SMPL-H) or 24 (SMPL)")
    # NaN fails the comparison as well.
    if not all((np.abs(array) <= MAX_VALUE).all() for array in (template, regressor, shapes)):
        raise _not_a_model(file, "NaN, infinity or larger numbers", f"numbers within +-{MAX_VALUE:g}")
    expected = np.array(_BODIES[len(regressor)].parents[1:])
    if parents is not None and not (
        parents.shape == (2, len(regressor)) and np.array_equal(parents[0, 1:], expected)
    ):
        raise _not_a_model(file, "a kintree_table with other parents", f"the tree of {_BODIES[len(regressor)].name}")


def _shape(file: Path, betas: ArrayLike | None, available: int) -> Floats:
    shape = np.zeros(available)
    if betas is None:
        return shape
    values = np.asarray(betas, dtype=np.float64).reshape(-1)
    if not (np.abs(values) <= _MAX_BETA).all() or np.any(values[available:]):
        raise UsageError(
            "the betas do not match the body model",
            where=str(file),
            found=f"{len(values)} betas",
            allowed=f"at most {available}, within +-{_MAX_BETA:g}",
            fix="set body_model to the model that they were fitted with",
        )
    shape[: min(len(values), available)] = values[:available]
    return shape


def _not_a_model(file: Path, found: str, allowed: str) -> UsageError:
    fix = "set body_model to a SMPL-X, SMPL-H or SMPL model as published (.npz or .pkl)"
    return UsageError("not a body model", where=str(file), found=found, allowed=allowed, fix=fix)


_CH, _SELECT, _CSC, _CSR = "chumpy.ch.Ch", "chumpy.reordering.Select", "csc_matrix", "csr_matrix"
#: Elements of a dense matrix; SMPL-X's regressor has 55 x 10,475.
_MAX_DENSE = 1 << 24

Array = np.ndarray[Any, Any]

_NAMES: Names = {
    **ARRAY_NAMES,
    ("chumpy.ch", "Ch"): ClassName(_CH, makes=True),
    ("chumpy", "Ch"): ClassName(_CH, makes=True),
    ("chumpy.reordering", "Select"): ClassName(_SELECT, makes=True),
    **{
        (f"scipy.sparse.{module}", f"{name}_matrix"): ClassName(f"{name}_matrix", makes=True)
        for name in ("csc", "csr")
        for module in (name, f"_{name}")
    },
    **{(package, "object"): ClassName("object") for package in ("builtins", "__builtin__")},
    **{(package, "_reconstructor"): make for package in ("copyreg", "copy_reg")},
}


def _open_pickle(path: Path) -> ValueArrays:
    """Return the arrays of a body model; DataError also for contradictory sparse matrices and chumpy arrays."""
    content = load_pickle(path, _NAMES)
    if not isinstance(content, dict):
        content = {}
    return ValueArrays(path, {name: _value(path, name, value) for name, value in content.items()})


def _value(path: Path, name: object, value: object) -> object:
    if not isinstance(value, StandIn):
        return value
    try:
        return _array(value)
    except Exception as error:  # of indices and shapes that a crafted file states
        raise DataError(
            f"{shown(name)} is not an array as {value.name} holds it",
            reason="broken_file",
            where=path,
            found=shown(error),
            fix="download the model again",
        ) from error


def _array(value: StandIn) -> Array:
    state = value.state or {}
    if value.name == _CH:
        return _numbers(state["x"])
    if value.name == _SELECT:
        source = state["a"]
        if isinstance(source, StandIn) and source.name == _CH:
            source = (source.state or {})["x"]
        taken = _numbers(source).reshape(-1)[_indices(state["idxs"])]
        shape = state.get("preferred_shape", taken.shape)
        if not is_shape(shape):
            raise ValueError(f"a shape {shown(shape)}")
        return taken.reshape(shape)
    return _dense(value.name, state)


def _numbers(value: object) -> Array:
    array = as_array(value)
    if array is None or array.dtype.kind not in "fiu":
        raise ValueError(f"not an array of numbers: {shown(value)}")
    return array


def _indices(value: object) -> Array:
    array = _numbers(value)
    if array.dtype.kind not in "iu":
        raise ValueError("indices that are not whole numbers")
    return array


def _dense(kind: str, state: dict[str, Any]) -> Array:
    from scipy import sparse

    shape = state["_shape"] if "_shape" in state else state["shape"]
    if not is_shape(shape) or len(shape) != 2 or shape[0] * shape[1] > _MAX_DENSE:
        raise ValueError(f"a matrix of shape {shown(shape)}")
    parts = (_numbers(state["data"]), _indices(state["indices"]), _indices(state["indptr"]))
    matrix = (sparse.csc_matrix if kind == _CSC else sparse.csr_matrix)(parts, shape=shape)
    matrix.check_format(full_check=True)
    return np.asarray(matrix.toarray())
