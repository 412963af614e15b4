"""DCM (Wang et al. 2024, DanceCamera3D): dances and cameras of MikuMikuDance, 108 sequences, 30 FPS, in pieces.

The files, as DanceCamera3D's scripts write them, and the lists of its repository: docs/datasets/dcm.md.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np

from dancedata.core.bodies import SMPLX22
from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import DataError
from dancedata.core.fitting import fitted
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import DATASETS
from dancedata.core.typing import override
from dancedata.datasets.checks import DOWNLOAD_AGAIN, read_frames, require_upright
from dancedata.datasets.files import MAX_LIST_BYTES
from dancedata.datasets.published import Layout, Listing, PairedDataset
from dancedata.files.strict_json import read_json
from dancedata.formats.values import ValueArrays

RATE, BONES = 30, 60
#: Metres in a unit of MikuMikuDance.
UNIT_M = 0.08
#: A minute has about 35 MB.
MAX_BYTES = 1 << 29
#: Bone of the files of each joint of SMPL: lower body, chest, neck, head, legs, shoulders, arms, elbows, wrists.
_BONES = {
    "pelvis": 0, "spine2": 2, "neck": 3, "head": 4, "left_hip": 8, "left_knee": 9, "left_ankle": 10, "left_foot": 11,
    "right_hip": 12, "right_knee": 13, "right_ankle": 14, "right_foot": 15, "left_collar": 17, "left_shoulder": 18,
    "left_elbow": 19, "left_wrist": 20, "right_collar": 39, "right_shoulder": 40, "right_elbow": 41,
    "right_wrist": 42,
}  # fmt: skip
#: Upper and lower body begin at one place: these joints of SMPL are put half way.
_BETWEEN = {"spine1": ("pelvis", "spine2"), "spine3": ("spine2", "neck")}


@DATASETS.register("dcm")
@dataclass(frozen=True)
class DCM(PairedDataset):
    """DCM, from the pieces that DanceCamera3D's scripts cut, and its lists.

    Attributes
    ----------
    split
        ``official``: train.json, validation.json and test.json, which share sequences. ``by-sequence``: a tenth of
        the sequences each is val and test, by a hash of their names; also for sequences that are not cut.
    """

    split: Literal["official", "by-sequence"] = field(default="official", metadata={"scan": True})

    licence: ClassVar[str] = (
        "DCM's EULA: academic use only. Dances, cameras and music are of their creators: no redistribution."
    )
    citation: ClassVar[str] = (
        "Wang et al., DanceCamera3D: 3D Camera Movement Synthesis with Music and Dance, CVPR 2024."
    )

    layout: ClassVar[Layout] = Layout(
        "dcm", "DCM", "Simplified_MotionGlobalTransform", ".json", "m4_0_gt.json", stem="m{}_gt", music="a{}",
        name_problem=lambda name: "" if name.replace("_", "").isascii() and name.replace("_", "").isdigit()
        else "not named m<sequence>_<piece>_gt",
        folder_names=("aligned_data_split",), published="108 sequences were published",
    )  # fmt: skip
    music_folders: ClassVar[tuple[str, ...]] = ("Audio",)
    unit: ClassVar[str] = "sequence"
    official: ClassVar[Mapping[str, str]] = {"train": "train.json", "val": "validation.json", "test": "test.json"}
    below: ClassVar[tuple[str, ...]] = ("split", "")
    get_lists: ClassVar[str] = "copy DCM_data/split of DanceCamera3D's repository into the source"

    @override
    def song_of(self, name: str) -> str:
        return name.split("_")[0]

    @override
    def listed_name(self, line: str) -> str:
        return line.partition("_")[2]

    @override
    def all_clips(self, refs: Sequence[ClipRef], listing: Listing, left_out: list[Reject]) -> list[ClipRef]:
        """Return the clips with the language of the song as their genre."""
        files = [place / "split" / "music_categories.json" for place in listing.folders.places]
        table: dict[str, list[int]] = next((read_json(path, MAX_LIST_BYTES) for path in files if path.is_file()), {})
        language = {str(sequence): name for name, sequences in table.items() for sequence in sequences}
        return super().all_clips([replace(ref, genre=language.get(ref.music, "")) for ref in refs], listing, left_out)

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Fit rotations of SMPLX22 to the places of the joints: 30 FPS, metres, +Y up, on the bones of the file.

        DataError: ``broken_file``, ``bad_shape``, ``empty``, ``nan``, ``bad_axes`` (not upright).
        """
        path = ref.motion_path
        try:
            frames = [frame["Transform"] for frame in read_json(path, MAX_BYTES)["BoneKeyFrameTransformRecord"]]
            arrays = ValueArrays(path, {"Transform": np.array(frames, dtype=np.float64)})
        except (OSError, ValueError, TypeError, KeyError, OverflowError) as error:
            raise DataError("the motion file cannot be read", reason="broken_file", where=str(path), found=str(error),
                            allowed='{"BoneKeyFrameTransformRecord": [{"Transform": [...]}, ...]}',
                            fix=DOWNLOAD_AGAIN) from error  # fmt: skip
        (matrices,) = read_frames(arrays, {"Transform": [(BONES * 16,)]})
        bones = UNIT_M * matrices.reshape(-1, BONES, 16)[:, :, 12:15]
        places = {joint: bones[:, bone] for joint, bone in _BONES.items()}
        places |= {joint: (places[a] + places[b]) / 2 for joint, (a, b) in _BETWEEN.items()}
        motion = fitted(np.stack([places[joint] for joint in SMPLX22.joints], axis=1), SMPLX22, FrameGrid.of(RATE))
        require_upright(path, motion, "axes of the published files, which +Y is up in")
        return motion

    @override
    def make_example(self, folder: Path) -> None:
        """Write five pieces of six seconds, of four sequences, and the lists."""
        from dancedata.datasets._examples import dance, write_json, write_song

        lists: dict[str, list[str]] = {"train": [], "validation": [], "test": []}
        root = folder / "amc_aligned_data_split"
        for name, split, steps in (
            ("C_4_0", "train", "gBR_sBM_cAll_d04_mBR0_ch01"), ("C_4_1", "train", "gBR_sBM_cAll_d04_mBR0_ch02"),
            ("J_11", "train", "gPO_sBM_cAll_d10_mPO4_ch03"), ("K_10_2", "validation", "gHO_sBM_cAll_d19_mHO3_ch01"),
            ("E_1_0", "test", "gMH_sBM_cAll_d22_mMH1_ch04"),
        ):  # fmt: skip
            content = content_of(dance(steps, 181))
            write_json(root / self.layout.path_of(self.listed_name(name)), content)
            write_song(root / "Audio" / f"a{self.listed_name(name)}.wav", steps, 181 / RATE)
            lists[split].append(name)
        for split, names in lists.items():
            write_json(folder / "split" / f"{split}.json", names)
        languages = {"Chinese": [4], "Japanese": [11], "Korean": [10], "English": [1]}
        write_json(folder / "split" / "music_categories.json", languages)


def content_of(motion: Motion) -> dict[str, Any]:
    """Return a motion on SMPL's joints as a file of DCM has it; what SMPL lacks is at the pelvis."""
    joints = motion.joints() / UNIT_M
    matrices = np.tile(np.eye(4).ravel(), (motion.n_frames, BONES, 1))
    matrices[:, :, 12:15] = joints[:, :1]
    for joint, bone in _BONES.items():
        matrices[:, bone, 12:15] = joints[:, motion.skeleton.index(joint)]
    frames = [{"Transform": frame.ravel().tolist()} for frame in np.round(matrices, 4)]
    return {"BoneKeyFrameNumber": motion.n_frames, "BoneKeyFrameTransformRecord": frames}
