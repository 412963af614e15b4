"""Samples named by their ids have the same numbers everywhere: in a folder, an evaluator, and in numpy."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import dancedata
from dancedata import Evaluator
from dancedata.cli.app import app
from dancedata.core.errors import DataError, UsageError
from dancedata.core.sample_id import safe_name
from dancedata.evaluation.report import Report
from dancedata.metrics.beats import beat_alignment, motion_beat_times
from dancedata.samples import Samples
from dancedata.samples.saved import save_samples
from dancedata.scene.comparisons import comparison_payload
from dancedata.scene.selection import ViewRequest, ViewSelection
from dancedata.store import Store, write_store
from dancedata.study.trials import begin_of, common_clips
from tests.groups_store import HEADER, stored
from tests.messages import raises_message

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


def by_hand(store: Store, name: str) -> float:
    """Return the alignment of one window's beats by numpy alone."""
    sample, step = Samples(store).require(name), 1 / 6
    joints = dancedata.decode(rows_of(store, name), "edge151", fps=30).joints()[:, :22]
    beats = store[sample.clip.id].beats() - sample.start / 30
    beats = beats[(beats >= step) & (beats <= (sample.length - 1) / 30 - step)]
    return beat_alignment(beats, motion_beat_times(joints, 30), sigma=0.05)


def numbers_of(report: Report) -> dict[str, list[float]]:
    """Return the beat alignment and PFC of each sample."""
    rows: dict[str, list[dict[str, Any]]] = {}
    for row in report.per_clip:
        rows.setdefault(row["clip"].rpartition("=")[2], []).append(dict(row))
    return {name: [float(np.mean([row[k] for row in of])) for k in ("bas", "pfc")] for name, of in rows.items()}


def test_every_command_has_the_numbers_of_numpy(copies: Store, tmp_path: Path) -> None:
    """Windows, whole clips, mirrored samples, copies at another tempo, takes, and samples of a source of a `Mix`."""
    ids = ids_of(copies)
    evaluator = Evaluator(copies, "edge151", normalized=False)
    for folder, source in (("gen", ""), ("mix", "a=")):
        (tmp_path / folder).mkdir()
        for name in ids:
            np.save(tmp_path / folder / f"{source}{name}.npy", rows_of(copies, name))
    for name in ids:
        evaluator.update(rows_of(copies, name)[None], [name])
    request = ViewRequest(copies.path, compare=(tmp_path / "gen",), field="edge151", normalized=False)
    walls = ViewSelection.of(replace(request, wall=True)).scenes
    wall = {
        item.members[1].sample: [float(dict(walls.scene(item).members[1].numbers)[name]) for name in ("BAS", "PFC")]
        for item in walls.items
    }
    folder = dancedata.evaluate(tmp_path / "gen", like=copies, **OPTIONS)
    found = {
        "folder": numbers_of(folder), "evaluator": numbers_of(evaluator.compute(intervals=False)),
        "wall": wall,
        "mix": numbers_of(dancedata.evaluate(tmp_path / "mix", like=copies, **OPTIONS)),
    }  # fmt: skip
    for name in ids:
        bas, pfc = found["folder"][name]
        hand = [by_hand(copies, name) if "@" in name else bas, pfc]
        for command, numbers in found.items():
            assert numbers[name] == pytest.approx(hand, rel=5e-3 if command == "wall" else 1e-6), (command, name)
    assert {command: set(numbers) for command, numbers in found.items()} == {command: set(ids) for command in found}
    # All begin at the same second of the music, a study too.
    seconds = {name: Samples(copies).require(name).music_start_s for name in ids}
    shown = ViewSelection.of(request).scenes
    assert {item.sample: item.clip.audio_start + copies.grid.seconds(item.start) for item in shown.items} == seconds
    of_files = ViewSelection.of(
        ViewRequest(tmp_path / "gen", like=copies.path, field="edge151", normalized=False)
    ).scenes
    assert {item.id: item.clip.audio_start for item in of_files.items} == seconds
    chosen = common_clips({"truth": shown, "gen": of_files})
    assert set(chosen) == {name for name in ids if not Samples(copies).require(name).clip.source}
    assert all(begin_of(items, {"truth": shown, "gen": of_files}) == 0 for items in chosen.values())
    assert folder.clips == tuple(sorted(ids))
    assert "windows of" in folder.matched
    originals = {Samples(copies).require(name).recording for name in ids}
    assert originals == {clip.id for clip in copies.clips() if not clip.source}


def test_dancers_of_a_group_have_the_numbers_of_numpy(duets: Store, tmp_path: Path) -> None:
    group = next(clip.group for clip in duets.clips() if clip.group)
    ids = [f"{safe_name(group)}@15+150~p{k}" for k in range(2)]
    evaluator = Evaluator(duets, "edge151", normalized=False)
    for name in ids:
        np.save(tmp_path / f"{name}.npy", rows_of(duets, name))
        evaluator.update(rows_of(duets, name)[None], [name])
    folder = dancedata.evaluate(tmp_path, like=duets, **OPTIONS)
    numbers = numbers_of(folder)
    assert [numbers[name][0] for name in ids] == pytest.approx([by_hand(duets, name) for name in ids], rel=1e-6)
    assert numbers_of(evaluator.compute(intervals=False)) == {name: pytest.approx(numbers[name]) for name in ids}


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
    assert sample.to_json() | {"recording": clip.id, "music_start_s": "1", "fps": "30"} == sample.to_json()
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


def test_a_file_states_its_id(store: Store, tmp_path: Path) -> None:
    clip = store.clips()[0]
    rows, name = clip.read("edge151")[20:170], f"{clip.id}@20+150"
    np.savez(tmp_path / "x.npz", samples=rows, id=name)
    stated = dancedata.evaluate(tmp_path, like=store, **OPTIONS)
    assert stated["bas"].value == pytest.approx(by_hand(store, name), rel=1e-6)


def test_a_sample_of_another_length_than_its_id_states_is_left_out(store: Store, tmp_path: Path) -> None:
    clip = store.clips()[0]
    np.save(tmp_path / f"{clip.id}@0+150.npy", clip.read("edge151")[:120])
    np.save(tmp_path / f"{clip.id}@3+150.npy", clip.read("edge151")[3:153])
    report = dancedata.evaluate(tmp_path, like=store, **OPTIONS)
    assert report.left_out[0][0] == f"{clip.id}@0+150"


def test_what_a_reader_saves_needs_no_statement(copies: Store, tmp_path: Path) -> None:
    pytest.importorskip("torch")
    from torch.utils.data import DataLoader

    from dancedata.torch import Scale, WindowDataset

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
    assert {len(scene.members) for scene in walled} == {2}
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
