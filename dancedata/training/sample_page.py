"""A page of samples of a model, each beside the truth of its window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Window
from dancedata.core.typing import override
from dancedata.store import Store
from dancedata.store.motion_fields import ColumnsReader
from dancedata.viewer.comparisons import Comparison
from dancedata.viewer.figure import Figure
from dancedata.viewer.page import clip_page
from dancedata.viewer.scene_list import Item, Scene
from dancedata.viewer.scenes import Scenes
from dancedata.viewer.wall import Wall


@dataclass(frozen=True, eq=False)
class WindowSample:
    """Columns (L, D) that a model generated for a window of the dataset."""

    window: Window
    columns: npt.NDArray[np.generic]


def sample_page(store: Store, field: str, reader: ColumnsReader, samples: Sequence[WindowSample], title: str) -> str:
    """Return a page with a wall for each sample: the dataset's dancer, and that of the model.

    `field`: Motion field of the truth.
    `reader`: Reader of the columns of samples, as they are normalised.
    """
    truth = _Windows(store, field, [sample.window for sample in samples], title)
    wall = Wall(truth, [_Generated(name="sample", samples=tuple(samples), reader=reader)], "truth")
    return clip_page(wall, wall.items)


class _Windows(Scenes):
    """Windows of a dataset, in the given order."""

    def __init__(self, store: Store, field: str, windows: Sequence[Window], title: str) -> None:
        super().__init__(store, field)
        self._windows, self._title = windows, title

    @override
    @cached_property
    def items(self) -> tuple[Item, ...]:
        clips = [self.store[window.clip].record for window in self._windows]
        return tuple(
            Item(number, clip, window.start, window.length, window, source=clip.source)
            for number, (clip, window) in enumerate(zip(clips, self._windows, strict=True))
        )

    @override
    def about(self) -> dict[str, Any]:
        frames = sum(item.n_frames for item in self.items)
        counts = {"clips": len(self.items), "windows": len(self.items)}
        hours = float(self.grid.seconds(frames)) / 3600
        return {**super().about(), "name": self._title, **counts, "hours": hours}


@dataclass(frozen=True, eq=False, kw_only=True)
class _Generated(Comparison):
    """The samples, by the numbers of their windows."""

    samples: tuple[WindowSample, ...]
    reader: ColumnsReader

    @override
    def figure(self, scene: Scene) -> Figure:
        return Figure.of_columns(self.samples[scene.item.number].columns, self.reader)
