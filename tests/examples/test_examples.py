"""The examples train, generate and resume; they write the documented files."""

import json
import re
import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("accelerate")

import torch
from safetensors.torch import load_file

import dancedata
from dancedata.formats.bvh.kinematics import world
from dancedata.formats.bvh.parse import read_bvh
from dancedata.testing.stores import random_fields, write_random_store

EXAMPLES = Path(__file__).parents[2] / "examples"
SMALL = ["--cpu", "--width", "16", "--layers", "1", "--ddim", "2", "--rate", "5e-3"]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small demo with the fields of both examples, and its music next to it."""
    folder = tmp_path_factory.mktemp("examples")
    overrides = {
        "dataset.synthetic": {"songs": 3, "clips_per_song": 3, "clip_s": 7},
        "motion": {"edge151": {}, "lodge139": {}},
        "keymotion": {"lodge": {}},
    }
    result = dancedata.build(
        "demo", out=folder / "data", overrides=overrides, jobs=1, cache=folder / "cache", progress=False
    )
    assert result is not None
    return folder / "data"


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, data: Path) -> Callable[..., None]:
    """Run an example as a script does, in this process: another one would import torch again."""
    monkeypatch.syspath_prepend(str(EXAMPLES))

    def run(name: str, out: Path, *arguments: str, data: Path = data) -> None:
        monkeypatch.setattr(sys, "argv", [name, "--data", str(data), "--out", str(out), *SMALL, *arguments])
        runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")

    return run


def losses(out: Path) -> list[float]:
    return [json.loads(line)["loss"] for line in (out / "log.jsonl").read_text().splitlines()]


def check_dance(out: Path, frames: int) -> None:
    """The BVH is read back, is at the position of the figure in the browser, and has bones of constant length."""
    bvh = read_bvh(out / "dance.bvh")
    assert not np.any(bvh.joints[0].offset)  # readers that add it to the channels agree with those that do not
    _, places = world(bvh, range(len(bvh.joints)), slice(None))
    places = np.asarray(places)
    assert places.shape == (frames, len(bvh.joints), 3)
    assert np.isfinite(places).all()
    for joint, about in enumerate(bvh.joints):
        if about.parent is not None and about.parent >= 0:
            bone = np.linalg.norm(places[:, joint] - places[:, about.parent], axis=-1)
            np.testing.assert_allclose(bone, np.linalg.norm(about.offset), atol=1e-4)
    figure = ElementTree.parse(out / "dance.svg").getroot()  # noqa: S314 (our own file)
    (animation,) = figure.iter("{http://www.w3.org/2000/svg}animate")
    paths = animation.get("values", "").split(";")
    assert len(paths) == frames
    numbers = np.array([[float(n) for n in re.findall(r"\d+", path)] for path in paths]).reshape(frames, -1, 2)
    middle = (places[..., 0].min() + places[..., 0].max()) / 2
    drawn = (numbers[..., 0].min() + numbers[..., 0].max()) / 2
    hip = numbers[:, 0, 0] - drawn  # the first bone begins at the root
    np.testing.assert_allclose(hip, (places[:, 0, 0] - middle) * 200, atol=2)


def test_edge_like_learns_generates_and_resumes(run: Callable[..., None], data: Path, tmp_path: Path) -> None:
    size = ["--seconds", "2", "--batch", "8"]
    (song,) = sorted((data.parent).rglob("*.wav"))[:1]
    run("train_edge_like", tmp_path / "once", *size, "--steps", "24", "--song", str(song))
    found = losses(tmp_path / "once")
    assert len(found) == 24
    assert np.mean(found[-4:]) < 0.6 * np.mean(found[:4])
    check_dance(tmp_path / "once", len(dancedata.features(song, "librosa35")))
    for steps in ("10", "24"):
        run("train_edge_like", tmp_path / "twice", *size, "--steps", steps)
    assert losses(tmp_path / "twice") == found
    weights = [load_file(tmp_path / name / "checkpoint" / "model.safetensors") for name in ("once", "twice")]
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[0])
    check_dance(tmp_path / "twice", len(dancedata.open(data).clips()[-1].read("librosa35")))


@pytest.mark.parametrize(("name", "field"), [("train_edge_like", "edge151"), ("train_lodge_like", "lodge139")])
def test_unusable_data_is_reported_in_one_line(run, tmp_path, name, field):
    fields = random_fields({"joints": 72}, {"librosa35": 35})
    write_random_store(tmp_path / "own", n_frames=(40, 40), length=20, fields=fields)
    # Python prints it, and ends with 1.
    with pytest.raises(SystemExit, match=f"^error: .*no field '{field}'; found joints, librosa35"):
        run(name, tmp_path, data=tmp_path / "own")


def test_lodge_like_learns_and_generates(run: Callable[..., None], data: Path, tmp_path: Path) -> None:
    run("train_lodge_like", tmp_path, "--frames", "192", "--segment", "48", "--steps", "24", "--batch", "8")
    found = losses(tmp_path)
    assert np.mean(found[-4:]) < 0.6 * np.mean(found[:4])
    check_dance(tmp_path, 192)
    with np.load(tmp_path / "primitives.npz") as made:
        assert made["frames"].shape == (13, 8, 139)
        assert (np.diff(made["start"]) >= 8).all()
        assert str(made["genre"]) == dancedata.open(data).clips()[-1].genre


def test_a_missing_song_is_an_error_before_training(run: Callable[..., None], tmp_path: Path) -> None:
    for name, size in (("train_edge_like", ["--seconds", "2"]), ("train_lodge_like", ["--frames", "128"])):
        with pytest.raises(SystemExit, match=r"nope\.wav.*exist"):
            run(name, tmp_path, *size, "--steps", "1", "--song", str(tmp_path / "nope.wav"))
    assert not (tmp_path / "log.jsonl").exists()
