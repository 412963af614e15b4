"""Time and memory of the feature hf with a network of MERT-95M's size (random weights), as ratios.

    python benchmarks/encoders.py [--minutes 10] [--layer 7] [--threads 1] [--device cpu]

On a CPU: a song of `--minutes` against 30-s chunks that transformers is given one by one, and one minute against the
whole song in one call of transformers. The peers compute and keep all 12 layers, as public scripts do, and bring one
of them to 30 rows per second by linear interpolation; ours computes the blocks up to the layer, in chunks that
overlap by 4 s. Each runs in a separate process. Times are CPU times of all its threads, without loading; memory is
the peak of the resident set over what it is after loading.
On a card (`--device cuda`): songs per second and the share of the measured matmul rate, fp16 and fp32.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

#: MERT-v1-95M.
SIZE = {
    "hidden_size": 768, "num_hidden_layers": 12, "num_attention_heads": 12, "intermediate_size": 3072,
    "conv_dim": [512] * 7, "num_conv_pos_embeddings": 128, "num_conv_pos_embedding_groups": 16,
}  # fmt: skip
RATE = 24_000
CHUNK = 30 * RATE


def main() -> None:
    """Run the selected benchmarks and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--layer", type=int, default=7)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--worker", choices=("ours", "chunks", "whole"), help="internal")
    parser.add_argument("--folder", type=Path, help="internal")
    arguments = parser.parse_args()
    if arguments.worker:
        import torch

        torch.set_num_threads(arguments.threads)
        work = {"ours": ours, "chunks": chunks, "whole": whole}[arguments.worker]
        print(json.dumps(work(arguments.folder, arguments.minutes, arguments.layer)))
        return
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary) / "model"
        write_model(folder)
        print(circumstances(), flush=True)
        if arguments.device == "cpu":
            against(folder, arguments.minutes, "chunks", arguments.layer, arguments.threads)
            against(folder, 1, "whole", arguments.layer, arguments.threads)
        else:
            on_card(folder, arguments.device, arguments.layer)


def write_model(folder: Path) -> None:
    """Write the random model."""
    from dancedata.testing.encoders import write_random_model

    write_random_model("mert", folder, **SIZE)


def circumstances() -> str:
    """Return date, versions and number of cores."""
    import datetime

    import torch
    import transformers

    versions = f"torch {torch.__version__}, transformers {transformers.__version__}"
    return f"{datetime.date.today()}, Python {sys.version.split()[0]}, {versions}, {os.cpu_count()} cores"


def against(folder: Path, minutes: float, peer: str, layer: int, threads: int) -> None:
    """Print time and memory of ours and of a plain way, and their ratios."""
    found, load = {}, [os.getloadavg()[0]]
    for name in ("ours", peer):
        found[name] = run(name, folder, minutes, layer, threads)
        load.append(os.getloadavg()[0])
    print(f"\n{minutes:g} min of music, layer {layer}, {threads} threads; against transformers: {peer}")
    print(f"  load of the machine before, between and after: {', '.join(f'{one:.1f}' for one in load)}")
    for name, one in found.items():
        print(f"  {name:8} {one['cpu_s']:8.1f} CPU s  {one['peak_mb']:8.0f} MB over the loaded model")
    ratios = [found["ours"][key] / found[peer][key] for key in ("cpu_s", "peak_mb")]
    print(f"  ratios: time {ratios[0]:.2f}, memory {ratios[1]:.2f}", flush=True)


def run(worker: str, folder: Path, minutes: float, layer: int, threads: int) -> dict[str, float]:
    """Run a worker in a separate process."""
    limits = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), str(threads))
    command = [sys.executable, __file__, "--worker", worker, "--folder", str(folder), "--minutes", str(minutes)]
    command += ["--layer", str(layer), "--threads", str(threads)]
    done = subprocess.run(command, env={**os.environ, **limits}, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} failed:\n{done.stderr}")
    result: dict[str, float] = json.loads(done.stdout.strip().splitlines()[-1])
    return result


def song(minutes: float) -> Any:
    """Noise of some minutes, (n,) float32 at MERT's rate."""
    import numpy as np

    return np.random.default_rng(0).normal(0, 0.1, int(60 * minutes * RATE)).astype(np.float32)


def measured(compute: Any) -> dict[str, float]:
    """Return CPU time and the peak of the resident set over what it is now."""
    base = int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6
    Path("/proc/self/clear_refs").write_text("5")
    start = time.process_time()
    compute()
    seconds = time.process_time() - start
    line = next(x for x in Path("/proc/self/status").read_text().splitlines() if x.startswith("VmHWM"))
    return {"cpu_s": seconds, "peak_mb": int(line.split()[1]) * 1024 / 1e6 - base}


