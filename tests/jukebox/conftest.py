"""Fixtures of the Jukebox tests: the reference's outputs, and a tiny random checkpoint that needs no reference."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dancedata.audio.jukebox.config import JukeboxConfig

#: Sizes of the reference's tiny checkpoint.
GOLDEN_CONFIG = JukeboxConfig(
    conv_width=8, code_width=16, codebook_size=512, width=40, depth=6, heads=2, attn_width=10, mlp_width=40
)


@pytest.fixture(scope="session")
def golden(jukebox_golden: Path) -> SimpleNamespace:
    """The reference's tiny checkpoint, its config, its clips and outputs."""
    return _reference(jukebox_golden)


@pytest.fixture(scope="session")
def whole_golden(shared: Path, tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """The same with a checkpoint for the whole context, and a clip that is longer."""
    folder = tmp_path_factory.mktemp("whole")
    for path in (shared / "golden" / "jukebox").iterdir():
        (folder / path.name).symlink_to(path)
    return _reference(folder)


def _reference(folder: Path) -> SimpleNamespace:
    import soundfile

    (folder / "sizes.json").write_text(json.dumps(GOLDEN_CONFIG.to_json()))
    manifest = json.loads((folder / "manifest.json").read_text())
    names = [name for name in manifest if not name.startswith("_")]

    def audio(name: str) -> tuple[np.ndarray, int]:
        samples, rate = soundfile.read(folder / manifest[name]["wav"], dtype="float32", always_2d=True)
        return (samples[:, 0] if samples.shape[1] == 1 else samples.T), rate

    return SimpleNamespace(
        folder=folder,
        manifest=manifest,
        clips=names,
        audio=audio,
        expected={name: dict(np.load(folder / f"expect_{name}.npz")) for name in names},
        conditioning=dict(np.load(folder / "expect_cond.npz")),
        config=GOLDEN_CONFIG,
    )


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """A tiny random checkpoint in OpenAI's layout, its config and its tensors by file and name."""
    from dancedata.testing.jukebox import TINY, random_checkpoint

    folder = tmp_path_factory.mktemp("jukebox")
    return SimpleNamespace(folder=folder, config=TINY, tensors=random_checkpoint(folder))


@pytest.fixture(scope="session")
def tiny_encoder(tiny: SimpleNamespace) -> Any:
    """An fp32 encoder of the tiny checkpoint, layers 2 and 6, on the CPU."""
    from dancedata.audio.jukebox import JukeboxEncoder

    return JukeboxEncoder(tiny.folder, layers=(2, 6), device="cpu")


@pytest.fixture(scope="session")
def noise() -> np.ndarray:
    """One second of noise, (44100,) float32."""
    return (0.1 * np.random.default_rng(0).standard_normal(44100)).astype(np.float32)
