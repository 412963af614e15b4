"""What the stages of `pipeline` read of repairs and of the rule `curate`."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

from dancedata.core.motion import Motion
from dancedata.core.text import listed
from dancedata.curation.repair import STAGES, UNITS, Repaired, repaired
from dancedata.curation.scores import MEASURES


@dataclass(frozen=True)
class Repairs:
    """Which repairs, and above which limit; None for those that are not made.

    `original`: Whether the motion as it was is stored beside the repaired one.
    """

    spikes: float | None = None
    gaps: float | None = None
    floor: float | None = None
    smoothing: float | None = None
    original: bool = True

    def __bool__(self) -> bool:
        return bool(self.key())

    def key(self) -> dict[str, float]:
        """Return what decides the numbers, for keys of the cache."""
        return {name: getattr(self, name) for name in STAGES if getattr(self, name) is not None}

    def apply(self, motion: Motion) -> Repaired:
        """Make the repairs."""
        return repaired(motion, self.key())


@dataclass(frozen=True)
class CurateRule:
    """What is left out for one score.

    `score`: A key of `MEASURES`.
    `limit`: Values above it are a fault.
    `leave_out`: The windows that touch such a span, or the clip.
    `splits`: Splits that are curated; None for all.
    """

    score: str
    limit: float
    leave_out: Literal["windows", "clip"]
    splits: tuple[str, ...] | None = None

    def applies_to(self, split: str) -> bool:
        """Whether clips of a split are curated."""
        return self.splits is None or split in self.splits


@dataclass(frozen=True)
class CurationSpec:
    """What a recipe asks for; empty by default."""

    rules: tuple[CurateRule, ...] = ()
    repairs: Repairs = Repairs()  # noqa: RUF009 (frozen)

    def notes(self, splits: Collection[str]) -> list[str]:
        """Return notes on a source with these splits: what is left out, where no clip is, and what is repaired."""
        notes = []
        for rule in self.rules:
            what = "clips with" if rule.leave_out == "clip" else "windows with"
            where = "" if rule.splits is None else f" of {', '.join(rule.splits)}"
            unit = MEASURES[rule.score].unit
            notes.append(
                f"left out{where}: {what} {rule.score} above {rule.limit:g} {'' if unit == '1' else unit}".strip()
            )
            absent = sorted(set(rule.splits or ()) - set(splits))
            if absent:
                known = listed(sorted(splits))
                notes.append(f"rules.curate.{rule.score}.splits: no clip is in {listed(absent)}, of {known}")
        if self.repairs:
            stages = ", ".join(f"{name} ({limit:g} {UNITS[name]})" for name, limit in self.repairs.key().items())
            kept = "; fields NAME.original have the motion as it was" if self.repairs.original else ""
            notes.append(f"repaired: {stages}; every frame that was changed has a quality flag{kept}")
        return notes
