"""The recipe of docs/augmentation.md builds, and the page's code runs on what it gives."""

import re
from pathlib import Path

import pytest

from dancedata.building.build import build
from dancedata.recipes.parse import load_recipe

pytest.importorskip("torch")

PAGE = Path(__file__).parents[2] / "docs" / "augmentation.md"


@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
def test_code_of_the_page_runs(source: Path, cache: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = PAGE.read_text(encoding="utf-8")
    (recipe,) = re.findall(r"```yaml\n(.*?)```", text, flags=re.DOTALL)
    (tmp_path / "recipe.yaml").write_text(recipe)
    build(load_recipe(str(tmp_path / "recipe.yaml")), source, tmp_path / "out", cache=cache)
    names: dict[str, object] = {"OUT": tmp_path / "out"}
    for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        exec(compile(block, str(PAGE), "exec"), names)
    printed = capsys.readouterr().out
    for word in ("__mirror", "__yaw", "__tempo", "x\n", "do not determine the angles", "does not change samples"):
        assert word in printed
