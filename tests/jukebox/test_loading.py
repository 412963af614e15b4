"""Checkpoint files and folders: what is read, and what is said of those that are damaged or of another network."""

import os
import pickle
import re
import struct
import sys
from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from tests.messages import raises_message

pytest.importorskip("torch")
pytest.importorskip("accelerate")

import subprocess

import torch

from dancedata.audio.jukebox import JukeboxEncoder, checkpoint_sha256
from dancedata.audio.jukebox.network.tensors import BLOCKS
from dancedata.audio.jukebox.weights.folder import PRIOR_FILE, VQVAE_FILE
from dancedata.audio.jukebox.weights.sources import TorchFile
from dancedata.core.errors import SourceError, UsageError
from dancedata.files.regular_file import sha256_file
from dancedata.testing.jukebox import write_torch_file

QKV = f"{BLOCKS}.3.attn.c_attn.w"
SHARED = torch.arange(24.0)


@pytest.fixture
def broken(tiny: SimpleNamespace, tmp_path: Path) -> Callable[..., Path]:
    """A copy of the tiny checkpoint with changed tensors (None: left out)."""

    def make(file: str, changes: dict[str, torch.Tensor | None], **how: bool) -> Path:
        for name in (VQVAE_FILE, PRIOR_FILE):
            tensors = dict(tiny.tensors[name])
            if name == file:
                tensors.update(changes)
            write_torch_file(tmp_path / name, {k: v for k, v in tensors.items() if v is not None}, **how)
        return tmp_path

    return make


def _load(folder: Path, tiny: SimpleNamespace, layers: tuple[int, ...] = (6,)) -> JukeboxEncoder:
    (folder / "sizes.json").write_bytes((tiny.folder / "sizes.json").read_bytes())
    return JukeboxEncoder(folder, layers=layers, device="cpu")


@pytest.mark.parametrize("file", [VQVAE_FILE, PRIOR_FILE])
def test_every_tensor_bit_for_bit(tiny: SimpleNamespace, file: str) -> None:
    source = TorchFile(tiny.folder / file)
    assert set(source.tensors) == set(tiny.tensors[file])
    for name, tensor in tiny.tensors[file].items():
        assert source.tensors[name].shape == tensor.shape
        assert source.tensors[name].dtype == tensor.dtype
        assert torch.equal(source.read(name, len(tensor)), tensor)
        assert torch.equal(source.read(name, 1), tensor[:1])


def test_weights_stored_in_fp32_are_not_rounded(tiny, broken):
    exact = tiny.tensors[PRIOR_FILE][QKV].float() + 1e-6
    encoder = _load(broken(PRIOR_FILE, {QKV: exact}), tiny)
    assert torch.equal(encoder._prior.stream.blocks[3].attn_c_attn_w, exact)


def test_zip_format_gives_the_same(tiny: SimpleNamespace, tiny_encoder: JukeboxEncoder, broken) -> None:
    folder = broken("none", {}, legacy=False)
    assert (folder / PRIOR_FILE).read_bytes().startswith(b"PK")
    codes = np.arange(64)
    np.testing.assert_array_equal(_load(folder, tiny).activations(codes)[6], tiny_encoder.activations(codes)[6])


def test_prefix_of_distributed_training(tiny: SimpleNamespace, tmp_path: Path) -> None:
    for file in (VQVAE_FILE, PRIOR_FILE):
        write_torch_file(tmp_path / file, {f"module.{k}": v for k, v in tiny.tensors[file].items()})
    _load(tmp_path, tiny)


