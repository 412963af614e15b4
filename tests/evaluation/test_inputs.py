"""One motion gives one result, for every source and every process."""

import json
import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata import comparison
from dancedata.core.bodies import SMPLX55, transfer
from dancedata.core.errors import StoreError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.evaluation.options import EvaluationOptions
from dancedata.evaluation.protocol import PROTOCOLS, protocol_named
from dancedata.evaluation.report import Report
from dancedata.formats.bvh.write import write_bvh
from dancedata.metrics import MusicBeats
from dancedata.pages import write_report
from dancedata.store import Store, open_store
from dancedata.synthetic import write_synthetic
from tests.clusters import dask_cluster
from tests.messages import raises_message

#: A store has float32 columns: 6D rotations are within 1e-7, positions within 1e-6 m.
FLOAT32 = 2e-3
#: BVH has six decimals of degrees and metres.
TEXT = 2e-3


def values(report: Report) -> dict[str, float | None]:
    return {score.name: score.value for score in report.scores}


def assert_same(one: Report, other: Report, rtol: float, atol: float = 1e-6) -> None:
    assert values(one).keys() == values(other).keys()
    for name, value in values(one).items():
        assert value is not None, name
        assert values(other)[name] == pytest.approx(value, rel=rtol, abs=atol), name


def evaluated(what: object, store: Store, protocol: str = "dancedata", **options: object) -> Report:
    options = {"pool": store, "pool_split": "all", "role": "truth", "intervals": False} | options
    options["protocol"] = protocol
    options |= {"split": "all"} if what is store or what == store.path else {}
    return dancedata.evaluate(what, **options)


@pytest.fixture(scope="module")
def reference(folder: Path, store: Store) -> Report:
    return dancedata.evaluate(store, split="all", pool_split="all", intervals=False, cache=folder / "cache")


def test_joints_motions_and_arrays_of_a_store_agree(tmp_path, store, motions, reference):
    assert_same(reference, evaluated(motions, store, like=store), 1e-12)
    joints = {name: motion.joints() for name, motion in motions.items()}
    assert_same(reference, evaluated(joints, store, like=store, body="smpl24"), 1e-9)
    assert_same(reference, evaluated(store, store, field="joints"), FLOAT32)
    for name, motion in motions.items():
        np.savez(tmp_path / f"{name}.npz", joints=motion.joints().astype(np.float32), fps=30)
    assert_same(reference, evaluated(tmp_path, store, like=store, up="y"), FLOAT32)


def test_positions_with_z_up_and_in_centimetres(tmp_path, store, motions, reference):
    for name, motion in motions.items():
        x, y, z = np.moveaxis(100 * motion.joints(), -1, 0)
        np.save(tmp_path / f"{name}.npy", np.stack([x, -z, y], axis=-1))
    found = evaluated(tmp_path, store, like=store, up="z", unit="cm", fps=30)
    assert_same(reference, found, 1e-6)


def test_columns_normalised_or_not(tmp_path, store, motions, reference):
    scaler = store.scaler("edge151")
    for clip in store:
        np.save(tmp_path / f"{clip.id}.npy", clip.read("edge151"))
        (tmp_path / "normalised").mkdir(exist_ok=True)
        columns = scaler.normalize(clip.read("edge151").astype(np.float64))
        np.save(tmp_path / "normalised" / f"{clip.id}.npy", columns)
    assert_same(reference, evaluated(tmp_path, store, like=store, field="edge151", normalized=False), 1e-12)
    found = evaluated(tmp_path / "normalised", store, like=store, field="edge151", normalized=True)
    assert_same(reference, found, FLOAT32, 1e-4)
    alone = evaluated(tmp_path, store, field="edge151", fps=30)
    assert alone["fid_k"].value == pytest.approx(reference["fid_k"].value, abs=1e-9)


def test_files_that_decode_writes(tmp_path: Path, store: Store) -> None:
    batch = np.stack([store.read(window, "edge151") for window in store.windows("train")[:2]])
    np.save(tmp_path / "sample.npy", batch)
    scores = []
    for to, options in (("npz", {"up": "y", "body": "smpl24"}), ("smpl", {}), ("bvh", {"unit": "m"})):
        out = tmp_path / to
        dancedata.decode(tmp_path / "sample.npy", "edge151", to=to, fps=30, out=out)
        found = dancedata.evaluate(
            out, like=store, metrics=["PFC"], protocol="edge-aistpp", intervals=False, **options
        )
        assert not found.left_out
        assert found["pfc"].published is None  # 1.332 is of AIST++, and this is another dataset
        scores.append(found["pfc"].value)
    assert scores[1] == pytest.approx(scores[0], rel=1e-2)
    assert scores[2] == pytest.approx(scores[0], abs=2e-4)


def test_smpl_arrays(tmp_path: Path, store: Store, motions: Mapping[str, Motion], reference: Report) -> None:
    for name, motion in motions.items():
        poses = motion.rotations.reshape(motion.n_frames, -1)
        np.savez(tmp_path / f"{name}.npz", poses=poses, trans=motion.translation)
    assert_same(reference, evaluated(tmp_path, store, like=store, up="y", unit="m", fps=30), 1e-9)


