"""Metrics in the first set of reference outputs (`peers`): EDGE, AIST++ API, Bailando, Lodge."""

import json
from typing import Any

import numpy as np
import pytest

from dancedata.core.dance import Dance, MusicBeats
from dancedata.core.grid import FrameGrid
from dancedata.metrics import beat_alignment, geometric, motion_beats, pfc, rooted, skating
from dancedata.metrics.beats import BeatAlignment
from dancedata.metrics.kinetic_features import KINETIC_VARIANTS

#: The README's gate for features, PFC, beat alignment and skating.
GATE = 1e-5


def _clips(metrics_golden: Any, kind: str) -> dict[str, np.ndarray]:
    found = {key.split("/")[1]: joints for key, joints in metrics_golden.joints.items() if key.startswith(kind)}
    return {name: joints.astype(np.float64) for name, joints in found.items()}


def test_pfc(peers: Any, metrics_golden: Any) -> None:
    if peers.whole != metrics_golden.whole:
        return  # both compact, or both whole
    values = json.loads((peers / "pfc_edge.json").read_text())
    # The joints of `metrics` differ by up to 1e-6 m from these, of which the compact set has some frames only.
    own = {name: peers.load("fk_smpl24.npz")[f"{name}.zup30"] for name in values} if peers.whole else {}
    clips = own or _clips(metrics_golden, "smpl24_zup30")
    found = {name: pfc(joints, 30, variant="code", up="z") for name, joints in clips.items()}
    assert found == pytest.approx({name: values[name] for name in found}, rel=GATE)
    assert len(found) == (6 if peers.whole else 1)


def test_features(peers: Any, metrics_golden: Any) -> None:
    if peers.whole != metrics_golden.whole:
        return  # both compact, or both whole
    arrays = peers.load("aistpp_features.npz")
    compared = 0
    for name, joints in _clips(metrics_golden, "smpl24_yup60").items():
        if f"{name}.kinetic" not in arrays:
            continue
        for kind, root in (("", "absolute"), ("_zero", "zero_start")):
            positions = rooted(joints[:600], root)  # type: ignore[arg-type]
            found = KINETIC_VARIANTS["code"](positions, 60)
            np.testing.assert_allclose(found, arrays[f"{name}.kinetic{kind}"], rtol=GATE, atol=1e-9)
            manual = arrays[f"{name}.manual{'_new' if kind else ''}{kind}"]
            np.testing.assert_allclose(geometric(positions), manual, rtol=GATE)
            compared += 1
    assert compared == (12 if peers.whole else 2)


def test_bailandos_beats(peers: Any, metrics_golden: Any) -> None:
    if peers.whole != metrics_golden.whole:
        return  # both compact, or both whole
    arrays = peers.load("bas_bailando.npz")
    compared = 0
    for name, joints in _clips(metrics_golden, "smpl24_yup60").items():
        if f"{name}.score" not in arrays:
            continue
        beats, music = motion_beats(joints, 60, detector="bailando"), arrays[f"{name}.music_beats"]
        assert beats.tolist() == arrays[f"{name}.dance_beats"].tolist()
        assert beat_alignment(music, beats, sigma=3) == pytest.approx(float(arrays[f"{name}.score"]), rel=1e-9)
        compared += 1
    assert compared == (6 if peers.whole else 1)


def test_lodges_beats_and_feet(peers: Any, metrics_golden: Any) -> None:
    if peers.whole != metrics_golden.whole:
        return  # both compact, or both whole
    arrays, feet = peers.load("bas_lodge.npz"), json.loads((peers / "foot_skating_lodge.json").read_text())
    metric = BeatAlignment("bailando", "music", 3.0, "frames", "none")
    joints_of = _clips(metrics_golden, "smplx24_yup30")
    clips = {name: joints for name, joints in joints_of.items() if f"{name}.dance_beats" in arrays}
    assert len(clips) == (3 if peers.whole else 1)
    for name, joints in clips.items():
        assert motion_beats(joints, 30, detector="bailando").tolist() == arrays[f"{name}.dance_beats"].tolist()
        for which in ("wav", "feat"):
            music = MusicBeats.of(arrays[f"{name}.music_beats_{which}"], FrameGrid.of(30))
            found = metric.measure(Dance(joints, FrameGrid.of(30), music))[0]
            assert found == pytest.approx(float(arrays[f"{name}.score_{which}"]), rel=1e-9)
        assert skating(joints, 30, rule="lodge-code").ratios == pytest.approx(feet[name], abs=1e-6)
