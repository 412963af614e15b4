"""bvh, smpl, humanml3d and webdataset: what they write is read back, by this package and by independent readers."""

import io
import json
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.motion import Motion
from dancedata.core.registry import DATASETS
from dancedata.datasets.folder.facts import Declared
from dancedata.datasets.folder.load import Reading, load_motion
from dancedata.recipes.parse import parse_recipe
from dancedata.store import Store, open_store, write_store
from dancedata.testing.stores import write_random_store
from tests.messages import raises_message

DOCUMENT: dict[str, Any] = {
    "recipe": 1,
    "name": "motion",
    "dataset": {"synthetic": {"songs": 3, "clips_per_song": 2, "clip_s": 6}},
    "windows": {"length_s": 5, "stride_s": 0.5},
    "motion": {"edge151": {}, "humanml263": {}, "joints": {}},
}
#: Facts that a file's layout does not state.
ANY = Reading(Declared(), Declared())


def _build(folder: Path, **keys: Any) -> Path:
    recipe = parse_recipe({**DOCUMENT, **keys})
    dancedata.build(recipe, folder / "source", folder / "store", cache=folder / "cache", jobs=1, progress=False)
    return folder / "store"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _build(tmp_path_factory.mktemp("motion"))


@pytest.fixture(scope="module")
def store(dataset: Path) -> Store:
    return open_store(dataset)


def _stored(store: Store, clip: str) -> Motion:
    found = dancedata.decode(store[clip].read("edge151"), "edge151", fps=30)
    assert isinstance(found, Motion)
    return found


