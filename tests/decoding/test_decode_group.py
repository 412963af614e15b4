"""decode_group: the dancers of a group, present or not, each where he was; and files of groups."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import DataError, UsageError
from dancedata.core.motion import Motion
from dancedata.core.registry import REPRESENTATIONS
from dancedata.representations.root_place import RootPlace
from dancedata.store import Store, open_store, write_store
from dancedata.testing.examples import contact_rule_of, random_motion
from dancedata.torch import GroupDataset
from tests.commands import as_json
from tests.groups_store import HEADER, SIZES, stored
from tests.messages import raises_message

#: Third dancer of four is not there.
MASK = np.array([1, 1, 0, 1], np.bool_)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    out = tmp_path_factory.mktemp("decode-group")
    write_store(out, HEADER, stored(SIZES), shard_bytes=300_000)
    return open_store(out)


def columns(name: str, size: int = 4, n_frames: int = 20) -> tuple[np.ndarray, list[Motion]]:
    """Rows (P, T, D) of dancers 1.3 m apart, and their motions."""
    plugin = REPRESENTATIONS.get(name)()
    long = random_motion(plugin.skeleton, size * n_frames, turn_rad=0.3)
    parts = [long.part(k * n_frames, (k + 1) * n_frames) for k in range(size)]
    motions = [replace(part, translation=part.translation * 0.1 + (1.3 * k, 0, 0.7)) for k, part in enumerate(parts)]
    return np.stack([plugin.encode(motion, contact_rule_of(plugin)) for motion in motions]), motions


def roots(motions: list[Any]) -> np.ndarray:
    return np.stack([m.joints()[:, 0] for m in motions if m is not None])


def test_each_dancer_is_as_decoded_alone_and_the_absent_are_none() -> None:
    rows, _ = columns("edge151")
    rows[2] = np.nan  # not looked at
    group = dancedata.decode(rows, "edge151", mask=MASK)
    assert [m is None for m in group] == [False, False, True, False]
    for k in np.flatnonzero(MASK):
        alone = dancedata.decode(rows[k], "edge151")
        np.testing.assert_array_equal(group[k].joints(), alone.joints())


def test_samples_of_the_reader_come_back_as_stored(store: Store) -> None:
    groups = GroupDataset(store, fields=("edge151",))
    sample = next(s for s in (groups[k] for k in range(len(groups))) if s["group"] == "train1")
    decoded = dancedata.decode(sample["edge151"].numpy(), "edge151", mask=sample["person_mask"], like=groups)
    assert [m is not None for m in decoded] == sample["person_mask"].tolist()
    for clip, motion in zip(sample["clips"], decoded, strict=True):
        if motion is not None:
            stored_rows = store[clip].read("edge151")[sample["start"] :][: motion.n_frames]
            plain = dancedata.decode(stored_rows, "edge151", fps=store.fps)
            np.testing.assert_allclose(motion.joints(), plain.joints(), rtol=0, atol=1e-4)


def test_dancers_without_a_place_in_their_columns_stand_where_they_were() -> None:
    rows, motions = columns("humanml263")
    places = np.stack([RootPlace().encode(m) for m in motions])[:, : rows.shape[1]]
    placed = dancedata.decode(rows, "humanml263", mask=MASK, place=places, fps=30)
    wanted = roots([m.part(0, rows.shape[1]) for m, there in zip(motions, MASK, strict=True) if there])
    np.testing.assert_allclose(roots(placed), wanted, rtol=0, atol=2e-5)  # float32 columns summed over 20 rows


@pytest.mark.parametrize(("name", "options"), [
    ("edge151", {"place": np.zeros((4, 20, 6))}),
    ("humanml263", {"fps": 30, "place": np.zeros((4, 19, 3))}), ("edge151", {"mask": [1, 1, 0]}),
    ("edge151", {"mask": [0, 0, 0, 0]}), ("edge151", {"mask": [2, 1, 0, 1]}), ("joints", {}),
])  # fmt: skip
def test_what_is_refused(name: str, options: dict[str, Any]) -> None:
    with raises_message(UsageError, "mask|places|turns"):
        dancedata.decode(columns(name)[0], name, **options)


def test_rows_of_0_without_a_mask_are_not_a_pose() -> None:
    rows, _ = columns("edge151")
    rows[2] = 0
    human = np.zeros((3, 20, 263))
    with raises_message(DataError, "mask", where="dancer 0", reason="bad_shape"):
        dancedata.decode(human, "humanml263", place=np.zeros((3, 20, 6)), fps=30)
    with raises_message(UsageError, "these"):
        dancedata.decode(rows[0], "edge151", mask=MASK)
    rows[3, 4, 7] = np.nan
    with raises_message(DataError, "infinity", where="dancer 3, edge151", reason="nan"):
        dancedata.decode(rows, "edge151", mask=MASK)


def test_places_are_scaled_by_their_own_field(store: Store) -> None:
    places = np.zeros((4, 20, 6))
    scaler = store.scaler("edge151")
    with raises_message(UsageError, "normalise"):
        dancedata.decode(columns("humanml263")[0][:, :20], "humanml263", place=places, scaler=scaler, fps=30)


def test_files_of_groups_are_named_by_their_dancers(tmp_path: Path) -> None:
    rows, _ = columns("edge151")
    np.savez(tmp_path / "duo.npz", columns=rows, person_mask=MASK, fps=30)
    files = dancedata.decode(tmp_path / "duo.npz", "edge151", to="npz", out=tmp_path / "one")
    assert [f.name for f in files] == ["duo_p0.npz", "duo_p1.npz", "duo_p3.npz"]
    with np.load(files[2]) as written:
        joints = dancedata.decode(rows[3], "edge151").joints()
        np.testing.assert_allclose(written["positions"], joints, rtol=0, atol=1e-6)

    np.savez(tmp_path / "batch.npz", columns=np.stack([rows, rows]), person_mask=[MASK, ~MASK], fps=30)
    arguments = ["decode", str(tmp_path / "batch.npz"), "--field", "edge151", "--to", "bvh", "--out", str(tmp_path)]
    names = [Path(f).name for f in as_json(*arguments)["files"]]
    assert names == ["batch_000_p0.bvh", "batch_000_p1.bvh", "batch_000_p3.bvh", "batch_001_p2.bvh"]

    human, motions = columns("humanml263")
    places = np.stack([RootPlace().encode(m) for m in motions])[:, : human.shape[1]]
    np.savez(tmp_path / "human.npz", columns=human, root_place=places, fps=30)
    assert len(dancedata.decode(tmp_path / "human.npz", "humanml263", to="npz", out=tmp_path)) == 4


def test_files_whose_masks_are_of_other_groups(tmp_path: Path) -> None:
    rows, _ = columns("edge151")
    np.savez(tmp_path / "batch.npz", columns=np.stack([rows, rows]), person_mask=[MASK])
    with raises_message(UsageError, "person_mask", where="batch.npz"):
        dancedata.decode(tmp_path / "batch.npz", "edge151", to="npz", out=tmp_path / "out", fps=30)
    rows[1] = 0
    np.save(tmp_path / "plain.npy", np.stack([rows, rows]))
    with raises_message(DataError, "person_mask", reason="bad_shape"):
        dancedata.decode(tmp_path / "plain.npy", "edge151", to="npz", out=tmp_path / "out", fps=30)
    assert not (tmp_path / "out").exists()
