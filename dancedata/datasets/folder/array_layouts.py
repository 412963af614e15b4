"""Array layouts of AMASS, SMPL, SMPL-X and FineDance: recognises them and reads the motion.

docs/reference/recipes.md, Files, has the arrays of each layout, with their shapes, axes and units.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from dancedata.core.bodies import SMPLH52, SMPLX55
from dancedata.core.errors import DataError
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.text import shown
from dancedata.datasets.checks import check_rows, lengths_differ, require_rotations, rotations_of
from dancedata.datasets.folder.facts import Fact, bad_declaration, bad_shape, finite, from_matrices, scales
from dancedata.datasets.folder.positions import positions_in
from dancedata.formats.arrays import ArrayFile
from dancedata.formats.stated import RATE_KEYS
from dancedata.formats.video_pose import PHALP_CAMERA, PHALP_ROTATIONS, PersonArrays

_SAVE_AGAIN = "save the file again"
_AMASS_RATES = RATE_KEYS[:2]
_TRANSLATIONS = ("trans", "transl", "smpl_trans")
_BODIES: dict[str, Skeleton] = {
    "smpl": SMPL24, "smplh": SMPLH52, "smplx": SMPLX55, "finedance": SMPLX55, "positions": SMPL24,
}  # fmt: skip
_BY_WIDTH = {72: "smpl", 156: "smplh", 165: "smplx"}
_BY_MATRICES = {24 * 9: "smpl", 52 * 9: "smplh", 55 * 9: "smplx"}
_FINEDANCE_WIDTH = 3 + 6 * 52
MOTIONX_WIDTH, _HUMANML3D_WIDTH = 322, 263
_RATE_20 = Fact(Fraction(20), "HumanML3D's definition")
#: Arrays of the parts of a body in the order of its joints: (names in use, columns).
_ROOT = (("global_orient", "root_orient"), 3)
_BODY = (("body_pose", "pose_body"), 63)
_FACE = ((("jaw_pose", "pose_jaw"), 3), (("leye_pose",), 3), (("reye_pose",), 3))
_HANDS = ((("left_hand_pose",), 45), (("right_hand_pose",), 45))
_PARTS: dict[str, tuple[tuple[tuple[str, ...], int], ...]] = {
    "smpl": (_ROOT, (_BODY[0], 69)),
    "smplh": (_ROOT, _BODY, *_HANDS),
    "smplx": (_ROOT, _BODY, *_FACE, *_HANDS),
}
#: AMASS's names for arrays of two parts.
_PAIRS = {"leye_pose": ("pose_eye", 0), "reye_pose": ("pose_eye", 1)}
_PAIRS |= {"left_hand_pose": ("pose_hand", 0), "right_hand_pose": ("pose_hand", 1)}

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Layout:
    """The layout of a file.

    `body`: "smpl", "smplh", "smplx", "finedance" or "positions": how the columns are read.
    `poses`, `translation`, `scaling`: Names of arrays; "" for an unnamed one, None where there is none of its own.
    `matrices`: Whether the rotations are matrices, row by row.
    `joints`: Set of joints of positions, as `positions.JOINT_SETS` has them; "" where names decide.
    """

    name: str
    body: str
    poses: str | None
    translation: str | None
    up: Fact[str] | None = None
    unit: Fact[str] | None = None
    scaling: str | None = None
    matrices: bool = False
    rate: Fact[Fraction] | None = None
    joints: str = ""

    @property
    def skeleton(self) -> Skeleton:
        """The skeleton to use without a body model."""
        return _BODIES[self.body]


def recognise(arrays: ArrayFile, declared: str, keys: Mapping[str, str] | None = None) -> Layout:
    """Return the layout by names and shapes; DataError for an unknown one, or another than the declared one."""
    names = arrays.names
    if keys is not None and "positions" in keys and keys["positions"] in names:
        layout = Layout("positions", "positions", keys["positions"], None)
    elif keys is not None and keys.get("rotation") in names:
        layout = _keyed(arrays, keys)
    elif isinstance(arrays, PersonArrays) and arrays.tool:
        layout = _of_tool(arrays)
    elif "smpl_poses" in names and "smpl_trans" in names:
        layout = _whole(arrays, "smpl_poses", "smpl_trans")
    elif "poses" in names and _first(names, _TRANSLATIONS):
        layout = _whole(arrays, "poses", _first(names, _TRANSLATIONS))
    elif _first(names, _ROOT[0]) and _first(names, _BODY[0]) and _first(names, _TRANSLATIONS):
        layout = _in_parts(arrays, declared)
    elif {"rotations", "translation"} <= set(names) and _width(arrays, "rotations") in _BY_WIDTH:
        body, own = _BY_WIDTH[_width(arrays, "rotations")], "skeleton" in names
        up, unit = (Fact(value, "dancedata's definition") if own else None for value in ("y", "m"))
        layout = Layout(body, body, "rotations", "translation", up, unit)
    elif (positions := positions_in(arrays)) is not None:
        layout = Layout("positions", "positions", positions, None)
    elif names == ("",):
        layout = _unnamed(arrays)
    else:
        raise DataError(
            "the arrays of the file match no known layout",
            reason="missing_key",
            where=str(arrays.path),
            found=f"arrays {arrays.listed}",
            allowed="poses and trans; smpl_poses and smpl_trans; global_orient, body_pose and transl; "
            "positions (T, J, 3); or one array (T, 315), (T, 322) or (T, 263) in an .npy file",
            fix="name its arrays in the recipe: dataset.folder.keys={rotation: NAME, translation: NAME}, or "
            "{positions: NAME}",
        )
    return _as_declared(arrays, layout, declared)


def _keyed(arrays: ArrayFile, keys: Mapping[str, str]) -> Layout:
    missing = [name for name in keys.values() if name not in arrays.names]
    if missing:
        raise DataError("the file lacks an array that the recipe names", reason="missing_key", where=str(arrays.path),
                        found=f"arrays {arrays.listed}", allowed=f"{', '.join(keys.values())} (dataset.folder.keys)",
                        fix="correct dataset.folder.keys")  # fmt: skip
    rotation, width = keys["rotation"], _width(arrays, keys["rotation"])
    body = _BY_WIDTH.get(width) or _BY_MATRICES.get(width)
    if body is None:
        allowed = "(T, 72) SMPL, (T, 156) SMPL-H or (T, 165) SMPL-X, axis-angle; or 216, 468, 495 for matrices"
        raise bad_shape(arrays, rotation, allowed)
    matrices = width in _BY_MATRICES
    return Layout(body, body, rotation, keys["translation"], scaling=keys.get("scale"), matrices=matrices)


def _of_tool(arrays: PersonArrays) -> Layout:
    """Return the layout of a file of a video program. The frame rate is the video's: not in the file."""
    if arrays.tool == "wham":
        up, unit = Fact("y", "WHAM's world"), Fact("m", "WHAM's definition")
        return Layout("wham", "smpl", "pose_world", "trans_world", up, unit)
    if arrays.tool == "phalp":
        up, unit = Fact("-y", "PHALP's camera axes"), Fact("m", "PHALP's definition")
        return Layout("phalp", "smpl", PHALP_ROTATIONS, PHALP_CAMERA, up, unit, matrices=True)
    if arrays.tool == "mdm":
        up, unit = Fact("y", "HumanML3D's axes"), Fact("m", "HumanML3D's definition")
        return Layout("mdm", "positions", "positions", None, up, unit, rate=_RATE_20, joints="smpl22")
    up, unit = Fact("y", "GVHMR's world"), Fact("m", "the body model's definition")
    return Layout("gvhmr", "smplx", None, "transl", up, unit)


