"""I-Dancers (CoheDancers, Yang et al. 2025): groups of dancers, SMPL by rotation matrices.

The files: docs/datasets/i-dancers.md. Neither the rate nor the axis that is up is published.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from dancedata.core.clip import ClipRef, Reject, member_id
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid, as_rate
from dancedata.core.motion import Motion
from dancedata.core.registry import DATASETS
from dancedata.core.rotations import rotvec_from_matrix
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.datasets import checks
from dancedata.datasets.published import Layout, LeftOut, Listing, PairedDataset, rejected
from dancedata.formats.values import open_arrays
from dancedata.kernel import audio_length

KEYS, SUFFIX = ("smpl_poses", "smpl_trans"), "_smpl"
#: Rates that are recognised from the lengths of motion and music, which agree within this share.
_RATES, _NEAR = (20, 24, 25, 30, 50, 60), Fraction(1, 50)
_MAX_TRIM = 100_000

Floats = NDArray[np.float64]


@DATASETS.register("i-dancers")
@dataclass(frozen=True)
class IDancers(PairedDataset):
    """I-Dancers, from the files of CoheDancers: each clip is one dancer, each sequence a group.

    Attributes
    ----------
    fps
        Frames per second. "auto": the one of 20, 24, 25, 30, 50 and 60 by which motion and music of most sequences
        are equally long, within 2 %; a sequence in which they then are not, or without music, is left out.
    up
        Axis that is up: "y", "z", or "auto", that along which heads are above pelvises.
    trim_frames
        Frames to leave out at both ends, of motion and music; CoheDancers' loader leaves out 15.
    """

    fps: str = field(default="auto", metadata={"scan": True})
    up: Literal["auto", "y", "z"] = "auto"
    trim_frames: int = field(default=0, metadata={"scan": True})

    body: ClassVar[Skeleton] = SMPL24
    licence: ClassVar[str] = (
        "I-Dancers: no licence is published with the files. Motion was estimated from videos of third parties, whose "
        "music is not licensed for redistribution."
    )
    citation: ClassVar[str] = "Yang et al., CoheDancers: Enhancing Interactive Group Dance Generation, ACM MM 2025."

    def __post_init__(self) -> None:
        super().__post_init__()
        if type(self.trim_frames) is not int or not 0 <= self.trim_frames <= _MAX_TRIM:
            raise UsageError("i-dancers: invalid value for trim_frames", found=repr(self.trim_frames),
                             allowed=f"a number of frames from 0 to {_MAX_TRIM}")  # fmt: skip
        if self.fps != "auto":
            as_rate(self.fps)

    layout: ClassVar[Layout] = Layout(
        "i-dancers", "I-Dancers", "motion", ".pkl", f"NAME{SUFFIX}.pkl",
        folder_names=("dancers",), stem=f"{{}}{SUFFIX}",
    )  # fmt: skip
    music_folders: ClassVar[tuple[str, ...]] = ("music",)
    official: ClassVar[Mapping[str, str]] = {"train": "train.txt", "test": "test.txt"}

    @override
    def listed_name(self, line: str) -> str:
        return line.removesuffix(".pkl").removesuffix(SUFFIX)

    @override
    def audio_of(self, name: str, listing: Listing) -> Path | None:
        audio = super().audio_of(name, listing)
        if audio is None and self.fps == "auto":
            raise LeftOut("missing_music", f"no music/{name}, which fps: auto needs", music=name)
        return audio

    @override
    def all_clips(self, refs: Sequence[ClipRef], listing: Listing, left_out: list[Reject]) -> list[ClipRef]:
        """Return the dancers of all sequences; their rate is told from the lengths of all."""
        shapes: dict[str, tuple[int, int]] = {}
        for ref in refs:
            with rejected(left_out, ref.id, listing):
                shapes[ref.id] = shape_of(ref.motion_path)
        refs, clips = [ref for ref in refs if ref.id in shapes], []
        rates = self._rates(refs, {name: frames for name, (_, frames) in shapes.items()})
        for ref in refs:
            with rejected(left_out, ref.id, listing):
                (dancers, frames), rate = shapes[ref.id], rates[ref.id]
                if isinstance(rate, DataError):
                    raise rate
                if frames <= 2 * self.trim_frames:
                    raise too_short(ref.motion_path, frames, self.trim_frames)
                trim = self.trim_frames / rate
                clips += [
                    replace(
                        ref, id=member_id(ref.id, member), declared=(("fps", str(rate)),),
                        group=ref.id, member=member, audio_start=trim, source_start=trim or None,
                        source_end=frames / rate - trim if trim else None,
                    )
                    for member in range(dancers)
                ]  # fmt: skip
        return clips

    @override
    def notes(self, listing: Listing, clips: Sequence[ClipRef]) -> Iterable[str]:
        rates = sorted({dict(clip.declared)["fps"] for clip in clips}, key=Fraction)
        by = "by the lengths of motion and music" if self.fps == "auto" else "as set"
        yield f"Rate: {listed(rates) or 'none'} frames per second, {by}."
        yield (
            f"Trims: {counted(self.trim_frames, 'frame')} at both ends are left out, of motion and music."
            if self.trim_frames
            else "Trims: none; CoheDancers' loader leaves out 15 frames at both ends (trim_frames: 15)."
        )
        yield (
            f"Up: {self.up}." if self.up != "auto" else "Up: the axis along which heads are above pelvises, by file."
        )

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read one dancer: metres, radians, +Y up, SMPL24; DataError as of `load_motions`."""
        return self.load_group([ref])[0]

    @override
    def load_group(self, refs: Sequence[ClipRef]) -> list[Motion]:
        """Read the dancers of one sequence, whose pickle is read once."""
        rate, members = Fraction(dict(refs[0].declared)["fps"]), [ref.member for ref in refs]
        return load_motions(refs[0].motion_path, members, rate, self.up, self.trim_frames)

    @override
    def make_example(self, folder: Path) -> None:
        """Write three sequences of six seconds at 30 FPS, dancers 1.2 m apart, +Y up, and the lists."""
        from dancedata.datasets._examples import dance, write_lines, write_pickle, write_song

        names: dict[str, list[str]] = {"train": [], "test": []}
        for name, size, split, music in (
            ("seq_001", 2, "train", "mBR0"), ("seq_002", 3, "train", "mPO1"), ("seq 010", 2, "test", "mHO2"),
        ):  # fmt: skip
            write_song(folder / "music" / f"{name}.wav", music, 183 / 30)
            content = content_of(dance(f"gBR_sBM_cAll_d04_{music}_ch01", 183), size)
            write_pickle(folder / "motion" / f"{name}{SUFFIX}.pkl", content)
            names[split].append(f"{name}{SUFFIX}.pkl")
        for split, of in names.items():
            write_lines(folder / f"{split}.txt", of)

    def _rates(self, refs: Sequence[ClipRef], n_frames: Mapping[str, int]) -> dict[str, Fraction | DataError]:
        """Return the rate of each sequence, or why it has none: all have that of most, by the lengths of music."""
        rates: dict[str, Fraction | DataError] = {}
        lengths: dict[str, tuple[Path, int, Fraction]] = {}
        for ref in refs:
            try:
                if self.fps != "auto" or ref.audio_path is None:
                    rates[ref.id] = as_rate(self.fps)
                else:
                    lengths[ref.id] = ref.motion_path, n_frames[ref.id], Fraction(*audio_length(ref.audio_path))
            except DataError as error:
                rates[ref.id] = error
        fitting = {name: _fitting(frames, seconds) for name, (_, frames, seconds) in lengths.items()}
        counts = Counter(rate for of_one in fitting.values() for rate in of_one).most_common(2)
        clear = bool(counts) and (len(counts) == 1 or counts[0][1] > counts[1][1])
        votes = ", ".join(f"{n} at {rate}" for rate, n in counts) or "none"
        for name, (path, frames, seconds) in lengths.items():
            if clear and counts[0][0] in fitting[name]:
                rates[name] = Fraction(counts[0][0])
                continue
            rates[name] = DataError(
                "the frame rate cannot be told from the lengths of motion and music",
                reason="unknown_rate",
                where=str(path),
                found=f"{frames} frames, {float(seconds):.2f} s of music; of {len(lengths)} sequences {votes}",
                allowed=f"as long as the music, within 2 %, at one of {listed(_RATES)} frames per second, the one of "
                "most sequences",
                fix="set dataset.i-dancers.fps, or cut the song to the dance",
            )
        return rates


