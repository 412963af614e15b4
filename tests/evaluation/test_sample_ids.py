"""Samples named by their ids have the same numbers everywhere: in a folder, an evaluator, and in numpy."""

import html
import re
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.signal import find_peaks
from typer.testing import CliRunner

import dancedata
from dancedata import Evaluator
from dancedata.cli.app import app
from dancedata.core.errors import DataError, UsageError
from dancedata.core.sample_id import safe_name
from dancedata.evaluation.report import Report
from dancedata.pages.samples import write_samples_report
from dancedata.samples import Samples
from dancedata.samples.saved import save_samples
from dancedata.scene.comparisons import comparison_payload
from dancedata.scene.selection import ViewRequest, ViewSelection
from dancedata.store import Store, write_store
from dancedata.study.trials import Trial, begin_of, common_clips, shown_figures
from tests.groups_store import HEADER, stored
from tests.messages import raises_message

#: Beat alignment and PFC by the id of a sample.
Numbers = dict[str, list[float]]
OPTIONS: Mapping[str, Any] = {"normalized": False, "intervals": False}
RECIPE = {
    "recipe": 1, "name": "late", "dataset": {"synthetic": {"songs": 3, "clips_per_song": 2, "clip_s": 9}}, "fps": 30,
    "windows": {"length_s": 5, "stride_s": 0.5}, "motion": {"edge151": {}}, "audio": {"librosa35": {}},
    "augment": {"mirror": True, "tempo": {"speeds": [1.1]}},
}  # fmt: skip


@pytest.fixture(scope="module")
def copies(folder: Path) -> Store:
    """A dataset with mirrored and faster copies."""
    dancedata.build(RECIPE, out=folder / "copies", jobs=1, cache=folder / "cache", progress=False)
    return dancedata.open(folder / "copies")


def ids_of(store: Store) -> list[str]:
    """Windows of clips and of copies, a whole clip, a mirrored window, and a second take."""
    ids = [f"{safe_name(clip.id)}@{7 * k + 3}+150" for k, clip in enumerate(store.clips())]
    return [*ids, f"{ids[0]}~s1", f"{ids[1]}~mirror~draw0.0.4", safe_name(store.clips()[0].id)]


def rows_of(store: Store, name: str) -> np.ndarray:
    """Return the dances of the dataset that an id names."""
    sample = Samples(store).require(name)
    rows = store.read(sample.windows[0], "edge151")
    mirror = store.fields["edge151"].mirror
    return np.asarray(mirror.apply(rows) if sample.id.mirrored and mirror else rows)


def of_piece(joints: np.ndarray, beats: np.ndarray) -> tuple[float, float]:
    """Return beat alignment and PFC of joints (150, 22, 3), 30 frames per second, by numpy and scipy alone."""
    fine = CubicSpline(np.arange(150), joints)(np.arange(4 * 149 + 1) / 4)
    padded = np.pad(fine, ((10, 10), (0, 0), (0, 0)), "reflect", reflect_type="odd")
    fine = gaussian_filter1d(padded, 120 / 50, axis=0)[10:-10]
    speed = gaussian_filter1d(120 * np.linalg.norm(np.diff(fine, axis=0), axis=2).mean(axis=1), 120 / 12)
    lows = find_peaks(-speed, prominence=1e-4)[0]
    before, low, after = speed[lows - 1], speed[lows], speed[lows + 1]
    dance = (lows + 0.5 + (before - after) / (2 * (before - 2 * low + after))) / 120
    heard = beats[(beats >= 1 / 6) & (beats <= 149 / 30 - 1 / 6)]
    nearest = np.abs(heard[:, None] - dance).min(axis=1)
    push = np.diff(fine[:, 0], n=2, axis=0).clip(min=[-np.inf, 0, -np.inf])
    force = np.linalg.norm(push, axis=1)
    feet = np.linalg.norm(np.diff(fine[:, [7, 8, 10, 11]], axis=0)[1:, :, [0, 2]], axis=2)
    products = feet[:, [0, 2]].min(axis=1) * feet[:, [1, 3]].min(axis=1) * force / force.max()
    return float(np.exp(-(nearest**2) / (2 * 0.05**2)).mean()), float(10_000 * 4**2 * products.mean())