def test_bvh(tmp_path: Path, store: Store, motions: Mapping[str, Motion], reference: Report) -> None:
    for name, motion in motions.items():
        bones = motion.skeleton
        root = motion.translation + bones.offsets[0]
        names = [_camel(joint) for joint in bones.joints]
        path = tmp_path / f"{name}.bvh"
        write_bvh(path, names, bones.parents, bones.offsets, motion.matrices, root, "0.0333333")
    assert_same(reference, evaluated(tmp_path, store, like=store, unit="m"), TEXT, 2e-4)


def _camel(joint: str) -> str:
    return "".join(part.capitalize() for part in joint.split("_"))


def test_order_and_jobs_do_not_count(folder, store, motions, reference, tmp_path):
    backwards = dict(reversed(motions.items()))
    assert values(evaluated(backwards, store, like=store)) == values(evaluated(motions, store, like=store))
    again = dancedata.evaluate(
        store, split="all", pool_split="all", intervals=False, jobs=2, cache=tmp_path / "cache"
    )
    assert again.to_json() == reference.to_json()


def test_a_second_run_computes_nothing(store: Store, reference: Report, monkeypatch: pytest.MonkeyPatch) -> None:
    from dancedata.evaluation import measuring

    monkeypatch.setattr(measuring, "measure_pose", None)
    assert dancedata.evaluate(store, split="all", pool_split="all", intervals=False).to_json() == reference.to_json()


_OF_GROUPS = {name for name in PROTOCOLS.names() if PROTOCOLS.get(name)().of_groups}


@pytest.mark.parametrize("name", sorted(set(PROTOCOLS.names()) - {"lodge-finedance"} - _OF_GROUPS))
def test_every_protocol_gives_a_table(store: Store, motions: Mapping[str, Motion], name: str) -> None:
    protocol = PROTOCOLS.get(name)()
    rate = protocol.motion.fps or 30
    sources = {k: m.resampled(FrameGrid.of(rate)) for k, m in motions.items()}
    sources = {k: Motion(m.translation, m.rotations, m.grid, m.skeleton) for k, m in sources.items()}
    beats = MusicBeats.of([9, 40, 70, 99, 130, 200], FrameGrid.of(rate))
    music = {} if protocol.music is None else dict.fromkeys(motions, beats)
    report = dancedata.evaluate(sources, protocol=name, pool=sources, music=music, role="truth")
    assert len(report.clips) == len(motions)
    for score in report.scores:
        assert score.value is not None, score
        assert np.isfinite(score.value)
    assert name in str(report)
    assert report.to_json()["scores"]


def test_lodge_takes_smplx(store: Store, motions: Mapping[str, Motion]) -> None:
    smplx = {name: transfer(motion, SMPLX55) for name, motion in motions.items()}
    of_motion = dancedata.evaluate(smplx, protocol="lodge-finedance", pool=smplx, like=store, intervals=False)
    joints = {name: motion.joints()[:, :24] for name, motion in smplx.items()}
    of_joints = dancedata.evaluate(
        joints, protocol="lodge-finedance", pool=joints, like=store, body="smplx24", intervals=False
    )
    assert_same(of_motion, of_joints, 1e-9)
    of_store = dancedata.evaluate(
        store, split="all", protocol="lodge-finedance", pool_split="all", intervals=False, role="generated"
    )
    assert_same(of_motion, of_store, FLOAT32)


def test_judged_clips_in_the_pool_are_said(store: Store) -> None:
    train, other = store.splits[0], store.splits[-1]
    assert train != other
    for split, pool_split, said in (
        (other, train, False), (other, other, True), (other, "all", True), (other, None, False), (train, None, True),
    ):  # fmt: skip
        report = dancedata.evaluate(store, split=split, pool_split=pool_split, intervals=False)
        assert any(why.code == "in_pool" for why in report["fid_k"].why) == said
        assert not any(why.code == "in_pool" for why in report["pfc"].why)


@pytest.mark.parametrize(("protocol", "splits"), [("dancedata", ["train"]), ("motius-aistpp", []), ("own", ["val"])])
def test_the_pool_is_the_split_of_the_protocol(store: Store, protocol: str, splits: list[str]) -> None:
    rules = PROTOCOLS.get("dancedata" if protocol == "own" else protocol)()
    if protocol == "own":
        object.__setattr__(rules, "pool_split", "val")
    pool = dancedata.evaluate(
        store, split="all", protocol=rules, pool=store.path, metrics=["FID_k"], intervals=False
    ).pool
    assert pool is not None
    assert len(pool.ids) == sum(not c.source and (not splits or c.split in splits) for c in store)


# Evaluation on a Dask cluster gives what it gives here.


