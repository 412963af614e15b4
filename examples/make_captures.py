"""Captures as a studio leaves them, to try the tutorials on.

    python examples/make_captures.py captures

Synthetic dances in three kinds of files: BVH with Mixamo's names in centimetres, AMASS's npz with +Z up, and a result
of WHAM; songs with other names than the takes, of which one begins before its dance. captures/README.txt says what
is what, for comparison with what dancedata finds.
"""

import argparse
from pathlib import Path

import joblib
import numpy as np
from scipy.spatial.transform import Rotation

from dancedata.core.audio_signal import wav_bytes
from dancedata.core.ground import grounded
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.folder.example import MIXAMO_NAMES
from dancedata.formats.bvh.write import write_bvh
from dancedata.synthetic import synthesise_motion, synthesise_song

#: File of a take, synthetic dance that it is, and its song. Songs of one letter are those of one file.
TAKES = (
    ("mocap/anna_blue_1.bvh", "gBR_sBM_cAll_d04_mBR0_ch01", "blue"),
    ("mocap/anna_blue_2.bvh", "gBR_sBM_cAll_d04_mBR0_ch02", "blue"),
    ("mocap/ben_green_1.bvh", "gKR_sBM_cAll_d28_mKR5_ch03", "green"),
    ("amass/anna_red_1_poses.npz", "gHO_sFM_cAll_d19_mHO3_ch01", "red"),
    ("amass/anna_red_2_poses.npz", "gHO_sBM_cAll_d19_mHO3_ch02", "red"),
    ("amass/ben_white_1_poses.npz", "gLO_sBM_cAll_d13_mLO2_ch01", "white"),
    ("amass/ben_white_2_poses.npz", "gLO_sBM_cAll_d13_mLO2_ch02", "white"),
    ("video/carla_pink.pkl", "gPO_sBM_cAll_d10_mPO4_ch03", "pink"),
)
#: File of each song, the synthetic song, and the seconds of silence before it: the dance begins after them.
SONGS = {
    "blue": ("songs/blue.wav", "mBR0", 0.0),
    "green": ("songs/Green (final mix).wav", "mKR5", 0.0),
    "red": ("songs/red_master.wav", "mHO3", 0.0),
    "white": ("songs/03 White.wav", "mLO2", 0.2),
    "pink": ("songs/carla_pink.wav", "mPO4", 0.0),
}
SECONDS = 13.5


def write_take(path: Path, motion: Motion) -> None:
    """Write a motion at 60 frames per second as its ending says."""
    path.parent.mkdir(parents=True, exist_ok=True)
    motion = grounded(motion)
    n, pelvis = motion.n_frames, motion.translation + SMPL24.offsets[0]
    if path.suffix == ".bvh":
        offsets = 100 * np.array(SMPL24.offsets)
        offsets[0] = 0
        period = f"{1 / 60:.7f}"
        write_bvh(path, MIXAMO_NAMES.split(), SMPL24.parents, offsets, motion.matrices, 100 * pelvis, period)
    elif path.suffix == ".npz":
        z_up = Rotation.from_euler("x", 90, degrees=True)
        poses = np.zeros((n, 52, 3))
        poses[:, :22] = motion.rotations[:, :22]
        poses[:, 0] = (z_up * Rotation.from_rotvec(np.array(motion.rotations[:, 0]))).as_rotvec()
        trans = z_up.apply(pelvis) - SMPL24.offsets[0]
        facts = {"betas": np.zeros(16), "gender": np.array("neutral"), "mocap_framerate": np.array(60.0)}
        np.savez(path, poses=poses.reshape(n, 156), trans=trans, **facts)
    else:
        pose = motion.rotations[::2].reshape(-1, 72).astype(np.float32)  # of a video at 30
        person = {"pose_world": pose, "trans_world": motion.translation[::2].astype(np.float32)}
        joblib.dump({0: {**person, "frame_ids": np.arange(len(pose))}}, path)


def main() -> None:
    """Write the folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    (folder / "songs").mkdir(parents=True)
    for file, music, silence in SONGS.values():
        song = synthesise_song(music, length_s=SECONDS + 0.5)
        rate = song.signal.sample_rate
        (folder / file).write_bytes(wav_bytes(np.pad(song.pcm, ((round(silence * rate), 0), (0, 0))), rate))
    for file, dance, _ in TAKES:
        write_take(folder / file, synthesise_motion(dance, n_frames=round(60 * SECONDS))[0])
    lines = [f"{file}: {SONGS[song][0]}, from second {SONGS[song][2]:g}" for file, _, song in TAKES]
    (folder / "README.txt").write_text("\n".join(["Take: song.", *lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
