"""Refused input, and problems that are counted instead of hidden."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.evaluation.pool import load_pool
from dancedata.evaluation.protocol import PROTOCOLS, Pieces, Protocol
from dancedata.evaluation.protocols.aistpp import BailandoAistpp
from dancedata.metrics import MusicBeats
from dancedata.store import Store
from tests.messages import raises_message


@dataclass(frozen=True)
class NextVersion(BailandoAistpp):
    """The same protocol, later."""

    version: ClassVar[int] = 2


def dance(n_frames: int = 300, joints: int = 24, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(0, 0.01, (n_frames, joints, 3)).cumsum(axis=0) + rng.normal(0, 0.4, (joints, 3))


def dances(n: int = 3, **options: Any) -> dict[str, np.ndarray]:
    return {f"d{k}": dance(seed=k, **options) for k in range(n)}


def test_mixed_rates(motions: Mapping[str, Motion]) -> None:
    names = sorted(motions)
    mixed = dict(motions)
    half = motions[names[0]].resampled(FrameGrid.of(15))
    mixed[names[0]] = Motion(half.translation, half.rotations, half.grid, half.skeleton)
    with raises_message(UsageError, "compare", where="clips in memory"):
        dancedata.evaluate(mixed)


def test_a_pool_of_another_rate(store: Store) -> None:
    with raises_message(UsageError, "generate", where="small, split train"):
        dancedata.evaluate(dances(n_frames=600), fps=60, pool=store)


def test_a_store_without_the_joints(store: Store) -> None:
    with raises_message(UsageError, "computed", where="small"):
        dancedata.evaluate(store, split="all", protocol="bailando-aistpp")
    with raises_message(UsageError, "smplx24", where="small"):
        dancedata.evaluate(store, split="all", protocol="lodge-finedance", field="edge151")
    with raises_message(UsageError, "edge15", where="small"):
        dancedata.evaluate(store, split="all", field="edge15")


def test_metrics_have_the_names_of_the_table(store: Store) -> None:
    scores = dancedata.evaluate(store, split="all", metrics=["FSR"], intervals=False).scores
    assert [s.name for s in scores][-1] == "skating"
    assert {s.better for s in scores if s.name.startswith("skating")} == {"lower"}
    with raises_message(UsageError, "skating_right", where="protocol dancedata"):
        dancedata.evaluate(store, split="all", metrics=["skatin"])


@pytest.mark.parametrize(
    ("joints", "options"),
    [
        (24, {"protocol": "bailando-aistpp", "fps": 30}), (24, {"protocol": "fact-aistpp", "fps": 60}),
        (None, {"protocol": "lodge-finedance"}), (22, {"protocol": "lodge-finedance", "fps": 30}),
        *((number, {"fps": 30}) for number in (17, 23, 100)),
    ],
)  # fmt: skip
def test_dances_that_cannot_be_measured(motions, joints, options):
    """At another rate, without the true pelvis, without SMPL-X, of an unknown body."""
    with raises_message(DataError, "measured", where="clips in memory", reason="nothing_left"):
        dancedata.evaluate(motions if joints is None else dances(joints=joints), **options)


def test_pools_are_keyed_by_protocol_version_and_rate(tmp_path: Path) -> None:
    path = tmp_path / "pool.npz"
    made = dancedata.evaluate(
        dances(), protocol="bailando-aistpp", fps=60, pool=dances(4), save_pool=path, intervals=False
    )
    data = path.read_bytes()
    again = dancedata.evaluate(
        dances(), protocol="bailando-aistpp", fps=60, pool=path, save_pool=path, intervals=False
    )
    assert path.read_bytes() == data
    assert [s.value for s in again.scores] == [s.value for s in made.scores]
    assert load_pool(path, BailandoAistpp()).ids == ("d0", "d1", "d2", "d3")
    with raises_message(UsageError, "motius-aistpp", where="pool.npz"):
        dancedata.evaluate(dances(), protocol="motius-aistpp", fps=60, pool=path)
    later = NextVersion()
    object.__setattr__(later, "name", "bailando-aistpp")
    with raises_message(UsageError, r"FILE\.npz", where="pool.npz"):
        dancedata.evaluate(dances(), protocol=later, fps=60, pool=path)


@pytest.mark.parametrize(
    ("values", "word"),
    [({"skip": -1}, "skip"), ({"length": 5}, "length and stride"), ({"seconds": (5, 0)}, "seconds"),
     ({"seconds": (5, 2.5), "length": 9, "stride": 9}, "without length")],
)  # fmt: skip
def test_pieces_that_cannot_be(values: dict[str, Any], word: str) -> None:
    with raises_message(UsageError, word):
        Pieces(**values)


def test_foreign_pools_are_not_read_and_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "pool.npz"
    np.savez(path, about=np.array([object()], dtype=object))
    before = path.read_bytes()
    for options in ({"pool": path}, {"pool": dances(), "save_pool": path}):
        with raises_message(UsageError, "--out", where="pool.npz"):
            dancedata.evaluate(dances(), protocol="bailando-aistpp", fps=60, **options)
    assert path.read_bytes() == before
    with raises_message(UsageError, r"NAME\.npz"):
        dancedata.evaluate(dances(), protocol="gcd", body="smpl24", fps=30, pool=dances(), save_pool=tmp_path / "a")


def test_broken_clips_are_counted_by_name(tmp_path: Path, store: Store) -> None:
    for name, array in dances().items():
        np.save(tmp_path / f"{name}.npy", array)
    broken = dance()
    broken[7] = np.nan
    np.save(tmp_path / "broken.npy", broken)
    report = dancedata.evaluate(tmp_path, fps=30, up="y", pool=store, intervals=False)
    assert report.clips == ("d0", "d1", "d2")
    ((clip, reason),) = report.left_out
    assert clip == "broken"
    assert "the first at frame 7" in reason
    assert "left out: 1 clip\n    broken:" in str(report)
    for k in range(4):
        np.save(tmp_path / f"broken{k}.npy", broken)
    report = dancedata.evaluate(tmp_path, fps=30, up="y", pool=store, intervals=False)
    assert "    and 2 more, which --json lists" in str(report)


@pytest.mark.parametrize(
    ("width", "said"), [(152, "allowed: (T, 151), columns of edge151; "), (151, "frame 0, pelvis: ")]
)
def test_columns_that_cannot_be_decoded_are_named_with_their_file(tmp_path, store, width, said):
    path = tmp_path / "zeros.npy"
    np.save(path, np.zeros((30, width), np.float32))
    with pytest.raises(DataError) as raised:
        dancedata.evaluate(tmp_path, like=store, field="edge151", normalized=False, intervals=False)
    assert f"found {path}: " in str(raised.value)
    assert said in str(raised.value)


def test_still_and_short_clips_are_named_outcomes(store: Store) -> None:
    still = np.broadcast_to(dance()[:1], (300, 24, 3))
    clips = dances() | {"still": still, "short": dance(60)}
    report = dancedata.evaluate(
        clips, fps=30, pool=store, music=dict.fromkeys(clips, beats_of_music()), intervals=False
    )
    pfc = next(s for s in report.scores if s.name == "pfc")
    assert pfc.undefined == {"short": ("short",), "still": ("still#0", "still#1", "still#2")}
    bas = next(s for s in report.scores if s.name == "bas")
    assert bas.undefined["no_motion_beats"] == ("still#0", "still#1", "still#2")
    assert "never accelerates (still), 3 pieces: still#0" in str(report)
    alone = dancedata.evaluate({"still": still}, fps=30, pool=store, intervals=False)
    assert alone["pfc"].value is None
    assert alone.to_json()["scores"]["pfc"]["value"] is None


def beats_of_music() -> Any:
    return MusicBeats.of([10, 70, 130, 190, 250], FrameGrid.of(30))


@pytest.mark.parametrize(("options", "message"), [
    ({"protocol": "bailando"}, "unknown protocol 'bailando'.*Did you mean 'bailando-aistpp'"),
    ({"role": "ground truth"}, "unknown role"), ({"normalized": True}, "normalised columns need the scaler"),
    ({"scaler": "scaler.json"}, "a scaler applies only to columns"), ({"split": "test"}, "only a dataset has splits"),
    ({"fps": None}, "the frame rate of the joints is unknown"),
    ({"music": {"nobody": "song"}}, "the list of songs names unknown clips; found nobody"),
    ({"music": {"nobody": [1]}}, "beats given for unknown clips; found nobody"),
    ({"music": {"d0": [1]}}, "does not state a rate of beats"), ({"up": "x"}, None),
])  # fmt: skip
def test_options_that_do_not_go_together(options: dict[str, Any], message: str | None) -> None:
    given = {"fps": 30} | options
    if message is None:
        assert (
            dancedata.evaluate(dances(), intervals=False, **given)["pfc"].value is not None
        )  # arrays in memory are +Y up
        return
    with pytest.raises(UsageError, match=message):
        dancedata.evaluate(dances(), **given)


COLUMNS: dict[str, Any] = {"field": "edge151", "normalized": False}


@pytest.mark.parametrize(("arrays", "options"), [
    ({"": dance()}, {"fps": 30}), ({"": dance()}, {"up": "y"}),  # no direction, no rate
    ({"poses": np.zeros((9, 72)), "trans": np.zeros((9, 3)), "mocap_framerate": 30}, {}),
    *(({"joints": dance(), "fps": rate}, {"fps": 30, "up": "y"})
      for rate in (0, -30, np.nan, np.inf, 1e300, [30, 30])),
    ({"": np.zeros((3, 60, 151))}, COLUMNS),  # a batch
])  # fmt: skip
def test_facts_of_files_that_are_not_stated_or_wrong(store, tmp_path, arrays, options):
    options = options | ({"like": store} if "field" in options else {})
    if "" in arrays:
        np.save(tmp_path / "a.npy", arrays[""])
    else:
        np.savez(tmp_path / "a.npz", **arrays)
    with raises_message(DataError, "measured", reason="nothing_left"):
        dancedata.evaluate(tmp_path, metrics=["pfc"], **options)


def test_columns_at_another_rate_than_their_file_states(store: Store, tmp_path: Path) -> None:
    options: dict[str, Any] = {"like": store, "normalized": False, "metrics": ["pfc"], "intervals": False}
    columns = store.clips()[0].read("edge151")
    np.savez(tmp_path / "a.npz", columns=columns, fps=60)
    with raises_message(DataError, "measured", reason="nothing_left"):
        dancedata.evaluate(tmp_path, **options)
    np.savez(tmp_path / "a.npz", columns=columns, fps=30)
    assert dancedata.evaluate(tmp_path, **options)["pfc"].value is not None


def test_folders_with_nothing_to_evaluate(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for name in ("b", "empty"):
        with raises_message(DataError, "evaluate", where=name, reason="nothing_matched"):
            dancedata.evaluate(tmp_path / name)


def test_columns_take_precedence_over_positions(store: Store, tmp_path: Path) -> None:
    columns = store.clips()[0].read("edge151")
    options: dict[str, Any] = {"field": "edge151", "fps": 30, "metrics": ["pfc"], "intervals": False}
    wanted = []
    for name, beside in (
        ("alone", {}), ("both", {"joints": dance()}), ("named", {"joints": np.array(["hip", "knee"])}),
    ):  # fmt: skip
        (tmp_path / name).mkdir()
        np.savez(tmp_path / name / "a.npz", columns=columns, **beside)  # type: ignore[arg-type]
        wanted.append(dancedata.evaluate(tmp_path / name, **options)["pfc"].value)
    assert wanted == [wanted[0]] * 3
    with raises_message(UsageError, "body", where="alone"):
        dancedata.evaluate(tmp_path / "alone", body="smpl24", **options)
    np.savez(tmp_path / "both" / "a.npz", joints=dance(), motion=np.array(["walk"]))
    assert dancedata.evaluate(tmp_path / "both", up="y", **options)["pfc"].value != wanted[0]


def test_a_protocol_needs_its_members() -> None:
    @dataclass(frozen=True)
    class Bare(Protocol):
        """Nothing."""

        version: ClassVar[int] = 1
        name: ClassVar[str] = "bare"

    with raises_message(UsageError, "lacks", where="bare"):
        Bare()


def test_protocols_are_complete() -> None:
    assert PROTOCOLS.names() == (
        "bailando-aistpp", "dancedata", "dgsdp", "duolando", "edge-aistpp", "fact-aistpp", "flowerdance-code", "gcd",
        "gcd-groups", "groups", "lodge-finedance", "megadance-finedance", "motius-aistpp", "popdg",
    )  # fmt: skip
    for name in PROTOCOLS.names():
        protocol = PROTOCOLS.get(name)()
        scores = {score for m in protocol.measures for score in m.metric.better}
        needs_music = any(m.metric.needs_music for m in protocol.measures)
        assert (protocol.music is not None) == needs_music, name
        for row in protocol.published:
            assert set(row.values) <= scores | set(protocol.not_computable), name
