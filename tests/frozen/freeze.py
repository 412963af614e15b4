"""Freezes a dataset of the version that is installed: python tests/frozen/freeze.py OUT.tar.xz

Two groups of two dancers, noise from a seed, with words.
"""

import hashlib
import io
import json
import sys
import tarfile
import tempfile
from dataclasses import replace
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import dancedata
from dancedata.core.segments import Layer, Segment
from dancedata.store import write_store
from tests.groups_store import HEADER, stored

WORDS = Layer("words", language="en", sided="mirrored")
SEGMENTS = (
    Segment(WORDS, Fraction(0), Fraction(1, 3), "a", ("one", "left"), ("one", "right")),
    Segment(WORDS, Fraction(1, 3), Fraction(1, 2), "b", ("same",), ("same",)),
)


def read(folder: Path) -> dict[str, Any]:
    """Return what is read from a dataset; only names that every version has are used."""
    ds = dancedata.open(folder)
    digest, fourth = hashlib.sha256(), dict[str, list[float]]()
    windows = {split: len(ds.windows(split)) for split in ("train", "test")}
    for split in windows:
        for window in ds.windows(split):
            for field in sorted(ds.fields):
                rows = ds.read(window, field)
                digest.update(f"{window.clip} {window.start} {window.length} {field}".encode() + rows.tobytes())
                fourth.setdefault(field, [float(value) for value in rows[3, :4]])
    answer: dict[str, Any] = {
        "format": ds.info["format"],
        "windows": windows,
        "rows": digest.hexdigest(),
        "fourth_row": fourth,
        "clips": [[c.id, c.split, int(c.n_frames), c.genre, c.music, c.dancer] for c in ds],
    }
    if find_spec("torch"):
        from dancedata.torch import WindowDataset

        sample = WindowDataset(folder, fields=(min(ds.fields),), split="train")[1]  # as a trainer reads it
        answer["normalized"] = [round(float(value), 6) for value in np.asarray(sample[min(ds.fields)])[2, :8]]
    answer["groups"] = [[clip.id, clip.group, clip.member, clip.role] for clip in ds]
    answer["segments"] = [
        [s.layer.name, str(s.start), str(s.end), s.label, list(s.texts), list(s.texts_mirrored)]
        for s in ds.segments(ds.clips()[0].id)
    ]
    return answer


def main(out: Path) -> None:
    """Write, read and pack; equal code gives equal bytes."""
    clips = [replace(c, segments=SEGMENTS) for c in stored({"train": (2,), "test": (2,)}, length=6) if c.group]
    for clip in clips:
        del clip.motion["edge151"]
    header = replace(HEADER, length=6, stride=3, fields=HEADER.fields[1:])
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        (root / "groups").mkdir()
        write_store(root / "groups", header, clips)
        files = {f"groups/{path.name}": path.read_bytes() for path in sorted((root / "groups").iterdir())}
        files["read.json"] = json.dumps({"groups": read(root / "groups")}, indent=1).encode()
    with tarfile.open(out, "x:xz", preset=9) as archive:
        for name, data in sorted(files.items()):
            entry = tarfile.TarInfo(name)
            entry.size = len(data)
            archive.addfile(entry, io.BytesIO(data))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
