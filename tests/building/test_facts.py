"""The key `segments` of recipes: facts, genres, a lexicon; in builds, with copies, from the cache."""

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import dancedata
from dancedata.core.clip import ClipRef, Scan, member_id
from dancedata.core.errors import RecipeError
from dancedata.core.grid import FrameGrid
from dancedata.core.hashing import recipe_hash
from dancedata.core.motion import Motion
from dancedata.core.segments import Layer, Segment
from dancedata.core.skeleton import SMPL24
from dancedata.recipes.parse import parse_recipe
from dancedata.store import Store, verify_store
from tests.building.conftest import OwnReader
from tests.messages import raises_message
from tests.metrics.test_events import Dance

WORDS = Layer("description", language="de")


@dataclass(frozen=True)
class Planted(OwnReader):
    """A dancer who turns, jumps and walks; and a group of two who stand, one of whom jumps."""

    name: ClassVar[str] = "planted"

    def scan(self, source: Path) -> Scan:
        words = (Segment(WORDS, Fraction(0), Fraction(1), texts=("dreht sich nach links",)),)
        path = source / "any.txt"
        single = ClipRef("single", path, None, "train", genre="house", segments=words)
        pair = [
            ClipRef(member_id("pair", k), path, None, "train", group="pair", member=k, declared=(("k", str(k)),))
            for k in range(2)
        ]
        return Scan("planted", (*pair, single))

    def load(self, ref: ClipRef) -> Motion:
        dance = Dance(60, 7).wait()
        if ref.id == "single":
            dance.turn(360, 1.2).jump(0.4).walk(2, 0, 2, "")
        elif ref.member == 1:
            dance.wait(1.5).jump(0.5)
        else:
            dance.wait(3)
        n = 400 if ref.id == "single" else 200
        beside = np.array([1.5 * (ref.member == 1), 0, 0])
        root = np.array(dance.root)[:n] + beside - SMPL24.offsets[0]
        rotations = np.zeros((n, 24, 3))
        rotations[:, 0, 1] = dance.yaw[:n]
        return Motion(root, rotations, FrameGrid.of(60), SMPL24)

    def make_example(self, folder: Path) -> None:
        folder.mkdir(exist_ok=True)
        (folder / "any.txt").write_text("x")


def document(**keys: Any) -> dict[str, Any]:
    return {
        "recipe": 1, "name": "facts", "dataset": {"planted": {}}, "fps": 30,
        "windows": {"length_s": 2, "stride_s": 1}, "motion": {"joints": {}}, "audio": {},
    } | keys  # fmt: skip


def build(tmp_path: Path, cache: Path, out: str = "out", **keys: Any) -> Store:
    Planted().make_example(tmp_path)
    return dancedata.build(document(**keys), tmp_path, tmp_path / out, jobs=1, cache=cache, progress=False).open()


def labels(store: Store, clip: str) -> list[str]:
    return [s.label for s in store.segments(clip, "facts") if s.label not in ("still", "high energy")]


def test_facts_are_a_layer_of_clips_and_copies(tmp_path: Path, cache: Path) -> None:
    augment = {"mirror": True, "tempo": {"speeds": [1.25]}, "yaw": {}}
    store = build(tmp_path, cache, annotators={"facts": True}, augment=augment)
    assert verify_store(tmp_path / "out") == []
    assert labels(store, "single") == ["turn left", "jump", "travel forward"]
    assert labels(store, "single__mirror") == ["turn right", "jump", "travel forward"]
    assert labels(store, "single__yaw") == labels(store, "single")
    turn, mirrored = (store.segments(clip, "facts") for clip in ("single", "single__mirror"))
    (left,) = (s for s in turn if s.label == "turn left")
    (right,) = (s for s in mirrored if s.label == "turn right")
    assert left.value == pytest.approx(360, abs=8)
    assert (right.value, right.start) == (left.value, left.start)
    assert right.texts == (left.texts[0].replace("left", "right"),)
    # Computed from the copy's own motion: at 5/4 of the speed a fall of 9.81 is one of 15.3 m/s2, for less time.
    jump, faster = (
        next(s for s in store.segments(clip, "facts") if s.label == "jump") for clip in ("single", "single__tempo")
    )
    assert faster.value == pytest.approx(0.32, abs=0.05)
    assert faster.start == pytest.approx(float(jump.start) / 1.25, abs=0.05)
    assert (labels(store, "pair_p0"), labels(store, "pair_p1")) == ([], ["jump"])
    layer = next(layer for layer in store.layers if layer.name == "facts")
    assert dict(layer.units)["jump"] == "s"
    assert layer.by.startswith("facts 1 {")


def test_genres_and_a_lexicon(tmp_path: Path, cache: Path) -> None:
    lexicon = tmp_path / "german.yaml"
    lexicon.write_text("language: de\npairs: [[links, rechts], [linke, rechte]]\nsame:\n")
    annotators = {"genre": True, "captions": {"lexicon": str(lexicon)}}
    store = build(tmp_path, cache, annotators=annotators, augment={"mirror": True})
    (genre,) = store.segments("single", "genre")
    assert (genre.label, genre.end) == ("house", store.grid.seconds(store["single"].n_frames))
    assert store.segments("pair_p0") == []
    assert store.segments("single__mirror", "description")[0].texts == ("dreht sich nach rechts",)
    assert store.info["recipe"]["annotators"]["captions"]["lexicon"]["pairs"] == [
        ["links", "rechts"],
        ["linke", "rechte"],
    ]
    assert str(tmp_path) not in str(store.info["recipe"])
    again = parse_recipe(store.info["recipe"])
    assert again.sha256 == recipe_hash(store.info["recipe"])


@pytest.mark.parametrize("value", [
    True, {"fact": True}, {"facts": 3}, {"facts": {"turns": 90}}, {"facts": {"turn_degrees": -1}}, {"faults": True},
    {"facts": {"kinds": ["turns", "spins"]}}, {"genre": "yes"}, {"captions": {"lexicon": "nowhere.yaml"}},
    {"captions": {"lexicon": {"language": "de", "pairs": [["links", "rechts"]], "whole_words": "no"}}},
    {"captions": {"lexicon": {"language": "de"}}}, {"captions": {"lexicon": {"language": "de", "pairs": [["a"]]}}},
])  # fmt: skip
def test_wrong_values_are_named(value: Any) -> None:
    with raises_message(RecipeError, "problem", where="recipe"):
        parse_recipe(document(annotators=value))
