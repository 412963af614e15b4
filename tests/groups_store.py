"""A small store of groups of dancers on a line, for tests."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import CONTACTS, REPRESENTATIONS
from dancedata.core.skeleton import SMPL24
from dancedata.store import write_store
from dancedata.store.schema import Field, StoreHeader
from dancedata.store.stored_clip import AudioBlock, StoredClip
from dancedata.testing.stores import random_columns

EDGE = REPRESENTATIONS.make("edge151", {})
JOINTS = REPRESENTATIONS.make("joints", {})
CONTACT_RULE = CONTACTS.make("velocity", {})
GRID = FrameGrid(Fraction(30))
#: Dancers of each group, by split.
SIZES = {"train": (2, 3, 5, 3), "test": (2, 2)}
LENGTH = 20


def motion(rng: np.random.Generator, n: int, place: Sequence[float]) -> Motion:
    rotations = np.cumsum(rng.normal(scale=0.03, size=(n, 24, 3)), axis=0)
    translation = np.cumsum(rng.normal(scale=0.02, size=(n, 3)), axis=0) + place
    return Motion(rotations=rotations, translation=translation, grid=GRID, skeleton=SMPL24)


def stored(
    sizes: dict[str, tuple[int, ...]],
    order: Callable[[list[int]], list[int]] = list,
    *,
    length: int = LENGTH,
    music: str = "tune",
) -> list[StoredClip]:
    """Groups of dancers on a line, 1.2 m apart; `order` permutes the dancers of a group, as a tracker might."""
    rng = np.random.default_rng(0)
    clips = []
    for split, of_split in sizes.items():
        for number, size in enumerate(of_split):
            n = 3 * length + 10 * number
            rows_of_music = rng.normal(size=(n + 5, 35 if music == "librosa35" else 4)).astype(np.float32)
            motions = [motion(rng, n, (1.2 * k, 0.9, 0.3 * k * k)) for k in range(size)]
            for member, dancer in enumerate(order(list(range(size)))):
                rows = {
                    "edge151": EDGE.encode(motions[dancer], CONTACT_RULE),
                    "joints": JOINTS.encode(motions[dancer]),
                }
                clips.append(
                    StoredClip(
                        id=f"{split}{number}_p{member}", split=split, n_frames=n, group=f"{split}{number}",
                        member=member, role=f"dancer {dancer}", music=f"{split} song {number}", motion=rows,
                        starts=tuple(range(0, n - length + 1, length // 2)),
                        audio={music: AudioBlock(f"{split}{number}", rows_of_music, 2)},
                    )
                )  # fmt: skip
    if music == "librosa35":
        return clips
    alone = motion(rng, 50, (0, 0.9, 0))
    clips.append(
        StoredClip(
            id="alone", split="train", n_frames=50, starts=(0, 10), music="train song 0",
            motion={"edge151": EDGE.encode(alone, CONTACT_RULE), "joints": JOINTS.encode(alone)},
            audio={"tune": AudioBlock("alone", rng.normal(size=(50, 4)).astype(np.float32))},
        )
    )  # fmt: skip
    return clips


HEADER = StoreHeader(
    fps=Fraction(30), length=LENGTH, stride=10, skeleton=SMPL24,
    fields=(
        Field("edge151", "motion", EDGE.columns, Fraction(30)),
        Field("joints", "motion", JOINTS.columns, Fraction(30)),
        Field("tune", "audio", random_columns(4, mirror=False), Fraction(30)),
    ),
    meta={"recipe": {"name": "groups", "motion": {"edge151": {"contacts": {"velocity": {}}}, "joints": {}}}},
)  # fmt: skip


def write_groups(out: Path, length: int = 150) -> None:
    """Write a store of groups with the fields edge151 and librosa35, for examples of the documentation."""
    music = Field("librosa35", "audio", random_columns(35, mirror=False), Fraction(30))
    header = replace(HEADER, length=length, stride=length // 2, fields=(*HEADER.fields[:2], music))
    out.mkdir(parents=True, exist_ok=True)
    write_store(out, header, stored(SIZES, length=length, music="librosa35"))
