"""The dataset reader aioz-gdance: groups, names, lists and what they share; columns against TCDiff and GCD."""

import os
import pickle
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.contacts.velocity import Velocity
from dancedata.core.errors import DataError, SourceError
from dancedata.datasets.aioz_gdance import AiozGdance
from dancedata.datasets.aioz_gdance.motion import count_dancers, load_motions, write_example
from dancedata.datasets.aioz_gdance.reader import parse_name
from dancedata.readers import GroupDataset
from dancedata.representations.edge151 import Edge151
from dancedata.store import verify_store
from tests.datasets.scans import splits
from tests.messages import raises_message

PAIR, TRIO = "-Ab_cdEf123_01_0_180", "-Ab_cdEf123_02_187_370"
FIVE = "Zz9_8-7_6Q1_01_0_181"
SHARED = Path(os.environ.get("DANCEDATA_SHARED", "/nowhere"))
GOLDEN = SHARED / "golden" / "crowd"


@pytest.fixture
def source(tmp_path: Path) -> Path:
    write_example(tmp_path / "AIOZ dänce")
    return tmp_path / "AIOZ dänce"


def change(path: Path, **changes: Any) -> None:
    """Replace values of a pickle; None removes a key."""
    content = {**pickle.loads(path.read_bytes()), **changes}
    path.write_bytes(pickle.dumps({key: value for key, value in content.items() if value is not None}))


def content(source: Path, name: str) -> dict[str, Any]:
    read: dict[str, Any] = pickle.loads((source / "motions_smpl" / f"{name}.pkl").read_bytes())
    return read


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("-Ab_cdEf123_02_187_370", ("-Ab_cdEf123", "02", 187, 370)),
        ("Zz9_8-7_6Q1_01_0_181", ("Zz9_8-7_6Q1", "01", 0, 181)),
        ("plainid0123_01_829_1009", ("plainid0123", "01", 829, 1009)),
        ("short_01_0_180", None),
        ("plainid0123_01_180_180", None),
        ("plainid0123_01_0", None),
        ("plainid0123_01_0_1٣", None),
    ],
)
def test_names_are_taken_apart_from_the_right(name: str, parts: tuple[Any, ...] | None) -> None:
    parsed = parse_name(name)
    assert (None if parsed is None else tuple(parsed)) == parts


def test_scan(source: Path) -> None:
    scan = AiozGdance().scan(source)
    assert [ref.id for ref in scan.clips if ref.group == TRIO] == [f"{TRIO}_p{k}" for k in range(3)]
    assert Counter(splits(scan).values()) == {"train": 7, "test": 3, "val": 2}
    ref = scan.clips[0]
    assert (ref.group, ref.member, ref.music, ref.lists) == (PAIR, 0, PAIR, ("train",))
    assert (ref.keys, ref.columns, ref.genre) == (
        (("video", "-Ab_cdEf123"),),
        (("dance_style", "Street"),),
        "Hip-Hop",
    )
    assert [(r.reason, r.clip) for r in scan.rejects] == [("missing_motion", "plainid0123_09_0_200")]
    assert any("Leak: train and test share 1 video (-Ab_cdEf123)" in note for note in scan.notes)
    assert "the tracker's" in " ".join(scan.notes)


def test_videos_stay_together_by_rule(source: Path) -> None:
    scan = AiozGdance(split="by-video").scan(source)
    assert len({(dict(ref.keys)["video"], ref.split) for ref in scan.clips}) == 3
    assert any("Leak of the official lists, which are not used" in note for note in scan.notes)
    assert not AiozGdance(split="by-video").official_split


def test_the_parent_folder_music_and_lists_with_columns(source: Path) -> None:
    (source / "musics").rename(source / "music")
    lines = (source / "train_split_sequence_names.txt").read_text().splitlines()
    (source / "train_split_sequence_names.txt").write_text("".join(f"{line},5,x\n" for line in lines))
    assert Counter(splits(AiozGdance().scan(source.parent)).values()) == {"train": 7, "test": 3, "val": 2}
    (source / "train_labels.csv").write_text("a;b\n")
    assert AiozGdance().scan(source).clips[0].genre == ""


def test_what_is_missing_is_named(source: Path) -> None:
    (source / "musics" / f"{PAIR}.wav").rename(source / "musics" / "-Ab_cdEf123_09_0_10.wav")
    (source / "motions_smpl" / f"{FIVE}.pkl").write_bytes(b"nothing")
    scan = AiozGdance().scan(source)
    found = {(r.reason, r.clip) for r in scan.rejects}
    assert {("missing_music", PAIR), ("broken_file", FIVE)} <= found
    (source / "val_split_sequence_names.txt").write_text("")
    assert ("unassigned", "plainid0123_01_829_1009") in {
        (r.reason, r.clip) for r in AiozGdance().scan(source).rejects
    }


def test_lists_are_needed_and_hold_a_sequence_once(source: Path) -> None:
    names = source / "val_split_sequence_names.txt"
    names.write_text(f"{PAIR}\n")
    with raises_message(SourceError):
        AiozGdance().scan(source)
    (source / "test_split_sequence_names.txt").unlink()
    with raises_message(SourceError):
        AiozGdance().scan(source)


