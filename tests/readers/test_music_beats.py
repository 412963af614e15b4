"""Beats in readers: labels of samples, windows and crops that begin at beats."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

from dancedata.core.errors import UsageError
from dancedata.store.clip_view import Clip
from dancedata.store.dataset import Store
from dancedata.torch import BatchLoader, ClipDataset, Scale, WindowDataset, Windows, pad_clips
from tests.messages import raises_message

FIELDS = ("edge151", "beats")


@pytest.fixture(scope="module")
def store(beats_store: Store) -> Store:
    return beats_store


def train_clips(store: Store) -> list[Any]:
    return list(store.clips("train"))


def rows_of(store: Store, sample: dict[str, Any]) -> np.ndarray:
    start = int(sample["start"])
    return store[sample["clip"]].read("beats")[start : start + int(sample["length"])]


@pytest.mark.parametrize("fields", [FIELDS, ("edge151", "librosa35"), ("edge151",)])
def test_a_tempo_that_is_not_stated_is_that_of_the_beats(store: Store, fields: tuple[str, ...]) -> None:
    data = WindowDataset(store, "train", fields)
    field = next((name for name in fields if "beat" in store.fields[name].names), next(
        name for name in store.fields if "beat" in store.fields[name].names))  # fmt: skip
    column = store.fields[field].slice("beat").start
    estimated = 0
    for sample in data.samples(range(len(data))):
        stated = store[sample["clip"]].tempo_bpm
        assert sample["tempo_estimated"] == (stated is None)
        if stated is not None:
            assert sample["tempo_bpm"] == stated
            continue
        gaps = np.diff(np.flatnonzero(store[sample["clip"]].read(field)[:, column]))
        middle = np.median(gaps)
        mean = gaps[(gaps >= 0.75 * middle) & (gaps <= 1.25 * middle)].mean()
        assert sample["tempo_bpm"] == pytest.approx(60 * 30 / mean)
        estimated += 1
    assert estimated > 10


@pytest.mark.parametrize("scale", [Scale(), Scale(fields=FIELDS), None])
def test_samples_have_labels(store: Store, scale: Any) -> None:
    windows = WindowDataset(store, "train", FIELDS, scale=scale, augment={"mirror": 0.5, "drop": {"p": 0.5}})
    for sample in (windows[3], windows.samples([5, 2])[1]):
        rows = rows_of(store, sample)
        assert sample["beat"].dtype == sample["downbeat"].dtype == torch.bool
        assert np.array_equal(sample["beat"], rows[:, 0] == 1)
        assert np.array_equal(sample["downbeat"], rows[:, 1] == 1)
    whole = ClipDataset(store, "train", FIELDS, scale=scale)[1]
    assert np.array_equal(whole["downbeat"], store[whole["clip"]].read("beats")[:, 1] == 1)


def test_labels_are_padded(store: Store) -> None:
    clips = ClipDataset(store, "train", FIELDS)
    samples = [
        clips[0],
        {name: v[:50] if name in (*FIELDS, "beat", "downbeat") else v for name, v in clips[1].items()},
    ]
    padded = pad_clips(samples, multiple=64, value=-1.0)
    assert padded["beat"].shape == padded["beats"].shape[:2] == (2, 320)
    assert torch.equal(padded["downbeat"][1, :50], samples[1]["downbeat"])
    assert not padded["downbeat"][1, 50:].any()
    windows = WindowDataset(store, "train", FIELDS)
    for batch in (next(iter(DataLoader(windows, batch_size=3))), next(iter(BatchLoader(windows, batch_size=3)))):
        assert torch.equal(batch["beat"], batch["beats"][:, :, 0] == 1)
        assert torch.equal(batch["downbeat"], batch["beats"][:, :, 1] == 1)
    assert "beat" not in WindowDataset(store, "train", ("edge151", "librosa35"))[0]


@pytest.mark.parametrize("at", ["beat", "downbeat"])
def test_windows_begin_at_beats(store: Store, at: str) -> None:
    fields = ("fast", "beats")
    windows = WindowDataset(store, "train", fields, windows=Windows(length_s=4, stride=1, start_at=at))
    column = ("beat", "downbeat").index(at)
    expected = {
        (clip.id, start)
        for clip in train_clips(store)
        for start in np.flatnonzero(store[clip.id].read("beats")[:, column]).tolist()
        if start + 120 <= len(clip.read("edge151"))
    }
    assert {(w.clip, w.start) for w in windows.windows} == expected
    assert all(bool(windows[k][at][0]) for k in range(0, len(windows), 3))
    assert not windows.rejects


def test_a_stride_is_the_least_distance(store: Store) -> None:
    every = WindowDataset(store, "train", FIELDS, windows=Windows(length_s=2, stride=1, start_at="beat"))
    some = WindowDataset(store, "train", FIELDS, windows=Windows(length_s=2, stride_s=2, start_at="beat"))
    for clip in {w.clip for w in every.windows}:
        starts = [w.start for w in some.windows if w.clip == clip]
        assert starts[0] == min(w.start for w in every.windows if w.clip == clip)
        assert min(np.diff(starts)) >= 60
        assert max(np.diff(starts)) < 60 + 30
    assert {(w.clip, w.start) for w in some.windows} < {(w.clip, w.start) for w in every.windows}


def test_beats_of_another_field(store: Store) -> None:
    """librosa35 has beats and no downbeats: these are then those of the field beats, though it is not read."""
    windows = WindowDataset(store, "train", ("edge151", "librosa35"), windows=Windows(length_s=2, start_at="beat"))
    column = store.fields["librosa35"].slice("beat").start
    # Its beats are a row late, and windows begin at their instants.
    assert all(store.read(w, "librosa35")[1, column] == 1 for w in windows.windows)
    windows = WindowDataset(
        store, "train", ("edge151", "librosa35"), windows=Windows(length_s=2, start_at="downbeat")
    )
    assert all(store.read(w, "beats")[0, 1] == 1 for w in windows.windows)


def test_clips_without_downbeats_are_left_out(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    first = train_clips(store)[0].id
    silenced, read = {first}, Clip.read

    def silent(self: Clip, field: str) -> np.ndarray:
        rows = read(self, field)
        if self.id in silenced and field == "beats":
            rows[:, :2] = 0
        return rows

    monkeypatch.setattr(Clip, "read", silent)
    made = WindowDataset(store, "train", FIELDS, windows=Windows(start_at="downbeat"))
    (reject,) = made.rejects
    assert (reject.reason, reject.clip) == ("filtered", first)
    assert "no downbeat" in reject.detail
    assert first not in {w.clip for w in made.windows}
    # Beats by librosa have no downbeats in any clip: the error is not that windows are too long.
    silenced.update(clip.id for clip in train_clips(store))
    with raises_message(UsageError, "start_at", where="out"):
        WindowDataset(store, "train", FIELDS, windows=Windows(length_s=4, start_at="downbeat"))


def test_invalid_arguments(store: Store, store_path: Path) -> None:
    with raises_message(UsageError, "beat_this", where="store"):
        WindowDataset(store_path, fields=("edge151",), windows=Windows(length_s=3, start_at="downbeat"))
    with raises_message(UsageError, "beats"):
        ClipDataset(store, "train", FIELDS, windows=Windows(length_s=3, start_at="beat"))
