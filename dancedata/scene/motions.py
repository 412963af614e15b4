"""Motions of files and of Python as scenes, with music."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.clip import member_id
from dancedata.core.errors import DanceDataError, DataError, UsageError
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.text import listed, shown
from dancedata.core.typing import override
from dancedata.kernel import ClipRecord, Field, Store, load_audio
from dancedata.scene.figure import Figure
from dancedata.scene.group_scene import GroupScene
from dancedata.scene.inputs.clip import ClipInput
from dancedata.scene.inputs.files import FileFormat, clips_of
from dancedata.scene.inputs.naming import motion_files, named_clips, require_unique
from dancedata.scene.inputs.songs import MusicSources
from dancedata.scene.scene_list import MAX_NAME, Item, Rhythm, Scene, SceneList
from dancedata.scene.scenes import rhythm_of
from dancedata.scene.source import MAX_SECONDS, ClipSound, cut

#: Feature whose beats and onsets are drawn, and its rows per second.
_FEATURE, _RATE = "librosa35", 30


@dataclass(frozen=True, eq=False)
class MusicFiles:
    """Music files of clips that are not of a dataset, and the clips, by their ids."""

    clips: Mapping[str, ClipInput]
    files: Mapping[str, Path]

    @classmethod
    def beside(cls, path: Path, clips: Sequence[ClipInput], like: Store | None = None) -> MusicFiles:
        """Return the music of clips."""
        sources = MusicSources.of(path)
        named = named_clips(clips, sources, like).clips
        music = {clip.id: sources.files[clip.music] for clip in named if clip.music in sources.files}
        if not music:
            raise UsageError("no file of this music is named after a clip", where=path,
                             found=listed(sorted(sources.files), 5),
                             allowed=listed([clip.id for clip in clips], 5),
                             fix="name one file, or a CSV file with the columns sample,song")  # fmt: skip
        return cls({clip.id: clip for clip in named}, music)

    def signal(self, clip: str, n_seconds: Fraction) -> AudioSignal | None:
        """Return the music of the first seconds of a clip, silent where it has ended; None without any."""
        path = self.files.get(clip)
        if path is None:
            return None
        return cut(load_audio(path), self.clips[clip].audio_start, min(n_seconds, Fraction(MAX_SECONDS)))


@dataclass(frozen=True, eq=False)
class _Loaded:
    """The figures of a clip, several of a group; none if it could not be read, for the reason in `problem`."""

    figures: tuple[Figure, ...]
    problem: str = ""


class MotionScenes(SceneList):
    """Motions that are not in a dataset, each an item; they are read at once.

    `clips`: The motions, by unique ids.
    `beats`: Instants of the beats of clips whose music is not at hand, seconds.
    Raises DanceDataError: if not one of them can be read: the reason of the first.
    """

    def __init__(
        self,
        clips: Sequence[ClipInput],
        name: str,
        music: MusicFiles | None = None,
        body: Skeleton = SMPL24,
        beats: Mapping[str, Float64Array] | None = None,
    ) -> None:
        if not clips:
            raise UsageError("there is no motion to show", where=name)
        self.place, self.body, self.music, self.beats = name, body, music, beats or {}
        self._clips = {clip.id: clip for clip in clips} if music is None else music.clips
        self._loaded, first = {}, None
        for clip in clips:
            try:
                self._loaded[clip.id] = _Loaded(figures_of(clip, body))
            except DataError as error:
                first = first or error
                self._loaded[clip.id] = _Loaded((), str(error))
        grids = [figures.figures[0].grid for figures in self._loaded.values() if figures.figures]
        if not grids:
            raise first or UsageError("there is no motion to show", where=name)
        self.grid = grids[0]

    @property
    def problems(self) -> list[str]:
        """Sentences on motions that could not be read."""
        return [f"{clip}: {loaded.problem}" for clip, loaded in self._loaded.items() if loaded.problem]

    @override
    @cached_property
    def items(self) -> tuple[Item, ...]:
        return tuple(self._item(number, name, loaded) for number, (name, loaded) in enumerate(self._loaded.items()))

    def _item(self, number: int, name: str, loaded: _Loaded) -> Item:
        if not loaded.figures:
            return Item(number, ClipRecord(id=name, split="", n_frames=1), 0, 1)
        figure = loaded.figures[0]
        n_frames = self.grid.frames_up(figure.grid.seconds(figure.n_frames))
        of = self._clips[name]
        clip = ClipRecord(
            id=name, split="", n_frames=n_frames, music=of.music, audio_start=of.audio_start,
            source_rate=str(figure.grid.rate),
        )  # fmt: skip
        if len(loaded.figures) == 1:
            return Item(number, clip, 0, n_frames)
        members = tuple(
            Item(number, replace(clip, id=member_id(name, k), group=name, member=k), 0, n_frames)
            for k in range(len(loaded.figures))
        )
        return replace(members[0], members=members, n_source=len(members))

    @override
    def scene(self, item: Item, field: str | None = None, *, first_s: float | None = None) -> Scene:
        name = item.clip.group or item.clip.id
        loaded = self._loaded[name]
        rhythm, notes = self._rhythm(name, item)
        if loaded.problem:
            return Scene(item, self.grid, "", None, None, rhythm, (), (), (f"no figure: {loaded.problem}", *notes))
        figures = loaded.figures if first_s is None else [figure.part(0, first_s) for figure in loaded.figures]
        notes = ["contacts are not stored in files: they were computed by the rule velocity", *notes]
        if not item.members:
            figure = figures[max(0, item.clip.member)]
            movement = figure.movement if figure.n_frames > 1 else None
            return Scene(item, self.grid, "", figure, movement, rhythm, (), (), tuple(notes))
        members = tuple(self.scene(member, first_s=first_s) for member in item.members)
        together = GroupScene.of(figures)
        return Scene(item, self.grid, "", None, None, rhythm, (), (), tuple(notes), members, together)

    @override
    def about(self) -> dict[str, Any]:
        n = sum(len(item.members) or 1 for item in self.items)
        hours = sum(float(self.grid.seconds(item.n_frames)) * (len(item.members) or 1) for item in self.items) / 3600
        return {
            "name": shown(self.place, MAX_NAME), "fps": float(self.grid.rate), "rate": str(self.grid),
            "clips": n, "windows": 0, "hours": hours, "licence": "", "citation": "",
        }  # fmt: skip

    def sound(self, item: Item) -> ClipSound | None:
        """Return the music of an item, as long as it; None without any. DataError if it cannot be decoded."""
        name, seconds = item.clip.group or item.clip.id, self.grid.seconds(item.n_frames)
        signal = None if self.music is None else self.music.signal(name, seconds)
        return None if signal is None else ClipSound(signal)

    def _rhythm(self, name: str, item: Item) -> tuple[Rhythm, list[str]]:
        """Return beats and onsets of a clip's music, and a note where there are none."""
        if name in self.beats:
            return Rhythm(self.beats[name], np.zeros(0), field="beats"), []
        if self.music is None:
            return Rhythm.none(), []
        from dancedata.building.arrays import extract
        from dancedata.core.registry import FEATURES

        try:
            signal = self.music.signal(name, self.grid.seconds(item.n_frames))
            if signal is None:
                return Rhythm.none(), ["no music is named as this clip"]
            rows = extract(_FEATURE, signal, fps=_RATE)
        except DanceDataError as error:
            return Rhythm.none(), [f"no beats: {error}"]
        field = Field(_FEATURE, "audio", FEATURES.get(_FEATURE)().columns, Fraction(_RATE))
        return rhythm_of(rows, field), []


