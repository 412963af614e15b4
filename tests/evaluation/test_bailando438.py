"""Protocols whose beats are those of bailando438: from a dataset with that column, and from the music itself."""

from collections.abc import Mapping

import numpy as np
import pytest

import dancedata
from dancedata.audio.bailando438 import Bailando438
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.metrics import MusicBeats
from dancedata.recipes.parse import load_recipe
from dancedata.store import Store
from tests.features import bailando438_rows

PROTOCOLS = ("bailando-aistpp", "motius-aistpp", "dancedata")
#: Beats: MFCC 20, their derivative 20, chroma 12 and the onset envelope stand before them.
COLUMN = 53


@pytest.fixture(scope="module")
def sixty(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """A dataset with the columns of the recipe aist++-60 that these protocols need."""
    folder = tmp_path_factory.mktemp("sixty")
    recipe = dict(load_recipe("aist++-60").document)
    recipe["dataset"] = {"synthetic": {"songs": 2, "clips_per_song": 2, "clip_s": 6}}
    recipe["audio"] = {"bailando438": recipe["audio"]["bailando438"]}
    recipe["motion"] = {"joints": {}}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Bailando438, "extract", bailando438_rows)
        dancedata.build(recipe, out=folder / "sixty", jobs=1, cache=folder / "cache", progress=False)
    return dancedata.open(folder / "sixty")


def bas(what: object, protocol: str, **options: object) -> float:
    options |= {"split": "all"} if isinstance(what, Store) else {}
    report = dancedata.evaluate(what, protocol=protocol, metrics=["bas"], intervals=False, **options)  # type: ignore[arg-type]
    value = report["bas"].value
    assert value is not None
    return value


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_the_column_of_a_dataset(sixty: Store, protocol: str) -> None:
    found = bas(sixty, protocol)
    beats = {
        clip.id: MusicBeats.of_rows(clip.read("bailando438"), sixty.fields["bailando438"], FrameGrid.of(60), late=1)
        for clip in sixty.clips()
    }
    assert all(own.frames.tolist() == np.flatnonzero(sixty[c].read("bailando438")[:, COLUMN]).tolist()
               for c, own in beats.items())  # fmt: skip
    assert all(len(own.frames) for own in beats.values())
    assert found == bas(sixty, protocol, music=beats)
    late = {clip: MusicBeats.of(own.frames + 7, own.grid) for clip, own in beats.items()}
    assert found != bas(sixty, protocol, music=late)


def test_a_dataset_without_it_has_no_beats_for_the_protocol(sixty: Store, motions: Mapping[str, Motion]) -> None:
    clips = {name: motion.resampled(FrameGrid.of(60)) for name, motion in motions.items()}
    report = dancedata.evaluate(clips, protocol="bailando-aistpp", pool=sixty, intervals=False)
    assert report["bas"].value is None
    assert any("the protocol takes those of bailando438 at 60 per second" in w for w in report.warnings)
