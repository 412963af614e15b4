"""Poses of the splits: a map of them, how far each split lies from train, and windows that two splits share.

Poses are relative to the root and turned to the front. All numbers are rounded, and chance draws from fixed seeds, so
equal datasets give equal numbers.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import BODY_JOINTS
from dancedata.core.clip import Window
from dancedata.core.dance import Undefined
from dancedata.core.grid import FrameGrid
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24
from dancedata.execution.arithmetic import one_thread
from dancedata.kernel import ClipRecord, Store
from dancedata.metrics import frechet, geometric, kinetic
from dancedata.scene.pieces import ClipReader, Piece, measured_units

#: Poses and windows that are compared, about and at most, and poses of a window.
_POSES, _WINDOWS, _MOMENTS = 8000, 6000, 10
#: Windows of two splits nearer than this, rms over joints and moments, are one: metres.
DUPLICATE_M = 0.02
#: Pairs of windows that are kept, the nearest first.
_PAIRS = 200
#: Hexagons of the map from left to right.
_HEXAGONS = 18
#: Draws for the chance level of Frechet distances.
DRAWS = 20
#: Rows of distances at a time.
_BLOCK = 1000
_PARENTS = {SMPL24.joints[j]: SMPL24.joints[parent] for j, parent in enumerate(SMPL24.parents) if parent >= 0}


def frontal(joints: Float64Array, names: Sequence[str]) -> Float64Array:
    """Return joints (T, J, 3) relative to the root, turned about +Y so that the left hip lies along +X."""
    poses = joints - joints[:, :1]
    if "left_hip" not in names or "right_hip" not in names:
        return poses
    across = joints[:, names.index("left_hip")] - joints[:, names.index("right_hip")]
    length = np.hypot(across[:, 0], across[:, 2])
    flat = length < 1e-9
    cos = np.where(flat, 1.0, across[:, 0] / np.where(flat, 1.0, length))[:, None]
    sin = np.where(flat, 0.0, across[:, 2] / np.where(flat, 1.0, length))[:, None]
    x, y, z = poses[..., 0], poses[..., 1], poses[..., 2]
    return np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=-1)


@dataclass(frozen=True)
class Nearness:
    """Distances of `n` poses to the nearest pose of train, rms over joints, metres: median and 95 % quantile."""

    n: int
    p50: float
    p95: float


@dataclass(frozen=True)
class Hexagon:
    """Poses near each other on the map."""

    # `x`, `y`: its centre, metres along the first two components
    x: float
    y: float
    counts: Mapping[str, int]  # poses by split
    # `clip`, `seconds`: the pose nearest to the centre
    clip: str
    seconds: float
    pose: tuple[tuple[int, int], ...]  # (J, 2) that pose from the front, millimetres

    def bones(self, joints: Sequence[str]) -> Iterator[tuple[str, tuple[int, int], tuple[int, int]]]:
        """Yield side ("left", "right", "mid") and both ends of each bone of SMPL that the pose has, millimetres."""
        at = dict(zip(joints, self.pose, strict=True))
        for name, place in at.items():
            parent = at.get(_PARENTS.get(name, ""))
            if parent is not None:
                side = name.partition("_")[0]
                yield side if side in ("left", "right") else "mid", parent, place


@dataclass(frozen=True)
class WindowPair:
    """Two windows of different splits, and the rms distance of their poses, metres."""

    clips: tuple[str, str]
    splits: tuple[str, str]
    seconds: tuple[float, float]
    distance_m: float


@dataclass(frozen=True)
class FrechetLevels:
    """Frechet distance of a split to train, and of random parts of train of its size to the rest of train."""

    value: float
    chance_min: float
    chance_p50: float
    chance_max: float


@dataclass(frozen=True)
class Poses:
    """Poses of the splits; see `Space`."""

    joints: tuple[str, ...]
    n: Mapping[str, int]  # poses by split
    every_s: float | None  # seconds between two poses of a clip
    variance: tuple[float, ...]  # shares of the variance along the first five components
    # `radius`, `hexagons`: the map, and the radius of a hexagon, metres
    radius: float
    hexagons: tuple[Hexagon, ...]
    # `to_train`, `chance`: distances of each other split to train, and of one random half of the clips of train to
    # the other
    to_train: Mapping[str, Nearness]
    chance: Nearness | None
    frechet: Mapping[str, Mapping[str, FrechetLevels]]  # by features ("kinetic", "geometric") and split
    windows: Mapping[str, int]
    # `n_duplicates`, `duplicates`: pairs of windows of two splits nearer than DUPLICATE_M, and the nearest of them
    n_duplicates: int
    duplicates: tuple[WindowPair, ...]


@dataclass
class Space:
    """Poses, windows and features of the clips of a dataset, thinned to a fixed number."""

    grid: FrameGrid
    pose_step: int
    window_step: int
    joints: tuple[str, ...] = ()
    poses: list[npt.NDArray[np.float32]] = field(default_factory=list)
    pose_of: list[tuple[str, str, float]] = field(default_factory=list)
    windows: list[npt.NDArray[np.float32]] = field(default_factory=list)
    window_of: list[tuple[str, str, float]] = field(default_factory=list)
    features: dict[str, dict[str, Float64Array]] = field(default_factory=lambda: {"kinetic": {}, "geometric": {}})
    split_of: dict[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, store: Store, windows: Mapping[str, Sequence[Window]]) -> Space:
        """Choose the steps from the size of a dataset."""
        originals = [clip for clip in store if not clip.source]
        n_frames = sum(clip.n_frames for clip in originals)
        n_windows = sum(len(windows[clip.id]) for clip in originals)
        return cls(store.grid, max(1, -(-n_frames // _POSES)), max(1, -(-n_windows // _WINDOWS)))

    def add(self, clip: ClipRecord, piece: Piece, windows: Sequence[Window]) -> None:
        """Add a clip."""
        self.split_of[clip.id] = clip.split
        figure, names = piece.figure, piece.figure.skeleton.joints
        body = [names.index(name) for name in BODY_JOINTS] if set(BODY_JOINTS) <= set(names) else range(len(names))
        self.joints = tuple(names[j] for j in body)
        rate = piece.rate
        trim = max(0.0, clip.trim_start / float(self.grid.rate))
        poses = frontal(figure.joints, names)[:, body]
        step = max(1, round(self.pose_step * rate / float(self.grid.rate)))
        kept = np.arange(int(np.ceil(trim * rate)), len(poses), step)
        self.poses.append(poses[kept].reshape(len(kept), -1).astype(np.float32))
        self.pose_of += [(clip.id, clip.split, k / rate) for k in kept.tolist()]
        for window in windows[:: self.window_step]:
            begin = window.start / float(self.grid.rate) * rate
            end = begin + (window.length - 1) / float(self.grid.rate) * rate
            if trim * rate - 1e-6 <= begin and end <= len(poses) - 1 + 1e-6:
                moments = np.linspace(begin, end, _MOMENTS).round().astype(int)
                self.windows.append(poses[moments].reshape(-1).astype(np.float32))
                self.window_of.append((clip.id, clip.split, window.start / float(self.grid.rate)))
        self._measure(clip, piece, trim)

    def _measure(self, clip: ClipRecord, piece: Piece, trim: float) -> None:
        if len(self.joints) != len(BODY_JOINTS):
            return
        body = [piece.figure.skeleton.joints.index(name) for name in BODY_JOINTS]
        joints = piece.figure.joints[int(np.ceil(trim * piece.rate)) :, body]
        try:
            self.features["kinetic"][clip.id] = kinetic(joints - joints[:1, :1], piece.rate)
            self.features["geometric"][clip.id] = geometric(joints - joints[:1, :1])
        except (Undefined, IndexError):  # too short
            self.features["kinetic"].pop(clip.id, None)


def measured_poses(store: Store) -> Poses:
    """Measure the poses of a dataset alone; a report measures them with everything else."""
    reader, windows = ClipReader.of(store), {clip.id: store[clip.id].windows() for clip in store}
    space = Space.of(store, windows)
    for clip in (clip for dancers in measured_units(store) for clip in dancers):
        if (piece := reader.piece(clip)) is not None:
            space.add(clip, piece, windows[clip.id])
    return poses_of(space, store.splits)


def base_split(poses: Poses) -> str:
    """Return the split that the hexagons of a map show: train, or the only one."""
    return "train" if poses.n.get("train") else next(iter(poses.n))


def poses_of(space: Space, splits: Sequence[str]) -> Poses:
    """Return the numbers of a space."""
    with one_thread():
        return _poses_of(space, splits)


def _poses_of(space: Space, splits: Sequence[str]) -> Poses:
    poses = np.concatenate(space.poses) if space.poses else np.zeros((0, 3 * len(space.joints)), np.float32)
    of_split = np.array([split for _, split, _ in space.pose_of])
    n = {split: int((of_split == split).sum()) for split in splits}
    places, variance = components(poses.astype(np.float64))
    radius = _radius(places)
    train = poses[of_split == "train"] if len(poses) else poses
    to_train = {
        split: nearness(poses[of_split == split], train, len(space.joints))
        for split in splits
        if split != "train" and n[split] and len(train)
    }
    n_duplicates, pairs = duplicates(space)
    return Poses(
        joints=space.joints,
        n=n,
        every_s=space.pose_step / float(space.grid.rate) if len(poses) else None,
        variance=variance,
        radius=radius,
        hexagons=_hexagons(space, poses, places[:, :2], radius, splits),
        to_train=to_train,
        chance=_chance(space, poses, of_split),
        frechet={kind: _frechet(space, rows, splits) for kind, rows in space.features.items()},
        windows={split: sum(of == split for _, of, _ in space.window_of) for split in splits},
        n_duplicates=n_duplicates,
        duplicates=pairs,
    )


def components(poses: Float64Array) -> tuple[Float64Array, tuple[float, ...]]:
    """Return the places (N, 5) of poses (N, D) along their principal components, and the shares of the variance."""
    if len(poses) < 2:
        return np.zeros((len(poses), 5)), ()
    centred = poses - poses.mean(axis=0)
    values, vectors = np.linalg.eigh(centred.T @ centred / (len(poses) - 1))
    largest = vectors[:, ::-1][:, :5]
    signs = np.sign(largest[np.abs(largest).argmax(axis=0), np.arange(largest.shape[1])])
    shares = values[::-1][:5] / max(float(values.sum()), 1e-12)
    return np.round(centred @ (largest * signs), 3), tuple(round(float(v), 3) for v in shares)


def distances(poses: npt.NDArray[np.float32], others: npt.NDArray[np.float32], parts: int) -> Float64Array:
    """Return the rms distance over `parts` points of each of poses (N, D) to the nearest of others (M, D)."""
    nearest = [_squared(poses[k : k + _BLOCK], others).min(axis=1) for k in range(0, len(poses), _BLOCK)]
    return np.asarray(np.sqrt(np.maximum(np.concatenate(nearest), 0.0) / parts))


def _squared(a: npt.NDArray[np.float32], b: npt.NDArray[np.float32]) -> Float64Array:
    one, two = a.astype(np.float64), b.astype(np.float64)
    rows, columns = (one**2).sum(axis=1), (two**2).sum(axis=1)
    squared = np.asarray(2 * one @ two.T)
    for row, at in zip(rows, squared, strict=True):  # in place: the three of a block would be 200 MB
        np.subtract(row + columns, at, out=at)
    return squared


def nearness(poses: npt.NDArray[np.float32], train: npt.NDArray[np.float32], joints: int) -> Nearness:
    """Return median and 95 % quantile of the distances of poses (N, 3 J) to those of train (M, 3 J)."""
    median, high = np.quantile(distances(poses, train, joints), (0.5, 0.95))
    return Nearness(len(poses), round(float(median), 4), round(float(high), 4))


def _chance(space: Space, poses: npt.NDArray[np.float32], of_split: npt.NDArray[np.str_]) -> Nearness | None:
    """Return the nearness of a random half of the clips of train to the other half."""
    clips = [clip for clip, split in space.split_of.items() if split == "train"]
    if len(clips) < 2:
        return None
    half = {clips[k] for k in np.random.default_rng(0).permutation(len(clips))[: len(clips) // 2]}
    in_half = np.array([clip in half for clip, _, _ in space.pose_of])
    one, two = poses[in_half], poses[~in_half & (of_split == "train")]
    return nearness(one, two, len(space.joints)) if len(one) and len(two) else None


def _frechet(space: Space, features: Mapping[str, Float64Array], splits: Sequence[str]) -> dict[str, FrechetLevels]:
    rows = {s: np.array([r for clip, r in features.items() if space.split_of[clip] == s]) for s in splits}
    train = rows.get("train", np.zeros((0, 1)))
    return {
        split: frechet_levels(rows[split], train)
        for split in splits
        if split != "train" and len(rows[split]) >= 2 and len(train) >= 4
    }


def frechet_levels(rows: Float64Array, train: Float64Array) -> FrechetLevels:
    """Return the Frechet distance of features (N, D) to those of train (M, D), and its chance level.

    Features are normalised by train's mean and standard deviation. A Frechet distance grows as sets shrink: for the
    chance level, random parts of train of N clips, at most half of it, are compared with the rest of train.
    """
    std = train.std(axis=0)
    scale = np.where(std > 1e-9, std, 1.0)
    one, two = (rows - train.mean(axis=0)) / scale, (train - train.mean(axis=0)) / scale
    rng, size = np.random.default_rng(0), min(len(rows), len(train) // 2)
    draws = [rng.permutation(len(two)) for _ in range(DRAWS)]
    chance = np.quantile([frechet(two[d[:size]], two[d[size:]]) for d in draws], (0, 0.5, 1))
    return FrechetLevels(*(round(float(v), 3) for v in (frechet(one, two), *chance)))


def duplicates(space: Space) -> tuple[int, tuple[WindowPair, ...]]:
    """Return the number of pairs of windows of two splits nearer than DUPLICATE_M, and the nearest of them."""
    if not space.windows:
        return 0, ()
    rows, splits = np.stack(space.windows), np.array([split for _, split, _ in space.window_of])
    parts = len(space.joints) * _MOMENTS
    found: list[WindowPair] = []
    n = 0
    names = list(dict.fromkeys(splits.tolist()))
    for k, first in enumerate(names):
        for second in names[k + 1 :]:
            ours, theirs = np.flatnonzero(splits == first), np.flatnonzero(splits == second)
            for begin in range(0, len(ours), _BLOCK):
                block = ours[begin : begin + _BLOCK]
                squared = _squared(rows[block], rows[theirs]) / parts
                near = np.argwhere(squared < DUPLICATE_M**2)
                n += len(near)
                order = np.argsort(squared[near[:, 0], near[:, 1]], kind="stable")[:_PAIRS]
                for i, j in near[order].tolist():
                    pair = space.window_of[block[i]], space.window_of[theirs[j]]
                    distance = round(float(np.sqrt(max(squared[i, j], 0.0))), 4)
                    clips, of, seconds = zip(*pair, strict=True)
                    found.append(WindowPair(clips, of, tuple(round(s, 3) for s in seconds), distance))
    found.sort(key=lambda pair: (pair.distance_m, pair.clips, pair.seconds))
    return n, tuple(found[:_PAIRS])


def _radius(places: Float64Array) -> float:
    span = float(np.ptp(places[:, 0])) if len(places) else 0.0
    return float(round(max(span, 0.01) / (_HEXAGONS * np.sqrt(3)), 4))


def _hexagons(
    space: Space, poses: npt.NDArray[np.float32], places: Float64Array, radius: float, splits: Sequence[str]
) -> tuple[Hexagon, ...]:
    """Return the hexagons that hold poses: pointy-topped, the nearest centre of two shifted grids."""
    if not len(places):
        return ()
    wide, high = np.sqrt(3) * radius, 3 * radius
    grids = []
    for shift in (0.0, 0.5):
        column, row = np.round(places[:, 0] / wide - shift), np.round(places[:, 1] / high - shift)
        centre = np.stack([(column + shift) * wide, (row + shift) * high], axis=1)
        grids.append((centre, ((places - centre) ** 2).sum(axis=1)))
    nearer = grids[1][1] < grids[0][1]
    centres = np.round(np.where(nearer[:, None], grids[1][0], grids[0][0]), 4)
    away = np.where(nearer, grids[1][1], grids[0][1])
    members: dict[tuple[float, float], list[int]] = {}
    for number, (x, y) in enumerate(centres.tolist()):
        members.setdefault((x, y), []).append(number)
    return tuple(_hexagon(space, poses, centre, of, away, splits) for centre, of in sorted(members.items()))


def _hexagon(
    space: Space, poses: npt.NDArray[np.float32], centre: tuple[float, float], members: Sequence[int],
    away: Float64Array, splits: Sequence[str],
) -> Hexagon:  # fmt: skip
    middle = min(members, key=lambda number: (round(float(away[number]), 6), number))
    clip, _, seconds = space.pose_of[middle]
    counts = {split: sum(space.pose_of[k][1] == split for k in members) for split in splits}
    pose = poses[middle].reshape(-1, 3)[:, :2]
    return Hexagon(
        *centre, counts, clip, round(seconds, 3), tuple((round(1000 * x), round(1000 * y)) for x, y in pose.tolist())
    )
