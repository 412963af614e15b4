"""Other motions of a dataset's clips, to compare with."""

from abc import ABC, abstractmethod
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.errors import DanceDataError, DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.rotations import Float64Array
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import listed
from dancedata.core.typing import override
from dancedata.kernel import Scaler, Store, make_named, open_store
from dancedata.scene.figure import Figure
from dancedata.scene.inputs.files import FileClip, FileFormat
from dancedata.scene.inputs.naming import motion_files
from dancedata.scene.like import scaling_of
from dancedata.scene.payload import Json, curve, figure_payload
from dancedata.scene.poses import ColumnsReader
from dancedata.scene.scene_list import Item, Scene, SceneList, begins_after
from dancedata.scene.scenes import Scenes
from dancedata.scene.source import ClipSource


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison(ABC):
    """Another motion of clips, by a name for the page."""

    name: str

    @abstractmethod
    def figure(self, scene: Scene) -> Figure:
        """Return the motion of a scene's item, from the same first frame; DataError if there is none."""

    def has(self, item: Item) -> bool:
        """Return whether there may be a motion of an item, by its name."""
        return True

    @property
    def held(self) -> str:
        """The first names that it has, for messages."""
        return ""


@dataclass(frozen=True, eq=False, kw_only=True)
class OriginalComparison(Comparison):
    """The motion that a clip was built from."""

    source: ClipSource
    name: str = "original"

    @override
    def figure(self, scene: Scene) -> Figure:
        return self.source.original(scene, scene.item)


@dataclass(frozen=True, eq=False, kw_only=True)
class ItemComparison(Comparison):
    """Another clip of the same dataset: of one song at the same second of it, else both from their first frame."""

    scenes: SceneList
    item: Item

    @override
    def figure(self, scene: Scene) -> Figure:
        figure = self.scenes.scene(self.item).figure
        return _from(figure, self.name, begins_after(scene.item, scene.grid, self.item, scene.grid), scene)


@dataclass(frozen=True, eq=False, kw_only=True)
class StoreComparison(Comparison):
    """Clips of the same ids in another dataset, at the same second of their song."""

    scenes: Scenes

    @property
    @override
    def held(self) -> str:
        return listed([item.id for item in self.scenes.items], 3)

    @override
    def has(self, item: Item) -> bool:
        return any(self.scenes.has(one.clip.id) for one in item.members or (item,))

    @override
    def figure(self, scene: Scene) -> Figure:
        try:
            named = self.scenes.items_of(scene.item.clip.id)
        except UsageError as error:
            raise DataError(f"{self.name} has no clip of this name", reason="missing_file") from error
        later = [(begins_after(scene.item, scene.grid, item, self.scenes.grid), item) for item in named]
        within = (one for one in later if 0 <= one[0] < self.scenes.grid.seconds(one[1].n_frames))
        begin, compared = next(within, later[0])
        return _from(self.scenes.scene(compared).figure, self.name, begin, scene)


def _from(figure: Figure | None, name: str, begin: Fraction, scene: Scene) -> Figure:
    """Return the part of a figure beside a scene that begins later, by seconds; DataError if it begins earlier."""
    if figure is None:
        raise DataError(f"{name} has no joint positions", reason="missing_joints")
    if begin < 0:
        raise DataError(f"{name} begins {float(-begin):g} s later in the song", reason="too_short")
    return figure.part(float(begin), scene.seconds)


@dataclass(frozen=True, eq=False, kw_only=True)
class FilesComparison(Comparison):
    """Motion files that are named as clips, or a single file for any clip."""

    paths: dict[str, Path]
    any_clip: Path | None
    form: FileFormat
    body: Skeleton

    @property
    @override
    def held(self) -> str:
        return listed(sorted(path.name for path in self.paths.values()), 3)

    @override
    def has(self, item: Item) -> bool:
        named = any(name in self.paths for one in item.members or (item,) for name in (one.id, one.clip.id))
        return self.any_clip is not None or named

    @override
    def figure(self, scene: Scene) -> Figure:
        item = scene.item
        path_of_item = self.paths.get(item.id)
        path = path_of_item or self.paths.get(item.clip.id) or self.any_clip
        if path is None:
            raise DataError(f"{self.name} has no file for this clip", reason="missing_file")
        whole = Figure.of_pose(FileClip(id=item.id, path=path, format=self.form).pose(), self.body, path)
        # A file of a window begins with the window; one of a clip, with the clip.
        begin = 0.0 if path_of_item is not None or path == self.any_clip else float(scene.grid.seconds(item.start))
        return whole.part(begin, scene.seconds)


