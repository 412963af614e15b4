"""Frechet distances and diversities of the published programs (golden set `metrics`), value by value."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.rotations import Float64Array
from dancedata.metrics.set_statistics import SetScores, frechet

#: Relative tolerances: programs in float64, in float32, and where sqrtm takes the root of a singular product.
FLOAT64, FLOAT32, SINGULAR = 1e-6, 1e-5, 1e-5

#: Program -> how it normalises, and what its windows are called.
PROGRAMS = {
    "bailando": ("numpy", "kinetic_bailando", "manual_bailando"),
    "fact": ("numpy", "kinetic_api", "manual_bailando"),
    "motius": ("numpy", "kinetic_bailando", "manual_bailando"),
    "megadance": ("torch", "kinetic_megadance", "geometric_megadance"),
    "flowerdance_normalise": ("flowerdance", "kinetic_megadance", "geometric_megadance"),
    "lodge": ("numpy", "kinetic_lodge", "manual_lodge"),
}


def _compare(key: str, found: float, wanted: float, n: int, width: int, dtype: str) -> None:
    singular = key.startswith("fid") and n <= width
    tolerance = max(FLOAT32 if dtype == "float32" else FLOAT64, SINGULAR if singular else 0)
    assert found == pytest.approx(wanted, rel=tolerance), key


def _score(scores: SetScores, key: str) -> float:
    kind, _, rest = key.partition("_")
    if kind == "fid":
        return scores.fid
    return scores.div_pool if rest.endswith("gt") else scores.div


@pytest.mark.parametrize("program", PROGRAMS)
@pytest.mark.parametrize("case", ["halves_even_odd", "pool_vs_40", "first_vs_second_half"])
def test_sets(case: str, program: str, metrics_golden: Any, shared: Path) -> None:
    if not metrics_golden.whole:
        return  # these sets have windows of real dances
    sets = metrics_golden.json("sets")
    given = sets["lodge"][case] if program == "lodge" else sets[case]
    statistics, *arrays = PROGRAMS[program]
    for array, letters in zip(arrays, ("k", "mg"), strict=True):
        windows = metrics_golden.features[f"windows/{array}"].astype(np.float64)
        scores = SetScores.of(windows[given["pred"]], windows[given["gt"]], statistics)
        compared = 0
        for dtype, values in given[program].items():
            # Bailando and Lodge: values, and what is left of their imaginary parts.
            for key, wanted in (values[0] if isinstance(values, list) else values).items():
                if key.split("_")[1] in letters:
                    n = min(len(given["pred"]), len(given["gt"]))
                    _compare(key, _score(scores, key), wanted, n, windows.shape[1], dtype)
                    compared += 1
        assert compared


@pytest.mark.parametrize("case", [
    "full", "rank_deficient", "tiny", "geo", "two", "gt_constant_column_pred_not", "both_constant_column",
    "constant_columns_differ",
])  # fmt: skip
def test_fid_cases(case: str, metrics_golden: Any) -> None:
    values_of = metrics_golden.json("fid_cases")
    if case not in values_of:
        assert not metrics_golden.whole
        return
    arrays = metrics_golden.arrays("fid_cases")
    pool, rows = (arrays[f"{case}.{name}"].astype(np.float64) for name in ("gt", "pred"))
    found = {name: SetScores.of(rows, pool, name) for name in ("numpy", "torch", "flowerdance")}
    for dtype, values in values_of[case].items():
        for key, wanted in values.items():
            value = wanted[0] if isinstance(wanted, list) else wanted
            kind, n = "fid" if "div" not in key else key, min(len(rows), len(pool))
            _compare(kind, _of(found, key, rows, pool), value, n, pool.shape[1], dtype)
        # FACT gives FID and Dist.
        assert found["numpy"].div == pytest.approx(values["fact"][1], rel=FLOAT32 if dtype == "float32" else FLOAT64)
    constant = case in ("gt_constant_column_pred_not", "both_constant_column", "constant_columns_differ")
    assert bool(found["numpy"].n_constant) == constant
    assert found["numpy"].fid_varying < 100


def _of(found: dict[str, SetScores], key: str, rows: Float64Array, pool: Float64Array) -> float:
    if key == "bailando_raw":
        return frechet(rows, pool)
    scores = found["torch" if "megadance" in key else "flowerdance" if "flowerdance" in key else "numpy"]
    if "div" not in key:
        return scores.fid
    return scores.div_pool if key.endswith("gt") else scores.div
