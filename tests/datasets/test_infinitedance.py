"""The dataset reader infinitedance: lists, styles, origins, fits, columns, tokens and features without audio."""

import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import dancedata
from dancedata.core.bodies import SMPLX22
from dancedata.core.errors import DataError, SourceError, StoreError
from dancedata.datasets import infinitedance as layout
from dancedata.datasets.infinitedance import InfiniteDance, load_columns
from dancedata.recipes.parse import load_recipe
from dancedata.store import Store, verify_store
from dancedata.torch import WindowDataset
from tests.datasets.scans import load, notes, rejects, splits
from tests.messages import raises_message
from tests.video_files import joblib_bytes

READER = InfiniteDance

OWN, LIVE, AIST, TEST = "video_0001", "my clip 2 (live)", "gBR_sBM_cAll_d04_mBR0_ch02", "video_0002"


def fit_of(source: Path, clip: str = OWN) -> dict[str, Any]:
    content: dict[str, Any] = pickle.loads((source / layout.FITS_FOLDER / f"{clip}.pkl").read_bytes())
    return content


def change(path: Path, **changes: Any) -> None:
    """Replace values of a fit; None removes a key."""
    content = {**pickle.loads(path.read_bytes()), **changes}
    path.write_bytes(joblib_bytes({key: value for key, value in content.items() if value is not None}))


def test_scan_of_fits(source: Path) -> None:
    scan = InfiniteDance().scan(source)
    assert splits(scan) == {OWN: "train", LIVE: "train", TEST: "test"}
    first = next(clip for clip in scan.clips if clip.id == OWN)
    assert (first.audio_path, first.music, first.genre, first.columns) == (
        None, OWN, "Popular", (("origin", "infinitedance"),),
    )  # fmt: skip
    assert first.lists == ("All_cleandata_train", "All_train", "infinitedance_train")
    assert rejects(scan, "missing_motion") == [AIST]
    assert "3 files; 9,748 fits were published)" in notes(scan)
    assert "3 names of All_cleandata_train.txt are train, 1 of test_eval861.txt test, no val" in notes(scan)


def test_scan_of_columns(source: Path) -> None:
    scan = InfiniteDance(motion="columns").scan(source)
    assert splits(scan) == {OWN: "train", LIVE: "train", AIST: "train", TEST: "test"}
    assert not scan.rejects
    aist = next(clip for clip in scan.clips if clip.id == AIST)
    assert (aist.music, aist.dancer, aist.genre, aist.columns) == ("mBR0", "d04", "", (("origin", "aist++"),))
    assert "Origin of the clips: 1 aist++, 3 infinitedance; clips of other datasets keep their own terms" in notes(
        scan
    )
    assert "AIST Dance Video Database" in notes(scan)
    assert f"Styles: none of 1 clips, whose genre is empty: {AIST}" in notes(scan)
    assert f"Columns: 1 clip in {layout.TEST_FOLDER}/ as well, not read: {TEST}" in notes(scan)
    assert next(c.motion_path for c in scan.clips if c.id == TEST) == source / layout.COLUMNS_FOLDER / f"{TEST}.npy"
    (source / layout.COLUMNS_FOLDER / f"{TEST}.npy").unlink()
    own = InfiniteDance(motion="columns", clips="own").scan(source)
    assert next(c.motion_path for c in own.clips if c.id == TEST) == source / layout.TEST_FOLDER / f"{TEST}.npy"
    assert "as well" not in notes(own)
    assert rejects(own, "other_dataset") == [AIST]
    assert splits(own) == {OWN: "train", LIVE: "train", TEST: "test"}


def test_origins(source: Path) -> None:
    """Lists of datasets first; then names as those datasets publish them; then an own fit; never a guess."""
    columns = source / layout.COLUMNS_FOLDER
    others = "kthjazz_gCH_sFM_cAll_d02_mCH_ch01_x_006", "gHO_sBM_cAll_d19_mHO3_ch01"
    for name in ("042", *others, "kthmisc_x", "strange"):
        (columns / f"{name}.npy").write_bytes(b"")
    (source / "partition" / "finedance_eval.txt").write_text("042\nkthmisc_x")
    scan = InfiniteDance(motion="columns", split="all").scan(source)
    origins = {clip.id: dict(clip.columns)["origin"] for clip in scan.clips}
    assert origins == {
        "042": "finedance", "kthjazz_gCH_sFM_cAll_d02_mCH_ch01_x_006": "motorica",
        "gHO_sBM_cAll_d19_mHO3_ch01": "aist++", "kthmisc_x": "finedance", "strange": "unknown", AIST: "aist++",
        OWN: "infinitedance", LIVE: "infinitedance", TEST: "infinitedance",
    }  # fmt: skip
    assert "unknown: on no list of one dataset" in notes(scan)


