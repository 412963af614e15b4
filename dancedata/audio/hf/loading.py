"""Load weights into a network: all must be present, none is random, no code is run."""

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

from dancedata.audio.hf.families.base import Family, NetworkSpec, Output
from dancedata.audio.hf.model_folder import ModelFolder
from dancedata.audio.networks.devices import free_memory
from dancedata.core.errors import SourceError, UsageError
from dancedata.core.packages import load
from dancedata.core.text import listed, shown
from dancedata.formats.torch_file import torch_for

#: Keys of a config that name code, the type of weights, or that have a call return something else than is read.
_NOT_OF_THE_NETWORK = (
    "auto_map", "_name_or_path", "dtype", "torch_dtype",
    "return_dict", "use_return_dict", "torchscript", "output_hidden_states", "output_attentions",
)  # fmt: skip
#: Of the free memory of a card, what weights may take: the rest is for a chunk's activations.
_FOR_WEIGHTS = 0.6


def load_network(folder: ModelFolder, family: Family, top: int, output: Output, dtype: torch.dtype) -> Any:
    """Load a model's blocks up to layer `top`, on the CPU, for inference.

    Raises SourceError: A file is damaged, or weights are missing (transformers fills those with random numbers),
        unexpected or of another shape.
    Raises UsageError: transformers is missing, or torch is older than 2.6 and the weights are pickled.
    """
    files = folder.weight_files()
    safe = files[0].suffix == ".safetensors"
    if not safe:
        torch_for(files[0])
    spec = family.network(top)
    with _errors_of(folder, files):
        if spec.model == "MuQ":
            network, missing, unexpected = _load_muq(family, spec, files)
        else:
            network, missing, unexpected = _load_native(folder, spec, safe=safe, dtype=dtype)
    _require_whole(folder, missing, spec.missing, "lack weights, which would be random")
    _require_whole(folder, unexpected, spec.unexpected, "have weights that the config has no place for")
    network = family.slimmed(network, output).eval().to(dtype)
    return network.requires_grad_(False)


def _load_native(
    folder: ModelFolder, spec: NetworkSpec, *, safe: bool, dtype: torch.dtype
) -> tuple[Any, list[str], list[str]]:
    package = load("transformers", "hf")
    config_name, keys = spec.config
    config = getattr(package, config_name)(**{k: v for k, v in keys.items() if k not in _NOT_OF_THE_NETWORK})
    mapping = {"key_mapping": dict(spec.renamed)} if spec.renamed else {}
    with _quiet(package):
        network, info = getattr(package, spec.model).from_pretrained(
            str(folder.path),
            config=config,
            dtype=dtype,
            use_safetensors=safe,
            weights_only=True,
            local_files_only=True,
            trust_remote_code=False,
            output_loading_info=True,
            **mapping,
        )
    wrong = [str(key[0] if isinstance(key, tuple) else key) for key in info.get("mismatched_keys", ())]
    if wrong:
        raise ValueError(f"weights of another shape: {listed(sorted(wrong))}")
    return network, sorted(map(str, info["missing_keys"])), sorted(map(str, info["unexpected_keys"]))


def _load_muq(family: Any, spec: NetworkSpec, files: Iterable[Path]) -> tuple[Any, list[str], list[str]]:
    from dancedata.audio.hf.families.muq_network import MuQNetwork

    network = MuQNetwork(spec.config[1], family.strides)
    tensors: dict[str, torch.Tensor] = {}
    for path in files:
        for name, tensor in _tensors(path).items():
            for old, new in spec.renamed.items():
                name = re.sub(old, new, name)
            tensors[name] = tensor
    keys = network.load_state_dict(tensors, strict=False)
    counted = [key for key in keys.missing_keys if not key.endswith("num_batches_tracked")]
    return network, sorted(counted), sorted(keys.unexpected_keys)


def _tensors(path: Path) -> Mapping[str, torch.Tensor]:
    if path.suffix == ".safetensors":
        from safetensors.torch import load_file

        return load_file(path)
    tensors: Mapping[str, torch.Tensor] = torch.load(path, map_location="cpu", weights_only=True)
    return tensors


@contextmanager
def _errors_of(folder: ModelFolder, files: tuple[Path, ...]) -> Iterator[None]:
    """Name the folder in the errors of transformers, torch and safetensors."""
    try:
        yield
    except (UsageError, SourceError):
        raise
    # A config or file that was made up can make these packages raise anything.
    except Exception as error:
        # torch's text advises to load pickles that hold more than tensors in a way that runs their code.
        more = "weights_only" in f"{error}{error.__cause__}{error.__context__}"
        raise SourceError(
            "hf: the model cannot be loaded",
            where=files[0] if len(files) == 1 else folder.path,
            found="a pickle with more than tensors, and nothing else is unpickled" if more else shown(error, 400),
            fix="compare its files with the model's page"
            + ("" if files[0].suffix == ".safetensors" else ", or get its weights as safetensors"),
        ) from error


def _require_whole(folder: ModelFolder, names: Iterable[str], allowed: Iterable[str], problem: str) -> None:
    patterns = [re.compile(pattern) for pattern in allowed]
    wrong = [name for name in names if not any(pattern.fullmatch(name) for pattern in patterns)]
    if wrong:
        raise SourceError(f"hf: the files {problem}", where=folder.path, found=f"{len(wrong)}: {listed(wrong, 6)}",
                          fix="the weights and config.json must be of one model; fetch both again")  # fmt: skip


@contextmanager
def _quiet(package: Any) -> Iterator[None]:
    """Keep transformers from printing: its complaints about weights are checked, and raised as errors."""
    logging = package.utils.logging
    level, bars = logging.get_verbosity(), logging.is_progress_bar_enabled()
    logging.set_verbosity(logging.CRITICAL)
    logging.disable_progress_bar()
    try:
        yield
    finally:
        logging.set_verbosity(level)
        if bars:
            logging.enable_progress_bar()


def place(network: Any, device: torch.device, budget: int | None = None) -> Any:
    """Put a network on a device; weights beyond the budget stay on the host, and are copied block by block."""
    if budget is None and device.type == "cuda":
        free = free_memory(device)
        budget = None if free is None else int(_FOR_WEIGHTS * free)
    if budget is None or weight_bytes(network) <= budget:
        return network.to(device)
    from accelerate import cpu_offload, dispatch_model, infer_auto_device_map

    if device.type == "cpu":
        return cpu_offload(network, execution_device=device)
    whole = getattr(network, "_no_split_modules", None) or []
    where = infer_auto_device_map(
        network,
        max_memory={device.index or 0: budget, "cpu": 1 << 60},
        no_split_module_classes=list(whole),
    )
    return dispatch_model(network, device_map=where, main_device=device)


def weight_bytes(network: torch.nn.Module) -> int:
    """Return the size of all parameters and buffers."""
    return sum(t.numel() * t.element_size() for t in (*network.parameters(), *network.buffers()))
