"""Segments of samples: those that a window overlaps, or one text drawn from them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from dancedata.core.clip import Window
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.segments import Layer, Segment
from dancedata.core.sided_words import mirrored_segment
from dancedata.core.text import listed
from dancedata.store.dataset import Store
from dancedata.store.stored_segments import PlacedRow, PlacedSegment
from dancedata.torch.draws import uniform
from dancedata.torch.options import Segments, Text

#: Streams of random numbers: whether a text is empty, its segment, the text; 1 to 6 are those of orders, mirroring,
#: primitives, augmentations, crops, dancers.
_EMPTY_STREAM, _SEGMENT_STREAM, _TEXT_STREAM = 7, 8, 9
#: Numbers of each stream for the dancers of a group and the group itself.
_SLOTS = 1024


class SegmentReader:
    """Reads the segments of windows, as pure functions of (seed, epoch, index)."""

    def __init__(self, store: Store, choice: Text | Segments, *, mirrors: bool, seed: int) -> None:
        """Check the arguments; UsageError for an unknown layer, or words of mirrored windows that are not known."""
        self._seed = seed
        text = choice if isinstance(choice, Text) else None
        self.layer = None if text is None else text.layer
        self._min_share, self._empty = (0.0, 0.0) if text is None else (text.min_share, text.empty)
        layers = store.layers
        if self.layer is not None and all(layer.name != self.layer for layer in layers):
            fix = did_you_mean(self.layer, sorted({layer.name for layer in layers}))
            raise UsageError(f"no layer named {self.layer!r}", where=str(store.path), fix=fix)
        self._joints = store.skeleton.other_side
        unknown = [layer for layer in layers if self.layer in (None, layer.name) and layer.sided == "unknown"]
        if mirrors and unknown and choice.mirror_words == "error":
            raise _unmirrored(store, unknown)

    @property
    def draws(self) -> bool:
        """Whether samples have a drawn text, and not all segments."""
        return self.layer is not None

    def placed(self, rows: Iterable[PlacedRow], mirrored: bool) -> list[PlacedSegment]:
        """Return segments, in the words of a mirrored dancer where the window is mirrored."""
        return [PlacedSegment(self._said(row, mirrored), row.start, row.end, row.share) for row in rows]

    def text(self, rows: Iterable[PlacedRow], mirrored: bool, numbers: Sequence[float]) -> str:
        """Return a text of a window, drawn by shares of its segments; "" without one, and for the share `empty`."""
        candidates = [row for row in rows if row.n_texts and row.share >= self._min_share]
        if numbers[0] < self._empty or not candidates:
            return ""
        place = numbers[1] * sum(row.share for row in candidates)
        for chosen in candidates:
            place -= chosen.share
            if place < 0:
                break
        return self._said(chosen, mirrored).texts[int(numbers[2] * chosen.n_texts)]

    def _drawn(self, epoch: int, places: Sequence[int]) -> list[list[float]]:
        """Return three numbers in [0, 1) for each of some places of the streams."""
        streams = (_EMPTY_STREAM, _SEGMENT_STREAM, _TEXT_STREAM)
        numbers = [uniform(self._seed, stream, epoch, places).tolist() for stream in streams]
        return [list(of_place) for of_place in zip(*numbers, strict=True)]

    def _said(self, row: PlacedRow, mirrored: bool) -> Segment:
        segment = row.load()
        return mirrored_segment(segment, self._joints) if mirrored and segment.can_be_mirrored else segment

    def values(
        self, store: Store, windows: Sequence[Window], mirrored: Sequence[bool], epoch: int, places: Sequence[int]
    ) -> dict[str, list[Any]]:
        """Return ``{"text": ...}`` or ``{"segments": ...}`` of the samples at `places`, (B,)."""
        samples = [
            (store._segment_rows_in(window, self.layer), flag) for window, flag in zip(windows, mirrored, strict=True)
        ]
        if not self.draws:
            return {"segments": [self.placed(*sample) for sample in samples]}
        drawn = self._drawn(epoch, places)
        return {"text": [self.text(*sample, numbers) for sample, numbers in zip(samples, drawn, strict=True)]}

    def group_values(
        self,
        store: Store,
        groups: Sequence[Sequence[Window]],
        mirrored: Sequence[bool],
        persons: int,
        epoch: int,
        places: Sequence[int],
    ) -> dict[str, list[Any]]:
        """Return the values of each dancer of groups, lists of `persons`, and of the whole groups; see `values`."""
        alone: list[list[Any]] = []
        whole: list[Any] = []
        for windows, flag, place in zip(groups, mirrored, places, strict=True):
            of_dancers = [store._segment_rows_in(window, self.layer) for window in windows]
            of_group = [row for row in of_dancers[0] if row.whole]
            of_dancers = [[row for row in rows if not row.whole] for rows in of_dancers]
            of_dancers += [[] for _ in range(persons - len(windows))]
            if self.draws:
                drawn = self._drawn(epoch, [place * _SLOTS + slot for slot in range(persons + 1)])
                alone.append([self.text(rows, flag, n) for rows, n in zip(of_dancers, drawn[1:], strict=True)])
                whole.append(self.text(of_group, flag, drawn[0]))
            else:
                alone.append([self.placed(rows, flag) for rows in of_dancers])
                whole.append(self.placed(of_group, flag))
        name = "text" if self.draws else "segments"
        return {name: alone, f"{name}_group": whole}


def _unmirrored(store: Store, layers: Sequence[Layer]) -> UsageError:
    named = listed(f"{layer.name} ({layer.language or 'no language'})" for layer in layers)
    return UsageError(
        "samples may be mirrored, and the words of mirrored ones are not known",
        where=str(store.path),
        found=f"layer {named}: may name sides, and has no mirrored words",
        fix="build with the language of the words, or a lexicon; or read them as they are with mirror_words='keep'",
    )
