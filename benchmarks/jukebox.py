"""Jukebox embeddings: memory and time, against transformers 4.57 on a CPU, and by themselves on a GPU.

    python benchmarks/jukebox.py --peer PYTHON        PYTHON has torch and transformers 4.57 (5.x dropped the model)
    python benchmarks/jukebox.py --device cuda        random weights at real size
    python benchmarks/jukebox.py                      memory of the real model by accounting, nothing else

The peer comparison uses a mid-size random model (width 1024, depth 24, layer 22, the real VQ-VAE) and a 5-s clip.
Each run is a separate process with one thread; runs of the two alternate. Time is the least CPU time of a clip over
all runs, without loading. Memory is the process's peak resident set minus its resident set after the imports, with
loading. The peer is run block by block with mask=True, because its own forward requires 8192 codes.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

MIDDLE = {"width": 1024, "depth": 24, "heads": 8, "attn_width": 256, "mlp_width": 1024}
MIDDLE_LAYER = 22
CLIP_S, CODES, FRAMES = 5, 1722, 150
GATES = {"time": 0.55, "memory": 0.45, "share": 0.60, "device_gb": 10.0, "host_gb": 1.0}


def main() -> None:
    """Run the chosen benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peer", help="a Python with torch and transformers 4.57")
    parser.add_argument("--runs", type=int, default=4, help="processes of each of the two")
    parser.add_argument("--repeats", type=int, default=2, help="clips per process")
    parser.add_argument("--device", help="measure this package alone on the device")
    parser.add_argument("--size", choices=("real", "middle", "tiny"), default="real", help="with --device")
    parser.add_argument("--batches", type=int, nargs="+", default=[1, 8, 32], help="with --device")
    parser.add_argument("--work", type=Path, help="folder for random checkpoints; kept. Default: a temporary one")
    parser.add_argument("--worker", choices=("ours", "transformers", "convert-for-transformers"), help="internal")
    arguments = parser.parse_args()
    if arguments.worker:
        worker = {"ours": ours, "transformers": transformers, "convert-for-transformers": convert_for_transformers}
        print(json.dumps(worker[arguments.worker](arguments.work, arguments.repeats)))
        return
    print_machine()
    with tempfile.TemporaryDirectory() as temporary:
        work = arguments.work or Path(temporary)
        if arguments.device:
            on_device(work, arguments.device, arguments.size, arguments.batches)
        else:
            print_accounting()
        if arguments.peer:
            against_peer(work, arguments.peer, arguments.runs, arguments.repeats)


def print_machine() -> None:
    """Print the machine and the versions that the numbers depend on."""
    import torch

    lines = Path("/proc/cpuinfo").read_text().splitlines()
    cpu = next((line.split(": ")[1] for line in lines if line.startswith("model name")), platform.processor())
    print(f"{cpu}, {os.cpu_count()} cores; Python {platform.python_version()}, ", end="")
    print(f"torch {torch.__version__}")


def resident_mb() -> float:
    """Resident set now, MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def peak_mb() -> float:
    """Largest resident set since the program began or `reset_peak`, MB."""
    # Not from getrusage, which includes the parent's before exec.
    line = next(x for x in Path("/proc/self/status").read_text().splitlines() if x.startswith("VmHWM"))
    return int(line.split()[1]) * 1024 / 1e6


def reset_peak() -> None:
    """Reset the peak of the resident set in the kernel."""
    Path("/proc/self/clear_refs").write_text("5")


# Memory by accounting


def print_accounting() -> None:
    """Print the real model's device memory, 5-s clips, by precision and batch size."""
    import torch

    from dancedata.audio.jukebox import JukeboxConfig
    from dancedata.audio.jukebox.network import memory

    config = JukeboxConfig()
    print("\nlayer 66 of 5b, 5-s clips, GB on the device by accounting (no allocator, no libraries)")
    print(f"{'':6}{'weights':>9}{'clip':>8}{'batch 1':>9}{'batch 8':>9}{'batch 32':>10}")
    for name, dtype in (("fp16", torch.float16), ("bf16", torch.bfloat16), ("fp32", torch.float32)):
        weights = memory.place(config, 66, dtype, CODES, None).weight_bytes / 1e9
        clip = memory.clip_bytes(config, dtype, CODES) / 1e9
        sums = [weights + n * clip for n in (1, 8, 32)]
        print(f"{name:6}{weights:9.2f}{clip:8.3f}{sums[0]:9.2f}{sums[1]:9.2f}{sums[2]:10.2f}")


