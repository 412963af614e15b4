"""Whole protocols against the published programs' results for the same dances (golden set `metrics`)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.grid import FrameGrid
from dancedata.evaluation.measuring import measure_pose
from dancedata.evaluation.protocol import PROTOCOLS
from dancedata.evaluation.report import Report
from dancedata.metrics.set_statistics import STATISTICS
from dancedata.scene.poses import Pose

# Relative; the README of the golden set gives these.
BAS, BAS_FLOAT32, PFC, FEATURES, SETS = 1e-9, 1e-6, 1e-6, 1e-6, 1e-5


class Golden:
    """Inputs by clip, and the values of the programs."""

    def __init__(self, metrics_golden: Any) -> None:
        self.values: Mapping[str, Any] = metrics_golden.json("per_clip")
        self.set = metrics_golden
        self.y60 = self._joints("smpl24_yup60")
        # To +Y up: (x, y, z) of z up is (x, z, -y).
        z30 = self._joints("smpl24_zup30")
        self.z30 = {k: np.stack([v[..., 0], v[..., 2], -v[..., 1]], axis=-1) for k, v in z30.items()}
        self.x30 = self._joints("smplx24_yup30")

    def _joints(self, kind: str) -> dict[str, np.ndarray]:
        found = {k.split("/")[1]: v.astype(np.float64) for k, v in self.set.joints.items() if k.startswith(kind)}
        return found

    def of(self, key: str, clips: Mapping[str, Any]) -> dict[str, Any]:
        return {clip: self.values[clip][key] for clip in clips}


@pytest.fixture
def whole(metrics_golden: Any) -> None:
    """Skip unless the whole set is available."""
    if not metrics_golden.whole:
        pytest.skip("sets of windows, and dances of some lengths, are in the whole set of metrics")


@pytest.fixture(scope="module")
def golden(metrics_golden: Any) -> Golden:
    return Golden(metrics_golden)


def evaluated(motions: Mapping[str, np.ndarray], protocol: str, fps: int, **options: Any) -> Report:
    return dancedata.evaluate(motions, protocol=protocol, fps=fps, role="truth", intervals=False, **options)


def column(report: Report, name: str) -> dict[str, Any]:
    return {row["clip"]: row[name] for row in report.per_clip}


def assert_total(report: Report, score: str, expected: Mapping[str, float], rtol: float, row: str = "") -> None:
    """The clips' values and their mean."""
    assert column(report, row or score) == pytest.approx(dict(expected), rel=rtol, abs=1e-12)
    assert report[score].value == pytest.approx(np.mean(list(expected.values())), rel=rtol, abs=1e-12)


def beats(golden: Golden, suffix: str, clips: Mapping[str, Any]) -> dict[str, np.ndarray]:
    return {clip: golden.set.beats[f"{clip}.{suffix}"] for clip in clips}


#: Protocol, its dances, their rate and body, where the golden set has beats of music and values, and their tolerance.
ALIGNMENTS = [
    ("bailando-aistpp", "y60", 60, None, "bailando60", "bas_bailando", BAS),
    ("fact-aistpp", "y60", 60, "smpl24", "music_beats_fact60", "bas_fact", BAS_FLOAT32),
    ("gcd", "z30", 30, "smpl24", "music_beats_edge30_track", "bas_gcd", BAS_FLOAT32),
    ("megadance-finedance", "z30", 30, None, "music_beats_edge30_track", "bas_megadance", BAS),
]


@pytest.mark.parametrize("case", ALIGNMENTS, ids=lambda case: case[0])
def test_beat_alignment(golden: Golden, case: tuple[Any, ...]) -> None:
    name, dances, fps, body, music, key, tolerance = case
    # MEGADance cuts its windows to multiples of 8: dances that are such multiples are measured whole.
    clips = {k: v for k, v in getattr(golden, dances).items() if len(v) % 8 == 0 or name != "megadance-finedance"}
    if not clips:
        pytest.skip("a dance of such a length is in the whole set")
    heard = beats(golden, music, clips) if music == "bailando60" else golden.of(music, clips)
    report = evaluated(clips, name, fps, body=body, music=heard)
    assert_total(report, "bas", golden.of(key, clips), tolerance)


