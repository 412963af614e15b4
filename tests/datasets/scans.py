"""Names of the tiny AIST++ copy, and what a scan says."""

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

from dancedata.core.clip import ClipRef, Scan
from dancedata.core.motion import Motion

TRAIN = "gBR_sBM_cAll_d04_mBR2_ch08"
VAL = "gJS_sBM_cAll_d03_mJS3_ch01"
TEST = "gJS_sBM_cAll_d03_mJS3_ch02"
UNASSIGNED = "gBR_sBM_cAll_d04_mBR2_ch01"
IGNORED = "gJB_sBM_cAll_d07_mJB2_ch06"


def splits(scan: Scan) -> dict[str, str]:
    return {clip.id: clip.split for clip in scan.clips}


def rejects(scan: Scan, reason: str) -> list[str]:
    return sorted(r.clip or r.file for r in scan.rejects if r.reason == reason)


def notes(scan: Scan) -> str:
    return "\n".join(scan.notes)


def change_pickle(path: Path, **changes: Any) -> None:
    """Replace values of a pickle; None removes a key."""
    content = {**pickle.loads(path.read_bytes()), **changes}
    path.write_bytes(pickle.dumps({key: value for key, value in content.items() if value is not None}))


def replaced(key: str, change: Callable[[Any], Any]) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda content: {**content, key: change(content[key])}


def load(reader: Any, path: Path, clip: str = TRAIN) -> Motion:
    """Load one motion file."""
    motion: Motion = reader.load(ClipRef(clip, path, None, "train"))
    return motion
