"""PopDanceSet (Luo et al. 2024): dances from videos, SMPL by HybrIK, 30 FPS; 1,036 clips of 305 videos.

The files: docs/datasets/popdanceset.md.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from dancedata.core.clip import ClipRef
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import DATASETS
from dancedata.core.rotations import rotation, rotvec_from_matrix
from dancedata.core.skeleton import SMPL24_EDGE, Skeleton
from dancedata.core.typing import override
from dancedata.datasets.checks import read_frames, require_matrices, require_rotations
from dancedata.datasets.published import Layout, Listing, PairedDataset
from dancedata.formats.values import open_arrays

RATE, JOINTS = 30, SMPL24_EDGE.n_joints
# Explicit ranges: \d would accept digits of other scripts.
_NAME = re.compile(r"(BV[0-9A-Za-z]{10})_Clip_[0-9]+")
#: From a camera's axes, +Y down and +Z away from it, to +Y up: half a turn about x.
_UPRIGHT, _UPRIGHT_VECTOR = np.diag([1.0, -1.0, -1.0]), np.array([np.pi, 0.0, 0.0])
#: What POPDG adds to positions after the turn, in our axes: one metre up, five towards the camera.
_POPDG_PLACE = (0.0, 1.0, 5.0)
_SHAPES: dict[str, list[tuple[int, ...]]] = {
    "transl": [(3,)],
    "pred_thetas": [(72,), (JOINTS, 3), (216,), (JOINTS, 9), (JOINTS, 3, 3)],
    "pred_camera": [(1,), ()],
}


@DATASETS.register("popdanceset")
@dataclass(frozen=True)
class PopDanceSet(PairedDataset):
    """PopDanceSet, from the published files and the lists of POPDG's repository.

    Attributes
    ----------
    split
        ``official``: train.txt and test.txt of POPDG's repository; 21 of the 24 test videos are in train as well, and
        there is no val. ``by-video``: a tenth of the videos each is val and test, by a hash of their names.
    scale
        ``none``: the translation as it is, in metres. ``multiply``: translation x ``pred_camera``, which has no unit,
        one metre up and five forward, as POPDG reads the files.
    """

    split: Literal["official", "by-video"] = field(default="official", metadata={"scan": True})
    scale: Literal["multiply", "none"] = field(default="none", metadata={"scan": True})

    body: ClassVar[Skeleton] = SMPL24_EDGE
    licence: ClassVar[str] = (
        "POPDG's code and lists: MIT. Motion was estimated from videos of third parties, whose videos and music "
        "are not licensed for redistribution."
    )
    citation: ClassVar[str] = "Luo et al., POPDG: Popular 3D Dance Generation with PopDanceSet, CVPR 2024."

    layout: ClassVar[Layout] = Layout(
        "popdanceset", "PopDanceSet", "motions", ".pkl", "BVxxxxxxxxxx_Clip_1.pkl",
        name_problem=lambda stem: "" if _NAME.fullmatch(stem) else "not named as a clip, BVxxxxxxxxxx_Clip_1",
        folder_names=("popdanceset",),
        published="1,036 were published",
    )  # fmt: skip
    music_folders: ClassVar[tuple[str, ...]] = ("wavs",)
    unit: ClassVar[str] = "video"
    official: ClassVar[Mapping[str, str]] = {"train": "train.txt", "test": "test.txt"}
    recorded: ClassVar[Mapping[str, str]] = {"high_quality": "high_quality_dataset"}
    below: ClassVar[tuple[str, ...]] = ("splits", "data/splits", "")
    get_lists: ClassVar[str] = "copy splits/ from the folder data/ of POPDG's repository into the source"

    @override
    def song_of(self, name: str) -> str:
        return name.rsplit("_Clip_", 1)[0]

    @override
    def clips_of(self, ref: ClipRef, listing: Listing) -> Iterable[ClipRef]:
        yield replace(ref, dancer=ref.music)  # of a video: one dancer or group of dancers

    @override
    def notes(self, listing: Listing, clips: Sequence[ClipRef]) -> Iterable[str]:
        none = "none: metres, with the camera 5 m or so away; POPDG multiplies by pred_camera (scale: multiply)"
        multiply = "translation x pred_camera, which has no physical unit, and POPDG's shift, as POPDG reads it"
        yield f"Scale: {none if self.scale == 'none' else multiply}."

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read the motion of one clip: 30 FPS, +Y up; the pelvis is at the translation (SMPL24_EDGE).

        Files have 72 numbers a frame, or 216 (matrices, as HybrIK writes them). DataError: as `open_arrays` and
        `read_frames`; ``not_rotations`` or ``bad_rotation``.
        """
        path, scaled = ref.motion_path, self.scale == "multiply"
        with open_arrays(path) as arrays:
            shapes = {key: shape for key, shape in _SHAPES.items() if scaled or key != "pred_camera"}
            places, thetas, *cameras = read_frames(arrays, shapes)
        if thetas.shape[1] == 3 * JOINTS:
            rotations = thetas.reshape(-1, JOINTS, 3).copy()
            require_rotations(path, "pred_thetas", rotations, places, SMPL24_EDGE.parents)
        else:
            matrices = thetas.reshape(-1, JOINTS, 3, 3)
            require_matrices(str(path), matrices, SMPL24_EDGE.joints)
            rotations = rotvec_from_matrix(matrices)
        for camera in cameras:
            places = places * camera
        rotations[:, 0] = (rotation(_UPRIGHT_VECTOR) * rotation(rotations[:, 0])).as_rotvec()
        shift = _POPDG_PLACE if scaled else (0.0, 0.0, 0.0)
        return Motion(places @ _UPRIGHT.T + shift, rotations, FrameGrid.of(RATE), SMPL24_EDGE)

    @override
    def make_example(self, folder: Path) -> None:
        """Write four clips of six seconds, one of them with matrices, and the lists."""
        from dancedata.datasets._examples import dance, write_lines, write_pickle, write_song

        for k, (clip, n, more_s, _, steps) in enumerate(_CLIPS):
            write_song(folder / "wavs" / f"{clip}.wav", steps, n / RATE + more_s)
            content = content_of(dance(steps, n))
            if k == 2:
                turned = rotation(content["pred_thetas"].reshape(-1, 3)).as_matrix()
                content["pred_thetas"] = turned.reshape(n, 216).astype(np.float32)
            write_pickle(folder / "motions" / f"{clip}.pkl", content)
        for split, end in (("train", "\n"), ("test", "")):
            write_lines(folder / "splits" / f"{split}.txt", [c for c, _, _, of, _ in _CLIPS if of == split], end)
        write_lines(folder / "high_quality_dataset", [_CLIPS[0][0]])


