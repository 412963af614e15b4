"""A small EDGE (Tseng et al., CVPR 2023): diffusion of motion windows, conditioned on music, with losses on joints.

    pip install accelerate && dancedata build demo --out data/demo
    python examples/train_edge_like.py --data data/demo --out runs/edge              # a minute on a CPU
    python examples/train_edge_like.py --data data/demo --out runs/edge --steps 600  # resumes
    accelerate launch examples/train_edge_like.py --data data/aistpp --out runs/edge --width 512 --steps 200000

`--data` has edge151, lodge139 or finedance319, and librosa35: AIST++, FineDance, or your own data. OUT/dance.bvh,
for Blender, and OUT/dance.svg, for a browser, are a dance for `--song`. Resume with the same `--seconds`.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import torch
from accelerate import Accelerator, utils
from torch import Tensor, nn
from torch.utils.data import DataLoader

import dancedata
from dancedata.core.errors import DanceDataError
from dancedata.formats.bvh.write import write_bvh
from dancedata.torch import BatchStream, Scale, WindowDataset, Windows
from dancedata.torch.kinematics import Poses, decode, joints


class Denoiser(nn.Module):
    """Returns clean motion (B, T, D) of noisy motion (B, T, D), noise levels (B,) and music (B, T, M)."""

    def __init__(self, motion: int, music: int, width: int, layers: int, length: int) -> None:
        super().__init__()
        self.motion, self.music = nn.Linear(motion, width), nn.Linear(music, width)
        self.out = nn.Linear(width, motion)
        self.place = nn.Parameter(torch.randn(length, width) * 0.02)
        self.level = nn.Sequential(nn.Linear(width, width), nn.SiLU(), nn.Linear(width, width))
        self.unconditional = nn.Parameter(torch.zeros(width))
        layer = nn.TransformerEncoderLayer(width, 4, 2 * width, 0.1, "gelu", batch_first=True, norm_first=True)
        self.body = nn.TransformerEncoder(layer, layers, enable_nested_tensor=False)
        self.register_buffer("rates", torch.exp(-torch.arange(0, width, 2) * math.log(1e4) / width) * 1000)

    def forward(self, noisy: Tensor, level: Tensor, music: Tensor, keep: Tensor) -> Tensor:
        """Music is left out where `keep` (B,) is false: classifier-free guidance."""
        angles = level[:, None] * self.rates
        time = self.level(torch.cat([angles.sin(), angles.cos()], dim=-1))
        condition = torch.where(keep[:, None, None], self.music(music), self.unconditional)
        return self.out(self.body(self.motion(noisy) + condition + self.place[: noisy.shape[1]] + time[:, None]))


def noise(clean: Tensor, level: Tensor) -> Tensor:
    """Mix in noise by the cosine schedule, levels (B,) in [0, 1]."""
    share = torch.cos(level * math.pi / 2).view(-1, *[1] * (clean.dim() - 1))
    return share * clean + (1 - share**2).clamp_min(0).sqrt() * torch.randn_like(clean)


@torch.no_grad()
def sample(model: nn.Module, shape: tuple[int, ...], condition: tuple, steps: int, guidance: float, link) -> Tensor:
    """Return samples by DDIM; `link` may tie the samples of a batch to each other after every step."""
    x = torch.randn(shape, device=condition[0].device)
    keep = torch.ones(len(x), dtype=torch.bool, device=x.device)
    for step in range(steps, 0, -1):
        now, then = (torch.full((len(x),), k / steps * 0.999, device=x.device) for k in (step, step - 1))
        free = model(x, now, *condition, ~keep)
        clean = (free + guidance * (model(x, now, *condition, keep) - free)).clamp(-1, 1)
        a, b = (torch.cos(level[0] * math.pi / 2) for level in (now, then))
        x = link(b * clean + (1 - b**2).clamp_min(0).sqrt() * (x - a * clean) / (1 - a**2).sqrt())
    return x


class Losses:
    """EDGE's four losses, with its weights: columns, their speed, joints, and feet that slide while in contact."""

    def __init__(self, data: WindowDataset, field: str) -> None:
        self.field, self.scaler = field, data.scaler(field)
        self.columns, self.feet = data.store.fields[field], list(data.store.skeleton.feet)

    def __call__(self, found: Tensor, clean: Tensor) -> dict[str, Tensor]:
        """Return the losses by name."""
        found, clean, square = found.float(), clean.float(), nn.functional.mse_loss
        places, wanted = (joints(self.scaler.unnormalize(x), self.field) for x in (found, clean))
        contact = self.scaler.unnormalize(found)[..., :-1, self.columns.slice("contact")] > 0.95
        slide = places[..., self.feet, :].diff(dim=-3) * contact[..., None]
        return {
            "columns": 0.636 * square(found, clean),
            "speed": 2.964 * square(found.diff(dim=-2), clean.diff(dim=-2)),
            "joints": 0.646 * square(places, wanted),
            "feet": 10.942 * slide.square().mean(),
        }