def by_hand(store: Store, name: str, joints: np.ndarray | None = None) -> list[float]:
    """Return the means of both over the pieces of a sample, 5 s every 2.5 s."""
    sample = Samples(store).require(name)
    if joints is None:
        joints = dancedata.decode(rows_of(store, name), "edge151", fps=30).joints()
    beats = store[sample.clip.id].beats() - sample.start / 30
    starts = range(0, len(joints) - 149, 75)
    return np.mean([of_piece(joints[k : k + 150, :22], beats - k / 30) for k in starts], axis=0).tolist()


def numbers_of(report: Report) -> Numbers:
    """Return the beat alignment and PFC of each sample."""
    rows: dict[str, list[dict[str, Any]]] = {}
    for row in report.per_clip:
        rows.setdefault(row["clip"].removeprefix("a="), []).append(dict(row))
    return {name: [float(np.mean([row[k] for row in of])) for k in ("bas", "pfc")] for name, of in rows.items()}


def of_folder(store: Store, folder: Path) -> Numbers:
    return numbers_of(dancedata.evaluate(folder / "gen" / "*.npy", like=store, **OPTIONS))


def of_evaluator(store: Store, folder: Path) -> Numbers:
    evaluator = Evaluator(store, "edge151", normalized=False)
    for file in sorted((folder / "gen").iterdir()):
        evaluator.update(np.load(file)[None], [file.stem])
    return numbers_of(evaluator.compute(intervals=False))


def of_mix(store: Store, folder: Path) -> Numbers:
    """Return those of samples of the source ``a`` of a `Mix`."""
    (folder / "mix").mkdir(exist_ok=True)
    for file in (folder / "gen").iterdir():
        shutil.copy(file, folder / "mix" / f"a={file.name}")
    return numbers_of(dancedata.evaluate(folder / "mix", like=store, **OPTIONS))


def of_wall(store: Store, folder: Path) -> Numbers:
    request = ViewRequest(store.path, compare=(folder / "gen",), field="edge151", normalized=False, wall=True)
    walls = ViewSelection.of(request).scenes
    dancers = {item.members[1].sample: walls.scene(item).members[1] for item in walls.items}
    return {name: [float(dict(of.numbers)[key]) for key in ("BAS", "PFC")] for name, of in dancers.items()}


def of_page(store: Store, folder: Path) -> Numbers:
    """Return the numbers that the page of samples shows."""
    page = folder / "page.html"
    scores = dancedata.evaluate(folder / "gen", like=store, **OPTIONS)
    write_samples_report(scores, store.path, page, clips=1, overwrite=True)
    text = page.read_text().partition('id="r-samples"')[2].partition("</figure>")[0].replace("−", "-")
    head, *rows = ([re.sub("<[^>]*>", "", cell) for cell in re.findall(r"<t[hd].*?</t[hd]>", row)]
                   for row in text.split("</tr>")[:-1])  # fmt: skip
    return {html.unescape(row[0]): [float(row[head.index(key)]) for key in ("BAS", "PFC")] for row in rows}


def of_study(store: Store, folder: Path) -> Numbers:
    """Return those of the dancers of trials, who begin at the second of the music at which their samples do."""
    views = {"truth": ViewRequest(store.path, compare=(folder / "gen",), field="edge151", normalized=False),
             "gen": ViewRequest(folder / "gen", like=store.path, field="edge151", normalized=False)}  # fmt: skip
    systems = {name: ViewSelection.of(view).scenes for name, view in views.items()}
    numbers = {}
    for name, items in common_clips(systems).items():
        _, dancer = shown_figures(Trial(0, "", name, *views), items, systems, 60)
        seconds = {systems[view].second(item) for view, item in items.items()}
        assert (begin_of(items, systems), seconds) == (0, {Samples(store).require(name).music_start_s})
        numbers[name] = by_hand(store, name, dancer.joints)
    return numbers


@pytest.fixture(scope="module")
def written(copies: Store, duets: Store, tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Store, Path]]:
    """Samples of a dataset with copies, and of one with groups, under their ids."""
    group = safe_name(next(clip.group for clip in duets.clips() if clip.group))
    folders = {}
    for store, ids in ((copies, ids_of(copies)), (duets, [f"{group}@15+150~p0", f"{group}@15+150~p1"])):
        folders[store.path.name] = store, tmp_path_factory.mktemp("samples")
        (folders[store.path.name][1] / "gen").mkdir()
        for name in ids:
            np.save(folders[store.path.name][1] / "gen" / f"{name}.npy", rows_of(store, name))
    return folders


