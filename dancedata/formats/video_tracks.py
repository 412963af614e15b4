"""Tracks of one person: where a program for motion from video loses a person, it goes on under another number.

Files of WHAM have such chunks (0, 4, 17, 31). Each has a world of its own, in which it begins at the origin: a later
one is moved on the floor and turned about +Y so that the body goes on from where the last one left it.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError
from dancedata.core.rotations import angles_between, matrix_from_rotvec, rotvec_from_matrix
from dancedata.core.skeleton import SMPL24
from dancedata.formats.values import holds_values
from dancedata.formats.video_pose import PHALP_CAMERA, PHALP_ROTATIONS, PersonArrays, open_people

#: Frames in a row without a person that are interpolated: a third of a second at 30 FPS.
MAX_GAP = 10
#: Poses of one person on both sides of a gap: median angle of the joints, degrees, and distance to the camera's axes,
#: metres, which estimates of the depth change.
_POSE_DEG, _PLACE_M = 30.0, 1.0
#: Frames that give the speed with which the body goes on.
_BEFORE = 5
#: Rotations (T, 24, 3) or (T, 24, 3, 3) and place in the camera's axes, by program.
_ARRAYS = {"wham": ("pose", "trans"), "phalp": (PHALP_ROTATIONS, PHALP_CAMERA)}

Floats = NDArray[np.float64]


def joined(people: Sequence[PersonArrays]) -> tuple[PersonArrays, ...]:
    """Return the people of a file, each as one person, whatever the number of tracks."""
    after = dict(_links(people))
    if len(set(after.values())) < len(after):
        after = {a: b for a, b in after.items() if list(after.values()).count(b) == 1}
    chains = []
    for first in range(len(people)):
        if first not in after.values():
            chain = [first]
            while chain[-1] in after:
                chain.append(after[chain[-1]])
            chains.append([people[k] for k in chain])
    return tuple(_chained(chain) if len(chain) > 1 else chain[0] for chain in chains)


def _links(people: Sequence[PersonArrays]) -> Iterator[tuple[int, int]]:
    """Yield the numbers of tracks and of the only ones in which they go on."""
    ends = []
    for person in people:
        try:
            frames = person.frames if person.tool in _ARRAYS else None
        except DataError:  # reading the person gives the error
            frames = None
        ends.append(None if frames is None or not len(frames) else (int(frames[0]), int(frames[-1])))
    for a, one in enumerate(ends):
        near = [b for b, two in enumerate(ends) if one and two and 0 < two[0] - one[1] <= MAX_GAP + 1]
        near = [b for b in near if _goes_on(people[a], people[b])]
        if len(near) == 1:
            yield a, near[0]


def _goes_on(one: PersonArrays, two: PersonArrays) -> bool:
    rotations, place = _ARRAYS[one.tool]
    try:
        at = [(_rotvecs(p.read(rotations))[k, 1:22], p.read(place)[k]) for p, k in ((one, -1), (two, 0))]
    except (DataError, KeyError, ValueError, IndexError):  # not as the program writes it: reading gives the error
        return False
    turned = np.degrees(np.median(angles_between(np.stack([at[0][0], at[1][0]]))))
    return bool(turned < _POSE_DEG and np.linalg.norm(at[0][1] - at[1][1]) < _PLACE_M)


def _rotvecs(values: Floats) -> Floats:
    """Return rotations of SMPL's joints as axis-angle (T, 24, 3)."""
    if values.size == len(values) * 24 * 9:
        return rotvec_from_matrix(values.reshape(-1, 24, 3, 3))
    return values.reshape(len(values), 24, 3)


def _chained(chain: Sequence[PersonArrays]) -> PersonArrays:
    shared = [name for name in chain[0].names if all(name in person.names for person in chain)]
    columns: dict[str, list[Floats]] = {name: [] for name in shared}
    for person in chain:
        values = {name: person.read(name) for name in shared if name != "verts"}
        if person.tool == "wham" and columns["pose_world"]:
            last = {name: columns[name][-1] for name in ("pose_world", "trans_world", "frame_ids")}
            values |= _continued(last, values)
        for name, value in values.items():
            columns[name].append(value)
    joined = {name: np.concatenate(values) for name, values in columns.items() if values}
    first = chain[0]
    return PersonArrays(first.path, joined, first.person, first.tool, tuple(person.person for person in chain))


def _continued(last: dict[str, Floats], values: dict[str, Floats]) -> dict[str, Floats]:
    """Return WHAM's pose and translation in the world of the track before: SMPL turns about its pelvis."""
    rest = SMPL24.offsets[0]
    begins, steps = len(last["frame_ids"]) - 1, float(values["frame_ids"][0] - last["frame_ids"][-1])
    start = max(0, begins - _BEFORE)
    frames = last["frame_ids"][begins] - last["frame_ids"][start]
    root = matrix_from_rotvec(values["pose_world"][:, :3])
    headings = _heading(matrix_from_rotvec(last["pose_world"][[start, begins], :3]))
    turn = np.angle(np.exp(1j * (headings[1] - headings[0]))) / max(frames, 1)
    moved = (last["trans_world"][begins] - last["trans_world"][start]) / max(frames, 1) * (1, 0, 1)
    angle = headings[1] + steps * turn - _heading(root[:1])[0]
    yaw = matrix_from_rotvec(np.array([[0.0, angle, 0.0]]))[0]
    pelvis = (values["trans_world"] + rest) @ yaw.T
    pelvis += last["trans_world"][begins] + rest + steps * moved - pelvis[0]
    pose = values["pose_world"].copy()
    pose[:, :3] = rotvec_from_matrix(yaw @ root)
    return {"pose_world": pose, "trans_world": pelvis - rest}


def _heading(root: Floats) -> Floats:
    """Return the angles about +Y of the directions that bodies face, from their rotations (N, 3, 3)."""
    return np.arctan2(root[:, 0, 2], root[:, 2, 2])


def people_of(path: Path) -> tuple[str, ...]:
    """Return the names of the people of a file; ("",) for one person without a name. DataError as `open_arrays`."""
    people = joined(open_people(path)) if holds_values(path) else ()
    return tuple(person.person for person in people if not person.tracks or len(people) > 1) or ("",)
