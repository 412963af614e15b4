"""One scaler from training to table: what readers normalise, decode, evaluate and view undo, or refuse."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.commands import run
from tests.messages import raises_message

pytest.importorskip("torch")

from torch.utils.data import Subset
from typer.testing import CliRunner

import dancedata
from dancedata.cli.app import app
from dancedata.core.errors import DataError, UsageError
from dancedata.core.registry import REPRESENTATIONS
from dancedata.evaluation.evaluator import Evaluator
from dancedata.evaluation.options import EvaluationOptions
from dancedata.evaluation.protocol import PROTOCOLS
from dancedata.scene.comparisons import comparison_of, file_format
from dancedata.scene.inputs.files import FileClip
from dancedata.scene.scaling import Scaling, _warn_once
from dancedata.store import Store
from dancedata.store.normalize import Scaler
from dancedata.torch import ClipDataset, Scale, WindowDataset

FIELD = "edge151"
KINDS: dict[str, dict[str, Any]] = {
    "mirror": {"augment": {"mirror": 1.0}}, "yaw": {"augment": ["yaw"]}, "root_offset": {"augment": ["root_offset"]},
}  # fmt: skip


def joints(rows: Any, store: Store, field: str = FIELD) -> Any:
    """Joints of plain columns, by forward kinematics alone."""
    return dancedata.decode(np.asarray(rows, np.float64), field, fps=store.fps).joints()


def worst(found: Any, wanted: Any) -> float:
    return float(np.linalg.norm(found - wanted, axis=-1).max())


def view(path: Path, rows: Any, store: Store, **options: Any) -> Any:
    np.save(path / "x.npy", rows)
    return FileClip(id="x", path=path / "x.npy", format=file_format(store, field=FIELD, **options)).load()


def evaluated(store: Store, rows: Any, **options: Any) -> Any:
    request = EvaluationOptions(what={}, protocol=PROTOCOLS.get("dancedata")(), like=store, field=FIELD, **options)
    columns = request._columns()
    assert columns is not None
    return columns.pose(rows)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("reader", [WindowDataset, ClipDataset])
def test_normalising_is_undone(store: Store, tmp_path: Path, kind: str, reader: Any) -> None:
    changed, plain = (reader(store, fields=(FIELD,), scale=scale, **KINDS[kind]) for scale in (Scale(), None))
    for one in (changed, plain):
        one.set_epoch(0)  # otherwise each read draws again
    beyond = 0.0
    for place in (0, 3):
        rows, wanted = changed[place][FIELD].numpy(), joints(plain[place][FIELD], store)
        beyond = max(beyond, float(np.abs(rows).max()))
        for like in (store, changed):
            stated = {"normalized": True} if like is store else {}
            assert worst(dancedata.decode(rows, FIELD, like=like, **stated).joints(), wanted) < 1e-5
        assert worst(evaluated(store, rows, normalized=True).joints, wanted) < 1e-5
        assert worst(evaluated(store, rows, reader=changed).joints, wanted) < 1e-5
        assert worst(view(tmp_path, rows, store, normalized=True).joints, wanted) < 1e-5
        half = changed.scaler(FIELD).unnormalize(changed[place][FIELD].half())
        assert worst(joints(half, store), wanted) < 0.02
    assert beyond > 1.01


def test_a_wider_scaler_is_named_and_travels(store: Store, tmp_path: Path) -> None:
    wide = WindowDataset(store, fields=(FIELD,), scale=Scale(covers=["mirror", "yaw"]), augment={"mirror": 1.0})
    plain = WindowDataset(store, fields=(FIELD,), scale=None, augment={"mirror": 1.0})
    rows, wanted = wide[3][FIELD].numpy(), joints(plain[3][FIELD], store)
    scaler, path = wide.scaler(FIELD), tmp_path / "scaler.json"
    scaler.save(path)
    assert np.abs(rows).max() <= 1 + 1e-4
    assert worst(dancedata.decode(rows, FIELD, like=store, normalized=True).joints(), wanted) > 0.01  # the stored one
    for given in (scaler, path, str(path)):
        assert worst(dancedata.decode(rows, FIELD, like=store, scaler=given).joints(), wanted) < 1e-5
        assert worst(dancedata.decode(rows, FIELD, fps=30, scaler=given).joints(), wanted) < 1e-5
        assert worst(evaluated(store, rows, scaler=given).joints, wanted) < 1e-5
        assert worst(view(tmp_path, rows, store, scaler=given).joints, wanted) < 1e-5
    assert worst(dancedata.decode(rows, FIELD, like=wide).joints(), wanted) < 1e-5
    for given in (wide, scaler, path, {FIELD: path}):
        val = WindowDataset(store, "val", (FIELD,), scale=given)
        np.testing.assert_array_equal(val.scaler(FIELD).data_min, scaler.data_min)
        val.load_state_dict(json.loads(json.dumps(wide.state_dict())))
    with raises_message(UsageError, "scalers"):
        WindowDataset(store, "val", (FIELD,)).load_state_dict(wide.state_dict())
    with raises_message(UsageError, "covers="):
        WindowDataset(store, "val", (FIELD,), scale=Scale(covers=["mirror"], scaler=wide))


def test_samples_state_the_scaler_that_they_need(store: Store, tmp_path: Path) -> None:
    plain, wide = (WindowDataset(store, fields=(FIELD,), scale=Scale(covers=of)) for of in ([], ["mirror"]))
    [file] = plain.save_samples(tmp_path / "gen", [plain[3]["id"]], plain[3][FIELD][None])
    wide.scaler(FIELD).save(tmp_path / "wide.json")
    named: tuple[dict[str, Any], ...] = ({"scaler": tmp_path / "wide.json"}, {"like": wide})
    for options in named:
        with raises_message(UsageError, "another scaler", where=str(file)):
            dancedata.evaluate(tmp_path / "gen", **options)
    command = ["decode", str(file), "--to", "bvh", "--out", str(tmp_path / "bvh")]
    assert "another scaler" in CliRunner().invoke(app, [*command, "--scaler", str(tmp_path / "wide.json")]).output
    assert CliRunner().invoke(app, command).exit_code == 0
    dancedata.evaluate(tmp_path / "gen", like=plain, intervals=False)


def test_two_arrays_of_a_width_are_not_one_motion(store: Store, tmp_path: Path) -> None:
    clip = store.clips()[0]
    rows = clip.read(FIELD)
    np.savez(tmp_path / f"{clip.id}.npz", samples=rows, motion=np.flip(rows, axis=0))
    with raises_message(DataError, "several arrays", reason="nothing_left"):
        dancedata.evaluate(tmp_path, like=store, normalized=False, intervals=False)


def test_a_reader_that_leaves_normalising_to_the_trainer_has_its_scaler(store: Store) -> None:
    wide = WindowDataset(store, fields=(FIELD,), scale=Scale(fields=(), covers=["yaw"]), augment={"mirror": 1.0})
    rows = wide[3][FIELD].numpy()
    scaled, wanted = wide.scaler(FIELD).normalize(rows), joints(rows, store)
    assert worst(dancedata.decode(scaled, FIELD, like=wide, normalized=True).joints(), wanted) < 1e-5
    assert worst(dancedata.decode(rows, FIELD, like=wide).joints(), wanted) < 1e-5
    val = WindowDataset(store, "val", (FIELD,), scale=wide)
    np.testing.assert_array_equal(val.scaler(FIELD).data_min, wide.scaler(FIELD).data_min)
    val.load_state_dict(wide.state_dict())
    with raises_message(UsageError, "scalers"):
        WindowDataset(store, fields=(FIELD,), scale=None).load_state_dict(wide.state_dict())
    for call in (
        lambda: WindowDataset(store, fields=(FIELD,), scale=store),
        lambda: dancedata.decode(rows, FIELD, like=Subset(wide, [0])),
    ):
        with raises_message(UsageError, "reader"):
            call()
    other = WindowDataset(store, fields=("lodge139",))
    with raises_message(UsageError, "whether"):
        dancedata.decode(rows, FIELD, like=other)
    with raises_message(UsageError, "reader"):
        WindowDataset(store, fields=(FIELD,), scale=other)


def test_a_scaler_of_something_else_is_refused(store: Store, tmp_path: Path) -> None:
    scaler, rows = store.scaler(FIELD), store.read(store.windows("train")[0], FIELD)
    lodge = store.scaler("lodge139")
    other = Scaler("minmax", scaler.data_min, scaler.data_max, field=FIELD, columns=scaler.columns, dataset="0" * 64)
    named = Scaler("minmax", scaler.data_min, scaler.data_max, field="edge151.second")
    columns = Scaler("minmax", scaler.data_min, scaler.data_max, columns=scaler.columns[::-1])
    for wrong, problem in (
        (lodge, "different width"), (other, "another dataset"), (named, "another field"),
        (columns, "another columns"),
    ):  # fmt: skip
        wrong.save(tmp_path / "wrong.json")
        for given in (wrong, tmp_path / "wrong.json"):
            with pytest.raises(UsageError, match=problem):
                dancedata.decode(scaler.normalize(rows), FIELD, like=store, scaler=given)
    with raises_message(UsageError, "name the field"):
        WindowDataset(store, fields=(FIELD,), scale=lodge)
    with raises_message(UsageError, r"s\.data_min", where="field edge151"):
        WindowDataset(store, fields=(FIELD,), scale=other)
    with raises_message(UsageError, "scaler"):
        dancedata.decode(rows, FIELD, like=store, scaler=scaler, normalized=False)


def test_whether_columns_are_normalised_is_stated(store: Store, tmp_path: Path) -> None:
    rows = store[store.clips()[0].id].read(FIELD)
    normal, cache = store.scaler(FIELD).normalize(rows), tmp_path.with_name("cache")
    for wrong in (rows, normal):
        with raises_message(UsageError, "whether"):
            dancedata.decode(wrong, FIELD, like=store)
        with raises_message(UsageError, "whether", where="x.npy"):
            view(tmp_path, wrong, store)
        with raises_message(UsageError, "whether", where="x.npy"):
            dancedata.evaluate(tmp_path, like=store, field=FIELD, intervals=False, cache=cache)
        assert not (cache / "evaluate").exists(), "nothing is measured before"
        with raises_message(UsageError, "whether", where="x.npy"):
            comparison_of(tmp_path, store, file_format(store, field=FIELD))
    with raises_message(UsageError, "whether", where="small, field edge151"):
        Evaluator(store, FIELD)
    # A file may state it; then no argument is needed.
    (tmp_path / "x.npy").unlink()
    for normalized, columns in ((True, normal), (False, rows)):
        np.savez(tmp_path / "x.npz", columns=columns, normalized=normalized)
        dancedata.decode(tmp_path / "x.npz", to="npz", like=store, out=tmp_path / f"{normalized}")
        with np.load(tmp_path / f"{normalized}" / "x.npz") as made:
            assert worst(made["positions"], joints(rows, store)) < 1e-5
        with raises_message(UsageError, "whether", where="x.npz"):
            dancedata.evaluate(
                tmp_path / "x.npz", like=store, field=FIELD, normalized=not normalized, intervals=False
            )
    options: dict[str, Any] = {"metrics": ["pfc"], "intervals": False}
    assert dancedata.evaluate(tmp_path / "x.npz", like=store, field=FIELD, **options)["pfc"].value is not None


@pytest.mark.parametrize("field", [FIELD, "lodge139", "joints"])
def test_columns_that_are_not_as_stated_are_refused(store: Store, field: str) -> None:
    scaler = store.scaler(field)
    other = {True: "normalized=False", False: "normalized=True"}
    rng = np.random.default_rng(0)
    options: dict[str, Any] = {"protocol": "dancedata", "metrics": ["pfc"]}
    for window in list(store.windows("train"))[:3]:
        rows = store.read(window, field)
        for normalized, right in ((True, scaler.normalize(rows)), (False, rows)):
            noisy = right + rng.normal(0, 0.01, right.shape)
            evaluator = Evaluator(store, field, normalized=normalized, protocol=options["protocol"])
            name = f"{window.clip}@{window.start}+{window.length}"
            evaluator.update(np.stack([right, noisy]), [name, f"{name}~s1"])
            wrong = Evaluator(store, field, normalized=not normalized, protocol=options["protocol"])
            for columns in (right, noisy):
                wrong.reset()
                with pytest.raises(UsageError, match=f"but look .*{other[not normalized]}"):
                    wrong.update(columns[None], [name])


def test_normalised_positions_of_a_model_that_errs_are_not_taken_as_plain(store: Store) -> None:
    rows = store.read(store.windows("train")[0], "joints") + 5.0  # as in a capture volume whose corner is the origin
    scaler, plugin = Scaler("minmax", np.full(72, 6 - 1.45), np.full(72, 6 + 1.45)), REPRESENTATIONS.get("joints")()
    scaling = Scaling(scaler, normalized=False)
    normal = scaler.normalize(rows) + np.random.default_rng(0).normal(0, 0.01, rows.shape)
    with raises_message(UsageError, "stated"):
        scaling.undone(normal, plugin)
    np.testing.assert_array_equal(scaling.undone(rows, plugin)[0], rows)
    for size in (0.15, 0.3, 0.6, 1.0):  # a network that is not trained
        scaling.undone(np.random.default_rng(1).normal(0, size, rows.shape), plugin)


@pytest.mark.parametrize("field", [FIELD, "joints"])
def test_a_column_of_nan_hides_nothing(store: Store, field: str) -> None:
    scaler, plugin = store.scaler(field), REPRESENTATIONS.get(field)()
    rows = np.array(store.read(store.windows("train")[0], field))
    for normalized, right in ((True, scaler.normalize(rows)), (False, rows)):
        right[:, 0], right[3, 5] = np.nan, np.inf
        Scaling(scaler, normalized).undone(right, plugin)
        with raises_message(UsageError, "stated"):
            Scaling(scaler, not normalized).undone(right, plugin)


def test_doubts_are_a_warning(store: Store, caplog: pytest.LogCaptureFixture) -> None:
    scaler, plugin = store.scaler(FIELD), REPRESENTATIONS.get(FIELD)()
    rows = store.read(store.windows("train")[0], FIELD)
    # As a network with a mean-squared loss: vectors too short by 5 %, for its whole life.
    normal = scaler.normalize(np.concatenate([rows[:, :7], 0.95 * rows[:, 7:]], axis=1))
    for scaling, columns, words in (
        (Scaling(scaler, True), normal, ""), (Scaling(scaler, False), normal, "nearer to it with the other choice"),
        (Scaling(None, False), rows, ""), (Scaling(None, False), normal, "taken as not normalised"),
    ):  # fmt: skip
        _warn_once.cache_clear()
        caplog.clear()
        scaling.undone(columns, plugin)
        scaling.undone(columns, plugin)
        assert [words in message for message in caplog.messages] == ([True] if words else [])


@pytest.mark.parametrize("field", [FIELD, "lodge139", "joints"])
@pytest.mark.parametrize("normalized", [True, False])
def test_the_output_of_an_untrained_network_passes(store: Store, field: str, normalized: bool) -> None:
    rng, width = np.random.default_rng(1), store.fields[field].width
    evaluator = Evaluator(store, field, normalized=normalized)
    clip = store.clips()[0].id
    for size in (0.0, 0.1, 0.3, 1.0, 3.0):
        evaluator.reset()
        evaluator.update(rng.normal(0, size, (2, 150, width)) + 1e-4, [f"{clip}@{k}+150" for k in (0, 5)])
        still = np.tile(rng.normal(0, size, (1, 1, width)), (2, 150, 1)) + 1e-4
        evaluator.update(still, [f"{clip}@{k}+150" for k in (10, 15)])


def test_the_commands(store: Store, tmp_path: Path) -> None:
    wide = WindowDataset(store, fields=(FIELD,), scale=Scale(covers=["root_offset"]), augment={"mirror": 1.0})
    wide.scaler(FIELD).save(tmp_path / "scaler.json")
    (tmp_path / "bad.json").write_text("{}")
    (tmp_path / "made").mkdir()
    file, out = tmp_path / "made" / "x.npy", tmp_path / "out"
    np.save(file, wide[0][FIELD].numpy())
    decode = ("decode", file, "--to", "npz", "--like", store.path, "--overwrite", "--out", out)
    evaluate = ("evaluate", file.parent, "--like", store.path, "--metric", "pfc")
    view_ = ("view", store.path, "--compare", file.parent, "--no-browser")
    for command in (decode, evaluate, view_):
        for options, words in (
            ((), "nothing states whether these columns are normalised. State it: --normalized or "),
            (("--not-normalized",), "If they are normalised: --normalized\n"),
            (("--scaler", tmp_path / "bad.json"), "not a scaler file"),
        ):
            assert words in run(*command, "--field", FIELD, *options, code=2).stderr
    for command in (evaluate, decode):
        run(*command, "--field", FIELD, "--scaler", tmp_path / "scaler.json")
    wanted = joints(WindowDataset(store, fields=(FIELD,), scale=None, augment={"mirror": 1.0})[0][FIELD], store)
    with np.load(out / "x.npz") as made:
        assert worst(made["positions"], wanted) < 1e-5


def test_a_pool_knows_the_scaler_of_its_columns(store: Store, tmp_path: Path) -> None:
    scaler = store.scaler(FIELD)
    wide = WindowDataset(store, fields=(FIELD,), scale=Scale(covers=["mirror"])).scaler(FIELD)
    for name, own in (("plain", scaler), ("wide", wide)):
        (tmp_path / name).mkdir()
        for clip in list(store.clips())[:3]:
            np.save(tmp_path / name / f"{clip.id}.npy", own.normalize(clip.read(FIELD)))
    options: dict[str, Any] = {"like": store, "field": FIELD, "intervals": False, "metrics": ["fid_k"]}
    pool, saved = tmp_path / "wide", tmp_path / "pool.npz"
    wanted = dancedata.evaluate(pool, pool=pool, scaler=wide, save_pool=saved, **options)
    assert dancedata.evaluate(pool, pool=saved, scaler=wide, **options)["fid_k"].value == pytest.approx(
        wanted["fid_k"].value
    )
    with raises_message(UsageError, r"FILE\.npz", where="pool.npz"):
        dancedata.evaluate(tmp_path / "plain", pool=saved, normalized=True, **options)
    with raises_message(UsageError, r"FILE\.npz", where="pool.npz"):
        Evaluator(store, FIELD, normalized=True, pool=saved)
