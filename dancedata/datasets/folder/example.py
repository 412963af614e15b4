"""A tiny source in the layout of `folder`, made of synthetic motion and music; no captured data."""

from pathlib import Path

import numpy as np

from dancedata.core.bodies import SMPLH52
from dancedata.core.motion import Motion
from dancedata.core.rotations import rotation
from dancedata.core.skeleton import SMPL24
from dancedata.datasets._examples import dance, write_song
from dancedata.files import atomic
from dancedata.formats.bvh.write import write_bvh
from dancedata.formats.stated import UPRIGHT

#: Mixamo's names for SMPL's joints.
MIXAMO_NAMES = (
    "Hips LeftUpLeg RightUpLeg Spine LeftLeg RightLeg Spine1 LeftFoot RightFoot Spine2 LeftToeBase RightToeBase Neck "
    "LeftShoulder RightShoulder Head LeftArm RightArm LeftForeArm RightForeArm LeftHand RightHand "
    "LeftHandMiddle1 RightHandMiddle1"
)
_N_FRAMES = 360
_MANIFEST = """motion,audio,split,genre,dancer,tempo_bpm,fps,up,unit
motions/amass_poses.npz,music/slow.wav,train,break,anna,80,,,
motions/own.bvh,music/slow.wav,train,break,anna,80,,,cm
motions/smpl.npz,music/fast.wav,test,house,ben,125,60,y,m
"""


def write_folder(folder: Path) -> None:
    """Write three clips of six seconds at 60 FPS."""
    (folder / "motions").mkdir(parents=True, exist_ok=True)
    clips = ("gBR_sBM_cAll_d04_mBR0_ch01", "gBR_sBM_cAll_d04_mBR0_ch02", "gHO_sBM_cAll_d19_mHO3_ch01")
    first, second, third = (dance(clip, _N_FRAMES, 60) for clip in clips)
    _write_amass(folder / "motions" / "amass_poses.npz", first)
    # In centimetres with Mixamo's names.
    pelvis = (second.translation + SMPL24.offsets[0]) * 100
    offsets = np.array(SMPL24.offsets) * 100
    offsets[0] = 0.0
    names, period = MIXAMO_NAMES.split(), f"{1 / 60:.6f}"
    write_bvh(folder / "motions" / "own.bvh", names, SMPL24.parents, offsets, second.matrices, pelvis, period)
    np.savez(folder / "motions" / "smpl.npz", poses=third.rotations.reshape(_N_FRAMES, 72), trans=third.translation)
    for file, music in (("slow.wav", "mBR0"), ("fast.wav", "mHO3")):
        write_song(folder / "music" / file, music, _N_FRAMES / 60 + 0.5, 48_000, n_channels=2)
    atomic.write_text(folder / "manifest.csv", _MANIFEST)


def _write_amass(path: Path, motion: Motion) -> None:
    """Write SMPL-H in AMASS's axes, +Z up; the hands do not move."""
    from scipy.spatial.transform import Rotation

    to_z_up = UPRIGHT["z"].T
    root = SMPLH52.offsets[0]
    poses = np.zeros((motion.n_frames, 52, 3))
    poses[:, :22] = motion.rotations[:, :22]
    poses[:, 0] = (Rotation.from_matrix(to_z_up) * rotation(motion.rotations[:, 0])).as_rotvec()
    np.savez(
        path,
        poses=poses.reshape(motion.n_frames, 156),
        trans=(motion.translation + root) @ to_z_up.T - root,
        betas=np.zeros(16),
        gender=np.array("neutral"),
        mocap_framerate=np.array(60.0),
    )
