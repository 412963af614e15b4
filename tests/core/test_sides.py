"""Left, right and up: planted swaps, mirrors and axes are flagged; dances, handstands and mirrored copies are not."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from dancedata.core.motion import Motion
from dancedata.core.quality import IMPLAUSIBLE, OF_CLIPS, implausible_flags, implausible_sides
from dancedata.core.sides import sides_of
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.synthetic import synthesise_motion

LEGS = {1, 2, 4, 5, 7, 8, 10, 11}
#: Rotations of the world, as a wrongly declared axis makes them: z for y, y for z, -y for y.
WORLDS = [Rotation.from_euler("x", angle, degrees=True) for angle in (-90, 90, 180)]


@pytest.fixture(scope="module")
def dance() -> Motion:
    return synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=240)[0]


def order(of: str, skeleton: Skeleton = SMPL24) -> list[int]:
    """Joints with left and right swapped: of the "sides", the "legs" or the "arms"."""
    found = list(range(skeleton.n_joints))
    for left, right in skeleton.pairs:
        if of == "sides" or (of == "legs") == (left in LEGS):
            found[left], found[right] = right, left
    return found


def swapped(motion: Motion, of: str) -> Motion:
    rotations = motion.rotations[:, order(of, motion.skeleton)]
    return Motion(motion.translation, rotations, motion.grid, motion.skeleton)


def mirrored(motion: Motion) -> Motion:
    """The motion reflected across x = 0, its joints in their old order."""
    return Motion(motion.translation * (-1, 1, 1), motion.rotations * (1, -1, -1), motion.grid, motion.skeleton)


def turned(motion: Motion, world: Rotation) -> Motion:
    rotations, root = np.array(motion.rotations), motion.skeleton.offsets[0]
    rotations[:, 0] = (world * Rotation.from_rotvec(rotations[:, 0])).as_rotvec()
    return Motion(world.apply(root + motion.translation) - root, rotations, motion.grid, motion.skeleton)


def on_the_floor(motion: Motion, root: tuple[float, float, float]) -> Motion:
    """The motion with a still root, its lowest joint on the floor in every frame."""
    rotations = np.array(motion.rotations)
    rotations[:, 0] = root
    lowest = Motion(motion.translation, rotations, motion.grid, motion.skeleton).joints()[..., 1].min(axis=1)
    translation = motion.translation - lowest[:, None] * (0, 1, 0)
    return Motion(translation, rotations, motion.grid, motion.skeleton)


def kinds(motion: Motion) -> set[str]:
    return {flag.kind for flag in implausible_flags(motion)}


def test_cosines_against_loops(dance: Motion) -> None:
    places, sides = dance.joints(), sides_of(dance.joints(), dance)
    toes, knees, stance, elbows = [], [], [], []
    for frame, turns in zip(places, np.array(dance.rotations), strict=True):
        left = frame[1] - frame[2]
        front = np.cross(left, (frame[16] + frame[17] - frame[1] - frame[2]) / 2)
        for hip, knee, ankle, toe in ((1, 4, 7, 10), (2, 5, 8, 11)):
            toes.append(cosine(frame[toe] - frame[ankle], front))
            thigh, shin = frame[knee] - frame[hip], frame[ankle] - frame[knee]
            if np.degrees(np.arccos(cosine(thigh, shin))) > 15.07:
                knees.append(cosine(np.cross(thigh, shin), left))
        for elbow, wrist in ((18, 20), (19, 21)):
            bone = SMPL24.offsets[wrist] / np.linalg.norm(SMPL24.offsets[wrist])
            forearm = Rotation.from_rotvec(turns[elbow]).apply(bone)
            if np.degrees(np.arccos(forearm @ bone)) > 15.07:
                elbows.append(forearm[2])
        stance.append((frame[7] - frame[8]) @ left / (left @ left))
    expected = [np.median(values) for values in (toes, knees, elbows, stance)]
    assert np.allclose([sides.toes, sides.knees, sides.elbows, sides.stance], expected, atol=1e-4)


def cosine(one: NDArray[np.float64], two: NDArray[np.float64]) -> float:
    return float(one @ two / np.linalg.norm(one) / np.linalg.norm(two))


@pytest.mark.parametrize("of", ["sides", "legs", "arms"])
def test_positions_whose_names_are_swapped(dance: Motion, of: str) -> None:
    places = dance.joints()
    true, found = sides_of(places), sides_of(places[:, order(of)])
    assert (true.swapped, found.swapped, found.certain) == ("", of, True)
    legs, chest = {"sides": (-1, 1), "legs": (-1, -1), "arms": (1, -1)}[of]
    assert (found.toes, found.knees) == pytest.approx((legs * true.toes, legs * true.knees), abs=0.06)
    assert found.chest == pytest.approx(chest * true.chest, abs=1e-6)
    assert [kind for kind, _ in implausible_sides(places[:, order(of)])] == [f"implausible_{of}"]
    # A mirrored body with its old names is the same; with its names swapped it is a body again.
    mirror = places * (-1, 1, 1)
    assert sides_of(mirror).swapped == "sides"
    assert sides_of(mirror[:, order("sides")]).swapped == ""


PLANTED: list[tuple[str, Callable[[Motion], Motion]]] = [
    ("implausible_elbows", lambda motion: swapped(motion, "sides")),
    ("implausible_elbows", lambda motion: swapped(motion, "arms")),
    ("implausible_elbows", mirrored),
    *(("implausible_up", lambda motion, world=world: turned(motion, world)) for world in WORLDS),
]


@pytest.mark.parametrize(("kind", "plant"), PLANTED)
def test_arrays_on_a_body_of_their_own(dance: Motion, kind: str, plant: Callable[[Motion], Motion]) -> None:
    assert kinds(dance) == set()
    assert kind in kinds(plant(dance))
    assert kinds(swapped(mirrored(dance), "sides")) == set()


@pytest.mark.parametrize("root", [(np.pi, 0, 0), (np.pi / 2, 0, 0), (-np.pi / 2, 0, 0), (0, 0, np.pi / 2)])
def test_dancers_who_lie_or_stand_on_their_hands(dance: Motion, root: tuple[float, float, float]) -> None:
    motion = on_the_floor(dance, root)
    head = motion.joints()[:, 15] - motion.joints()[:, 7:9].mean(axis=1)
    assert np.median(head[:, 1]) < 0.3
    assert kinds(motion) == {"lying"}
    assert "lying" not in IMPLAUSIBLE  # it may be so: no strict build stops


def test_a_dancer_who_lies_and_rolls_the_chest(dance: Motion) -> None:
    """Hips and feet rest, so that the floor along the body is the steadier one, by millimetres."""
    rotations = np.zeros((600, 24, 3))
    rotations[:, 0, 0], rotations[:, 16, 2], rotations[:, 17, 2] = -np.pi / 2, -1.2, 1.2
    rotations[:, (3, 6), 1] = 0.2 * np.sin(np.arange(600) / 30)[:, None]
    noise = gaussian_filter1d(np.random.default_rng(0).normal(0, 0.003, (600, 3)), 6, axis=0)
    for turn in (0, np.pi):
        world = Rotation.from_euler("y", turn)
        motion = turned(Motion(noise, rotations, dance.grid, SMPL24), world)
        assert kinds(motion) & {"implausible_up", "implausible_sides"} == set()


@pytest.mark.parametrize("degrees", [40, 60, 80, 100])
def test_pointed_feet(dance: Motion, degrees: int) -> None:
    """Toes that point down or back, as en pointe, contradict nothing while knees and shoulders agree."""
    rotations = np.array(dance.rotations)
    rotations[:, (7, 8)] = (np.radians(degrees), 0, 0)
    motion = Motion(dance.translation, rotations, dance.grid, dance.skeleton)
    sides = sides_of(motion.joints(), motion)
    assert sides.knees > 0.5
    assert sides.toes < 0.5
    assert kinds(motion) == set()


def test_crossed_legs_are_a_doubt(dance: Motion) -> None:
    places = np.array(dance.joints())
    places[:, [7, 8, 10, 11]] = places[:, [8, 7, 11, 10]]
    assert "crossed_legs" in [kind for kind, _ in implausible_sides(places)]
    assert "crossed_legs" not in IMPLAUSIBLE


def test_a_spinning_dancer(dance: Motion) -> None:
    spin = Rotation.from_euler("y", np.linspace(0, 6 * np.pi, 240)[:, None])
    rotations = np.array(dance.rotations)
    rotations[:, 0] = (spin * Rotation.from_rotvec(rotations[:, 0])).as_rotvec()
    assert kinds(Motion(dance.translation, rotations, dance.grid, dance.skeleton)) == set()


@pytest.fixture(scope="module")
def real(shared: Path) -> dict[str, Motion]:
    from dancedata.datasets.folder.facts import Declared
    from dancedata.datasets.folder.load import Reading, load_motion

    paths: list[tuple[Path, str | None, str | None, str | None]]
    paths = [(path, "60", None, None) for path in sorted((shared / "realdata/aistpp/motions").glob("*.pkl"))]
    paths += [(path, "30", None, None) for path in sorted((shared / "realdata/finedance").glob("derived_315_*.npy"))]
    paths += [
        (shared / f"realdata/bvh/{name}.bvh", None, unit, up)
        for name, unit, up in (
            ("rokoko_jesse_dance", "cm", None),
            ("cmu_01_01", "cmu", None),
            ("fair1_dab", "guess", "z"),
        )
    ]
    return {p.stem: load_motion(p, Reading(Declared(fps, up, unit), Declared())) for p, fps, unit, up in paths}


def test_no_false_alarm_on_real_dances(real: dict[str, Motion], shared: Path) -> None:
    for name, motion in real.items():
        step = int(2 * motion.grid.rate)
        starts = range(0, motion.n_frames - step + 1, step)
        for part in (motion, swapped(mirrored(motion), "sides"), *(motion.part(k, k + step) for k in starts)):
            assert not kinds(part) & set(OF_CLIPS), name
    with np.load(shared / "golden/metrics/inputs.npz") as arrays:
        for name in arrays.files:
            if "yup" in name:
                assert implausible_sides(arrays[name].astype(np.float64)) == [], name


@pytest.mark.parametrize(("kind", "plant"), PLANTED)
def test_planted_in_real_dances(real: dict[str, Motion], kind: str, plant: Callable[[Motion], Motion]) -> None:
    assert {
        name
        for name, motion in real.items()
        if "bvh" not in motion.skeleton.name and kind not in kinds(plant(motion))
    } == set()


def test_swapped_legs_of_arrays_are_found_unless_steps_are_narrow(real: dict[str, Motion]) -> None:
    arrays = {name: motion for name, motion in real.items() if "bvh" not in motion.skeleton.name}
    missed = [name for name, motion in arrays.items() if kinds(swapped(motion, "legs")) != {"crossed_legs"}]
    assert missed == ["gJS_sBM_cAll_d03_mJS2_ch07"]
