"""A page of samples of a model, each beside the truth of its window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dancedata.core.typing import override
from dancedata.kernel import Sample, Store
from dancedata.scene.comparisons import Comparison
from dancedata.scene.figure import Figure
from dancedata.scene.page import clip_page
from dancedata.scene.poses import ColumnsReader
from dancedata.scene.scene_list import Scene
from dancedata.scene.wall import Wall
from dancedata.scene.windows import SampleScenes


@dataclass(frozen=True, eq=False)
class Generated:
    """Columns (L, D) that a model generated for a sample of the dataset."""

    of: Sample
    columns: npt.NDArray[np.generic]


def sample_page(store: Store, field: str, reader: ColumnsReader, samples: Sequence[Generated], title: str) -> str:
    """Return a page with a wall for each sample: the dataset's dancer, and that of the model."""
    truth = SampleScenes(store, field, [sample.of for sample in samples], title)
    wall = Wall(truth, [_Generated(name="sample", samples=tuple(samples), reader=reader)], "truth")
    return clip_page(wall, wall.items)


@dataclass(frozen=True, eq=False, kw_only=True)
class _Generated(Comparison):
    """The samples, by the numbers of their windows."""

    samples: tuple[Generated, ...]
    reader: ColumnsReader

    @override
    def figure(self, scene: Scene) -> Figure:
        return Figure.of_columns(self.samples[scene.item.number].columns, self.reader)