@pytest.mark.parametrize(
    ("name", "command", "tolerance"),
    [
        *(("copies", command, 1e-6) for command in (of_folder, of_evaluator, of_mix)),
        *(("copies", command, 5e-3) for command in (of_wall, of_page, of_study)),  # three digits, or float32
        *(("duets", command, 1e-6) for command in (of_folder, of_evaluator, of_mix)), ("duets", of_page, 5e-3),
    ],
)  # fmt: skip
def test_every_command_has_the_numbers_of_numpy(written, name, command, tolerance):
    """Windows, whole clips, mirrored samples, copies at another tempo, takes, dancers of groups, and a `Mix`."""
    store, folder = written[name]
    ids = {file.stem for file in (folder / "gen").iterdir()}
    numbers = command(store, folder)
    assert set(numbers) == ids
    for sample, found in numbers.items():
        assert found == pytest.approx(by_hand(store, sample), rel=tolerance), sample


def test_readers_read_an_id_again(copies: Store, duets: Store) -> None:
    pytest.importorskip("torch")
    from dancedata.torch import ClipDataset, Dancers, GroupDataset, Mix, WindowDataset, Windows

    noisy: Any = {"augment": {"mirror": 0.5, "yaw": {"max_degrees": 90}}, "seed": 3, "fields": ("edge151",)}
    plain: Any = {"fields": ("edge151",)}
    mix = Mix({"a": WindowDataset(copies, "train", **noisy), "b": WindowDataset(copies, "val", **plain)})
    readers = (
        mix, mix.datasets[0], mix.datasets[1], GroupDataset(duets, "train", **plain),
        GroupDataset(duets, "train", dancers=Dancers(persons=1, choose="seed"), **plain),
        ClipDataset(copies, "train", windows=Windows(length_s=3), **noisy),
        WindowDataset(copies, "train", augment={"mirror": 0.5}, **plain),
    )  # fmt: skip
    for reader in readers:
        for sample in reader.samples(range(len(reader)), 2):
            again = reader[sample["id"]]
            assert again["id"] == sample["id"]
            assert np.array_equal(again["edge151"].numpy(), sample["edge151"].numpy())
    for reader, name in ((mix, "c=x"), (mix.datasets[0], mix.datasets[1][0]["id"]), (mix.datasets[0], "x~draw4.0.0")):
        with raises_message(UsageError, "source|read"):
            reader[name]


def test_samples_resolve(copies: Store) -> None:
    clip = copies.clips()[0]
    sample = Samples(copies).require(f"{clip.id}@30+150")
    assert sample.music_start_s == 1
    assert sample.recording == clip.id
    copy = next(c for c in copies.clips() if c.source)
    assert Samples(copies).require(copy.id).recording == copy.source
    assert Samples(copies).find("nobody") is None


def test_dancers_have_the_numbers_of_the_source(tmp_path: Path) -> None:
    dancers = [replace(clip, member=clip.member + 1) for clip in stored({"train": (2,)}) if clip.group]
    write_store(tmp_path, HEADER, dancers)
    with dancedata.open(tmp_path) as ds:
        numbers = {clip.id: clip.member for clip in ds}
        for clip, number in numbers.items():
            assert [found.id for found in Samples(ds).require(f"train0@0+20~p{number}").clips] == [clip]
        with raises_message(DataError, "~p1, ~p2", reason="no_clip"):
            Samples(ds).require("train0@0+20~p0")


def test_a_clip_whose_name_looks_like_an_id(tmp_path: Path) -> None:
    [alone] = stored({})
    write_store(tmp_path, HEADER, [alone, replace(alone, id="alone~mirror")])
    with dancedata.open(tmp_path) as ds:
        assert [Samples(ds).require(clip.id).clip.id for clip in ds] == ["alone", "alone~mirror"]
        assert Samples(ds).require("alone~mirror~draw0.0.1").id.mirrored


