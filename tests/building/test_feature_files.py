"""Audio fields from files: rows on the clip's frames, what sets a clip aside, keys, plans, and wrong recipes."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import dancedata
from dancedata.building.left_out import reasons
from dancedata.building.plan import Plan, make_plan
from dancedata.core.audio_signal import wav_bytes
from dancedata.core.errors import RecipeError, StoreError
from dancedata.recipes.parse import load_recipe, parse_recipe
from dancedata.store import Store
from dancedata.synthetic import synthesise_song
from dancedata.torch import WindowDataset
from tests.messages import raises_message

#: Frames at 30 per second: 6 s.
N = 180
PATH = "rows/{clip}.npy"


def ramp(n: int, width: int = 3, dtype: str = "float32") -> np.ndarray:
    return (np.arange(n)[:, None] + np.arange(width) / 10).astype(dtype)


@pytest.fixture
def source(silent_source: Path) -> Path:
    return silent_source


def document(feature: dict[str, Any], dataset: dict[str, Any] | None = None, **keys: Any) -> dict[str, Any]:
    muq = {"path": PATH, "rate": 25, "columns_per_row": 3, "tolerance_s": "1/10", **feature}
    return {
        "recipe": 1, "name": "files", "dataset": {"silent": dataset or {}}, "fps": 30,
        "windows": {"length_s": 2, "stride_s": 1}, "motion": {"joints": {}}, "audio": {"file.muq": muq},
    } | keys  # fmt: skip


@pytest.fixture
def build(source: Path, store_of: Callable[..., Store]) -> Callable[..., Store]:
    return lambda feature, dataset=None, **keys: store_of(document(feature, dataset, **keys), source)


#: The transforms of whole clips, and of slices.
SCOPES: dict[str, list[Any]] = {"track": [], "window": [{"slices": {"length_s": 2, "stride_s": 1}}]}


def starts_of(store: Store) -> list[int]:
    """First frames of the windows, of slices in the whole clip."""
    return [store[window.clip].slice_start + window.start for window in store.windows("train")]


@pytest.mark.parametrize("scope", ["track", "window"])
def test_rows_at_their_own_rate(source: Path, build: Callable[..., Store], scope: str) -> None:
    np.save(source / "rows" / "a.npy", ramp(150))
    store = build({"fps": 25}, transforms=SCOPES[scope])
    assert store.field("file.muq").rate == 25
    assert starts_of(store) == [0, 30, 60, 90, 120]
    for start, window in zip(starts_of(store), store.windows("train"), strict=True):
        first = start * 25 // 30
        np.testing.assert_array_equal(store.read(window, "file.muq"), ramp(150)[first : first + 50])
    assert store.clips()[0].music == "m"
    sample = WindowDataset(store, fields=("file.muq",), scale=None)[1]
    np.testing.assert_array_equal(sample["file.muq"], ramp(150)[25:75])


#: Of two equally near rows the later: frame 3 is row 2.5. The last row lasts to the end.
NEAREST = np.minimum((np.arange(N) * 50 + 30) // 60, 149)
BETWEEN = np.minimum(np.arange(N) * 25 / 30, 149)[:, None] + np.arange(3) / 10


@pytest.mark.parametrize(
    ("feature", "file", "expected"),
    [
        ({"resample": "nearest"}, ramp(150), ramp(150)[NEAREST]),
        ({"resample": "linear"}, ramp(150, dtype="float64"), BETWEEN),
        ({"rate": "60.0", "resample": "nearest", "dtype": "float16", "fps": 15},
         ramp(360, dtype="float16"), ramp(360, dtype="float16")[::4]),
    ],
    ids=["nearest", "between", "fewer"],
)  # fmt: skip
def test_rows_at_another_rate(source, build, feature, file, expected):
    np.save(source / "rows" / "a.npy", file)
    store = build(feature)
    rows = store["a"].read("file.muq")
    assert store.field("file.muq").dtype == feature.get("dtype", "float32") == rows.dtype
    np.testing.assert_allclose(rows, expected, rtol=0, atol=1e-5 if feature["resample"] == "linear" else 0)


@pytest.mark.parametrize(("begins", "offset"), [("music", 30), ("clip", 0)])
def test_files_of_songs_that_begin_before_the_clip(source, build, begins, offset):
    np.save(source / "rows" / "m.npy", ramp(300))
    feature = {"path": "rows/{music}.npy", "rate": 30, "begins": begins, "tolerance_s": None}
    store = build(feature, {"start": "1", "clips": ["a", "b"]})
    for window in store.windows("train"):
        first = window.start + offset
        np.testing.assert_array_equal(store.read(window, "file.muq"), ramp(300)[first : first + 60])
    assert sum(w.clip == "b" for w in store.windows("train")) == 5
    # One song, stored once.
    (shard,) = source.parent.glob("out/*-0000*.h5")
    with h5py.File(shard) as file:
        assert file["audio/file.muq"].shape == (300, 3)


def test_a_clip_between_two_rows_needs_a_rule(source: Path, build: Callable[..., Store]) -> None:
    np.save(source / "rows" / "a.npy", ramp(250))
    keys: dict[str, Any] = {"rate": 25, "fps": 25, "tolerance_s": None}
    with raises_message(StoreError, "between_rows", where="source"):
        build(keys, {"start": "0.51"})
    store = build({**keys, "resample": "linear"}, {"start": "0.51"})
    np.testing.assert_allclose(store["a"].read("file.muq")[:3, 0], [12.75, 13.75, 14.75], rtol=0, atol=1e-5)


@pytest.mark.parametrize(("origin", "starts"), [("-1/3", [0, 30, 60, 90]), ("1/2", [30, 60, 90, 120])])
def test_windows_outside_the_rows_are_left_out(source, build, origin, starts):
    np.save(source / "rows" / "a.npy", ramp(180))
    store = build({"rate": 30, "origin_s": origin})
    assert [w.start for w in store.windows("train")] == starts
    assert [row["reason"] for row in store.rejects] == ["no_audio"]
    shift = round(Fraction(origin) * 30)
    for window in store.windows("train"):
        first = window.start - shift
        np.testing.assert_array_equal(store.read(window, "file.muq"), ramp(180)[first : first + 60])


BAD: dict[str, tuple[Any, dict[str, Any], str]] = {
    "shorter": (ramp(146), {}, "feature_length"), "longer": (ramp(154), {}, "feature_length"),
    "width": (ramp(150, 4), {}, "bad_shape"), "vector": (ramp(150)[:, 0], {}, "bad_shape"),
    "codes": (ramp(150).astype(np.int32), {}, "bad_dtype"), "empty": (ramp(0), {}, "empty"),
    "objects": (np.array([[{}]], dtype=object), {}, "unsafe_pickle"),
    "nan": (np.where(np.arange(150)[:, None] == 7, np.nan, ramp(150)), {}, "nan"),
    "overflow": (ramp(150) * 1e6, {"dtype": "float16"}, "nan"), "missing": (None, {}, "missing_feature"),
    "short": (ramp(30), {"tolerance_s": None}, "short_feature"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_what_sets_a_clip_aside(source: Path, build: Callable[..., Store], case: str, cache: Path) -> None:
    content, keys, reason = BAD[case]
    np.save(source / "rows" / "a.npy", ramp(150))
    if content is not None:
        np.save(source / "rows" / "b.npy", content, allow_pickle=True)
    feature = {"fps": 25, **keys}
    store = build(feature, {"clips": ["a", "b"]})
    assert [clip.id for clip in store] == ["a"]
    (reject,) = store.rejects
    assert (reject["reason"], reject["clip"]) == (reason, "b")
    if case not in ("nan", "overflow"):  # which a plan does not read
        plan = make_plan(load_recipe(document(feature, {"clips": ["a", "b"]})), source, cache=cache)
        assert [(r.reason, r.clip) for r in plan.rejects] == [(reason, "b")]
    if case != "short":  # which depends on the windows
        problems = dancedata.check(source, recipe=document(feature, {"clips": ["a", "b"]}))
        assert [(p.severity, p.where, p.message.partition(":")[0]) for p in problems] == [("error", "b", reason)]


@pytest.mark.parametrize("scope", ["track", "window"])
@pytest.mark.parametrize(("seconds", "rows", "starts"), [(5, 150, [0, 30, 60, 90]), (6, 125, [0, 30, 60, 90])])
def test_beside_a_feature_of_music(source, build, cache, scope, seconds, rows, starts):
    (source / "song.wav").write_bytes(
        wav_bytes(synthesise_song("mBR0", length_s=seconds, sample_rate=24_000, n_channels=1).pcm, 24_000)
    )
    np.save(source / "rows" / "a.npy", ramp(rows))
    muq = document({"fps": 25, "tolerance_s": 1})["audio"]
    store = build({}, transforms=SCOPES[scope], audio={**muq, "librosa35": {}})
    assert starts_of(store) == starts
    window = store.windows("train")[-1]
    np.testing.assert_array_equal(store.read(window, "file.muq"), ramp(rows)[75:125])
    assert store.read(window, "librosa35").shape == (60, 35)
    plan = make_plan(
        load_recipe(document({}, transforms=SCOPES[scope], audio={**muq, "librosa35": {}})), source, cache=cache
    )
    assert plan.to_json()["splits"]["train"]["windows"] == len(starts)
    held = {name: cached.cached == cached.of for name, cached in plan.cached.items()}
    assert held["file.muq"]
    assert held["librosa35"]


@pytest.mark.parametrize("music", ["../x", "", ".."])
def test_names_that_are_no_names_of_files(source: Path, build: Callable[..., Store], music: str) -> None:
    np.save(source / "x.npy", ramp(150))
    with pytest.raises(StoreError, match="missing_feature"):
        build({"path": "rows/{music}.npy", "fps": 25}, {"music": music})


def test_the_content_is_the_key(source: Path, build: Callable[..., Store], tmp_path: Path, cache: Path) -> None:
    np.save(source / "rows" / "a.npy", ramp(150))
    before = build({"fps": 25})["a"].read("file.muq")
    (source / "other").mkdir()
    (source / "rows" / "a.npy").rename(source / "other" / "a.npy")
    moved = {"fps": 25, "path": "other/{clip}.npy"}
    assert plan_of(source, cache, moved).cached["file.muq"]._asdict() == {"unit": "files", "cached": 0, "of": 1}
    np.testing.assert_array_equal(build(moved)["a"].read("file.muq"), before)
    assert plan_of(source, cache, moved).cached["file.muq"]._asdict() == {"unit": "files", "cached": 1, "of": 1}
    np.save(source / "other" / "a.npy", ramp(150) + 1)
    assert plan_of(source, cache, moved).cached["file.muq"].cached == 0
    with pytest.raises(StoreError, match="another source"):
        dancedata.build(document(moved), source, tmp_path / "out", jobs=1, cache=cache, progress=False)
    np.testing.assert_array_equal(build(moved)["a"].read("file.muq"), ramp(150) + 1)


def plan_of(source: Path, cache: Path, feature: dict[str, Any]) -> Plan:
    return make_plan(load_recipe(document(feature)), source, cache=cache)


def test_a_plan_counts_what_a_build_stores(source: Path, build: Callable[..., Store], cache: Path) -> None:
    np.save(source / "rows" / "a.npy", ramp(148))
    plan = plan_of(source, cache, {"fps": 25})
    store = build({"fps": 25})
    counts = store.info["splits"]["train"]
    assert plan.to_json()["splits"]["train"]["windows"] == counts["windows"] == 4
    assert plan.to_json()["left_out"] == reasons(store) == {"no_audio": 1}
    assert plan.to_json()["bytes"] == sum(
        store.field(name).row_bytes * n for name, n in {"joints": N, "file.muq": 148}.items()
    )


WRONG: dict[str, dict[str, Any]] = {
    "another rate": {}, "no name": {"path": "rows/all.npy", "fps": 25},
    "outside": {"path": "../{clip}.npy", "fps": 25}, "absolute": {"path": "/rows/{clip}.npy", "fps": 25},
    "unknown name": {"path": "{clip}{fps}.npy", "fps": 25}, "a format": {"path": "{clip.split}.npy", "fps": 25},
    "a brace": {"path": "{clip.npy", "fps": 25}, "a pickle": {"path": "{clip}.pkl", "fps": 25},
    "negative": {"tolerance_s": -1, "fps": 25}, "negative width": {"columns_per_row": -1, "fps": 25},
    "rate": {"rate": "fast", "fps": 25},
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_wrong_recipes(source: Path, case: str) -> None:
    with raises_message(RecipeError, "problem", where="recipe"):
        parse_recipe(document(WRONG[case]))


def test_nothing_is_assumed(source: Path) -> None:
    wrong = document({})
    wrong["audio"] = {"file.muq": {"path": PATH}}
    with raises_message(RecipeError, "columns_per_row", where="recipe"):
        parse_recipe(wrong)


def test_no_copies_at_another_speed(source: Path) -> None:
    with raises_message(RecipeError, r"augment\.tempo", where="recipe"):
        parse_recipe(document({"fps": 25}, augment={"tempo": True}))


def test_one_rate_written_in_several_ways_is_one_recipe(source: Path) -> None:
    hashes = {load_recipe(document({"rate": rate, "fps": 25})).sha256 for rate in (25, 25.0, "25", "50/2")}
    assert len(hashes) == 1
