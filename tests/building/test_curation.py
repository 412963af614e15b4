"""`curate` and `repair` in builds: what is left out and why, what is repaired and flagged, what stays as it was."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.building.plan import make_plan
from dancedata.core.errors import RecipeError, UsageError
from dancedata.core.hashing import recipe_hash
from dancedata.core.motion import Motion
from dancedata.curation import quality
from dancedata.curation.scores import MEASURES
from dancedata.recipes.parse import load_recipe, parse_recipe
from dancedata.store import Store, verify_store
from dancedata.synthetic import synthesise_motion
from tests.commands import as_json, run
from tests.messages import raises_message

DOCUMENT: dict[str, Any] = {
    "recipe": 1, "name": "mine",
    "dataset": {"folder": {"unit": "m", "up": "y", "fps": 60, "music": "optional", "layout": "smpl"}},
    "windows": {"length_s": 2, "stride_s": 1}, "motion": {"edge151": {}}, "audio": {},
}  # fmt: skip
FRAMES = 480
#: First frame that is held in the clip "held".
HELD = 200


def spoilt(kind: str, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    translation, rotations = np.array(motion.translation), np.array(motion.rotations)
    if kind == "spike":
        translation[300] += (0.2, 0.0, 0.0)
    elif kind == "held":
        speed = np.linalg.norm(np.diff(motion.joints(), axis=0), axis=2).max(axis=1)
        assert speed[HELD - 1 : HELD + 12].max() > 0.02
        translation[HELD : HELD + 12], rotations[HELD : HELD + 12] = translation[HELD - 1], rotations[HELD - 1]
    elif kind == "sinks":
        translation[:, 1] -= np.linspace(0, 0.15, FRAMES)
    return translation, rotations


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captures")
    for k, kind in enumerate(("clean", "held", "sinks", "spike")):
        motion = synthesise_motion(f"gHO_sFM_cAll_d04_mHO0_ch0{k + 1}", n_frames=FRAMES)[0]
        translation, rotations = spoilt(kind, motion)
        np.savez(folder / f"{kind}.npz", poses=rotations.reshape(-1, 72), trans=translation)
    return folder


@pytest.fixture(scope="module")
def build(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Any:
    cache = tmp_path_factory.mktemp("cache")

    def build(jobs: int = 1, **keys: Any) -> Store:
        out = tmp_path_factory.mktemp("out") / "d"
        return dancedata.build({**DOCUMENT, **keys}, source, out, jobs=jobs, cache=cache, progress=False).open()

    return build


@pytest.fixture(scope="module")
def plain(build: Any) -> Store:
    return build()


def starts(store: Store) -> dict[str, list[int]]:
    return {clip.id: [window.start for window in store[clip.id].windows()] for clip in store}


def test_windows_that_touch_a_span_are_left_out(build: Any, plain: Store) -> None:
    store = build(rules={"curate": {"spikes": True}})
    assert verify_store(store.path) == []
    before, after = starts(plain), starts(store)
    # Frame 300 of 60 per second is frame 150 of 30, in the windows of 60 frames that begin at 120 and 150.
    gone = {clip: sorted(set(before[clip]) - set(after[clip])) for clip in before}
    assert gone == {"clean": [], "held": [], "sinks": [], "spike": [120, 150]}
    rejects = [r for r in store.rejects if r["reason"] == "curated"]
    assert [(r["clip"], r["window"], r["numbers"]["limit"]) for r in rejects] == [
        ("spike", 120, 0.075), ("spike", 150, 0.075)
    ]  # fmt: skip
    assert all(r["numbers"]["spikes"] == pytest.approx(0.2, abs=0.02) for r in rejects)
    assert "5.00 s to 5.02 s" in rejects[0]["detail"]
    # A clip keeps its frames: windows are left out, not columns.
    assert np.array_equal(store["spike"].read("edge151"), plain["spike"].read("edge151"))


@pytest.mark.parametrize("rates", [(25, 60), (50, 30)])
def test_windows_with_rows_between_a_faulty_frame_and_its_neighbour_are_left_out(build, rates):
    of_source, fps = rates
    dataset = {"folder": {**DOCUMENT["dataset"]["folder"], "fps": of_source}}
    keys = {"dataset": dataset, "fps": fps, "windows": {"length_frames": 7, "stride_frames": 1}}
    store, every = build(rules={"curate": {"spikes": True}}, **keys), build(**keys)
    seconds = np.arange(every["spike"].n_frames) / fps
    off = np.flatnonzero(np.abs(seconds * of_source - 300) < 1 - 1e-9)  # slerp and lines take two frames
    touched = {start for start in starts(every)["spike"] if np.isin(np.arange(start, start + 7), off).any()}
    assert len(off) > 1 or of_source > fps
    assert not touched & set(starts(store)["spike"])
    assert len(starts(every)["spike"]) - len(starts(store)["spike"]) <= len(touched) + 1


def test_clips_are_left_out(build: Any) -> None:
    store = build(rules={"curate": {"floor_drift": 0.1, "spikes": {"leave_out": "clip", "limit": 0.1}}})
    assert sorted(clip.id for clip in store) == ["clean", "held"]
    assert sorted((r["clip"], *sorted(r["numbers"])) for r in store.rejects) == [
        ("sinks", "floor_drift", "limit"), ("spike", "limit", "spikes")
    ]  # fmt: skip


def test_only_named_splits_are_curated(build: Any, plain: Store) -> None:
    store = build(rules={"curate": {"spikes": {"splits": ["val"]}, "frozen": {"splits": "train"}}})
    assert {r["clip"] for r in store.rejects} == {"held"}
    assert starts(store)["spike"] == starts(plain)["spike"]
    assert "rules.curate.spikes.splits: no clip is in val, of train" in store.info["source"]["notes"]


def test_copies_lose_the_same_windows(build: Any) -> None:
    store = build(rules={"curate": {"spikes": True}}, augment={"mirror": True, "tempo": {"speeds": [1]}})
    of_clip = starts(store)
    assert of_clip["spike__mirror"] == of_clip["spike__tempo"] == of_clip["spike"] == [0, 30, 60, 90, 180]
    assert {r["clip"] for r in store.rejects} == {"spike", "spike__tempo"}
    assert not any("partner" in r["detail"] for r in store.rejects)


def test_what_was_repaired_is_flagged_and_the_original_is_kept(build: Any, plain: Store) -> None:
    store = build(transforms=[{"repair": {"spikes": True, "gaps": True, "floor": True, "smoothing": True}}])
    assert verify_store(store.path) == []
    assert list(store.fields) == ["edge151", "edge151.original"]
    kinds = {clip: sorted({q["kind"] for q in store.quality if q["clip"] == clip}) for clip in starts(store)}
    assert kinds == {
        "clean": [], "held": ["repaired_gap"], "sinks": ["repaired_floor"], "spike": ["repaired_spike"]
    }  # fmt: skip
    position = store.fields["edge151"].slice("translation")
    for clip in plain.clips():
        before = plain[clip.id].read("edge151")
        after, original = (store[clip.id].read(name) for name in ("edge151", "edge151.original"))
        assert np.array_equal(before, original)
        frames = {q.get("frame") for q in store.quality if q["clip"] == clip.id}
        rows = range(len(before)) if None in frames else [f // 2 for f in sorted(frames) if f % 2 == 0]
        differ = np.flatnonzero((before != after)[:, 4:].any(axis=1)).tolist()  # the first four are contacts
        assert set(differ) <= set(rows)
        assert bool(differ) == bool(frames)
    spike = store["spike"].read("edge151")[150, position]
    assert np.abs(spike - plain["spike"].read("edge151")[150, position]).max() == pytest.approx(0.2, abs=0.01)
    assert "repaired: spike in 1 frame of 1 clip" in run("info", store.path).output
    assert any("repaired: spikes (0.075 m)" in note for note in store.info["source"]["notes"])
    assert store.info["recipe"]["motion"].keys() == {"edge151"}
    assert load_recipe(store.info["recipe"]).sha256 == recipe_hash(store.info["recipe"])


def test_without_the_original_and_for_clean_clips_bytes_are_those_of_a_plain_build(build, plain, source, tmp_path):
    store = build(transforms=[{"repair": {"spikes": True, "original": False}}])
    assert list(store.fields) == ["edge151"]
    for clip in ("clean", "held", "sinks"):
        assert store[clip].read("edge151").tobytes() == plain[clip].read("edge151").tobytes()
    assert store["spike"].read("edge151").tobytes() != plain["spike"].read("edge151").tobytes()


def test_mirrored_copies_are_mirrored_repairs(build: Any, plain: Store) -> None:
    mirrored, store = (
        build(augment={"mirror": True}),
        build(transforms=[{"repair": {"spikes": True}}], augment={"mirror": True}),
    )
    of_plain = mirrored["spike__mirror"].read("edge151")
    assert np.array_equal(store["spike__mirror"].read("edge151.original"), of_plain)
    repaired = store["spike__mirror"].read("edge151")
    rows = np.flatnonzero((repaired != of_plain).any(axis=1)).tolist()
    of_clip = store["spike"].read("edge151") != store["spike"].read("edge151.original")
    assert rows == np.flatnonzero(of_clip.any(axis=1)).tolist() == [149, 150]


@pytest.mark.parametrize(
    "keys",
    [
        *({"rules": {"curate": curate}} for curate in (
            ["spikes"], {"spike": True}, {"spikes": {"limits": 1}}, {"spikes": "much"}, {"spikes": 0.001},
            {"up": {"leave_out": "windows"}}, {"up": {"splits": 3}}, {"floor_drift": 1e7},
        )),
        *({"transforms": [{"repair": repair}]} for repair in (
            [], {"spike": True}, {"gaps": -1}, {"original": "maybe"},
        )),
        {"transforms": {"repair": {"gaps": True}}}, {"transforms": ["repair", "repair"]},
        {"transforms": [{"repair": {"gaps": True}}], "motion": {"edge151": {}, "edge151.original": {}}},
    ],
)  # fmt: skip
def test_wrong_keys(keys: dict[str, Any]) -> None:
    with raises_message(RecipeError, "problem", where="recipe"):
        parse_recipe({**DOCUMENT, **keys})


def test_check_finds_what_a_build_leaves_out(source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DANCEDATA_CACHE", str(tmp_path))
    problems = dancedata.check(
        source, recipe={**DOCUMENT, "rules": {"curate": {"floor_drift": True}}}, progress=False
    )
    assert [(p.severity, p.where) for p in problems if p.message.startswith("curated")] == [("note", "sinks")]
    plan = make_plan({**DOCUMENT, "rules": {"curate": {"spikes": True}}}, source, cache=tmp_path, progress=False)
    assert any("counted before curate" in note for note in plan.to_json()["notes"])


def test_quality_of_a_source_a_dataset_and_a_motion(source: Path, plain: Store, tmp_path: Path) -> None:
    found = quality.quality(source, recipe=DOCUMENT, progress=False)
    above = {clip.clip: [name for name in MEASURES if clip.above(name)] for clip in found.clips}
    assert above == {"clean": [], "held": ["frozen"], "sinks": ["floor_drift"], "spike": ["spikes"]}
    assert [sum(clip.above("spikes", limit) for clip in found.clips) for limit in (0.0375, 0.075, 0.3)] == [1, 1, 0]
    repaired = quality.quality(
        source, recipe={**DOCUMENT, "transforms": [{"repair": {"spikes": True, "floor": True}}]}, progress=False
    )
    assert [c.clip for c in repaired.clips if any(map(c.above, MEASURES))] == ["held"]
    text = run("check", "--faults", plain.path, "--out", tmp_path / "q.csv").output
    assert "spikes 0.2" in text
    assert "4 clips" in text
    lines = (tmp_path / "q.csv").read_text().splitlines()
    assert lines[0].startswith("clip,score,value")
    assert any(line.startswith("spike,spikes,") and line.endswith("pelvis") for line in lines)
    document = as_json("check", "--faults", plain.path)
    spiky = [c["clip"] for c in document["clips"] if c["scores"]["spikes"]["above"]]
    assert (spiky, document["scores"]["spikes"]["above"]) == (["held", "spike"], 2)  # what is held ends with a jump
    assert document["clips"][3]["scores"]["spikes"]["spans"][0]["joint"] == "pelvis"
    opened = quality.quality(plain, progress=False)
    assert opened.to_json()["clips"] == document["clips"]
    with raises_message(UsageError, "exists", where="q.csv"):
        quality.quality(source, out=tmp_path / "q.csv")