# CPU, against a peer


def against_peer(work: Path, peer: str, runs: int, repeats: int) -> None:
    """Compare with transformers and print the ratios."""
    import numpy as np

    from dancedata.audio.jukebox import JukeboxConfig
    from dancedata.testing.jukebox import random_checkpoint

    if not (work / "ready").exists():
        random_checkpoint(work, JukeboxConfig(**MIDDLE))
        _run_worker(peer, "convert-for-transformers", work, repeats)
        (work / "ready").touch()
    results: dict[str, list[dict[str, Any]]] = {"ours": [], "transformers": []}
    for _ in range(runs):
        for name, python in (("ours", sys.executable), ("transformers", peer)):
            results[name].append(_run_worker(python, name, work, repeats))
    print(
        f"\nmid-size model (width 1024, depth 24, layer 22), one 5-s clip, one thread, {runs} x {repeats} clips each"
    )
    print(f"{'':14}{'CPU s':>8}{'peak MB':>9}{'load s':>8}")
    best = {}
    for name, many in results.items():
        # The least time is the cost of the code, the largest peak is the memory that must be available.
        best[name] = (min(r["clip_s"] for r in many), max(r["peak_mb"] for r in many))
        load = min(r["load_s"] for r in many)
        print(f"{name:14}{best[name][0]:8.2f}{best[name][1]:9.0f}{load:8.2f}  {many[0]['versions']}")
    a, b = (np.load(work / f"features-{name}.npy") for name in results)
    print(f"largest difference of the features {np.abs(a - b).max():.1e} (their std is {b.std():.2f})")
    _gate("time / transformers", best["ours"][0] / best["transformers"][0], GATES["time"])
    _gate("memory / transformers", best["ours"][1] / best["transformers"][1], GATES["memory"])


def _run_worker(python: str, name: str, work: Path, repeats: int) -> dict[str, Any]:
    threads = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    command = [python, __file__, "--worker", name, "--work", str(work), "--repeats", str(repeats)]
    done = subprocess.run(command, env={**os.environ, **threads}, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)} failed:\n{done.stderr}")
    result: dict[str, Any] = json.loads(done.stdout.strip().splitlines()[-1])
    return result


def _gate(what: str, value: float, limit: float, *, least: bool = False) -> None:
    met = value >= limit if least else value <= limit
    print(f"{what}: {value:.3f} (gate {'>=' if least else '<='} {limit}) {'met' if met else 'MISSED'}")


def _clip() -> Any:
    """Five seconds of coloured noise, (n,) float32."""
    import numpy as np

    rng = np.random.default_rng(0)
    noise = np.cumsum(rng.standard_normal(CLIP_S * 44100)) * 0.01
    return (noise + 0.3 * rng.standard_normal(noise.shape)).astype(np.float32)


def _timed(work: Path, name: str, repeats: int, base_mb: float, load_s: float, embed: Any) -> dict[str, float]:
    import numpy as np

    clip, times = _clip(), []
    for _ in range(repeats):
        start = time.process_time()
        features = embed(clip)
        times.append(time.process_time() - start)
    np.save(work / f"features-{name}.npy", features)
    return {"clip_s": min(times), "load_s": load_s, "peak_mb": peak_mb() - base_mb}


def ours(work: Path, repeats: int) -> dict[str, Any]:
    """Embed with this package, from OpenAI's file layout."""
    import torch

    import dancedata
    from dancedata.audio.jukebox import JukeboxEncoder

    torch.set_num_threads(1)
    base, start = resident_mb(), time.process_time()
    encoder = JukeboxEncoder(work, layers=(MIDDLE_LAYER,), device="cpu", precision="fp32", max_codes=CODES)
    load = time.process_time() - start
    result = _timed(work, "ours", repeats, base, load, lambda clip: encoder(clip, 44100)[MIDDLE_LAYER])
    return {**result, "versions": f"dancedata {dancedata.__version__}, torch {torch.__version__}"}


