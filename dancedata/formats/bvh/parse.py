"""Parser of BVH files (Biovision hierarchy) with any skeleton; errors name the line.

Lengths are in the file's unit, angles in degrees. Time and memory are linear in the file's size; nothing is allocated
by the numbers in a header.
"""

import math
import os
import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dancedata.core.errors import DataError
from dancedata.core.rest import POINT
from dancedata.files.regular_file import open_regular
from dancedata.formats.bvh.hierarchy import MAX_VALUE, NUMBER, BvhJoint, bvh_error, not_a_number, parse_hierarchy

#: About an hour of 60 joints at 120 FPS.
MAX_FILE_BYTES = 1 << 30
#: The hierarchy must end within this many bytes.
MAX_HEADER_BYTES = 1 << 22


Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Bvh:
    """A parsed file.

    `values`: (T, C) channels as in the file; its first frame at most if only the header was read.
    """

    path: Path
    joints: tuple[BvhJoint, ...]
    n_frames: int
    frame_time: str
    values: Floats = field(repr=False)

    @property
    def n_channels(self) -> int:
        """Number of columns C."""
        return sum(len(joint.channels) for joint in self.joints)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(joint.name for joint in self.joints)

    @cached_property
    def placed(self) -> frozenset[int]:
        """The joints below the root whose position channels, unless they are always 0, replace their OFFSET."""
        columns = {k: list(joint.position_columns.values()) for k, joint in enumerate(self.joints) if k}
        reach = {k: float(np.abs(self.values[:, c]).max(initial=0.0)) for k, c in columns.items() if c}
        largest = max([0.0, *reach.values(), *(math.hypot(*joint.offset) for joint in self.joints[1:])])
        return frozenset(k for k, value in reach.items() if value > POINT * largest)


def read_bvh(path: Path) -> Bvh:
    """Read a complete file; DataError with the line."""
    lines = _lines(path, _read(path, MAX_FILE_BYTES))
    header, first = _header(path, lines)
    rows = [(k + 1, line) for k, line in enumerate(lines[first:], start=first) if line.strip()]
    _check_rows(header, rows)
    return Bvh(path, header.joints, header.n_frames, header.frame_time, _values(header, rows))


def read_bvh_header(path: Path) -> Bvh:
    """Read hierarchy, frames, frame time and the first frame: (1, C), or (0, C) if it cannot be read. DataError."""
    lines = _lines(path, _read(path, MAX_FILE_BYTES, MAX_HEADER_BYTES))
    header, first = _header(path, lines)
    row = next(((k + 1, line) for k, line in enumerate(lines[first:], start=first) if line.strip()), None)
    if row is None or len(row[1].split()) != header.n_channels:
        return header
    try:
        return replace(header, values=_values(header, [row]))
    except DataError:
        return header


def _read(path: Path, limit: int, part: int = -1) -> bytes:
    try:
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size
            if size <= limit:
                return file.read(part)
    except OSError as error:
        raise DataError(
            "the BVH file cannot be read", reason="broken_file", where=str(path), found=error.strerror or str(error)
        ) from error
    raise DataError("the BVH file is too large", reason="broken_file", where=str(path), found=f"{size:,} bytes",
                    allowed=f"a file of at most {limit:,} bytes", fix="split it into several files")  # fmt: skip


def _lines(path: Path, data: bytes) -> list[bytes]:
    lines = data.removeprefix(b"\xef\xbb\xbf").splitlines()
    first = next((line.strip() for line in lines if line.strip()), b"")
    if first.split(b"{")[0].strip().upper() != b"HIERARCHY":
        shown = first[:40].decode("utf-8", "replace")
        raise bvh_error(
            path, 1, "not a BVH file: unexpected first line", repr(shown) if shown else "nothing", "HIERARCHY"
        )
    return lines