def _whole(arrays: ArrayFile, poses: str, translation: str) -> Layout:
    width = _width(arrays, poses)
    body = _BY_WIDTH.get(width)
    if body is None:
        raise bad_shape(arrays, poses, "(T, 72) SMPL, (T, 156) SMPL-H or (T, 165) SMPL-X, axis-angle")
    if "smpl_scaling" in arrays.names:
        why = "AIST++'s definition, by smpl_scaling"
        unit = Fact("m", "after division by smpl_scaling")
        return Layout(body, body, poses, translation, Fact("y", why), unit, "smpl_scaling")
    if body != "smpl" and _first(arrays.names, _AMASS_RATES):
        return _amass(body, poses, translation)
    return Layout(body, body, poses, translation, unit=_smpl_metres(body))


def _in_parts(arrays: ArrayFile, declared: str) -> Layout:
    translation = _first(arrays.names, _TRANSLATIONS)
    body_pose = _first(arrays.names, _BODY[0])
    width = _width(arrays, body_pose)
    if width not in (63, 69):
        raise bad_shape(arrays, body_pose, "(T, 63) SMPL-X and SMPL-H, or (T, 69) SMPL, axis-angle")
    body = "smpl" if width == 69 else "smplh" if declared == "smplh" else "smplx"
    if body == "smplx" and _first(arrays.names, _AMASS_RATES):
        return _amass(body, None, translation)
    return Layout(body, body, None, translation, unit=_smpl_metres(body))


def _amass(body: str, poses: str | None, translation: str) -> Layout:
    up, unit = Fact("z", "AMASS's definition"), Fact("m", "AMASS's definition")
    return Layout("amass", body, poses, translation, up, unit)


def _smpl_metres(body: str) -> Fact[str] | None:
    # Files with 72 columns exist in various units; the others follow the model's code.
    return None if body == "smpl" else Fact("m", "the body model's definition")