@pytest.mark.parametrize(
    "tensors",
    [
        {"a": SHARED[:12].view(3, 4), "b": SHARED[12:].view(2, 6)},
        {"t": SHARED[:12].view(3, 4).T, "s": SHARED[1:20:3].view(7, 1), "e": torch.zeros(0, 3)},
    ],
    ids=["shared", "not contiguous"],
)
def test_views_of_storages(tmp_path: Path, tensors: dict[str, torch.Tensor]) -> None:
    write_torch_file(tmp_path / "x", tensors)
    source = TorchFile(tmp_path / "x")
    for name, tensor in tensors.items():
        for rows in {len(tensor), len(tensor) // 2}:
            assert torch.equal(source.read(name, rows), tensor[:rows])


class Hyperparams(dict):
    """As OpenAI's, with attributes."""

    __module__ = "jukebox.hparams"


def test_other_content_of_the_checkpoint_is_ignored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hparams = Hyperparams(width=40)
    hparams.name = "prior"
    module = ModuleType("jukebox.hparams")
    module.Hyperparams = Hyperparams
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "jukebox", ModuleType("jukebox"))
        patch.setitem(sys.modules, "jukebox.hparams", module)
        content = {"hps": hparams, "model": {"a": torch.ones(2)}, "loss": np.float64(0.5), "opt": None}
        torch.save(content, tmp_path / "x", _use_new_zipfile_serialization=False)
    source = TorchFile(tmp_path / "x")
    assert list(source.tensors) == ["a"]
    assert torch.equal(source.read("a", 2), torch.ones(2))


def test_missing_file(tiny: SimpleNamespace, tmp_path: Path) -> None:
    (tmp_path / VQVAE_FILE).write_bytes((tiny.folder / VQVAE_FILE).read_bytes())
    with raises_message(SourceError, "OpenAI", where="prior_level_2.pth.tar"):
        _load(tmp_path, tiny)
    with raises_message(SourceError, "OpenAI", where="nowhere/vqvae.pth.tar"):
        JukeboxEncoder(tmp_path / "nowhere", device="cpu")


def test_unneeded_tensors_may_be_missing(tiny: SimpleNamespace, broken: Callable[..., Path]) -> None:
    folder = broken(PRIOR_FILE, {f"{BLOCKS}.5.ln_0.bias": None, "prior.x_out.weight": None})
    _load(folder, tiny, (5,))
    with raises_message(SourceError, "tensors", where="prior_level_2.pth.tar"):
        _load(folder, tiny, (6,))


@pytest.mark.parametrize(
    ("file", "name", "tensor", "word"),
    [
        (PRIOR_FILE, QKV, None, "is missing"),
        (VQVAE_FILE, "bottleneck.level_blocks.2.k", None, "is missing"),
        (PRIOR_FILE, QKV, torch.zeros(30, 40), r"has shape \(30, 40\), not \(40, 30\)"),
        (PRIOR_FILE, "prior.pos_emb.pos_emb", torch.zeros(8000, 40), r"has shape .*, not \(8192, 40\)"),
        (PRIOR_FILE, QKV, torch.zeros(40, 30, dtype=torch.int8), r"is torch\.int8"),
        # Of another network.
        (PRIOR_FILE, f"{BLOCKS}.0.attn.c_enc_kv.w", torch.zeros(2, 2), "belongs"),
        (PRIOR_FILE, "x_cond.x_emb.weight", torch.zeros(2, 2), "belongs"),
        (VQVAE_FILE, "encoders.2.level_blocks.3.model.0.0.weight", torch.zeros(2, 2), "belongs"),
    ],
)
def test_tensors_that_do_not_fit(tiny, broken, file, name, tensor, word):
    with raises_message(SourceError, f"{re.escape(name)} {word}" if word != "belongs" else word):
        _load(broken(file, {name: tensor}), tiny)


def test_other_sizes_than_the_files(broken: Callable[..., Path]) -> None:
    with raises_message(SourceError, "tensors", where="vqvae.pth.tar"):
        JukeboxEncoder(broken("none", {}), device="cpu")


@pytest.mark.parametrize(
    "damaged",
    [lambda data: data[: int(0.999 * len(data))], lambda data: data[:300], lambda data: b"",
     lambda data: b"\x80\x02}q\x00.", lambda data: b"PK\x03\x04nonsense"],
)  # fmt: skip
def test_files_that_are_damaged(tiny, broken, damaged):
    path = broken("none", {}) / PRIOR_FILE
    path.write_bytes(damaged(path.read_bytes()))
    with raises_message(SourceError, "complete file", where=PRIOR_FILE):
        _load(path.parent, tiny)


