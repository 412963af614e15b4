"""The dataset reader aioz-gdance: groups, both forms, lists and what they share; columns against GCD's."""

import json
import pickle
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.contacts.velocity import Velocity
from dancedata.core.errors import DataError, SourceError
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.aioz_gdance import AiozGdance, frames_of, load_dancers, read_sizes
from dancedata.representations.gcd151 import Gcd151
from tests.datasets.scans import change_pickle, notes, rejects
from tests.messages import raises_message

READER = AiozGdance

DASH, LEAK = "-Ab_cdEf123_01_0_180", "-Ab_cdEf123_02_187_367"
BODY, PLAIN = "Zz9_8-7_6Q1_02_300_481", "plainid0123_04_829_1009"


def pickle_of(source: Path, name: str) -> Path:
    return source / "motions_smpl" / f"{name}.pkl"


def test_names_are_split_from_the_right() -> None:
    units = [AiozGdance().unit_of(name) for name in (DASH, BODY, PLAIN)]
    assert units == ["-Ab_cdEf123", "Zz9_8-7_6Q1", "plainid0123"]
    assert frames_of("-abcDEF_123_01_187_1358") == 1171


def test_scan(source: Path) -> None:
    scan = AiozGdance().scan(source)
    groups = {clip.group: clip.split for clip in scan.clips}
    assert groups == {DASH: "train", LEAK: "test", BODY: "val", PLAIN: "train"}
    assert [clip.id for clip in scan.clips if clip.group == LEAK] == [f"{LEAK}_p{k}" for k in range(3)]
    first = scan.clips[0]
    assert (first.member, first.role, first.dancer, first.music, first.genre) == (0, "", "", DASH, "Hip-Hop")
    assert (first.keys, first.columns) == ((("video", "-Ab_cdEf123"),), (("style", "Street"),))
    assert first.lists == ("train",)
    assert not scan.rejects
    assert "4 sequences (1 of 2, 1 of 3, 1 of 5, 1 of 7 dancers)" in notes(scan)
    (source / "musics").rename(source / "musics438")
    assert not AiozGdance().scan(source).rejects
    assert "Leak: 1 of 1 test are of videos of train (-Ab_cdEf123)" in notes(scan)


def test_by_video_keeps_videos_together(source: Path) -> None:
    scan = AiozGdance(split="by-video").scan(source)
    of = {clip.group: clip.split for clip in scan.clips}
    assert of[DASH] == of[LEAK]
    assert "Leak of the official lists, which are not used" in notes(scan)


def test_lists_and_files_that_do_not_agree(source: Path) -> None:
    train = source / "train_split_sequence_names.txt"
    train.write_text(f"{DASH},2,x\nplainid0123_09_0_200\n")
    (source / "split_dancerNum_2.txt").write_text(DASH)
    scan = AiozGdance().scan(source)
    assert {clip.group for clip in scan.clips} == {DASH, LEAK, BODY}
    assert scan.clips[0].lists == ("train", "dancers_2")
    assert rejects(scan, "unassigned") == [PLAIN]
    assert rejects(scan, "missing_motion") == ["plainid0123_09_0_200"]


def test_labels_by_their_titles(source: Path) -> None:
    table = source / "train_labels.csv"
    table.write_text(f"name,Genre A,genre B\n{DASH},Pop,Rock\n")
    with raises_message(SourceError, "columns", where="мой dänce/train_labels.csv"):
        AiozGdance().scan(source)
    for other in ("val", "test"):
        (source / f"{other}_labels.csv").unlink()
    table.write_text(f"name,level,genre B\n{DASH},Pop,Rock\n")
    first = AiozGdance().scan(source).clips[0]
    assert (first.genre, first.columns) == ("Rock", ())
    table.write_bytes(b"\xff\xfe")
    with raises_message(SourceError, "labels", where="мой dänce/train_labels.csv"):
        AiozGdance().scan(source)


def test_a_length_that_the_name_does_not_have(source: Path) -> None:
    path = pickle_of(source, DASH)
    content = pickle.loads(path.read_bytes())
    change_pickle(path, smpl_poses=content["smpl_poses"][:, :140], root_trans=content["root_trans"][:, :140])
    scan = AiozGdance().scan(source)
    assert scan.clips[0].notes == ("140 frames, but 180 by its name",)
    assert f"Lengths: 1 sequence: {DASH} (140 frames, but 180 by its name)" in notes(scan)