@pytest.fixture(scope="module")
def bvh(dataset: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bvh")
    dancedata.export(dataset, "bvh", out / "m", progress=False)
    dancedata.export(dataset, "bvh", out / "cm", progress=False, unit="cm")
    return out


@pytest.mark.parametrize("unit", ["m", "cm"])
def test_bvh_is_read_back(store: Store, bvh: Path, unit: str) -> None:
    reading = Reading(Declared(unit=unit, up="y"), Declared())
    clips = list(store.clips())
    assert {p.stem for p in (bvh / unit / f"bvh_{unit}").iterdir()} == {clip.id for clip in clips}
    for clip in clips[:2]:
        motion = load_motion(bvh / unit / f"bvh_{unit}" / f"{clip.id}.bvh", reading)
        wanted = _stored(store, clip.id)
        assert motion.grid == wanted.grid
        np.testing.assert_allclose(motion.joints(), wanted.joints(), rtol=0, atol=1e-5)


def test_bvh_has_a_rest_pose_and_ends(store: Store, bvh: Path) -> None:
    text = (bvh / "cm" / "bvh_cm" / f"{store.clips()[0].id}.bvh").read_text()
    assert text.startswith("HIERARCHY\nROOT pelvis\n{\n\tOFFSET 0.000000 0.000000 0.000000\n\tCHANNELS 6 Xposition")
    assert "OFFSET 5.858135 -8.228004 -1.766408" in text  # the left hip, in centimetres
    assert text.count("End Site") == 5
    assert "OFFSET 0.0 0.0 0.0" not in text
    assert "Frame Time: 0.0333333333\n" in text


@pytest.mark.parametrize("kind", ["amass", "smplx"])
def test_smpl_files_are_read_back(store: Store, dataset: Path, tmp_path: Path, kind: str) -> None:
    dancedata.export(dataset, "smpl", tmp_path / "out", progress=False, gender="male")
    clip = store.clips()[1].id
    path = tmp_path / "out" / kind / f"{clip}.npz"
    motion, wanted = load_motion(path, ANY), _stored(store, clip)
    assert motion.grid == wanted.grid
    np.testing.assert_allclose(motion.matrices[:, :22], wanted.matrices[:, :22], rtol=0, atol=1e-6)
    np.testing.assert_allclose(motion.joints()[:, 0], wanted.joints()[:, 0], rtol=0, atol=1e-6)
    with np.load(path) as file:
        assert file["poses"].shape == (wanted.n_frames, {"amass": 156, "smplx": 165}[kind])
        assert str(file["gender"]) == "male"
        # AMASS has +Z up.
        height = wanted.translation[:, 1] - wanted.translation[0, 1]
        np.testing.assert_allclose(file["trans"][:, 2] - file["trans"][0, 2], height, atol=1e-9)
        if kind == "smplx":
            joined = [file[k] for k in ("root_orient", "pose_body", "pose_jaw", "pose_eye", "pose_hand")]
            np.testing.assert_array_equal(np.concatenate(joined, axis=1), file["poses"])


def test_humanml3d(store: Store, dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    dancedata.export(dataset, "humanml3d", out, progress=False)
    vectors = {path.stem: np.load(path) for path in sorted((out / "new_joint_vecs").iterdir())}
    assert sorted(vectors) == sorted(clip.id for clip in store)
    for clip, rows in vectors.items():
        stored = store[clip].read("humanml263")
        assert rows.dtype == np.float32
        np.testing.assert_array_equal(rows, stored[:-1])
        joints = np.load(out / "new_joints" / f"{clip}.npy")
        assert joints.shape == (len(rows), 22, 3)
        back = dancedata.decode(rows, "humanml263")
        assert int(back.grid.rate) == 20
        np.testing.assert_allclose(back.joints(), joints, rtol=0, atol=1e-5)
    everything = np.concatenate(list(vectors.values())).astype(np.float64)
    np.testing.assert_allclose(np.load(out / "Mean.npy"), everything.mean(axis=0), rtol=0, atol=1e-6)
    deviation = everything.std(axis=0)
    # cal_mean_variance.ipynb, with J = 22: J - 1 positions, rotations in 6D, J velocities, 4 contacts.
    for part in ((0, 1), (1, 3), (3, 4), (4, 4 + 21 * 3), (4 + 21 * 3, 4 + 21 * 9), (193, 193 + 66), (259, 263)):
        deviation[slice(*part)] = deviation[slice(*part)].mean()
    np.testing.assert_allclose(np.load(out / "Std.npy"), deviation, rtol=1e-5)
    lists = {split: (out / f"{split}.txt").read_text().split() for split in ("train", "val", "test", "all")}
    assert lists["all"] == sorted(vectors)
    assert sorted(lists["train"] + lists["val"] + lists["test"]) == lists["all"]
    dancedata.export(dataset, "humanml3d", tmp_path / "scaled", progress=False, scaler="train")
    rows = np.concatenate([vectors[clip] for clip in lists["train"]]).astype(np.float64)
    np.testing.assert_allclose(np.load(tmp_path / "scaled" / "Mean.npy"), rows.mean(axis=0), rtol=0, atol=1e-6)


def _samples(path: Path) -> dict[str, dict[str, bytes]]:
    found: dict[str, dict[str, bytes]] = {}
    with tarfile.open(path) as tar:
        for member in tar:
            key, _, suffix = member.name.partition(".")
            assert (member.mtime, member.uid) == (0, 0)
            found.setdefault(key, {})[suffix] = tar.extractfile(member).read()  # type: ignore[union-attr]
    return found


def test_webdataset_holds_every_window_once(store: Store, dataset: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    dancedata.export(dataset, "webdataset", out, progress=False, fields=("edge151", "joints"), shard_mb=0.5)
    index = json.loads((out / "index.json").read_text())
    for split in store.splits:
        shards = sorted(out.glob(f"{split}-*.tar"))
        assert len(shards) > (split == "train")
        assert [shard.name for shard in shards] == sorted(s for s in index["shards"] if s.startswith(f"{split}-"))
        samples: dict[str, dict[str, bytes]] = {}
        for shard in shards:
            own = _samples(shard)
            assert len(own) == index["shards"][shard.name]
            samples |= own
        windows = list(store.windows(split))
        assert len(samples) == len(windows)
        for window in windows:
            sample = samples[f"{window.clip}_{window.start:06d}"]
            assert set(sample) == {"edge151.npy", "joints.npy", "json"}
            rows = np.load(io.BytesIO(sample["edge151.npy"]))
            np.testing.assert_array_equal(rows, store.read(window, "edge151"))
            about = json.loads(sample["json"])
            assert (about["start"], about["frames"], about["split"]) == (window.start, 150, split)
    keys = [key for shard in sorted(out.glob("train-*.tar")) for key in _samples(shard)]
    assert keys != sorted(keys)  # shuffled
    assert index["fields"]["edge151"]["scaler"]["data_min"]


def test_webdataset_of_clips_in_order(store: Store, dataset: Path, tmp_path: Path) -> None:
    dancedata.export(dataset, "webdataset", tmp_path / "out", progress=False, samples="clips", seed=-1)
    samples = _samples(tmp_path / "out" / "train-000000.tar")
    assert list(samples) == sorted(clip.id for clip in store if clip.split == "train")
    for clip, sample in samples.items():
        rows = np.load(io.BytesIO(sample["humanml263.npy"]))
        np.testing.assert_array_equal(rows, store[clip].read("humanml263"))


def test_webdataset_of_long_names(tmp_path: Path) -> None:
    """A name in a tar of POSIX's first format has a hundred bytes."""
    made = write_random_store(tmp_path / "random", clips={"train": 2})
    name = "x" * 198 + "ü"
    (tmp_path / "long").mkdir()
    write_store(tmp_path / "long", made.header, [replace(made.clips[0], id=name)])
    dancedata.export(tmp_path / "long", "webdataset", tmp_path / "out", samples="clips", progress=False)
    assert list(_samples(tmp_path / "out" / "train-000000.tar")) == [name]
    twice = (made.header.fields[0].name,) * 2
    with raises_message(StoreError, "webdataset", where="long"):
        dancedata.export(tmp_path / "long", "webdataset", tmp_path / "two", fields=twice, progress=False)


def test_missing_requirements_are_named(dataset: Path, tmp_path: Path) -> None:
    one = {"synthetic": {"songs": 3, "clips_per_song": 2, "clip_s": 6}}
    positions = _build(tmp_path, dataset=one, motion={"joints": {}})
    for target, parts in {
        "bvh": ["no field with rotations (it has joints)", "motion: {edge151: {}}"],
        "smpl": ["no field with rotations"],
        "humanml3d": ["no field humanml263", "motion: {humanml263: {}}"],
    }.items():
        with raises_message(StoreError, target, where="store") as caught:
            dancedata.export(positions, target, tmp_path / target, progress=False)
        assert all(part in str(caught.value) for part in parts), str(caught.value)
        assert not (tmp_path / target).exists()
    with raises_message(StoreError, "determine", where="store"):
        dancedata.export(dataset, "bvh", tmp_path / "out", progress=False, field="joints")
    with raises_message(StoreError, "webdataset", where="store"):
        dancedata.export(dataset, "webdataset", tmp_path / "out", progress=False, fields=("edge",))
    with raises_message(UsageError, "shard_mb"):
        dancedata.export(dataset, "webdataset", tmp_path / "out", progress=False, shard_mb=0)


def test_bvh_of_humanml3ds_columns(dataset: Path, store: Store, tmp_path: Path) -> None:
    """If only positions are restored, rotations are fitted to them."""
    dancedata.export(dataset, "bvh", tmp_path / "out", progress=False, field="humanml263")
    clip = store.clips()[0].id
    motion = load_motion(tmp_path / "out" / "bvh_m" / f"{clip}.bvh", Reading(Declared(unit="m", up="y"), Declared()))
    wanted = dancedata.decode(store[clip].read("humanml263"), "humanml263").joints()
    np.testing.assert_allclose(motion.joints()[:, :22], wanted, rtol=0, atol=1e-4)


# ---- words


@pytest.fixture(scope="module")
def worded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Clips with captions: with tokens, without, of a part, of the whole clip."""
    folder = tmp_path_factory.mktemp("worded")
    DATASETS.get("folder")().make_example(folder / "source")
    (folder / "source" / "texts").mkdir()
    (folder / "source" / "texts" / "own.txt").write_text(
        "steps left # twice#step/VERB left/ADJ#0.0#0.0\nwaves#wave/VERB#0.0#0.0\nspins#spin/VERB#1.5#3.0\n"
    )
    (folder / "source" / "segments.csv").write_text(
        'clip,start,end,layer,label,text\namass_poses,1,2,description,turn,"The dancer\'s left turn"\n'
    )
    recipe = {
        "recipe": 1, "name": "w", "dataset": {"folder": {"fps": 30, "unit": "m", "up": "y", "language": "en"}},
        "fps": 20, "windows": {"length_s": 2, "stride_s": 1}, "motion": {"humanml263": {}}, "audio": {},
        "augment": {"mirror": True},
    }  # fmt: skip
    dancedata.build(recipe, folder / "source", folder / "out", cache=folder / "cache", jobs=1, progress=False)
    return folder / "out"


def test_captions_as_humanml3ds_loader_reads_them(worded: Path, tmp_path: Path) -> None:
    with raises_message(StoreError, "amass_poses__mirror", where="out"):
        dancedata.export(worded, "humanml3d", tmp_path / "out", progress=False)
    result = dancedata.export(worded, "humanml3d", tmp_path / "out", progress=False, tokens="plain")
    assert "no captions for" in result.summary
    texts = {path.stem: path.read_text().splitlines() for path in (tmp_path / "out" / "texts").iterdir()}
    assert texts == {
        "own": [
            "steps left twice#step/VERB left/ADJ#0.0#0.0", "waves#wave/VERB#0.0#0.0", "spins#spin/VERB#1.5#3.0",
        ],
        "own__mirror": [
            "steps right twice#step/VERB right/ADJ#0.0#0.0", "waves#wave/VERB#0.0#0.0", "spins#spin/VERB#1.5#3.0",
        ],
        "amass_poses": ["The dancer's left turn#the/OTHER dancer's/OTHER left/OTHER turn/OTHER#1.0#2.0"],
        "amass_poses__mirror": ["The dancer's right turn#the/OTHER dancer's/OTHER right/OTHER turn/OTHER#1.0#2.0"],
    }  # fmt: skip
    # As HumanML3D's Text2MotionDataset does.
    for line in texts["own"]:
        caption, tokens, start, end = line.strip().split("#")
        assert all(len(token.split("/")) == 2 for token in tokens.split(" "))
        assert float(start) <= float(end)
        assert caption
