"""Kinetic and geometric features of the published programs (golden set `metrics`), array by array."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dancedata.metrics.geometric_features import geometric
from dancedata.metrics.kinetic_features import KINETIC_VARIANTS
from dancedata.metrics.root import rooted

#: Kinds of input: 60 per second y up, every second frame of it, 30 per second z up, Lodge's SMPL-X.
UP60, UP30, Z30, LODGE = "smpl24_yup60", "smpl24_yup60::2", "smpl24_zup30", "smplx24_yup30"
#: FlowerDance turns its z-up data a quarter about z.
QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
#: Of stored float32 values; `_f32` arrays were computed of float32 joints.
EXACT, FLOAT32 = 1e-6, 1e-3


def _kinetic(
    variant: str, root: Any = "absolute", turn: np.ndarray | None = None
) -> Callable[[np.ndarray], np.ndarray]:
    def compute(joints: np.ndarray) -> np.ndarray:
        turned = joints if turn is None else joints @ turn
        return KINETIC_VARIANTS[variant](rooted(turned, root), 12345.0 if variant != "fixed" else 60.0)

    return compute


def _geometric(root: Any = "absolute", turn: np.ndarray | None = None) -> Callable[[np.ndarray], np.ndarray]:
    return lambda joints: geometric(rooted(joints if turn is None else joints @ turn, root))


#: Array of features.npz -> input, frames of it, relative tolerance, and what computes it.
ARRAYS: dict[str, tuple[str, int | None, float, Callable[[np.ndarray], np.ndarray]]] = {
    "kinetic_api": (UP60, None, EXACT, _kinetic("code")),
    "manual_api": (UP60, None, EXACT, _geometric()),
    "kinetic_bailando": (UP60, 1200, EXACT, _kinetic("code", "zero_start")),
    "manual_bailando": (UP60, 1200, EXACT, _geometric("zero_start")),
    "kinetic_bailando_f32": (UP60, 1200, FLOAT32, _kinetic("code", "zero_start")),
    "manual_bailando_f32": (UP60, 1200, FLOAT32, _geometric("zero_start")),
    "kinetic_gcd30": (UP30, None, EXACT, _kinetic("gcd-code")),
    "kinetic_gcd_fixed30": (UP30, None, EXACT, _kinetic("gcd-fixed")),
    "kinetic_megadance30": (UP30, None, EXACT, _kinetic("megadance", "zero_start")),
    "geometric_megadance30": (UP30, None, EXACT, _geometric("zero_start")),
    "kinetic_popdg_zup30": (Z30, None, EXACT, _kinetic("code")),
    "manual_popdg_zup30": (Z30, None, EXACT, _geometric()),
    "kinetic_flowerdance_zup30": (Z30, None, FLOAT32, _kinetic("flowerdance-code", turn=QUARTER)),
    "kinetic_flowerdance_zup30_exact": (Z30, None, EXACT, _kinetic("flowerdance-code", turn=QUARTER)),
    "geometric_flowerdance_zup30": (Z30, None, FLOAT32, _geometric(turn=QUARTER)),
    "geometric_flowerdance_zup30_exact": (Z30, None, EXACT, _geometric(turn=QUARTER)),
    "kinetic_lodge": (LODGE, 1024, EXACT, _kinetic("code", "root_relative")),
    "manual_lodge": (LODGE, 1024, EXACT, _geometric("root_relative")),
}
#: Arrays of windows -> names, input, frames, relative tolerance, and what computes a row.
WINDOWS = {
    "kinetic_api": ("names60", UP60, 60, 1, _kinetic("code")),
    "kinetic_bailando": ("names60", UP60, 60, 1, _kinetic("code", "zero_start")),
    "manual_bailando": ("names60", UP60, 60, 1, _geometric("zero_start")),
    "kinetic_megadance": ("names60", UP60, 60, 2, _kinetic("megadance", "zero_start")),
    "geometric_megadance": ("names60", UP60, 60, 2, _geometric("zero_start")),
    "kinetic_lodge": ("names_lodge", LODGE, 64, 1, _kinetic("code", "root_relative")),
    "manual_lodge": ("names_lodge", LODGE, 64, 1, _geometric("root_relative")),
}


def _input(golden: Any, kind: str, clip: str) -> np.ndarray:
    name, _, step = kind.partition("::")
    joints = golden.joints[f"{name}/{clip}"][:: int(step or 1)].astype(np.float64)
    return joints[:, :22] if kind == LODGE else joints


@pytest.mark.parametrize("array", ARRAYS)
def test_features_of_clips(array: str, metrics_golden: Any) -> None:
    kind, frames, tolerance, compute = ARRAYS[array]
    keys = [key for key in metrics_golden.features if key.startswith(f"{array}/")]
    for key in keys:
        joints = _input(metrics_golden, kind, key.split("/")[1])
        wanted = metrics_golden.features[key]
        found = compute(joints[:frames])[: len(wanted)]
        np.testing.assert_allclose(found, wanted, rtol=tolerance, atol=1e-9, err_msg=key)
    assert keys or not metrics_golden.whole


@pytest.mark.parametrize("array", WINDOWS)
def test_features_of_windows(array: str, metrics_golden: Any) -> None:
    names, kind, frames, step, compute = WINDOWS[array]
    compared = 0
    for name, wanted in zip(
        metrics_golden.features[f"windows/{names}"], metrics_golden.features[f"windows/{array}"], strict=True
    ):
        clip, _, start = str(name).partition("@")
        found = compute(_input(metrics_golden, kind, clip)[int(start) : int(start) + frames : step])
        np.testing.assert_allclose(found, wanted, rtol=EXACT, atol=1e-9, err_msg=str(name))
        compared += 1
    assert compared >= 13


def test_every_array_is_compared(metrics_golden: Any) -> None:
    keys = set(metrics_golden.features)
    names = {key.split("/")[0] for key in keys} - {"windows"}
    windows = {key.split("/")[1] for key in keys if key.startswith("windows/")} - {"names60", "names_lodge"}
    assert names <= ARRAYS.keys()
    assert windows <= WINDOWS.keys()
