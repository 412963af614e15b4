"""Scenes: the clips of a dataset, as they are drawn."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Window
from dancedata.core.errors import DanceDataError, DataError, StoreError, UsageError, did_you_mean, nearest
from dancedata.core.grid import as_rate
from dancedata.core.registry import FEATURES, beat_rows_late
from dancedata.core.text import counted, listed, shown
from dancedata.core.typing import override
from dancedata.kernel import DATASET_FILE, Field, Store
from dancedata.metrics.key_motion import KeyMotion
from dancedata.scene.figure import Figure, Movement
from dancedata.scene.group_scene import GroupScene
from dancedata.scene.poses import ColumnsReader, motion_reader, pose_readers
from dancedata.scene.scene_list import MAX_NAME, Flag, Item, Rhythm, Scene, SceneList, Word
from dancedata.store.dataset import reopen

_ONSET, _DOWNBEAT = "onset_envelope", "downbeat"
#: Most segments of a layer that are drawn.
_MOST_WORDS = 3000
#: Frames that are read, about, to find the item to begin with: half a second of work.
_TRIED_FRAMES = 10_000


def drawable_fields(store: Store) -> dict[str, ColumnsReader]:
    """Return the motion fields that have joint positions, those first that give back the motion as it was."""
    readers = pose_readers(store)
    # First whole motions, then positions, then motions that `decode` fits to the columns.
    rank = {name: (r.representation.positions_only, not r.representation.decodes) for name, r in readers.items()}
    return dict(sorted(readers.items(), key=lambda item: rank[item[0]]))


def rhythm_fields(store: Store) -> tuple[str, ...]:
    """Return the audio fields that have beats, librosa35 first: two datasets are then compared by the same beats."""
    names = [field.name for field in store.fields_with("beat")]
    return tuple(sorted(names, key=lambda name: FEATURES.split(name)[0] != "librosa35"))


def rhythm_of(rows: npt.NDArray[Any], field: Field, lead: int = 0) -> Rhythm:
    """Return the rhythm of (T, D) rows of an audio field, at its instants, not late."""
    rate, stored = float(field.rate), field.beats(rows)
    beats = (stored.seconds + lead / rate).clip(min=0)
    downbeats: tuple[int, ...] = ()
    if _DOWNBEAT in field.columns.names:
        downbeats = tuple(np.flatnonzero(rows[stored.frames, field.columns.slice(_DOWNBEAT)].ravel() > 0.5).tolist())
    if _ONSET not in field.columns.names:
        return Rhythm(beats, np.zeros(0), rate, field.name, downbeats)
    onset = rows[beat_rows_late(field.name) :, field.columns.slice(_ONSET)].ravel().astype(np.float64)
    onset = np.pad(np.nan_to_num(onset, posinf=0.0, neginf=0.0), (lead, 0))
    top = float(onset.max(initial=0.0))
    return Rhythm(beats, np.clip(onset / top, 0, 1) if top > 0 else onset * 0, rate, field.name, downbeats)


class Scenes(SceneList):
    """The items of a dataset; arrays are read item by item.

    `field`: Motion field to draw. Default: the first one that decodes to the motion itself. UsageError for another.
    """

    def __init__(self, store: Store, field: str | None = None) -> None:
        self.store = store
        self.place, self.grid, self.body = str(store.path), store.grid, store.skeleton
        self.readers = drawable_fields(store)
        self.fields = tuple(self.readers)
        common = [name for name in self.readers if name in store.required_fields]
        self.field = next(iter([*common, *self.readers]), None) if field is None else self._drawable(field)
        self._rhythm_field = next(iter(rhythm_fields(store)), None)
        self._identity = self._file_identity()

    @cached_property
    def items(self) -> tuple[Item, ...]:
        """The groups and clips in stored order."""
        items: list[Item] = []
        for number, unit in enumerate(self.store.clips().units()):
            dancers = [clip.record for clip in unit]
            members = tuple(Item(number, clip, 0, clip.n_frames, source=clip.source) for clip in dancers)
            items.append(self._group(members) if dancers[0].group else members[0])
        return tuple(items)

    @override
    def scene(self, item: Item, field: str | None = None, *, first_s: float | None = None) -> Scene:
        name = self._drawn(item) if field is None else self._drawable(field)
        if item.members:
            return self._group_scene(item, name, first_s)
        figure, problem = self._figure(item, name, first_s)
        rhythm = self._rhythm(item)
        return Scene(
            item, self.store.grid, name or "", figure, self._movement(item, figure, first_s), rhythm,
            self.windows_of(item), self._flags_of(item), tuple(_notes(self.store, figure, problem, rhythm)),
            words=tuple(self._words_of(item)),
        )  # fmt: skip

    @override
    def sliding(self, item: Item) -> float | None:
        figure, _ = self._figure(item, self._drawn(item), None)  # a whole scene would take four times as long
        return None if figure is None else figure.sliding

    @override
    def best(self) -> Item:
        """Return the item whose dancers hit most beats, of some without flags if there are any."""
        originals = [item for item in self.items if not (item.source or self.flag_count(item))] or self.items
        step = -(-sum(item.n_frames for item in originals) // _TRIED_FRAMES)
        return max(originals[::step], key=self._share_of_hits)

    def _share_of_hits(self, item: Item) -> float:
        try:
            scene = self.scene(item)
        except DanceDataError:
            return -1.0
        dancers = scene.members or (scene,)
        return sum(len(dancer.hits) for dancer in dancers) / max(1, sum(len(dancer.offsets) for dancer in dancers))

    @override
    def flag_count(self, item: Item) -> int:
        return sum(len(self._flags_of(dancer)) for dancer in item.members or (item,))

    @override
    def about(self) -> dict[str, Any]:
        meta, counts = self.store.info, self.store.info["splits"].values()
        total = {key: sum(split.get(key, 0) for split in counts) for key in ("clips", "windows", "hours")}
        if any("groups" in split for split in counts):
            total["groups"] = sum(split.get("groups", 0) for split in counts)
        return {
            "name": shown(meta.get("name", self.store.path.name), MAX_NAME), "fps": float(self.grid.rate),
            "rate": str(self.grid), **total,
            "made": self.store.reference[1],
            "licence": shown(meta.get("licence", ""), 600), "citation": shown(meta.get("citation", ""), 600),
        }  # fmt: skip

    @override
    def changed(self) -> bool:
        try:
            if self._file_identity() == self._identity:
                return False
            reopen(*self.store.reference)
        except (OSError, StoreError):
            return True
        self._identity = self._file_identity()
        return False

    def _file_identity(self) -> tuple[int, ...]:
        status = os.stat(self.store.path / DATASET_FILE)
        return status.st_ino, status.st_size, status.st_mtime_ns

    @override
    def _nearest(self, name: str, kind: str) -> str:
        return nearest(name, self._by_name, "name" if "or" in kind else kind, self.store.path)

    def _drawable(self, field: str) -> str:
        """Return the name of a field that can be drawn; UsageError for another one."""
        if field not in self.readers:
            if field in self.store.fields and self.store.field(field).kind == "motion":
                motion_reader(self.store, field)  # raises the reason
            fix = did_you_mean(field, list(self.readers))
            raise UsageError("this field cannot be drawn", where=str(self.store.path), found=field, fix=fix)
        return field

    def _drawn(self, item: Item) -> str | None:
        """Return the field that an item is drawn by: that of these scenes, or another where its clip lacks it."""
        name, clip = self.field, item.clip.id
        if name is None or name in self.store[clip]:
            return name
        return next((other for other in self.readers if (other in self.store[clip])), name)

    def _rows(self, item: Item, field: str) -> npt.NDArray[Any]:
        if item.window is None:
            return self.store[item.clip.id].read(field)
        return self.store.read(item.window, field)

    def _figure(self, item: Item, name: str | None, first_s: float | None) -> tuple[Figure | None, str]:
        if name is None:
            fields = [f for f in self.store.fields if self.store.field(f).kind == "motion"]
            return None, f"no figure: {', '.join(fields) or 'no field'} holds neither rotations nor joint positions"
        if name not in self.store[item.clip.id]:
            return None, f"no figure: the clip was kept without {name}"
        try:
            return Figure.of_columns(self._first(item, name, first_s), self.readers[name]), ""
        except DataError as error:
            return None, f"no figure: {error}"

    def _first(self, item: Item, field: str, seconds: float | None) -> npt.NDArray[Any]:
        """Return the rows of the first seconds of an item; all of them for None."""
        rows = self._rows(item, field)
        return rows if seconds is None else rows[: max(1, round(seconds * float(self.store.field(field).rate)))]

    def _movement(self, item: Item, figure: Figure | None, first_s: float | None) -> Movement | None:
        for name in self.store.fields:
            stored = self.store.field(name)
            is_lodge = stored.kind == "keymotion" and stored.columns.names == ("speed", "minimum", "prominence")
            if is_lodge and name in self.store[item.clip.id]:
                return Movement.of(KeyMotion.from_rows(self._first(item, name, first_s)), stored.grid, name)
        return None if figure is None or figure.n_frames < 2 else figure.movement

    def _rhythm(self, item: Item) -> Rhythm:
        name = self._rhythm_field
        if name is None:
            return Rhythm.none()
        if item.window is not None:
            return rhythm_of(self._rows(item, name), self.store.field(name))
        lead, rows = self.store[item.clip.id].rows_within(name)
        return rhythm_of(rows, self.store.field(name), lead)

    @override
    def windows_of(self, item: Item) -> tuple[tuple[int, int], ...]:
        if item.window is not None:
            return ((0, item.n_frames),)
        return tuple((window.start, window.length) for window in self.store[item.clip.id].windows())

    def _flags_of(self, item: Item) -> tuple[Flag, ...]:
        begin, length = float(self.store.grid.seconds(item.start)), float(self.store.grid.seconds(item.n_frames))
        flags = []
        for row in self._quality.get(item.clip.id, ()):
            flag = _flag(row, begin)
            if flag.time is None or 0 <= flag.time < length:
                flags.append(flag)
        return tuple(flags)

    def _words_of(self, item: Item) -> list[Word]:
        """Return the segments of an item, without the quality flags; at most `_MOST_WORDS` of a layer."""
        words: dict[int, list[Word]] = {}
        window = Window(item.clip.id, item.start, item.n_frames)
        layers = {layer: number for number, layer in enumerate(self.store.layers)}
        for placed in self.store.segments(window):
            segment, number = placed.segment, layers[placed.segment.layer]
            if segment.layer.name == "quality" or len(words.get(number, ())) == _MOST_WORDS:
                continue
            name = " ".join(filter(None, (segment.layer.name, segment.layer.language)))
            text = segment.texts[0] if segment.texts else segment.label
            begin, end = (float(self.grid.seconds(frame)) for frame in (placed.start, placed.end))
            member = -1 if segment.whole or not item.clip.group else item.clip.member
            words.setdefault(number, []).append(Word(name, begin, end, shown(text, MAX_NAME), member))
        return [word for number in sorted(words) for word in words[number]]

    def _group(self, members: tuple[Item, ...]) -> Item:
        first = members[0]
        source = self.store[first.clip.source].group if first.clip.source else ""
        n_source = self.store.group_sizes.get(first.clip.group, len(members))
        return replace(first, members=members, n_source=n_source, source=source)

    def _group_scene(self, item: Item, name: str | None, first_s: float | None) -> Scene:
        members = tuple(self.scene(member, name, first_s=first_s) for member in item.members)
        figures = [scene.figure for scene in members if scene.figure is not None]
        together, notes = None, list(dict.fromkeys(note for scene in members for note in scene.notes))
        if item.n_source > len(members):
            numbers = listed([member.part for member in item.members], 12)
            notes.append(f"{len(members)} of {item.n_source} dancers are stored: {numbers}; the others were left out")
        if len(figures) == len(members):
            together = GroupScene.of(figures)
            if not together.touch:
                notes.append("contacts and collisions are not measured: the body has other joints than SMPL")
        windows, rhythm = members[0].windows, members[0].rhythm
        places = {member.item.clip.member: place for place, member in enumerate(members)}
        words = dict.fromkeys(
            replace(word, member=places.get(word.member, -1)) for member in members for word in member.words
        )
        ordered = tuple(sorted(words, key=lambda word: word.layer))
        return Scene(
            item,
            self.grid,
            name or "",
            None,
            None,
            rhythm,
            windows,
            (),
            tuple(notes),
            members,
            together,
            words=ordered,
        )

    @cached_property
    def _quality(self) -> dict[str, list[Mapping[str, Any]]]:
        flags: dict[str, list[Mapping[str, Any]]] = {}
        for row in self.store.quality:
            flags.setdefault(row["clip"], []).append(row)
        return flags


def _flag(row: Mapping[str, Any], begin: float) -> Flag:
    """Return the flag of a line of quality.jsonl; its frame is one of the source."""
    frame, rate = row.get("frame"), row.get("rate")
    try:
        time = None if frame is None or rate is None else float(frame / as_rate(str(rate))) - begin
    except (UsageError, OverflowError):
        time = None  # not a rate, or a frame beyond all time: the flag is shown as one of the whole clip
    return Flag(time, str(row.get("kind", "")), str(row.get("joint", "")), row.get("value", 0.0), row.get("unit", ""))


def _notes(store: Store, figure: Figure | None, problem: str, rhythm: Rhythm) -> list[str]:
    notes = [problem] if problem else []
    if figure is not None and not figure.contacts_stored:
        notes.append("contacts are not stored in this field: they were computed by the rule velocity")
    if not rhythm.field:
        audio = [name for name in store.fields if store.field(name).kind == "audio"]
        notes.append(f"no beats: {counted(len(audio), 'audio field')} of the dataset, none with a column beat")
    return notes
