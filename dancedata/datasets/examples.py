"""Tiny sources in the layouts of FineDance and `folder`, made of synthetic motion and music; no captured data."""

import json
from pathlib import Path

import numpy as np

from dancedata.core.audio_signal import wav_bytes
from dancedata.core.bodies import SMPLH52, SMPLX52, SMPLX55, on_body
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.rotations import rotation, rotation_6d
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.finedance.layout import LABELS, MOTION, MUSIC
from dancedata.files import atomic
from dancedata.formats.bvh.write import write_bvh
from dancedata.formats.stated import UPRIGHT
from dancedata.synthetic import synthesise_motion, synthesise_song

_RATE = 30
_SAMPLE_RATE = 24_000
_TOE_HEIGHT_M = 0.02

# Id, frames, style1, style2, and the synthetic clip that provides steps and song. 010 has a beginning to trim
# (three frames), 063 is a test clip of both releases' cross-genre split.
_CLIPS = (
    ("001", 181, "Street", "Popping", "gPO_sBM_cAll_d10_mPO4_ch03"),
    ("010", 186, "Street", "Breaking", "gBR_sFM_cAll_d04_mBR4_ch01"),
    ("063", 180, "Modern", "Hiphop", "gMH_sBM_cAll_d22_mMH1_ch04"),
    ("150", 182, "Modern", "jazz", "gJS_sFM_cAll_d01_mJS1_ch02"),
)


def write_finedance(folder: Path) -> None:
    """Write four clips of six seconds: ``motion/``, ``music_wav/`` and ``label_json/``."""
    for name in (MOTION, MUSIC, LABELS):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for clip, n_frames, coarse, fine, steps in _CLIPS:
        motion = _with_hands(steps, n_frames)
        # FineDance's array (T, 315): translation, then 52 joints x 6D.
        rows = rotation_6d(on_body(motion, SMPLX52).matrices).reshape(n_frames, -1)
        columns = np.concatenate([motion.translation, rows], axis=1)
        np.save(folder / MOTION / f"{clip}.npy", columns.astype(np.float32))
        length = n_frames / _RATE
        song = synthesise_song(steps.split("_")[4], length_s=length, sample_rate=_SAMPLE_RATE, n_channels=1)
        (folder / MUSIC / f"{clip}.wav").write_bytes(wav_bytes(song.pcm, _SAMPLE_RATE))
        label = {"name": f"synthetic {clip}", "style1": coarse, "style2": fine}
        (folder / LABELS / f"{clip}.json").write_text(json.dumps(label), encoding="utf-8", newline="\n")


def _with_hands(steps: str, n_frames: int) -> Motion:
    """Return a dance on SMPL-X's joints, feet on the floor (y = 0), fingers opening and closing."""
    dance, _ = synthesise_motion(steps, n_frames=2 * n_frames - 1)
    motion = on_body(dance.resampled(FrameGrid.of(_RATE)), SMPLX55, keep="translation")
    rotations = motion.rotations.copy()
    curl = 0.35 - 0.25 * np.cos(2 * np.pi * np.arange(n_frames) / _RATE)
    # About z, towards the palms, which face the floor at rest.
    rotations[:, 25:40, 2] = -curl[:, None]
    rotations[:, 40:55, 2] = curl[:, None]
    feet = motion.joints()[:, list(SMPLX55.feet), 1]
    translation = motion.translation - (0.0, feet.min() - _TOE_HEIGHT_M, 0.0)
    return Motion(translation, rotations, motion.grid, SMPLX55)


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
    (folder / "music").mkdir(exist_ok=True)
    clips = ("gBR_sBM_cAll_d04_mBR0_ch01", "gBR_sBM_cAll_d04_mBR0_ch02", "gHO_sBM_cAll_d19_mHO3_ch01")
    first, second, third = (synthesise_motion(clip, n_frames=_N_FRAMES)[0] for clip in clips)
    _write_amass(folder / "motions" / "amass_poses.npz", first)
    # In centimetres with Mixamo's names.
    pelvis = (second.translation + SMPL24.offsets[0]) * 100
    offsets = np.array(SMPL24.offsets) * 100
    offsets[0] = 0.0
    names, period = MIXAMO_NAMES.split(), f"{1 / 60:.6f}"
    write_bvh(folder / "motions" / "own.bvh", names, SMPL24.parents, offsets, second.matrices, pelvis, period)
    np.savez(folder / "motions" / "smpl.npz", poses=third.rotations.reshape(_N_FRAMES, 72), trans=third.translation)
    for file, music in (("slow.wav", "mBR0"), ("fast.wav", "mHO3")):
        song = synthesise_song(music, length_s=_N_FRAMES / 60 + 0.5)
        (folder / "music" / file).write_bytes(wav_bytes(song.pcm, song.signal.sample_rate))
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