#: Of the example: clip, frames, seconds of music beyond the motion, split, and the synthetic clip that it is.
_CLIPS = (
    ("BVaaaaaaaa1a_Clip_1", 181, 0.0, "train", "gBR_sBM_cAll_d04_mBR0_ch01"),
    ("BVaaaaaaaa1a_Clip_2", 180, 0.2, "train", "gBR_sBM_cAll_d04_mBR0_ch02"),
    ("BVbbbbbbbb2b_Clip_1", 183, -0.2, "train", "gPO_sBM_cAll_d10_mPO4_ch03"),
    ("BVcccccccc3c_Clip_7", 180, 0.0, "test", "gMH_sBM_cAll_d22_mMH1_ch04"),
)


def content_of(motion: Motion) -> dict[str, Any]:
    """Return a motion as a pickle of PopDanceSet has it: the camera's axes, a slowly varying `pred_camera`."""
    n, thetas = motion.n_frames, motion.rotations.copy()
    thetas[:, 0] = (rotation(_UPRIGHT_VECTOR) * rotation(thetas[:, 0])).as_rotvec()
    content = {
        "transl": motion.joints()[:, 0] @ _UPRIGHT.T + (0.0, 0.0, 5.0),
        "pred_thetas": thetas.reshape(n, 72),
        "pred_camera": 0.85 + 0.3 * np.sin(np.arange(n) / 40)[:, None],
        "pred_betas": np.zeros((n, 10)),
    }
    return {key: array.astype(np.float32) for key, array in content.items()}
