"""The dances of a dataset that samples are of, as scenes: each sample stands beside its truth."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy.typing as npt

from dancedata.core.sample_id import SampleId
from dancedata.core.typing import override
from dancedata.formats.values import MOTION_SUFFIXES
from dancedata.kernel import Sample, Store
from dancedata.samples import Samples
from dancedata.scene.inputs.naming import motion_paths
from dancedata.scene.scene_list import Item
from dancedata.scene.scenes import Scenes


class SampleScenes(Scenes):
    """What samples are of a dataset, mirrored where they are, in their order; groups are left out.

    `title`: Name for the page; "": that of the dataset.
    """

    def __init__(self, store: Store, field: str | None, samples: Sequence[Sample], title: str = "") -> None:
        super().__init__(store, field)
        self._samples, self._title = [sample for sample in samples if len(sample.clips) == 1], title

    @override
    @cached_property
    def items(self) -> tuple[Item, ...]:
        return tuple(
            Item(
                number, of.clip.record, of.start, of.length, of.windows[0], source=of.clip.source, sample=str(of.id)
            )
            for number, of in enumerate(self._samples)
        )  # fmt: skip

    @override
    def _rows(self, item: Item, field: str) -> npt.NDArray[Any]:
        rows, mirror = super()._rows(item, field), self.store.field(field).columns.mirror
        return rows if mirror is None or not self._samples[item.number].id.mirrored else mirror.apply(rows)

    @override
    def about(self) -> dict[str, Any]:
        frames = sum(item.n_frames for item in self.items)
        counts = {"clips": len(self.items), "windows": len(self.items)}
        about = {**super().about(), **counts, "hours": float(self.grid.seconds(frames)) / 3600}
        return about | ({"name": self._title} if self._title else {})


def samples_in(store: Store, paths: Sequence[Path]) -> list[Sample]:
    """Return what motion files, or those of folders, are of a dataset by their names, where one is more than a clip.

    Empty where all are named as whole clips. DataError "outside" for a window that is not within its clip.
    """
    files = [file for path in paths for file in motion_paths(path) if file.suffix.lower() in MOTION_SUFFIXES]
    finder = Samples(store)
    by_stem = {file.stem: sample for file in files if (sample := finder.find(file.stem)) is not None}
    return list(by_stem.values()) if any(of.id != SampleId(of.id.clip) for of in by_stem.values()) else []
