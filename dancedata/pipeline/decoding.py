"""decode: columns, one motion or a batch of them, back to motions, and the output of a trainer to motion files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, overload

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import DanceDataError, DataError, StoreError, UsageError, did_you_mean
from dancedata.core.grid import FrameGrid, Number
from dancedata.core.motion import Motion
from dancedata.core.plugins import Representation
from dancedata.core.registry import REPRESENTATIONS
from dancedata.files import atomic
from dancedata.formats.arrays import ArrayFile, open_arrays
from dancedata.formats.motion_files import MOTION_FILES, motion_file
from dancedata.recipes.plugins import make_named

if TYPE_CHECKING:
    from dancedata.store import Store
    from dancedata.store.normalize import MinMax
    from dancedata.store.scaling import Reader


#: A dataset, open or not, or a reader of it.
Like: TypeAlias = "Store | Reader | str | Path | None"
#: A scaler, or its file.
Scaler: TypeAlias = "MinMax | str | Path | None"
_OneMotion = np.ndarray[tuple[int, int], Any]
_Batch = np.ndarray[tuple[int, int, int], Any]


@overload
def decode(
    array: _Batch, representation: str, *, fps: Number | None = ..., like: Like = ..., normalized: bool | None = ...,
    scaler: Scaler = ..., clip: bool = ..., **parameters: Any,
) -> list[Motion]: ...  # fmt: skip


@overload
def decode(
    array: _OneMotion, representation: str, *, fps: Number | None = ..., like: Like = ...,
    normalized: bool | None = ..., scaler: Scaler = ..., clip: bool = ..., **parameters: Any,
) -> Motion: ...  # fmt: skip


def decode(
    array: npt.NDArray[Any],
    representation: str,
    *,
    fps: Number | None = None,
    like: Like = None,
    normalized: bool | None = None,
    scaler: Scaler = None,
    clip: bool = False,
    **parameters: Any,
) -> Motion | list[Motion]:
    """Decode the columns of a representation into a motion, or a batch of them into a list.

    Parameters
    ----------
    array
        (T, D) columns, or a batch (B, T, D): as stored, or normalised, as `normalized` states.
    representation
        Name of the representation that the columns are in; with `like` the name of the dataset's field, such as
        "edge151.second".
    fps
        Frames per second of the rows. Default: those of `like`, else the representation's rate, else 30.
    like
        The dataset that the trainer read, or its reader. A reader states its scaler, and whether it normalises.
    normalized
        True for columns that are normalised by the scaler of the dataset's field; required with a dataset as `like`.
        Columns that clearly contradict it are refused.
    scaler
        Another scaler, or the file of its ``save``: the columns are normalised by it.
    clip
        Clip normalised values to [-1, 1] first, as EDGE and Lodge do. False: mirrored and turned motion, which is a
        little outside, comes back whole.
    parameters
        Parameters of the representation, as in a recipe.

    Returns
    -------
    Motion, or list of Motion for a batch
        Metres, radians, +Y up.

    Raises
    ------
    UsageError
        For an unknown representation or parameter, for a representation that holds positions only, for another shape
        or a rate that the dataset does not have; if nothing states whether the columns are normalised, or they are
        clearly not as stated; for a scaler of another field or dataset.
    DataError
        If the columns are not those of the representation, or not finite; for a batch with the number of the motion.

    Examples
    --------
    >>> import dancedata
    >>> ds = dancedata.open("data/aistpp")
    >>> dancedata.decode(ds.read(ds.windows("train")[3], "edge151"), "edge151", fps=ds.fps)
    Motion(150 frames at 30 FPS, 5.00 s, skeleton smpl24)
    """
    name, _ = REPRESENTATIONS.split(representation)
    plugin = make_named(REPRESENTATIONS, "motion", name, parameters)
    return _decoded(array, representation, plugin, fps, _Statement(like, normalized, scaler, clip))


@dataclass(frozen=True)
class _Statement:
    """Statements of a call, and of its file, on the scaling of columns and on their rate."""

    like: Like
    normalized: bool | None
    scaler: Scaler
    clip: bool
    file: bool | None = None
    grid: FrameGrid | None = None


def _decoded(
    array: Any, representation: str, plugin: Representation, fps: Number | None, stated: _Statement
) -> Motion | list[Motion]:
    from dancedata.store.scaling import Scaling, opened, store_of

    if not plugin.decodes:
        raise UsageError(
            f"{representation} cannot be decoded: positions do not determine how a bone turns about its own axis",
            fix="use the positions unchanged, or store a representation that holds rotations as well",
        )
    array = _numbers(array, representation)
    _require_shape(array, plugin, representation)
    like = None if stated.like is None else opened(stated.like)
    store = None if like is None else store_of(like)
    grid = _grid(plugin, representation, fps, store, stated.grid)
    scaling = Scaling.of(
        like, representation, plugin.columns.labels, normalized=stated.normalized, scaler=stated.scaler,
        clip=stated.clip,
    )  # fmt: skip
    array = scaling.undo(array, plugin, file=stated.file)
    if array.ndim == 2:
        return plugin.decode(array, grid)
    return [_numbered(plugin, one, grid, number) for number, one in enumerate(array)]


def decode_file(
    path: str | Path,
    representation: str,
    *,
    to: Literal["bvh", "npz", "smpl", "smplx"],
    out: str | Path,
    like: Like = None,
    fps: Number | None = None,
    key: str | None = None,
    overwrite: bool = False,
    normalized: bool | None = None,
    scaler: Scaler = None,
    clip: bool = False,
    **parameters: Any,
) -> list[Path]:
    """Decode a file that a trainer wrote into motion files, as ``dancedata decode`` does.

    Parameters
    ----------
    path
        .npy, .npz or .pkl with columns (T, D), or a batch (B, T, D). Pickles are read without executing them. An
        entry ``normalized``, True or False, states whether the columns are normalised, and one such as ``fps`` their
        rate.
    representation, like, normalized, scaler, clip, parameters
        As in `decode`.
    to
        "bvh": metres, +Y up. "npz": translation, rotations, positions, skeleton. "smpl": AMASS's arrays on SMPL-H,
        and "smplx" on SMPL-X, both +Z up.
    out
        Folder for the files: <name>.bvh, or <name>_000.bvh and so on for a batch.
    fps
        Frames per second. Default: those of `like` or of the file, or of the representation.
    key
        Name of the array, where the file has several. Default: the only one with the representation's columns.
    overwrite
        Overwrite existing files.

    Returns
    -------
    list of Path
        The files, in the order of the batch.

    Raises
    ------
    UsageError
        As `decode`; for an unknown format or array, an unknown rate, and existing files.
    DataError
        As `decode`; if the file cannot be read, or states a rate other than `fps` or `like`.
    StoreError
        If the files cannot be written; then none is left.

    Examples
    --------
    >>> import dancedata
    >>> dancedata.decode_file("samples.npy", "edge151", to="bvh", like="data/aistpp", normalized=True, out="x")
    [PosixPath('x/samples_000.bvh'), PosixPath('x/samples_001.bvh')]
    """
    path, out = Path(path).expanduser(), Path(out).expanduser()
    if to not in MOTION_FILES:
        raise UsageError(f"unknown format {to!r}", fix=did_you_mean(to, MOTION_FILES))
    if path.is_dir():
        raise UsageError("a folder cannot be decoded", where=path, allowed="one file", fix="call it for each file")
    name, _ = REPRESENTATIONS.split(representation)
    plugin = make_named(REPRESENTATIONS, "motion", name, parameters)
    from dancedata.datasets.folder import stated_grid
    from dancedata.store.scaling import stated_in

    with open_arrays(path) as arrays:
        array, file, grid = arrays.read(_key(arrays, plugin, key)), stated_in(arrays), stated_grid(arrays)
    if like is None and fps is None and plugin.rate is None and grid is None:
        raise UsageError(
            "the frame rate of these columns is unknown",
            where=path,
            fix="give it with --fps, or name the dataset that the trainer read with --like",
        )
    try:
        motions = _decoded(array, representation, plugin, fps, _Statement(like, normalized, scaler, clip, file, grid))
    except DanceDataError as error:
        error.where = f"{path}, {error.where}" if error.where else path
        raise
    files = _files(path, out, to, motions)
    if any(file.exists() and file.samefile(path) for file in files):
        raise UsageError("the file that is decoded would be replaced", where=path, fix="choose another --out")
    return _written(files, overwrite)


def _numbers(array: Any, name: str) -> npt.NDArray[Any]:
    """Return an array of floats or integers."""
    try:
        numbers = np.asarray(array)
        problem = "" if numbers.dtype.kind in "iuf" else f"dtype {numbers.dtype}"
    except (TypeError, ValueError, RuntimeError) as error:  # lists of unequal length; tensors that numpy cannot hold
        problem = str(error)
    if problem:
        fix = "pass a numpy array: tensor.detach().cpu().float().numpy()"
        raise UsageError(f"these are not columns of {name}", found=problem, allowed="floats or integers", fix=fix)
    return numbers


def _require_shape(array: npt.NDArray[Any], plugin: Representation, name: str) -> None:
    width = plugin.columns.width
    if array.ndim not in (2, 3) or array.shape[-1] != width or 0 in array.shape:
        raise UsageError(
            f"these are not columns of {name}",
            found=f"shape {array.shape}",
            allowed=f"(T, {width}) or a batch (B, T, {width}), not empty",
            fix=_named_by_width(array.shape[-1]) if array.ndim in (2, 3) and array.shape[-1] != width else None,
        )


def _named_by_width(width: int) -> str | None:
    fitting = [n for n in REPRESENTATIONS.names() if REPRESENTATIONS.get(n)().columns.width == width]
    return f"{width} columns are those of {' or '.join(fitting)}" if fitting else None


def _grid(
    plugin: Representation, name: str, fps: Number | None, store: Store | None, file: FrameGrid | None
) -> FrameGrid:
    stored = None if store is None else FrameGrid(store.field(name).rate)
    grid = FrameGrid.of(fps) if fps is not None else stored or file or FrameGrid(plugin.rate or FrameGrid.of(30).rate)
    from dancedata.datasets.folder import same_rate

    if not same_rate(file, grid):
        raise DataError(
            "the file states another rate", reason="bad_rate", found=f"{file} frames per second",
            allowed=f"{grid}, as --fps or --like states", fix="leave the wrong one out, or save the file again",
        )  # fmt: skip
    if stored is not None and grid != stored:
        raise UsageError(
            f"{name} has another rate in the dataset",
            where=store.path if store else None,
            found=f"{grid} frames per second",
            allowed=f"{stored}",
            fix="omit fps: the rate is the dataset's",
        )
    return grid


def _numbered(plugin: Representation, array: npt.NDArray[Any], grid: FrameGrid, number: int) -> Motion:
    try:
        return plugin.decode(array, grid)
    except DanceDataError as error:
        error.where = f"motion {number} of the batch" + (f", {error.where}" if error.where else "")
        raise


def _key(arrays: ArrayFile, plugin: Representation, key: str | None) -> str:
    width = plugin.columns.width
    if key is not None:
        if key not in arrays.names:
            raise UsageError(
                f"the file has no array {key!r}", where=arrays.path, fix=did_you_mean(key, list(arrays.names))
            )
        return key
    if len(arrays.names) == 1:
        return arrays.names[0]
    fitting = [name for name in arrays.names if _shape(arrays, name)[-1:] == (width,)]
    if len(fitting) != 1:
        raise UsageError(
            f"{'several arrays have' if fitting else 'no array has'} {width} columns",
            where=arrays.path,
            found=arrays.listed,
            fix="name the array with --key" if fitting else "name the representation that the file holds with --as",
        )
    return fitting[0]


def _shape(arrays: ArrayFile, name: str) -> tuple[int, ...]:
    try:
        return arrays.shape(name)
    except DanceDataError:
        return ()  # not numbers


def _files(path: Path, out: Path, to: str, motions: Motion | list[Motion]) -> Mapping[Path, bytes]:
    """Return the bytes of <name>.bvh for one motion, of <name>_000.bvh, ... for a batch."""
    suffix = MOTION_FILES[to][0]
    if isinstance(motions, Motion):
        return {out / f"{path.stem}{suffix}": motion_file(motions, to)}
    digits = max(3, len(str(len(motions) - 1)))
    return {out / f"{path.stem}_{k:0{digits}}{suffix}": motion_file(one, to) for k, one in enumerate(motions)}


def _written(files: Mapping[Path, bytes], overwrite: bool) -> list[Path]:
    existing = [path for path in files if path.exists()]
    if existing and not overwrite:
        raise UsageError("files are already there", where=existing[0], fix="choose another --out, or add --overwrite")
    done: list[Path] = []
    try:
        for path, data in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            atomic.write_bytes(path, data)
            done.append(path)
    except OSError as error:
        for path in done:
            if path not in existing:
                path.unlink(missing_ok=True)
        raise StoreError("the motion files cannot be written", where=path.parent, found=str(error)) from error
    return done
