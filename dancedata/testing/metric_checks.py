"""The conformance check of metrics."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from dancedata.core.dance import OUTCOMES, Dance, Undefined
from dancedata.core.errors import UsageError
from dancedata.core.plugins import Metric
from dancedata.testing.examples import example_dances
from dancedata.testing.plugin_checks import check_plugin
from dancedata.testing.require import raises, require


def check_metric(cls: type[Metric]) -> None:
    """Check a metric: finite numbers or a named outcome, equal dances get equal numbers, scores, order of clips."""
    check_plugin(cls)
    made = cls()
    width = len(made.columns)
    require(bool(cls.source), "source says where the definition is from")
    require(width > 0 and len(set(made.columns)) == width, "every number of a clip has a name of its own")
    rows = [row for row in (_measured(made, dance) for dance in example_dances()) if row is not None]
    require(len(rows) >= 2, "ordinary dances have values")
    table = np.array(rows)
    before = table.copy()
    scores = made.summarise(table, table if cls.needs_pool else None)
    require(np.array_equal(table, before), "summarise does not write into the rows")
    require(bool(scores) and all(np.isfinite(value) for value in scores.values()), "scores are finite numbers")
    require(set(cls.better) <= scores.keys(), f"better names scores: {', '.join(scores)}")
    require(bool(cls.better), "better says what is better for a score")
    turned = made.summarise(table[::-1], table[::-1] if cls.needs_pool else None)
    close = scores.keys() == turned.keys() and all(np.isclose(turned[k], scores[k], atol=1e-9) for k in scores)
    require(close, "scores do not depend on the order of clips")
    if cls.needs_pool:
        raises(UsageError, lambda: made.summarise(table), "a metric that needs a pool asks for it")
    raises(Undefined, lambda: made.summarise(table[:0], table), "a set without clips is Undefined")


def _measured(made: Metric, dance: Dance) -> npt.NDArray[np.float64] | None:
    """Return the numbers of a dance, or None where they are undefined."""
    try:
        row = made.measure(dance)
    except Undefined as outcome:
        require(outcome.reason in OUTCOMES, f"outcomes are one of {', '.join(OUTCOMES)}")
        return None
    require(row.shape == (len(made.columns),), f"measure gives ({len(made.columns)},), not {row.shape}")
    require(row.dtype == np.float64, f"measure gives float64, not {row.dtype}")
    require(bool(np.isfinite(row).all()), "numbers are finite; where there is no value, measure raises Undefined")
    require(np.array_equal(made.measure(dance), row), "equal dances give equal numbers")
    return row
