"""Skeletons from the user's body model: SMPL-X, SMPL-H or SMPL, as .npz or .pkl.

The rest joints are J_regressor @ (v_template + shapedirs @ betas) (Loper et al. 2015, eq. 10; Pavlakos et al. 2019).
The smplx library gives the same joints (a test compares the two), but runs the code in the file (allow_pickle=True).
In published .pkl files chumpy arrays and scipy's sparse matrices are read as stand-ins; no class is imported.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dancedata.core.bodies import SMPLH52, SMPLX55
from dancedata.core.errors import DataError, UsageError
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.text import listed
from dancedata.formats.bvh.hierarchy import MAX_VALUE
from dancedata.formats.model_pickle import open_model_pickle
from dancedata.formats.values import open_arrays

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
    """Return a skeleton with the bones of a body model, metres; its name has a hash of them.

    `path`: A model file, or a folder, where `gender` and `joints` select one, such as smplh/male/model.npz.
    `joints`: The joints of the result: all of the model's or a subset (SMPLX52 of a SMPL-X model).
    `betas`: (n,) shape of the body; None for the model's mean. Missing ones are 0.
    Raises UsageError: if there is no such model, or if it lacks an array or has different joints or too few betas.
    """
    file = find_model(path, joints=joints, gender=gender)
    model = _model(file, file.stat().st_size, file.stat().st_mtime_ns)
    body = _BODIES[len(model[0])]
    if not set(joints.joints) <= set(body.joints):
        raise UsageError(f"the body model does not have the joints of {joints.name}", where=str(file),
                         found=f"{body.n_joints} joints ({body.name})",
                         allowed=f"a model with {', '.join(j for j in joints.joints if j not in body.joints)}",
                         fix="set body_model to the model that the motion was made with")  # fmt: skip
    rest = model[0] + model[1] @ shape_of(file, betas, model[1].shape[2])
    return skeleton_of(rest, body, joints)


def skeleton_of(rest: Floats, body: Skeleton, joints: Skeleton) -> Skeleton:
    """Return the skeleton of rest joints (J, 3), metres, of a body; its joints are those of `joints`."""
    offsets = rest.copy()
    offsets[1:] -= rest[list(body.parents[1:])]
    whole = Skeleton(body.name, body.joints, body.parents, offsets, body.pairs, body.feet)
    part = whole if joints.joints == body.joints else whole.subset(joints.name, joints.joints)
    digest = hashlib.sha256((np.round(part.offsets, 6) + 0.0).astype("<f8").tobytes()).hexdigest()
    name = f"{joints.name.partition(':')[0]}:{digest[:8]}"
    return Skeleton(name, part.joints, part.parents, part.offsets, part.pairs, part.feet)


def find_model(path: Path, *, joints: Skeleton = SMPLX55, gender: str = "neutral") -> Path:
    """Return the model's file: `path`, or the one of a folder with that gender and joints; UsageError without one."""
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


@dataclass(frozen=True, eq=False)
class ModelArrays:
    """Arrays of a model file, checked.

    `body`: The skeleton with the model's joints; its bones are not those of the model.
    `template`: (V, 3) vertices of the mean body, metres.
    `regressor`: (J, V) weights of the vertices in each joint.
    `shapes`: (V, 3, B) change of the vertices with each beta; of the body alone.
    `more`: Further arrays of the file, by name; not checked.
    """

    file: Path
    body: Skeleton
    template: Floats
    regressor: Floats
    shapes: Floats
    more: Mapping[str, Floats]

    @classmethod
    def read(cls, file: Path, more: Sequence[str] = ()) -> ModelArrays:
        """Read a model file; UsageError unless it is a model that also has the arrays `more`."""
        if file.suffix.lower() not in _SUFFIXES:
            raise UsageError("the body model is neither an .npz nor a .pkl file", where=str(file),
                             found=file.suffix or "no suffix", allowed="SMPLX_NEUTRAL.npz, SMPL_MALE.pkl, ...",
                             fix="set body_model to the model's file as published")  # fmt: skip
        needed = ("v_template", "shapedirs", "J_regressor", *more)
        try:
            pickled = file.suffix.lower() == ".pkl"
            with nullcontext(open_model_pickle(file)) if pickled else open_arrays(file) as arrays:
                missing = [name for name in needed if name not in arrays.names]
                if missing:
                    listed_names = f"{', '.join(needed[:-1])} and {needed[-1]}"
                    raise not_a_model(file, f"no {' and no '.join(missing)}", listed_names)
                template, shapes, regressor, *others = (arrays.read(name) for name in needed)
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
        body = _BODIES[len(regressor)]
        return cls(file, body, template, regressor, shapes, dict(zip(more, others, strict=True)))


@lru_cache(maxsize=8)
def _model(file: Path, size: int, changed_ns: int) -> tuple[Floats, Floats]:
    """Return the rest joints of the mean body (J, 3) and their change with each shape (J, 3, B)."""
    arrays = ModelArrays.read(file)
    return arrays.regressor @ arrays.template, np.einsum("jv,vcb->jcb", arrays.regressor, arrays.shapes)


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
        raise not_a_model(file, found, "(V, 3), (J, V) and (V, 3, B)")
    if len(regressor) not in _BODIES:
        raise not_a_model(file, f"{len(regressor)} joints", "55 (SMPL-X), 52 (SMPL-H) or 24 (SMPL)")
    # NaN fails the comparison as well.
    if not all((np.abs(array) <= MAX_VALUE).all() for array in (template, regressor, shapes)):
        raise not_a_model(file, "NaN, infinity or larger numbers", f"numbers within +-{MAX_VALUE:g}")
    expected = np.array(_BODIES[len(regressor)].parents[1:])
    if parents is not None and not (
        parents.shape == (2, len(regressor)) and np.array_equal(parents[0, 1:], expected)
    ):
        raise not_a_model(file, "a kintree_table with other parents", f"the tree of {_BODIES[len(regressor)].name}")


def shape_of(file: Path, betas: ArrayLike | None, available: int) -> Floats:
    """Return the betas of all shapes that a model has, (available,); missing ones are 0."""
    shape = np.zeros(available)
    if betas is None:
        return shape
    values = np.asarray(betas, dtype=np.float64).reshape(-1)
    if not (np.abs(values) <= _MAX_BETA).all() or np.any(values[available:]):
        raise UsageError("the betas do not match the body model", where=str(file), found=f"{len(values)} betas",
                         allowed=f"at most {available}, within +-{_MAX_BETA:g}",
                         fix="set body_model to the model that they were fitted with")  # fmt: skip
    shape[: min(len(values), available)] = values[:available]
    return shape


def not_a_model(file: Path, found: str, allowed: str) -> UsageError:
    """Return the UsageError for a file that is not a body model."""
    fix = "set body_model to a SMPL-X, SMPL-H or SMPL model as published (.npz or .pkl)"
    return UsageError("not a body model", where=str(file), found=found, allowed=allowed, fix=fix)
