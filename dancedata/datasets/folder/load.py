"""One motion file of any format -> canonical motion, and the facts about it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.rest import SMPL_REST, rest_positions
from dancedata.core.rotations import rotation
from dancedata.core.sides import sides_of, wrong_up
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.datasets.folder.array_layouts import Layout, read_motion, recognise
from dancedata.datasets.folder.facts import (
    GUESS,
    IN_MANIFEST,
    IN_RECIPE,
    Declared,
    Fact,
    bad_declaration,
    decide,
    undeclared,
)
from dancedata.datasets.folder.people import on_video_frames, open_person, seen_in
from dancedata.datasets.folder.positions import (
    JOINT_SETS,
    body_at,
    fit_body,
    height_of,
    humanml_at,
    joint_names,
    map_names,
)
from dancedata.formats.arrays import ArrayFile
from dancedata.formats.body_model import GENDERS, body_model_skeleton, find_model, gender_of
from dancedata.formats.bvh.joint_names import JointMap, map_joints
from dancedata.formats.bvh.kinematics import stretch, world
from dancedata.formats.bvh.parse import Bvh, read_bvh, read_bvh_header
from dancedata.formats.bvh.retarget import Rig, make_rig, retarget, skeleton_of, uneven_bones
from dancedata.formats.stated import RATE_KEYS, UNITS, UPRIGHT, drift_note, metres, rate_of_period, stored_rate
from dancedata.formats.video_pose import PersonArrays

NO_LENGTH = "BVH bones without length"
#: Height of a skeleton in a guessed unit, toes to head joint at rest, metres.
_PLAUSIBLE_M = (1.2, 2.2)
_UNITS_ALLOWED = f"{', '.join(UNITS)}, or metres per unit, such as 0.0254"

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Reading:
    """Declarations for one file and for all files, which decide how it is read; keys as in `Folder`."""

    manifest: Declared
    recipe: Declared
    joint_map: Mapping[str, str] | str | None = None
    body_model: Path | None = None
    keys: Mapping[str, str] | None = None
    joints: Sequence[str] | str | None = None


def load_motion(path: Path, reading: Reading) -> Motion:
    """Read a motion file: metres, +Y up, radians, exact rate; DataError if it contradicts its declarations."""
    if path.suffix.lower() == ".bvh":
        return _load_bvh(path, reading)
    with open_person(path, reading.manifest.person) as arrays:
        return motion_of(arrays, reading)


def motion_of(arrays: ArrayFile, reading: Reading) -> Motion:
    """Return the motion of the arrays of a file, or of one dancer in it; errors as `load_motion`."""
    from scipy.spatial.transform import Rotation

    layout = recognised(arrays, reading)
    facts = _array_facts(arrays, layout, reading)
    if layout.body == "positions":
        return _fitted(arrays, layout, reading, facts)
    translation, rotations, first = on_video_frames(arrays, *read_motion(arrays, layout))
    skeleton = layout.skeleton
    if reading.body_model is not None:
        skeleton = _body(arrays, layout, reading, reading.body_model)
    root = skeleton.offsets[0]
    translation = translation * facts.metres
    if facts.up.value != "y":
        upright = UPRIGHT[facts.up.value]
        # SMPL rotates about the pelvis, which is at root + translation: that point rotates with the axes.
        translation = (root + translation) @ upright.T - root
        rotations = rotations.copy()
        rotations[:, 0] = (Rotation.from_matrix(upright) * rotation(rotations[:, 0])).as_rotvec()
    motion = Motion(translation, rotations, FrameGrid(facts.rate.value), skeleton, first)
    if facts.up.where != IN_MANIFEST:  # the manifest's declaration is not questioned
        _check_up(arrays.path, motion.joints(), facts.up)
    return motion


@dataclass(frozen=True)
class FileFacts:
    """Frame rate, up axis and unit of a file, each with its origin; `metres` is the unit's size."""

    rate: Fact[Fraction]
    up: Fact[str]
    unit: Fact[str]
    metres: float

    def __str__(self) -> str:
        rotated = ", rotated to +Y" if self.up.value != "y" else ""
        axis = self.up.value.upper() if self.up.value.startswith("-") else f"+{self.up.value.upper()}"
        unit = self.unit.value if self.unit.value in UNITS else f"1 unit = {self.metres:.7g} m"
        return (
            f"{self.rate.value} FPS ({self.rate.where}); {axis} up ({self.up.where}){rotated}; "
            f"{unit} ({self.unit.where})"
        )