@pytest.mark.parametrize("fps", [60, 30])
def test_motius(golden: Golden, fps: int) -> None:
    dances = {clip: joints[:: 60 // fps] for clip, joints in golden.y60.items()}
    report = evaluated(dances, "motius-aistpp", fps, music=beats(golden, "bailando60", dances))
    assert_total(report, "bas", golden.of(f"bas_motius{fps}", dances), BAS)
    physics = golden.of(f"physical_motius{fps}", dances)
    for name, score in (("Jitter", "jitter"), ("Dynamic", "dynamic"), ("Float", "floating"), ("Slide", "sliding")):
        assert_total(report, score, {clip: v[name] for clip, v in physics.items()}, 1e-6)


def test_popdg(golden: Golden) -> None:
    music = golden.of("music_beats_edge30_track", golden.z30)
    report = evaluated(golden.z30, "popdg", 30, body="smpl24-edge", music=music)
    expected = golden.of("bas_popdg", golden.z30)
    assert column(report, "bas") == pytest.approx(expected, rel=BAS_FLOAT32)
    assert report["bas"].value == pytest.approx(sum(expected.values()) / 24, rel=BAS_FLOAT32)
    assert_total(report, "pfc", golden.of("pfc_edge", golden.z30), PFC)
    assert_total(report, "pbc", golden.of("pbc_popdg", golden.z30), PFC)


def test_slices_of_dgsdp_and_edge(golden: Golden) -> None:
    slices = golden.of("pfc_edge.slices", golden.z30)
    starts = golden.of("slice_starts30", golden.z30)
    report = evaluated(golden.z30, "dgsdp", 30)
    assert report.pieces == sum(map(len, slices.values()))
    assert report["pfc"].value == pytest.approx(np.mean([v for own in slices.values() for v in own]), rel=PFC)
    for clip, values in slices.items():
        own = [row["pfc"] for row in report.per_clip if row["clip"] == clip]
        assert own == pytest.approx(values, rel=PFC)
    every = [v for clip, own in slices.items() for s, v in zip(starts[clip], own, strict=True) if s % 75 == 0]
    assert evaluated(golden.z30, "edge-aistpp", 30)["pfc"].value == pytest.approx(np.mean(every), rel=PFC)


def test_beats_of_dgsdps_slices(whole: None, golden: Golden) -> None:
    clips = {k: v for k, v in golden.z30.items() if "bas_dgsdp.slices" in golden.values[k]}
    slices, values = [golden.of(k, clips) for k in ("music_beats_edge30_slices", "bas_dgsdp.slices")]
    for clip, joints in clips.items():
        cut = {f"{clip}@{k:02d}": joints[15 * k : 15 * k + 150] for k, v in enumerate(values[clip]) if v is not None}
        music = {name: slices[clip][int(name[-2:])] for name in cut}
        found = column(evaluated(cut, "dgsdp", 30, music=music), "bas")
        assert found == pytest.approx({name: values[clip][int(name[-2:])] for name in cut}, rel=BAS)


def test_lodge(golden: Golden) -> None:
    clips = {k: v for k, v in golden.x30.items() if len(v) <= 1024}
    if not clips:
        pytest.skip("a dance of at most 1,024 frames is in the whole set")
    music = beats(golden, "music_beats_wav", clips)
    report = evaluated(clips, "lodge-finedance", 30, body="smplx24", music=music)
    assert_total(report, "bas", golden.of("bas_lodge.music_beats_wav", clips), BAS)
    sides = np.array([golden.values[clip]["fsr_lodge"] for clip in clips])
    found = [[column(report, f"skating_{side}")[clip] for side in ("left", "right")] for clip in clips]
    np.testing.assert_allclose(found, sides, atol=1e-6)
    assert report["skating"].value == pytest.approx(sides.mean(axis=0).mean(), abs=1e-6)


#: Protocol, which of its measures, the dances, their rate and body, role, and the golden array.
ARRAYS = [
    ("bailando-aistpp", 0, "y60", 60, None, "generated", "kinetic_bailando"),
    ("bailando-aistpp", 1, "y60", 60, None, "generated", "manual_bailando"),
    ("fact-aistpp", 0, "y60", 60, "smpl24", "truth", "kinetic_api"),
    ("fact-aistpp", 1, "y60", 60, "smpl24", "truth", "manual_api"),
    ("popdg", 0, "z30", 30, "smpl24-edge", "truth", "kinetic_popdg_zup30"),
    ("popdg", 1, "z30", 30, "smpl24-edge", "truth", "manual_popdg_zup30"),
    ("gcd", 0, "y60", 60, "smpl24", "truth", "kinetic_gcd30"),
    ("megadance-finedance", 0, "y60", 60, None, "truth", "kinetic_megadance30"),
    ("flowerdance-code", 0, "z30", 30, None, "truth", "kinetic_flowerdance_zup30_exact"),
    ("flowerdance-code", 1, "z30", 30, None, "truth", "geometric_flowerdance_zup30_exact"),
    ("lodge-finedance", 0, "x30", 30, "smplx24", "truth", "kinetic_lodge"),
    ("lodge-finedance", 1, "x30", 30, "smplx24", "truth", "manual_lodge"),
]


@pytest.mark.parametrize("case", ARRAYS, ids=lambda case: f"{case[0]}-{case[-1]}")
def test_features(golden: Golden, case: tuple[Any, ...]) -> None:
    name, number, dances, fps, body, role, key = case
    protocol = PROTOCOLS.get(name)()
    stored = [k for k in golden.set.features if k.split("/")[0] == key]
    checked = 0
    for clip, joints in getattr(golden, dances).items():
        names = [k for k in stored if k.split("/")[-1] == clip]
        if not names or (name == "megadance-finedance" and len(joints[::2]) % 8):
            continue
        pose = Pose.of_joints(joints, FrameGrid.of(fps), body)
        found = measure_pose(protocol, role, [number], pose, None)[number]
        assert found is not None
        expected = np.asarray(golden.set.features[names[0]], dtype=np.float64)
        np.testing.assert_allclose(found[3][0], expected[: len(found[3][0])], rtol=FEATURES, atol=1e-7)
        checked += 1
    assert checked or (name == "megadance-finedance" and not golden.set.whole)


#: Protocol and the golden set's name for its statistics, of the features that it takes.
STATISTICS_OF = {
    "bailando-aistpp": ("bailando", "numpy"), "fact-aistpp": ("fact", "numpy"), "motius-aistpp": ("motius", "numpy"),
    "megadance-finedance": ("megadance", "torch"), "flowerdance-code": ("flowerdance_normalise", "flowerdance"),
    "lodge-finedance": ("lodge", "numpy"),
}  # fmt: skip


@pytest.mark.parametrize("name", sorted(STATISTICS_OF))
def test_sets_are_normalised_as_in_the_originals(name: str) -> None:
    protocol = PROTOCOLS.get(name)()
    for measure in protocol.measures:
        if measure.metric.needs_pool:
            own = getattr(measure.metric, "statistics")  # noqa: B009 (of the plug-ins that have it)
            assert STATISTICS[own] == STATISTICS[STATISTICS_OF[name][1]]
