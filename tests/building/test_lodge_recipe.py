"""The recipe aist++-lodge, key motions, the movement filter and fields at 60 a second."""

import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata.core.motion import forward_kinematics
from dancedata.core.registry import DATASETS, KEYMOTIONS
from dancedata.store import verify_store
from dancedata.synthetic import write_synthetic


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Clips of 10 s; the first train clip stands still in its second half, the next one throughout."""
    source = write_synthetic(tmp_path_factory.mktemp("lodge") / "source", songs=3, clips_per_song=2, clip_s=10)
    names = (source / "splits" / "crossmodal_train.txt").read_text().split()
    for name, begin in ((names[0], 300), (names[1], 0)):
        path = source / "motions" / f"{name}.pkl"
        with path.open("rb") as file:
            clip = pickle.load(file)
        for key in ("smpl_poses", "smpl_trans"):
            clip[key][begin:] = clip[key][begin]
        with path.open("wb") as file:
            pickle.dump(clip, file)
    return source


@pytest.fixture(scope="module")
def names(corpus: Path) -> list[str]:
    return (corpus / "splits" / "crossmodal_train.txt").read_text().split()


SHORT = ("windows.length_frames=64", "windows.stride_frames=32")
SLICES = "transforms=[{slices: {length_s: 32/15, stride_s: 16/15}}]"


@pytest.fixture(scope="module")
def lodge(corpus: Path, run_build, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("lodge") / "out"
    run_build(corpus, out, "aist++-lodge", SHORT)
    return out


def test_still_windows_are_rejects_and_the_rest_is_as_the_reference_chooses(lodge: Path, names: list[str]) -> None:
    store = dancedata.open(lodge)
    assert [p for p in verify_store(lodge) if p.severity == "error"] == []
    rows = store[names[0]].read("lodge139")
    starts = range(0, len(rows) - 63, 32)
    wanted = [k for k in starts if rows[k : k + 64].std(axis=0).mean() > 0.07]
    assert [w.start for w in store.windows("train") if w.clip == names[0]] == wanted
    assert 0 < len(wanted) < len(starts)
    still = [r for r in store.rejects if r["reason"] == "still" and r["clip"] == names[0]]
    assert [r["window"] for r in still] == [k for k in starts if k not in wanted]
    assert all(r["numbers"]["std"] <= 0.07 for r in still)
    assert names[1] not in [c.id for c in store]
    assert any(r["clip"] == names[1] and "window" not in r for r in store.rejects)
    # Windows of test are all kept.
    clips = [c for c in store if c.split == "test"]
    counts = {c.id: sum(w.clip == c.id for w in store.windows("test")) for c in clips}
    assert counts == {c.id: (c.n_frames - 64) // 32 + 1 for c in clips}


def test_key_motions_are_stored_for_every_clip(lodge: Path) -> None:
    store = dancedata.open(lodge)
    finder = KEYMOTIONS.get("lodge")()
    for record in store:
        rows = store[record.id].read("lodge")
        assert rows.shape == (record.n_frames, finder.columns.width)
        motion = dancedata.decode(store[record.id].read("lodge139"), "lodge139")
        # float32 columns move the curve by about 1e-7 m; the minima are those of the clip.
        np.testing.assert_allclose(finder.analyse(motion)[:, 0], rows[:, 0], atol=1e-6)


def test_the_filter_of_slices(corpus: Path, run_build, names: list[str], tmp_path: Path) -> None:
    run_build(corpus, tmp_path / "out", "aist++-lodge", (*SHORT, SLICES, "audio={}", "augment.mirror=true"))
    store = dancedata.open(tmp_path / "out")
    assert [p for p in verify_store(tmp_path / "out") if p.severity == "error"] == []
    mine = [clip for clip in store if clip.slice_of == names[0]]
    assert mine
    for clip in mine:
        assert clip.read("lodge139").std(axis=0).mean() > 0.07


def test_windows_lost_to_a_slower_field_are_named(run_build, corpus: Path, tmp_path: Path) -> None:
    # 599 frames at 60 a second: 300 at 30, and 599 rows at 60 reach only to frame 299.
    source = tmp_path / "source"
    shutil.copytree(corpus, source)
    for path in (source / "motions").glob("*.pkl"):
        clip = pickle.loads(path.read_bytes())
        path.write_bytes(pickle.dumps({**clip, **{k: clip[k][:599] for k in ("smpl_poses", "smpl_trans")}}))
    changes = ("audio={}", "windows.length_frames=100", "windows.stride_frames=100")
    run_build(source, tmp_path / "out", "aist++", (*changes, "motion={edge151: {}, fact219: {}}"))
    store = dancedata.open(tmp_path / "out")
    short = [r for r in store.rejects if r["reason"] == "short_field"]
    assert {r["clip"] for r in short} == {c.id for c in store}
    assert {r["window"] for r in short} == {200}
    assert all("60 per second" in r["detail"] for r in short)
    assert {w.start for w in store.windows("train")} == {0, 100}


@pytest.mark.parametrize("transforms", ["[]", "[slices]"])
def test_fields_with_a_rate_of_their_own(corpus: Path, run_build, tmp_path: Path, transforms: str) -> None:
    run_build(corpus, tmp_path / "out", "aist++", (
        "motion={edge151: {}, bailando72: {}, fact219: {}}", "audio={}", f"transforms={transforms}",
    ))  # fmt: skip
    store = dancedata.open(tmp_path / "out")
    assert [p for p in verify_store(tmp_path / "out") if p.severity == "error"] == []
    assert {f: str(store.field(f).rate) for f in store.fields} == {
        "bailando72": "60", "edge151": "30", "fact219": "60",
    }  # fmt: skip
    window = store.windows("train")[1]
    slow, fast = store.read(window, "edge151"), store.read(window, "fact219")
    assert (len(slow), len(fast)) == (150, 300)
    # Every second row is at the instant of a row at 30 a second, in EDGE's axes.
    np.testing.assert_allclose(fast[::2, :3] @ [[1, 0, 0], [0, 0, 1], [0, -1, 0]], slow[:, 4:7], atol=1e-6)
    motion = dancedata.decode(fast, "fact219", fps=60)
    joints = forward_kinematics(motion.skeleton, motion.rotations, motion.translation)
    np.testing.assert_allclose(store.read(window, "bailando72").reshape(-1, 24, 3), joints, atol=1e-5)


def test_equal_files_of_two_names_are_cut_by_their_names(run_build, tmp_path: Path) -> None:
    source = tmp_path / "source"
    DATASETS.get("finedance")().make_example(source)
    # 010 and 014 begin with three frames that Lodge cuts.
    for folder, suffix in (("motion", "npy"), ("music_wav", "wav"), ("label_json", "json")):
        shutil.copy(source / folder / f"001.{suffix}", source / folder / f"010.{suffix}")
    run_build(source, tmp_path / "out", "finedance", ("audio={}", "windows.length_frames=30"))
    store = dancedata.open(tmp_path / "out")
    assert {c.id: c.trim_start for c in store if c.id in ("001", "010")} == {"001": 0, "010": 3}
