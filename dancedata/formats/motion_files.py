"""A motion as the bytes of one file, by the name of the format."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping

import numpy as np

from dancedata.core.motion import Motion
from dancedata.formats.bvh.write import motion_bvh
from dancedata.formats.smpl_files import Arrays, amass_arrays, plain_arrays, smplx_arrays

__all__ = ["MOTION_FILES", "motion_file"]


def _npz(arrays: Callable[[Motion], Arrays]) -> Callable[[Motion], bytes]:
    def data(motion: Motion) -> bytes:
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, **arrays(motion))
        return buffer.getvalue()

    return data


#: Name -> suffix and what makes the bytes. bvh: metres. smpl: AMASS's arrays on SMPL-H. smplx: on SMPL-X.
MOTION_FILES: Mapping[str, tuple[str, Callable[[Motion], bytes]]] = {
    "bvh": (".bvh", lambda motion: motion_bvh(motion).encode()),
    "npz": (".npz", _npz(plain_arrays)),
    "smpl": (".npz", _npz(amass_arrays)),
    "smplx": (".npz", _npz(smplx_arrays)),
}


def motion_file(motion: Motion, kind: str) -> bytes:
    """Return the bytes of a file of the format `kind`, one of `MOTION_FILES`."""
    return MOTION_FILES[kind][1](motion)
