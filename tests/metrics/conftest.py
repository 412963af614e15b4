"""The golden set `metrics`: what the published programs make of dances, see tests/golden/data/README.md."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
SHARED = ROOT.parent / "shared"


class GoldenMetrics:
    def __init__(self, folder: Path, whole: bool) -> None:
        self.folder, self.whole = folder, whole
        self.per_clip = self.json("per_clip")
        with np.load(folder / "inputs.npz") as file:
            self.inputs = dict(file)
        with np.load(folder / "features.npz") as file:
            self.features = dict(file)
        with np.load(folder / "fid_cases.npz") as file:
            self.fid_arrays = dict(file)
        self.sets, self.fid_cases = self.json("sets"), self.json("fid_cases")
        with np.load(folder / "beats.npz") as file:
            self.beats = dict(file)

    def json(self, name):
        return json.loads((self.folder / f"{name}.json").read_text())


@pytest.fixture(scope="session")
def golden_metrics():
    return GoldenMetrics(Path("/work/shared/golden/metrics"), True)
