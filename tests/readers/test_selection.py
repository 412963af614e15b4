"""Selection of windows: lists, protocols, trims, movement, presets; and the reported rejects."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dancedata.core.errors import UsageError
from dancedata.filters.movement import Movement
from dancedata.store import Store, open_store
from dancedata.store.normalize import Scaler
from dancedata.store.stored_clip import StoredClip
from dancedata.store.writer import write_store
from dancedata.testing.stores import random_fields, write_random_store
from dancedata.torch import PRESETS, Primitives, Scale, Select, WindowDataset, Windows
from tests.messages import raises_message
from tests.readers.conftest import LODGE, rewritten

N, LENGTH = 600, 120


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Eight clips of 600 frames: lists, trims, one that stands still from frame 300 on, one too short to cut."""
    folder = tmp_path_factory.mktemp("selection")
    made = write_random_store(
        folder / "plain", clips={"train": 6, "test": 2}, n_frames=(N, N), length=LENGTH, stride=60, fields=LODGE
    )
    clips = []
    for number, clip in enumerate(made.clips):
        home = clip.split
        lists = [f"one.{home}", f"other.{'val' if number in (0, 7) else 'train'}"]
        if number == 1:
            lists.append("ignored")
        if number == 2:
            lists += ["ignored.finenet", "ignored.one"]
        rows = {name: np.array(array) for name, array in clip.motion.items()}
        if number == 3:
            rows["lodge139"][300:] = rows["lodge139"][300]
        rows["lodge"][:, 1] = np.arange(len(rows["lodge"])) % 25 == 20
        rows["lodge"][:, 2] = rows["lodge"][:, 1] * (1 + np.arange(len(rows["lodge"])) % 7)
        trim = 130 if number == 4 else 0
        clips.append(replace(clip, lists=tuple(lists), motion=rows, trim_start=trim, genre="Popping"))
    meta = {"recipe": {"name": "random"}, "licence": "CC0-1.0", "genre_ids": {"Popping": 1}}
    (folder / "out").mkdir()
    write_store(folder / "out", replace(made.header, meta=meta), clips)
    return open_store(folder / "out")


def _ids(dataset: WindowDataset) -> list[str]:
    return list(dict.fromkeys(w.clip for w in dataset.windows))


def _read(store: Store, **options: object) -> WindowDataset:
    return WindowDataset(store, **{"fields": ("lodge139",), "scale": None, **options})  # type: ignore[arg-type]


def test_lists_that_are_ignored_are_named_in_rejects(store: Store) -> None:
    dataset = _read(store, select=Select(ignore=("ignored", "ignored.finenet")))
    assert _ids(dataset) == ["train_c00", "train_c03", "train_c04", "train_c05"]
    assert [(r.reason, r.clip, r.detail) for r in dataset.rejects] == [
        ("ignored", "train_c01", "on the list ignored"),
        ("ignored", "train_c02", "on the list ignored.finenet"),
    ]


def test_a_protocol_defines_the_clips_of_a_split(store: Store) -> None:
    assert _ids(_read(store, select=Select(protocol="other"))) == [
        *(f"train_c{k:02d}" for k in range(1, 6)),
        "test_c00",
    ]
    assert _ids(_read(store, split="val", select=Select(protocol="other"))) == ["train_c00", "test_c01"]
    assert "train_c02" in _ids(_read(store, select=Select(protocol="one")))
    assert "train_c02" not in _ids(_read(store, select=Select(protocol="one", ignore=("ignored",))))
    with raises_message(UsageError, "split", where="out"):
        _read(store, split="test", select=Select(protocol="other"))
    # A misspelt protocol would read the stored splits.
    with raises_message(UsageError, "ohter", where="out"):
        _read(store, select=Select(protocol="ohter"))
    with raises_message(UsageError, "no clip is in a list named 'ohter.train'. Did you mean 'other.train'"):
        _read(store, select=Select(ignore=("ohter.train",)))


def test_windows_begin_after_the_trim(store: Store) -> None:
    dataset = _read(store, windows=Windows(trim=True))
    assert [w.start for w in dataset.windows if w.clip == "train_c04"] == list(range(130, N - LENGTH + 1, 60))
    assert [w.start for w in dataset.windows if w.clip == "train_c03"] == list(range(0, N - LENGTH + 1, 60))
    index = next(k for k, w in enumerate(dataset.windows) if w.clip == "train_c04")
    np.testing.assert_array_equal(dataset[index]["lodge139"].numpy(), store["train_c04"].read("lodge139")[130:250])