def test_full_lists_and_no_split(source: Path) -> None:
    (source / "partition" / "All_train.txt").write_text(OWN)
    scan = InfiniteDance(split="full").scan(source)
    assert splits(scan) == {OWN: "train", TEST: "test"}
    assert rejects(scan, "unassigned") == [LIVE]
    everything = InfiniteDance(split="all").scan(source)
    assert set(splits(everything).values()) == {"all"}
    assert not InfiniteDance(split="all").official_split


def test_lists_that_cannot_be_used(source: Path) -> None:
    (source / "partition" / "test_eval861.txt").write_text(f"{TEST}\n{OWN}\n")
    with raises_message(SourceError, r"All_cleandata_train\.txt", where="мой dänce/partition"):
        InfiniteDance().scan(source)
    (source / "partition" / "test_eval861.txt").unlink()
    with raises_message(SourceError, r"All_cleandata_train\.txt", where="мой dänce/partition"):
        InfiniteDance().scan(source)


def test_songs_of_both_lists_are_named(source: Path) -> None:
    other = "gBR_sFM_cAll_d05_mBR0_ch07"
    (source / layout.COLUMNS_FOLDER / f"{AIST}.npy").rename(source / layout.COLUMNS_FOLDER / f"{other}.npy")
    (source / "partition" / "test_eval861.txt").write_text(f"{TEST}\n{other}\n")
    assert "songs of AIST++ in both: mBR0" in notes(InfiniteDance(motion="columns").scan(source))


def test_names_with_an_at_sign_are_left_out(source: Path) -> None:
    """InfiniteDance's retrieval names pieces NAME@START_END."""
    fits = source / layout.FITS_FOLDER
    (fits / f"{OWN}@0_96.pkl").write_bytes((fits / f"{OWN}.pkl").read_bytes())
    scan = InfiniteDance().scan(source)
    assert rejects(scan, "extra_file") == [f"{layout.FITS_FOLDER}/{OWN}@0_96.pkl"]
    assert "separates names from frames" in scan.rejects[-1].detail


def test_styles(source: Path) -> None:
    styles = source / "styles"
    (styles / f"{OWN}.json").write_text('{"style": "Latin"}')
    (styles / f"{LIVE}.json").write_text('["Folk"]')
    (styles / "all_style_map.json").write_text(json.dumps({OWN: "Popular"}))
    scan = InfiniteDance().scan(source)
    assert {clip.id: clip.genre for clip in scan.clips} == {OWN: "Popular", LIVE: "", TEST: "Modern"}
    assert f"1 files contradict all_style_map.json, which counts: {OWN} ('Latin', not 'Popular')" in notes(scan)
    assert rejects(scan, "bad_style") == [LIVE]
    (styles / "all_style_map.json").write_text('{"video_0001": 3}')
    with raises_message(SourceError, "STYLE", where="мой dänce/styles/all_style_map.json"):
        InfiniteDance().scan(source)


def test_a_fit(source: Path) -> None:
    content = fit_of(source)
    motion = load(InfiniteDance(), source / layout.FITS_FOLDER / f"{OWN}.pkl")
    assert (motion.n_frames, motion.grid.rate, motion.skeleton) == (182, 30, SMPLX22)
    np.testing.assert_allclose(motion.translation, content["transl"], atol=1e-6)
    np.testing.assert_allclose(motion.rotations[:, 1:], content["body_pose"].reshape(182, 21, 3), atol=1e-6)
    assert (motion.joints()[:, 15, 1] > motion.joints()[:, 0, 1]).all()


@pytest.mark.parametrize("shape", [(182, 63), (182, 21, 3), (182, 69), (182, 23, 3)])
@pytest.mark.parametrize("compress", [0, 3])
def test_shapes_of_joblib_files(source: Path, shape: tuple[int, ...], compress: int) -> None:
    path = source / layout.FITS_FOLDER / f"{OWN}.pkl"
    expected = load(InfiniteDance(), path)
    content = fit_of(source)
    pose = content["body_pose"].reshape(182, 63)
    if np.prod(shape[1:]) == 69:
        pose = np.concatenate([pose, np.full((182, 6), 0.3, np.float32)], axis=1)
    path.write_bytes(joblib_bytes({**content, "body_pose": pose.reshape(shape)}, compress=compress))
    np.testing.assert_array_equal(load(InfiniteDance(), path).rotations, expected.rotations)


@pytest.mark.parametrize(("up", "turn"), [("z", [np.pi / 2, 0, 0]), ("-y", [np.pi, 0, 0]), ("y", [0, 0, 0])])
def test_the_axis_that_is_up_is_told(source: Path, up: str, turn: list[float]) -> None:
    path = source / layout.FITS_FOLDER / f"{OWN}.pkl"
    expected = load(InfiniteDance(), path).joints()
    content, world = fit_of(source), Rotation.from_rotvec(turn)
    rest = SMPLX22.offsets[0]
    change(
        path,
        global_orient=(world * Rotation.from_rotvec(content["global_orient"])).as_rotvec(),
        transl=world.apply(content["transl"] + rest) - rest,
    )
    for stated in ("auto", up):
        np.testing.assert_allclose(load(InfiniteDance(up=stated), path).joints(), expected, atol=1e-5)
    with raises_message(DataError, "pelvises", where="video_0001.pkl", reason="bad_axes"):
        load(InfiniteDance(up="z" if up != "z" else "y"), path)


