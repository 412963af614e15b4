"""decode: columns of one motion, of a batch, of a group of dancers, or of files, back to motions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeAlias, overload

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import UsageError
from dancedata.core.grid import Number
from dancedata.core.motion import Motion
from dancedata.core.text import shown
from dancedata.decoding.decoder import Decoder
from dancedata.decoding.files import decode_files
from dancedata.scene.inputs.files import field_of_width
from dancedata.scene.like import DatasetLike, ScalerLike, opened, store_of

#: Files of columns, folders of them, or patterns.
Files: TypeAlias = "str | Path | Sequence[str | Path]"
_OneMotion = np.ndarray[tuple[int, int], Any]
_Batch = np.ndarray[tuple[int, int, int], Any]


@overload
def decode(
    columns: _OneMotion, field: str | None = ..., *, like: DatasetLike = ..., normalized: bool | None = ...,
    scaler: ScalerLike = ..., clamp: bool = ..., fps: Number | None = ..., **parameters: Any,
) -> Motion: ...  # fmt: skip


@overload
def decode(
    columns: _Batch, field: str | None = ..., *, mask: npt.ArrayLike | None, place: npt.ArrayLike | None = ...,
    like: DatasetLike = ..., normalized: bool | None = ..., scaler: ScalerLike = ..., clamp: bool = ...,
    fps: Number | None = ..., **parameters: Any,
) -> list[Motion | None]: ...  # fmt: skip


@overload
def decode(
    columns: _Batch, field: str | None = ..., *, like: DatasetLike = ..., normalized: bool | None = ...,
    scaler: ScalerLike = ..., clamp: bool = ..., fps: Number | None = ..., **parameters: Any,
) -> list[Motion]: ...  # fmt: skip


@overload
def decode(
    columns: Files, field: str | None = ..., *, to: str, out: str | Path, like: DatasetLike = ...,
    normalized: bool | None = ..., scaler: ScalerLike = ..., clamp: bool = ..., fps: Number | None = ...,
    key: str | None = ..., overwrite: bool = ..., body_model: str | Path | None = ...,
    betas: npt.ArrayLike | None = ..., frames: str | None = ..., **parameters: Any,
) -> list[Path]: ...  # fmt: skip


def decode(
    columns: npt.NDArray[Any] | Files,
    field: str | None = None,
    *,
    like: DatasetLike = None,
    normalized: bool | None = None,
    scaler: ScalerLike = None,
    clamp: bool = False,
    fps: Number | None = None,
    mask: npt.ArrayLike | None = None,
    place: npt.ArrayLike | None = None,
    to: str | None = None,
    out: str | Path | None = None,
    key: str | None = None,
    overwrite: bool = False,
    body_model: str | Path | None = None,
    betas: npt.ArrayLike | None = None,
    frames: str | None = None,
    **parameters: Any,
) -> Motion | list[Motion] | list[Motion | None] | list[Path]:
    """Decode columns into a motion, a batch of them into a list; or files of them into motion files.

    Parameters
    ----------
    columns
        (T, D) columns, a batch (B, T, D), or with `mask` or `place` a group (P, T, D) as `GroupDataset` gives it: as
        stored, or normalised, as `normalized` states. Or files .npy, .npz, .pkl with such arrays, or batches of
        groups, folders of them and patterns, with `to` and `out`. Pickles are read without executing them; entries
        such as ``normalized``, ``fps``, ``person_mask`` and ``root_place`` of a file count.
    field
        Name of the dataset's field or of the representation that the columns are in, such as "edge151.second".
        Default: what files of `WindowDataset.save_samples` state, else the only field of `like` of their width.
    like
        The dataset that the trainer read, or its reader. A reader states its scaler, and whether it normalises.
    normalized
        True for columns that are normalised by the scaler of the dataset's field; required with a dataset as `like`.
        Columns that clearly contradict it are refused.
    scaler
        Another scaler, or the file of its ``save``: the columns are normalised by it.
    clamp
        Cut normalised values to [-1, 1] first, as EDGE and Lodge do. False: mirrored and turned motion, which is a
        little outside, comes back whole.
    fps
        Frames per second of the rows. Default: those of `like` or of the file, else the representation's, else 30.
    mask
        (P,) truth values: which dancers of a group there are; the rows of the others are ignored. Default: all.
    place
        (P, T, 6) columns of the field root_place, normalised if `columns` are: required for representations without
        a place, such as humanml263, whose dancers would else all stand at the origin.
    to
        "bvh": metres, +Y up. "npz": translation, rotations, positions, skeleton. "smpl": AMASS's arrays on SMPL-H,
        and "smplx" on SMPL-X, both +Z up. "glb": glTF, an animated skeleton, with `body_model` its skinned mesh.
        "obj": a mesh for each frame, with pose correctives.
    out
        Folder for the files: <name>.bvh, or <name>_000.bvh and so on for a batch; <name>_p0.bvh and so on for the
        dancers of a group who are there, <name>_000_p0.bvh in a batch. Meshes: <name>/<name>_000000.obj and so on.
    key
        Name of the array, where a file has several. Default: the only one with the representation's columns.
    overwrite
        Overwrite existing files.
    body_model, betas
        File of SMPL, SMPL-H or SMPL-X, whose mesh is written, required for "obj"; its shape, default: its mean.
    frames
        Frames of "obj", from 0: one, or begin:end or begin:end:step as slices of Python. Default: all.
    parameters
        Parameters of the representation, as in a recipe.

    Returns
    -------
    Motion; list of Motion, of a group None for a dancer who is not there; or the files
        Metres, radians, +Y up; the dancers of a group in one world.

    Raises
    ------
    UsageError
        For an unknown field, representation, parameter or format, for a representation that holds positions only, for
        another shape or a rate that the dataset does not have; if nothing states whether the columns are normalised,
        or they are clearly not as stated; for a scaler of another field or dataset, and existing files.
    DataError
        If the columns are not those of the representation, not finite, or a file cannot be read; with the number of
        the motion or dancer.
    StoreError
        If the files cannot be written; then none is left.

    Examples
    --------
    >>> import dancedata
    >>> ds = dancedata.open("data/aistpp")
    >>> dancedata.decode(ds.read(ds.windows("train")[3], "edge151"), "edge151", fps=ds.fps)
    Motion(150 frames at 30 FPS, 5.00 s, skeleton smpl24)
    >>> dancedata.decode("samples.npy", "edge151", like="data/aistpp", normalized=True, to="bvh", out="x")
    [PosixPath('x/samples_000.bvh'), PosixPath('x/samples_001.bvh')]
    """
    is_file = isinstance(columns, str | Path) or (
        isinstance(columns, Sequence) and bool(columns) and isinstance(columns[0], str | Path)
    )
    if is_file != (to is not None and out is not None):
        raise UsageError("files are decoded to a format and a folder, arrays to motions", found=shown(columns),
                         fix='give to="bvh" and out=FOLDER with files, and with nothing else')  # fmt: skip
    if is_file:
        return decode_files(
            columns, field, to=str(to), out=Path(str(out)), like=like, fps=fps, key=key, overwrite=overwrite,
            normalized=normalized, scaler=scaler, clamp=clamp, body_model=body_model, betas=betas, frames=frames,
            **parameters,
        )  # fmt: skip
    if field is None:
        field = _field_of_width(columns, like)
    decoder = Decoder.of(field, parameters, fps, like, normalized, scaler, clamp)
    if mask is not None or place is not None:
        return decoder.group(columns, mask, place)
    return decoder.motions(columns)


def _field_of_width(columns: Any, like: DatasetLike) -> str:
    """Return the only motion field of a dataset as wide as columns; UsageError without one."""
    (width,) = np.shape(columns)[-1:] or (0,)
    field = None if like is None else field_of_width(store_of(opened(like)), width)
    if field is None:
        raise UsageError("nothing states what these columns are", found=f"shape {np.shape(columns)}",
                         fix='name the field: decode(columns, "edge151")')  # fmt: skip
    return field
