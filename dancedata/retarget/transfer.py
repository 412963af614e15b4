"""A motion on another skeleton of the SMPL family: limbs scaled, feet kept on the floor, residuals measured."""

from dataclasses import dataclass, replace

import numpy as np

from dancedata.core.bodies import has_body, rotations_on
from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.quality import Flag
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import Skeleton
from dancedata.core.tracks import runs
from dancedata.retarget.body import Body, body_of
from dancedata.retarget.feet import contact_spans, toes_of, with_planted_feet
from dancedata.retarget.maps import Names

#: Raised by hand when a motion gets other numbers.
VERSION = 3
#: Residuals above this are flagged, metres: about the length of a hand.
MAX_RESIDUAL_M = 0.15
#: Joints whose places are compared: skeletons put the others (spine, neck, head, collars, hands) at different places.
_MEASURED = (0, 1, 2, 4, 5, 7, 8, 10, 11, 16, 17, 18, 19, 20, 21)
#: Twists about a bone are copied, not seen: no joint position shows them.
_UNSEEN = "twists of limbs are copied and cannot be checked by joint positions"


@dataclass(frozen=True, eq=False)
class Retargeted:
    """A motion on another body.

    `scale`: Metres of the result per metre of the source's world.
    `residual_m`: (T,) largest distance of a joint from the place that the scaled source has for it, metres; of the
        pelvis and the joints of arms and legs, as skeletons place those of the trunk and head differently.
    `joint`: (T,) that joint, an index of the skeleton.
    `notes`: What could not be mapped.
    """

    motion: Motion
    scale: float
    residual_m: Float64Array
    joint: np.ndarray[tuple[int], np.dtype[np.intp]]
    notes: tuple[str, ...]

    def flags(self) -> list[Flag]:
        """Return one flag, "retarget_residual", for each run of frames above MAX_RESIDUAL_M, at its worst frame."""
        flags = []
        for first, stop in runs(self.residual_m > MAX_RESIDUAL_M):
            frame = first + int(np.argmax(self.residual_m[first:stop]))
            joint = self.motion.skeleton.joints[int(self.joint[frame])]
            value = round(float(self.residual_m[frame]), 4)
            flags.append(Flag("retarget_residual", joint, frame, value, "m", str(self.motion.grid)))
        return flags


def retargeted(
    motion: Motion,
    skeleton: Skeleton,
    joint_map: Names | None = None,
    *,
    scale: float | None = None,
    feet: bool = True,
) -> Retargeted:
    """Put a motion on another skeleton, of the SMPL family.

    Each joint keeps its rotation in the world, up to the constant one that aligns the rest poses: limbs point as in
    the source, on any skeleton (`limb_alignment`). The path of the pelvis is scaled about the origin, and moved up or
    down by one constant, so that the toes stand at the height that the scaled source has. In contacts, each foot then
    moves as in the scaled source.

    `motion`: On any skeleton that a joint map fits.
    `joint_map`: SMPL joint -> names; default: the map of the package that matches most joints.
    `scale`: Of the world; default: the ratio of the lengths of the legs. Dancers of one group need one scale.
    `feet`: Whether legs are bent so that feet do not slide.
    Raises UsageError: if either skeleton cannot be used.
    """
    if not has_body(skeleton):
        raise UsageError(f"motion cannot be retargeted to skeleton {skeleton.name}",
                         found=f"joints {', '.join(skeleton.joints[:4])}, ...",
                         allowed="skeletons of the SMPL family, such as smpl24")  # fmt: skip
    body = body_of(motion, joint_map)
    source = body.motion.skeleton
    factor = leg_ratio(source, skeleton) if scale is None else scale
    if source.captured:
        skeleton = replace(skeleton, captured=True)
    rotations = rotations_on(body.motion, skeleton, align=True)
    place = (body.motion.translation + source.offsets[0]) * factor - skeleton.offsets[0]
    moved = replace(body.motion, translation=place, rotations=rotations, skeleton=skeleton)
    toes = toes_of(body.places, body.joints, skeleton, body.motion.joints())
    spans = [contact_spans(toes[:, side], float(motion.grid.rate)) for side in (0, 1)]
    lift = _lift(moved.joints()[:, skeleton.feet[2:], 1], toes[..., 1] * factor, spans)
    moved = replace(moved, translation=moved.translation + np.array([0.0, lift, 0.0]))
    if feet:
        moved = with_planted_feet(moved, toes * factor, spans)
    shared = [(k, j) for k, j in enumerate(body.joints) if j in _MEASURED]
    targets = body.places[:, [k for k, _ in shared]] * factor
    apart = np.linalg.norm(moved.joints()[:, [j for _, j in shared]] - targets, axis=-1)
    worst = apart.argmax(axis=1)
    joints = np.array([j for _, j in shared])[worst]
    return Retargeted(moved, float(factor), apart.max(axis=1), joints, _notes(body, skeleton))


def leg_ratio(source: Skeleton, skeleton: Skeleton) -> float:
    """Return the ratio of the lengths of two bodies' legs, from the hips to the ankles."""
    target, legs = (float(np.linalg.norm(s.offsets[[4, 5, 7, 8]], axis=1).sum()) for s in (skeleton, source))
    return target / legs


def _lift(heights: Float64Array, wanted: Float64Array, spans: list[list[tuple[int, int]]]) -> float:
    """Return how far to move a body up so that its toes (T, 2) stand at the height of the source's, metres."""
    apart = [wanted[slice(*span), side] - heights[slice(*span), side] for side in (0, 1) for span in spans[side]]
    lift = float(np.median(np.concatenate(apart))) if apart else 0.0
    return lift if abs(lift) > 1e-9 else 0.0


def _notes(body: Body, skeleton: Skeleton) -> tuple[str, ...]:
    source = body.motion.skeleton
    dropped = [*body.unmapped, *(name for name in source.joints if name not in skeleton.joints)]
    turned = np.abs(body.motion.rotations).max(axis=(0, 2)) > 1e-9
    points = [source.joints[j] for j in range(1, source.n_joints) if not source.offsets[j].any() and not turned[j]]
    absent = [name for name in skeleton.joints if name not in source.joints]
    still = dict.fromkeys([*body.missing, *points, *absent])
    notes = [_UNSEEN]
    if dropped:
        notes.append(f"joints that are dropped: {', '.join(dropped)}")
    if still:
        notes.append(f"joints of {skeleton.name} that do not move: {', '.join(still)}")
    return tuple(notes)