def test_still_windows_are_left_out_of_train_alone(store: Store) -> None:
    dataset = _read(store, select=Select(filter=Movement(field="lodge139")))
    still = [r for r in dataset.rejects if r.reason == "still"]
    rows = store["train_c03"].read("lodge139")
    wanted = [k for k in range(0, N - LENGTH + 1, 60) if not rows[k : k + LENGTH].std(axis=0).mean() > 0.07]
    assert [(r.clip, r.window) for r in still] == [("train_c03", k) for k in wanted]
    assert len(dataset) + len(still) == len(_read(store))
    given = {"movement": {"field": "lodge139", "min_std": 1e9}}
    assert not _read(store, split="test", select=Select(filter=given)).rejects
    with raises_message(UsageError, "filters", where="out"):
        _read(store, select=Select(filter=given))
    with raises_message(UsageError, "min_sdt"):
        _read(store, select=Select(filter={"movement": {"min_sdt": 1}}))
    with raises_message(UsageError, "still"):
        _read(store, select=Select(filter={"still": {}}))


def test_clips_shorter_than_the_windows_are_named(store: Store) -> None:
    dataset = _read(store, windows=Windows(length=500, trim=True))
    assert [(r.reason, r.clip) for r in dataset.rejects] == [("too_short", "train_c04")]
    assert "130 of them trimmed" in dataset.rejects[0].detail


def test_explicit_arguments_override_a_preset(store: Store) -> None:
    with raises_message(UsageError, "cross_genre", where="out"):
        WindowDataset(store, **PRESETS["lodge-local"])
    given = PRESETS["lodge-local"] | {"select": replace(PRESETS["lodge-local"]["select"], protocol=None)}
    local = WindowDataset(store, **given)
    assert local.fields == ("lodge139", "librosa35")
    assert {w.length for w in local.windows} == {256}
    assert {(r.reason, r.clip) for r in local.rejects} >= {("ignored", "train_c01"), ("still", "train_c03")}
    assert local[0]["genre_id"] == 1
    assert float(local[0]["lodge139"].abs().max()) <= 1
    other = WindowDataset(
        store, **PRESETS["lodge-local"] | {"windows": Windows(length=120), "select": Select(), "scale": None}
    )
    assert not other.rejects
    assert {w.length for w in other.windows} == {120}
    assert _ids(other) == [f"train_c{k:02d}" for k in range(6)]


def test_a_scaler_of_the_protocols_own_train_clips(store: Store, caplog: pytest.LogCaptureFixture) -> None:
    dataset = WindowDataset(store, fields=("lodge139",), select=Select(protocol="other"), split="val")
    assert "that of the train split of protocol other, not the stored one" in caplog.text
    train = _read(store, select=Select(protocol="other"))
    rows = np.concatenate([store.read(w, "lodge139") for w in train.windows])
    wanted = Scaler("minmax", rows.min(axis=0), rows.max(axis=0))
    np.testing.assert_array_equal(dataset.scaler("lodge139").data_min, wanted.data_min)
    np.testing.assert_array_equal(dataset.scaler("lodge139").data_max, wanted.data_max)
    # Those of whole clips, however their windows are chosen.
    for windows in (Windows(trim=True), Windows(length=300)):
        chosen = WindowDataset(store, fields=("lodge139",), select=Select(protocol="other"), windows=windows)
        np.testing.assert_array_equal(chosen.scaler("lodge139").data_min, wanted.data_min)
    everything = WindowDataset(store, fields=("lodge139",), scale=Scale(over="all")).scaler("lodge139")
    rows = np.concatenate([store[c.id].read("lodge139") for c in store])
    np.testing.assert_array_equal(everything.data_max, rows.max(axis=0))
    with raises_message(UsageError, "zscore"):
        WindowDataset(store, fields=("lodge139",), select=Select(protocol="other"), scale=Scale("zscore"))


def test_mirrored_copies_are_for_training_under_every_protocol(tmp_path: Path) -> None:
    lists = {f"train_c{k:02d}": (f"p.{split}",) for k, split in enumerate(("train", "train", "val", "val"))}
    copies = {"train_c01", "train_c02"}
    made = rewritten(tmp_path, lambda c: replace(c, lists=lists[c.id], source="train_c00" if c.id in copies else ""))
    options = {"fields": ("edge151",), "select": Select(protocol="p"), "scale": None}
    assert _ids(WindowDataset(made, **options)) == ["train_c00", "train_c01"]  # type: ignore[arg-type]
    assert _ids(WindowDataset(made, "val", **options)) == ["train_c03"]  # type: ignore[arg-type]
    (tmp_path / "other").mkdir()
    made = rewritten(tmp_path / "other", lambda c: replace(c, lists=() if c.id == "train_c02" else ("p.train",)))
    dataset = WindowDataset(made, **options)  # type: ignore[arg-type]
    assert [(r.reason, r.clip, r.detail) for r in dataset.rejects] == [("unassigned", "train_c02", "on no list of p")]


