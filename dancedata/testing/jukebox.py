"""Random Jukebox checkpoints in the layout of OpenAI's real files, for tests and benchmarks."""

from __future__ import annotations

import io
import math
import zlib
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from dancedata.audio.jukebox.config import JukeboxConfig
from dancedata.audio.jukebox.network import tensors
from dancedata.audio.jukebox.weights.folder import PRIOR_FILE, SIZES_FILE, VQVAE_FILE
from dancedata.files.atomic import write_json

if TYPE_CHECKING:
    import torch

# As small as the layout allows: two blocks of each of the three kinds; context and label tables of the real size.
TINY = JukeboxConfig(
    conv_width=8, code_width=16, codebook_size=64, width=40, depth=6, heads=2, attn_width=10, mlp_width=40
)


class RandomSource:
    """Random tensors by name, made when they are read: those of a layer, each of the seed and its own name."""

    path = Path("random weights")

    def __init__(self, config: JukeboxConfig, layer: int, *, seed: int = 0) -> None:
        import torch

        self.seed = seed
        specs = (*tensors.vqvae_tensors(config), *tensors.prior_tensors(config, layer))
        self._specs = {spec.name: spec for spec in specs}
        self.tensors: Mapping[str, torch.Tensor] = {
            spec.name: torch.empty(spec.shape, dtype=getattr(torch, spec.dtype), device="meta") for spec in specs
        }

    def read(self, name: str, rows: int) -> torch.Tensor:
        """Generate the leading rows of a tensor."""
        import torch

        spec = self._specs[name]
        generator = torch.Generator().manual_seed(self.seed + zlib.crc32(name.encode()))
        tensor = torch.randn((rows, *spec.shape[1:]), generator=generator)
        return (
            tensor.mul_(_scale(spec))
            .add_(1 if ".ln_" in name and name.endswith("weight") else 0)
            .to(self.tensors[name].dtype)
        )


def _scale(spec: tensors.TensorSpec) -> float:
    """Return a standard deviation with which activations neither vanish nor explode."""
    if spec.name == tensors.CODEBOOK:
        return 1.0
    if spec.name.endswith((".b", ".bias")) or ".ln_" in spec.name:
        return 0.1
    if spec.name.endswith(".w"):
        return float(spec.shape[0] ** -0.5)
    if len(spec.shape) == 3:
        # Convolutions; those with kernel 1 end a residual unit, and 28 of these are added.
        gain = 0.3 if spec.shape[2] == 1 else 1.4
        return float(gain * math.prod(spec.shape[1:]) ** -0.5)
    return 0.5


def random_checkpoint(
    folder: Path, config: JukeboxConfig = TINY, *, seed: int = 0
) -> dict[str, dict[str, torch.Tensor]]:
    """Write OpenAI's files with random weights, in torch's legacy format, and sizes.json; return the tensors."""
    import torch

    folder.mkdir(parents=True, exist_ok=True)
    source = RandomSource(config, config.depth, seed=seed)

    def read(specs: tuple[tensors.TensorSpec, ...]) -> dict[str, torch.Tensor]:
        return {spec.name: source.read(spec.name, spec.shape[0]) for spec in specs}

    models = {
        VQVAE_FILE: {
            "encoders.0.level_blocks.0.model.0.0.weight": torch.zeros(8, 1, 4),
            **read(tensors.vqvae_tensors(config)),
            "decoders.0.out.weight": torch.zeros(1, 16, 3),
        },
        PRIOR_FILE: {
            **read(tensors.prior_tensors(config, config.depth)),
            tensors.OUTPUT: torch.zeros(config.codebook_size, config.width),
        },
    }
    for file, model in models.items():
        write_torch_file(folder / file, model)
    write_json(folder / SIZES_FILE, config.to_json())
    return models


def write_torch_file(path: Path, model: Mapping[str, torch.Tensor], *, legacy: bool = True) -> None:
    """Write a checkpoint file with these tensors, in torch's legacy format (or the current zip format)."""
    import torch

    content = {"hps": {"level": 2, "name": "tiny"}, "model": OrderedDict(model), "opt": None, "step": 1}
    if not legacy:
        torch.save(content, path)
        return
    buffer = io.BytesIO()
    torch.save(content, buffer, _use_new_zipfile_serialization=False)
    # The pickle has the device once, as a string with its length; nothing else depends on the pickle's length.
    path.write_bytes(buffer.getvalue().replace(b"X\x03\x00\x00\x00cpu", b"X\x06\x00\x00\x00cuda:0", 1))
