"""Freezes a dataset of the version that is installed: python tests/frozen/freeze.py OUT.tar.xz

The source is noise from a seed, 0.4 s of motion and 0.6 s of music for one clip of each split.
"""

import hashlib
import io
import json
import pickle
import sys
import tarfile
import tempfile
import wave
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import dancedata

CLIPS = ("gBR_sBM_cAll_d04_mBR2_ch03", "gJS_sBM_cAll_d01_mJS3_ch01", "gJB_sBM_cAll_d07_mJB5_ch02")
FRAMES, SAMPLES, RATE = 24, 13_230, 22_050


def write_source(root: Path) -> None:
    """Write motions/*.pkl and wavs/*.wav."""
    rng = np.random.default_rng(27)
    for folder in ("motions", "wavs"):
        (root / folder).mkdir(parents=True)
    for name in CLIPS:
        motion = {
            "smpl_poses": np.cumsum(rng.normal(0, 0.02, (FRAMES, 72)), axis=0).astype(np.float32),
            "smpl_trans": np.add((0, 90, 0), np.cumsum(rng.normal(0, 0.3, (FRAMES, 3)), axis=0)).astype(np.float32),
            "smpl_scaling": np.array([93.75], np.float32),
        }
        (root / "motions" / f"{name}.pkl").write_bytes(pickle.dumps(motion))
        t = np.arange(SAMPLES) / RATE
        song = 0.3 * np.sin(2 * np.pi * rng.uniform(200, 500) * t) * (np.sin(2 * np.pi * 2 * t) > 0)
        song += rng.normal(0, 0.01, SAMPLES)
        with wave.open(str(root / "wavs" / f"{name.split('_')[4]}.wav"), "wb") as file:
            file.setnchannels(1)
            file.setsampwidth(2)
            file.setframerate(RATE)
            file.writeframes((song * 32767).astype("<i2").tobytes())


def read(folder: Path) -> dict[str, Any]:
    """Return what is read from a dataset; only names that every version has are used."""
    ds = dancedata.open(folder)
    digest, windows = hashlib.sha256(), {}
    fourth: dict[str, list[float]] = {}
    for split in ("train", "val", "test"):
        if split not in {clip.split for clip in ds.clips}:
            continue
        windows[split] = len(ds.windows(split))
        for window in ds.windows(split):
            for field in sorted(ds.fields):
                rows = ds.read(window, field)
                digest.update(f"{window.clip} {window.start} {window.length} {field}".encode() + rows.tobytes())
                fourth.setdefault(field, [float(value) for value in rows[3, :4]])
    answer: dict[str, Any] = {
        "format": ds.meta["format"],
        "windows": windows,
        "rows": digest.hexdigest(),
        "fourth_row": fourth,
        "clips": [[c.id, c.split, int(c.n_frames), c.genre, c.music, c.dancer] for c in ds.clips],
    }
    if find_spec("torch"):
        answer["normalized"] = normalized(folder, next(name for name in sorted(ds.fields) if name != "librosa35"))
    if folder.name == "groups":
        answer["groups"] = [[clip.id, clip.group, clip.member, clip.role] for clip in ds.clips]
        answer["segments"] = [
            [s.layer.name, str(s.start), str(s.end), s.label, list(s.texts), list(s.texts_mirrored)]
            for s in ds.segments(ds.clips[0].id)
        ]
    return answer


def normalized(folder: Path, field: str) -> list[float]:
    """Return numbers of a normalised window, as a trainer reads it."""
    from dancedata.readers import WindowDataset

    sample = WindowDataset(folder, split="train", fields=(field,), normalize=True)[1][field]
    return [round(float(value), 6) for value in np.asarray(sample)[2, :8]]


def main(out: Path) -> None:
    """Build, read and pack; equal code gives equal bytes."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        write_source(root / "source")
        windows = {"windows.length_s": 0.2, "windows.stride_s": 0.2}
        dancedata.build(
            "aist++", root / "source", root / "track", overrides=windows, cache=root / "cache", progress=False
        )
        files = {f"track/{path.name}": path.read_bytes() for path in sorted((root / "track").iterdir())}
        files["read.json"] = json.dumps({"track": read(root / "track")}, indent=1).encode()
    with tarfile.open(out, "x:xz", preset=9) as archive:
        for name, data in sorted(files.items()):
            entry = tarfile.TarInfo(name)
            entry.size = len(data)
            archive.addfile(entry, io.BytesIO(data))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