def ours(folder: Path, minutes: float, layer: int) -> dict[str, float]:
    """Compute rows at 30 per second as a build does."""
    from dancedata.audio.hf.encoder import HuggingFaceEncoder
    from dancedata.core.grid import FrameGrid

    encoder = HuggingFaceEncoder(_settings(folder, layer), device="cpu")
    samples = song(minutes)
    rows = int(60 * minutes * 30)
    return measured(
        lambda: encoder.rows([samples], RATE, FrameGrid.of(30), rows, finish=lambda x: x.astype("float16"))
    )


def _settings(folder: Path, layer: int) -> Any:
    from dancedata.audio.hf.model_folder import open_model
    from dancedata.audio.hf.settings import settings_of

    return settings_of(
        open_model(str(folder)), output="auto", layers=layer, reduce="concat", chunk_s=None, overlap_s=None,
        resample="auto", normalize="extractor",
    )  # fmt: skip


def _peer(folder: Path) -> Any:
    import transformers

    transformers.utils.logging.set_verbosity_error()
    transformers.utils.logging.disable_progress_bar()
    config = json.loads((folder / "config.json").read_text()) | {"model_type": "hubert"}
    config.pop("auto_map")
    return transformers.HubertModel.from_pretrained(folder, config=transformers.HubertConfig(**config)).eval()


def _by_transformers(network: Any, samples: Any, layer: int) -> Any:
    import torch

    normal = (samples - samples.mean()) / (samples.var() + 1e-7) ** 0.5
    with torch.inference_mode():
        found = network(torch.from_numpy(normal)[None], output_hidden_states=True)
    return found.hidden_states[layer][0].numpy()


def chunks(folder: Path, minutes: float, layer: int) -> dict[str, float]:
    """Give transformers 30-s chunks one by one, all layers kept, and interpolate, as public scripts do."""
    import numpy as np

    network, samples = _peer(folder), song(minutes)

    def compute() -> None:
        found = [_by_transformers(network, samples[k : k + CHUNK], layer) for k in range(0, len(samples), CHUNK)]
        _interpolated(np.concatenate(found), int(60 * minutes * 30))

    return measured(compute)


def whole(folder: Path, minutes: float, layer: int) -> dict[str, float]:
    """Give transformers the whole song at once."""
    network, samples = _peer(folder), song(minutes)
    return measured(lambda: _interpolated(_by_transformers(network, samples, layer), int(60 * minutes * 30)))


def _interpolated(frames: Any, rows: int) -> Any:
    import torch

    given = torch.from_numpy(frames).T[None]
    return torch.nn.functional.interpolate(given, size=rows, mode="linear", align_corners=False)[0].T.numpy()


def on_card(folder: Path, device: str, layer: int) -> None:
    """Print songs of 60 s per second, and the share of the card's matmul rate in the transformer's products."""
    import torch

    from dancedata.audio.hf.encoder import HuggingFaceEncoder
    from dancedata.core.grid import FrameGrid

    samples = song(1)
    for precision, dtype in (("fp16", torch.float16), ("fp32", torch.float32)):
        encoder = HuggingFaceEncoder(_settings(folder, layer), device=device, precision=precision)
        seconds = []
        for _ in range(4):
            start = time.perf_counter()
            encoder.rows([samples] * 8, RATE, FrameGrid.of(30), 1800, finish=lambda x: x.astype("float16"))
            seconds.append((time.perf_counter() - start) / 8)
        best = min(seconds[1:])
        # Products of a block: 4 projections of 768 x 768 and 2 of 768 x 3072; of the convolutions all but the first.
        frames = 60 * 75 * 34 / 30  # chunks overlap by 4 of 30 s
        blocks = layer * frames * 2 * (4 * 768**2 + 2 * 768 * 3072)
        stem = sum(2 * 512 * 512 * k * 34 / 30 * 60 * RATE / hop for k, hop in _CONVOLUTIONS)
        share = (blocks + stem) / best / _matmul_rate(device, dtype)
        print(f"{precision}: {1 / best:.1f} songs of 60 s per second, {100 * share:.0f} % of the matmul rate")


_CONVOLUTIONS = ((3, 10), (3, 20), (3, 40), (3, 80), (2, 160), (2, 320))


def _matmul_rate(device: str, dtype: Any) -> float:
    import torch

    a, b = (torch.randn(8192, 8192, device=device, dtype=dtype) for _ in range(2))
    best = float("inf")
    for _ in range(10):
        torch.cuda.synchronize()
        start = time.perf_counter()
        torch.mm(a, b)
        torch.cuda.synchronize()
        best = min(best, time.perf_counter() - start)
    return 2 * 8192**3 / best


if __name__ == "__main__":
    main()