def transformers(work: Path, repeats: int) -> dict[str, Any]:
    """Embed with transformers' own modules."""
    import torch
    import transformers as package
    from scipy.signal import resample
    from transformers.models.deprecated.jukebox import JukeboxPrior, JukeboxVQVAE

    torch.set_num_threads(1)
    base, start = resident_mb(), time.process_time()
    vqvae = JukeboxVQVAE.from_pretrained(work / "hf-vqvae").eval()
    prior = JukeboxPrior.from_pretrained(work / "hf-prior").eval()
    labels = torch.tensor([[2734080, 0, 1048576, 0, 0, -1, -1, -1, -1]])
    load = time.process_time() - start

    @torch.inference_mode()
    def embed(clip: Any) -> Any:
        audio = torch.from_numpy(clip / abs(clip).max())[None, :, None]
        codes = vqvae.encode(audio, start_level=2, end_level=3)[0]
        start_vector, positions = prior.metadata_embedding(labels)
        h = prior.prior.embed_tokens(codes)
        h = torch.cat((start_vector.view(1, 1, -1), h[:, :-1]), dim=1)
        h = h + prior.prior.pos_emb()[: h.shape[1]] + positions[:, : h.shape[1]]
        for block in prior.prior.transformer._attn_mods[:MIDDLE_LAYER]:
            h = block(h, last_encoder_hidden_states=None, sample=True)
            block.attn.del_cache()
        return resample(h[0].numpy(), FRAMES)

    result = _timed(work, "transformers", repeats, base, load, embed)
    return {**result, "versions": f"transformers {package.__version__}, torch {torch.__version__}"}


def convert_for_transformers(work: Path, _repeats: int) -> dict[str, Any]:
    """Write the random checkpoint as transformers' own folders, with every block, as it loads all of them."""
    import torch
    from transformers.models.deprecated.jukebox import (
        JukeboxPrior,
        JukeboxPriorConfig,
        JukeboxVQVAE,
        JukeboxVQVAEConfig,
    )

    vqvae = JukeboxVQVAE(JukeboxVQVAEConfig())
    model = torch.load(work / "vqvae.pth.tar", map_location="cpu", weights_only=True)["model"]
    ours = {k: v for k, v in model.items() if k.startswith("encoders.2.") or k == "bottleneck.level_blocks.2.k"}
    _load_all({_vqvae_name(k): v for k, v in ours.items()}, vqvae)
    vqvae.save_pretrained(work / "hf-vqvae")
    prior = JukeboxPrior(
        JukeboxPriorConfig(
            hidden_size=MIDDLE["width"],
            num_layers=MIDDLE["depth"],
            n_heads=MIDDLE["heads"],
            attention_pattern="raw_column_previous_row_attention",
            blocks=128,
            n_ctx=8192,
            mask=True,
            max_nb_genres=5,
            metadata_dims=[120, 4111],
            timing_dims=128,
            min_duration=60,
            max_duration=600,
            nb_relevant_lyric_tokens=0,
            is_encoder_decoder=False,
        )
    )
    model = torch.load(work / "prior_level_2.pth.tar", map_location="cpu", weights_only=True)["model"]
    _load_all({_prior_name(k): v for k, v in model.items()}, prior)
    prior.save_pretrained(work / "hf-prior")
    return {}


def _load_all(tensors: dict[str, Any], module: Any) -> None:
    wrong = module.load_state_dict(tensors, strict=False).unexpected_keys
    if wrong:
        raise SystemExit(f"transformers has no {wrong[:3]}")


def _vqvae_name(name: str) -> str:
    if name.startswith("bottleneck"):
        return name.replace(".k", ".codebook")
    part = name.split(".")
    head, step, rest = ".".join(part[:4]), int(part[5]), part[6:]
    if len(rest) == 1:
        return f"{head}.proj_out.{rest[0]}"
    if rest[0] == "0":
        return f"{head}.downsample_block.{2 * step}.{rest[1]}"
    layer = {"1": "conv1d_1", "3": "conv1d_2"}[rest[4]]
    return f"{head}.downsample_block.{2 * step + 1}.resnet_block.{rest[2]}.{layer}.{rest[5]}"


def _prior_name(name: str) -> str:
    for old, new in (
        ("y_emb.bow_genre_emb.emb", "metadata_embedding.bow_genre_emb"),
        ("y_emb.artist_emb.emb", "metadata_embedding.artist_emb"),
        ("y_emb.", "metadata_embedding."),
        ("prior.x_emb", "prior.embed_tokens"),
        ("prior.x_out", "prior.fc_proj_out"),
        (".ln_", ".layer_norm_"),
    ):
        name = name.replace(old, new)
    for short, long in ((".w", ".weight"), (".b", ".bias")):
        name = name.removesuffix(short) + long if name.endswith(short) else name
    return name


