"""A dataset with odd names and music in four formats, and a server for it."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.registry import DATASETS
from dancedata.scene.scenes import Scenes
from dancedata.store import StoredClip
from dancedata.store.schema import StoreHeader
from dancedata.store.writer import write_store
from dancedata.synthetic import write_synthetic
from dancedata.viewer.view import ViewRequest
from tests.conftest import Once
from tests.scene.helpers import FORMATS, FPS, HOSTILE, clicks, jumping, serving


@pytest.fixture(scope="session")
def source(once: Once) -> Path:
    """One clip for each format of music, and one for each hostile name."""
    return once("odd-source", _write_source)


def _write_source(folder: Path) -> None:
    (folder / "motions").mkdir()
    (folder / "music").mkdir()
    for number, name in enumerate([*FORMATS, *HOSTILE]):
        poses, trans = jumping(name)
        np.savez(folder / "motions" / f"{name}.npz", poses=poses, trans=trans, mocap_framerate=FPS)
        fmt = name if name in FORMATS else FORMATS[number % 2]
        clicks(fmt, folder / "music" / f"{name}.{fmt}")


@pytest.fixture(scope="session")
def odd(source: Path, once: Once) -> Path:
    """The dataset built from it."""
    dataset = {"folder": {"fps": FPS, "up": "y", "unit": "m"}}
    recipe = {"recipe": 1, "name": "odd", "dataset": dataset, "windows": {"length_s": 2, "stride_s": 0.5},
              "motion": {"edge151": {}}, "audio": {"librosa35": {}}}  # fmt: skip

    def build(folder: Path) -> None:
        dancedata.build(recipe, source, folder / "odd", jobs=1, cache=folder / "cache", progress=False)

    return once("odd", build) / "odd"


@pytest.fixture(scope="session")
def served(odd: Path, source: Path) -> Iterator[str]:
    """Address of the dataset with its music."""
    with serving(ViewRequest(odd, music=source)) as address:
        yield address


_BASE = {"recipe": 1, "dataset": {"aist++": {}}, "windows": {"length_s": 2, "stride_s": 0.5}}
_SOUND = {**_BASE, "audio": {"librosa35": {}}}
RECIPES: dict[str, dict[str, Any]] = {
    "thirty": {
        **_SOUND, "keymotion": {"lodge": {}}, "augment": {"mirror": True, "tempo": {"speeds": [1.25]}},
        "motion": {k: {} for k in ("edge151", "gcd151", "lodge139", "lodge319", "finedance319", "joints")},
    },
    "slices": {**_SOUND, "transforms": [{"slices": {"length_s": 2}}], "motion": {"edge151": {}}},
    "sixty": {**_SOUND, "fps": 60, "motion": {"fact219": {}, "bailando72": {}}},
    "infinite": {**_BASE, "motion": {"humanml264": {}}},
    "twenty": {**_BASE, "fps": 20, "motion": {"humanml263": {}}},
}  # fmt: skip


@pytest.fixture(scope="session")
def dances(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Five seconds of four clips to two songs."""
    return write_synthetic(tmp_path_factory.mktemp("dances") / "aist", songs=2, clips_per_song=2, clip_s=5)


@pytest.fixture(scope="session")
def scenes(dances: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Scenes]:
    """Return a function that builds one of `RECIPES`, once."""
    folder, opened = tmp_path_factory.mktemp("scenes"), {}

    def of(name: str) -> Scenes:
        if name not in opened:
            recipe = {**RECIPES[name], "name": name}
            dancedata.build(recipe, dances, folder / name, jobs=1, cache=folder / "cache", progress=False)
            opened[name] = Scenes(dancedata.open(folder / name))
        return opened[name]

    return of


@pytest.fixture(scope="session")
def crowd_source(once: Once) -> Path:
    """Groups of 2, 3, 5 and 7."""
    return once("crowd-source", lambda folder: DATASETS.get("aioz-gdance")().make_example(folder))


@pytest.fixture(scope="session")
def crowd(crowd_source: Path, once: Once) -> Path:
    """The dataset built from it, with mirrored copies."""
    recipe = {**_BASE, "name": "crowd", "dataset": {"aioz-gdance": {}}, "motion": {"edge151": {}},
              "audio": {"librosa35": {}}, "augment": {"mirror": True}}  # fmt: skip

    def build(folder: Path) -> None:
        dancedata.build(recipe, crowd_source, folder / "crowd", jobs=1, cache=folder / "cache", progress=False)

    return once("crowd", build) / "crowd"


@pytest.fixture(scope="session")
def duets(once: Once) -> Path:
    """Three duets, two of them with collisions."""
    recipe = {**_BASE, "name": "duets", "dataset": {"dd100": {}}, "motion": {"joints": {}},
              "audio": {"librosa35": {}}}  # fmt: skip

    def build(folder: Path) -> None:
        source = folder / "source"
        DATASETS.get("dd100")().make_example(source)
        dancedata.build(recipe, source, folder / "duets", jobs=1, cache=folder / "cache", progress=False)

    return once("duets", build) / "duets"


@pytest.fixture(scope="session")
def lacking(crowd: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The group of seven without its dancers 1 and 4, as `groups.incomplete: keep` stores it."""
    out = tmp_path_factory.mktemp("lacking")
    with dancedata.open(crowd) as store:
        clips = [
            StoredClip(**vars(clip.record), group_size=7, starts=(0,), motion={"edge151": clip.read("edge151")})
            for clip in store.clips()
            if clip.group == "plainid0123_04_829_1009" and clip.member not in (1, 4)
        ]
        write_store(out, StoreHeader(store.grid.rate, 60, 15, (store.field("edge151"),), store.skeleton), clips)
    return out
