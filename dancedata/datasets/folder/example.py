"""A tiny source folder for the dataset `folder`: synthetic motion in three formats, two songs, a manifest."""

import wave
from pathlib import Path

import numpy as np

from dancedata.core.motion import Motion
from dancedata.core.rotations import rotation
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.folder.facts import UPRIGHT
from dancedata.files import atomic
from dancedata.formats.body_model import SMPLH52
from dancedata.formats.bvh.write import write_bvh

#: Mixamo's names for SMPL's joints.
_NAMES = (
    "Hips LeftUpLeg RightUpLeg Spine LeftLeg RightLeg Spine1 LeftFoot RightFoot Spine2 LeftToeBase RightToeBase Neck "
    "LeftShoulder RightShoulder Head LeftArm RightArm LeftForeArm RightForeArm LeftHand RightHand "
    "LeftHandMiddle1 RightHandMiddle1"
)
_FRAMES = 360
_MANIFEST = """motion,audio,split,genre,dancer,tempo_bpm,fps,up,unit
motions/amass_poses.npz,music/slow.wav,train,break,anna,80,,,
motions/own.bvh,music/slow.wav,train,break,anna,80,,,cm
motions/smpl.npz,music/fast.wav,test,house,ben,125,60,y,m
"""


def write_example(folder: Path) -> None:
    """Write three clips of six seconds at 60 FPS."""
    from dancedata.synthetic import synthesise_motion, synthesise_song

    (folder / "motions").mkdir(parents=True, exist_ok=True)
    (folder / "music").mkdir(exist_ok=True)
    names = ("gBR_sBM_cAll_d04_mBR0_ch01", "gBR_sBM_cAll_d04_mBR0_ch02", "gHO_sBM_cAll_d19_mHO3_ch01")
    first, second, third = (synthesise_motion(name, n_frames=_FRAMES)[0] for name in names)
    _write_amass(folder / "motions" / "amass_poses.npz", first)
    _write_bvh(folder / "motions" / "own.bvh", second)
    np.savez(folder / "motions" / "smpl.npz", poses=third.rotations.reshape(_FRAMES, 72), trans=third.translation)
    for file, music in (("slow.wav", "mBR0"), ("fast.wav", "mHO3")):
        song = synthesise_song(music, length_s=_FRAMES / 60 + 0.5)
        with wave.open(str(folder / "music" / file), "wb") as out:
            out.setnchannels(song.pcm.shape[1])
            out.setsampwidth(2)
            out.setframerate(song.signal.sample_rate)
            out.writeframes(song.pcm.astype("<i2").tobytes())
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


def _write_bvh(path: Path, motion: Motion) -> None:
    """Write a BVH in centimetres with Mixamo's names."""
    pelvis = (motion.translation + SMPL24.offsets[0]) * 100
    offsets = np.array(SMPL24.offsets) * 100
    offsets[0] = 0.0
    write_bvh(path, _NAMES.split(), SMPL24.parents, offsets, motion.matrices, pelvis, f"{1 / 60:.6f}")