def test_what_a_reader_saves_needs_no_statement(copies: Store, tmp_path: Path) -> None:
    pytest.importorskip("torch")
    import torch
    from torch.utils.data import DataLoader

    from dancedata.torch import Scale, WindowDataset

    torch.manual_seed(0)  # it draws the epoch of a loader without a sampler, so which windows are mirrored
    data = WindowDataset(copies, "test", fields=("edge151",), scale=Scale(), augment={"mirror": 0.5}, seed=3)
    evaluator = Evaluator(data, "edge151")
    written = []
    for batch in DataLoader(data, batch_size=4):
        evaluator.update(batch["edge151"], batch["id"])
        written += data.save_samples(tmp_path / "gen", batch["id"], batch["edge151"])
    assert sorted(path.stem for path in written) == sorted(evaluator.compute().clips)
    assert any("~mirror" in path.stem for path in written)
    folder = dancedata.evaluate(tmp_path / "gen", intervals=False)
    for score in evaluator.compute().scores:
        assert folder[score.name].value == pytest.approx(score.value, rel=1e-5), score.name
    assert any("the dances of the dataset themselves" in warning for warning in folder.warnings)
    for command in (
        ["evaluate", "gen", "-q"],
        ["report", "gen", "-q"],
        ["decode", "gen", "--to", "bvh", "--out", "x"],
    ):
        words = [str(tmp_path / word) if word in ("gen", "x") else word for word in command]
        words += ["--out", str(tmp_path / "page.html")] if command[0] == "report" else []
        found = CliRunner().invoke(app, words, catch_exceptions=False)
        assert found.exit_code == 0, found.output
    assert {path.stem for path in (tmp_path / "x").iterdir()} == {path.stem for path in written}
    for wall in (False, True):
        shown = ViewSelection.of(ViewRequest(tmp_path / "gen", wall=wall))
        assert len(shown.scenes.items) == len(written)
        distances = [
            comparison_payload(shown.comparisons[-1], shown.scenes.scene(item))["mean"] for item in shown.scenes.items
        ] if not wall else [0.0]  # fmt: skip
        assert max(distances) < 1  # mm: each beside its own truth, mirrored where it is
    walled = [shown.scenes.scene(item) for item in shown.scenes.items]
    assert {tuple(member.item.called for member in scene.members) for scene in walled} == {("truth", "gen")}
    page = dict(walled[0].members[1].numbers)
    of_sample = [row for row in folder.per_clip if row["clip"] == shown.scenes.items[0].members[0].sample]
    assert page["BAS"] == f"{of_sample[0]['bas']:.3f}"


def test_what_save_samples_refuses(copies: Store, tmp_path: Path) -> None:
    name, rows = f"{copies.clips()[0].id}@0+150", copies.clips()[0].read("edge151")[None, :150]
    options: dict[str, Any] = {"field": "edge151", "scaler": None}
    save_samples(copies, tmp_path, [name], rows, **options)
    for ids, given, message in (
        ([name], options, "already there"), ([name.replace("+150", "+151")], options, "shorter"),
        (["nobody@0+150"], options, "no clip"), (name, options, "a list of ids"),
        ([name], {**options, "scaler": copies.scaler("edge151")}, "another"),
    ):  # fmt: skip
        with raises_message((UsageError, DataError), message):
            save_samples(copies, tmp_path, ids, rows, **given)
    with raises_message(DataError, "number", reason="two_samples"):
        save_samples(copies, tmp_path / "twice", [name, name], np.concatenate([rows, rows + 1]), **options)
    with raises_message(DataError, "finite"):
        save_samples(copies, tmp_path / "nan", [name], rows * np.nan, **options)
    assert not (tmp_path / "twice").exists()
    save_samples(copies, tmp_path, [name], rows, overwrite=True, **options)
    save_samples(copies, tmp_path / "scaled", [name], rows, field="edge151", scaler=copies.scaler("edge151"))
    copies.scaler("edge151", kind="zscore").save(tmp_path / "scaled/scaler.json")
    with raises_message(UsageError, "scaler", where="scaler.json"):
        dancedata.evaluate(tmp_path / "scaled", intervals=False)
    (tmp_path / "samples.json").write_text("{}")
    with raises_message(UsageError, "say", where="samples.json"):
        dancedata.evaluate(tmp_path, intervals=False)


def test_the_field_is_that_of_the_width(store: Store, tmp_path: Path) -> None:
    """The first of the dataset's fields is edge151; samples of lodge139 are read as such."""
    clip = store.clips()[0]
    np.save(tmp_path / f"{clip.id}@0+150.npy", clip.read("lodge139")[:150])
    plain = dancedata.evaluate(tmp_path, like=store, **OPTIONS)
    assert plain["pfc"].value == dancedata.evaluate(tmp_path, like=store, field="lodge139", **OPTIONS)["pfc"].value
    assert plain["pfc"].truth == pytest.approx(plain["pfc"].value, rel=1e-3)
