"""Reading the weights of Beat This! without executing anything of the file."""

import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch

from dancedata.audio.beats.network import BeatNetwork, Sizes
from dancedata.core.errors import SourceError
from dancedata.core.text import listed, shown
from dancedata.files.regular_file import open_regular
from dancedata.formats.torch_file import torch_for

_FIX = "fetch final0.ckpt or small0.ckpt of Beat This! again"
_ALLOWED = "a checkpoint of beat_this (.ckpt), or its state as .safetensors"
_FLAGS = {"true": True, "false": False}


def load_network(path: Path) -> BeatNetwork:
    """Load a network from a checkpoint of the package beat_this, or from its tensors in a safetensors file.

    `path`: ``.ckpt``: a torch file with ``state_dict`` and ``hyper_parameters``. ``.safetensors``: the same tensors;
        ``sum_head`` in its metadata may be "false".
    Raises SourceError: The file is missing or damaged, holds objects other than tensors and plain values, or another
        network.
    """
    tensors, summed = _read_safetensors(path) if path.suffix == ".safetensors" else _read_checkpoint(path)
    state = {name.removeprefix("model.").replace("_orig_mod.", ""): value for name, value in tensors.items()}
    shapes = {name: tuple(value.shape) for name, value in state.items()}
    try:
        sizes = Sizes.of_shapes(shapes, summed)
    except (KeyError, IndexError) as error:
        raise _other_network(path, f"no tensor {shown(error)}") from error
    if not sizes.possible:
        raise _other_network(path, f"{sizes}")
    with torch.device("meta"):
        network = BeatNetwork(sizes)
    bad = [name for name, value in state.items() if value.is_floating_point() and not value.isfinite().all()]
    if bad:
        raise _other_network(path, f"values that are not finite in {listed(bad)}")
    try:  # none stays random, none is unused, and shapes are equal
        network.load_state_dict({k: v.float() if v.is_floating_point() else v for k, v in state.items()}, assign=True)
    except RuntimeError as error:
        raise _other_network(path, shown(" ".join(str(error).split()), 300)) from error
    return network.requires_grad_(False)


def _read_checkpoint(path: Path) -> tuple[dict[str, torch.Tensor], bool]:
    torch_for(path)
    try:
        with open_regular(path) as file:
            checkpoint: Any = torch.load(file, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, EOFError, ValueError, KeyError, pickle.UnpicklingError) as error:
        raise _unreadable(path, error) from error
    if not isinstance(checkpoint, Mapping) or not isinstance(checkpoint.get("state_dict"), Mapping):
        raise _other_network(path, "no state_dict")
    parameters = checkpoint.get("hyper_parameters")
    summed = parameters.get("sum_head", True) if isinstance(parameters, Mapping) else True
    return _tensors(path, checkpoint["state_dict"]), bool(summed)


def _read_safetensors(path: Path) -> tuple[dict[str, torch.Tensor], bool]:
    from safetensors import SafetensorError, safe_open

    try:
        with open_regular(path), safe_open(path, framework="pt") as file:
            metadata: dict[str, str] = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
    except (OSError, SafetensorError) as error:
        raise _unreadable(path, error) from error
    return tensors, _FLAGS.get(metadata.get("sum_head", "true").lower(), True)


def _tensors(path: Path, state: Mapping[Any, Any]) -> dict[str, torch.Tensor]:
    strange = [shown(name) for name, value in state.items() if not (isinstance(name, str) and torch.is_tensor(value))]
    if strange:
        raise _other_network(path, f"entries that are not tensors: {listed(strange)}")
    return dict(state)


def _unreadable(path: Path, error: Exception) -> SourceError:
    missing = isinstance(error, FileNotFoundError)
    problem = "the file of the weights does not exist" if missing else "the weights cannot be read"
    found = None if missing else f"{type(error).__name__}: {shown(str(error).splitlines()[0] if str(error) else '')}"
    return SourceError(f"beats: {problem}", where=path, found=found, allowed=_ALLOWED, fix=_FIX)


def _other_network(path: Path, found: str) -> SourceError:
    return SourceError("beats: not the weights of Beat This!", where=path, found=found, allowed=_ALLOWED, fix=_FIX)
