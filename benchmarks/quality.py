"""Faults of motion: planted ones against those found, and what is found in clean clips.

    python benchmarks/quality.py                10 minutes
    python benchmarks/quality.py --planted 12

Synthetic dancers (100 clips of 9.6 s at 60 frames per second) and, with $DANCEDATA_SHARED or ../shared, seven real
clips: four of AIST++, three BVH files of other captures. Each fault is planted in a clip, at a random place with
the seed 0, and it is found if a span above the default limit touches its frames (of a whole clip: if the value is
above the limit); places where that is so without it are passed over. Clean are the synthetic clips; the real ones
are as their makers published them, and what is found in them is listed. Spikes of AIST++ are compared with its own
keypoints, which were triangulated before bodies were fitted to them.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import ClipRef
from dancedata.core.motion import Motion
from dancedata.core.rotations import rotation
from dancedata.core.skeleton import SMPL24
from dancedata.curation.glitches import spikes
from dancedata.curation.repair import LIMITS, repaired
from dancedata.curation.scores import MEASURES, score_motion
from dancedata.datasets.aistpp import AistPP
from dancedata.datasets.folder.facts import Declared
from dancedata.datasets.folder.load import Reading, load_motion
from dancedata.formats.safe_pickle import load_pickle
from dancedata.metrics.body import bone_spread
from dancedata.synthetic import synthesise_motion
from dancedata.synthetic.plan import CATALOGUE

Floats = npt.NDArray[np.float64]
Planted = tuple[Motion, int, int]
#: BVH files with their up axis and unit.
BVH = (("rokoko_jesse_dance", "y", "cm"), ("fair1_dab", "z", "guess"), ("cmu_01_01", "y", "cmu"))
#: COCO's numbers of the joints that SMPL has too.
COCO = {"shoulder": 5, "elbow": 7, "wrist": 9, "hand": 9, "hip": 11, "knee": 13, "ankle": 15, "foot": 15}


@cache
def synthetic(n: int) -> dict[str, Motion]:
    """Return clean clips of 9.6 s."""
    names = [f"gBR_sBM_cAll_d{4 + k % 3:02d}_{song}_ch{k:02d}" for song in CATALOGUE for k in range(1, 11)]
    return {name: synthesise_motion(name, n_frames=576)[0] for name in names[:n]}


@cache
def real(shared: Path) -> dict[str, Motion]:
    """Return the real clips."""
    clips = {}
    for path in sorted((shared / "realdata/aistpp/motions").glob("*.pkl")):
        clips[path.stem] = AistPP().load(ClipRef(path.stem, path, None, "train", ""))
    for name, up, unit in BVH:
        clips[name] = load_motion(shared / f"realdata/bvh/{name}.bvh", Reading(Declared(None, up, unit), Declared()))
    return clips


def moved(motion: Motion, offsets: Floats) -> Motion:
    """Return a motion with its places moved by (T, 3)."""
    return replace(motion, translation=motion.translation + offsets)


def turned(motion: Motion, joint: str, frames: slice, by: Floats) -> Motion:
    """Return a motion with a joint turned in some frames, in its own axes."""
    rotations, j = np.array(motion.rotations), motion.skeleton.index(joint)
    rotations[frames, j] = (rotation(rotations[frames, j]) * rotation(by)).as_rotvec()
    return replace(motion, rotations=rotations)


def somewhere(motion: Motion, seconds: float, rng: np.random.Generator) -> tuple[int, int]:
    """Return frames [start, stop) of this length, away from the ends."""
    n = max(1, round(seconds * float(motion.grid.rate)))
    start = int(rng.integers(8, motion.n_frames - n - 8))
    return start, start + n


def direction(rng: np.random.Generator) -> Floats:
    """Return a random unit vector."""
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def plant_spikes(motion: Motion, rng: np.random.Generator) -> Planted | None:
    """Move the root, a wrist, an ankle or the head by 10 cm for 1 to 3 frames, by a turn of the joint above it."""
    frames = int(rng.integers(1, 4 if float(motion.grid.rate) >= 50 else 3))
    start = int(rng.integers(8, motion.n_frames - frames - 8))
    span = slice(start, start + frames)
    joint, above = [("", ""), ("left_wrist", "left_shoulder"), ("right_wrist", "right_elbow"),
                    ("left_ankle", "left_hip"), ("head", "spine1")][int(rng.integers(5))]  # fmt: skip
    if not joint:
        offsets = np.zeros((motion.n_frames, 3))
        offsets[span] = 0.1 * direction(rng)
        return moved(motion, offsets), start, start + frames
    j, before = motion.skeleton.index(joint), motion.joints()
    axis = direction(rng)

    def off(angle: float) -> float:
        after = turned(motion, above, span, axis * angle).part(start, start + 1).joints()
        return float(np.linalg.norm(after[0, j] - before[start, j]))

    low, high = 0.0, 1.5
    if off(high) < 0.1:
        return None  # about the bone itself
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if off(middle) < 0.1 else (low, middle)
    return turned(motion, above, span, axis * high), start, start + frames


def plant_frozen(motion: Motion, rng: np.random.Generator) -> Planted | None:
    """Hold a pose for 0.3 s while a joint moves at 1 m/s or faster."""
    steps = np.linalg.norm(np.diff(motion.joints(), axis=0), axis=2).max(axis=1) * float(motion.grid.rate)
    start, stop = somewhere(motion, 0.3, rng)
    if steps[start - 1 : stop].min() < 1.0:
        return None
    translation, rotations = np.array(motion.translation), np.array(motion.rotations)
    translation[start:stop], rotations[start:stop] = translation[start - 1], rotations[start - 1]
    return replace(motion, translation=translation, rotations=rotations), start, stop


def plant_jitter(motion: Motion, rng: np.random.Generator) -> Planted:
    """Add white noise of 1 cm to the root's place for 2 s."""
    start, stop = somewhere(motion, 2.0, rng)
    offsets = np.zeros((motion.n_frames, 3))
    offsets[start:stop] = rng.normal(0, 0.01, (stop - start, 3))
    return moved(motion, offsets), start, stop


