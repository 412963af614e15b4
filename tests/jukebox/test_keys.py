"""Sizes of the networks; at real size, without memory, the names requested are the names in the files."""

import csv
import json
import math
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("torch")
pytest.importorskip("accelerate")

import torch

from dancedata.audio.jukebox import JukeboxConfig
from dancedata.audio.jukebox.network import memory, tensors
from dancedata.audio.jukebox.weights.folder import PRIOR_FILE, VQVAE_FILE
from dancedata.audio.jukebox.weights.loading import Checkpoint, load_encoder, load_prior
from dancedata.core.errors import UsageError
from tests.messages import raises_message

REAL = JukeboxConfig()


class MetaSource:
    """Tensors of the meta device; records the requested names."""

    path = Path("meta")

    def __init__(self, tensors: Mapping[str, tuple[tuple[int, ...], torch.dtype]]) -> None:
        self.tensors = {k: torch.empty(s, dtype=dtype, device="meta") for k, (s, dtype) in tensors.items()}
        self.asked: list[str] = []

    def read(self, name: str, rows: int) -> torch.Tensor:
        self.asked.append(name)
        assert 1 <= rows <= len(self.tensors[name])
        return self.tensors[name][:rows]


@pytest.fixture(scope="module")
def rows(jukebox_golden: Path) -> list[dict[str, str]]:
    with (jukebox_golden / "keys.csv").open() as file:
        return list(csv.DictReader(file))


def _shape(row: dict[str, str]) -> tuple[int, ...]:
    return tuple(int(n) for n in row["shape"].split("x"))


def test_specs_are_the_keys_of_the_files(rows: list[dict[str, str]]) -> None:
    for file, specs in ((VQVAE_FILE, tensors.vqvae_tensors(REAL)), (PRIOR_FILE, tensors.prior_tensors(REAL, 66))):
        needed = {
            row["openai_key"]: (_shape(row), row["dtype_in_file"])
            for row in rows
            if row["file"] == file and row["needed_for_layer_66"] == "1"
        }
        assert {spec.name: (spec.shape, spec.dtype) for spec in specs} == needed
    assert len(tensors.prior_tensors(REAL, 66)) == 799
    in_file = {row["openai_key"] for row in rows if row["file"] == PRIOR_FILE}
    assert tensors.all_prior_names(REAL) == in_file


@pytest.mark.parametrize("precision", [torch.float16, torch.float32])
def test_loading_asks_for_the_needed_keys_once(rows: list[dict[str, str]], precision: torch.dtype) -> None:
    def source(file: str) -> MetaSource:
        own = [row for row in rows if row["file"] == file]
        return MetaSource({row["openai_key"]: (_shape(row), getattr(torch, row["dtype_in_file"])) for row in own})

    checkpoint = Checkpoint(source(VQVAE_FILE), source(PRIOR_FILE))
    device = torch.device("meta")
    placement = memory.place(REAL, 66, precision, 1722, None)
    load_encoder(checkpoint, REAL, device)
    prior = load_prior(checkpoint, REAL, placement, max_codes=1722, precision=precision, device=device)
    needed = sorted(row["openai_key"] for row in rows if row["needed_for_layer_66"] == "1")
    assert sorted([*checkpoint.vqvae.asked, *checkpoint.prior.asked]) == needed
    kept = sum(p.numel() * p.element_size() for block in prior.stream.blocks for p in block.parameters())
    assert kept == 66 * memory.block_bytes(REAL, precision)
    # JUKEBOX.md, section 8: 66 blocks as stored, and with biases in two bytes (norms stay fp32).
    assert kept == (9_133_660_800 if precision == torch.float32 else 66 * (138_314_400 + 4 * 4800 * 2))


def test_bytes_as_stored() -> None:
    specs = tensors.prior_tensors(REAL, 66)
    assert sum(math.prod(s.shape) * (2 if s.dtype == "float16" else 4) for s in specs) == 9_418_876_800
    assert [s.rows for s in tensors.table_tensors(REAL, 1722)] == [1, 1, 128, 2, 11, 2048, 1722]
    assert [s.rows for s in tensors.table_tensors(REAL, 8192)] == [1, 1, 128, 6, 50, 2048, 8192]


def test_default_is_the_real_model() -> None:
    config = JukeboxConfig()
    assert (config.hop, config.row_length) == (128, 64)
    assert config.total_length == 2_734_080
    assert float(config.code_rate) == 344.53125
    # No tensor's shape shows these.
    assert (config.heads, config.downs, config.dilation_growth) == (8, (3, 2, 2), 3)
    assert (config.min_duration_s, config.max_duration_s, config.sample_rate) == (60, 600, 44_100)


def test_round_trips() -> None:
    config = JukeboxConfig(width=40, attn_width=10, heads=2, depth=6, mlp_width=37)
    assert JukeboxConfig.from_json(json.loads(json.dumps(config.to_json()))) == config
    with raises_message(UsageError, "time_bins"):
        JukeboxConfig.from_json({**config.to_json(), "widht": 1})


@pytest.mark.parametrize(
    "sizes", [{"heads": 7}, {"depth": 0}, {"downs": [3, 0, 2]}, {"n_rows": 100}, {"min_duration_s": 100.0}]
)
def test_impossible_sizes_are_refused(sizes: dict[str, Any]) -> None:
    with raises_message(UsageError, "JukeboxConfig"):
        JukeboxConfig.from_json({**JukeboxConfig().to_json(), **sizes})


def test_import_is_light() -> None:
    code = (
        "import sys, dancedata.audio.jukebox as j; j.JukeboxConfig; "
        "assert not {'torch', 'accelerate', 'librosa'} & set(sys.modules); "
        "assert 'JukeboxEncoder' in dir(j); j.fetch; assert not hasattr(j, 'nothing')"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)