# A device, this package alone


def on_device(work: Path, device: str, size: str, batches: list[int]) -> None:
    """Load random weights, print memory, time a clip and the share of the device's measured matmul rate."""
    import torch

    from dancedata.audio.jukebox import JukeboxConfig, JukeboxEncoder
    from dancedata.audio.jukebox.weights.folder import SIZES_FILE
    from dancedata.audio.jukebox.weights.loading import Checkpoint
    from dancedata.testing.jukebox import TINY, RandomSource

    config = {"real": JukeboxConfig(), "middle": JukeboxConfig(**MIDDLE), "tiny": TINY}[size]
    layer = {"real": 66, "middle": MIDDLE_LAYER, "tiny": TINY.depth}[size]
    folder = work / f"random-{size}"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / SIZES_FILE).write_text(json.dumps(config.to_json()))
    source = RandomSource(config, layer)
    cuda = torch.device(device).type == "cuda"
    if cuda:
        torch.zeros(1, device=device)
        print(torch.cuda.get_device_name(device))
    base, start = resident_mb(), time.perf_counter()
    reset_peak()
    with patch("dancedata.audio.jukebox.encoder.open_openai", lambda *_: Checkpoint(source, source)):
        encoder = JukeboxEncoder(folder, layers=(layer,), device=device, max_codes=CODES)
    load = time.perf_counter() - start
    host = (peak_mb() - base) / 1e3
    print(f"{size} model, layer {layer}, {encoder.precision}: loaded in {load:.1f} s")
    if cuda:
        _gate("peak host memory while loading, GB", host, GATES["host_gb"])
    else:
        print(f"peak memory while loading, weights included, GB: {host:.2f}")
    rate = _matmul_rate(torch.device(device), encoder.precision)
    flop = 2 * CODES * layer * config.width * (4 * config.attn_width + 2 * config.mlp_width)
    print(f"measured {encoder.precision} matmul: {rate / 1e12:.2f} TFLOP/s; a 5-s clip takes {flop / 1e12:.3f} TFLOP")
    for batch in batches:
        _measure_batch(encoder, batch, flop / rate, cuda)


def _measure_batch(encoder: Any, batch: int, ideal_s: float, cuda: bool) -> None:
    import torch

    clips = [_clip() for _ in range(batch)]
    if cuda:
        torch.cuda.reset_peak_memory_stats()
    seconds = []
    for _ in range(4):
        start = time.perf_counter()
        encoder.embed_batch(clips, 44100, batch_size=batch)  # the results are on the host, so no operation is pending
        seconds.append((time.perf_counter() - start) / batch)
    share = ideal_s / min(seconds[1:])
    print(f"batch {batch}: {1000 * min(seconds[1:]):.1f} ms per 5-s clip, {100 * share:.0f} % of the matmul rate")
    if not cuda:
        return
    gb = torch.cuda.max_memory_reserved() / 1e9
    print(f"  peak device memory {gb:.2f} GB reserved, {torch.cuda.max_memory_allocated() / 1e9:.2f} GB allocated")
    if batch >= 8:
        _gate(f"  share at batch {batch}", share, GATES["share"], least=True)
    if batch == 1:
        _gate("  device GB at batch 1", gb, GATES["device_gb"])


def _matmul_rate(device: Any, precision: str) -> float:
    """Return the best FLOP/s of a large square product in the type of the model on the device."""
    import torch

    on_cpu = device.type != "cuda"
    dtype = {"fp16": torch.float16, "bf16": torch.bfloat16, "fp32": torch.float32}[precision]
    n = 1024 if on_cpu else 8192
    a, b = (torch.randn(n, n, device=device).to(dtype) for _ in range(2))
    best = float("inf")
    for _ in range(20):
        if not on_cpu:
            torch.cuda.synchronize()
        start = time.perf_counter()
        torch.mm(a, b)
        if not on_cpu:
            torch.cuda.synchronize()
        best = min(best, time.perf_counter() - start)
    return 2 * n**3 / best


if __name__ == "__main__":
    main()
