"""The keys `curate` and `repair` of a recipe: which clips and windows are left out, and what is repaired."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.text import listed, shown
from dancedata.curation.repair import STAGES, Repairs
from dancedata.curation.scores import MEASURES

LEAVE_OUT = ("windows", "clip")
_RULE_KEYS = ("limit", "leave_out", "splits")
#: Limit of each repair where a recipe has `true`.
REPAIR_LIMITS = {
    "spikes": MEASURES["spikes"].limit,
    "gaps": 0.5,
    "floor": MEASURES["floor_drift"].limit,
    "smoothing": MEASURES["jitter"].limit,
}
_UNITS = {"spikes": "m", "gaps": "s", "floor": "m", "smoothing": "m"}
_MAX = 1e6


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

    def document(self) -> dict[str, Any]:
        """Return JSON data."""
        splits = None if self.splits is None else list(self.splits)
        return {"limit": self.limit, "leave_out": self.leave_out, "splits": splits}


@dataclass(frozen=True)
class CurationSpec:
    """What a recipe asks for; empty by default."""

    rules: tuple[CurateRule, ...] = ()
    repairs: Repairs = Repairs()  # noqa: RUF009 (frozen)

    def document(self) -> dict[str, Any]:
        """Return the keys of a recipe, with every default."""
        return {"curate": {rule.score: rule.document() for rule in self.rules}, "repair": self.repairs.document()}

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
                notes.append(f"curate.{rule.score}.splits: no clip is in {listed(absent)}, of {known}")
        if self.repairs:
            stages = ", ".join(f"{name} ({limit:g} {_UNITS[name]})" for name, limit in self.repairs.key().items())
            kept = "; fields NAME.original have the motion as it was" if self.repairs.original else ""
            notes.append(f"repaired: {stages}; every frame that was changed has a quality flag{kept}")
        return notes


def parse_curation(curate: Any, repair: Any) -> CurationSpec:
    """Check the values of the keys `curate` and `repair`; UsageError for a wrong one."""
    return CurationSpec(_rules(curate), _repairs(repair))


def _rules(value: Any) -> tuple[CurateRule, ...]:
    if value is None:
        return ()
    if not isinstance(value, Mapping):
        raise UsageError(
            "curate: not a mapping of scores", found=shown(repr(value)), allowed="such as {spikes: true}"
        )
    rules = []
    for score, rule in value.items():
        if score not in MEASURES:
            raise UsageError(f"curate.{shown(str(score))}: unknown score", fix=did_you_mean(str(score), MEASURES))
        if rule is not False and rule is not None:
            rules.append(_rule(score, rule))
    order = list(MEASURES)
    return tuple(sorted(rules, key=lambda rule: order.index(rule.score)))


def _rule(score: str, value: Any) -> CurateRule:
    measure, where = MEASURES[score], f"curate.{score}"
    keys = {} if value is True else value if isinstance(value, Mapping) else {"limit": value}
    for key in keys:
        if key not in _RULE_KEYS:
            raise UsageError(f"{where}.{shown(str(key))}: unknown key", fix=did_you_mean(str(key), _RULE_KEYS))
    limit = _number(
        keys.get("limit", measure.limit), f"{where}.limit", low=-1 if measure.unit == "1" else measure.least
    )
    leave_out = keys.get("leave_out", "windows" if measure.of == "spans" else "clip")
    allowed = LEAVE_OUT if measure.of == "spans" else ("clip",)
    if leave_out not in allowed:
        raise UsageError(f"{where}.leave_out: not what can be left out for this score", found=shown(repr(leave_out)),
                         allowed=" or ".join(allowed))  # fmt: skip
    splits = keys.get("splits")
    splits = [splits] if isinstance(splits, str) else splits
    if splits is not None and not (
        isinstance(splits, Sequence) and splits and all(isinstance(s, str) for s in splits)
    ):
        raise UsageError(
            f"{where}.splits: must be a list of splits", found=shown(repr(splits)), allowed="such as [train]"
        )
    return CurateRule(score, limit, leave_out, None if splits is None else tuple(sorted(set(splits))))


def _repairs(value: Any) -> Repairs:
    if value is None:
        return Repairs()
    names = [*STAGES, "original"]
    if not isinstance(value, Mapping):
        raise UsageError(
            "repair: not a mapping of repairs", found=shown(repr(value)), allowed="such as {spikes: true}"
        )
    limits: dict[str, float | None] = {}
    for key, limit in value.items():
        if key not in names:
            raise UsageError(f"repair.{shown(str(key))}: unknown key", fix=did_you_mean(str(key), names))
        if key != "original" and limit is not False and limit is not None:
            low = MEASURES["spikes"].least if key == "spikes" else 1e-6
            limits[key] = REPAIR_LIMITS[key] if limit is True else _number(limit, f"repair.{key}", low=low)
    original = value.get("original", True)
    if not isinstance(original, bool):
        raise UsageError("repair.original: must be true or false", found=shown(repr(original)))
    return Repairs(**limits, original=original)


def _number(value: Any, where: str, low: float) -> float:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (is_number and low <= value <= _MAX):
        raise UsageError(
            f"{where}: must be true, or a number", found=shown(repr(value)), allowed=f"{low:g} to {_MAX:,.0f}"
        )
    return float(value)