def test_damaged_element_count(tiny: SimpleNamespace, broken: Callable[..., Path]) -> None:
    folder = broken("none", {})
    data = (folder / PRIOR_FILE).read_bytes()
    weight = tiny.tensors[PRIOR_FILE][QKV]
    at = data.index(weight.numpy().tobytes())
    assert struct.unpack("<q", data[at - 8 : at]) == (weight.numel(),)
    (folder / PRIOR_FILE).write_bytes(data[: at - 8] + struct.pack("<q", 7) + data[at:])
    with raises_message(SourceError, "7 elements", where="prior_level_2.pth.tar"):
        _load(folder, tiny)


def test_checkpoint_without_a_model(tiny: SimpleNamespace, broken: Callable[..., Path]) -> None:
    folder = broken("none", {})
    torch.save({"weights": {}}, folder / PRIOR_FILE, _use_new_zipfile_serialization=False)
    with raises_message(SourceError, "dictionary", where="prior_level_2.pth.tar"):
        _load(folder, tiny)


class _Runs:
    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize(
    "pickled",
    [
        lambda runs: pickle.dumps({"model": {}, "hps": runs}, 2),
        lambda runs: pickle.dumps(OrderedDict(model={"a": runs}), 2),
        lambda runs: b"\x80\x02ctorch\nFloatStorage\n}X\x01\x00\x00\x00aK\x01sb.",  # sets the state of a class
    ],
)
def test_foreign_code_is_not_run(tiny, broken, tmp_path, pickled):
    folder = broken("none", {})
    head = [pickle.dumps(part, 2) for part in (0x1950A86A20F9469CFC6C, 1001, {"little_endian": True})]
    content = b"".join([*head, pickled(_Runs(tmp_path / "made")), pickle.dumps([], 2)])
    (folder / VQVAE_FILE).write_bytes(content)
    with raises_message(SourceError, "weights", where="vqvae.pth.tar"):
        _load(folder, tiny)
    assert not (tmp_path / "made").exists()
    assert not hasattr(torch.FloatStorage, "a")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"layers": ()}, "one or more of 1 to 6"), ({"layers": (7, 1)}, "1 to 6"), ({"layers": (2, 2)}, "each once"),
     ({"device": "tpu9"}, "unknown device"), ({"precision": "int8"}, "unknown precision"),
     ({"max_codes": 8193}, "1 to 8192"), ({"max_codes": 0}, "1 to 8192"),
     ({"memory_budget": 1000}, "too little device memory")],
)  # fmt: skip
def test_bad_arguments(tiny: SimpleNamespace, arguments: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        JukeboxEncoder(tiny.folder, **{"layers": (1,), "device": "cpu", **arguments})


# ---- a folder of weights: its hashes and sizes, read without torch


def test_the_facts_of_a_folder_need_no_torch(tiny: SimpleNamespace) -> None:
    code = (
        "import sys; from pathlib import Path; from dancedata.audio.jukebox.weights import folder; "
        "path = Path(sys.argv[1]); print(folder.config_of(path).depth, len(folder.checkpoint_sha256(path))); "
        "assert not {'torch', 'accelerate', 'safetensors'} & set(sys.modules)"
    )
    command = [sys.executable, "-c", code, str(tiny.folder)]
    assert subprocess.run(command, check=True, capture_output=True, text=True).stdout == "6 2\n"
    assert checkpoint_sha256(tiny.folder) == {f: sha256_file(tiny.folder / f) for f in (VQVAE_FILE, PRIOR_FILE)}


def test_files_that_are_not_openais_are_not_read(tiny: SimpleNamespace, tmp_path: Path) -> None:
    for name in (VQVAE_FILE, PRIOR_FILE):
        (tmp_path / name).write_bytes(b"a pickle that takes forever")
    with raises_message(SourceError, "OpenAI.*sizes", where=tmp_path.name):
        checkpoint_sha256(tmp_path)
    (tmp_path / "sizes.json").write_bytes((tiny.folder / "sizes.json").read_bytes())
    assert set(checkpoint_sha256(tmp_path)) == {VQVAE_FILE, PRIOR_FILE}