def plant_sliding(motion: Motion, rng: np.random.Generator) -> Planted | None:
    """Move the dancer sideways by 80 cm in 0.8 s while a foot stands flat."""
    start, stop = somewhere(motion, 0.8, rng)
    feet = motion.joints()[:, list(motion.skeleton.feet)]
    still = np.linalg.norm(np.diff(feet[start:stop], axis=0), axis=2).max(axis=0) * float(motion.grid.rate) < 0.2
    low = (feet[start:stop, :, 1] - np.quantile(feet[..., 1], 0.1, axis=0) < 0.02).all(axis=0)
    if not ((still & low)[[0, 2]].all() or (still & low)[[1, 3]].all()):
        return None
    angle = rng.uniform(0, 2 * np.pi)
    path = np.interp(np.arange(motion.n_frames), [start, stop], [0.0, 0.8])
    return moved(motion, path[:, None] * (np.cos(angle), 0.0, np.sin(angle))), start, stop


def plant_penetration(motion: Motion, rng: np.random.Generator) -> Planted | None:
    """Let the dancer sink by 20 cm for 0.6 s and rise again, where a foot is on the floor."""
    start, stop = somewhere(motion, 0.6, rng)
    heights = motion.joints()[..., 1].min(axis=1)
    if heights[start:stop].max() > np.median(heights) + 0.03:
        return None
    path = np.zeros((motion.n_frames, 3))
    path[start:stop, 1] = -0.2 * np.sin(np.linspace(0, np.pi, stop - start))
    return moved(motion, path), start, stop


def plant_drift(motion: Motion, rng: np.random.Generator) -> Planted:
    """Let the floor rise or sink by 15 cm over the clip."""
    path = np.zeros((motion.n_frames, 3))
    path[:, 1] = np.linspace(0, rng.choice([-0.15, 0.15]), motion.n_frames)
    return moved(motion, path), 0, motion.n_frames


def plant_limits(motion: Motion, rng: np.random.Generator) -> Planted:
    """Bend a knee or an elbow the wrong way by 70 degrees for 0.5 s."""
    start, stop = somewhere(motion, 0.5, rng)
    side, hinge = rng.choice(["left", "right"]), rng.choice(["knee", "elbow"])
    rotations = np.array(motion.rotations)
    wrong = (-np.radians(70), 0, 0) if hinge == "knee" else (0, np.radians(70) * (1 if side == "left" else -1), 0)
    rotations[start:stop, motion.skeleton.index(f"{side}_{hinge}")] = wrong
    return replace(motion, rotations=rotations), start, stop


