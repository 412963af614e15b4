"""Compares our front end and conformer of MuQ with the package muq, on the kept tiny model of test_direct.

    pip install --no-deps --target FOLDER muq==0.1.0 nnAudio easydict einops torchaudio==2.11.0
    pip install --no-deps --target FOLDER transformers==4.57.6 huggingface-hub==0.36.0 tokenizers==0.22.1
    PYTHONPATH=FOLDER python tests/hf/against_muq.py

The package does not run with transformers 5, whose conformer returns no hidden states to it. Releases of torchaudio
trail those of torch: where its compiled part does not load, its folder lib may be removed: spectrograms do not use
it. MuQ-MuLan, which needs torchvision, is not imported.
"""

import importlib
import importlib.util
import json
import sys
import tempfile
import types
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import load_file
from transformers import Wav2Vec2ConformerConfig

sys.path.insert(0, str(Path(__file__).parent))

from golden import layouts, uniform, write_model

from dancedata.audio.hf.encoder import HuggingFaceEncoder
from dancedata.audio.hf.model_folder import open_model
from dancedata.audio.hf.settings import settings_of

#: Largest difference that passes, of values near 1.
TOLERANCE = 1e-4


def package() -> Any:
    """Import muq.muq.muq, and not muq.muq_mulan with it."""
    if "muq.muq.muq" in sys.modules:
        return sys.modules["muq.muq.muq"]
    spec = importlib.util.find_spec("muq")
    if spec is None:
        raise SystemExit(__doc__)
    parent = types.ModuleType("muq")
    parent.__path__ = list(spec.submodule_search_locations or ())
    sys.modules["muq"] = parent
    return importlib.import_module("muq.muq.muq")


def theirs(folder: Path, samples: np.ndarray) -> list[np.ndarray]:
    """Hidden states of the package: what enters the first block, what leaves each."""
    config = json.loads((folder / "config.json").read_text())
    inner = Wav2Vec2ConformerConfig(**{k: v for k, v in config["w2v2_config"].items() if k != "model_type"}).to_dict()
    config["w2v2_config"] = {k: v for k, v in inner.items() if not isinstance(v, dict)} | {
        "_attn_implementation": "eager"
    }
    network = package().MuQ({k: v for k, v in config.items() if k != "model_type"}).eval()
    own = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    tensors = load_file(folder / "model.safetensors")
    # The head and the quantiser of training have other sizes here.
    used = {name: tensor for name, tensor in tensors.items() if own.get(name) == tuple(tensor.shape)}
    print(
        "tensors of the file that the package does not have, or has in another shape:",
        sorted(set(tensors) - set(used)),
    )
    print("tensors of the package that the file does not have:", sorted(set(own) - set(tensors)))
    network.load_state_dict(used, strict=False)
    with torch.inference_mode():
        return [state[0].numpy() for state in network(torch.from_numpy(samples)[None]).hidden_states]


def main() -> int:
    """Print the largest difference of each layer; 1 where one is too large."""
    torch.set_num_threads(1)
    worst = 0.0
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "muq"
        write_model(layouts()["muq"], folder)
        for n in (14_400, 15_119, 24_240):  # whole hops, and not
            samples = 0.2 * uniform(n, (n,))
            for layer, wanted in enumerate(theirs(folder, samples)):
                made = settings_of(
                    open_model(str(folder)), output="hidden", layers=layer, reduce="concat", chunk_s=None,
                    overlap_s=None, resample="auto", normalize="extractor",
                )  # fmt: skip
                found = HuggingFaceEncoder(made, device="cpu").frames(samples, 24_000).values
                if found.shape != wanted.shape:
                    print(f"{n} samples, layer {layer}: {found.shape} instead of {wanted.shape}")
                    return 1
                difference = float(np.abs(found - wanted).max())
                print(
                    f"{n} samples, layer {layer}: {wanted.shape}, largest {np.abs(wanted).max():.3g}, "
                    f"difference {difference:.2g}"
                )
                worst = max(worst, difference)
    return int(not worst < TOLERANCE)


if __name__ == "__main__":
    sys.exit(main())
