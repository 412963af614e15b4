"""The person of a file that is read, and the frames of the video in which the person was not seen."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import DataError
from dancedata.core.rotations import slerp
from dancedata.core.text import counted, listed, quoted
from dancedata.datasets.folder.manifest import id_problem
from dancedata.formats.arrays import ArrayFile
from dancedata.formats.values import holds_values, open_arrays
from dancedata.formats.video_pose import PersonArrays, open_people
from dancedata.formats.video_tracks import MAX_GAP, joined, people_of

#: Frames before a person appears; an hour at 30 FPS.
_MAX_LEAD = 108_000

Floats = NDArray[np.float64]


def split_people(clips: Sequence[ClipRef], rejects: Sequence[Reject]) -> tuple[list[ClipRef], list[Reject]]:
    """Make a clip NAME-personID of each person in files divided by people, unless the manifest chooses one."""
    people, left_out = [], list(rejects)
    for clip in clips:
        for person in _people_of(clip):
            name = f"{clip.id}-person{person}" if person else clip.id
            problem = id_problem(name)
            if problem is None:
                declared = (*clip.declared, ("person", person)) if person else clip.declared
                people.append(replace(clip, id=name, declared=tuple(sorted(declared))))
            else:
                detail = f"the id of a person, {quoted(person, 60)}, gives a name that {problem}"
                left_out.append(Reject("bad_name", clip=clip.id, file=str(clip.motion_path), detail=detail))
    return people, left_out


def _people_of(clip: ClipRef) -> tuple[str, ...]:
    """Return the names of the people of a clip's file; ("",) for one person without a name."""
    if any(name == "person" for name, _ in clip.declared):
        return ("",)
    try:
        return people_of(clip.motion_path)
    except DataError:
        return ("",)


@contextmanager
def open_person(path: Path, person: str | None) -> Iterator[ArrayFile]:
    """Open the arrays of one person, or of the only one; DataError if several are there, or this one is not."""
    if not holds_values(path):
        with open_arrays(path) as arrays:
            if person is not None:
                raise _missing(path, person, "a file that is not divided by people")
            yield arrays
        return
    tracks = open_people(path)
    people = joined(tracks)
    if person is None and len(people) > 1:
        raise DataError(
            f"the file has {counted(len(people), 'person').replace('persons', 'people')}, and none of them is chosen",
            reason="several_people",
            where=str(path),
            found=listed(map(str, people)),
            fix="make each a clip (--set dataset.folder.people=split), or choose one in the manifest's column person",
        )
    chosen = [one for one in (*people, *tracks) if person is None or one.person == person]
    if not chosen:
        found = f"people {listed(map(str, people))}" if people[0].person else "one person without a name"
        raise _missing(path, person, found)
    yield chosen[0]


def _missing(path: Path, person: str | None, found: str) -> DataError:
    return DataError(f"the file has no person {quoted(person, 40)}", reason="missing_person", where=str(path),
                     found=found, fix="correct the column person of the manifest, or leave it empty")  # fmt: skip


@dataclass(frozen=True)
class Seen:
    """Frames of the video in which a person is seen: the first, one after the last, and the number missing."""

    first: int
    stop: int
    missing: int

    def __str__(self) -> str:
        parts = [f"first seen in frame {self.first} of the video, still until then (trim_start)"] * (self.first > 0)
        parts += [f"{counted(self.missing, 'frame')} of {self.stop - self.first} interpolated"] * (self.missing > 0)
        return "; ".join(parts)


def seen_in(arrays: ArrayFile) -> tuple[Seen, NDArray[np.int64]] | None:
    """Return when the person is seen, and in which frames; None if not stated. DataError: ``missing_frames``."""
    frames = arrays.frames if isinstance(arrays, PersonArrays) else None
    if frames is None or not len(frames):
        return None
    steps = np.diff(frames)
    gap = int(steps.max()) - 1 if len(steps) else 0
    if frames[0] < 0 or frames[0] > _MAX_LEAD or (steps < 1).any():
        order = f"frames from {frames[0]:,}, {'not ' if (steps < 1).any() else ''}in rising order"
        allowed = f"frames in rising order from 0 on; the first one at most {_MAX_LEAD:,}"
        raise _missing_frames(arrays.path, "the frames of the video are not in order", order, allowed)
    if gap > MAX_GAP:
        at = int(steps.argmax())
        problem = f"the person is not seen in {gap:,} frames of the video in a row"
        found = f"nothing between frames {frames[at]:,} and {frames[at + 1]:,}"
        raise _missing_frames(arrays.path, problem, found, f"at most {MAX_GAP} in a row, which are interpolated")
    first, stop = int(frames[0]), int(frames[-1]) + 1
    return Seen(first, stop, stop - first - len(frames)), frames


def on_video_frames(arrays: ArrayFile, translation: Floats, rotations: Floats) -> tuple[Floats, Floats, int]:
    """Return a motion (F, 3), (F, J, 3) on the frames of the video, and the frame in which the person appears."""
    span = seen_in(arrays)
    if span is None:
        return translation, rotations, 0
    seen, frames = span
    if len(frames) != len(rotations):
        raise DataError("the frames of the video do not match the motion", reason="length_mismatch",
                        where=str(arrays.path), found=f"{len(frames):,} frames, {len(rotations):,} rows of rotations",
                        fix="run the program again")  # fmt: skip
    if seen.missing:
        row = np.interp(np.arange(seen.first, seen.stop), frames, np.arange(len(frames)))
        new = np.setdiff1d(np.arange(len(row)), frames - seen.first)
        between = slerp(rotations, row[new])
        moved = np.stack([np.interp(row, np.arange(len(frames)), column) for column in translation.T], axis=1)
        turned = np.empty((len(row), *rotations.shape[1:]))
        turned[frames - seen.first], turned[new] = rotations, between
        translation, rotations = moved, turned
    if seen.first:
        translation = np.concatenate([np.repeat(translation[:1], seen.first, axis=0), translation])
        rotations = np.concatenate([np.repeat(rotations[:1], seen.first, axis=0), rotations])
    return translation, rotations, seen.first


def _missing_frames(path: Path, problem: str, found: str, allowed: str) -> DataError:
    return DataError(
        problem,
        reason="missing_frames",
        where=str(path),
        found=found,
        allowed=allowed,
        fix="cut video and music into parts in which the person is seen, and run the program on each of them",
    )
