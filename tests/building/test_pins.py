"""Guards against accidental changes: hashes of recipes, keys of the cache, bytes of the demo.

Users have caches and datasets that were made with them. A change on purpose raises a version, is listed in
CHANGELOG.md, and is written down here by ``python -m tests.building.test_pins``, for the kind of machine that it runs
on; ``... compare FOLDER`` compares the demo in a folder.
"""

import json
import os
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from dancedata.building import plugins
from dancedata.building import signals as audio_units
from dancedata.building.fields import music as music_fields
from dancedata.building.fields.music import MusicField
from dancedata.building.signals import SignalId
from dancedata.core.clip import ClipRef
from dancedata.execution import arithmetic
from dancedata.files.regular_file import sha256_file
from dancedata.recipes.parse import load_recipe, recipe_names
from tests import takes
from tests.takes import take_of

PINS = Path(__file__).with_name("pins.json")
DEMO = "demo"
#: Packages whose versions change the bytes of the demo.
PACKAGES = ("numpy", "scipy", "soxr", "h5py", "soundfile", "librosa")
CLIP = ClipRef(
    id="gBR_sBM_cAll_d04_mBR0_ch01", motion_path=Path("motions/gBR_sBM_cAll_d04_mBR0_ch01.pkl"),
    audio_path=Path("wavs/mBR0.wav"), split="train", music="mBR0", tempo_bpm=80.0, genre="break", dancer="d04",
)  # fmt: skip
SONG = SignalId(Path("wavs/mBR0.wav"), "file", "a" * 64, 48_000, 10**6)


def keys_of(name: str) -> dict[str, Any]:
    """Return the hash of a recipe and the keys of its units, for one clip and song, with versions left out."""
    recipe = load_recipe(name)
    with ExitStack() as stack:
        for module in (audio_units, plugins, music_fields):
            for what in ("package_version", "expected"):
                stack.enter_context(mock.patch.object(module, what, return_value="1"))
        of_motion = replace(recipe, fields=tuple(field for field in recipe.fields if field not in recipe.audio))
        take = take_of(of_motion, [(CLIP, "c" * 64)], {"body_model/SMPL.npz": "b" * 64})
        music = [field for field in recipe.audio if isinstance(field, MusicField)]
        return {
            "recipe": recipe.sha256, "motion": takes.keys_of(of_motion, take),
            "tracks": {field.name: field.song_key(80.0, SONG.sha256) for field in music},
            "windows": {field.name: field.slice_key(80.0, SONG, 3) for field in music if field.windows},
        }  # fmt: skip


def demo_shards(folder: Path) -> dict[str, str]:
    """Return the hashes of the demo's shards, built by the command line from nothing."""
    command = [
        sys.executable, "-m", "dancedata", "build", "demo", "--jobs", "1", "--quiet", "--out", str(folder / "demo"),
    ]  # fmt: skip
    environment = {**os.environ, "DANCEDATA_CACHE": str(folder / "cache")}
    subprocess.run(command, check=True, capture_output=True, env=environment)
    return shards_in(folder / "demo")


def shards_in(folder: Path) -> dict[str, str]:
    """Return the hashes of a dataset's HDF5 files."""
    return {path.name: sha256_file(path) for path in sorted(folder.glob("*.h5"))}


def pins() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(PINS.read_text(encoding="utf-8"))
    return found


def test_every_shipped_recipe_is_pinned() -> None:
    assert sorted(pins()["recipes"]) == sorted(recipe_names())


@pytest.mark.parametrize("name", recipe_names())
def test_hash_and_keys_of_a_recipe(name: str) -> None:
    assert keys_of(name) == pins()["recipes"][name]


def test_bytes_of_the_demo(tmp_path: Path) -> None:
    pinned = pins()[DEMO]
    here = {name: version(name) for name in PACKAGES}
    if here != pinned["packages"] or not arithmetic.has_reference():
        pytest.skip(f"the demo's bytes are pinned for {pinned['packages']}, Linux, x86-64 with AVX2, not for {here}")
    assert demo_shards(tmp_path) == pinned["shards"]


def write() -> None:
    """Pin what there is now."""
    with tempfile.TemporaryDirectory() as folder:
        demo = {"packages": {name: version(name) for name in PACKAGES}, "shards": demo_shards(Path(folder))}
    found = {**pins(), "recipes": {name: keys_of(name) for name in recipe_names()}, DEMO: demo}
    PINS.write_text(json.dumps(found, indent=1, sort_keys=True) + "\n", encoding="utf-8")


if __name__ == "__main__":
    if sys.argv[1:2] == ["compare"]:
        same = shards_in(Path(sys.argv[2])) == pins()[DEMO]["shards"]
        print(f"{DEMO}: {'the bytes that are pinned' if same else 'other bytes than those that are pinned'}")
        raise SystemExit(not same)
    write()
