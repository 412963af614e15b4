"""The page on audio features: its recipe gives both rates."""

import re
from pathlib import Path

import yaml

from dancedata.core.registry import FEATURES
from dancedata.recipes.parse import load_recipe, parse_recipe

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "audio-features.md").read_text(encoding="utf-8")


def test_its_recipe_has_both_rates() -> None:
    block, *_ = re.findall(r"^```yaml\n(.*?)^```", TEXT, flags=re.DOTALL | re.MULTILINE)
    recipe = parse_recipe(yaml.safe_load(block))
    rates = {field.name: int(field.grid.rate) for field in (*recipe.motion, *recipe.audio)}
    assert rates == {"edge151": 30, "fact219": 60, "librosa35": 30, "librosa35.60": 60, "bailando438": 60}


def test_everything_in_the_60_recipe_has_60_rows() -> None:
    recipe = load_recipe("aist++-60")
    fields = (*recipe.motion, *recipe.audio)
    assert sorted(f.name for f in fields) == ["bailando438", "bailando72", "fact219", "joints", "librosa35"]
    assert {int(field.grid.rate) for field in fields} == {60}


def test_every_feature_is_on_the_page() -> None:
    assert all(f"| `{name}` | " in TEXT for name in FEATURES.names())
