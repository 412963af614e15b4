"""Tiny random models in the real layout of every family, written once; no test reaches a network."""

import copy
import socket
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("transformers")

from dancedata.audio.hf import HuggingFace
from dancedata.audio.hf import encoder as hf_encoder
from dancedata.audio.hf.encoder import HuggingFaceEncoder
from dancedata.audio.hf.model_folder import ENVIRONMENT, open_model
from dancedata.audio.hf.settings import Settings, settings_of
from dancedata.core.audio_signal import AudioSignal
from dancedata.files.regular_file import sha256_file
from dancedata.testing.encoders import KINDS, write_random_model
from tests.conftest import Once

#: Kinds of models without those that cut and frame a signal as wav2vec2 does.
ONE_OF_EACH = sorted(
    {*KINDS} - {"wav2vec2-large", "wav2vec2-conformer", "hubert", "hubert-large", "wavlm", "data2vec-audio"}
)


@pytest.fixture(autouse=True)
def _no_network(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> NoReturn:
        raise AssertionError("a test opened a network connection")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    monkeypatch.delenv(ENVIRONMENT, raising=False)


@lru_cache(maxsize=64)
def _loaded(files: tuple[Any, ...], spec: str, output: str, dtype: Any) -> list[Any]:
    """A place for one network of these files."""
    return []


@pytest.fixture(autouse=True)
def _loaded_once(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Copy networks that were loaded before: loading takes longer than all that these tests compute."""
    if request.path.name == "test_loading.py":
        return
    load = hf_encoder.load_network

    def copied(folder: Any, family: Any, top: int, output: Any, dtype: Any) -> Any:
        states = ((path, path.stat()) for path in (*folder.weight_files(), folder.path / "config.json"))
        files = tuple((str(path), state.st_ino, state.st_size, state.st_mtime_ns) for path, state in states)
        place = _loaded(files, repr(family.network(top)), output, dtype)
        if not place:
            place.append(load(folder, family, top, output, dtype))
        return copy.deepcopy(place[0])

    monkeypatch.setattr(hf_encoder, "load_network", copied)


@pytest.fixture(scope="session")
def model(once: Once) -> Callable[[str], Path]:
    """Folder of the tiny random model of a kind. Not to be written into."""

    def folder(kind: str) -> Path:
        if kind == "pe-audio":
            transformers = pytest.importorskip("transformers", minversion="5.0")
            assert hasattr(transformers, "PeAudioEncoder")
        return once(f"hf-{kind}", lambda root: write_random_model(kind, root / kind)) / kind

    return folder


@pytest.fixture(scope="session")
def feature(model: Callable[[str], Path]) -> Callable[..., HuggingFace]:
    """The feature on a tiny model, resolved."""

    def made(kind: str, **keys: Any) -> HuggingFace:
        return HuggingFace(model=str(model(kind)), device="cpu", **keys).resolved(sha256_file)

    return made


def settings(folder: Path, **keys: Any) -> Settings:
    """Settings with the defaults of a recipe."""
    given: dict[str, Any] = {
        "output": "auto", "layers": "last", "reduce": "concat", "chunk_s": None, "overlap_s": None,
        "resample": "auto", "normalize": "extractor", **keys,
    }  # fmt: skip
    return settings_of(open_model(str(folder)), **given)


@pytest.fixture(scope="session")
def encoder(model: Callable[[str], Path]) -> Callable[..., HuggingFaceEncoder]:
    """The encoder of a tiny model, on the CPU: one for equal keys, unless a test is to change it (`fresh`)."""
    kept: dict[str, HuggingFaceEncoder] = {}

    def made(kind: str, *, fresh: bool = False, **keys: Any) -> HuggingFaceEncoder:
        key = f"{kind} {sorted(keys.items())}"
        if fresh or key not in kept:
            network = HuggingFaceEncoder(settings(model(kind), **keys), device="cpu")
            if fresh:
                return network
            kept[key] = network
        return kept[key]

    return made


def noise(seconds: float, rate: int, seed: int = 0) -> np.ndarray:
    """(n,) float32 of coloured noise."""
    white = np.random.default_rng(seed).standard_normal(round(seconds * rate))
    return (0.1 * (white + np.convolve(white, np.ones(16) / 4, "same"))).astype(np.float32)


def song(seconds: float, rate: int = 22_050, seed: int = 0) -> AudioSignal:
    """A signal of coloured noise."""
    return AudioSignal(noise(seconds, rate, seed), rate)