def test_dancers_share_one_world(source: Path) -> None:
    reader = AiozGdance()
    scan = reader.scan(source)
    for group in (DASH, LEAK, BODY, PLAIN):
        refs = [clip for clip in scan.clips if clip.group == group]
        motions = reader.load_group(refs)
        alone = [reader.load(ref) for ref in refs]
        raw = pickle.loads(pickle_of(source, group).read_bytes())
        for member, (motion, one) in enumerate(zip(motions, alone, strict=True)):
            assert motion.skeleton is SMPL24
            assert np.array_equal(motion.translation, raw["root_trans"][member])
            assert np.array_equal(motion.rotations, one.rotations)
        roots = np.stack([motion.translation for motion in motions])
        apart = np.linalg.norm(roots[:, None] - roots[None], axis=-1)
        assert apart[~np.eye(len(refs), dtype=bool)].min() > 0.5
    swapped = np.stack([motion.translation[:, 0] for motion in reader.load_group(scan.clips[2:4])])
    assert np.all(np.sign(np.diff(swapped[:, [0, -1]], axis=0)) == [[1, -1]])


def test_the_form_without_a_root(source: Path) -> None:
    path = pickle_of(source, BODY)
    raw = pickle.loads(path.read_bytes())
    (motion,) = load_dancers(path, [3])
    assert read_sizes(path).width == 63
    assert np.array_equal(motion.rotations[:, 0], raw["smpl_orients"][3])
    assert np.array_equal(motion.rotations[:, 1:22].reshape(-1, 63), raw["smpl_poses"][3])
    assert not motion.rotations[:, 22:].any()


def test_nan_in_one_dancer(source: Path) -> None:
    path = pickle_of(source, LEAK)
    trans = pickle.loads(path.read_bytes())["root_trans"]
    trans[1, 7] = np.nan
    change_pickle(path, root_trans=trans)
    assert len(load_dancers(path, [0, 2])) == 2
    with raises_message(DataError, "root_trans", where="-Ab_cdEf123_02_187_367.pkl, frame 7", reason="nan"):
        load_dancers(path, [0, 1])
    with raises_message(DataError, "dancer", where="-Ab_cdEf123_02_187_367.pkl", reason="missing_dancer"):
        load_dancers(path, [3])


@pytest.mark.parametrize(
    ("reason", "changes"),
    [
        ("contradiction", {"smpl_orients": np.zeros((2, 180, 3))}),
        ("bad_shape", {"smpl_poses": np.zeros((2, 180, 63))}),
        ("bad_shape", {"smpl_poses": np.zeros((2, 180, 64)), "smpl_orients": np.zeros((2, 180, 3))}),
        ("length_mismatch", {"smpl_poses": np.zeros((2, 180, 63)), "smpl_orients": np.zeros((2, 179, 3))}),
        ("unsafe_pickle", {"meta": Fraction(1)}),
    ],
)
def test_files_that_cannot_be_used(source: Path, reason: str, changes: dict[str, Any]) -> None:
    path = pickle_of(source, DASH)
    change_pickle(path, **changes)
    with raises_message(DataError, "frames|refers|smpl_poses", where="-Ab_cdEf123_01_0_180.pkl", reason=reason):
        read_sizes(path)
    scan = AiozGdance().scan(source)
    assert rejects(scan, reason) == [DASH]
    assert DASH not in {clip.group for clip in scan.clips}


def test_columns_of_gcd(shared: Path) -> None:
    crowd = shared / "golden" / "crowd"
    wanted = np.load(crowd / "gcd" / "whole_clips.npz")
    facts = json.loads((crowd / "gcd" / "facts.json").read_text())
    near = {tuple(place) for place in facts["contacts_too_near_to_call"]}
    reader = AiozGdance(split="by-video", music="optional")
    scan = reader.scan(crowd / "inputs" / "aioz_gdance")
    for name in {clip.group for clip in scan.clips}:
        path = next(clip.motion_path for clip in scan.clips if clip.group == name)
        sizes = read_sizes(path)
        motions = load_dancers(path, range(sizes.dancers))
        columns = np.stack([Gcd151().encode(motion, Velocity(max_speed_m_s=0.3)) for motion in motions])
        if name in wanted:
            np.testing.assert_allclose(columns[..., :-4], wanted[name][..., :-4], atol=1e-5)
        differs = np.argwhere(columns[..., -4:] != wanted[f"{name}.contacts"])
        assert {(name, *map(int, place)) for place in differs} <= near
