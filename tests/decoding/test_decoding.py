"""decode of batches and of trainers' files: API, command, and what they refuse."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.contacts.velocity import Velocity
from dancedata.core.errors import DataError, StoreError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import REPRESENTATIONS
from dancedata.datasets.folder.facts import Declared
from dancedata.datasets.folder.load import Reading, load_motion
from dancedata.files import atomic
from dancedata.recipes.parse import parse_recipe
from dancedata.representations.edge151 import Edge151
from dancedata.store import Store, open_store
from dancedata.testing.examples import contact_rule_of, random_motion
from tests.messages import raises_message

DECODED = [name for name in REPRESENTATIONS.names() if REPRESENTATIONS.get(name).decodes]
METRES = Reading(Declared(unit="m", up="y"), Declared())


def _columns(name: str, n_frames: int = 30) -> tuple[Any, np.ndarray]:
    made = REPRESENTATIONS.get(name)()
    return made, made.encode(random_motion(made.skeleton, n_frames, turn_rad=0.3), contact_rule_of(made))


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    folder = tmp_path_factory.mktemp("decoding")
    document = {
        "recipe": 1, "name": "decoding", "dataset": {"synthetic": {"songs": 3, "clips_per_song": 2, "clip_s": 6}},
        "fps": 24, "windows": {"length_s": 5, "stride_s": 0.5}, "motion": {"edge151": {}},
    }  # fmt: skip
    recipe = parse_recipe(document)
    dancedata.build(recipe, folder / "source", folder / "store", cache=folder / "cache", jobs=1, progress=False)
    return open_store(folder / "store")


@pytest.mark.parametrize("name", DECODED)
def test_a_batch_is_its_motions(name: str) -> None:
    _, array = _columns(name)
    batch = np.stack([array, array[::-1], array])
    motions = dancedata.decode(batch, name, fps=24)
    assert len(motions) == 3
    for motion, rows in zip(motions, batch, strict=True):
        one = dancedata.decode(rows, name, fps=24)
        assert isinstance(one, Motion)
        assert motion.grid == one.grid == FrameGrid.of(24)
        np.testing.assert_array_equal(motion.joints(), one.joints())


@pytest.mark.parametrize(("name", "rate"), [("edge151", 30), ("fact219", 60), ("humanml263", 20), ("humanml264", 30)])
def test_the_rate_that_nobody_gave(name: str, rate: int) -> None:
    assert dancedata.decode(_columns(name)[1], name).grid == FrameGrid.of(rate)


def test_the_normaliser_is_undone(store: Store) -> None:
    windows = list(store.windows("train"))[:2]
    rows = np.stack([store.read(window, "edge151") for window in windows])
    normal = store.scaler("edge151").normalize(rows)
    for like in (store, store.path, str(store.path)):
        motions = dancedata.decode(normal, "edge151", like=like, normalized=True)
        for motion, wanted in zip(motions, rows, strict=True):
            assert motion.grid == FrameGrid.of(24)  # the dataset's
            plain = dancedata.decode(wanted, "edge151", fps=24)
            np.testing.assert_allclose(motion.joints(), plain.joints(), rtol=0, atol=1e-5)
    options: dict[str, Any] = {"like": store, "normalized": True}
    cut = dancedata.decode(np.clip(normal * 3, -1, 1), "edge151", **options)[0].translation
    np.testing.assert_array_equal(dancedata.decode(normal * 3, "edge151", clamp=True, **options)[0].translation, cut)
    beyond = dancedata.decode(normal * 3, "edge151", **options)[0].translation
    assert np.abs(beyond - cut).max() > 0.1


def test_invalid_input_of_decode(store: Store) -> None:
    _, array = _columns("edge151")
    cases: list[tuple[np.ndarray, str, dict[str, Any]]] = [
        (array[:, :139], "edge151", {}), (array[None, None], "edge151", {}), (array[:0], "edge151", {}),
        (array, "edge", {}), (array[:, :72], "bailando72", {}), (array, "edge151", {"fps": 30, "like": store}),
        (_columns("fact219")[1], "fact219", {"like": store}),
    ]  # fmt: skip
    for wrong, name, options in cases:
        with raises_message(UsageError, "bailando72|field|omit|these"):
            dancedata.decode(wrong, name, **options)
    for value in (array.astype(object), array.astype(str), array[:, :, None] > 0, [[1.0], [1.0, 2.0]], None):
        for options in ({}, {"like": store}):
            with pytest.raises(UsageError, match="these are not columns of edge151"):
                dancedata.decode(value, "edge151", **options)  # type: ignore[call-overload]
    batch = np.stack([array, array, array]).astype(np.float64)
    liked = {"like": store, "normalized": False}
    for value, options in ((np.nan, {}), (1e200, {}), (np.nan, liked), (np.inf, liked)):
        batch[1, 7, 20] = value
        with raises_message(DataError, "infinity", where="motion 1 of the batch, edge151", reason="nan"):
            dancedata.decode(batch, "edge151", **options)


@pytest.mark.parametrize("bent", ["requires_grad_", "bfloat16"])
def test_tensors_that_numpy_cannot_hold(bent: str) -> None:
    torch = pytest.importorskip("torch")
    with pytest.raises(UsageError, match=r"not columns of edge151.*tensor\.detach\(\)\.cpu\(\)\.float\(\)"):
        dancedata.decode(getattr(torch.zeros(4, 151), bent)(), "edge151")


def test_the_file_that_is_decoded_stays(tmp_path: Path) -> None:
    _, array = _columns("edge151")
    np.savez(tmp_path / "x.npz", sample=array)
    before = (tmp_path / "x.npz").read_bytes()
    (tmp_path / "link").symlink_to(tmp_path)
    for out in (tmp_path, tmp_path / "link"):
        with raises_message(UsageError, "replaced", where="x.npz"):
            dancedata.decode(tmp_path / "x.npz", "edge151", to="npz", out=out, fps=30, overwrite=True)
    assert (tmp_path / "x.npz").read_bytes() == before


def test_the_rate_that_a_file_states_is_that_of_its_columns(store: Store, tmp_path: Path) -> None:
    def decoded(rate: float, **options: Any) -> float:
        np.savez(tmp_path / "x.npz", columns=_columns("edge151")[1], normalized=False, fps=rate)
        options |= {"out": tmp_path / "out", "overwrite": True}
        (made,) = dancedata.decode(tmp_path / "x.npz", "edge151", to="npz", **options)
        with np.load(made) as arrays:
            return float(arrays["fps"])

    assert decoded(60.0) == 60
    assert decoded(60.0, fps=60) == 60
    assert decoded(24.0, like=store) == 24
    assert decoded(29.97, fps=29.97) == 29.97
    for options in ({"fps": 24}, {"like": store}, {"fps": 24, "like": store}):
        with raises_message(DataError, "states", where="x.npz", reason="bad_rate"):
            decoded(60.0, **options)
    with raises_message(DataError, "frame rate", where="x.npz", reason="bad_rate"):
        decoded(0.0, like=store)


@pytest.mark.parametrize("to", ["bvh", "npz", "smpl", "smplx"])
def test_a_trainers_file(store: Store, tmp_path: Path, to: Any) -> None:
    window = store.windows("train")[0]
    normal = store.scaler("edge151").normalize(store.read(window, "edge151"))
    np.save(tmp_path / "sample.npy", np.stack([normal, normal]))
    options: dict[str, Any] = {"out": tmp_path / "out", "like": store, "normalized": True}
    files = dancedata.decode(tmp_path / "sample.npy", "edge151", to=to, **options)
    suffix = "bvh" if to == "bvh" else "npz"
    assert [path.name for path in files] == [f"sample_000.{suffix}", f"sample_001.{suffix}"]
    wanted = dancedata.decode(store.read(window, "edge151"), "edge151", fps=24)
    if to == "npz":
        with np.load(files[1]) as file:
            np.testing.assert_allclose(file["positions"], wanted.joints(), rtol=0, atol=1e-5)
            assert (float(file["fps"]), str(file["fps_exact"]), str(file["skeleton"])) == (24, "24", "smpl24")
            assert file["joints"].tolist() == list(wanted.skeleton.joints)
            assert file["rotations"].shape == (120, 24, 3)
        return
    motion = load_motion(files[1], METRES if to == "bvh" else Reading(Declared(), Declared()))
    assert motion.grid == wanted.grid
    np.testing.assert_allclose(motion.joints()[:, 0], wanted.joints()[:, 0], rtol=0, atol=1e-5)
    if to == "bvh":
        np.testing.assert_allclose(motion.joints(), wanted.joints(), rtol=0, atol=1e-5)


def test_files_of_several_arrays(tmp_path: Path) -> None:
    _, array = _columns("edge151")
    np.savez(tmp_path / "out.npz", sample=array, music=np.zeros((30, 35)), names=np.array(["a"]))
    options: dict[str, Any] = {"to": "bvh", "fps": 30}
    (file,) = dancedata.decode(tmp_path / "out.npz", "edge151", out=tmp_path / "a", **options)
    assert file == tmp_path / "a" / "out.bvh"
    with (tmp_path / "out.pkl").open("wb") as pickled:
        pickle.dump({"pose": array}, pickled)
    dancedata.decode(tmp_path / "out.pkl", "edge151", out=tmp_path / "b", **options)
    assert (tmp_path / "b" / "out.bvh").read_bytes() == file.read_bytes()
    np.savez(tmp_path / "two.npz", one=array, two=array[:5])
    with raises_message(UsageError, "several", where="two.npz"):
        dancedata.decode(tmp_path / "two.npz", "edge151", out=tmp_path / "c", **options)
    dancedata.decode(tmp_path / "two.npz", "edge151", out=tmp_path / "c", key="two", **options)
    assert "Frames: 5\n" in (tmp_path / "c" / "two.bvh").read_text()
    with raises_message(UsageError, "array", where="two.npz"):
        dancedata.decode(tmp_path / "two.npz", "fact219", out=tmp_path / "d", **options)
    with raises_message(UsageError, "three", where="two.npz"):
        dancedata.decode(tmp_path / "two.npz", "edge151", out=tmp_path / "d", key="three", **options)
    assert not (tmp_path / "d").exists()


def test_nothing_is_guessed_or_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, array = _columns("edge151")
    np.save(tmp_path / "x.npy", np.stack([array, array]))
    path, out = tmp_path / "x.npy", tmp_path / "out"
    with raises_message(UsageError, "trainer", where="x.npy"):
        dancedata.decode(path, "edge151", to="bvh", out=out)
    with raises_message(UsageError, "format"):
        dancedata.decode(path, "edge151", to="fbx", out=out, fps=30)  # type: ignore[arg-type]
    with raises_message(DataError, "no such file", where="gone.npy", reason="nothing_matched"):
        dancedata.decode(tmp_path / "gone.npy", "edge151", to="bvh", out=out, fps=30)
    dancedata.decode(path, "edge151", to="bvh", out=out, fps=30)
    with raises_message(UsageError, "already", where="out/x_000.bvh"):
        dancedata.decode(path, "edge151", to="bvh", out=out, fps=30)
    dancedata.decode(path, "edge151", to="bvh", out=out, fps=30, overwrite=True)
    calls = []

    def full(place: Path, data: bytes) -> None:
        calls.append(place)
        if len(calls) == 2:
            raise OSError(28, "No space left on device")
        place.write_bytes(data)

    monkeypatch.setattr(atomic, "write_bytes", full)
    with raises_message(StoreError, "space", where="full"):
        dancedata.decode(path, "edge151", to="npz", out=tmp_path / "full", fps=30)
    assert not list((tmp_path / "full").iterdir())


def test_contacts_are_not_part_of_a_motion() -> None:
    motion = random_motion(Edge151().skeleton, 20, turn_rad=0.3)
    array = Edge151().encode(motion, Velocity())
    array[:, :4] = np.nan  # as networks give them: any number
    found = dancedata.decode(array, "edge151")
    np.testing.assert_allclose(found.joints(), motion.joints(), rtol=0, atol=1e-5)


def test_folders_patterns_and_lists_are_decoded_file_by_file(tmp_path: Path) -> None:
    options: dict[str, Any] = {"to": "npz", "fps": 30}
    with raises_message(DataError, "no file", where=tmp_path.name, reason="nothing_matched"):
        dancedata.decode(tmp_path, "edge151", out=tmp_path / "out", **options)
    rows = Edge151().encode(random_motion(Edge151().skeleton, 20, turn_rad=0.3), Velocity())
    for name in ("a.npy", "b.npy"):
        np.save(tmp_path / name, rows)
    (tmp_path / "notes.txt").write_text("")
    for n, what in enumerate((tmp_path, tmp_path / "*.npy", [tmp_path / "b.npy", tmp_path / "a.npy"])):
        written = dancedata.decode(what, "edge151", out=tmp_path / f"out{n}", **options)
        assert {path.name for path in written} == {"a.npz", "b.npz"}
    np.savez(tmp_path / "a.npz", rows)
    with raises_message(UsageError, "same name"):
        dancedata.decode(tmp_path, "edge151", out=tmp_path / "twice", **options)
    assert not (tmp_path / "twice").exists()