def test_both_forms_are_read(source: Path) -> None:
    motions = load_motions(source / "motions_smpl" / f"{PAIR}.pkl")
    assert [(m.n_frames, m.rotations.shape) for m in motions] == [(180, (180, 24, 3))] * 2
    read = content(source, FIVE)
    five = load_motions(source / "motions_smpl" / f"{FIVE}.pkl")
    np.testing.assert_array_equal(five[3].rotations[:, 0], read["smpl_orients"][3])
    np.testing.assert_array_equal(five[3].rotations[:, 1:22].reshape(181, 63), read["smpl_poses"][3])
    assert not five[3].rotations[:, 22:].any()
    assert count_dancers(source / "motions_smpl" / f"{FIVE}.pkl") == 5


BAD: dict[str, Any] = {
    "other dancers": lambda c: {"root_trans": c["root_trans"][:1]},
    "nan in one dancer": lambda c: {"root_trans": c["root_trans"] * np.array([1, np.nan])[:, None, None]},
    "72 and orients": lambda c: {"smpl_orients": c["smpl_poses"][..., :3]},
    "63 alone": lambda c: {"smpl_poses": c["smpl_poses"][..., :63]},
    "one dancer": lambda c: {"smpl_poses": c["smpl_poses"][0]},
    "no frames": lambda c: {"smpl_poses": c["smpl_poses"][:, :0], "root_trans": c["root_trans"][:, :0]},
    "no trans": lambda c: {"root_trans": None},
    "orients of another length": lambda c: {
        "smpl_poses": c["smpl_poses"][..., 3:66], "smpl_orients": c["smpl_poses"][:, :9, :3],
    },
}  # fmt: skip


@pytest.mark.parametrize("change_of", BAD.values(), ids=BAD)
def test_bad_pickles_are_refused(source: Path, change_of: Any) -> None:
    path = source / "motions_smpl" / f"{PAIR}.pkl"
    change(path, **change_of(content(source, PAIR)))
    with raises_message(DataError):
        load_motions(path)


def test_a_name_that_states_other_frames_is_refused(source: Path) -> None:
    read = content(source, PAIR)
    change(
        source / "motions_smpl" / f"{PAIR}.pkl",
        smpl_poses=read["smpl_poses"][:, :150], root_trans=read["root_trans"][:, :150],
    )  # fmt: skip
    ref = next(ref for ref in AiozGdance().scan(source).clips if ref.group == PAIR)
    with raises_message(DataError):
        AiozGdance().load(ref)


def test_a_build_holds_groups(source: Path, tmp_path: Path, cache: Path) -> None:
    built = dancedata.build("aioz-gdance", source, tmp_path / "out", jobs=1, cache=cache, progress=False)
    store = built.open()
    problems = verify_store(tmp_path / "out")
    assert {p.severity for p in problems} <= {"note"}
    assert store.meta["split_rule"] == "official"
    assert {split: counts["groups"] for split, counts in store.meta["counts"].items()} == {
        "train": 2, "val": 1, "test": 1,
    }  # fmt: skip
    dataset = GroupDataset(store, "train", persons=5)
    assert dataset[0]["edge151"].shape == (5, 150, 151)
    assert {s["group"] for s in (dataset[k] for k in range(len(dataset)))} == {PAIR, FIVE}
    # 1.2 m apart, as in the source.
    clips = [store.clip(f"{PAIR}_p{k}").read("edge151")[:, 4:7] for k in range(2)]
    places = content(source, PAIR)["root_trans"]
    np.testing.assert_allclose(
        np.linalg.norm(clips[0] - clips[1], axis=1), np.linalg.norm(places[0] - places[1], axis=1), atol=1e-5
    )


@pytest.mark.skipif(not GOLDEN.is_dir(), reason="needs the reference outputs")
def test_columns_are_those_of_gcd() -> None:
    """Place and 6D within 1e-5; theirs are +Y up with the contacts last, EDGE's world is (x, -z, y)."""
    folder, whole = GOLDEN / "inputs" / "aioz_gdance" / "motions_smpl", np.load(GOLDEN / "gcd" / "whole_clips.npz")
    (name,) = (key for key in whole.files if not key.endswith(".contacts"))
    motions = load_motions(folder / f"{name}.pkl")
    assert len(motions) == len(whole[name])
    for motion, theirs in zip(motions, whole[name], strict=True):
        rows = Edge151().encode(motion, Velocity(max_speed_m_s=0.3))
        np.testing.assert_allclose(rows[:, 4:7][:, [0, 2, 1]] * (1, 1, -1), theirs[:, :3], atol=1e-5)
        np.testing.assert_allclose(rows[:, 13:], theirs[:, 9:147], atol=1e-5)  # joints 1 to 23


@pytest.mark.skipif(not GOLDEN.is_dir(), reason="needs the reference outputs")
def test_windows_are_those_of_tcdiff() -> None:
    """Place and 6D within 1e-5; the last frame of its windows has no next one, so contacts are all 1 there."""
    folder, windows = GOLDEN / "inputs" / "aioz_gdance" / "motions_smpl", np.load(GOLDEN / "tcdiff" / "windows.npz")
    motions = load_motions(folder / "-Ab_cdEf123_02_187_367.pkl")
    rows = np.stack([Edge151().encode(motion.part(0, 150), Velocity(max_speed_m_s=0.3)) for motion in motions])
    theirs = windows["train0.raw_first_last"]
    np.testing.assert_allclose(rows[:, [0, 1, 148, 149], 4:], theirs[..., 4:], atol=1e-5)
    np.testing.assert_array_equal(rows[..., :4], windows["train0.contacts"])
