"""Models whose files and outputs are kept: releases of transformers must not change them.

The cache key of the feature hf does not have the version of transformers (a decision), so a release that changes
numbers has to fail a test. `data/golden.json.gz` has, for each kind of model, config.json, the extractor's parameters
and the names and shapes of the tensors as transformers 4.57 and 5.23 both write them; the tensors are drawn here.
`data/golden.npz` has outputs::

    python tests/hf/golden.py

rewrites both. That is right only for a model that was added: other outputs for the same files mean that the
family's `version` and the feature's key have to change.
"""

import gzip
import json
import re
import tempfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

DATA = Path(__file__).parent / "data"
LAYOUTS, OUTPUTS = DATA / "golden.json.gz", DATA / "golden.npz"
#: 0.6 s: shorter than the windows of encoders of spectrograms, which are padded.
SECONDS = 0.6
#: Of the outputs every 5th frame and every 3rd column are kept.
KEPT = (slice(None, None, 5), slice(None, None, 3))
#: Decoders are not loaded.
_UNUSED = re.compile(r"(model\.)?decoder\.")


def uniform(seed: int, shape: tuple[int, ...]) -> np.ndarray:
    """Numbers of mean 0 and variance 1, float32, from the bits that numpy guarantees for every version of itself."""
    bits = np.random.PCG64(seed).random_raw(int(np.prod(shape, dtype=np.int64)))
    return np.asarray((np.asarray(bits >> np.uint64(40)) / 2**24 - 0.5) * 12**0.5, np.float32).reshape(shape)


def tensor(name: str, shape: tuple[int, ...], dtype: str) -> np.ndarray:
    """The tensor of a name: matrices keep activations near 1, norms and gains are positive, codes are spread."""
    if name.endswith("relative_position_index"):
        return _index_of_pairs(round(shape[0] ** 0.5))
    if dtype == "int64":
        return np.zeros(shape, np.int64)
    values = uniform(zlib.crc32(name.encode()), shape)
    if name.endswith(("inited", "initialized", "cluster_size", "cluster_usage")):
        return np.ones(shape, np.float32)
    if name.endswith(("codebook.embed", "codebook.embed_avg", "codebook.embed_sum")):
        return 0.3 * values
    if name.endswith("bias") or "running_mean" in name or name.endswith("_bias_table"):
        return 0.1 * values
    if len(shape) >= 2 and max(shape) < np.prod(shape):
        fan_in = np.prod(shape[1:])
        return np.asarray(values / np.sqrt(fan_in), np.float32)
    return np.asarray(1 + 0.2 * values, np.float32)  # gains: (n,), or (1, n, 1) and the like


def _index_of_pairs(width: int) -> np.ndarray:
    """Index of the entry of its table that a Swin transformer adds for a pair of patches, as in CLAP's files."""
    places = np.indices((width, width)).reshape(2, -1)
    apart = places[:, :, None] - places[:, None, :] + width - 1
    return np.asarray(apart[0] * (2 * width - 1) + apart[1], np.int64)


def write_model(layout: dict[str, Any], folder: Path) -> None:
    """Write the folder of a model."""
    import torch
    from safetensors.torch import save_file

    folder.mkdir(parents=True)
    (folder / "config.json").write_text(json.dumps(layout["config"]))
    if layout["extractor"] is not None:
        (folder / "preprocessor_config.json").write_text(json.dumps(layout["extractor"]))
    tensors = {name: torch.from_numpy(tensor(name, tuple(s), d)) for name, (s, d) in layout["tensors"].items()}
    if layout["config"].get("model_type") == "mert_model":
        torch.save(tensors, folder / "pytorch_model.bin")
    else:
        save_file(tensors, folder / "model.safetensors", metadata={"format": "pt"})


def outputs(folder: Path) -> dict[str, np.ndarray]:
    """Some frames and columns of what a model gives: the first and last layers, or embedding and codes."""
    from dancedata.audio.hf.encoder import HuggingFaceEncoder
    from dancedata.audio.hf.model_folder import open_model
    from dancedata.audio.hf.settings import settings_of
    from dancedata.core.errors import UsageError

    found = {}
    opened = open_model(str(folder))
    wanted = [("hidden", 0), ("hidden", 1), ("hidden", "last"), ("embedding", "last"), ("codes", "last")]
    for output, layers in wanted:
        try:
            made = settings_of(
                opened, output=output, layers=layers, reduce="concat", chunk_s=None, overlap_s=None, resample="auto",
                normalize="extractor",
            )  # fmt: skip
        except UsageError:  # not of this family
            continue
        rate = made.family.sample_rate
        samples = 0.2 * uniform(rate, (round(SECONDS * rate),))
        values = HuggingFaceEncoder(made, device="cpu").frames(samples, rate).values
        found[output if output != "hidden" else f"layer {layers}"] = values[KEPT]
    return found


def layouts() -> dict[str, Any]:
    """Parts of the models' files that are kept, by kind."""
    with gzip.open(LAYOUTS, "rt") as file:
        found: dict[str, Any] = json.load(file)
    return found


def kept() -> dict[str, dict[str, np.ndarray]]:
    """The kept outputs, by kind."""
    found: dict[str, dict[str, np.ndarray]] = {}
    with np.load(OUTPUTS) as file:
        for name in file.files:
            kind, what = name.split("/")
            found.setdefault(kind, {})[what] = file[name]
    return found


def _layout(kind: str, folder: Path) -> dict[str, Any]:
    import torch
    from safetensors.torch import load_file

    from dancedata.testing.encoders import write_random_model

    write_random_model(kind, folder)
    safe, extractor = folder / "model.safetensors", folder / "preprocessor_config.json"
    tensors = load_file(safe) if safe.exists() else torch.load(folder / "pytorch_model.bin", weights_only=True)
    config = json.loads((folder / "config.json").read_text())
    config.pop("transformers_version", None)
    return {
        "config": config,
        "extractor": json.loads(extractor.read_text()) if extractor.exists() else None,
        "tensors": {
            name: (list(value.shape), str(value.dtype).removeprefix("torch."))
            for name, value in sorted(tensors.items())
            if not _UNUSED.match(name)
        },
    }


def main() -> None:
    """Rewrite layouts and outputs."""
    from dancedata.testing.encoders import KINDS

    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        made = {kind: _layout(kind, root / "made" / kind) for kind in KINDS}
        arrays = {}
        for kind, layout in made.items():
            write_model(layout, root / kind)
            for what, values in outputs(root / kind).items():
                print(f"{kind:20} {what:10} {values.shape!s:10} from {values.min():.3g} to {values.max():.3g}")
                arrays[f"{kind}/{what}"] = values
    DATA.mkdir(exist_ok=True)
    text = json.dumps(made, separators=(",", ":"), sort_keys=True)
    LAYOUTS.write_bytes(gzip.compress(text.encode(), mtime=0))
    np.savez_compressed(OUTPUTS, **arrays)


if __name__ == "__main__":
    main()
