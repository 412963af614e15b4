"""Deviation of mirrored columns from the reflection on asymmetric bodies: the numbers of the docs."""

from pathlib import Path

import numpy as np
import pytest

from dancedata.contacts.height import Height
from dancedata.core.bodies import SMPLX22, SMPLX52, carried_over
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.datasets.aistpp import AistPP
from dancedata.representations.lodge139 import Lodge139
from dancedata.testing.examples import mirrored_motion, random_motion

PAGE = Path(__file__).resolve().parents[2] / "docs" / "representations.md"
SKELETONS = pytest.mark.parametrize("skeleton", [SMPL24, SMPLX22, SMPLX52], ids=lambda s: s.name)


def deviation_m(motion: Motion) -> np.ndarray:
    """Distance (T, J) of the mirrored motion's joints from the reflected joints, on the motion's own skeleton."""
    order = list(range(motion.skeleton.n_joints))
    for left, right in motion.skeleton.pairs:
        order[left], order[right] = right, left
    reflection = motion.joints()[:, order] * (-1, 1, 1)
    return np.asarray(np.linalg.norm(mirrored_motion(motion).joints() - reflection, axis=-1))


def in_docs(what: str, skeleton: Skeleton, found: np.ndarray) -> None:
    row = next(line for line in PAGE.read_text().splitlines() if line.startswith(f"| {what}"))
    column = {"smpl24": 2, "smplx22": 3, "smplx52": 4}[skeleton.name]
    assert row.split("|")[column].strip() == f"{100 * found.mean():.1f} / {100 * found.max():.1f}"


@pytest.fixture(scope="module")
def clips(shared: Path) -> list[Motion]:
    dataset = AistPP(split="all", ignore="none", music="optional")
    found = [dataset.load(ref) for ref in dataset.scan(shared / "realdata" / "aistpp").clips]
    assert len(found) == 4
    return found


@SKELETONS
def test_on_real_clips(clips: list[Motion], skeleton: Skeleton) -> None:
    found = np.concatenate([deviation_m(carried_over(clip, skeleton)) for clip in clips])
    in_docs("four real AIST++ clips", skeleton, found)


@SKELETONS
@pytest.mark.parametrize("turn_rad", [0.0, 0.3, 0.6, 1.5])
def test_on_random_rotations(skeleton: Skeleton, turn_rad: float) -> None:
    found = deviation_m(random_motion(skeleton, 500, turn_rad=turn_rad))
    in_docs(f"{turn_rad:g} rad" if turn_rad else "at rest", skeleton, found)


def test_labels_that_recomputing_would_change(clips: list[Motion]) -> None:
    """Contacts are permuted; detected again on the shipped body, some would differ."""
    made, changed = Lodge139(), []
    for clip in clips:
        permuted = made.columns.mirror.apply(made.encode(clip, Height()))[:, :4]
        anew = made.encode(mirrored_motion(carried_over(clip, SMPLX22)), Height())[:, :4]
        changed.append(permuted != anew)
    share = 100 * np.concatenate(changed).mean()
    assert f"{share:.1f} % of the labels" in PAGE.read_text()