def _fitted(arrays: ArrayFile, layout: Layout, reading: Reading, facts: FileFacts) -> Motion:
    at, unseen = _body_at(arrays, layout, reading)
    upright = at * facts.metres @ UPRIGHT[facts.up.value].T
    motion = fit_body(arrays.path, upright, unseen, FrameGrid(facts.rate.value))
    joints = motion.joints()
    if facts.up.where != IN_MANIFEST:
        _check_up(arrays.path, joints, facts.up)
    _check_sides(arrays.path, joints, toes=not {10, 11} & set(unseen))
    return motion


def _body_at(arrays: ArrayFile, layout: Layout, reading: Reading) -> tuple[Floats, list[int]]:
    if layout.name == "humanml3d":
        return humanml_at(arrays)
    return body_at(arrays, layout.poses or "", layout.joints or reading.joints, reading.joint_map)


def _fitting_note(arrays: ArrayFile, layout: Layout, reading: Reading) -> tuple[str, ...]:
    if layout.joints:
        names, where = JOINT_SETS[layout.joints], f"{layout.name}'s definition"
    else:
        names, where = joint_names(arrays, layout.poses or "", reading.joints)
    of = map_names(arrays.path, names, None if layout.joints else reading.joint_map)
    missing = [joint for s, joint in enumerate(SMPL24.joints) if s not in of and not joint.startswith("spine")]
    without = f"; without {', '.join(missing)}" if missing else ""
    return (
        f"Positions of {len(names)} joints ({where}){without}: rotations are fitted, twists of bones are unknown",
    )


def recognised(arrays: ArrayFile, reading: Reading) -> Layout:
    """Return the layout of a file of arrays, checked against the declared one."""
    return recognise(arrays, reading.manifest.layout or reading.recipe.layout or "auto", reading.keys)


def _array_facts(arrays: ArrayFile, layout: Layout, reading: Reading) -> FileFacts:
    """Return the facts about a file of arrays; DataError (``undeclared``, ``bad_rate``) if one is unknown."""
    path, found = arrays.path, f"layout {layout.name}, arrays {arrays.listed}"
    if layout.poses == "":
        found = f"layout {layout.name}, an array without names"
    stated = None
    key = next((key for key in RATE_KEYS if key in arrays.names), None)
    if key is not None and reading.manifest.fps is None:
        stated = Fact(stored_rate(arrays, key), key)
    stated = stated or layout.rate
    rate_fact = decide(reading.manifest.rate, stated, reading.recipe.rate)
    up = decide(reading.manifest.up, layout.up, reading.recipe.up)
    unit = decide(reading.manifest.unit, layout.unit, reading.recipe.unit)
    # The unit is guessed from bones, which files of rotations do not contain.
    factor: float | None
    if unit is not None and unit.value == GUESS and layout.body == "positions":
        unit, factor = _guessed(height_of(_body_at(arrays, layout, reading)[0]), unit)
    else:
        factor = None if unit is None else metres(unit.value)
    also = [*["up"] * (up is None), *["unit"] * (factor is None)]
    if rate_fact is None:
        raise undeclared(path, "fps", "frame rate", "frames per second, such as 30 or 30000/1001", found, also)
    if up is None:
        raise undeclared(path, "up", "up axis", "y, z, or -y (a camera's axes)", found, also[1:])
    if unit is None or factor is None:
        raise undeclared(path, "unit", "unit of the translation", _UNITS_ALLOWED, found)
    return FileFacts(rate_fact, up, unit, factor)


