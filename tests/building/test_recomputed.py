"""What a build computes again when one parameter of its recipe has changed, by stage of the cache."""

import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import dancedata
from dancedata.synthetic import write_synthetic

COPIES = {"mirror": True, "yaw": {}, "tempo": {"speeds": [0.9]}}
WINDOWS = {"length_s": 2, "stride_s": 0.5}
RECIPE = {
    "recipe": 1, "name": "parts", "dataset": {"aist++": {"split": "crossmodal"}}, "fps": 30, "windows": WINDOWS,
    "motion": {"edge151": {}, "lodge139": {}}, "keymotion": {"lodge": {}}, "audio": {"librosa35": {}},
    "augment": COPIES, "annotators": {"facts": True}, "transforms": [{"repair": {"spikes": 0.5}}],
    "rules": {"curate": {"spikes": 0.6}},
}  # fmt: skip
#: Clips of the source; of train, which have copies; songs, stretched ones among them.
CLIPS, COPIED, SONGS = 4, 2, 3
MOTIONS = CLIPS + 2 * COPIED  # mirror images are not computed
#: Fields of motion, key motions among them, and those that are stored as they were before repairs.
FIELDS, ORIGINAL = 3, 2
SEGMENTS = 2 * MOTIONS + CLIPS  # facts and flags, and scores, which copies have from their parents


@pytest.fixture(scope="module")
def changed(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., dict[str, int]]:
    """Return a function: build with other keys after a first build; entries of the cache that are new, by stage."""
    folder = tmp_path_factory.mktemp("recomputed")
    write_synthetic(folder / "source", songs=2, clips_per_song=2, clip_s=4)
    built = iter(range(100))

    def entries() -> set[Path]:
        return {
            path.relative_to(folder / "cache") for path in (folder / "cache").rglob("*.*") if path.suffix != ".db"
        }

    def build(**keys: Any) -> dict[str, int]:
        before, out = entries(), folder / f"out{next(built)}"
        dancedata.build(RECIPE | keys, folder / "source", out, jobs=1, cache=folder / "cache", progress=False)
        return dict(Counter(path.parts[0] for path in entries() - before if len(path.parts) > 1))

    first = build()
    assert first["motion"] == MOTIONS * (FIELDS + ORIGINAL)
    assert first["features"] == SONGS
    (folder / "source").rename(folder / "moved")
    shutil.copytree(folder / "moved", folder / "source")
    assert build() == {"files": CLIPS, "signals": 2}, "of copies of files, what they hold alone is looked at"
    return build


@pytest.mark.parametrize(
    ("keys", "new"),
    [
        ({}, {}),
        ({"windows": {"length_s": 1, "stride_s": 0.2}}, {}),
        ({"rules": {"movement": {"min_std": 0.0001, "field": "edge151"}}}, {}),
        ({"rules": {"curate": {"spikes": 0.7}}}, {}),
        ({"name": "another", "store": {"shard_mb": 1}, "groups": {"incomplete": "keep"}}, {}),
        ({"augment": {"yaw": {}, "tempo": {"speeds": [0.9]}}}, {}),
        (
            {"augment": COPIES | {"yaw": {"seed": 5}}},
            {"motion": COPIED * (FIELDS + ORIGINAL), "segments": 2 * COPIED},
        ),
        (
            {"augment": COPIES | {"tempo": {"speeds": [0.8]}}},
            {"motion": COPIED * (FIELDS + ORIGINAL), "segments": 2 * COPIED, "features": 1},
        ),
        (
            {"motion": {"edge151": {"contacts": {"velocity": {"max_speed_m_s": 0.4}}}, "lodge139": {}}},
            {"motion": 2 * MOTIONS},
        ),
        ({"motion": {"edge151": {}, "lodge139": {}, "joints": {}}}, {"motion": 2 * MOTIONS}),
        ({"keymotion": {"lodge": {"sigma_frames": 7}}}, {"motion": MOTIONS}),
        ({"audio": {"librosa35": {"tightness": 50}}}, {"features": SONGS}),
        ({"audio": {"librosa35": {}, "stft193": {}}}, {"features": SONGS}),
        ({"annotators": {"facts": {"turn_degrees": 90}}}, {"segments": MOTIONS}),
        ({"transforms": []}, {"motion": MOTIONS, "segments": SEGMENTS}),
        ({"transforms": [{"repair": {"spikes": 0.4}}]}, {"motion": MOTIONS * FIELDS, "segments": SEGMENTS}),
        ({"fps": 60}, {"motion": MOTIONS * (FIELDS + ORIGINAL), "features": SONGS}),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else None,
)  # fmt: skip
def test_only_what_a_parameter_shapes_is_computed_again(changed, keys: dict[str, Any], new: dict[str, int]) -> None:
    assert changed(**keys) == new
