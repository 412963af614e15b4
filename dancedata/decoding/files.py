"""decode_files: the output of a trainer, of single dancers or of groups, as motion files."""

from __future__ import annotations

import logging
import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy.typing as npt

from dancedata.core.clip import member_id
from dancedata.core.errors import DanceDataError, StoreError, UsageError, did_you_mean
from dancedata.core.grid import Number
from dancedata.core.motion import Motion
from dancedata.core.plugins import Representation
from dancedata.core.text import counted, listed, shown
from dancedata.decoding.decoder import Decoder
from dancedata.files import atomic
from dancedata.files.listing import named_files
from dancedata.formats.arrays import Array, ArrayFile, stated_scaling
from dancedata.formats.body_mesh import BodyMesh, obj_text
from dancedata.formats.gltf import motion_glb
from dancedata.formats.motion_files import MOTION_FILES, motion_file
from dancedata.formats.stated import PERSON_MASK, stated_grid
from dancedata.formats.values import MOTION_SUFFIXES, open_arrays
from dancedata.kernel import saved_samples
from dancedata.scene.inputs.files import field_of_width
from dancedata.scene.like import DatasetLike, ScalerLike, opened, store_of

_log = logging.getLogger(__name__)

#: Entries of a group's file: which of its dancers there are, and where they are.
_ROOT_PLACE = "root_place"
#: Names of the formats; obj needs a body model, and has a file for each frame.
FORMATS = (*MOTION_FILES, "obj")
_SUFFIXES = tuple(suffix for suffix in MOTION_SUFFIXES if suffix != ".bvh")


def decode_files(path: Any, field: str | None, *, to: str, out: Path, **options: Any) -> list[Path]:
    """Decode the files that a trainer wrote into motion files; see `dancedata.decode`."""
    if to not in FORMATS:
        raise UsageError(f"unknown format {to!r}", fix=did_you_mean(to, FORMATS))
    named = [path] if isinstance(path, str | Path) else list(path)
    paths = named_files([Path(p).expanduser() for p in named], _SUFFIXES)
    stems = Counter(p.stem for p in paths)
    if twice := sorted(stem for stem, n in stems.items() if n > 1):
        raise UsageError("two files have the same name", where=out, found=listed(twice), fix="rename one of them")
    written: list[Path] = []
    lost: Counter[str] = Counter()
    for file in paths:
        written += _decode_file(file, field, lost, to=to, out=out.expanduser(), **options)
    for sentence, n in lost.items():
        _log.warning("%s (%s)", sentence, counted(n, "motion"))
    return written


def _decode_file(
    path: Path,
    field: str | None,
    lost: Counter[str],
    *,
    to: str,
    out: Path,
    like: DatasetLike,
    fps: Number | None,
    key: str | None,
    overwrite: bool,
    normalized: bool | None,
    scaler: ScalerLike,
    clamp: bool,
    body_model: str | Path | None,
    betas: npt.ArrayLike | None,
    frames: str | None,
    **parameters: Any,
) -> list[Path]:
    """Decode a file, and count what its motions lose on a body model."""
    if (saved := saved_samples(path)) is not None:
        like = saved.dataset if like is None else like
        scaler = saved.chosen_scaler(scaler, normalized)
        field = field or saved.field
    if field is None and like is not None:
        field = field_of_width(store_of(opened(like)), path)
    if field is None:
        raise UsageError("nothing states what these columns are", where=path, reason="not_stated",
                         fix="name it: field=\"edge151\"", options="name it: --field edge151")  # fmt: skip
    mesh = _mesh(to, body_model, betas, frames)
    decoder = Decoder.of(field, parameters, fps, like, normalized, scaler, clamp)
    with open_arrays(path) as arrays:
        array = arrays.read(_key(arrays, decoder.representation, key))
        mask, place = (arrays.read(name) if name in arrays.names else None for name in (PERSON_MASK, _ROOT_PLACE))
        decoder = replace(decoder, file=stated_scaling(arrays), grid=stated_grid(arrays))
    if like is None and fps is None and decoder.representation.rate is None and decoder.grid is None:
        raise UsageError("the frame rate of these columns is unknown", where=path,
                         fix="give it, or name the dataset that the trainer read: fps= or like=",
                         options="give it, or name the dataset that the trainer read: --fps RATE or --like DATASET",
                         )  # fmt: skip
    try:
        motions = _motions(decoder, array, mask, place)
    except DanceDataError as error:
        error.where = f"{path}, {error.where}" if error.where else path
        raise
    if mesh is not None:
        lost.update(filter(None, map(mesh.lost, motions.values())))
    files = {
        out / name: data
        for end, motion in motions.items()
        for name, data in _files(f"{path.stem}{end}", motion, to, mesh, frames).items()
    }
    if any(file.exists() and file.samefile(path) for file in files):
        raise UsageError("the file that is decoded would be replaced", where=path, fix="choose another folder")
    return _written(files, overwrite)