@pytest.mark.parametrize(
    "given",
    [
        {"movement": {"splits": "train"}}, {"movement": {"splits": ["trian"]}}, {"movement": {"min_std": "0.07"}},
        {"movement": {"min_std": float("nan")}}, "movement",
    ],
)  # fmt: skip
def test_an_invalid_movement_filter(store: Store, given: object) -> None:
    with raises_message(UsageError, "min_std|splits"):
        _read(store, select=Select(filter=given))


def test_a_trim_is_rounded_up_to_a_row_of_every_field(tmp_path: Path) -> None:
    fields = random_fields({"fast": 6, "slow": 6}, {}, fast=30, slow=15)
    store = rewritten(tmp_path, lambda c: replace(c, trim_start=7), length=20, stride=10, fields=fields)
    both = store.windows("train", fields=("fast", "slow"), trim=True, length=20, stride=10)
    assert [w.start for w in both][:6] == [8, 18, 28, 38, 48, 58]
    alone = store.windows("train", fields=("fast",), trim=True, length=20, stride=10)
    assert [w.start for w in alone][:6] == [7, 17, 27, 37, 47, 57]
    rows = store[both[0].clip].read("slow")
    np.testing.assert_array_equal(store.read(both[0], "slow"), rows[4:14])


def test_the_filter_looks_at_the_rows_of_a_field_of_another_rate(tmp_path: Path) -> None:
    fields = random_fields({"edge151": 6, "fast": 6}, {}, fast=60)

    def still(clip: StoredClip) -> StoredClip:
        rows = {name: np.array(array) for name, array in clip.motion.items()}
        rows["fast"][60:120] = rows["fast"][60]  # frames 30 .. 59
        return replace(clip, motion=rows)

    store = rewritten(tmp_path, still, clips={"train": 1}, fields=fields)
    dataset = _read(store, fields=("edge151",), select=Select(filter={"movement": {"field": "fast"}}))
    assert [w.start for w in dataset.windows] == [0, 60]
    assert [r.window for r in dataset.rejects] == [30]


def test_local_borders_need_no_key_motions(tmp_path: Path) -> None:
    made = write_random_store(tmp_path / "none", length=30)
    data = WindowDataset(made.path, fields=("edge151", Primitives(n=30)), scale=None)
    assert "\n  primitives: Primitives(n=30)" in str(data)
    item = data[0]
    assert (item["primitives"][:4] == item["edge151"][:4]).all()
    assert (item["primitives"][4:] == item["edge151"][-4:]).all()


def test_primitives_of_stored_minima(store: Store) -> None:
    dataset = WindowDataset(
        store, fields=("lodge139", Primitives(n=120)), windows=Windows(length=480, stride=60), augment={"mirror": 0.5}
    )
    for k in range(0, len(dataset), 7):
        item = dataset[k]
        assert item["primitives"].shape == (13, 8, 139)
        starts = item["primitive_start"].tolist()
        for piece, start in zip(item["primitives"], starts, strict=True):
            # Mirrored and normalised with the window.
            assert (piece == item["lodge139"][start : start + 8]).all()
        soft = [
            s
            for s, hard, filled in zip(starts, item["primitive_hard"], item["primitive_filled"], strict=True)
            if not (hard or filled)
        ]
        assert soft
        assert all((item["start"] + s + 4) % 25 == 20 for s in soft)


def test_the_codes_bias_is_a_function_of_seed_epoch_and_index(store: Store) -> None:
    options = {"fields": ("lodge139", Primitives(variant="code")), "windows": Windows(length=512, stride=40)}
    # Rows that are rotations, which the code's joints need.
    with pytest.raises(Exception, match=r"rotation|bad"):
        _ = [WindowDataset(store, scale=None, **options)[k] for k in range(3)]  # type: ignore[arg-type]
    dataset = _read(store)
    biases = [[dataset._bias(k) for k in range(200)] for _ in range(2)]
    assert biases[0] == biases[1]
    assert set(biases[0]) == {-2, -1, 0, 1, 2}
    dataset.set_epoch(1)
    assert [dataset._bias(k) for k in range(200)] != biases[0]


def test_requirements_of_primitives(store: Store, tmp_path: Path) -> None:
    with raises_message(UsageError, "primitives"):
        WindowDataset(store, fields=("librosa35", Primitives()))
    with raises_message(UsageError, "n=100"):
        WindowDataset(store, fields=("lodge139", Primitives(n=100)))
    made = write_random_store(tmp_path / "none", length=30)
    with raises_message(UsageError, "variant", where="none"):
        WindowDataset(made.path, fields=("edge151", Primitives(n=15)))
