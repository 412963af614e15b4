"""EDGE's folders and cache as its loader makes them, POPDG's at 30 per second; Lodge's and FineDance's folders."""

import json
import pickle
import shutil
import sys
import wave
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import dancedata
from dancedata.core.errors import DataError, StoreError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24
from dancedata.exports.base.run import ExportResult
from dancedata.files.atomic_folder import AtomicFolder
from dancedata.music.signal import load_audio
from tests.exports.conftest import cut
from tests.messages import raises_message


def names(folder: Path) -> list[str]:
    return sorted(path.stem for path in folder.iterdir())


def loaded(path: Path) -> dict[str, np.ndarray]:
    return pickle.loads(path.read_bytes())


def motion_of(pos: np.ndarray, q: np.ndarray) -> Motion:
    return Motion(pos.astype(float), q.reshape(len(q), 24, 3).astype(float), FrameGrid.of(30), SMPL24)


def _name(clip, start: int) -> str:
    return clip.id if clip.slice_of else f"{clip.id}_slice{start // 15}"


@pytest.mark.parametrize("recipe", ["edge", "edge-exact"])
def test_slices_and_cache_give_back_the_windows(export: Callable[..., ExportResult], built, recipe: str) -> None:
    out, store = export(recipe, "edge").path, built(recipe).store
    for part in ("train", "test"):
        windows = {_name(store[w.clip], w.start): w for w in store.windows(part)}
        folders = ("motions_sliced", "wavs_sliced", "jukebox_feats", "baseline_feats")
        listed = [names(out / part / folder) for folder in folders]
        assert listed == [listed[0]] * 4
        assert set(listed[0]) <= set(windows)
        cache = loaded(out / "cache" / f"processed_{part}_data.pkl")
        assert [Path(p).stem for p in cache["filenames"]] == sorted(listed[0], key=lambda name: f"{name}.npy")
        assert all(Path(p).is_file() for p in (*cache["filenames"], *cache["wavs"]))
        assert all(p.startswith(f"{out}/{part}/") for p in (*cache["filenames"], *cache["wavs"]))
        for number, name in enumerate(Path(p).stem for p in cache["filenames"]):
            piece = loaded(out / part / "motions_sliced" / f"{name}.pkl")
            assert {k: (v.shape, v.dtype.str) for k, v in piece.items()} == {
                "pos": ((300, 3), "<f4"), "q": ((300, 72), "<f4")
            }  # fmt: skip
            for key in ("pos", "q"):
                np.testing.assert_array_equal(piece[key][::2], cache[key][number])
                np.testing.assert_array_equal(piece[key][1::2], cache[key][number])
            # Back again: in EDGE's own quantities, contacts aside, which a window's last frame does not keep.
            again = dancedata.encode(motion_of(cache["pos"][number], cache["q"][number]), "edge151")
            np.testing.assert_allclose(again[:, 4:], store.read(windows[name], "edge151")[:, 4:], atol=1e-5)
            for folder in ("jukebox_feats", "baseline_feats"):
                rows = np.load(out / part / folder / f"{name}.npy")
                assert rows.dtype == np.float32
                np.testing.assert_array_equal(rows, store.read(windows[name], "librosa35"))


