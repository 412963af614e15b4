"""A dataset with two encoders, Jukebox and librosa: what is recomputed, and what dataset.json says."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.audio.hf import HuggingFace
from dancedata.building.build import build
from dancedata.building.plan import make_plan
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import FEATURES
from dancedata.files.regular_file import sha256_file
from dancedata.recipes.parse import load_recipe
from dancedata.songs import find_jobs, write_features
from dancedata.store import verify_store
from dancedata.testing.jukebox import random_checkpoint


def _recipe(mert: Path, dac: Path, jukebox: Path, **mert_keys: Any) -> Any:
    audio = {
        "hf.mert": {"model": str(mert), "layers": [2], "device": "cpu", "precision": "fp32", **mert_keys},
        "hf.dac": {"model": str(dac), "device": "cpu", "store": "float32"},
        "jukebox": {"weights": str(jukebox), "layer": 6, "device": "cpu"},
        "librosa35": {},
    }
    return load_recipe("aist++", {"audio": audio, "motion": {"edge151": {}}})


def _watched(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the features that compute a song, from now on; of encoders that of the instance."""
    computed: list[str] = []

    def watch(feature: Any) -> None:
        plain = feature.extract

        def extract(self: Any, *args: Any, **kwargs: Any) -> Any:
            instance = {"DacModel": "hf.dac", "MERTModel": "hf.mert"}
            config = Path(self.model) / "config.json" if isinstance(self, HuggingFace) else None
            name = self.name if config is None else instance[json.loads(config.read_text())["architectures"][0]]
            computed.append(name)
            return plain(self, *args, **kwargs)

        monkeypatch.setattr(feature, "extract", extract)

    for name in ("hf", "jukebox", "librosa35"):
        watch(FEATURES.get(name))
    return computed


def _flip_a_byte_of(path: Path, tensor: str) -> None:
    data = bytearray(path.read_bytes())
    begin = 8 + int.from_bytes(data[:8], "little")
    header = json.loads(data[8:begin])
    data[begin + header[tensor]["data_offsets"][0] + 2] ^= 0x40  # the first number changes by up to a third
    path.write_bytes(data)


def test_two_encoders_jukebox_and_librosa_in_one_dataset(corpus, model, tmp_path, monkeypatch):
    computed = _watched(monkeypatch)
    random_checkpoint(tmp_path / "jukebox")
    mert, dac = tmp_path / "MERT-v1-tiny", tmp_path / "dac"
    shutil.copytree(model("mert"), mert)
    shutil.copytree(model("dac"), dac)
    cache = tmp_path / "cache"
    build(_recipe(mert, dac, tmp_path / "jukebox"), corpus, tmp_path / "one", cache=cache, jobs=1)
    assert [p for p in verify_store(tmp_path / "one") if p.severity == "error"] == []
    store = dancedata.open(tmp_path / "one")
    assert {"hf.mert", "hf.dac", "jukebox", "librosa35"} <= set(store.fields)
    assert (store.field("hf.mert").dtype, store.field("hf.dac").dtype) == ("float16", "float32")
    about = store.info["encoders"]["hf.mert"]
    assert (about["model"], about["licence"], about["frames_per_s"]) == ("MERT-v1-tiny", "cc0-1.0", "75")
    assert about["first_frame_s"] == "133/16000"
    assert about["sha256"] == store.info["recipe"]["audio"]["hf.mert"]["model_sha256"]
    assert str(tmp_path) not in (tmp_path / "one" / "dataset.json").read_text()
    assert "licence of its weights: cc0-1.0" in (tmp_path / "one" / "README.md").read_text()

    # Another name of the folder, another batch and device: nothing is computed. One byte: that feature alone.
    assert sorted(computed) == ["hf.dac", "hf.dac", "hf.mert", "hf.mert", *["jukebox"] * 2, *["librosa35"] * 2]
    computed.clear()
    mert.rename(tmp_path / "renamed")
    mert = tmp_path / "renamed"
    again = _recipe(mert, dac, tmp_path / "jukebox", batch_size=3, device="auto")
    build(again, corpus, tmp_path / "two", cache=cache, jobs=1)
    assert computed == []
    _flip_a_byte_of(dac / "model.safetensors", "encoder.conv1.weight")
    build(again, corpus, tmp_path / "three", cache=cache, jobs=1)
    assert computed == ["hf.dac"] * 2  # two songs
    one, two, three = (dancedata.open(tmp_path / name) for name in ("one", "two", "three"))
    window = one.windows("train")[0]
    for name in ("hf.mert", "hf.dac", "jukebox", "librosa35"):
        np.testing.assert_array_equal(one.read(window, name), two.read(window, name))
        assert np.array_equal(one.read(window, name), three.read(window, name)) == (name != "hf.dac"), name

    # One's own song, as in the dataset.
    song = next((corpus / "wavs").glob("*.wav"))
    jobs = find_jobs("hf.dac", str(tmp_path / "three"))
    written = write_features([song], tmp_path / "features", jobs, None, weights=dac)
    rows = np.load(tmp_path / "features" / written[0]["file"])
    own = HuggingFace(model=str(dac), device="cpu", store="float32").resolved(sha256_file)
    from dancedata.music.signal import load_audio

    np.testing.assert_array_equal(rows, own.extract(load_audio(song), FrameGrid.of(30)))


def test_a_plan_needs_the_config_alone(corpus: Path, model: Callable[[str], Path], tmp_path: Path) -> None:
    folder = tmp_path / "no weights"
    folder.mkdir()
    for name in ("config.json", "preprocessor_config.json"):
        shutil.copyfile(model("mert") / name, folder / name)
    recipe = load_recipe(
        "aist++", {"audio": {"hf": {"model": str(folder), "device": "cpu"}}, "motion": {"edge151": {}}}
    )
    plan = make_plan(recipe, corpus, cache=tmp_path / "cache")
    assert plan.to_json()["fields"]["hf"] == {"columns": 24, "dtype": "float16"}
    assert any("no weights" in note for note in plan.to_json()["notes"])


def test_listing_and_columns_import_neither_torch_nor_transformers(model: Callable[[str], Path]) -> None:
    import subprocess
    import sys

    code = (
        "import sys; from dancedata.audio.hf import HuggingFace; from dancedata.core.grid import FrameGrid\n"
        f"made = HuggingFace(model={str(model('mert'))!r}); made.columns, made.about\n"
        "made.n_rows(48_000, 48_000, FrameGrid.of(30))\n"
        "print([name for name in ('torch', 'transformers', 'librosa', 'scipy') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