def plant_contact(motion: Motion, rng: np.random.Generator) -> Planted | None:
    """Turn an arm for 0.5 s so that the middle of its forearm lies in the chest's bone, within 2 cm."""
    start, stop = somewhere(motion, 0.5, rng)
    side = rng.choice(["left", "right"])
    elbow, wrist, chest = (motion.skeleton.index(j) for j in (f"{side}_elbow", f"{side}_wrist", "spine3"))
    turns = rng.normal(size=(4000, 2, 3))
    poses = np.repeat(motion.rotations[start : start + 1], len(turns), axis=0)
    poses[:, [motion.skeleton.index(f"{side}_shoulder"), elbow]] = turns
    joints = Motion(np.zeros((len(turns), 3)), poses, motion.grid, motion.skeleton).joints()
    middle = (joints[:, chest] + joints[:, motion.skeleton.parents[chest]]) / 2
    away = np.linalg.norm((joints[:, elbow] + joints[:, wrist]) / 2 - middle, axis=1)
    if away.min() > 0.02:
        return None
    rotations = np.array(motion.rotations)
    rotations[start:stop, [motion.skeleton.index(f"{side}_shoulder"), elbow]] = turns[int(np.argmin(away))]
    return replace(motion, rotations=rotations), start, stop


def plant_mirror(motion: Motion, rng: np.random.Generator) -> Planted:
    """Reflect the dancer and leave the names of the joints; or exchange those of the legs, or of all joints."""
    kind, skeleton = int(rng.integers(3)), motion.skeleton
    if kind == 0:
        rotations, translation = motion.rotations * (1, -1, -1), motion.translation * (-1, 1, 1)
        return replace(motion, rotations=rotations, translation=translation), 0, motion.n_frames
    order = np.arange(skeleton.n_joints)
    for left, right in skeleton.pairs:
        if kind == 1 or any(part in skeleton.joints[left] for part in ("hip", "knee", "ankle", "foot")):
            order[[left, right]] = right, left
    renamed = replace(skeleton, offsets=skeleton.offsets[order])
    return replace(motion, rotations=motion.rotations[:, order], skeleton=renamed), 0, motion.n_frames


def plant_up(motion: Motion, rng: np.random.Generator) -> Planted:
    """Lay the world on its side, as +Z up read as +Y up."""
    quarter = rotation(np.array([np.pi / 2, 0, 0]))
    rotations = np.array(motion.rotations)
    rotations[:, 0] = (quarter * rotation(rotations[:, 0])).as_rotvec()
    pelvis = quarter.apply(motion.translation + motion.skeleton.offsets[0]) - motion.skeleton.offsets[0]
    return replace(motion, rotations=rotations, translation=pelvis), 0, motion.n_frames


def plant_bones(motion: Motion, rng: np.random.Generator) -> Planted:
    """State that bones of the capture stretched by 3 cm, as a reader does; joints are compared in `bones`."""
    return replace(motion, stretch_m=0.03), 0, motion.n_frames


PLANTS: dict[str, Callable[[Motion, np.random.Generator], Planted | None]] = {
    "spikes": plant_spikes, "frozen": plant_frozen, "jitter": plant_jitter, "sliding": plant_sliding,
    "penetration": plant_penetration, "floor_drift": plant_drift, "bone_spread": plant_bones,
    "joint_limits": plant_limits, "self_contact": plant_contact, "mirrored": plant_mirror, "up": plant_up,
}  # fmt: skip
#: Attempts for each fault that is planted: not every place has a foot that stands.
ATTEMPTS = 60


@dataclass
class Count:
    """Faults planted and found, and clean parts."""

    planted: int = 0
    found: int = 0
    hidden: int = 0


def is_found(name: str, motion: Motion, start: int, stop: int) -> bool:
    """Whether a score is above its limit, in these frames."""
    score = score_motion(motion, [name])[name]
    limit = MEASURES[name].limit
    if score.value is None or score.value <= limit:
        return False
    return MEASURES[name].of == "clip" or any(s.start < stop + 2 and s.end > start - 2 for s in score.above(limit))


def plant(name: str, clips: dict[str, Motion], n: int) -> Count:
    """Plant a fault n times, in one clip after the other."""
    rng, count, motions = np.random.default_rng(0), Count(), list(clips.values())
    for k in range(n * ATTEMPTS):
        if count.planted == n:
            break
        planted = PLANTS[name](motions[k % len(motions)], rng)
        if planted is None:
            continue
        motion, start, stop = planted
        if is_found(name, motions[k % len(motions)], start, stop):
            count.hidden += 1  # the clip has that fault there already
            continue
        count.planted += 1
        count.found += is_found(name, motion, start, stop)
    return count