def test_workers_in_another_folder_read_the_same_music(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Relative paths name the files of the caller, and not others of the same names beside the worker."""
    pytest.importorskip("distributed")
    for seed, name in enumerate(("here", "there")):
        write_synthetic(tmp_path / name, seed=seed, songs=2, clips_per_song=2, clip_s=6.0)
    options: dict[str, Any] = {"fps": 60, "up": "y", "unit": "m", "metrics": ("bas",), "intervals": False}
    options["music"] = "."
    monkeypatch.chdir(tmp_path / "there")
    with dask_cluster(os.environ, workers=1) as address:
        monkeypatch.chdir(tmp_path / "here")
        there = dancedata.evaluate("motions", cache=tmp_path / "a", scheduler=address, **options)
    here = dancedata.evaluate("motions", cache=tmp_path / "b", **options)
    assert there.to_json() == here.to_json()
    assert there.per_clip == here.per_clip
    assert list((tmp_path / "a").rglob("*"))


# No number is of bytes that a build did not write: not now, and not from the cache later.


Flip = Callable[[str], None]


@pytest.fixture
def copy(store: Store, tmp_path: Path) -> Path:
    return Path(shutil.copytree(store.path, tmp_path / "copy"))


@pytest.fixture
def flip(copy: Path) -> Flip:
    """Flip the lowest bit of an exponent in the middle of a field's rows; a second time restores it."""

    def change(field: str) -> None:
        with open_store(copy) as opened:
            span = opened._locate(opened.windows("train")[0], field)
            layout = span.shard.layout(field)
            path, at = span.shard.path, layout.offset + (span.first + 20) * layout.row_bytes + 6  # column 1
        data = bytearray(path.read_bytes())
        data[at] ^= 0x80
        path.write_bytes(data)

    return change


def pfc(path: Path, cache: Path) -> float | None:
    return dancedata.evaluate(path, split="all", metrics=["pfc"], field="joints", intervals=False, cache=cache)[
        "pfc"
    ].value


def test_a_flipped_bit_is_an_error_and_leaves_nothing_in_the_cache(copy: Path, flip: Flip, tmp_path: Path) -> None:
    flip("joints")
    with raises_message(StoreError, "those", where="copy/train-00000-of-00001.h5"):
        pfc(copy, tmp_path / "shared")
    flip("joints")
    assert pfc(copy, tmp_path / "shared") == pfc(copy, tmp_path / "fresh")


def test_keys_of_stored_clips_hold_their_rows(copy, flip, tmp_path, monkeypatch):
    monkeypatch.setattr(Store, "require_intact", lambda *args, **options: None)
    flip("joints")
    damaged = pfc(copy, tmp_path / "shared")
    flip("joints")
    intact = pfc(copy, tmp_path / "shared")
    assert intact == pfc(copy, tmp_path / "fresh") != damaged


@pytest.mark.parametrize("metrics", [["kinetic"], ["bas"]], ids=["pool", "beats"])
def test_pools_and_beats_are_of_intact_shards(copy: Path, flip: Flip, metrics: list[str]) -> None:
    with open_store(copy) as opened:
        clip = next(c for c in opened.clips() if c.split == "train")
        clips = {clip.id: dancedata.decode(clip.read("edge151"), "edge151", fps=30)}
    flip("librosa35")
    with raises_message(StoreError, "those", where="copy/train-00000-of-00001.h5"):
        dancedata.evaluate(clips, like=copy, metrics=metrics, intervals=False)


def test_exports_reports_and_diff_verify_their_input(store: Store, copy: Path, flip: Flip, tmp_path: Path) -> None:
    assert comparison.diff(store.path, copy) == []
    flip("edge151")
    for use in (
        lambda: dancedata.export(copy, "npz", out=tmp_path / "out"),
        lambda: write_report(copy),
        lambda: comparison.diff(store.path, copy),
    ):
        with raises_message(StoreError, "those", where="copy/train-00000-of-00001.h5"):
            use()
    assert not (tmp_path / "out").exists()


def test_a_description_that_was_changed_is_an_error_with_a_cure(copy: Path) -> None:
    path = copy / "dataset.json"
    document = {**json.loads(path.read_text(encoding="utf-8")), "fps": "60"}
    path.write_text(json.dumps(document), encoding="utf-8")
    for use in (open_store, dancedata.evaluate, write_report, lambda p: dancedata.export(p, "npz", out=p / "x")):
        with pytest.raises(StoreError, match=r"dataset\.json was changed after the build") as found:
            use(copy)
    path.write_text(json.dumps({**document, "self_sha256": found.value.allowed}), encoding="utf-8")
    assert open_store(copy).fps == 60


def test_the_pool_is_of_the_field_that_is_named(store: Store) -> None:
    protocol = protocol_named("dancedata")
    for pool in (None, store.path):
        request = EvaluationOptions(what=store, protocol=protocol, field="joints", pool=pool)
        inputs = request.inputs()
        assert {clip.field for clip in (*inputs.clip_set.clips, *inputs.pool.clips)} == {"joints"}
