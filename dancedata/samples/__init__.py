"""Samples of models: what ids name in a dataset, and files."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property

from dancedata.core.clip import Window
from dancedata.core.errors import DataError, nearest
from dancedata.core.sample_id import SampleId, safe_name
from dancedata.core.text import listed
from dancedata.store.clip_view import Clip
from dancedata.store.dataset import Store


@dataclass(frozen=True, eq=False)
class Sample:
    """What an id names in a dataset; `start` and `length` are frames of the dataset."""

    id: SampleId
    store: Store
    clips: tuple[Clip, ...]  # the clip; of a group those of its dancers
    start: int
    length: int
    recording: str  # id of the clip that copies, windows and parts of one file come from: the unit of intervals

    @property
    def clip(self) -> Clip:
        """The clip; of a group that of the first dancer."""
        return self.clips[0]

    @property
    def music_start_s(self) -> Fraction:
        """Second of the song, of a copy of the stretched one, at the first frame."""
        return self.clip.audio_start + self.store.grid.seconds(self.start)

    @property
    def windows(self) -> tuple[Window, ...]:
        """Its frames of each clip."""
        return tuple(Window(clip.id, self.start, self.length) for clip in self.clips)


class Samples:
    """Finds what ids name in a dataset."""

    def __init__(self, store: Store) -> None:
        self.store = store

    @cached_property
    def _groups(self) -> dict[str, list[Clip]]:
        groups: dict[str, list[Clip]] = {}
        for clip in self.store.clips():
            if clip.group:
                groups.setdefault(clip.group, []).append(clip)
        return groups

    @cached_property
    def _shortened(self) -> dict[str, str]:
        """Names of clips and groups by those of ids that do not give them back: shortened, or composed."""
        names = (name for clip in self.store.clips() for name in (clip.id, clip.group) if name)
        return {safe: name for name in names if SampleId.parse(safe := safe_name(name)).clip != name}

    def _clips(self, of: SampleId) -> tuple[Clip, ...]:
        for name in dict.fromkeys((of.clip, self._shortened.get(safe_name(of.clip), of.clip))):
            if name in self.store:
                return (self.store[name],)
            members = self._groups.get(name, [])
            if of.dancer is not None:
                numbers = [f"~p{clip.member}" for clip in members]
                members = [clip for clip in members if clip.member == of.dancer]
                if numbers and not members:
                    raise DataError("the group has no such dancer", reason="no_clip", where=str(of),
                                    found=f"~p{of.dancer}", allowed=listed(numbers))  # fmt: skip
            if members:
                return tuple(members)
        return ()

    def find(self, name: str | SampleId) -> Sample | None:
        """Return what an id names, None if it is no clip or group of the dataset; DataError "outside" beyond a clip.

        A name that is that of a clip as it stands is the clip.
        """
        stored = isinstance(name, str) and (name in self.store or name in self._groups)
        of = SampleId(str(name)) if stored else SampleId.parse(name)
        clips = self._clips(of)
        if not clips:
            return None
        n_frames = min(clip.n_frames for clip in clips)
        start, length = (0, n_frames) if of.start is None or of.length is None else (of.start, of.length)
        if start + length > n_frames or not length:
            raise DataError("the window is not within its clip", reason="outside", where=str(name),
                            found=f"frames {start} to {start + length}",
                            allowed=f"0 to {n_frames} of {of.clip}")  # fmt: skip
        origin = self.store[clips[0].source] if clips[0].source else clips[0]
        recording = origin.recording if len(clips) == 1 else origin.group
        return Sample(of, self.store, clips, start, length, recording)

    def require(self, name: str | SampleId) -> Sample:
        """Return what an id names; DataError "no_clip" with the nearest clips if it is none of the dataset."""
        sample = self.find(name)
        if sample is None:
            clip = SampleId.parse(name).clip
            ids = [*(c.id for c in self.store.clips()), *self._groups]
            raise DataError(f"the dataset has no clip {clip!r}", reason="no_clip", where=str(name),
                            fix=nearest(clip, ids, "clip", self.store.path))  # fmt: skip
        return sample