def generate(model: nn.Module, data: WindowDataset, field: str, music: Tensor, steps: int, guidance: float) -> Tensor:
    """Return columns (T', D) for music (T, M): windows that overlap by half, the halves tied to each other."""
    half, music = data.windows[0].length // 2, data.scaler("librosa35").normalize(music)
    n = max(1, -(-(len(music) - half) // half))
    music = torch.cat([music, music[-1:].expand(max(0, (n + 1) * half - len(music)), -1)])
    windows = torch.stack([music[k * half : k * half + 2 * half] for k in range(n)])

    def link(x: Tensor) -> Tensor:
        for k in range(1, len(x)):
            x[k, :half] = x[k - 1, half:]
        return x

    model.eval()
    made = sample(model, (n, 2 * half, data.store.fields[field].width), (windows,), steps, guidance, link)
    return data.scaler(field).unnormalize(torch.cat([made[0, :half], *made[:, half:]]))


def write_dance(out: Path, poses: Poses, fps: float) -> None:
    """Write poses of (T) frames as BVH, in metres, and as a figure that moves in a browser, seen from the front."""
    bones, places = poses.skeleton, poses.joints().cpu()
    turns, root = poses.matrices.double().cpu().numpy(), places[:, 0].double().numpy()
    offsets = bones.offsets * (torch.arange(len(bones.joints)) > 0).numpy()[:, None]  # the root's is in its channels
    write_bvh(out.with_suffix(".bvh"), bones.joints, bones.parents, offsets, turns, root, f"{1 / fps:.8f}")
    low, high = places.amin((0, 1)) - 0.1, places.amax((0, 1)) + 0.1
    x, y = (places[..., 0] - low[0]) * 200, (high[1] - places[..., 1]) * 200
    pairs, frames = list(enumerate(bones.parents))[1:], zip(x.int().tolist(), y.int().tolist(), strict=True)
    lines = ["".join(f"M{a[p]} {b[p]}L{a[j]} {b[j]}" for j, p in pairs) for a, b in frames]
    width, height, _ = ((high - low) * 200).int().tolist()
    motion = f'attributeName="d" dur="{len(x) / fps:.2f}s" repeatCount="indefinite" values="{";".join(lines)}"'
    figure = f'<path fill="none" stroke="black" stroke-width="5" d="{lines[0]}"><animate {motion}/></path>'
    page = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}">{figure}</svg>'
    out.with_suffix(".svg").write_text(page, encoding="utf-8")
    print(f"wrote {out.with_suffix('.bvh')} and {out.with_suffix('.svg')}")


def train(args: argparse.Namespace, model: nn.Module, data, losses_of, condition_of, field: str) -> tuple:
    """Train from the last checkpoint to `--steps`; OUT/log.jsonl has the losses. Returns accelerator and model."""
    accelerator = Accelerator(cpu=args.cpu)
    utils.set_seed(args.seed, device_specific=True)
    optimizer = torch.optim.AdamW(model.parameters(), lr=args.rate, weight_decay=0.02)
    model, optimizer = accelerator.prepare(model, optimizer)
    checkpoint, done = args.out / "checkpoint", 0
    if (checkpoint / "step.json").exists():
        accelerator.load_state(checkpoint)
        done = json.loads((checkpoint / "step.json").read_text())["step"]
    # The order of the data is a function of the step; ranks are those of torch.distributed.
    stream = BatchStream(data, args.batch, seed=args.seed, start_step=done, steps=max(0, args.steps - done))
    model.train()
    # With its own generator, the loader takes nothing from the one that makes the noise.
    loader = DataLoader(stream, batch_size=None, num_workers=args.workers, generator=torch.Generator())
    for step, batch in enumerate(loader, start=done + 1):
        clean = batch[field].to(accelerator.device)
        condition = tuple(value.to(accelerator.device) for value in condition_of(batch))
        level = torch.rand(len(clean), device=clean.device)
        keep = torch.rand(len(clean), device=clean.device) > 0.25
        losses = losses_of(model(noise(clean, level), level, *condition, keep), clean)
        optimizer.zero_grad()
        accelerator.backward(sum(losses.values()))
        optimizer.step()
        if accelerator.is_main_process:
            numbers = {name: round(loss.item(), 5) for name, loss in losses.items()}
            with (args.out / "log.jsonl").open("a") as log:
                log.write(json.dumps({"step": step, "loss": round(sum(numbers.values()), 5), **numbers}) + "\n")
            if step % 20 == 0 or step == args.steps:
                print(f"step {step}:", numbers, flush=True)
        if step % args.save_every == 0 or step == args.steps:
            accelerator.save_state(checkpoint)
            (checkpoint / "step.json").write_text(json.dumps({"step": step}))
    return accelerator, accelerator.unwrap_model(model)


def options(description: str | None, **defaults: object) -> argparse.ArgumentParser:
    """Return the options that both examples have."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("data/demo"), help="a built dataset")
    parser.add_argument("--out", type=Path, required=True, help="folder for checkpoint, log and dance")
    parser.add_argument("--song", type=Path, help="music to dance to; default: that of the dataset's last clip")
    numbers = {"steps": 120, "batch": 16, "width": 96, "layers": 3, "rate": 1e-3, "workers": 0, "seed": 0}
    for name, value in {**numbers, "save_every": 500, "ddim": 25, "guidance": 2.0, **defaults}.items():
        parser.add_argument("--" + name.replace("_", "-"), type=type(value), default=value, help=f"default: {value}")
    parser.add_argument("--cpu", action="store_true", help="use no GPU")
    return parser


def main() -> None:
    """Train, and generate."""
    args = options(__doc__, seconds=5.0).parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    ds = dancedata.open(args.data)
    field = next((name for name in ("edge151", "lodge139", "finedance319") if name in ds.fields), "edge151")
    both, windows = (field, "librosa35"), Windows(length_s=args.seconds, stride_s=0.5)
    data = WindowDataset(ds, fields=both, windows=windows, scale=Scale(fields=both), augment={"mirror": 0.5})
    torch.manual_seed(args.seed)
    model = Denoiser(ds.fields[field].width, 35, args.width, args.layers, data.windows[0].length)
    music = dancedata.features(args.song, "librosa35", fps=ds.fps) if args.song else ds.clips()[-1].read("librosa35")
    accelerator, model = train(args, model, data, Losses(data, field), lambda batch: (batch["librosa35"],), field)
    if accelerator.is_main_process:
        made = generate(model, data, field, torch.from_numpy(music).to(accelerator.device), args.ddim, args.guidance)
        write_dance(args.out / "dance", decode(made[: len(music)], field), float(ds.fps))


if __name__ == "__main__":
    try:
        main()
    except DanceDataError as error:
        raise SystemExit(f"error: {error}") from None
