"""Segments of samples: those that a window overlaps, or one text drawn from them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from dancedata.core.clip import Window
from dancedata.core.draw import Draw
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.segments import Layer
from dancedata.core.sided_words import mirrored_segment
from dancedata.core.text import listed
from dancedata.readers.arguments import probability
from dancedata.store.dataset import Store
from dancedata.store.segments import PlacedSegment

#: Stream of random numbers that choose texts; 1 to 6 are those of orders, mirroring, primitives, crops, dancers.
_TEXT_STREAM = 7
MirrorWords = Literal["error", "keep"]


@dataclass(frozen=True)
class SegmentChoice:
    """Arguments of readers about segments; see `WindowDataset`."""

    segments: bool | str = False
    min_share: float = 0.5
    empty: float = 0.0
    mirror_words: MirrorWords = "error"


class SegmentReader:
    """Reads the segments of windows, as pure functions of (seed, epoch, index)."""

    def __init__(self, store: Store, choice: SegmentChoice, *, mirrors: bool, seed: int) -> None:
        """Check the arguments; `mirrors` tells whether samples may be mirrored.

        Raises
        ------
        UsageError
            For an unknown layer, one without texts, and one whose words in mirrored windows are not known.
        """
        self._choice, self._seed = choice, seed
        self._min_share = probability("min_share", choice.min_share)
        self._empty = probability("empty", choice.empty)
        if choice.mirror_words not in ("error", "keep"):
            fix = did_you_mean(str(choice.mirror_words), ("error", "keep"))
            raise UsageError(f"unknown mirror_words {choice.mirror_words!r}", fix=fix)
        self.layer = choice.segments if isinstance(choice.segments, str) else None
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

    def placed(self, store: Store, window: Window, mirrored: bool) -> list[PlacedSegment]:
        """Return the segments that a window overlaps, in the words of a mirrored dancer where it is mirrored."""
        placed = store.segments_in(window, self.layer)
        if not mirrored:
            return placed
        return [
            p._replace(segment=mirrored_segment(p.segment, self._joints)) if p.segment.can_be_mirrored else p
            for p in placed
        ]

    def text(self, placed: Iterable[PlacedSegment], *key: int) -> str:
        """Return one text of a window; "" without one, and for the share `empty` of windows.

        Drawn by their shares from the segments that cover at least `min_share` of the window, then from their texts.
        `key` are epoch, index, and the dancer of a group.
        """
        draw = Draw(self._seed, _TEXT_STREAM, *key)
        is_empty = draw.uniform() < self._empty
        candidates = [p for p in placed if p.segment.texts and p.share >= self._min_share]
        if is_empty or not candidates:
            return ""
        place = draw.uniform(0.0, sum(p.share for p in candidates))
        for chosen in candidates:
            place -= chosen.share
            if place < 0:
                break
        return chosen.segment.texts[draw.below(len(chosen.segment.texts))]

    def values(
        self, store: Store, windows: Sequence[Window], mirrored: Sequence[bool], epoch: int, places: Sequence[int]
    ) -> dict[str, list[Any]]:
        """Return ``{"text": ...}`` or ``{"segments": ...}`` of the samples at `places`, (B,)."""
        placed = [self.placed(store, *sample) for sample in zip(windows, mirrored, strict=True)]
        if not self.draws:
            return {"segments": placed}
        return {"text": [self.text(p, epoch, place) for p, place in zip(placed, places, strict=True)]}

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
        own: list[list[Any]] = []
        whole: list[Any] = []
        for windows, flag, place in zip(groups, mirrored, places, strict=True):
            of_dancers = [self.placed(store, window, flag) for window in windows]
            of_group = [p for p in of_dancers[0] if p.segment.whole]
            of_dancers = [[p for p in placed if not p.segment.whole] for placed in of_dancers]
            of_dancers += [[] for _ in range(persons - len(windows))]
            if self.draws:
                own.append([self.text(p, epoch, place, 1 + k) for k, p in enumerate(of_dancers)])
                whole.append(self.text(of_group, epoch, place, 0))
            else:
                own.append(of_dancers)
                whole.append(of_group)
        name = "text" if self.draws else "segments"
        return {name: own, f"{name}_group": whole}


def _unmirrored(store: Store, layers: Sequence[Layer]) -> UsageError:
    named = listed(f"{layer.name} ({layer.language or 'no language'})" for layer in layers)
    return UsageError(
        "samples may be mirrored, and it is not known what their words are then",
        where=str(store.path),
        found=f"layer {named}: may name sides, and has no mirrored words",
        fix="build with the language of the words, or a lexicon; or read them as they are with mirror_words='keep'",
    )
