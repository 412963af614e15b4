"""The code of docs/training.md runs, and what the page says of resuming holds: PyTorch, Accelerate, Lightning."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("torch")

import torch

from dancedata.readers import EpochSampler, WindowDataset

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "training.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)

# What a process of Accelerate runs: the blocks up to `main`, then all steps at once, and in two parts.
RANKS = """
import json, sys
from pathlib import Path

from accelerate.launchers import debug_launcher

def run(folder):
    torch.manual_seed(0)
    whole = main(8, folder / "whole")
    torch.manual_seed(0)
    parts = main(5, folder / "parts") + main(8, folder / "parts")
    weights = [accelerator_weights(folder / name) for name in ("whole", "parts")]
    # Not to the bit: torch's threads may add in another order. A lost state of the optimiser differs by far more.
    same = all(torch.allclose(weights[0][name], weights[1][name], 1e-4, 1e-6) for name in weights[0])
    if torch.distributed.get_rank() == 0:
        (folder / "seen.json").write_text(json.dumps({"whole": whole, "parts": parts, "same": same}))

def accelerator_weights(folder):
    from safetensors.torch import load_file
    return load_file(folder / "model.safetensors")

debug_launcher(run, (Path(sys.argv[1]),), num_processes=2)
"""


@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:This DataLoader will create:UserWarning")
def test_code_of_the_page_runs(store_path: Path) -> None:
    names: dict[str, object] = {"OUT": store_path}
    assert len(BLOCKS) >= 7
    for block in BLOCKS:
        if not re.search(r"^(from accelerate|import lightning)", block, flags=re.MULTILINE):
            exec(compile(block, str(PAGE), "exec"), names)
    checkpoint = names["checkpoint"]
    assert isinstance(checkpoint, dict)
    assert checkpoint["step"] == 6
    assert torch.allclose(names["again"], names["places"], atol=1e-5)  # type: ignore[arg-type]


def test_accelerate_with_two_processes(store_path: Path, tmp_path: Path) -> None:
    pytest.importorskip("accelerate")
    (ours,) = [block for block in BLOCKS if "import Accelerator" in block]
    start = "import torch\nfrom torch.utils.data import DataLoader\nfrom dancedata.readers import *\n"
    start += f"train = WindowDataset({str(store_path)!r}, mirror=0.5, seed=0)\n"
    script = tmp_path / "script.py"
    script.write_text(start + ours + RANKS)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run(
        [sys.executable, str(script), str(tmp_path)], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    seen = json.loads((tmp_path / "seen.json").read_text())
    order = EpochSampler(len(WindowDataset(store_path)), seed=0).order(0).tolist()
    wanted = [sorted(order[16 * step : 16 * step + 16]) for step in range(8)]  # 8 a rank: as one rank with 16
    assert seen == {"whole": wanted, "parts": wanted, "same": True}


@pytest.mark.filterwarnings("ignore")
def test_lightning_resumes(store_path: Path, tmp_path: Path) -> None:
    pytest.importorskip("lightning")
    (ours,) = [block for block in BLOCKS if "import lightning" in block]
    names: dict[str, object] = {"torch": torch, "train": WindowDataset(store_path, seed=0)}
    exec("from torch.utils.data import DataLoader\nfrom dancedata.readers import BatchStream\n", names)
    exec(compile(ours, str(PAGE), "exec"), names)
    names["trainer"].save_checkpoint(tmp_path / "four.ckpt")  # type: ignore[attr-defined]
    indices: list[list[int]] = []

    def training_step(self: torch.nn.Module, batch: dict, number: int) -> torch.Tensor:
        indices.append(batch["index"].tolist())
        return torch.nn.functional.mse_loss(self.model(batch["librosa35"]), batch["edge151"])

    names["Dance"].training_step = training_step  # type: ignore[attr-defined]
    names["fit"](7, tmp_path / "four.ckpt")  # type: ignore[operator]
    order = EpochSampler(len(WindowDataset(store_path)), seed=0).order(0).tolist()
    assert indices == [order[16 * step : 16 * step + 16] for step in range(4, 7)]
