"""AIOZ-GDANCE (Le et al. 2023): groups of 2 to 7 dancers from videos, 1,624 sequences, 30 FPS, +Y up.

The files: docs/datasets/aioz-gdance.md. VIDEO, the id of a YouTube video, may contain ``_``: names are split from the
right.
"""

import csv
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from dancedata.core.clip import ClipRef, Reject, member_id
from dancedata.core.errors import DataError, SourceError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.text import counted, listed, quoted
from dancedata.core.typing import override
from dancedata.datasets import checks
from dancedata.datasets.files import MAX_LIST_BYTES, SPLITS
from dancedata.datasets.published import Folders, Layout, Listing, PairedDataset
from dancedata.files.regular_file import read_regular
from dancedata.formats.arrays import ArrayFile
from dancedata.formats.values import open_arrays

RATE = 30
# Explicit ranges: \d would accept digits of other scripts.
_NAME = re.compile(r"([0-9A-Za-z_-]+)_([0-9]+)_([0-9]+)_([0-9]+)")
POSES, ORIENTS, TRANS = "smpl_poses", "smpl_orients", "root_trans"
JOINTS = 24
#: Columns of all joints, and of all but the root.
_ALL, _BODY = 3 * JOINTS, 3 * (JOINTS - 1)

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Sizes:
    """Numbers of one pickle: dancers, frames, and columns of `smpl_poses`."""

    dancers: int
    frames: int
    width: int
    has_orients: bool


def read_sizes(path: Path) -> Sizes:
    """Return the sizes of a sequence; DataError if it has neither form, or its arrays contradict each other."""
    with open_arrays(path) as arrays:
        return _sizes(arrays)


def load_dancers(path: Path, members: Sequence[int]) -> list[Motion]:
    """Read some dancers, numbered from 0: 30 FPS; axis-angle (T, 24, 3); metres, +Y up, in one world; SMPL24."""
    with open_arrays(path) as arrays:
        sizes = _sizes(arrays)
        for member in members:
            checks.require_dancer(path, member, sizes.dancers)
        poses, places = arrays.read(POSES)[list(members)], arrays.read(TRANS)[list(members)]
        if sizes.has_orients:
            blank = np.zeros((*poses.shape[:2], _BODY - sizes.width))
            poses = np.concatenate([arrays.read(ORIENTS)[list(members)], poses, blank], axis=-1)
    motions = []
    for member, rows, trans in zip(members, poses, places, strict=True):
        checks.require_finite(path, f"the rotations of dancer {member}", rows)
        checks.require_finite(path, f"{TRANS} of dancer {member}", trans)
        rotations = rows.reshape(len(rows), JOINTS, 3)
        checks.require_rotations(path, f"{POSES} of dancer {member}", rotations, trans, SMPL24.parents)
        motions.append(Motion(trans, rotations, FrameGrid.of(RATE), SMPL24))
    return motions


def _sizes(arrays: ArrayFile) -> Sizes:
    """Check which of the two forms a file has, and that its arrays agree."""
    path = arrays.path
    checks.require_keys(arrays, (POSES, TRANS), f"{POSES} and {TRANS}, and {ORIENTS} where {POSES} has no root")
    shape, has_orients = arrays.shape(POSES), ORIENTS in arrays.names
    width = shape[-1] if len(shape) == 3 else 0
    if has_orients and width == _ALL:
        raise DataError("the root's rotation is in the file twice", reason="contradiction", where=str(path),
                        found=f"{POSES} {shape}, of all {JOINTS} joints, and {ORIENTS} {arrays.shape(ORIENTS)}",
                        allowed=f"{POSES} (P, T, {_ALL}) alone, or (P, T, 63) with {ORIENTS} (P, T, 3)",
                        fix="remove the one that is wrong")  # fmt: skip
    valid = width % 3 == 0 and 0 < width <= _BODY if has_orients else width == _ALL
    if not valid:
        allowed = f"n at most {_BODY} and a multiple of 3" if has_orients else f"n {_ALL}, as {ORIENTS} is not there"
        raise checks.bad_shape(path, POSES, shape, f"(P, T, n), {allowed}")
    for key in (TRANS, *([ORIENTS] if has_orients else [])):
        if arrays.shape(key) != (*shape[:2], 3):
            raise DataError(f"{key} and {POSES} do not agree", reason="length_mismatch", where=str(path),
                            found=f"{key} {arrays.shape(key)}, {POSES} {shape}",
                            allowed=f"{key} {(*shape[:2], 3)}", fix=checks.DOWNLOAD_AGAIN)  # fmt: skip
    if not (shape[0] and shape[1]):
        raise checks.no_frames(path)
    return Sizes(shape[0], shape[1], width, has_orients)


