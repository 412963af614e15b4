"""The columns of each field: ranges, quantiles, and columns that never change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dancedata.store import Store

__all__ = ["fields"]

#: Smaller ranges are those of a column that does not change.
_CONSTANT = 1e-6
_STRIP = ("min", "p5", "p25", "p50", "p75", "p95", "max")


def fields(store: Store) -> dict[str, Any]:
    """Return the section of the document, from stats.json: numbers over the rows that train windows cover."""
    stats: Mapping[str, Any] = store.stats["fields"]
    return {name: _field(store, name, stats.get(name)) for name in store.fields}


def _field(store: Store, name: str, stats: Mapping[str, Any] | None) -> dict[str, Any]:
    field = store.field(name)
    about = {
        "kind": field.kind,
        "width": field.columns.width,
        "rate": str(field.rate),
        "dtype": field.dtype,
        "axes": store.meta.get("axes", {}).get(name),
        "groups": [{"name": g.name, "width": g.width, "unit": g.unit} for g in field.columns.groups],
    }
    if stats is None:
        return {**about, "rows": 0, "constant": [], "columns": []}
    strips = [_strip(stats, j) for j in range(field.columns.width)]
    pairs = list(zip(field.columns.labels, strips, strict=True))
    labelled = [{"label": label, **strip} for label, strip in pairs]
    constant = [label for label, strip in pairs if strip["max"] - strip["min"] < _CONSTANT]
    return {**about, "rows": stats["n"], "constant": constant, "columns": labelled}


def _strip(stats: Mapping[str, Any], column: int) -> dict[str, float]:
    quantiles = stats["quantiles"]
    values: Sequence[Sequence[float]] = (
        stats["min"], *(quantiles[q] for q in ("0.05", "0.25", "0.5", "0.75", "0.95")), stats["max"]
    )  # fmt: skip
    return {name: float(own[column]) for name, own in zip(_STRIP, values, strict=True)}