def _unnamed(arrays: ArrayFile) -> Layout:
    width = _width(arrays, "")
    if width == MOTIONX_WIDTH:
        up, unit = Fact("y", "Motion-X's definition"), Fact("m", "the body model's definition")
        return Layout("motionx", "smplx", "", None, up, unit, rate=Fact(Fraction(30), "Motion-X's definition"))
    if width == _HUMANML3D_WIDTH and len(arrays.shape("")) == 2:
        up, unit = Fact("y", "HumanML3D's axes"), Fact("m", "HumanML3D's definition")
        return Layout("humanml3d", "positions", "", None, up, unit, rate=_RATE_20, joints="smpl22")
    if width != _FINEDANCE_WIDTH:
        named = "; for axis-angle rotations an .npz from numpy.savez(file, poses=..., trans=...)"
        allowed = (
            f"(T, {_FINEDANCE_WIDTH}), translation 3, then 52 joints x 6D; (T, {MOTIONX_WIDTH}), Motion-X; "
            f"(T, {_HUMANML3D_WIDTH}), HumanML3D; positions (T, J, 3){named if width in _BY_WIDTH else ''}"
        )
        raise bad_shape(arrays, "", allowed)
    up, unit = Fact("y", "FineDance's definition"), Fact("m", "FineDance's definition")
    return Layout("finedance", "finedance", "", None, up, unit)


def _as_declared(arrays: ArrayFile, layout: Layout, declared: str) -> Layout:
    if declared in ("auto", layout.name):
        return layout
    if declared == "amass" and layout.body in ("smplh", "smplx"):
        return _amass(layout.body, layout.poses, layout.translation or "")
    if declared == layout.body and layout.rate is None:
        # It has AMASS's rate key but is declared not to be AMASS, so its axes are unknown.
        return replace(layout, name=layout.body, up=None)
    raise bad_declaration(arrays.path, f"the file does not have the layout {declared}",
                          f"{layout.name}: arrays {arrays.listed}", f"layout {layout.name}, or auto",
                          "correct layout, or remove it")  # fmt: skip


def read_motion(arrays: ArrayFile, layout: Layout) -> tuple[Floats, Floats]:
    """Return translation (T, 3) in the file's unit and rotations (T, J, 3), axis-angle; DataError."""
    if layout.name == "motionx":
        array = finite(arrays, layout.poses or "")
        body, hands, jaw, place = array[:, :66], array[:, 66:156], array[:, 156:159], array[:, 309:312]
        rotations = np.concatenate([body, jaw, np.zeros((len(array), 6)), hands], axis=1).reshape(-1, 55, 3)
        require_rotations(arrays.path, "the array", rotations, place, SMPLX55.parents)
        return place, rotations
    if layout.body == "finedance":
        array = finite(arrays, layout.poses or "")
        rows = array[:, 3:].reshape(len(array), 52, 6)
        check_rows(arrays.path, rows)
        return array[:, :3], rotations_of(rows)
    translation = finite(arrays, layout.translation or "")
    if translation.shape[1] != 3:
        raise bad_shape(arrays, layout.translation or "", "(T, 3)")
    joints = layout.skeleton.n_joints
    if layout.poses is not None:
        rotations = finite(arrays, layout.poses)
        rotations = from_matrices(arrays, _rotation_name(arrays, layout), rotations) if layout.matrices else rotations
    else:
        parts = _PARTS[layout.body]
        rotations = np.concatenate([_part(arrays, names, width, len(translation)) for names, width in parts], axis=1)
    if len(rotations) != len(translation):
        poses, places = layout.poses or "body_pose", layout.translation or ""
        raise lengths_differ(arrays.path, poses, len(rotations), places, len(translation), _SAVE_AGAIN)
    rotations = rotations.reshape(len(rotations), joints, 3)
    if not layout.matrices:  # matrices were checked as rotations
        what = _rotation_name(arrays, layout)
        require_rotations(arrays.path, what, rotations, translation, layout.skeleton.parents)
    if layout.scaling:
        translation = translation / scales(arrays, layout.scaling, len(translation))
    return translation, rotations


def _rotation_name(arrays: ArrayFile, layout: Layout) -> str:
    person = arrays.person if isinstance(arrays, PersonArrays) else ""
    return f"{layout.poses or 'body_pose'}{f' of person {shown(person, 40)}' if person else ''}"


def _part(arrays: ArrayFile, names: Sequence[str], width: int, n_frames: int) -> Floats:
    """Return the rotations of a part of the body, (T, width); a missing part does not rotate."""
    name = _first(arrays.names, names)
    pair, half = _PAIRS.get(names[0], ("", 0))
    if name:
        part, allowed = finite(arrays, name), f"(T, {width})"
    elif pair in arrays.names:
        name, allowed = pair, f"(T, {2 * width})"
        part = finite(arrays, pair)
        part = part[:, half * width : (half + 1) * width] if part.shape[1] == 2 * width else part[:, :0]
    else:
        return np.zeros((n_frames, width))
    if part.shape[1] != width:
        hands = "save hands as full poses (use_pca=False), or omit them" if "hand" in name else None
        raise bad_shape(arrays, name, f"{allowed}, axis-angle", hands)
    if len(part) != n_frames:
        raise lengths_differ(arrays.path, name, len(part), "the translation", n_frames, _SAVE_AGAIN)
    return part


def _first(names: Sequence[str], candidates: Sequence[str]) -> str:
    return next((name for name in candidates if name in names), "")


def _width(arrays: ArrayFile, name: str) -> int:
    shape = arrays.shape(name)
    return int(np.prod(shape[1:], dtype=np.float64)) if len(shape) > 1 else 0
