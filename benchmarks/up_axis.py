"""The up axis of folders: clips cut from dances, read as they are and with an axis that is wrong.

    python benchmarks/up_axis.py FOLDER

Cuts of 1.5 to 10 s of synthetic dances, and of AIST++'s under $DANCEDATA_SHARED, are written to FOLDER: upright ones,
and 33 with +Y up and the key of AMASS, whose axis is +Z, together and by length. Printed for each folder: clips,
those left out, those that are noted, and those that lie in the dataset without a note. Exit status 1 if an upright
clip is left out or noted, or one of the others is neither.
"""

from __future__ import annotations

import os
import pickle
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.quality import implausible_flags
from dancedata.core.sides import lies
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.folder import Folder
from dancedata.synthetic import synthesise_motion

RATE = 60
LENGTHS_S = {1.5: 3, 3: 3, 5: 3, 10: 3}  # seconds, and most cuts of each real dance that are read with a wrong axis
UPRIGHT = 400


def real() -> dict[str, Motion]:
    """Return the dances of AIST++ that are there."""
    dances = {}
    for path in sorted(Path(os.environ.get("DANCEDATA_SHARED", ".")).glob("realdata/aistpp/motions/*.pkl")):
        arrays = pickle.loads(path.read_bytes())  # noqa: S301 - the project's own files
        rotations = arrays["smpl_poses"].reshape(-1, 24, 3).astype(np.float64)
        dances[path.stem] = Motion(
            arrays["smpl_trans"] / arrays["smpl_scaling"], rotations, FrameGrid.of(RATE), SMPL24
        )
    return dances


def synthetic() -> dict[str, Motion]:
    """Return dances of all genres, 20 s each."""
    genres = ("BR", "PO", "LO", "MH", "LH", "HO", "WA", "KR", "JS", "JB")
    names = [f"g{genre}_sBM_cAll_d{d:02d}_m{genre}{d % 5}_ch0{1 + d % 9}" for genre in genres for d in range(3)]
    return {name: synthesise_motion(name, n_frames=20 * RATE)[0] for name in names}


def cuts(dances: dict[str, Motion], length_s: float, most: int) -> Iterator[tuple[str, Motion]]:
    """Yield cuts of a length, spread over each dance."""
    for name, dance in dances.items():
        frames, n = int(length_s * RATE), dance.n_frames
        starts = (
            sorted({int(s) for s in np.linspace(0, n - frames, min(most, max(n // frames, 1)))})
            if n >= frames
            else []
        )
        for start in starts:
            part = slice(start, start + frames)
            yield (
                f"{name}_{length_s:g}_{start}",
                Motion(dance.translation[part], dance.rotations[part], dance.grid, SMPL24),
            )


def written(folder: Path, parts: list[tuple[str, Motion]], *, amass: bool) -> Path:
    """Write SMPL's 72 columns, or SMPL-X's 165 with AMASS's rate, whose axis is +Z by definition."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name, motion in parts:
        poses = motion.rotations.reshape(motion.n_frames, -1)
        arrays = {"poses": poses, "trans": motion.translation, "fps": RATE}
        if amass:
            arrays = {"poses": np.pad(poses[:, :66], ((0, 0), (0, 99))), "trans": motion.translation}
            arrays["mocap_frame_rate"] = RATE
        np.savez(folder / f"{name}.npz", **arrays)
    return folder


def tried(folder: Path, reader: Folder) -> tuple[int, int, int, int]:
    """Return the number of clips, of those left out, of those that lie, and of these without a note."""
    scan = reader.scan(folder)
    motions = []
    for clip in scan.clips:
        try:
            motions.append(reader.load(clip))
        except DataError:
            continue
    flags = [{flag.kind for flag in implausible_flags(motion)} & {"lying", "implausible_up"} for motion in motions]
    lying = [lies(motion.joints()) for motion in motions]
    n = len(list(folder.iterdir()))
    silent = sum(down and not noted for down, noted in zip(lying, flags, strict=True))
    return n, n - len(motions), sum(bool(noted) for noted in flags), silent


def main() -> int:
    """Run all folders."""
    root, dances = Path(sys.argv[1]), real()
    every = {**dances, **synthetic()}
    upright = [cut for length in LENGTHS_S for cut in cuts(every, length, 6)][:UPRIGHT]
    n, out, noted, _ = tried(
        written(root / "upright", upright, amass=False), Folder(up="y", unit="m", music="optional")
    )
    print(f"upright: {n} clips, {out} left out, {noted} noted")
    wrong = bool(out or noted)
    parts = {length: list(cuts(dances, length, most)) for length, most in LENGTHS_S.items()}
    folders = {"all lengths": [cut for of_length in parts.values() for cut in of_length]}
    folders |= {f"{length:g} s": of_length for length, of_length in parts.items()}
    for what, clips in folders.items():
        if clips:
            folder = written(root / f"amass {what}", clips, amass=True)
            n, out, noted, silent = tried(folder, Folder(music="optional"))
            print(
                f"+Y with AMASS's key, {what}: {n} clips, {out} left out, {noted} noted, {silent} lie without a note"
            )
            wrong |= out + noted < n or silent > 0
    return int(wrong)


if __name__ == "__main__":
    sys.exit(main())
