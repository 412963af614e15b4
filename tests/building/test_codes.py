"""Codes: from files into datasets, what reads them, and what is refused."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.audio.file import FileRows
from dancedata.building.describe import describe_store
from dancedata.core.codebook import Codebook
from dancedata.core.errors import DataError, RecipeError, UsageError
from dancedata.pages import write_report
from dancedata.store import Store
from dancedata.torch import (
    BatchLoader,
    ClipDataset,
    Dancers,
    EpochSampler,
    GroupDataset,
    Scale,
    WindowDataset,
    pad_clips,
)
from tests.messages import raises_message

#: Frames at 30 per second, and rows of codes at 7.5: the last two frames have none.
N, ROWS, WIDTH, SIZES, FIRST = 182, 45, 3, (8, 8, 16), (4096, 4104, 4112)
RECORDS = ["a", "g_p0", "g_p1"]
SILENT: dict[str, Any] = {"clips": RECORDS, "n_frames": N}
ALONE: dict[str, Any] = {"silent": {**SILENT, "clips": ["a"]}}


def codes(clip: str, n: int = ROWS) -> np.ndarray:
    """Random codes from 0 on, where 0 occurs, (n, 3)."""
    rng = np.random.default_rng(sum(map(ord, clip)))
    return np.stack([rng.integers(0, size, n) for size in SIZES], axis=1)


def save(source: Path, clip: str, n: int = ROWS) -> Path:
    """Write tokens as InfiniteDance does: flat, each level with numbers of its own."""
    path = source / "rows" / f"{clip}.npy"
    np.save(path, (codes(clip, n) + FIRST).reshape(-1))
    return path


@pytest.fixture
def source(silent_source: Path) -> Path:
    for clip in RECORDS:
        save(silent_source, clip)
    return silent_source


TOKENS = {
    "path": "rows/{clip}.npy", "rate": "15/2", "columns_per_row": WIDTH, "fps": "15/2", "dtype": "int16",
    "begins": "clip", "of": "motion", "first_codes": list(FIRST),
    "codebook": {"name": "vq", "sizes": list(SIZES), "sha256": "ab" * 32},
}  # fmt: skip


def document(changes: dict[str, Any], **keys: Any) -> dict[str, Any]:
    return {
        "recipe": 1, "name": "codes", "dataset": {"silent": SILENT}, "fps": 30, "motion": {"joints": {}},
        "windows": {"length_s": 2, "stride_s": "4/3"}, "audio": {"file.tokens": {**TOKENS, **changes}},
    } | keys  # fmt: skip


@pytest.fixture
def build(source: Path, store_of: Callable[..., Store]) -> Callable[..., Store]:
    return lambda changes=None, **keys: store_of(document(changes or {}, **keys), source)


#: The transforms of whole clips, and of slices.
SCOPES: dict[str, list[Any]] = {"track": [], "window": [{"slices": {"length_s": 2, "stride_s": "4/3"}}]}


@pytest.mark.parametrize("scope", ["track", "window"])
def test_codes_of_motion(build: Callable[..., Store], source: Path, scope: str) -> None:
    dataset = ALONE if scope == "window" else {"silent": SILENT}  # groups are stored whole
    store = build(transforms=SCOPES[scope], dataset=dataset)
    field = store.field("file.tokens")
    assert (field.kind, field.dtype, field.rate) == ("motion", "int16", Fraction(15, 2))
    assert field.codebook == Codebook("vq", SIZES, "ab" * 32)
    windows = [(store[window.clip], window) for window in store.windows("train")]
    assert [c.slice_start + w.start for c, w in windows if c.original == "a"] == [0, 40, 80, 120]
    for clip, window in windows:
        first = (clip.slice_start + window.start) // 4
        np.testing.assert_array_equal(store.read(window, field.name), codes(clip.original)[first : first + 15])
    if scope == "track":
        np.testing.assert_array_equal(store["g_p1"].read(field.name), codes("g_p1"))
    sample = WindowDataset(store, fields=("joints", "file.tokens"))[1]
    assert sample["file.tokens"].dtype.is_floating_point is False
    np.testing.assert_array_equal(sample["file.tokens"], codes("a")[10:25])
    assert "int16; codes of vq, 8 x 8 x 16, pad -1" in describe_store(store.path)


def test_statistics_of_codes_are_counts(build: Callable[..., Store], tmp_path: Path) -> None:
    store = build()
    stats = store.stats["fields"]["file.tokens"]
    covered = np.concatenate([codes(clip) for clip in RECORDS])
    counts = [np.bincount(covered[:, level], minlength=size).tolist() for level, size in enumerate(SIZES)]
    assert stats == {
        "n": 3 * ROWS, "min": covered.min(axis=0).tolist(), "max": covered.max(axis=0).tolist(), "counts": counts,
    }  # fmt: skip
    with raises_message(UsageError, "scale", where="out"):
        store.scaler("file.tokens")
    (tmp_path / "report").mkdir()
    write_report(store.path, tmp_path / "report" / "page.html")
    assert "file.tokens" in (tmp_path / "report" / "page.html").read_text(encoding="utf-8")


def test_rows_without_a_code_are_not_counted(source, build, monkeypatch):
    rows = np.full((ROWS, WIDTH), -1)
    rows[:4, 1] = [FIRST[1] + 5, -1, FIRST[1] + 5, FIRST[1] + 2]
    for clip in RECORDS:
        np.save(source / "rows" / f"{clip}.npy", rows)
    stats = build().stats["fields"]["file.tokens"]
    assert (stats["n"], stats["min"], stats["max"]) == (3 * ROWS, [-1, 2, -1], [-1, 5, -1])
    assert [sum(level) for level in stats["counts"]] == [0, 9, 0]
    assert stats["counts"][1] == [0, 0, 3, 0, 0, 6, 0, 0]
    monkeypatch.setattr("dancedata.store.stats._MOST_COUNTS", sum(SIZES) - 1)
    assert set(build().stats["fields"]["file.tokens"]) == {"n", "min", "max"}


def test_bytes(source: Path, build: Callable[..., Store]) -> None:
    rows = codes("a")
    rows[7] = 255
    np.save(source / "rows" / "a.npy", rows.astype(np.uint16))
    book = {"name": "vq", "sizes": list(SIZES), "pad": 255}
    store = build({"dtype": "uint8", "first_codes": [], "codebook": book}, dataset=ALONE)
    read = store["a"].read("file.tokens")
    assert read.dtype == np.uint8
    np.testing.assert_array_equal(read, rows)


def test_other_first_codes_are_other_rows(build: Callable[..., Store]) -> None:
    """From one cache: the codebook is part of the key."""
    book = {"codebook": {"name": "vq", "sizes": [size + 1 for size in SIZES]}}
    np.testing.assert_array_equal(build(book)["a"].read("file.tokens"), codes("a"))
    one_less = {**book, "first_codes": [first - 1 for first in FIRST]}
    np.testing.assert_array_equal(build(one_less)["a"].read("file.tokens"), codes("a") + 1)


def test_codes_at_the_nearest_row(build: Callable[..., Store]) -> None:
    """Rates are changed by repeating codes, not by averaging them; of two the later."""
    store = build({"fps": 30, "resample": "nearest"})
    rows = store["a"].read("file.tokens")
    nearest = np.minimum((np.arange(4 * ROWS) + 2) // 4, ROWS - 1)
    np.testing.assert_array_equal(rows[: 4 * ROWS], codes("a")[nearest])
    assert (rows[4 * ROWS :] == -1).all(), "two frames beyond the file"
    assert len(rows) == N


def test_files_that_end_before_the_clip(source: Path, build: Callable[..., Store]) -> None:
    """Within the tolerance codes are filled up with the pad; windows there are left out, as for any file."""
    save(source, "a", ROWS - 2)
    store = build({"tolerance_s": "1/2"}, dataset=ALONE, windows={"length_s": 2, "stride_s": "2/15"})
    rows = store["a"].read("file.tokens")
    np.testing.assert_array_equal(rows, [*codes("a", ROWS - 2), *[[-1] * WIDTH] * 2])
    assert store.windows("train")[-1].start + 60 == 4 * (ROWS - 2)
    assert sum(row["reason"] == "no_audio" for row in store.rejects) == 2


def test_windows_of_a_group_are_those_that_all_files_reach(source: Path, build: Callable[..., Store]) -> None:
    save(source, "g_p1", ROWS - 2)
    store = build({"tolerance_s": "1/2"}, windows={"length_s": 2, "stride_s": "2/15"})
    starts = {clip: [w.start for w in store.windows("train") if w.clip == clip] for clip in RECORDS}
    assert starts["g_p0"] == starts["g_p1"] == starts["a"][:-2]
    lost = [(row["clip"], row["window"], row["reason"]) for row in store.rejects]
    assert sorted(lost) == [(clip, start, "no_audio") for clip in ("g_p0", "g_p1") for start in starts["a"][-2:]]


@pytest.mark.parametrize("incomplete", ["set_aside", "keep"])
def test_a_dancer_with_a_bad_file_is_not_stored(source: Path, build: Callable[..., Store], incomplete: str) -> None:
    np.save(source / "rows" / "g_p1.npy", np.full(3 * ROWS, 9999))
    kept = ["a"] if incomplete == "set_aside" else ["a", "g_p0"]
    assert [clip.id for clip in build(groups={"incomplete": incomplete}).clips()] == kept
    save(source, "g_p1", ROWS - 9)
    store = build(groups={"incomplete": incomplete})
    assert [clip.id for clip in store] == kept
    assert ("g_p1", "feature_length") in [(row.get("clip"), row["reason"]) for row in store.rejects]


def test_real_rows_of_motion_last_as_long_as_it(source: Path, build: Callable[..., Store]) -> None:
    real = {"dtype": "float32", "codebook": None, "first_codes": [], "rate": 30, "fps": 30}
    for clip in RECORDS:
        np.save(source / "rows" / f"{clip}.npy", np.ones((N + (1 if clip == "a" else 0), WIDTH)))
    assert build(real)["a"].read("file.tokens").shape == (N, WIDTH)
    np.save(source / "rows" / "a.npy", np.ones((N - 1, WIDTH)))
    store = build(real)
    assert [(row["clip"], row["reason"]) for row in store.rejects] == [("a", "feature_length")]


def test_codes_of_music_are_shared(source: Path, build: Callable[..., Store]) -> None:
    save(source, "m")
    store = build({"of": "music", "path": "rows/{music}.npy"})
    assert store.field("file.tokens").kind == "audio"
    sample = GroupDataset(store, fields=("joints", "file.tokens"), augment={"mirror": 1.0})
    assert sample[0]["file.tokens"].shape == (15, WIDTH)
    np.testing.assert_array_equal(sample[0]["file.tokens"], codes("m")[:15])


def test_padding_is_the_pad(build: Callable[..., Store]) -> None:
    store = build({"codebook": {"name": "vq", "sizes": list(SIZES), "pad": -7}})
    fields = ("joints", "file.tokens")
    groups = GroupDataset(store, fields=fields, dancers=Dancers(persons=4))
    rows = groups[0]["file.tokens"]
    np.testing.assert_array_equal(rows[:2], [codes("g_p0")[:15], codes("g_p1")[:15]])
    assert (rows[2:] == -7).all()
    loader = BatchLoader(groups, batch_size=2, sampler=EpochSampler(groups, seed=0))
    for batch in loader:
        assert (batch["file.tokens"][:, 2:] == -7).all()
        assert (batch["file.tokens"][:, :2] >= 0).all()
    masked = {"drop": {"fields": ["file.tokens"], "p": 1.0}}
    assert (WindowDataset(store, fields=fields, augment=masked)[0]["file.tokens"] == -7).all()
    assert (GroupDataset(store, fields=fields, augment=masked)[0]["file.tokens"] == -7).all()
    clips = ClipDataset(store, fields=fields, augment=masked)
    assert (clips[0]["file.tokens"] == -7).all()
    whole = ClipDataset(store, fields=fields)
    assert whole.blanks == {"joints": 0, "file.tokens": -7}
    padded = pad_clips([whole[0]], length=200, value=whole.blanks)
    assert (padded["file.tokens"][0, ROWS:] == -7).all()
    assert (padded["joints"][0, N:] == 0).all()
    with raises_message(UsageError, "filled"):
        pad_clips([whole[0]])


CHANGES: tuple[dict[str, Any], ...] = (
    {"scale": Scale(fields=("file.tokens",))}, {"augment": {"mirror": 0.5}}, {"augment": ["yaw"]},
    {"augment": ["noise"]}, {"augment": ["yaw", {"mirror": 0.5}]},
)  # fmt: skip


def test_codes_are_not_changed(build: Callable[..., Store]) -> None:
    store = build()
    for changes in CHANGES:
        for reader in (WindowDataset, GroupDataset):
            with raises_message(UsageError, "codes", where="out"):
                reader(store, fields=("file.tokens",), **changes)


@pytest.mark.parametrize("augment", [{"mirror": True}, {"tempo": {}}])
def test_copies_need_codes_of_their_own(build: Callable[..., Store], augment: dict[str, Any]) -> None:
    with raises_message(RecipeError, "copies", where="recipe"):
        build(augment=augment)


def test_windows_begin_at_rows_of_codes(build: Callable[..., Store]) -> None:
    with raises_message(RecipeError, r"file\.tokens", where="recipe"):
        build(windows={"length_s": 2, "stride_s": 0.5})


BAD: dict[str, tuple[Any, str]] = {
    "too large": (np.array([4096, 4104, 4128] * ROWS), "bad_code"),
    "too small": (np.array([4095, 4104, 4112] * ROWS), "bad_code"),
    "not whole rows": (np.array([4096, 4104, 4112] * ROWS + [4096]), "bad_shape"),
    "real": (np.full((ROWS, 3), 4096.0), "bad_dtype"),
}


def feature_of_tokens() -> FileRows:
    keys = {key: value for key, value in TOKENS.items() if key not in ("fps", "codebook", "first_codes")}
    return FileRows(**keys, codebook=Codebook("vq", SIZES), first_codes=FIRST)  # type: ignore[arg-type]


@pytest.mark.parametrize("case", BAD)
def test_bad_files(source: Path, case: str) -> None:
    content, reason = BAD[case]
    path, feature = source / "rows" / "a.npy", feature_of_tokens()
    np.save(path, content)
    with raises_message(DataError, "codes|features|first_codes", reason=reason):
        feature.rows(path, feature.placed(feature.length(path), Fraction(0), feature.grid))


def test_padded_codes_stay(source: Path) -> None:
    path = source / "rows" / "a.npy"
    np.save(path, np.array([4097, -1, 4112, -1, 4105, -1]))
    feature = feature_of_tokens()
    rows = feature.rows(path, feature.placed(2, Fraction(0), feature.grid))
    np.testing.assert_array_equal(rows, [[1, -1, 0], [-1, 1, -1]])


BAD_KEYS: dict[str, dict[str, Any]] = {
    "no codebook": {"codebook": None}, "real": {"dtype": "float32"}, "linear": {"resample": "linear"},
    "levels": {"codebook": {"name": "vq", "sizes": [8, 8]}},
    "no size": {"codebook": {"name": "vq", "sizes": [8, 8, 0]}},
    "large": {"dtype": "uint8", "codebook": {"name": "vq", "sizes": [8, 8, 512], "pad": 255}},
    "pad": {"codebook": {"name": "vq", "sizes": [8, 8, 16], "pad": 3}},
    "no name": {"codebook": {"name": "", "sizes": [8, 8, 16]}},
    "hash": {"codebook": {"name": "vq", "sizes": [8, 8, 16], "sha256": "x"}},
    "unknown key": {"codebook": {"name": "vq", "sizes": [8, 8, 16], "size": 3}}, "first codes": {"first_codes": [1]},
    "of": {"of": "dancer"}, "music's begin": {"begins": "music"},
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_KEYS)
def test_wrong_keys(build: Callable[..., Store], case: str) -> None:
    with raises_message(RecipeError, "problem", where="recipe"):
        build(BAD_KEYS[case])


def test_first_codes_are_of_codes() -> None:
    with raises_message(UsageError, "first_codes"):
        FileRows("{clip}.npy", 30, 2, first_codes=(1, 2))
