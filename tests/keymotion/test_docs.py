"""The code on key motions of docs/reference/columns.md runs, on a store built for it."""

import re
from pathlib import Path

import numpy as np

from dancedata.building.build import build
from dancedata.recipes.parse import parse_recipe

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "columns.md"


def test_code_of_the_page_runs(tmp_path: Path) -> None:
    recipe = {
        "recipe": 1, "name": "page", "windows": {"length_frames": 1024, "stride_frames": 102}, "fps": 30,
        "dataset": {"synthetic": {"songs": 2, "clips_per_song": 2, "clip_s": 36, "split": "all"}},
        "motion": {"lodge139": {}}, "audio": {"librosa35": {}}, "keymotion": {"lodge": {}},
    }  # fmt: skip
    build(parse_recipe(recipe), tmp_path / "source", tmp_path / "out", jobs=1, cache=tmp_path / "cache")
    text = PAGE.read_text(encoding="utf-8").replace('windows("train"', 'windows("all"')
    blocks = re.findall(r"```python\n(.*?)```", text.split("## Key motions")[1], flags=re.DOTALL)
    assert len(blocks) >= 2
    names: dict[str, object] = {"OUT": tmp_path / "out"}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    cues, window = names["cues"], names["motion"]
    assert cues.frames.shape == (13, 8, 139)
    assert np.shares_memory(cues.frames, window) is False
    assert not cues.filled.all()
    assert (names["relative"][1:, 0][:, [4, 6]] == 0).all()
