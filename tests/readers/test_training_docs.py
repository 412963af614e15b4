"""The code of docs/guides/training.md runs, and resuming is exact with PyTorch, Accelerate and Lightning."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from dancedata.testing.stores import write_random_store
from dancedata.torch import EpochSampler, WindowDataset
from tests.groups_store import write_groups

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "guides" / "training.md"
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)

# Script for a process of Accelerate: the blocks up to `main`, then all steps at once, and in two parts.
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
def test_code_of_the_page_runs(store_path, beats_store, tmp_path, cache, monkeypatch, capsys):
    write_groups(tmp_path / "data" / "groups")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DANCEDATA_CACHE", str(cache))
    names: dict[str, object] = {"OUT": store_path, "BEATS": beats_store}
    assert len(BLOCKS) >= 7
    for block in BLOCKS:
        if not re.search(r"^(from accelerate|import lightning)", block, flags=re.MULTILINE):
            exec(compile(block, str(PAGE), "exec"), names)
    checkpoint = names["checkpoint"]
    assert isinstance(checkpoint, dict)
    assert checkpoint["step"] == 6
    assert torch.allclose(names["again"], names["places"], atol=1e-5)  # type: ignore[arg-type]
    assert "steps to the right, then turns" in capsys.readouterr().out


@pytest.mark.nightly  # two processes, which start slowly; test_draws.py reads with Accelerate in one
def test_accelerate_with_two_processes(store_path: Path, tmp_path: Path) -> None:
    pytest.importorskip("accelerate")
    (ours,) = [block for block in BLOCKS if "import Accelerator" in block]
    start = "import torch\nfrom torch.utils.data import DataLoader\nfrom dancedata.torch import *\n"
    start += f"train = WindowDataset({str(store_path)!r}, augment={{'mirror': 0.5}}, seed=0)\n"
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


@pytest.fixture
def lightning_page(tmp_path: Path) -> dict[str, Any]:
    """The names of the page's block for Lightning, for 24 windows of train and 4 of val: 2 steps of 16 an epoch."""
    pytest.importorskip("lightning")
    made = write_random_store(tmp_path / "s", clips={"train": 2, "val": 1}, n_frames=(200, 200), length=35, stride=15)
    (ours,) = [block for block in BLOCKS if "import lightning" in block]
    train = WindowDataset(made.path, augment={"mirror": 0.5}, seed=0)
    assert len(train) == 24
    names: dict[str, Any] = {"torch": torch, "train": train, "OUT": made.path, "seen": [], "validated": []}
    exec("from torch.utils.data import DataLoader\nfrom dancedata.torch import *\n", names)
    exec(compile(ours, str(PAGE), "exec"), names)
    page = names["Dance"]

    class Watched(page):  # type: ignore[misc, valid-type]
        def training_step(self, batch: dict[str, Any], number: int) -> torch.Tensor:
            names["seen"].append(batch["id"])
            return super().training_step(batch, number)

        def validation_step(self, batch: dict[str, Any], number: int) -> None:
            names["validated"].append((len(names["seen"]), batch["id"]))
            super().validation_step(batch, number)

    names["Dance"] = Watched
    return names


@pytest.mark.filterwarnings("ignore")
def test_lightning_validates_after_each_epoch(lightning_page: dict[str, Any]) -> None:
    names = lightning_page
    trainer, _ = names["fit"](6)
    assert [len({*names["seen"][k], *names["seen"][k + 1]}) for k in (0, 2, 4)] == [24, 24, 24]
    val = [f"{w.clip}@{w.start}+{w.length}" for w in WindowDataset(names["OUT"], split="val").windows]
    sanity, *rest = names["validated"]
    assert sanity == (0, val)
    assert rest == [(2, val), (4, val), (6, val)]
    assert trainer.callback_metrics["val_loss"] > 0


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("stop", [1, 2, 3])
def test_lightning_resumes(lightning_page: dict[str, Any], tmp_path: Path, stop: int) -> None:
    """In the middle of an epoch and at its end: the same samples, with the same draws; each epoch is validated."""
    names = lightning_page
    names["fit"](6)
    whole = list(names["seen"])
    trainer, _ = names["fit"](stop)
    trainer.save_checkpoint(tmp_path / "some.ckpt")
    names["seen"].clear()
    names["validated"].clear()
    names["fit"](6, tmp_path / "some.ckpt")
    assert names["seen"] == whole[stop:]
    assert [n + stop for n, _ in names["validated"] if n] == [step for step in (2, 4, 6) if step > stop]