def test_columns_against_infinitedances_code(shared: Path) -> None:
    """Its joints of the columns that its own script wrote, and the joints that these were made from."""
    crowd = shared / "golden" / "crowd"
    arrays = np.load(crowd / "infinitedance" / "columns266.npz")
    inputs = crowd / "inputs" / "infinitedance"
    for clip in (OWN, LIVE):
        motion = load_columns(inputs / layout.COLUMNS_FOLDER / f"{clip}.npy")
        np.testing.assert_allclose(motion.joints(), arrays[f"{clip}.recovered264"], rtol=0, atol=1e-5)


def test_the_published_layout(shared: Path) -> None:
    inputs = shared / "golden" / "crowd" / "inputs" / "infinitedance"
    scan = InfiniteDance(motion="columns").scan(inputs)
    assert splits(scan) == {LIVE: "train", OWN: "test"}
    assert rejects(scan, "missing_motion") == [AIST, "no_such_clip"]
    fits = InfiniteDance().scan(inputs)
    for clip in fits.clips:
        joints = InfiniteDance().load(clip).joints()
        np.testing.assert_allclose(joints, np.load(inputs / "joints" / f"{clip.id}.npy"), rtol=0, atol=1e-4)


def short(document: dict[str, Any], **audio: Any) -> dict[str, Any]:
    """The recipe that ships, with windows that fit into six seconds."""
    windows = {"length_frames": 96, "stride_frames": 48}
    return {**document, "windows": windows, "audio": {**document["audio"], **audio}}


@pytest.fixture
def build(source: Path, tmp_path: Path, cache: Path) -> Callable[..., Store]:
    def run(**audio: Any) -> Store:
        recipe, out = short(load_recipe("infinitedance").document, **audio), tmp_path / "out"
        store = dancedata.build(recipe, source, out, jobs=1, cache=cache, progress=False, overwrite=True).open()
        assert [problem for problem in verify_store(out) if problem.severity != "note"] == []
        return store

    return run


def test_the_recipe(source: Path, build: Callable[..., Store]) -> None:
    store = build()
    assert {clip.id for clip in store} == {OWN, LIVE, AIST, TEST}
    assert store[AIST].columns["origin"] == "aist++"
    published = np.load(source / layout.COLUMNS_FOLDER / f"{OWN}.npy")
    np.testing.assert_array_equal(store[OWN].read("file.columns264"), published)
    tokens = np.load(source / layout.TOKENS_FOLDER / f"{OWN}.npy").reshape(-1, 3) - layout.FIRST_CODES
    np.testing.assert_array_equal(store[OWN].read("file.tokens"), tokens)
    music = np.load(source / layout.MUSIC55_FOLDER / f"{OWN}.npy")
    np.testing.assert_array_equal(store[OWN].read("file.music55")[:181], music[:181])
    sample = WindowDataset(store, fields=("humanml264", "file.tokens", "file.music55"))[1]
    assert [tuple(sample[name].shape) for name in ("humanml264", "file.tokens", "file.music55")] == [
        (96, 264), (24, 3), (96, 55),
    ]  # fmt: skip
    # Made again from its joints: equal where the skeleton is InfiniteDance's, but for the last row, which it lacks.
    made = store[OWN].read("humanml264")
    np.testing.assert_allclose(made[:-1, :68], published[:-1, :68], rtol=0, atol=2e-3)


def test_rows_of_muq(source: Path, build: Callable[..., Store]) -> None:
    """They are published for test clips alone: others are set aside, by name."""
    muq = {"path": f"{layout.MUQ_FOLDER}/{{clip}}.npy", "rate": 25, "fps": 25, "columns_per_row": 1024}
    store = build(**{"file.muq": muq})
    assert [clip.id for clip in store] == [TEST]
    assert {row["clip"] for row in store.rejects if row["reason"] == "missing_feature"} == {OWN, LIVE, AIST}
    np.testing.assert_array_equal(store[TEST].read("file.muq"), np.load(source / layout.MUQ_FOLDER / f"{TEST}.npy"))
    # 25 rows per second, not the 30 that InfiniteDance's README names.
    thirty = {**muq, "rate": 30, "fps": 30}
    with pytest.raises(StoreError, match="feature_length"):
        build(**{"file.muq": thirty})


def test_tokens_that_are_not_of_the_codebook(source: Path, build: Callable[..., Store]) -> None:
    tokens = source / layout.TOKENS_FOLDER
    np.save(tokens / f"{OWN}.npy", np.load(tokens / f"{OWN}.npy") + 512)
    np.save(tokens / f"{LIVE}.npy", np.load(tokens / f"{LIVE}.npy")[:-1])
    store = build()
    assert {clip.id for clip in store} == {AIST, TEST}
    assert {row["clip"]: row["reason"] for row in store.rejects} == {OWN: "bad_code", LIVE: "bad_shape"}