def _mesh(to: str, body_model: str | Path | None, betas: npt.ArrayLike | None, frames: str | None) -> BodyMesh | None:
    """Return the body model; UsageError for options that do not go with the format."""
    if frames is not None and to != "obj":
        raise UsageError("frames can be chosen for obj only", found=f"frames {frames} with {to}")
    if body_model is None:
        if to == "obj":
            fix = "name its file, or write the skeleton alone as glb"
            raise UsageError("obj files need a body model", allowed="a file of SMPL, SMPL-H or SMPL-X", fix=fix)
        if betas is not None:
            raise UsageError("betas are the shape of a body model", fix="name its file")
        return None
    if to not in ("glb", "obj"):
        raise UsageError("only the formats glb and obj use a body model", found=to)
    return BodyMesh.read(body_model, betas)


def _files(
    name: str, motion: Motion, to: str, mesh: BodyMesh | None, frames: str | None
) -> dict[str, Callable[[], bytes]]:
    """Return the files of a motion by name; meshes are made one at a time."""
    if mesh is None:
        return {f"{name}{MOTION_FILES[to][0]}": partial(bytes, motion_file(motion, to))}
    if to == "glb":
        return {f"{name}.glb": partial(bytes, motion_glb(motion, mesh))}
    posed = mesh.on(motion)
    return {f"{name}/{name}_{k:06d}.obj": partial(_obj, posed, mesh, k) for k in _chosen(frames, motion.n_frames)}


def _obj(motion: Motion, mesh: BodyMesh, frame: int) -> bytes:
    return obj_text(next(mesh.posed(motion.part(frame, frame + 1))), mesh.faces).encode()


def _chosen(frames: str | None, n_frames: int) -> range:
    """Return the frames that a text such as "12" or "0:300:10" names."""
    whole = range(n_frames)
    if frames is None:
        return whole
    chosen = range(0)
    if re.fullmatch(r"\d{1,9}|\d{0,9}:\d{0,9}(:[1-9]\d{0,8})?", frames):
        begin, *rest = [int(part) if part else None for part in frames.split(":")]
        chosen = whole[slice(begin, *rest)] if rest else whole[begin:][:1] if begin in whole else chosen
    if not chosen:
        raise UsageError(
            "no such frames", found=shown(frames), where=f"a motion of {n_frames} frames",
            allowed=f"0 to {n_frames - 1}, or BEGIN:END or BEGIN:END:STEP, such as 0:{n_frames}:10",
        )  # fmt: skip
    return chosen


def _motions(decoder: Decoder, array: Array, mask: Array | None, place: Array | None) -> dict[str, Motion]:
    """Return the motions by the ends of their files' names: "", _000 in a batch, _p0 in a group, _000_p0 in both."""
    if array.ndim < 4 and mask is None and place is None:
        motions = decoder.motions(array)
        return (
            {"": motions} if isinstance(motions, Motion) else dict(zip(_numbers(len(motions)), motions, strict=True))
        )
    if array.ndim < 4:
        return _members("", decoder.group(array, mask, place))
    for name, beside in ((PERSON_MASK, mask), (_ROOT_PLACE, place)):
        if beside is not None and len(beside) != len(array):
            raise UsageError(
                f"{name} has a different number of groups than the columns", found=len(beside), allowed=len(array)
            )
    dancers: dict[str, Motion] = {}
    for number, name in enumerate(_numbers(len(array))):
        one = [None if entry is None else entry[number] for entry in (array, mask, place)]
        try:
            dancers |= _members(name, decoder.group(*one))
        except DanceDataError as error:
            error.where = f"group {number} of the batch" + (f", {error.where}" if error.where else "")
            raise
    return dancers


def _members(name: str, motions: list[Motion | None]) -> dict[str, Motion]:
    return {member_id(name, p): motion for p, motion in enumerate(motions) if motion is not None}


def _numbers(n: int) -> list[str]:
    digits = max(3, len(str(n - 1)))
    return [f"_{k:0{digits}}" for k in range(n)]


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
            fix="name the array: key=NAME in Python"
            if fitting
            else "name the representation that the file holds with --field",
        )
    return fitting[0]


def _shape(arrays: ArrayFile, name: str) -> tuple[int, ...]:
    try:
        return arrays.shape(name)
    except DanceDataError:
        return ()  # not numbers


def _written(files: Mapping[Path, Callable[[], bytes]], overwrite: bool) -> list[Path]:
    existing = [path for path in files if path.exists()]
    if existing and not overwrite:
        raise UsageError("files are already there", where=existing[0], fix="choose another folder, or overwrite them")
    done: list[Path] = []
    try:
        for path, data in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            atomic.write_bytes(path, data())
            done.append(path)
    except OSError as error:
        for path in done:
            if path not in existing:
                path.unlink(missing_ok=True)
        raise StoreError("the motion files cannot be written", where=path.parent, found=str(error)) from error
    return done