def _body(arrays: ArrayFile, layout: Layout, reading: Reading, model: Path) -> Skeleton:
    """Return the skeleton of the user's body model, with the file's gender and betas."""
    stated = arrays.text("gender").strip().lower() if "gender" in arrays.names else ""
    fact = decide(
        reading.manifest.gender, Fact(stated, "the file") if stated in GENDERS else None, reading.recipe.gender
    )
    gender = fact.value if fact is not None else "neutral"
    betas = _betas(arrays) if "betas" in arrays.names else None
    try:
        file = find_model(model, joints=layout.skeleton, gender=gender)
        named = gender_of(file)
        if betas is not None and fact is not None and named not in (None, gender):
            raise bad_declaration(
                arrays.path,
                f"the betas of this file are for a {gender} body, but the body model is {named}",
                f"{fact}, {file.name}",
                f"a {gender} body model",
                "set body_model to a folder with the models of all genders, or declare gender",
            )
        return body_model_skeleton(file, joints=layout.skeleton, betas=betas, gender=gender)
    except UsageError as error:
        raise DataError("the body model does not match this file", reason="bad_body_model", where=str(arrays.path),
                        found=str(error),
                        fix="build files of one body model together, or remove body_model") from error  # fmt: skip


def _betas(arrays: ArrayFile) -> Floats:
    """Return one set of betas (B,); a file with betas for every frame must repeat the same ones."""
    betas = arrays.read("betas")
    rows = betas.reshape(-1, betas.shape[-1]) if betas.ndim else betas.reshape(1, 1)
    if isinstance(arrays, PersonArrays) and arrays.tool and len(rows) and np.isfinite(rows).all():
        return np.asarray(rows.mean(axis=0))  # estimated separately in each frame
    if not len(rows) or not np.isfinite(rows).all() or np.ptp(rows, axis=0).max() > 1e-3:
        raise DataError("the betas do not describe a single body", reason="bad_shape", where=str(arrays.path),
                        found=f"betas {betas.shape}, not finite or not the same in all rows",
                        allowed="(B,) or (T, B) with equal rows",
                        fix="save the file with the dancer's mean betas, or remove body_model")  # fmt: skip
    return np.asarray(rows[0])


def stated_time(ref: ClipRef, reading: Reading) -> tuple[int, Fraction, int] | None:
    """Return frames, rate and trim of a whole BVH file by its header; None for others. Errors as of `load_motion`."""
    if ref.motion_path.suffix.lower() != ".bvh" or (ref.source_start, ref.source_end) != (None, None):
        return None
    header = read_bvh_header(ref.motion_path)
    return header.n_frames, _bvh_rate(header, reading).value, 0


def _load_bvh(path: Path, reading: Reading) -> Motion:
    bvh = read_bvh(path)
    facts, rig = bvh_facts(bvh, reading)
    upright = UPRIGHT[facts.up.value]
    _check_standing(bvh, rig.joints, facts.up)
    rotations, pelvis = retarget(bvh, rig, upright)
    skeleton = skeleton_of(rig, facts.metres)
    stretched = stretch(bvh, rig.joints.of[0], list(rig.joints.of.values())) * facts.metres
    place, grid = pelvis * facts.metres - skeleton.offsets[0], FrameGrid(facts.rate.value)
    motion = Motion(place, rotations, grid, skeleton, stretch_m=stretched)
    joints = motion.joints()
    if facts.up.where != IN_MANIFEST:
        _check_up(path, joints, facts.up)
    _check_sides(path, joints, toes={10, 11} <= set(rig.joints.of))
    return motion


_CONVENTION = "BVH's convention, as nothing is declared"