def test_sounds_are_cut_as_edge_cuts_them(export: Callable[..., ExportResult], built) -> None:
    out, made = export("edge", "edge").path, built("edge")
    path = next(p for p in sorted((out / "train" / "wavs_sliced").iterdir()) if p.stem.endswith("_slice1"))
    clip = made.store[path.stem.removesuffix("_slice1")]
    signal = load_audio(made.source / "wavs" / f"{clip.music}.wav")
    rate = signal.sample_rate
    with wave.open(str(path)) as file:
        assert (file.getframerate(), file.getnchannels(), file.getsampwidth()) == (rate, 1, 2)
        found = np.frombuffer(file.readframes(file.getnframes()), "<i2")
    piece = signal.samples[rate // 2 : rate // 2 + 5 * rate]
    assert len(found) == 5 * rate
    np.testing.assert_array_equal(found, np.floor(piece.astype(float) * 32768))


def _cut_music(source: Path, out: Path, seconds: Callable[[str], float]) -> Path:
    """Copy the songs of a source, cut short."""
    out.mkdir(parents=True)
    for path in (source / "wavs").iterdir():
        (out / path.name).write_bytes(cut(path.read_bytes(), seconds(path.stem)))
    return out


def _of_cut_music(made, folder: Path, seconds: Callable[[str], float]) -> tuple[Path, Path]:
    """Return a source whose songs are cut short, and a dataset built from it."""
    source, out = folder / "source", folder / "short"
    _cut_music(made.source, source / "wavs", seconds)
    for part in ("motions", "splits", "ignore_list.txt", "cameras"):
        (source / part).symlink_to(made.source / part)
    recipe = {**made.store.info["recipe"], "dataset": {"aist++": {}}}
    dancedata.build(recipe, source, out, jobs=1, cache=folder / "cache", progress=False)
    return source, out


def test_windows_without_whole_sound_are_left_out(export, built, tmp_path: Path) -> None:
    ends = {clip.music: clip.n_frames / 30 for clip in built("edge").store.clips()}
    source, out = _of_cut_music(built("edge"), tmp_path, lambda music: ends.get(music, 99) - 0.02)
    short = dancedata.open(out)
    done = dancedata.export(short.path, "edge", tmp_path / "out", source=source, progress=False)
    gone = {f"{w.clip}_slice{w.start // 15}" for s in ("train", "test") for w in short.windows(s)}
    gone -= {*names(done.path / "train" / "wavs_sliced"), *names(done.path / "test" / "wavs_sliced")}
    assert gone
    assert all(any(name in note and "left out" in note for note in done.notes) for name in sorted(gone)[:1])


@pytest.mark.parametrize("to", ["edge", "npz"])
def test_a_damaged_copy_of_the_music_is_not_taken(built, tmp_path: Path, to: str) -> None:
    """Too short for any window, or not decoded at all, it is still not the music of the dataset."""
    made = built("edge")
    short = _cut_music(made.source, tmp_path / "cut", lambda music: 1.5)
    with raises_message(DataError, "match", reason="other_music"):
        dancedata.export(made.path, to, tmp_path / "out", source=short, progress=False)
    assert [p.name for p in tmp_path.iterdir()] == ["cut"]


def test_splits_whose_windows_have_no_sound_are_refused(built, tmp_path: Path) -> None:
    """Every clip has one window, whose music ends a few samples before its last frame does."""
    source, _ = _of_cut_music(built("edge"), tmp_path, lambda music: 4.99)
    assert {w.start for w in dancedata.open(tmp_path / "short").windows("train")} == {0}
    with raises_message(StoreError, "longer", where="short"):
        dancedata.export(tmp_path / "short", "edge", tmp_path / "out", source=source, progress=False)
    assert not (tmp_path / "out").exists()


def test_pickles_of_empty_arrays(tmp_path: Path) -> None:
    folder = AtomicFolder(tmp_path, tmp_path)
    folder.write_pickle("a", {"none": np.empty((0, 150, 3), np.float32), "one": np.float32(2) * np.ones(())})
    held = loaded(tmp_path / "a")
    assert (held["none"].shape, held["one"].shape, float(held["one"])) == ((0, 150, 3), (), 2.0)


def test_windows_that_the_dataset_has_left_out_are_noted(export, built) -> None:
    """Those that another field does not reach the end of."""
    fields = {"edge151": {}, "fact219": {}}
    made = built("edge", motion=fields)
    clip, start = next((r["clip"], r["window"]) for r in made.store.rejects if r["reason"] == "short_field")
    out = export("edge", "edge", source=None, sound="silence")
    assert not any("left out" in note for note in out.notes)
    out = dancedata.export(made.path, "edge", out.path.with_name("two"), sound="silence", progress=False)
    (note,) = (note for note in out.notes if "the dataset has left out" in note)
    assert f"1 window that the dataset has left out: {clip} from frame {start} (short_field)" == note


def test_val_is_named_and_may_be_test(export) -> None:
    without = export("edge", "edge")
    assert any("the split val" in note and "val_as_test" in note for note in without.notes)
    with_val = export("edge", "edge", "two", val_as_test=True)
    n = [len(names(r.path / "test" / "wavs_sliced")) for r in (without, with_val)]
    assert n[1] > n[0] > 0


def test_silence_needs_no_source(export) -> None:
    done = export("edge", "edge", source=None, sound="silence", link=True)
    sounds = sorted((done.path / "train" / "wavs_sliced").iterdir())
    assert {p.stat().st_ino for p in sounds} == {sounds[0].stat().st_ino}
    with wave.open(str(sounds[0])) as file:
        assert file.getnframes() == 5 * file.getframerate()
        assert set(file.readframes(file.getnframes())) == {0}


def test_pickles_load_where_numpy_has_no_private_modules(export) -> None:
    out = export("edge", "edge").path
    for path in (next((out / "train" / "motions_sliced").iterdir()), out / "cache" / "processed_test_data.pkl"):
        data = path.read_bytes()
        assert b"_core" not in data.split(b"filenames")[0][:2000]
        arrays = loaded(path)
        arrays["pos"][0] = 1  # writable
        assert b"numpy\x94\x8c\x07ndarray" in data


def test_popdg_has_each_frame_once(export, built) -> None:
    out, store = export("edge", "popdg").path, built("edge").store
    path = sorted((out / "train" / "motions_sliced").iterdir())[0]
    piece = loaded(path)
    assert (piece["pos"].shape, piece["q"].shape) == ((150, 3), (150, 72))
    clip, _, number = path.stem.rpartition("_slice")
    rows = store.read(
        next(w for w in store.windows("train") if w.clip == clip and w.start == 15 * int(number)), "edge151"
    )
    # The loader's turn, (x, y, z) -> (x, z, -y), and what it adds.
    np.testing.assert_allclose(piece["pos"][:, [0, 2, 1]] * [1, 1, -1] + [0, -5, 1], rows[:, 4:7], atol=1e-5)
    turned = Rotation.from_euler("x", -90, degrees=True) * Rotation.from_rotvec(piece["q"][:, :3])
    np.testing.assert_allclose(turned.as_matrix()[:, :2].reshape(-1, 6), rows[:, 7:13], atol=1e-5)
    assert (out / "high_quality_dataset").read_text() == ""
    assert (out / "splits" / "train.txt").read_text().splitlines() == [c.id for c in store if c.split == "train"]


@pytest.mark.parametrize("field", ["lodge139", "lodge319"])
def test_tracks_begin_at_the_trim_and_decode_again(export: Callable[..., ExportResult], built, field: str) -> None:
    pytest.importorskip("torch")
    out, store = export("finedance", "lodge", motion=field).path / "finedance", built("finedance").store
    assert any(clip.trim_start for clip in store)
    assert sorted(p.stem for p in (out / "label_json").iterdir()) == sorted(clip.id for clip in store)
    for clip in store:
        motion, music = (np.load(out / folder / f"{clip.id}.npy") for folder in ("mofea319", "music_npynew"))
        np.testing.assert_array_equal(motion, clip.read(field)[clip.trim_start :])
        np.testing.assert_array_equal(music, clip.read("librosa35")[clip.trim_start :])
        assert json.loads((out / "label_json" / f"{clip.id}.json").read_text()) == {"style2": clip.genre}
        # Back again, trimmed and grounded: already on the ground, so encoding moves nothing.
        again = dancedata.encode(dancedata.decode(motion, field), field)
        np.testing.assert_allclose(again, motion, atol=1e-5)


@pytest.mark.parametrize("over", ["all", "train"])
def test_the_normaliser_is_of_lodges_classes(export, built, over: str, tmp_path, monkeypatch) -> None:
    torch = pytest.importorskip("torch")
    out, store = export("finedance", "lodge", scaler=over).path, built("finedance").store
    assert not any(name.startswith("dld") for name in sys.modules)
    # The part of Lodge's module that a pickle needs.
    module = tmp_path / "site" / "dld" / "data" / "utils"
    module.mkdir(parents=True)
    (module / "preprocess.py").write_text("class Normalizer: pass\nclass MinMaxScaler: pass\n")
    monkeypatch.syspath_prepend(tmp_path / "site")
    try:
        made = torch.load(out / "Normalizer.pth", weights_only=False)
        from dld.data.utils import preprocess

        assert type(made) is preprocess.Normalizer
        assert type(made.scaler) is preprocess.MinMaxScaler
    finally:
        for name in [name for name in sys.modules if name.split(".")[0] == "dld"]:
            del sys.modules[name]
    clips = [c for c in store if over == "all" or c.split == "train"]
    rows = np.concatenate([c.read("lodge139")[c.trim_start :] for c in clips])
    scaler = made.scaler
    facts = (scaler.feature_range, scaler.clip, scaler.copy, scaler.n_samples_seen_)
    assert facts == ((-1, 1), True, True, len(rows))
    np.testing.assert_array_equal(scaler.data_min_.numpy(), rows.min(axis=0))
    np.testing.assert_array_equal(scaler.data_max_.numpy(), rows.max(axis=0))
    normal = rows * scaler.scale_.numpy() + scaler.min_.numpy()
    assert all(t.dtype == torch.float32 for t in (scaler.scale_, scaler.min_, scaler.data_range_))
    np.testing.assert_allclose((normal.min(), normal.max()), (-1, 1), atol=1e-4)


def test_a_normaliser_of_train_needs_train(built, tmp_path) -> None:
    pytest.importorskip("torch")  # its absence would be in the message
    made = built("finedance")
    source = tmp_path / "source"
    shutil.copytree(made.source, source)
    for clip in made.store.clips():
        for path in source.rglob(f"{clip.id}.*"):
            if clip.split == "train":
                path.unlink()
    recipe = made.store.info["recipe"]
    dancedata.build(recipe, source, tmp_path / "store", jobs=1, cache=tmp_path / "cache", progress=False)
    with raises_message(StoreError, "normaliser", where="store"):
        dancedata.export(tmp_path / "store", "lodge", tmp_path / "out", scaler="train", progress=False)
    assert dancedata.export(tmp_path / "store", "lodge", tmp_path / "out", progress=False).path.is_dir()


def test_assets_name_the_final_folder(export) -> None:
    pytest.importorskip("torch")
    out = export("finedance", "lodge", "it's here").path
    paths = yaml.safe_load((out / "assets.yaml").read_text())["DATASET"]["FINEDANCE_139CUT"]
    assert paths["MOTION"] == f"{out}/finedance/mofea319"
    assert all((out / name).exists() for name in paths.values())


def test_clips_that_loaders_expect_but_lack_are_noted(export) -> None:
    pytest.importorskip("torch")
    notes = {to: " ".join(export("finedance", to, to).notes) for to in ("lodge", "finedance")}
    # The example has four tracks; 120 and 130 are not among them.
    assert "198 ids of them are not in the dataset" in notes["lodge"]
    assert "197 ids of them are not in the dataset" in notes["finedance"]


def test_finedances_tracks_are_whole(export, built) -> None:
    out, store = export("finedance", "finedance").path / "finedance", built("finedance").store
    for clip in store:
        motion = np.load(out / "motion_fea319" / f"{clip.id}.npy")
        np.testing.assert_array_equal(motion, clip.read("finedance319"))
        np.testing.assert_array_equal(np.load(out / "music_npy" / f"{clip.id}.npy"), clip.read("librosa35"))
        again = dancedata.encode(dancedata.decode(motion, "finedance319"), "finedance319")
        np.testing.assert_allclose(again[:, 4:], motion[:, 4:], atol=1e-5)