def bones(motion: Motion) -> tuple[float, float]:
    """Return the spread of the bones of joints, and of the same joints with a shin that breathes by 4 %."""
    joints = motion.joints()
    breathing = joints.copy()
    knee, ankle = SMPL24.index("left_knee"), SMPL24.index("left_ankle")
    share = 1 + 0.04 * np.sin(np.arange(len(joints)) / 20)
    breathing[:, ankle] = joints[:, knee] + (joints[:, ankle] - joints[:, knee]) * share[:, None]
    return bone_spread(joints, motion.skeleton), bone_spread(breathing, motion.skeleton)


def in_keypoints(shared: Path, name: str, motion: Motion) -> str:
    """Count the spikes of an AIST++ clip above the limit, and those that its keypoints have too."""
    folder = shared / "realdata/aistpp"
    path = folder / f"keypoints3d/{name}.pkl"
    if not path.exists():
        return ""
    scale = float(np.ravel(load_pickle(folder / f"motions/{name}.pkl")["smpl_scaling"])[0])
    points = np.asarray(load_pickle(path)["keypoints3d_optim"], dtype=np.float64)[:, :17] / scale
    both = alone = 0
    for start, stop, joint, size in spikes(motion, MEASURES["spikes"].limit):
        side, _, part = motion.skeleton.joints[joint].partition("_")
        if part not in COCO:
            continue
        track = points[:, COCO[part] + (side == "right")]
        frames = np.arange(start, stop)
        nodes = [start - 2, start - 1, stop, stop + 1]
        off = track[frames] - np.stack(
            [np.polyval(np.polyfit(nodes, track[nodes, a], 3), frames) for a in range(3)], 1
        )
        in_both = np.linalg.norm(off, axis=1).min() > size / 2
        both, alone = both + in_both, alone + (not in_both)
    return f"spikes of joints that the keypoints have: {alone} in the fit alone, {both} in the keypoints too"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--planted", type=int, default=40)
    parser.add_argument("--clips", type=int, default=100)
    arguments = parser.parse_args()
    shared = Path(os.environ.get("DANCEDATA_SHARED", Path(__file__).resolve().parents[2] / "shared"))
    sets = {"synthetic": synthetic(arguments.clips)}
    if shared.exists():
        sets["real"] = real(shared)
    alarms = {what: {n: score_motion(m) for n, m in clips.items()} for what, clips in sets.items()}
    print("| score | limit |" + "".join(f" planted, found ({s}) | alarms ({s}) |" for s in sets))
    print("|---|---|" + "---|---|" * len(sets))
    for name, measure in MEASURES.items():
        cells = []
        for what, clips in sets.items():
            count = plant(name, clips, arguments.planted)
            clean = [s[name].value for s in alarms[what].values() if s[name].value is not None]
            cells += [f"{count.planted}, {count.found}", f"{sum(v > measure.limit for v in clean)} of {len(clean)}"]
        print(
            f"| `{name}` | {measure.limit:g} {measure.unit.replace('1', '')} | " + " | ".join(cells) + " |",
            flush=True,
        )
    for what, clips in sets.items():
        spreads = [bones(m) for m in clips.values()]
        limit = MEASURES["bone_spread"].limit
        n = sum(after > limit for _, after in spreads)
        print(f"{what}: bones of joints, a shin that breathes by 4 %: {n} of {len(spreads)}; as they are: "
              f"{sum(before > limit for before, _ in spreads)}")  # fmt: skip
    for what, clips in sets.items():
        untouched = {name: repaired(motion, LIMITS).motion is motion for name, motion in clips.items()}
        print(f"{what}: repairs leave {sum(untouched.values())} of {len(clips)} clips as they are")
        for name, scores in alarms[what].items():
            above = [f"{k} {s.value:.3g} ({len(s.above(MEASURES[k].limit))} spans)" for k, s in scores.items()
                     if s.value is not None and s.value > MEASURES[k].limit]  # fmt: skip
            if above or what == "real":
                keypoints = in_keypoints(shared, name, sets[what][name]) if what == "real" else ""
                repaired = "" if untouched[name] else "; repaired"
                print(f"  {name}: {', '.join(above) or 'nothing'}{repaired}. {keypoints}")


if __name__ == "__main__":
    main()