def figures_of(clip: ClipInput, body: Skeleton) -> tuple[Figure, ...]:
    """Load a clip and return its figures, several of a group; DataError if it cannot be drawn."""
    loaded = clip.load()
    poses = loaded if isinstance(loaded, tuple) else (loaded,)
    if len({pose.grid for pose in poses}) > 1 or len({len(pose.joints) for pose in poses}) > 1:
        raise DataError("the dancers of a group differ in length or rate", reason="length_mismatch", where=clip.id)
    return tuple(Figure.of_pose(pose, body, clip.id) for pose in poses)


def motion_scenes(
    path: Path, form: FileFormat, music: Path | None = None, body: Skeleton = SMPL24, like: Store | None = None
) -> MotionScenes:
    """Read the motion files of a folder, or one file; `like` is the dataset whose windows they may be."""
    clips = [clip for file in motion_files(path, "look at") for clip in clips_of(file, form)]
    require_unique([clip.id for clip in clips], path)
    beside = None if music is None else MusicFiles.beside(music, clips, like)
    try:
        return MotionScenes(named_clips(clips, MusicSources(), like).clips, path.name, beside, body)
    except DataError as error:
        if error.reason == "bad_shape" and form.columns is None:
            error.fix = "if these are columns, say of what: field and like, for their scaler and rate"
            error.options = "if these are columns, say of what: --field edge151 --like DATASET"
        raise
