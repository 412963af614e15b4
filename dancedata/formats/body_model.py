"""Skeletons from the user's body model: SMPL-X, SMPL-H or SMPL, as .npz.

The rest joints of a SMPL body are J_regressor @ (v_template + shapedirs @ betas) (Loper et al. 2015, eq. 10;
Pavlakos et al. 2019). Only these three arrays of the published file are needed, so they are read here, without
pickled objects. The smplx library gives the same joints (a test compares the two) but opens the file with
allow_pickle=True, which executes code in it, and needs torch.
"""

from __future__ import annotations

import hashlib
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dancedata.core.bodies import SMPLX52, SMPLX55
from dancedata.core.errors import DataError, UsageError
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.text import listed
from dancedata.formats.arrays import open_arrays
from dancedata.formats.bvh.hierarchy import MAX_VALUE

__all__ = ["GENDERS", "SMPLH52", "body_model_skeleton", "find_model"]

GENDERS = ("neutral", "male", "female")
#: SMPL-X files with at least this many shapes hold 300 of the body, then those of the face; older ones 10 and 10.
_SHAPES = 300
#: Bound of betas, which are in standard deviations.
_MAX_BETA = 1000.0


def _smplh52() -> Skeleton:
    offsets = np.array(SMPLX52.offsets)
    offsets[:22] = SMPL24.offsets[:22]
    return Skeleton("smplh52", SMPLX52.joints, SMPLX52.parents, offsets, SMPLX52.pairs, SMPLX52.feet)


#: SMPL-H: the body of SMPL (as in SMPL24), with SMPL-X's fingers at its wrists.
SMPLH52 = _smplh52()
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
        A model file (SMPLX_NEUTRAL.npz), or a folder of models, where `gender` and the number of joints select
        one: SMPLX_MALE.npz, smplx/SMPLX_MALE.npz, smplh/male/model.npz, ...
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
        If the model does not exist, is not an .npz, lacks an array, or has other joints or fewer betas.
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
        name = f"{kind.upper()}_{gender.upper()}.npz"
        tried += [path / name, path / kind / name, path / gender / "model.npz", path / kind / gender / "model.npz"]
    found_file = next((file for file in tried if file.is_file()), None)
    if found_file is None:
        raise UsageError(
            f"the folder has no {gender} body model for {joints.name}",
            where=str(path),
            found=listed(sorted(p.name for p in path.iterdir())) or "nothing",
            allowed=" or ".join(str(file.relative_to(path)) for file in tried),
            fix="set body_model to a folder with the models, or to the model's file",
        )
    return found_file


@lru_cache(maxsize=8)
def _model(file: Path, size: int, changed_ns: int) -> tuple[Floats, Floats]:
    """Return the rest joints of the mean body (J, 3) and their change with each shape (J, 3, B)."""
    if file.suffix.lower() != ".npz":
        raise UsageError(
            "the body model is not an .npz file; other formats are pickles, which execute code when they are loaded",
            where=str(file),
            found=file.suffix or "no suffix",
            allowed="SMPLX_NEUTRAL.npz, SMPLH_MALE.npz, ...",
            fix="download the .npz version, or save v_template, shapedirs and J_regressor with numpy.savez",
        )
    try:
        with open_arrays(file) as arrays:
            missing = [name for name in ("v_template", "shapedirs", "J_regressor") if name not in arrays.names]
            if missing:
                raise _not_a_model(file, f"no {' and no '.join(missing)}", "v_template, shapedirs and J_regressor")
            template, regressor = arrays.read("v_template"), arrays.read("J_regressor")
            shapes = arrays.read("shapedirs")
            parents = arrays.read("kintree_table") if "kintree_table" in arrays.names else None
    except DataError as error:
        raise UsageError("the body model cannot be read", where=str(file), found=str(error)) from error
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
    given = np.asarray(betas, dtype=np.float64).reshape(-1)
    if not (np.abs(given) <= _MAX_BETA).all() or np.any(given[available:]):
        raise UsageError(
            "the betas do not match the body model",
            where=str(file),
            found=f"{len(given)} betas",
            allowed=f"at most {available}, within +-{_MAX_BETA:g}",
            fix="set body_model to the model that they were fitted with",
        )
    shape[: min(len(given), available)] = given[:available]
    return shape


def _not_a_model(file: Path, found: str, allowed: str) -> UsageError:
    fix = "set body_model to a SMPL-X, SMPL-H or SMPL model as published (.npz)"
    return UsageError("not a body model", where=str(file), found=found, allowed=allowed, fix=fix)