def _bvh_rate(bvh: Bvh, reading: Reading) -> Fact[Fraction]:
    rate = rate_of_period(bvh.frame_time)
    stated = None if rate is None else Fact(rate, f"Frame Time: {bvh.frame_time}")
    rate_fact = decide(reading.manifest.rate, stated, reading.recipe.rate)
    if rate_fact is None:
        raise DataError("the frame time is outside the range of motion capture", reason="bad_rate",
                        where=str(bvh.path), found=f"Frame Time: {bvh.frame_time}", allowed="0.0001 to 1 s",
                        fix="declare fps for this file in the manifest, or correct Frame Time")  # fmt: skip
    return rate_fact


def bvh_facts(bvh: Bvh, reading: Reading) -> tuple[FileFacts, Rig]:
    """Return the facts about a BVH file, and its rig; DataError (``undeclared``, ``bad_rate``) if one is unknown."""
    rate_fact = _bvh_rate(bvh, reading)
    up = decide(reading.manifest.up, None, reading.recipe.up) or Fact("y", _CONVENTION)
    joints = map_joints(bvh.path, bvh.joints, reading.joint_map)
    rig = make_rig(bvh, joints, UPRIGHT[up.value].T @ np.array([0.0, 1.0, 0.0]))
    unit = decide(reading.manifest.unit, None, reading.recipe.unit)
    height = float(np.ptp(rest_positions(SMPL24.parents, rig.offsets)[:, 1]))  # toes to head joint
    if unit is None:
        fitting = [f"{name}: {height * value:.2f} m" for name, value in UNITS.items()]
        found = f"a skeleton of {height:.4g} units from toes to head at rest ({', '.join(fitting)})"
        raise undeclared(bvh.path, "unit", "unit of lengths", f"{_UNITS_ALLOWED}; guess", found)
    if unit.value == GUESS:
        unit, factor = _guessed(height, unit)
    else:
        factor = metres(unit.value) or 1.0
    return FileFacts(rate_fact, up, unit, factor), rig


def _guessed(height: float, unit: Fact[str]) -> tuple[Fact[str], float]:
    """Choose the unit that gives a plausible height; without one scale the body to the height of SMPL's."""
    low, high = _PLAUSIBLE_M
    fitting = [(name, value) for name, value in UNITS.items() if low <= height * value <= high]
    if fitting:
        name, value = fitting[0]
        return Fact(name, f"GUESSED, as {unit.where}: {height * value:.2f} m from toes to head at rest"), value
    smpl = float(np.ptp(SMPL_REST[:, 1]))
    why = f"GUESSED, as {unit.where}: no known unit gives {low} to {high} m for {height:.4g} units from toes to head"
    return Fact("", f"{why}, so the body is scaled to the height of SMPL's, {smpl:.2f} m"), smpl / height


