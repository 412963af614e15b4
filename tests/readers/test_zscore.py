"""Z-scores against numpy on the rows that train windows cover, and everything that takes a scaler."""

from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import UsageError
from dancedata.store import Store
from dancedata.store.normalize import Scaler
from dancedata.torch import BatchLoader, ClipDataset, Mix, Scale, WindowDataset
from tests.messages import raises_message

FIELD = "edge151"


@pytest.fixture(scope="module")
def store(built: Path) -> Store:
    return dancedata.open(built)


@pytest.fixture(scope="module")
def rows(store: Store) -> np.ndarray:
    """Every row that a train window covers, once."""
    covered = []
    for clip in store:
        if clip.split == "train":
            mask = np.zeros(clip.n_frames, dtype=bool)
            for window in store[clip.id].windows():
                mask[window.start : window.start + window.length] = True
            covered.append(clip.read(FIELD)[mask])
    return np.concatenate(covered)


def test_batches_are_numpys_z_scores(store: Store, rows: np.ndarray) -> None:
    mean, std = rows.mean(axis=0, dtype=np.float64), rows.std(axis=0, dtype=np.float64)
    scaler = store.scaler(FIELD, "zscore")
    np.testing.assert_allclose(scaler.mean, mean, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(scaler.std, std, rtol=1e-7, atol=1e-9)
    divisor = np.where(scaler.constant, 1, scaler.std).astype(np.float32)
    train = WindowDataset(store, "train", fields=[FIELD], scale=scaler)
    batch = next(iter(BatchLoader(train, 16)))
    for sample, clip, start in zip(batch[FIELD].numpy(), batch["clip"], batch["start"], strict=True):
        raw = store[clip].read(FIELD)[start : start + 150]
        np.testing.assert_array_equal(sample, (raw - scaler.mean.astype(np.float32)) / divisor)
    whole = np.concatenate([sample[FIELD].numpy() for sample in ClipDataset(store, fields=[FIELD], scale=scaler)])
    alive = ~scaler.constant
    assert np.abs(whole.mean(axis=0)).max() < 0.1  # whole clips have some rows that no window covers
    np.testing.assert_allclose(whole.std(axis=0)[alive], 1, atol=0.05)


def test_grouped_deviations_are_means(store: Store, rows: np.ndarray) -> None:
    """As in HumanML3D's cal_mean_variance: Std of a group of columns is the mean of theirs."""
    columns, std = store.fields[FIELD], rows.std(axis=0, dtype=np.float64)
    grouped = store.scaler(FIELD, "zscore_grouped")
    for name in columns.names:
        part = columns.slice(name)
        np.testing.assert_allclose(grouped.std[part], std[part].mean(), rtol=1e-6)
    assert grouped.sha256 != store.scaler(FIELD, "zscore").sha256


def test_decoded_motion_is_the_dancers(store: Store, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    reader = WindowDataset(store, "val", fields=[FIELD], scale=store.scaler(FIELD, "zscore"))
    window = reader.windows[0]
    expected = dancedata.decode(store.read(window, FIELD), FIELD, like=store, normalized=False).joints()
    scaler, path = store.scaler(FIELD, "zscore"), tmp_path / "z.json"
    scaler.save(path)
    assert (Scaler.load(path).kind, Scaler.load(path).sha256) == ("zscore", scaler.sha256)
    for options in ({"like": reader}, {"like": store, "scaler": scaler}, {"like": store, "scaler": path}):
        found = dancedata.decode(reader[0][FIELD].numpy(), FIELD, **options).joints()
        np.testing.assert_allclose(found, expected, atol=1e-5)  # metres: float32 columns
    with pytest.raises(UsageError, match="look"):
        dancedata.decode(store.read(window, FIELD), FIELD, like=reader)
    # Z-scores that are taken as min-max values are far from motion, and so they are as they stand.
    dancedata.decode(reader[0][FIELD].numpy(), FIELD, like=store, normalized=True)
    assert "with either choice" in caplog.text


def test_what_z_scores_cannot(store: Store) -> None:
    scaler = store.scaler(FIELD, "zscore")
    with pytest.raises(UsageError, match="no range to cut"):
        WindowDataset(store, fields=[FIELD], scale=Scale(clamp=True, scaler=scaler))
    with pytest.raises(UsageError, match="go together"):
        WindowDataset(store, fields=[FIELD], scale=Scale(covers=["mirror"], scaler=scaler), augment={"mirror": 0.5})
    with raises_message(UsageError, "zscore"):
        store.scaler(FIELD, "zscores")  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="negative"):
        Scaler("zscore", [0.0], [-1.0])
    with pytest.raises(UsageError, match="finite"):
        Scaler("zscore", [np.nan], [1.0])


def test_mixes_take_one_for_all(store: Store) -> None:
    scaler = store.scaler(FIELD, "zscore")
    readers = {split: WindowDataset(store, split, fields=[FIELD], scale=scaler) for split in ("train", "val")}
    mix = Mix(readers)
    assert mix.scaler(FIELD).sha256 == scaler.sha256
    np.testing.assert_array_equal(mix.datasets[1][0][FIELD].numpy(), readers["val"][0][FIELD].numpy())
    other = Scaler("zscore", scaler.mean + 1, scaler.std)
    with pytest.raises(UsageError, match="do not join"):
        Mix({**readers, "val": WindowDataset(store, "val", fields=[FIELD], scale={FIELD: other})})


@pytest.mark.parametrize("reader", [WindowDataset, ClipDataset])
def test_several_splits(store: Store, reader: type[WindowDataset]) -> None:
    parts = [reader(store, split, fields=[FIELD]) for split in ("train", "val")]
    both = reader(store, ("train", "val"), fields=[FIELD])
    assert len(both) == sum(map(len, parts))
    assert len(reader(store, "all", fields=[FIELD])) == len(both) + len(reader(store, "test", fields=[FIELD]))
    for place, (part, of_part) in {0: (0, 0), len(parts[0]): (1, 0), len(both) - 1: (1, len(parts[1]) - 1)}.items():
        found, expected = both[place], parts[part][of_part]
        assert (found["id"], found["split"]) == (expected["id"], expected["split"])
        np.testing.assert_array_equal(found[FIELD].numpy(), expected[FIELD].numpy())
    with pytest.raises(UsageError, match="twice"):
        reader(store, ("val", "val"))
    with pytest.raises(UsageError, match="no split named"):
        reader(store, ("val", "vol"))
