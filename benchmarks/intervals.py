"""Coverage of the 95 % intervals of `dancedata evaluate`: share that holds the population's score.

    python benchmarks/intervals.py [--sets 4000]

Sets of 3 to 40 clips are drawn from populations shaped as scores are, and each gets the interval of `jackknife`, as
in `evaluate`. The score of a population is its mean; for FID and Div, which depend on the number of clips, the mean
over many sets of the same size, against a fixed pool. Prints the table of docs/reference/protocols.md;
seeds are fixed.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from dancedata.core.rotations import Float64Array
from dancedata.metrics.intervals import jackknife
from dancedata.metrics.set_statistics import SetScores

SIZES = (3, 5, 10, 20, 40)
Draw = Callable[[np.random.Generator, int], Float64Array]
#: Population, its mean, and the bounds of the score.
MEANS: Mapping[str, tuple[Draw, float, tuple[float, float]]] = {
    "normal (PBC)": (lambda rng, n: rng.normal(10, 5, n), 10, (-np.inf, np.inf)),
    "ratio, beta(8, 12) (BAS)": (lambda rng, n: rng.beta(8, 12, n), 0.4, (0, 1)),
    "small ratio, beta(0.6, 10) (FSR)": (lambda rng, n: rng.beta(0.6, 10, n), 0.6 / 10.6, (0, 1)),
    "log-normal, sigma 0.5 (PFC of one style)": (lambda rng, n: rng.lognormal(0, 0.5, n), np.exp(0.125), (0, np.inf)),
    "log-normal, sigma 1 (PFC)": (lambda rng, n: rng.lognormal(0, 1, n), np.exp(0.5), (0, np.inf)),
    "log-normal, sigma 2 (PFC with glitches)": (lambda rng, n: rng.lognormal(0, 2, n), np.exp(2), (0, np.inf)),
}
#: Features of a clip, and vectors in the pool.
WIDTH, POOL = 32, 300


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=4000, help="sets of each size; a tenth for FID and Div")
    n_sets = parser.parse_args().sets
    print("| scores of clips | " + " | ".join(f"{n} clips" for n in SIZES) + " |")
    print("|---|" + "---|" * len(SIZES))
    for name, (draw, mean, bounds) in MEANS.items():
        print(_line(name, [_of_mean(draw, mean, bounds, n, n_sets) for n in SIZES]), flush=True)
    for name, sigma in (("normal features", 0.0), ("log-normal features", 0.5)):
        found = [_of_sets(sigma, n, n_sets // 10) for n in SIZES]
        for score, label in (("fid_k", "FID"), ("div_k", "Div")):
            print(_line(f"{label}, {name}", [each[score] for each in found]), flush=True)


def _line(name: str, shares: list[float]) -> str:
    return f"| {name} | " + " | ".join(f"{100 * share:.1f}" for share in shares) + " |"


def _of_mean(draw: Draw, mean: float, bounds: tuple[float, float], n: int, n_sets: int) -> float:
    rng = np.random.default_rng(n)

    def score(rows: Float64Array) -> dict[str, float]:
        return {"mean": float(rows.mean())}

    found = [jackknife(draw(rng, n)[:, None], score, bounds=bounds).get("mean") for _ in range(n_sets)]
    return float(np.mean([each is not None and each.low <= mean <= each.high for each in found]))


def _features(rng: np.random.Generator, mixing: Float64Array, sigma: float, n: int) -> Float64Array:
    normal = rng.normal(size=(n, WIDTH)) @ mixing
    return np.exp(sigma * normal) if sigma else normal


def _of_sets(sigma: float, n: int, n_sets: int) -> dict[str, float]:
    rng = np.random.default_rng(n)
    mixing = rng.normal(size=(WIDTH, WIDTH)) / np.sqrt(WIDTH)
    draw = partial(_features, rng, mixing, sigma)
    pool = draw(POOL) + 0.2

    def scores(rows: Float64Array) -> dict[str, float]:
        return SetScores.of(rows, pool).named("k")

    many = [scores(draw(n)) for _ in range(4 * n_sets)]
    found = [jackknife(draw(n), scores, bounds=(0, np.inf)) for _ in range(n_sets)]
    covered = {}
    for name in ("fid_k", "div_k"):
        mean = np.mean([each[name] for each in many])
        inside = [name in each and each[name].low <= mean <= each[name].high for each in found]
        covered[name] = float(np.mean(inside))
    return covered


if __name__ == "__main__":
    main()
