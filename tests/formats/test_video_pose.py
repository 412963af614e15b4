"""Files of WHAM, PHALP, GVHMR and others: read, divided by people, put on the frames of the video, built."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import dancedata
from dancedata.building.build import build
from dancedata.core.audio_signal import wav_bytes
from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.rotations import matrix_from_rotvec
from dancedata.core.skeleton import SMPL24
from dancedata.datasets.folder import Folder
from dancedata.files.documents import document_of
from dancedata.formats.video_pose import open_people
from dancedata.recipes.parse import parse_recipe
from tests.messages import raises_message
from tests.video_files import dance, gvhmr, in_camera, joblib_bytes, phalp, torch_file, wham, wham_person

N = 60


def loaded(path: Path, **parameters: Any) -> Any:
    dataset = Folder(**{"fps": 30, "music": "optional", **parameters})
    return {ref.id: (ref, dataset.load(ref)) for ref in dataset.scan(path.parent).clips}


def load_one(path: Path, **declared: str) -> Motion:
    ref = ClipRef("a", path, None, "train", declared=tuple(sorted(declared.items())))
    return Folder(fps=30, music="optional").load(ref)


def refused(path: Path, **parameters: Any) -> DataError:
    dataset = Folder(**{"fps": 30, "music": "optional", **parameters})
    with raises_message(DataError, "axis-angle|person|pred_camera|pred_thetas|video") as error:
        dataset.load(ClipRef(path.stem, path, None, "train", declared=parameters.pop("declared", ())))
    return error.value


def close(motion: Any, rotations: Any, path: Any, atol: float = 1e-5) -> None:
    np.testing.assert_allclose(matrix_from_rotvec(motion.rotations), matrix_from_rotvec(rotations), atol=atol)
    np.testing.assert_allclose(motion.translation, path, atol=atol)


@pytest.mark.parametrize("compress", [0, 3])
def test_two_people_of_wham_become_two_clips(tmp_path: Path, compress: int) -> None:
    path = tmp_path / "wham_output.pkl"
    path.write_bytes(wham({4: wham_person(N, seed=1), 17: wham_person(N - 9, seed=2)}, compress))
    clips = loaded(path, people="split")
    assert list(clips) == ["wham_output-person17", "wham_output-person4"]
    for name, (seed, length) in {"wham_output-person4": (1, N), "wham_output-person17": (2, N - 9)}.items():
        motion = clips[name][1]
        assert (motion.n_frames, motion.trim_start, motion.skeleton.name) == (length, 0, "smpl24")
        close(motion, *dance(length, seed))
    assert "layout wham on smpl's 24 joints: 30 FPS (declared in the recipe); +Y up (WHAM's world); m" in str(
        clips["wham_output-person4"][0].notes
    )


def test_two_people_whose_numbers_read_alike_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "wham_output.pkl"
    path.write_bytes(wham({1: wham_person(9), "1": wham_person(9)}))
    with raises_message(DataError, "program", where="wham_output.pkl", reason="bad_shape"):
        open_people(path)


def test_several_people_have_to_be_chosen(tmp_path: Path) -> None:
    path = tmp_path / "wham_output.pkl"
    path.write_bytes(wham({4: wham_person(N), 17: wham_person(9)}))
    assert refused(path).reason == "several_people"
    for person, length in (("4", N), ("17", 9)):
        assert load_one(path, person=person).n_frames == length
    with raises_message(DataError, "correct", where="wham_output.pkl", reason="missing_person"):
        load_one(path, person="5")


def test_one_person_needs_no_choice(tmp_path: Path) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(wham({0: wham_person(N)}))
    assert list(loaded(path)) == ["a"]
    assert list(loaded(path, people="split")) == ["a-person0"]


def test_a_manifest_chooses_people(tmp_path: Path) -> None:
    (tmp_path / "two.pkl").write_bytes(wham({0: wham_person(N, seed=1), 1: wham_person(N, seed=2)}))
    lines = ["id,motion,person,dancer,fps", "anna,two.pkl,1,anna,60", "all,two.pkl,,,25"]
    (tmp_path / "manifest.csv").write_text("\n".join(lines))
    dataset = Folder(music="optional", people="split")
    found = {ref.id: (ref.dancer, str(dataset.load(ref).grid)) for ref in dataset.scan(tmp_path).clips}
    assert found == {"anna": ("anna", "60"), "all-person0": ("", "25"), "all-person1": ("", "25")}


def test_frames_before_a_person_appears_and_short_gaps(tmp_path: Path) -> None:
    person = wham_person(N, first=5, seed=3)
    keep = np.delete(np.arange(N), [20, 21, 22])
    (tmp_path / "a.pkl").write_bytes(wham({0: {name: value[keep] for name, value in person.items()}}))
    ref, motion = loaded(tmp_path / "a.pkl")["a"]
    rotations, path = dance(N, 3)
    assert (motion.n_frames, motion.trim_start) == (N + 5, 5)
    assert "Video: first seen in frame 5 of the video" in ref.notes[1]
    assert "3 frames of 60 interpolated" in ref.notes[1]
    np.testing.assert_array_equal(motion.rotations[:5], np.repeat(motion.rotations[5:6], 5, axis=0))
    np.testing.assert_allclose(motion.rotations[5 + keep], rotations[keep], atol=1e-6)
    # Of a smooth dance the interpolated frames are near the true ones, and equal to neither neighbour.
    inner = np.abs(motion.rotations[25:28] - rotations[20:23]).max()
    assert 1e-4 < inner < 0.1
    np.testing.assert_allclose(motion.translation[25:28], path[20:23], atol=0.05)


@pytest.mark.parametrize(
    ("frames", "reason"),
    [
        (np.r_[:30, 41:71], "missing_frames"), (np.r_[:30, 30:60][::-1], "missing_frames"),
        (np.r_[:30, 29:59], "missing_frames"), (np.arange(N) - 1, "missing_frames"),
        (np.arange(N) + 200_000, "missing_frames"), (np.arange(N - 1), "length_mismatch"),
        (np.arange(N) + 0.5, "bad_shape"),
    ],
)  # fmt: skip
def test_frames_that_cannot_be_put_on_the_video(tmp_path: Path, frames: Any, reason: str) -> None:
    path = tmp_path / "a.pkl"
    path.write_bytes(wham({0: {**wham_person(N, vertices=4), "frame_ids": frames}}))
    assert refused(path).reason == reason


@pytest.mark.parametrize("compress", [0, 3])
def test_people_of_phalp(tmp_path: Path, compress: int) -> None:
    path = tmp_path / "demo_clip.pkl"
    gap = np.delete(np.arange(N), [30, 31])
    one, two = dance(N, 1), dance(N, 2)
    path.write_bytes(phalp({1: (*one, np.arange(N)), 3: (two[0][gap], two[1][gap], gap)}, compress))
    clips = loaded(path, people="split")
    assert list(clips) == ["demo_clip-person1", "demo_clip-person3"]
    close(clips["demo_clip-person1"][1], *one)
    ref, motion = clips["demo_clip-person3"]
    np.testing.assert_allclose(motion.translation[gap], two[1][gap], atol=1e-5)
    assert motion.n_frames == N
    assert "2 frames of 60 interpolated" in str(ref.notes)
    assert "-Y up (PHALP's camera axes), rotated to +Y" in str(ref.notes)


def test_gvhmr(tmp_path: Path) -> None:
    path = tmp_path / "hmr4d_results.pt"
    path.write_bytes(torch_file(gvhmr(N, 4)))
    ref, motion = loaded(path)["hmr4d_results"]
    assert motion.skeleton.name == "smplx55"
    rotations, transl = dance(N, 4, 22)
    np.testing.assert_allclose(motion.rotations[:, :22], rotations, atol=1e-6)
    np.testing.assert_allclose(motion.translation, transl, atol=1e-6)
    assert not motion.rotations[:, 22:].any()
    assert "layout gvhmr on smplx's 55 joints" in str(ref.notes)
    with raises_message(DataError, "body_pose", where="hmr4d_results.pt", reason="undeclared"):
        Folder(music="optional").load(ref)


def test_positions_and_degrees_of_wham_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "wham_output.pkl"
    good = wham_person(N, vertices=4)
    rotations, path_of = dance(N, 1)
    places = Motion(path_of, rotations, FrameGrid.of(30), SMPL24).joints()
    for pose, trans in (
        (places, places[:, 0]),
        (places - places[:, :1], places[:, 0] * 0),
        (np.degrees(good["pose_world"]), good["trans_world"]),
    ):
        wrong = {**good, "pose_world": pose.reshape(N, 72), "trans_world": trans}
        path.write_bytes(wham({4: good, 17: wrong}))
        with raises_message(DataError, "pose_world", where="wham_output.pkl", reason="not_rotations"):
            load_one(path, person="17")
        load_one(path, person="4")


@pytest.mark.parametrize(
    "change", [lambda m: m * 1.1, lambda m: m * [1, 1, -1], lambda m: m * 0], ids=["scaled", "reflected", "zeros"]
)
def test_matrices_of_phalp_that_are_not_rotations(tmp_path: Path, change: Any) -> None:
    path = tmp_path / "demo_clip.pkl"
    body = np.tile(np.eye(3), (23, 1, 1))
    body[4] = change(body[4])
    pose = {"global_orient": np.eye(3)[None], "body_pose": body, "betas": np.zeros(10)}
    frame = {"tid": [1], "tracked_time": [0], "camera": [np.zeros(3)]}
    right = {**pose, "body_pose": np.tile(np.eye(3), (23, 1, 1))}
    path.write_bytes(
        joblib_bytes({f"{k}.jpg": {**frame, "time": k, "smpl": [pose if k == 7 else right]} for k in range(9)})
    )
    assert refused(path).reason == "bad_rotation"


def hybrik(n_frames: int, **changes: Any) -> dict[str, Any]:
    """Return the content of HybrIK's res.pk: rotation matrices, the camera's axes."""
    rotations, path = dance(n_frames, 5)
    matrices = matrix_from_rotvec(rotations)
    turn = np.diag([1.0, -1.0, -1.0])
    matrices[:, 0] = turn @ matrices[:, 0]
    found = {"pred_thetas": matrices.reshape(n_frames, 216).astype(np.float32), "transl": in_camera(path)}
    found |= {"pred_camera": np.full((n_frames, 3), [0.5, 0.1, 0.2]), "img_path": np.array(["a.jpg"] * n_frames)}
    return {**found, **changes}


KEYS = {"rotation": "pred_thetas", "translation": "transl"}


def test_arrays_that_the_recipe_names(tmp_path: Path) -> None:
    path = tmp_path / "res.pk"
    path.write_bytes(pickle.dumps(hybrik(N)))
    rotations, transl = dance(N, 5)
    close(loaded(path, keys=KEYS, up="-y", unit="m")["res"][1], rotations, transl)
    scaled = loaded(path, keys={**KEYS, "scale": "pred_camera"}, up="-y", unit="m")["res"][1]
    np.testing.assert_allclose(in_camera(scaled.translation), in_camera(transl) / 0.5, atol=1e-5)
    # WHAM's motion in the camera's axes, in place of the world's.
    camera = tmp_path / "other" / "camera.pkl"
    camera.parent.mkdir()
    camera.write_bytes(wham({0: wham_person(N, seed=6, vertices=4)}))
    found = loaded(camera, keys={"rotation": "pose", "translation": "trans"}, up="-y", unit="m", layout="auto")
    turned = found["camera"][1]
    np.testing.assert_allclose(turned.rotations, dance(N, 6)[0], atol=1e-5)
    assert refused(path, up="-y", unit="m").reason == "missing_key"


@pytest.mark.parametrize(
    ("changes", "keys", "reason"),
    [
        ({"pred_thetas": np.zeros((N, 70))}, {}, "bad_shape"),
        ({"pred_thetas": np.zeros((N, 216))}, {}, "bad_rotation"),
        ({"pred_thetas": -np.tile(np.eye(3).ravel(), (N, 24))}, {}, "bad_rotation"),
        ({"pred_thetas": np.full((N, 216), np.nan)}, {}, "nan"),
        ({"pred_camera": np.zeros((N, 3))}, {"scale": "pred_camera"}, "bad_scaling"),
        ({"pred_camera": np.ones((N - 1, 3))}, {"scale": "pred_camera"}, "bad_scaling"),
        ({"pred_camera": np.ones((0, 3))}, {"scale": "pred_camera"}, "bad_scaling"),
        ({"pred_camera": np.ones((N, 1, 3))}, {"scale": "pred_camera"}, "bad_scaling"),
        ({}, {"scale": "nothing"}, "missing_key"),
        ({"transl": np.zeros((N - 1, 3))}, {}, "length_mismatch"),
    ],
)
def test_named_arrays_that_do_not_fit(tmp_path: Path, changes: Any, keys: Any, reason: str) -> None:
    path = tmp_path / "res.pk"
    path.write_bytes(pickle.dumps(hybrik(N, **changes)))
    assert refused(path, keys={**KEYS, **keys}, up="-y", unit="m").reason == reason


@pytest.mark.parametrize("keys", [{"rotations": "a"}, {"rotation": "a"}, {}])
def test_keys_that_are_incomplete(keys: Any) -> None:
    with raises_message(UsageError, "scale"):
        Folder(keys=keys)


def test_people_shape_the_scan_and_keys_the_loading() -> None:
    assert document_of(Folder(people="split"))["people"] == "split"
    assert document_of(Folder(people="split", keys=KEYS), loading=True)["keys"] == KEYS
    assert "people" not in document_of(Folder(people="split"), loading=True)


def test_files_of_phalp_that_contradict_themselves(tmp_path: Path) -> None:
    path = tmp_path / "a.pkl"
    good = {"time": 0, "tid": [1], "tracked_time": [0], "camera": [np.zeros(3)]}
    pose = {"global_orient": np.eye(3)[None], "body_pose": np.tile(np.eye(3), (23, 1, 1)), "betas": np.zeros(10)}
    for change in (
        {"tid": [1, 2]}, {"tid": None}, {"tid": ["x"]}, {"tracked_time": []}, {"time": "x"}, {"smpl": [None]},
        {"smpl": [{**pose, "body_pose": np.zeros((21, 3, 3))}]}, {"smpl": [{"betas": 1}]}, {"camera": ["x"]},
    ):  # fmt: skip
        path.write_bytes(joblib_bytes({"0.jpg": {**good, "smpl": [pose], **change}}))
        error = refused(path)
        assert error.reason == "bad_shape", change
    # Found by fuzzing: a number beyond float64 must not cause a warning.
    large = {**pose, "betas": np.full(10, np.finfo(np.longdouble).max)}
    path.write_bytes(joblib_bytes({"0.jpg": {**good, "smpl": [large]}}))
    assert load_one(path).n_frames == 1
    # A list that occurs a hundred thousand times.
    row = {**good, "tid": [1] * 100, "tracked_time": [0] * 100, "smpl": [pose] * 100, "camera": [np.zeros(3)] * 100}
    path.write_bytes(joblib_bytes({str(k): row for k in range(1000)}))
    assert "more people than a file of its size" in str(refused(path))
    path.write_bytes(joblib_bytes({"0.jpg": {**good, "smpl": [pose], "tracked_time": [1]}}))
    assert refused(path).reason == "empty"


def test_a_dataset_of_people(tmp_path: Path) -> None:
    source = tmp_path / "source"
    (source / "motions").mkdir(parents=True)
    (source / "music").mkdir()
    n = 100
    (source / "motions" / "wham.pkl").write_bytes(wham({0: wham_person(n, seed=1), 1: wham_person(n, seed=2)}))
    (source / "motions" / "phalp.pkl").write_bytes(phalp({2: (*dance(n, 3), np.arange(n))}))
    (source / "motions" / "gvhmr.pt").write_bytes(torch_file(gvhmr(n)))
    call = b"X\x01\0\0\0xcos\nsystem\n(S'touch PWNED'\ntRss."
    bad = joblib_bytes({0: {"pose_world": 1}}, 0, 2).removesuffix(b"s.") + call
    (source / "motions" / "bad.pkl").write_bytes(bad)
    noise = np.random.default_rng(0).integers(-9000, 9000, (64_000, 1)).astype(np.int16)
    for name in ("wham", "phalp", "gvhmr", "bad"):
        (source / "music" / f"{name}.wav").write_bytes(wav_bytes(noise, 16_000))
    recipe = {
        "recipe": 1, "name": "video", "dataset": {"folder": {"fps": 30, "people": "split"}},
        "motion": {"edge151": {}}, "windows": {"length_s": 2, "stride_s": 1},
    }  # fmt: skip
    build(parse_recipe(recipe), source, tmp_path / "out", cache=tmp_path / "cache")
    with dancedata.open(tmp_path / "out") as ds:
        assert [c.id for c in ds] == ["gvhmr", "phalp-person2", "wham-person0", "wham-person1"]
        joints = {c.id: ds[c.id].read("edge151") for c in ds}
    assert not np.array_equal(joints["wham-person0"], joints["wham-person1"])
    assert '"unsafe_pickle"' in (tmp_path / "out" / "rejects.jsonl").read_text()
    assert not list(tmp_path.rglob("PWNED"))
    assert not Path("PWNED").exists()


# ---- one person whom a program lost and found again under other numbers

LONG = 240


def chunk(whole: dict[str, Any], frames: range, yaw: float = 0.0) -> dict[str, Any]:
    """Return some frames of a person of WHAM, in a world of their own that begins at the origin."""
    part = {name: values[frames.start : frames.stop].copy() for name, values in whole.items()}
    turn, rest = Rotation.from_euler("y", yaw), np.array(SMPL24.offsets[0])
    pelvis = turn.apply(part["trans_world"] + rest)
    part["trans_world"] = pelvis - pelvis[0] * (1, 0, 1) + (0.3, 0.1, 0) - rest
    part["pose_world"][:, :3] = (turn * Rotation.from_rotvec(part["pose_world"][:, :3])).as_rotvec()
    return part


@pytest.mark.parametrize("keys", [(0, 4, 17, 31), tuple(np.unique([0, 4, 17, 31])), ("0", "4", "17", "31")])
def test_tracks_of_one_person_are_one_clip(tmp_path: Path, keys: tuple[Any, ...]) -> None:
    whole = wham_person(LONG, vertices=2)
    spans = (range(60), range(61, 130), range(136, 180), range(180, LONG))
    parts = [chunk(whole, span, yaw) for span, yaw in zip(spans, (0.0, 1.0, -2.5, 3.0), strict=True)]
    path = tmp_path / "anna.pkl"
    path.write_bytes(wham(dict(zip(keys, parts, strict=True))))
    motion = load_one(path)
    assert motion.n_frames == LONG
    (tmp_path / "whole.pkl").write_bytes(wham({0: chunk(whole, range(LONG))}))
    expected = load_one(tmp_path / "whole.pkl")
    seen = np.concatenate([np.arange(span.start, span.stop) for span in spans])
    # The body itself is exact; where it goes on, it does so as fast as before.
    np.testing.assert_allclose(motion.rotations[seen, 1:], expected.rotations[seen, 1:], atol=1e-6)
    assert np.abs(motion.joints()[seen] - expected.joints()[seen]).max() < 0.1
    assert np.linalg.norm(np.diff(motion.translation, axis=0), axis=1).max() < 0.1
    assert load_one(path, person=str(keys[2])).n_frames == spans[2].stop  # one track, by its number
    (clip,) = Folder(fps=30, music="optional", people="split").scan(_source(path)).clips
    assert clip.id == "anna"
    assert "0, 4, 17, 31" in " ".join(clip.notes)


def _source(path: Path) -> Path:
    source = path.parent / "source"
    (source / "motions").mkdir(parents=True)
    (source / "motions" / path.name).write_bytes(path.read_bytes())
    return source


def other(part: dict[str, Any], what: str) -> dict[str, Any]:
    if what == "another pose":
        part["pose"][:, 3:] += 1.2
        part["pose_world"][:, 3:] += 1.2
    elif what == "another place":
        part["trans"] += (2, 0, 0)
    elif what == "much later":
        part["frame_ids"] += 20
    elif what == "at the same time":
        part["frame_ids"] -= 5
    return part


@pytest.mark.parametrize("what", ["another pose", "another place", "much later", "at the same time"])
def test_other_people_are_not_joined(tmp_path: Path, what: str) -> None:
    whole = wham_person(LONG, vertices=2)
    path = tmp_path / "two.pkl"
    path.write_bytes(wham({1: chunk(whole, range(100)), 2: other(chunk(whole, range(101, LONG)), what)}))
    with raises_message(DataError, "split", where="two.pkl", reason="several_people"):
        load_one(path)
    clips = Folder(fps=30, music="optional", people="split").scan(_source(path)).clips
    assert [clip.id for clip in clips] == ["two-person1", "two-person2"]


def test_two_dancers_of_whom_one_is_lost(tmp_path: Path) -> None:
    anna, ben = wham_person(LONG, vertices=2), wham_person(LONG, seed=5, vertices=2)
    ben["trans"] = ben["trans"] + np.float32([3, 0, 0])
    path = tmp_path / "duet.pkl"
    path.write_bytes(wham({0: chunk(anna, range(90)), 1: ben, 7: chunk(anna, range(93, LONG))}))
    folder = Folder(fps=30, music="optional", people="split")
    clips = folder.scan(_source(path)).clips
    assert [clip.id for clip in clips] == ["duet-person0", "duet-person1"]
    assert [folder.load(clip).n_frames for clip in clips] == [LONG, LONG]


def test_two_tracks_that_go_on_in_the_same_one_are_left(tmp_path: Path) -> None:
    whole = wham_person(LONG, vertices=2)
    path = tmp_path / "three.pkl"
    path.write_bytes(
        wham({0: chunk(whole, range(90)), 1: chunk(whole, range(20, 91)), 2: chunk(whole, range(95, LONG))})
    )
    clips = Folder(fps=30, music="optional", people="split").scan(_source(path)).clips
    assert len(clips) == 3


def test_tracks_of_phalp(tmp_path: Path) -> None:
    rotations, path_of = dance(60)
    people = {3: (rotations[:30], path_of[:30], np.arange(30)), 8: (rotations[33:], path_of[33:], np.arange(33, 60))}
    path = tmp_path / "demo.pkl"
    path.write_bytes(phalp(people))
    assert load_one(path).n_frames == 60