def _fitting(frames: int, seconds: Fraction) -> list[int]:
    return [rate for rate in _RATES if seconds and abs(Fraction(frames, rate) / seconds - 1) <= _NEAR]


def shape_of(path: Path) -> tuple[int, int]:
    """Return dancers and frames of a pickle; DataError if they cannot be read."""
    with open_arrays(path) as arrays:
        checks.require_keys(arrays, KEYS)
        shape = arrays.shape("smpl_poses")
    _require_shape(path, shape)
    return shape[0], shape[1]


def load_motions(path: Path, members: Sequence[int], rate: Fraction, up: str = "auto", trim: int = 0) -> list[Motion]:
    """Read some dancers without `trim` frames at both ends: metres, turned to +Y up in one world; SMPL24."""
    with open_arrays(path) as arrays:
        checks.require_keys(arrays, KEYS)
        matrices, places = (arrays.read(key) for key in KEYS)
    _require_shape(path, matrices.shape)
    dancers, frames = matrices.shape[:2]
    if frames <= 2 * trim:
        raise too_short(path, frames, trim)
    if places.shape != (dancers, frames, 3):
        raise checks.bad_shape(path, "smpl_trans", places.shape, f"{(dancers, frames, 3)}, as smpl_poses")
    for member in members:
        checks.require_dancer(path, member, dancers)
        checks.require_finite(path, f"dancer {member}: smpl_trans", places[member])
        checks.require_finite(path, f"dancer {member}: smpl_poses", matrices[member].reshape(frames, -1))
        checks.require_matrices(f"{path}, dancer {member}", matrices[member], SMPL24.joints)
    matrices, places = (a[:, trim : frames - trim] for a in (matrices, places))
    finite = [k for k in range(dancers) if np.isfinite(matrices[k]).all() and np.isfinite(places[k]).all()]
    grid = FrameGrid(rate)
    motions = {k: Motion(places[k], rotvec_from_matrix(matrices[k]), grid, SMPL24) for k in finite}
    spine = np.mean([checks.spine_of(motion) for motion in motions.values()], axis=0)
    axis = checks.up_axis(path, spine, up, "i-dancers")
    return [checks.upright(motions[member], axis) for member in members]


def too_short(path: Path, frames: int, trim: int) -> DataError:
    """Return the error of a motion of which nothing is left."""
    return DataError("the motion has no frames left after trim_frames", reason="empty", where=str(path),
                     found=f"{frames} frames", allowed=f"more than {2 * trim}",
                     fix="set dataset.i-dancers.trim_frames to fewer frames")  # fmt: skip


def _require_shape(path: Path, shape: tuple[int, ...]) -> None:
    if len(shape) != 5 or shape[2:] != (SMPL24.n_joints, 3, 3) or shape[0] < 1:
        raise checks.bad_shape(path, "smpl_poses", shape, f"(P, T, {SMPL24.n_joints}, 3, 3) of rotation matrices")
    if shape[1] == 0:
        raise checks.no_frames(path)


def content_of(motion: Motion, size: int) -> dict[str, Any]:
    """Return copies of a dancer on a line as a pickle of I-Dancers has them."""
    matrices = np.stack([motion.matrices] * size)
    places = np.stack([np.add(motion.translation, (1.2 * k, 0.0, 0.3 * k)) for k in range(size)])
    return {"smpl_poses": matrices.astype(np.float32), "smpl_trans": places.astype(np.float32)}
