"""The published MERT-v1-95M, where its folder is on this machine. Nothing is downloaded.

    DANCEDATA_TEST_MERT=/models/mert-95m pytest -m nightly -s tests/hf/test_real_mert.py

``DANCEDATA_TEST_MERT_ROWS`` names a file .npy with rows of an earlier run, which these are compared with; a file that
does not exist yet is written.
"""

import os
from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata.audio.hf.encoder import HuggingFaceEncoder
from dancedata.audio.hf.model_folder import open_model
from dancedata.synthetic import synthesise_song

from .conftest import settings

FOLDER, ROWS = "DANCEDATA_TEST_MERT", "DANCEDATA_TEST_MERT_ROWS"
#: A bound, not a measurement: the weights were not at hand. MERT's group norm divides by what a chunk is as a whole.
CHUNKED_AGAINST_WHOLE = 0.2

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(FOLDER not in os.environ, reason=f"${FOLDER} names no folder of MERT-v1-95M"),
]


@pytest.fixture(scope="module")
def folder() -> Path:
    return Path(os.environ[FOLDER])


def test_it_is_mert_95m_and_loads_natively_with_nothing_missing(folder: Path) -> None:
    import transformers

    config = {k: v for k, v in open_model(str(folder)).config.items() if k not in ("auto_map", "model_type")}
    assert (config["hidden_size"], config["num_hidden_layers"]) == (768, 12)
    assert HuggingFaceEncoder(settings(folder), device="cpu").settings.family.sample_rate == 24_000
    _, info = transformers.HubertModel.from_pretrained(
        folder, config=transformers.HubertConfig(**config), output_loading_info=True, local_files_only=True
    )
    assert not info["missing_keys"]
    assert not info["mismatched_keys"]


def test_10_s_of_the_demos_music(folder: Path) -> None:
    signal = synthesise_song("mBR2", length_s=10).signal
    rows = dancedata.features(signal, "hf", fps=30, model=str(folder), layers=[7], precision="fp32", device="cpu")
    assert (rows.shape, rows.dtype) == ((300, 768), np.float16)
    assert np.isfinite(rows).all()
    assert rows.std(axis=0, dtype=np.float32).min() > 1e-4  # no column is constant
    if ROWS not in os.environ:
        return
    kept = Path(os.environ[ROWS])
    if not kept.exists():
        np.save(kept, rows)
        print(f"rows were written to {kept}")
    wanted = np.load(kept, allow_pickle=False)
    assert (wanted.shape, wanted.dtype) == (rows.shape, rows.dtype)
    # Both are rounded to float16, whose step is 1/1024 of a value.
    np.testing.assert_allclose(rows.astype(np.float32), wanted.astype(np.float32), rtol=2e-3, atol=2e-3)


def test_chunked_as_whole(folder: Path) -> None:
    samples = np.asarray(synthesise_song("mBR2", length_s=24, sample_rate=24_000).signal.samples)
    whole, cut = (
        HuggingFaceEncoder(settings(folder, layers=7, chunk_s=seconds), device="cpu").frames(samples, 24_000)
        for seconds in (30, 15)
    )
    np.testing.assert_allclose(cut.stamps_s, whole.stamps_s, atol=1e-9)
    error = np.linalg.norm(cut.values - whole.values, axis=1) / np.linalg.norm(whole.values, axis=1)
    print(f"chunks of 15 s against 24 s at once: median {np.median(error):.2g}, largest {error.max():.2g}")
    assert np.median(error) < CHUNKED_AGAINST_WHOLE
