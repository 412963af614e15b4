"""Metrics of dances in plain loops, frame by frame and joint by joint, as the published programs compute them.

Written from the formulas, not from the programs. `benchmarks/metrics.py` compares times with them, and the tests take
them as an oracle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

PELVIS, LHIP, RHIP, BELLY, LKNEE, RKNEE, _, LANKLE, RANKLE, CHEST, LTOE, RTOE, NECK = range(13)
LSHOULDER, RSHOULDER, LELBOW, RELBOW, LWRIST, RWRIST = range(16, 22)
HUMERUS, SHOULDERS, HIPS = 0.2568381092, 0.3908483586, 0.1192470659
RATE = 120


def kinetic(joints: Array, frame_s: float, *, slip: bool, up: int = 1) -> Array:
    """Return the kinetic features (3 J,)."""
    n = len(joints)
    features = []
    for j in range(joints.shape[1]):
        horizontal = vertical = energy = 0.0
        for i in range(1, n):
            velocity, count = np.zeros(3), 0
            for k in range(i - 2, i + 3):
                if 1 <= k <= n - 1:
                    velocity += joints[k, j] - joints[k - 1, j]
                    count += 1
            velocity /= count * frame_s
            vertical += velocity[up] ** 2
            horizontal += sum(velocity[a] ** 2 for a in range(3) if a != up)
            acceleration, count = np.zeros(3), 0
            for k in range(i - 2, i + 3):
                if 1 <= k <= n - 2:
                    later = (joints[k + 1, j] - joints[k, j]) / frame_s
                    if slip:
                        earlier = joints[k, j] - joints[k - 1, j] / frame_s
                    else:
                        earlier = (joints[k, j] - joints[k - 1, j]) / frame_s
                    acceleration += (later - earlier) / frame_s
                    count += 1
            energy += float(np.linalg.norm(acceleration / count))
        features += [horizontal / (n - 1), vertical / (n - 1), energy / (n - 1)]
    return np.array(features)


def geometric(joints: Array) -> Array:
    """Return the geometric features (32,), y up."""
    counts = np.zeros(32)
    for t in range(1, len(joints)):
        counts += _rules(joints[t - 1], joints[t])
    return counts / (len(joints) - 1)


def _rules(before: Array, now: Array) -> list[bool]:
    lowest = min(joint[1] for joint in now)
    h = HUMERUS
    spine = now[PELVIS] - now[NECK]

    def along(normal: Array, vector: Array) -> float:
        return float(np.dot(normal / np.linalg.norm(normal), vector))

    def relative(p: int, o: int) -> Array:
        return (now[p] - now[o]) - (before[p] - before[o])

    def nmove(a: int, b: int, c: int, p: int, limit: float) -> bool:
        return along(np.cross(now[c] - now[a], now[b] - now[a]), relative(p, a)) * RATE > limit

    def move(a: int, b: int, p: int, limit: float) -> bool:
        return along(now[b] - now[a], relative(p, a)) * RATE > limit

    def nplane(n1: int, n2: int, a: int, p: int, limit: float) -> bool:
        return along(now[n2] - now[n1], now[p] - now[a]) > limit

    def plane(a: int, b: int, c: int, p: int, limit: float) -> bool:
        return along(np.cross(now[c] - now[a], now[b] - now[a]), now[p] - now[a]) > limit

    def angle(u: Array, v: Array, low: float, high: float) -> bool:
        cosine = float(np.dot(u, v) / (np.linalg.norm(u) * np.linalg.norm(v)))
        return abs(cosine) <= 1 and low < math.degrees(math.acos(cosine)) < high

    def fast(p: int, limit: float) -> bool:
        return float(np.linalg.norm(now[p] - before[p])) * RATE > limit

    def low(p: int, limit: float) -> bool:
        return -(now[p][1] - lowest) > limit

    return [
        nmove(NECK, RHIP, LHIP, RWRIST, 1.8 * h),
        nmove(NECK, LHIP, RHIP, LWRIST, 1.8 * h),
        nplane(CHEST, NECK, NECK, RWRIST, 0.2 * h),
        nplane(CHEST, NECK, NECK, LWRIST, 0.2 * h),
        move(BELLY, CHEST, CHEST, 1.8 * h),
        move(BELLY, CHEST, CHEST, 1.8 * h),
        angle(now[RSHOULDER] - now[RELBOW], now[RWRIST] - now[RELBOW], 0, 110),
        angle(now[LSHOULDER] - now[LELBOW], now[LWRIST] - now[LELBOW], 0, 110),
        nplane(LSHOULDER, RSHOULDER, LWRIST, RWRIST, 2.5 * SHOULDERS),
        move(LWRIST, RWRIST, RWRIST, 1.4 * h),
        move(RWRIST, PELVIS, LWRIST, 1.4 * h),
        move(LWRIST, PELVIS, RWRIST, 1.4 * h),
        fast(RWRIST, 2.5 * h),
        fast(LWRIST, 2.5 * h),
        plane(PELVIS, LHIP, LTOE, RANKLE, 0.38 * h),
        plane(PELVIS, RHIP, RTOE, LANKLE, 0.38 * h),
        now[RANKLE][1] - lowest > 1.2 * h,
        now[LANKLE][1] - lowest > 1.2 * h,
        nplane(LHIP, RHIP, LANKLE, RANKLE, 2.1 * HIPS),
        angle(now[RHIP] - now[RKNEE], now[RANKLE] - now[RKNEE], 0, 110),
        angle(now[LHIP] - now[LKNEE], now[LANKLE] - now[LKNEE], 0, 110),
        fast(RANKLE, 2.5 * h),
        fast(LANKLE, 2.5 * h),
        angle(spine, now[RELBOW] - now[RSHOULDER], 25, 180),
        angle(spine, now[LELBOW] - now[LSHOULDER], 25, 180),
        angle(spine, now[RKNEE] - now[RHIP], 50, 180),
        angle(spine, now[LKNEE] - now[LHIP], 50, 180),
        plane(RANKLE, NECK, LANKLE, PELVIS, 0.5 * h),
        angle(spine, np.array([0.0, 1.0, 0.0]), 70, 110),
        low(RWRIST, -1.2 * h),
        low(LWRIST, -1.2 * h),
        fast(PELVIS, 2.3 * h),
    ]


def motion_beats(joints: Array, smooth: Callable[[Array], Array]) -> list[int]:
    """Return the strict local minima of the smoothed mean speed."""
    speeds = []
    for t in range(len(joints) - 1):
        total = 0.0
        for j in range(joints.shape[1]):
            total += float(np.linalg.norm(joints[t + 1, j] - joints[t, j]))
        speeds.append(total / joints.shape[1])
    curve = smooth(np.array(speeds))
    return [t for t in range(1, len(curve) - 1) if curve[t] < curve[t - 1] and curve[t] < curve[t + 1]]


def beat_alignment(from_: Sequence[float], to: Sequence[float], sigma: float) -> float:
    """Return the mean over `from_` of the kernel of the distance to the nearest of `to`."""
    total = 0.0
    for beat in from_:
        distance = min(abs(beat - other) for other in to)
        total += math.exp(-(distance**2) / 2 / sigma**2)
    return total / len(from_)


def pfc(joints: Array, up: int = 1) -> float:
    """Return PFC with steps per frame."""
    accelerations, products = [], []
    flat = [a for a in range(3) if a != up]
    for t in range(1, len(joints) - 1):
        acceleration = (joints[t + 1, PELVIS] - joints[t, PELVIS]) - (joints[t, PELVIS] - joints[t - 1, PELVIS])
        acceleration[up] = max(acceleration[up], 0)
        accelerations.append(float(np.linalg.norm(acceleration)))
        feet = []
        for pair in ((LANKLE, LTOE), (RANKLE, RTOE)):
            feet.append(min(float(np.linalg.norm((joints[t + 1, j] - joints[t, j])[flat])) for j in pair))
        products.append(feet[0] * feet[1])
    largest = max(accelerations)
    return 10_000 * sum(p * a / largest for p, a in zip(products, accelerations, strict=True)) / len(products)


def skating(joints: Array) -> tuple[float, float]:
    """Return the shares of left and right contact frames that slide by Lodge's code."""
    toes = joints[0, LTOE, 1], joints[0, RTOE, 1]
    ground = sum(toes) / 2 if abs(toes[0] - toes[1]) < 0.02 else min(toes)
    shares = []
    for ankle, toe in ((LANKLE, LTOE), (RANKLE, RTOE)):
        contacts = slides = 0
        for t in range(len(joints)):
            if joints[t, ankle, 1] - ground <= 0.08 and joints[t, toe, 1] - ground <= 0.05:
                contacts += 1
                if t + 1 < len(joints):
                    steps = [joints[t + 1, j] - joints[t, j] for j in (ankle, toe)]
                    slides += any(abs((step[0] + step[2]) / 2) > 0.01 for step in steps)
        shares.append(slides / contacts)
    return shares[0], shares[1]


def frechet(one: Array, two: Array) -> float:
    """Return the Frechet distance with a matrix root, as the published programs have it."""
    from scipy.linalg import sqrtm

    c1, c2 = np.cov(one, rowvar=False), np.cov(two, rowvar=False)
    difference = one.mean(axis=0) - two.mean(axis=0)
    root = np.real(sqrtm(c1 @ c2))
    return float(difference @ difference + np.trace(c1) + np.trace(c2) - 2 * np.trace(root))


def diversity(rows: Array) -> float:
    """Return the mean distance over all pairs."""
    total, pairs = 0.0, 0
    for i in range(len(rows)):
        for j in range(i + 1, len(rows)):
            total += float(np.linalg.norm(rows[i] - rows[j]))
            pairs += 1
    return total / pairs
