"""Checks of dataset readers, by their example: it is scanned, loaded and built."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.bodies import has_body
from dancedata.core.clip import Scan, check_name
from dancedata.core.errors import SourceError
from dancedata.core.motion import Motion
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.testing.plugin_checks import check_plugin, raises, require

#: Transforms of slices as long as the windows of `recipe_with`.
SLICES = [{"slices": {"length_s": 1}}]


def check_dataset(cls: type[Any], folder: Path) -> None:
    """Check a dataset reader in an empty folder: its example scans, loads and builds; bad folders are named."""
    check_plugin(cls)
    require(bool(cls.licence and cls.citation), "licence and citation say something")
    reader, sources = cls(), [folder / "an example", folder / "again"]
    for source in sources:
        reader.make_example(source)
    scan, other = (reader.scan(source) for source in sources)
    _check_scan(scan, has_audio=cls.has_audio)
    require(reader.scan(sources[0]) == scan, "two scans of a folder are equal")
    require([c.id for c in other.clips] == [c.id for c in scan.clips], "two examples hold the same clips")
    for ref, same in zip(scan.clips, other.clips, strict=True):
        motion, again = reader.load(ref), reader.load(same)
        _check_motion(motion, ref.id)
        for name in ("translation", "rotations"):
            equal = np.array_equal(getattr(motion, name), getattr(again, name))
            require(equal, f"clip {ref.id}: two loads give equal {name}")
    _check_bad_sources(reader, folder)
    skeleton = reader.load(scan.clips[0]).skeleton
    _check_build(recipe_with(dataset=cls.name, skeleton=skeleton), scan, sources[0], folder / "whole")
    on_body = {} if has_body(skeleton) else {"transforms": [{"retarget": {"skeleton": "smpl24"}}]}
    recipe = recipe_with(dataset=cls.name, keys={"motion": {"edge151": {}}, **on_body})
    _check_build(recipe, scan, sources[0], folder / "edge151")
    if not any(ref.group for ref in scan.clips):  # groups are stored whole
        recipe = recipe_with(dataset=cls.name, skeleton=skeleton, keys={"transforms": SLICES})
        _check_build(recipe, scan, sources[0], folder / "slices")


def recipe_with(*, dataset: str, skeleton: Skeleton = SMPL24, keys: Mapping[str, Any] | None = None) -> Any:
    """Return a recipe of one dataset, joint positions of its skeleton, no audio; `keys` replace or add keys."""
    from dancedata.recipes.parse import parse_recipe

    document = {
        "recipe": 1,
        "name": "conformance",
        "dataset": {dataset: {}},
        "windows": {"length_frames": 30, "stride_frames": 15},
        "motion": {"joints": {"body": skeleton.to_json()}},
        **(keys or {}),
    }
    recipe = parse_recipe(document)
    again = parse_recipe(json.loads(json.dumps(recipe.document)))
    require(again.sha256 == recipe.sha256, "a recipe with its defaults spelled out is the same recipe")
    return recipe


def _check_scan(scan: Scan, *, has_audio: bool) -> None:
    from dancedata.music.signal import load_audio

    ids = [c.id for c in scan.clips]
    require(len(ids) >= 2, "the example has two clips or more")
    require(ids == sorted(set(ids)), "clips have unique ids and are sorted by them")
    for ref in scan.clips:
        check_name(ref.split, "split")
        require(ref.motion_path.is_file(), f"clip {ref.id}: the motion file exists")
        exists = ref.audio_path is not None and ref.audio_path.is_file()
        require(
            exists if has_audio else ref.audio_path is None, f"clip {ref.id}: the music exists, as `has_audio` says"
        )
    for path in {c.audio_path for c in scan.clips if c.audio_path is not None}:
        require(load_audio(path).n_samples > 0, f"{path}: the music can be decoded")


def _check_motion(motion: Motion, clip: str) -> None:
    for array in (motion.translation, motion.rotations):
        require(array.dtype == np.float64 and not array.flags.writeable, f"clip {clip}: float64 and read-only")
    require(motion.n_frames * motion.grid.seconds(1) >= 2, f"clip {clip}: two seconds or more")
    # Metres and +Y up: a dancer's head is above the feet most of the time, and within arm's reach of 1.5 m.
    joints = motion.joints()
    height = np.median(joints[..., 1].max(axis=1) - joints[..., 1].min(axis=1))
    require(0.5 < height < 3.0, f"clip {clip}: metres, +Y up; the dancer is {height:.3g} m high")


def _check_bad_sources(reader: Any, folder: Path) -> None:
    file, empty, missing = folder / "a file", folder / "empty", folder / "missing"
    file.write_bytes(b"")
    empty.mkdir()
    # A dataset that makes its own source fills what is empty.
    for bad in (file,) if getattr(reader, "generates", False) else (file, empty, missing):
        text = raises(SourceError, lambda bad=bad: reader.scan(bad), f"{bad.name}: a SourceError")  # type: ignore[misc]
        require(str(bad) in text, f"the error names the source: {text}")


def _check_build(recipe: Any, scan: Scan, source: Path, out: Path) -> None:
    from dancedata.building.build import build
    from dancedata.store import open_store, verify_store

    build(recipe, source, out, cache=out.parent / "cache")
    errors = [str(p) for p in verify_store(out) if p.severity == "error"]
    require(not errors, f"the example's dataset is sound: {errors}")
    field = recipe.motion[0]
    with open_store(out) as store:
        built = {clip.original for clip in store}
        require(built == {ref.id for ref in scan.clips}, "every clip of the example is built")
        for split in store.splits:
            rows = store.read(store.windows(split)[0], field.name)
            require(rows.shape == (30, field.representation.columns.width), f"a window of {split} can be read")
