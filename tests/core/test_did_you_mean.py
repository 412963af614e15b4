"""The name that was meant: misspelt, in capitals, or a part of the whole."""

import pytest

from dancedata.core.errors import closest, did_you_mean

RECIPES = ("aist++-60", "aist++-edge-exact", "aist++-lodge", "aist++", "demo", "finedance")
KEYS = ("store", "windows", "windows.stride_s", "store.shard_mb", "audio.librosa35.tightness")


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("edge", "aist++-edge-exact"), ("EDGE", "aist++-edge-exact"), ("edge-exact", "aist++-edge-exact"),
        ("AIST++", "aist++"), ("Aist", "aist++"), ("aistpp", "aist++"), ("lodge", "aist++-lodge"),
        ("finedanc", "finedance"), ("dmo", "demo"), ("zzz", None), ("", None), ("++", None),
    ],
)  # fmt: skip
def test_recipes(name: str, meant: str | None) -> None:
    assert closest(name, RECIPES) == meant


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("stride_s", "windows.stride_s"),
        ("shard", "store.shard_mb"),
        ("tightness", "audio.librosa35.tightness"),
        ("window", "windows"),
    ],
)
def test_keys_by_their_last_part(name: str, meant: str) -> None:
    assert closest(name, KEYS) == meant


def test_a_long_list_is_cut() -> None:
    message = did_you_mean("zzz", [f"clip{number}" for number in range(100_000)])
    assert message.endswith("clip59 and 99,940 more")
