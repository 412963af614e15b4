"""Loading a network from files: each tensor is read by itself, directly into its type and onto its device."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from accelerate import init_empty_weights
from accelerate.utils import set_module_tensor_to_device
from torch.nn.functional import conv1d, relu

from dancedata.audio.jukebox.config import JukeboxConfig
from dancedata.audio.jukebox.network import tensors
from dancedata.audio.jukebox.network.memory import Placement, padded_length
from dancedata.audio.jukebox.network.tensors import CODEBOOK, ENCODER, start_vector, time_conditioning
from dancedata.audio.jukebox.network.transformer import Block, BlockStream, Prior, parameter_name, prepared
from dancedata.audio.jukebox.weights.folder import PRIOR_FILE, VQVAE_FILE, refuse_hugging_face
from dancedata.audio.jukebox.weights.sources import TensorSource, open_torch_file, require_tensors
from dancedata.audio.networks.devices import exact_float32
from dancedata.core.errors import SourceError
from dancedata.core.text import listed

# Codes at once whose distances to all code vectors are computed: 17 MB at 2048 code vectors.
_CHUNK = 1024


class VqEncoder:
    """Encoder and codebook; `weights` are those of `vqvae_tensors` by name, on the device, in fp32."""

    def __init__(self, config: JukeboxConfig, weights: Mapping[str, torch.Tensor]) -> None:
        self.config = config
        self._weights = weights
        self._codebook = weights[CODEBOOK].double()
        self._squares = self._codebook.square().sum(1)

    def __call__(self, audio: torch.Tensor) -> torch.Tensor:
        """Encode clips of one length, (B, n) float32 at the config's sample rate, as (B, n // hop) int64."""
        x = audio[:, None]
        with exact_float32():
            for level, steps in enumerate(self.config.downs):
                prefix = f"{ENCODER}.{level}.model"
                for step in range(steps):
                    x = self._conv(x, f"{prefix}.{step}.0", stride=2, padding=1)
                    for unit in range(self.config.conv_depth):
                        self._add_residual(x, f"{prefix}.{step}.1.model.{unit}.model", unit)
                x = self._conv(x, f"{prefix}.{steps}", padding=1)
        return torch.stack([self._nearest(clip.T) for clip in x])

    def _add_residual(self, x: torch.Tensor, prefix: str, unit: int) -> None:
        """Add conv1(relu(conv3(relu(x)))) to x, in place."""
        dilation = self.config.dilation_growth**unit
        y = self._conv(relu(x), f"{prefix}.1", padding=dilation, dilation=dilation)
        x += self._conv(y.relu_(), f"{prefix}.3")

    def _conv(
        self, x: torch.Tensor, name: str, *, stride: int = 1, padding: int = 0, dilation: int = 1
    ) -> torch.Tensor:
        weight, bias = self._weights[f"{name}.weight"], self._weights[f"{name}.bias"]
        return conv1d(x, weight, bias, stride=stride, padding=padding, dilation=dilation)

    def _nearest(self, vectors: torch.Tensor) -> torch.Tensor:
        """Return the nearest code vectors (T,) of (T, D) in Euclidean distance; of equal ones the first.

        In fp64: near-ties are decided the same way on all devices, with any other clips in the batch.
        """
        chunks = torch.split(vectors.double(), _CHUNK)
        return torch.cat([(self._squares - 2 * chunk @ self._codebook.T).argmin(1) for chunk in chunks])


@dataclass(frozen=True)
class Checkpoint:
    """Sources of the two networks."""

    vqvae: TensorSource
    prior: TensorSource


def open_openai(folder: Path, config: JukeboxConfig) -> Checkpoint:
    """Open OpenAI's vqvae.pth.tar and prior_level_2.pth.tar, and check that they belong to this network."""
    refuse_hugging_face(folder)
    checkpoint = Checkpoint(open_torch_file(folder / VQVAE_FILE), open_torch_file(folder / PRIOR_FILE))
    expected = {spec.name for spec in tensors.vqvae_tensors(config)}
    prefixes = (tensors.ENCODER.split(".level")[0] + ".", tensors.CODEBOOK)
    names = [name for name in checkpoint.vqvae.tensors if name.startswith(prefixes)]
    _refuse_unknown(checkpoint.vqvae, names, expected)
    _refuse_unknown(checkpoint.prior, checkpoint.prior.tensors, tensors.all_prior_names(config))
    return checkpoint


def load_encoder(checkpoint: Checkpoint, config: JukeboxConfig, device: torch.device) -> VqEncoder:
    """Load the level-2 encoder and its codebook, as fp32."""
    specs = tensors.vqvae_tensors(config)
    source = checkpoint.vqvae
    require_tensors(source, specs)
    return VqEncoder(config, {s.name: source.read(s.name, s.rows).to(device, torch.float32) for s in specs})


def load_prior(
    checkpoint: Checkpoint,
    config: JukeboxConfig,
    placement: Placement,
    *,
    max_codes: int,
    precision: torch.dtype,
    device: torch.device,
) -> Prior:
    """Load the blocks of `placement`, and tables for up to `max_codes` codes."""
    source, n_blocks, length = checkpoint.prior, len(placement.resident), padded_length(config, max_codes)
    require_tensors(source, tensors.prior_tensors(config, n_blocks, length))
    start, positions = load_conditioning(source, config, length)
    code_table = source.read(tensors.CODES, config.codebook_size).float()
    blocks = []
    for index, is_resident in enumerate(placement.resident):
        block = empty_block(config, index, precision)
        pinned = device.type == "cuda" and not is_resident
        _fill_block(block, source, device if is_resident else torch.device("cpu"), pinned=pinned)
        blocks.append(block)
    stream = BlockStream(blocks, placement.resident, device)
    return Prior(config, start.to(device), code_table.to(device), positions.to(device), stream)


def load_conditioning(source: TensorSource, config: JukeboxConfig, n_codes: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Load y_cond (W,), and the position embedding plus x_cond (n_codes, W), both float32."""
    rows = {spec.name: spec.rows for spec in tensors.table_tensors(config, n_codes)}

    def read(name: str) -> torch.Tensor:
        return source.read(name, rows[name]).float()

    x_cond = time_conditioning(
        config, read(tensors.SONG_LENGTH), read(tensors.SONG_POSITION), read(tensors.RELATIVE_POSITION), n_codes
    )
    return start_vector(read(tensors.GENRES), read(tensors.ARTISTS)), x_cond.add_(read(tensors.POSITIONS))


def empty_block(config: JukeboxConfig, index: int, precision: torch.dtype) -> Block:
    """Create a block without memory (meta device)."""
    with init_empty_weights():
        return Block(config, index, precision)


def _fill_block(block: Block, source: TensorSource, device: torch.device, *, pinned: bool) -> None:
    """Load the weights of a block, one tensor at a time."""
    for spec in block.specs:
        stored = source.read(spec.name, spec.rows)
        value = prepared(spec.name, stored)
        dtype = block.kept_dtype(spec.name, stored.dtype)
        if pinned:
            value = value.to(dtype).pin_memory()
        set_module_tensor_to_device(block, parameter_name(spec.name), device, value=value, dtype=dtype)


def _refuse_unknown(source: TensorSource, names: Iterable[str], expected: Iterable[str]) -> None:
    unknown = sorted(set(names) - set(expected))
    if unknown:
        raise SourceError("the checkpoint has unknown tensors: it belongs to another network", where=source.path,
                          found=listed(unknown), allowed="the 5b model without lyrics (or that of sizes.json)",
                          fix="get the right files with `dancedata pull jukebox`")  # fmt: skip
