"""Repairs of motion."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

from dancedata.core.registry import TRANSFORMS
from dancedata.core.text import listed
from dancedata.core.typing import override
from dancedata.curation.repair import LIMITS, STAGES, UNITS, VERSION, repaired
from dancedata.curation.scores import MEASURES, checked_limit
from dancedata.kernel import Scene, Transform


@TRANSFORMS.register("repair")
@dataclass(frozen=True)
class Repair(Transform):
    """Repairs spikes, gaps, the floor and jitter, in this order; every frame that is changed has a quality flag.

    Each repair is None (not made), True (with the limit in `curation.repair.LIMITS`) or a limit.

    Attributes
    ----------
    spikes
        Least size of a spike, metres.
    gaps
        Longest frozen span that is filled, seconds.
    floor
        Least drift of the floor, metres.
    smoothing
        Least jitter, metres.
    original
        Whether a second field, NAME.original, is stored beside each motion field: the motion before the repair.
    """

    version: ClassVar[int] = VERSION

    spikes: Any = None
    gaps: Any = None
    floor: Any = None
    smoothing: Any = None
    original: bool = True

    def __post_init__(self) -> None:
        for name, default in LIMITS.items():
            low = MEASURES["spikes"].least if name == "spikes" else 1e-6
            object.__setattr__(self, name, checked_limit(getattr(self, name), name, default, low))

    @cached_property
    def limits(self) -> dict[str, float]:
        """The repairs that are made, with their limits."""
        return {name: getattr(self, name) for name in STAGES if getattr(self, name) is not None}

    @property
    def moves(self) -> bool:  # type: ignore[override]
        """Whether any repair is made."""
        return bool(self.limits)

    @property
    def keeps_original(self) -> bool:  # type: ignore[override]
        """Whether the motion as it was is stored, too."""
        return self.original and bool(self.limits)

    @property
    def not_for_groups(self) -> str:  # type: ignore[override]
        """Why the floor of groups cannot be repaired."""
        return "" if self.floor is None else "each dancer would get a floor of their own (floor)"

    @override
    def scene(self, scene: Scene) -> Scene:
        done = [repaired(motion, self.limits) for motion in scene.motions]
        return scene.with_motions([d.motion for d in done], [d.flags for d in done])

    @override
    def key(self) -> list[Any]:
        return [self.name, self.version, self.limits]

    @override
    def notes(self, splits: Collection[str]) -> list[str]:
        if not self.limits:
            return []
        stages = listed(f"{name} ({limit:g} {UNITS[name]})" for name, limit in self.limits.items())
        kept = "; fields NAME.original have the motion as it was" if self.original else ""
        return [f"repaired: {stages}; every frame that was changed has a quality flag{kept}"]
