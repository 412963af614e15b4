"""Parameters that no reader takes: the error names the reader, the parameter, what was found and what is allowed."""

from typing import Any

import pytest

from dancedata.core.errors import UsageError
from dancedata.core.registry import DATASETS
from tests.messages import raises_message

WRONG: dict[str, dict[str, tuple[Any, ...]]] = {
    "aioz-gdance": {"split": ("by-song",), "music": ("none",)},
    "aist++": {"split": ("../mine", ""), "ignore": ("maybe",), "music": ("no",)},
    "dcm": {"split": ("by-song",), "music": ("no",)},
    "dd100": {"up": ("x",)},
    "finedance": {"split": ("crossgenre",), "labels": ("no",), "keep": (("001",), (120,), "120")},
    "i-dancers": {"up": ("x",), "music": ("no",), "fps": ("fast",), "trim_frames": (-1, 1.5)},
    "infinitedance": {"motion": ("tokens",), "split": ("by-video",), "clips": ("others",), "up": ("x",)},
    "motorica": {
        "split": ("official_clean",), "trim_s": (-1,), "fingers": ("no",), "music": ("none",), "takes": ("two",),
    },
    "phantomdance": {"split": ("official",), "music": ("no",)},
    "popdanceset": {"split": ("video",), "scale": ("divide",), "music": ("no",)},
}  # fmt: skip
CASES = [(name, key, value) for name, keys in WRONG.items() for key, values in keys.items() for value in values]


@pytest.mark.parametrize(("name", "key", "value"), CASES)
def test_wrong_parameters(name: str, key: str, value: Any) -> None:
    found = value[0] if isinstance(value, tuple) else value[0] if key == "keep" else value
    said = "rate" if key == "fps" else rf"^{name.replace('+', '[+]')}: .*\b{key}\b"
    with raises_message(UsageError, f"{said}.*; found '?{found}'?.*(allowed|known):"):
        DATASETS.get(name)(**{key: value})