def frames_of(name: str) -> int:
    """Return the number of frames that a sequence's name states."""
    start, end = name.rsplit("_", 2)[1:]
    return int(end) - int(start)


@DATASETS.register("aioz-gdance")
@dataclass(frozen=True)
class AiozGdance(PairedDataset):
    """AIOZ-GDANCE, from the published files: each clip is one dancer, each sequence a group.

    Attributes
    ----------
    split
        ``official``: the three lists, which share videos. ``by-video``: a tenth of the videos each is val and test,
        by a hash of their ids; sequences on no list are included.
    """

    split: Literal["official", "by-video"] = field(default="official", metadata={"scan": True})

    body: ClassVar[Skeleton] = SMPL24
    licence: ClassVar[str] = (
        "AIOZ-GDANCE's own licence: one user, non-commercial research only; no distribution, in whole or in part."
    )
    citation: ClassVar[str] = "Le et al., Music-Driven Group Choreography, CVPR 2023."

    layout: ClassVar[Layout] = Layout(
        "aioz-gdance", "AIOZ-GDANCE", "motions_smpl", ".pkl", "VIDEO_SEGMENT_START_END.pkl",
        name_problem=lambda stem: "" if _NAME.fullmatch(stem) else "not named VIDEO_SEGMENT_START_END",
        folder_names=("gdance",),
        published="1,624 were published",
    )  # fmt: skip
    music_folders: ClassVar[tuple[str, ...]] = ("musics", "music", "musics438")
    official: ClassVar[Mapping[str, str]] = {split: f"{split}_split_sequence_names.txt" for split in SPLITS}
    recorded: ClassVar[Mapping[str, str]] = {f"dancers_{n}": f"split_dancerNum_{n}.txt" for n in range(2, 8)}
    unit: ClassVar[str] = "video"

    @override
    def unit_of(self, name: str) -> str:
        return name.rsplit("_", 3)[0]  # a YouTube id may contain "_" and begin with "-"

    @override
    def clips_of(self, ref: ClipRef, listing: Listing) -> Iterable[ClipRef]:
        sizes, stated = read_sizes(ref.motion_path), frames_of(ref.id)
        notes = () if sizes.frames == stated else (f"{sizes.frames:,} frames, but {stated:,} by its name",)
        for member in range(sizes.dancers):
            yield replace(ref, id=member_id(ref.id, member), group=ref.id, member=member, notes=notes)

    @override
    def all_clips(self, refs: Sequence[ClipRef], listing: Listing, left_out: list[Reject]) -> list[ClipRef]:
        labels = self._labels(listing.folders)
        clips = super().all_clips(refs, listing, left_out)
        return [replace(clip, **labels.get(clip.group, {})) for clip in clips]

    @override
    def notes(self, listing: Listing, clips: Sequence[ClipRef]) -> Iterable[str]:
        yield "Axes: +Y up, metres, 30 FPS, as published; the dancers of a sequence share one world."
        if self.official_split:
            yield "GCD and TCDiff train on train; TCDiff reports on val."
        first = {clip.group: clip for clip in clips}
        sizes = Counter(Counter(clip.group for clip in clips).values())
        by_size = ", ".join(f"{n:,} of {size}" for size, n in sorted(sizes.items()))
        if first:
            yield f"Groups: {counted(len(first), 'sequence')} ({by_size} dancers); their order is the tracker's."
        other = [f"{name} ({clip.notes[0]})" for name, clip in sorted(first.items()) if clip.notes]
        if other:
            yield f"Lengths: {counted(len(other), 'sequence')}: {listed(other, 3)}. GCD repeats the last frame."

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read one dancer: 30 FPS, metres, radians, +Y up, SMPL24, in the world of the sequence."""
        return self.load_group([ref])[0]

    @override
    def load_group(self, refs: Sequence[ClipRef]) -> list[Motion]:
        return load_dancers(refs[0].motion_path, [ref.member for ref in refs])

    @override
    def make_example(self, folder: Path) -> None:
        """Write four sequences of six seconds with 2 to 7 dancers: one without root, one float64."""
        from dancedata.datasets._examples import write_lines, write_pickle, write_song

        for k, (name, dancers, _, steps) in enumerate(_SEQUENCES):
            start, end = (int(part) for part in name.rsplit("_", 2)[1:])
            seconds, channels = (end - start) / RATE, 1 + k % 2
            write_song(folder / "musics" / f"{name}.wav", steps, seconds, 44_100, n_channels=channels)
            arrays = _example(steps, dancers, end - start, swap=k == _SWAPS)
            if k == _BODY_ONLY:
                poses = arrays.pop(POSES)
                arrays |= {POSES: poses[..., 3:66], ORIENTS: poses[..., :3]}
            kind = np.float64 if name == _SEQUENCES[-1][0] else np.float32
            content = {key: array.astype(kind) for key, array in arrays.items()}
            meta = {"orig_start": start, "orig_end": end}
            write_pickle(folder / "motions_smpl" / f"{name}.pkl", {**content, "meta": meta})
        for split in SPLITS:
            names = [name for name, _, of, _ in _SEQUENCES if of == split]
            write_lines(folder / f"{split}_split_sequence_names.txt", names)
            rows = [f"{name},{_LABELS[self.unit_of(name)]}" for name in names]
            write_lines(folder / f"{split}_labels.csv", ["sequence_name,music_genre,dance_style", *rows])

    def _labels(self, folders: Folders) -> dict[str, dict[str, Any]]:
        labels: dict[str, dict[str, Any]] = {}
        files = [place / f"{split}_labels.csv" for place in folders.places for split in SPLITS]
        for path in dict.fromkeys(file for file in files if file.is_file()):
            header, *rows = _table(path)
            genre, style = (_column(path, header, part) for part in ("genre", "style"))
            for row in rows:
                values = [row[k].strip() if k is not None and k < len(row) else "" for k in (genre, style)]
                columns = (("style", values[1]),) if values[1] else ()
                labels[row[0].strip()] = {"genre": values[0], "columns": columns}
        return labels


def _table(path: Path) -> list[list[str]]:
    """Return the rows of a label file that are not empty; SourceError if it is not a table."""
    try:
        text = read_regular(path, MAX_LIST_BYTES).decode("utf-8-sig")
        rows = [row for row in csv.reader(text.splitlines()) if row]
        if rows:
            return rows
        problem = "no header"
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        problem = str(error)
    raise SourceError("aioz-gdance: the labels cannot be read", where=str(path), found=problem,
                      allowed="a table with a header; the sequence in its first column",
                      fix="download the file again, or remove it")  # fmt: skip


def _column(path: Path, header: Sequence[str], part: str) -> int | None:
    """Return the only column whose title contains a word, None if no title does; SourceError for several."""
    columns = [k for k, title in enumerate(header) if k and part in title.lower()]
    if len(columns) > 1:
        raise SourceError(f"aioz-gdance: several columns of the labels may be the {part}", where=str(path),
                          found=listed(header, 20, quoted), fix="rename or remove all but one")  # fmt: skip
    return columns[0] if columns else None


#: Of the example: sequence, dancers, official list, the synthetic clip with the steps and the song.
_SEQUENCES = (
    ("-Ab_cdEf123_01_0_180", 2, "train", "gBR_sBM_cAll_d04_mBR0_ch01"),
    ("-Ab_cdEf123_02_187_367", 3, "test", "gPO_sBM_cAll_d10_mPO4_ch03"),
    ("Zz9_8-7_6Q1_02_300_481", 5, "val", "gMH_sBM_cAll_d22_mMH1_ch04"),
    ("plainid0123_04_829_1009", 7, "train", "gHO_sBM_cAll_d19_mHO3_ch01"),
)
_BODY_ONLY, _SWAPS = 2, 1
_SPACING_M, _LARGEST_DELAY = 1.2, 6
_LABELS = {"-Ab_cdEf123": "Hip-Hop,Street", "Zz9_8-7_6Q1": "Pop,Commercial", "plainid0123": "K-Pop,Modern"}


def _example(steps: str, dancers: int, n: int, *, swap: bool) -> dict[str, Floats]:
    """Return the arrays of a sequence: one dance, each dancer up to 0.2 s later and in a place of its own."""
    from dancedata.datasets._examples import dance

    motion = dance(steps, n + _LARGEST_DELAY)
    delays = [(3 * member) % (_LARGEST_DELAY + 1) for member in range(dancers)]
    places = np.zeros((dancers, n, 3))
    places[..., 0] = _SPACING_M * (np.arange(dancers) - (dancers - 1) / 2)[:, None]
    if swap:  # half a circle about the middle of the two, so that they stay apart
        angle = np.pi * np.clip((np.arange(n) - n / 3) / (n / 3), 0, 1)
        middle, radius = places[:2].mean(axis=0), _SPACING_M / 2
        turn = radius * np.stack([np.cos(angle), np.zeros(n), np.sin(angle)], axis=-1)
        places[0], places[1] = middle - turn, middle + turn
    return {
        POSES: np.stack([motion.rotations[d : d + n].reshape(n, _ALL) for d in delays]),
        TRANS: np.stack([motion.translation[d : d + n] for d in delays]) + places,
    }
