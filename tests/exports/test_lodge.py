"""Lodge's and FineDance's folders: tracks, labels, the normaliser, names."""

import json
import shutil
import sys
from collections.abc import Callable

import numpy as np
import pytest
import yaml

import dancedata
from dancedata.core.errors import StoreError
from dancedata.exports.base.run import ExportResult
from tests.messages import raises_message


def test_tracks_begin_at_the_trim_and_decode_again(export: Callable[..., ExportResult], built) -> None:
    pytest.importorskip("torch")
    out, store = export("finedance", "lodge").path / "finedance", built("finedance").store
    assert any(clip.trim_start for clip in store)
    assert sorted(p.stem for p in (out / "label_json").iterdir()) == sorted(clip.id for clip in store)
    for clip in store:
        motion, music = (np.load(out / folder / f"{clip.id}.npy") for folder in ("mofea319", "music_npynew"))
        np.testing.assert_array_equal(motion, clip.read("lodge139")[clip.trim_start :])
        np.testing.assert_array_equal(music, clip.read("librosa35")[clip.trim_start :])
        assert json.loads((out / "label_json" / f"{clip.id}.json").read_text()) == {"style2": clip.genre}
        # Back again, trimmed and grounded: already on the ground, so encoding moves nothing.
        again = dancedata.encode(dancedata.decode(motion, "lodge139"), "lodge139")
        np.testing.assert_allclose(again, motion, atol=1e-5)


def test_other_columns_of_lodge(export, built) -> None:
    pytest.importorskip("torch")
    out, store = export("finedance", "lodge", motion="lodge319").path, built("finedance").store
    clip = store.clips()[0]
    rows = np.load(out / "finedance" / "mofea319" / f"{clip.id}.npy")
    np.testing.assert_array_equal(rows, clip.read("lodge319")[clip.trim_start :])


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