def _check_rows(header: Bvh, rows: Sequence[tuple[int, bytes]]) -> None:
    path, announced, width = header.path, header.n_frames, header.n_channels
    for line, row in rows:
        n = len(row.split())
        if n != width:
            found = f"a frame of {n} numbers"
            last = line == rows[-1][0] and n < width
            raise bvh_error(path, line,
                            "a frame is truncated" if last else "a frame has the wrong number of channels", found,
                            f"{width}, one for each channel of the hierarchy",
                            reason="truncated" if last else "broken_file")  # fmt: skip
    if len(rows) != announced:
        short = len(rows) < announced
        raise bvh_error(
            path,
            rows[-1][0] if rows else 1,
            "the file ends before its last frame" if short else "the file has more frames than it announces",
            f"{len(rows):,} frames",
            f"{announced:,}, as in Frames:",
            reason="truncated" if short else "length_mismatch",
            fix="copy or export the file again" if short else "correct Frames:, or export the file again",
        )


def _values(header: Bvh, rows: Sequence[tuple[int, bytes]]) -> Floats:
    """Parse the numbers of all frames, (T, C)."""
    shape = len(rows), header.n_channels
    try:
        with warnings.catch_warnings():
            # numpy only warns where it stops at something other than a number.
            warnings.simplefilter("error")
            values = np.fromstring(b" ".join(row for _, row in rows), dtype=np.float64, sep=" ").reshape(shape)
    except (DeprecationWarning, ValueError) as error:
        for line, row in rows:
            bad = next((word for word in row.split() if not NUMBER.fullmatch(word)), None)
            if bad is not None:
                raise not_a_number(header.path, line, bad) from error
        raise bvh_error(header.path, rows[0][0], "the frames cannot be read", str(error)) from error
    usable = np.isfinite(values) & (np.abs(values) <= MAX_VALUE)
    if not usable.all():
        frame, column = (int(k) for k in np.argwhere(~usable)[0])
        joint = next(j for j in header.joints if j.first <= column < j.first + len(j.channels))
        raise bvh_error(header.path, rows[frame][0],
                        f"{joint.name} {joint.channels[column - joint.first]} of frame {frame} is out of range",
                        repr(float(values[frame, column])), f"finite numbers within +-{MAX_VALUE:g}",
                        reason="out_of_range" if np.isfinite(values[frame, column]) else "nan")  # fmt: skip
    return values


def _header(path: Path, lines: Sequence[bytes]) -> tuple[Bvh, int]:
    """Parse up to the frame time; also return the index of the line after it."""
    joints, line = parse_hierarchy(path, lines)
    width = sum(len(joint.channels) for joint in joints)
    n_frames = 0
    for index in range(line, len(lines)):
        text = lines[index][:200].decode("utf-8", "replace").strip()
        if text:
            key, _, value = text.partition(":")
            if "".join(key.split()).lower() == "frames" and not n_frames:
                n_frames = _whole(path, index + 1, value.strip())
            elif "".join(key.split()).lower() == "frametime" and n_frames:
                frame_time = _seconds(path, index + 1, value.strip())
                return Bvh(path, joints, n_frames, frame_time, np.empty((0, width))), index + 1
            else:
                raise bvh_error(path, index + 1, "unexpected line after MOTION", repr(text[:40]),
                                "Frames: N, then Frame Time: seconds")  # fmt: skip
    raise bvh_error(path, max(len(lines), 1), "the file ends before its Frame Time", reason="truncated")


def _whole(path: Path, line: int, text: str) -> int:
    if not re.fullmatch(r"\d{1,12}", text):
        raise bvh_error(path, line, "Frames is not an integer", repr(text[:40]), "for example Frames: 300")
    if int(text) == 0:
        raise bvh_error(path, line, "the file has no frames", "Frames: 0", "at least one frame", reason="empty")
    return int(text)


def _seconds(path: Path, line: int, text: str) -> str:
    # Short enough that no exponent can describe a number of a million digits.
    valid = len(text) <= 40 and re.fullmatch(r"\+?(\d+\.?\d*|\.\d+)([eE][+-]?\d{1,2})?", text)
    if not valid or not 0 < float(text) < math.inf:
        raise bvh_error(path, line, "invalid frame time", repr(text[:40]),
                        "seconds above 0, such as 0.0333333 for 30 FPS", reason="bad_rate",
                        fix="correct Frame Time:, or export the file again")  # fmt: skip
    return text
