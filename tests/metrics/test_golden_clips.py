"""Every number that the published programs give for single clips (golden set `metrics`), key by key."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from dancedata.core.dance import Dance, MusicBeats, Undefined
from dancedata.core.grid import FrameGrid
from dancedata.metrics.beats import BeatAlignment, motion_beats
from dancedata.metrics.foot_skating import skating
from dancedata.metrics.motius_physics import physics
from dancedata.metrics.physical_contact import pbc, pfc
from tests.messages import raises_message

# Relative; the README of the golden set gives these.
PFC, FLOAT32, BAS, BAS_FLOAT32 = 1e-6, 1e-4, 1e-9, 1e-6

FACT = BeatAlignment("fact", "motion", 3.0, "frames", "frames", no_motion_beats="zero")
BAILANDO = BeatAlignment("bailando", "music", 3.0, "frames", "steps")
POPDG = BeatAlignment("fact", "motion", 3.0, "frames", "none", clips=24)
GCD = BeatAlignment("gcd", "motion", 2.12, "frames", "frames")
MEGADANCE = BeatAlignment("bailando", "music", 3.0, "frames", "frames")
MOTIUS = BeatAlignment("seconds", no_motion_beats="zero", no_music_beats="zero")
LODGE = BeatAlignment("bailando", "music", 3.0, "frames", "none")


class Clip:
    """The inputs and the values of one clip."""

    def __init__(self, name: str, golden: Any) -> None:
        self.name, self.values, self._golden = name, golden.json("per_clip")[name], golden

    def joints(self, kind: str, step: int = 1) -> np.ndarray:
        return self._golden.joints[f"{kind}/{self.name}"][::step].astype(np.float64)

    def dance(self, joints: np.ndarray, fps: int, beats: Any, beat_fps: int | None = None) -> Dance:
        return Dance(joints, FrameGrid.of(fps), MusicBeats.of(beats, FrameGrid.of(beat_fps or fps)))

    def score(
        self, metric: BeatAlignment, joints: np.ndarray, fps: int, beats: Any, beat_fps: int | None = None
    ) -> float:
        return float(metric.measure(self.dance(joints, fps, beats, beat_fps))[0])

    up60 = property(lambda self: self.joints("smpl24_yup60"))
    up30 = property(lambda self: self.joints("smpl24_yup60", 2))
    z30 = property(lambda self: self.joints("smpl24_zup30"))
    lodge = property(lambda self: self.joints("smplx24_yup30"))
    bailando60 = property(lambda self: self._golden.beats[f"{self.name}.bailando60"])

    def slices(self) -> list[np.ndarray]:
        return [self.z30[start : start + 150] for start in self.values["slice_starts30"]]


def _slice_scores(clip: Clip) -> list[float | None]:
    found: list[float | None] = []
    for joints, beats in zip(clip.slices(), clip.values["music_beats_edge30_slices"], strict=True):
        still = not len(motion_beats(joints, 30, detector="bailando"))
        if still:
            with raises_message(Undefined, "beats"):
                clip.score(BAILANDO, joints, 30, beats)
        found.append(None if still else clip.score(BAILANDO, joints, 30, beats))
    return found


def _physics(joints: np.ndarray) -> dict[str, float]:
    found = physics(joints)
    return {
        "Jitter": found.jitter, "Dynamic": found.dynamic, "Penet": found.penetration, "Float": found.floating,
        "Slide": found.sliding,
    }  # fmt: skip


def _counts(joints: np.ndarray) -> list[int]:
    found = skating(joints, 30, rule="duolando", up="z")  # the program's axis, whatever the data's
    return [int(found.sliding[0]), int(found.counted[0])]


def _gmd(joints: np.ndarray) -> float:
    return skating(joints, 20, rule="gmd").ratio


#: Key of per_clip.json -> relative tolerance (0: equal), and what computes it.
VALUES: dict[str, tuple[float, Callable[[Clip], Any]]] = {
    "pfc_edge": (PFC, lambda c: pfc(c.z30, 30, variant="code", up="z")),
    "pfc_edge.f32": (FLOAT32, lambda c: pfc(c.z30, 30, variant="rescaled", up="z")),
    "pfc_flowerdance_code": (FLOAT32, lambda c: pfc(c.z30 @ _quarter_about_z(), 30, up="z")),
    "pfc_edge.slices": (PFC, lambda c: [pfc(s, 30, variant="code", up="z") for s in c.slices()]),
    "pbc_popdg": (PFC, lambda c: pbc(c.z30, 30, variant="code", up="z")),
    "pbc_popdg.slices": (PFC, lambda c: [pbc(s, 30, variant="code", up="z") for s in c.slices()]),
    "motion_beats_fact": (0, lambda c: motion_beats(c.up60, 60, detector="fact").tolist()),
    "motion_beats_bailando": (0, lambda c: motion_beats(c.up60, 60, detector="bailando").tolist()),
    "motion_beats_motius60": (0, lambda c: motion_beats(c.up60, 60).tolist()),
    "motion_beats_motius30": (0, lambda c: motion_beats(c.up30, 30).tolist()),
    "motion_beats_popdg": (0, lambda c: motion_beats(c.z30[:300], 30, detector="fact").tolist()),
    "motion_beats_gcd": (0, lambda c: motion_beats(c.z30, 30, detector="gcd").tolist()),
    "motion_beats_megadance": (0, lambda c: motion_beats(c.z30, 30, detector="bailando").tolist()),
    "motion_beats_lodge": (0, lambda c: motion_beats(c.lodge, 30, detector="bailando").tolist()),
    "bas_fact": (BAS_FLOAT32, lambda c: c.score(FACT, c.up60, 60, c.values["music_beats_fact60"])),
    "bas_bailando": (BAS, lambda c: c.score(BAILANDO, c.up60, 60, c.bailando60)),
    "bas_bailando_factbeats": (BAS, lambda c: c.score(BAILANDO, c.up60, 60, c.values["music_beats_fact60_cut"])),
    "bas_motius60": (BAS, lambda c: c.score(MOTIUS, c.up60, 60, c.bailando60)),
    "bas_motius30": (BAS, lambda c: c.score(MOTIUS, c.up30, 30, c.bailando60, 60)),
    "bas_popdg": (BAS_FLOAT32, lambda c: c.score(POPDG, c.z30[:300], 30, _before(c, 300))),
    "bas_gcd": (BAS_FLOAT32, lambda c: c.score(GCD, c.z30, 30, c.values["music_beats_edge30_track"])),
    "bas_megadance": (BAS, lambda c: c.score(MEGADANCE, c.z30, 30, c.values["music_beats_edge30_track"])),
    "bas_dgsdp.slices": (BAS, _slice_scores),
    "bas_lodge.music_beats_wav": (BAS, lambda c: c.score(LODGE, c.lodge, 30, c.values["music_beats_wav"])),
    "bas_lodge.music_beats_feat": (BAS, lambda c: c.score(LODGE, c.lodge, 30, c.values["music_beats_feat"])),
    "fsr_lodge": (0, lambda c: skating(c.lodge, 30, rule="lodge-code").ratios.tolist()),
    "skating_gmd_20fps": (PFC, lambda c: _gmd(c.joints("smpl24_yup60", 3))),
    "skating_gmd_asis": (PFC, lambda c: _gmd(c.lodge)), "footskate_duolando30": (0, lambda c: _counts(c.up30)),
    "physical_motius60": (1e-6, lambda c: _physics(c.up60)), "physical_motius30": (1e-6, lambda c: _physics(c.up30)),
}  # fmt: skip
#: Inputs, not values.
INPUTS = {
    "slice_starts30", "music_beats_fact60", "music_beats_fact60_cut", "music_beats_bailando60_cut",
    "music_beats_edge30_track", "music_beats_edge30_slices", "music_beats_wav", "music_beats_feat",
}  # fmt: skip


def _quarter_about_z() -> np.ndarray:
    return np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def _before(clip: Clip, frames: int) -> list[int]:
    return [beat for beat in clip.values["music_beats_edge30_track"] if beat < frames]


def _same(found: Any, wanted: Any, tolerance: float) -> None:
    if isinstance(wanted, dict):
        assert found.keys() == wanted.keys()
        for key in wanted:
            _same(found[key], wanted[key], tolerance)
    elif tolerance == 0:
        assert found == pytest.approx(wanted, rel=0, abs=1e-6)
    else:
        undefined = [value is None for value in wanted] if isinstance(wanted, list) else []
        assert undefined == ([value is None for value in found] if isinstance(found, list) else [])
        assert _numbers(found) == pytest.approx(_numbers(wanted), rel=tolerance, abs=1e-12)


def _numbers(value: Any) -> Any:
    return [v for v in value if v is not None] if isinstance(value, list) else value


@pytest.mark.parametrize("key", VALUES)
def test_values_of_clips(key: str, metrics_golden: Any) -> None:
    tolerance, compute = VALUES[key]
    clips = [name for name, values in metrics_golden.json("per_clip").items() if key in values]
    for name in clips:
        clip = Clip(name, metrics_golden)
        _same(compute(clip), clip.values[key], tolerance)
    assert clips or not metrics_golden.whole


def test_every_key_is_compared(metrics_golden: Any) -> None:
    keys = {key for values in metrics_golden.json("per_clip").values() for key in values}
    assert keys - INPUTS <= VALUES.keys()
