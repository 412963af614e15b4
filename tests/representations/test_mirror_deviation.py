"""Deviation of mirrored columns from the reflection on asymmetric bodies, and the numbers of the docs."""

from pathlib import Path

import numpy as np
import pytest

from dancedata.contacts.height import Height
from dancedata.core.bodies import SMPLX22, SMPLX52, transfer
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.datasets.aistpp import AistPP
from dancedata.representations.lodge139 import Lodge139
from dancedata.testing.examples import mirrored_motion, random_motion

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "columns.md"
NAMES = ("smpl24", "smplx22", "smplx52")
#: Mean and largest distance, centimetres, of each body.
EXPECTED_CM = {
    "0 rad": ((0.7, 1.8), (1.4, 3.4), (0.6, 3.4)),
    "clips": ((1.0, 3.5), (1.7, 7.8), (1.6, 8.0)),
    "0.3 rad": ((1.0, 3.4), (1.7, 5.3), (1.7, 5.6)),
    "0.6 rad": ((1.4, 5.6), (2.2, 8.7), (2.7, 8.7)),
    "1.5 rad": ((1.9, 6.3), (3.3, 12.0), (4.6, 11.9)),
}
SKELETONS = pytest.mark.parametrize("skeleton", [SMPL24, SMPLX22, SMPLX52], ids=lambda s: s.name)


def deviation_m(motion: Motion) -> np.ndarray:
    """Distance (T, J) of the mirrored motion's joints from the reflected joints, on the motion's own skeleton."""
    order = list(range(motion.skeleton.n_joints))
    for left, right in motion.skeleton.pairs:
        order[left], order[right] = right, left
    reflection = motion.joints()[:, order] * (-1, 1, 1)
    return np.asarray(np.linalg.norm(mirrored_motion(motion).joints() - reflection, axis=-1))


def require(what: str, skeleton: Skeleton, deviations_m: np.ndarray) -> None:
    mean, most = EXPECTED_CM[what][NAMES.index(skeleton.name)]
    assert (round(100 * deviations_m.mean(), 1), round(100 * deviations_m.max(), 1)) == (mean, most)


@pytest.fixture(scope="module")
def clips(shared: Path) -> list[Motion]:
    dataset = AistPP(split="all", ignore="none", music="optional")
    found = [dataset.load(ref) for ref in dataset.scan(shared / "realdata" / "aistpp").clips]
    assert len(found) == 4
    return found


@SKELETONS
def test_on_real_clips(clips: list[Motion], skeleton: Skeleton) -> None:
    require("clips", skeleton, np.concatenate([deviation_m(transfer(clip, skeleton)) for clip in clips]))
    for words in ("1.0 cm on average on SMPL (3.5 at worst", "1.7 cm (7.8) on SMPL-X"):
        assert words in PAGE.read_text()


@SKELETONS
@pytest.mark.parametrize("turn_rad", [0.0, 0.3, 0.6, 1.5])
def test_on_random_rotations(skeleton: Skeleton, turn_rad: float) -> None:
    require(f"{turn_rad:g} rad", skeleton, deviation_m(random_motion(skeleton, 500, turn_rad=turn_rad)))


def test_labels_that_recomputing_would_change(clips: list[Motion]) -> None:
    """Contacts are permuted; detected again on the shipped body, some would differ."""
    made, changed = Lodge139(), []
    for clip in clips:
        permuted = made.columns.mirror.apply(made.encode(clip, Height()))[:, :4]
        anew = made.encode(mirrored_motion(transfer(clip, SMPLX22)), Height())[:, :4]
        changed.append(permuted != anew)
    share = 100 * np.concatenate(changed).mean()
    assert f"{share:.1f} % of the contacts" in PAGE.read_text()