def file_format(
    store: Store | None,
    *,
    grid: FrameGrid | None = None,
    field: str | None = None,
    normalized: bool | None = None,
    scaler: Scaler | str | Path | None = None,
    clamp: bool = False,
    fps: str | None = None,
    up: str = "y",
    unit: str | None = None,
) -> FileFormat:
    """Return the format in which files of motion are read."""
    grid = grid or (None if store is None else store.grid)
    rate = grid if fps is None else FrameGrid.of(fps)
    if field is None:
        return FileFormat(fps=None if rate is None else str(rate), up=up, unit=unit)
    name, _ = REPRESENTATIONS.split(field)
    plugin = make_named(REPRESENTATIONS, "motion", name, {})
    stored = store is not None and field in store.fields
    if fps is None:
        of_field = store.field(field).grid if store is not None and stored else None
        rate = of_field or (None if plugin.rate is None else FrameGrid(plugin.rate)) or grid
    if rate is None:
        raise UsageError(f"the frame rate of columns of {field} is unknown",
                         fix="give it: fps= or like=", options="give it: --fps RATE or --like DATASET")  # fmt: skip
    like = store if stored or normalized else None
    scaling = scaling_of(like, field, plugin.columns.labels, normalized=normalized, scaler=scaler, clamp=clamp)
    return FileFormat(fps=str(rate), up=up, unit=unit, columns=ColumnsReader(plugin, rate, scaling))


def comparison_of(path: Path, scenes: SceneList, form: FileFormat) -> Comparison:
    """Return the comparison of scenes with a path: another dataset, a folder of motion files, or one file."""
    if (path / "dataset.json").is_file():
        return StoreComparison(scenes=Scenes(open_store(path)), name=path.name)
    files = motion_files(path, "compare with")
    paths = {file.stem: file for file in files}
    any_clip = None if len(files) > 1 or path.is_dir() or scenes.has(files[0].stem) else files[0]
    if form.columns is not None:  # UsageError where their scaling is not stated, or is clearly another one
        with suppress(DataError):  # which is a note on the page
            FileClip(id=files[0].stem, path=files[0], format=form).pose()
    return FilesComparison(paths=paths, any_clip=any_clip, form=form, body=scenes.body, name=path.name)


def comparison_payload(comparison: Comparison, scene: Scene) -> Json:
    """Return a comparison for the page: its figure and the distance, or a note with the reason."""
    if not scene.members:
        return _compared(comparison, scene)[0]
    compared = [_compared(comparison, member) for member in scene.members]
    distances = [distance for _, distance in compared if distance is not None]
    notes: dict[str, list[str]] = {}
    for member, (payload, _) in zip(scene.members, compared, strict=True):
        if "note" in payload:
            notes.setdefault(payload["note"], []).append(member.item.part)
    texts = [f"{note} (dancers {', '.join(dancers)})" for note, dancers in notes.items()]
    payload = {"members": [payload for payload, _ in compared], "note": "; ".join(texts)}
    if distances and scene.dancers[0].figure is not None:
        finite = np.isfinite(distances)
        sums = np.where(finite, distances, 0).sum(axis=0)
        mean = np.divide(sums, finite.sum(axis=0), out=np.full(sums.shape, np.nan), where=finite.any(axis=0))
        payload |= _distance(mean, scene.dancers[0].figure)
    return payload


def _compared(comparison: Comparison, scene: Scene) -> tuple[Json, Float64Array | None]:
    """Return the comparison of one dancer, and its distance (T,); None where there is none."""
    if scene.figure is None:
        return {"note": f"{comparison.name}: this clip has no figure to compare with"}, None
    try:
        figure = comparison.figure(scene)
    except DanceDataError as error:
        return {"note": f"{comparison.name}: {error}"}, None
    drawn = figure
    if scene.figure.mesh is not None:
        with suppress(UsageError):  # where rotations are unknown
            drawn = figure.with_mesh(scene.figure.mesh)
    payload: dict[str, Any] = {"figure": figure_payload(drawn, turns=True)}
    distance = scene.figure.distance_mm(figure)
    if not np.isfinite(distance).any():
        return {**payload, "note": f"{comparison.name}: no joint name is in both, so there is no distance"}, None
    return payload | _distance(distance, scene.figure), distance


def _distance(distance: Float64Array, figure: Figure) -> Json:
    ends = int(np.flatnonzero(np.isfinite(distance))[-1]) + 1  # after the other's end there is no distance, not 0
    mean = round(float(distance[np.isfinite(distance)].mean()), 4)
    return {"distance": curve(distance[:ends], float(figure.grid.rate)), "mean": mean}