def _check_standing(bvh: Bvh, joints: JointMap, up: Fact[str]) -> None:
    """Reject files whose up axis is not BVH's usual one, in which the dancer would always lie on the ground."""
    if up.where != _CONVENTION:
        return
    head = 15 if 15 in joints.of else 12
    indices = [joints.of[s] for s in (head, 7, 8)]
    step = -(-bvh.n_frames // 1000)
    _, places = world(bvh, indices, slice(None, None, step))
    body = places[:, 0] - places[:, 1:].mean(axis=1)
    mean = (body / np.maximum(np.linalg.norm(body, axis=1, keepdims=True), 1e-12)).mean(axis=0)
    if abs(mean[2]) > 0.8 and abs(mean[1]) < 0.5:
        raise DataError(
            "the body stands along the file's z axis, not along +Y as by BVH's convention",
            reason="undeclared",
            where=str(bvh.path),
            found=f"from feet to head {np.array2string(mean, precision=2)} on average",
            allowed="y or z",
            fix="declare up: z (or up: y, if the dancer lies on the ground), in the manifest or in the recipe",
        )


def _check_up(path: Path, joints: Floats, up: Fact[str]) -> None:
    """Reject files that certainly stand along another axis that can be declared."""
    wrong = wrong_up(joints)
    error = wrong_axis(path, wrong[0], up, "and a steadier floor along that axis") if wrong and wrong[1] else None
    if error is not None:
        raise error


def wrong_axis(path: Path, mean: Floats, up: Fact[str], why: str) -> DataError | None:
    """Return the error of a file that stands along `mean` (3,), not +Y; None if no axis makes it stand."""
    in_file = mean @ UPRIGHT[up.value]
    better = max(UPRIGHT, key=lambda axis: float((UPRIGHT[axis] @ in_file)[1]))
    if (UPRIGHT[better] @ in_file)[1] < abs(in_file).max():
        return None  # along -z or x
    return DataError(
        f"the body does not stand along the up axis {up}",
        reason="undeclared" if up.where == _CONVENTION else "bad_declaration",
        where=str(path),
        found=f"from feet to head {np.array2string(in_file, precision=2)} in the file's axes on average, {why}",
        allowed="y, z or -y",
        fix=f"declare up: {better} (or up: {up.value} in the manifest, if the dancer does lie or stand upside down)",
    )


_SWAPPED = {
    "sides": "left and right are swapped, or the file is mirrored",
    "legs": "left and right are swapped in the legs alone",
    "arms": "left and right are swapped in the arms alone",
}


def _check_sides(path: Path, joints: Floats, *, toes: bool) -> None:
    """Reject a capture whose names of sides certainly contradict its body; doubts are flags, see `core.quality`."""
    sides = sides_of(joints, toes=toes)
    if sides.swapped and sides.certain:
        raise DataError(
            _SWAPPED[sides.swapped],
            reason="swapped_sides",
            where=str(path),
            found=f"cosines with what the names of the hips say: {sides}",
            allowed="toes to the front, knees that bend backwards, left shoulder above left hip: above 0",
            fix="correct joint_map or the names of the joints; export a mirrored file without a negative scale",
        )


def describe(path: Path, reading: Reading) -> tuple[tuple[str, ...], str, FileFacts]:
    """Return notes on a file by its header, the name of its body, "" for a body model's, and the facts."""
    if path.suffix.lower() == ".bvh":
        bvh = read_bvh_header(path)
        facts, rig = bvh_facts(bvh, reading)
        text = f"BVH: {facts}; joint names {rig.joints.producer or 'as given in joint_map'}"
        beyond = [f"{SMPL24.joints[s]} (of {SMPL24.joints[below]})" for s, below in rig.beyond.items()]
        without = (f"{NO_LENGTH}: the direction of {', '.join(beyond)}",) if beyond else ()
        uneven = uneven_bones(rig)
        sides = (f"BVH bones of unequal length: {', '.join(uneven)}",) if uneven else ()
        notes = (text, f"BVH joints: {rig.joints.text(bvh.joints)}", *without, *sides, *_drift(facts))
        return notes, SMPL24.name, facts
    with open_person(path, reading.manifest.person) as arrays:
        layout = recognised(arrays, reading)
        facts = _array_facts(arrays, layout, reading)
        span = seen_in(arrays)
        tracks = arrays.tracks if isinstance(arrays, PersonArrays) else ()
        fit = _fitting_note(arrays, layout, reading) if layout.body == "positions" else ()
    body = "smpl" if layout.body == "positions" else layout.body
    joints = f" on {body}'s {layout.skeleton.n_joints} joints" if layout.name != layout.body else ""
    text = f"{path.suffix.lower()}, layout {layout.name}{joints}: {facts}"
    video = (f"Video: {span[0]}",) if span is not None and str(span[0]) else ()
    if tracks:
        video = (
            f"Video: people {', '.join(tracks)} joined to one: each begins where the one before was lost",
            *video,
        )
    body = layout.skeleton.name if reading.body_model is None else ""
    return (text, *fit, *video, *_drift(facts)), body, facts


def _drift(facts: FileFacts) -> tuple[str, ...]:
    note = "" if facts.rate.where in (IN_MANIFEST, IN_RECIPE) else drift_note(facts.rate.value)
    return (note,) if note else ()
