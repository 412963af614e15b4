"""Groups of dancers in a build: one time, one world, whole or not at all."""

import itertools
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import soundfile

import dancedata
from dancedata import comparison
from dancedata.building.describe import describe_store
from dancedata.building.plan import make_plan
from dancedata.core.clip import ClipRef, Scan, member_id
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import AUGMENTATIONS
from dancedata.core.segments import Layer, Segment
from dancedata.core.skeleton import SMPL24
from dancedata.store import Store, verify_store
from dancedata.torch import GroupDataset
from tests.building.conftest import OwnReader
from tests.messages import raises_message
from tests.takes import keys_of, take_of

MOVES = Layer("moves", language="en", sided="mirrored", mirror=(("left turn", "right turn"),))
WORDS = Layer("words", language="fr")


@dataclass(frozen=True)
class Ensemble(OwnReader):
    """One .npz per sequence, all dancers together, and a .wav; world +Y up."""

    name: ClassVar[str] = "ensemble"

    def scan(self, source: Path) -> Scan:
        clips = []
        for path in sorted(source.glob("*.npz")):
            with np.load(path) as file:
                members = file["members"].tolist()
            for place, member in enumerate(members):
                clips.append(
                    ClipRef(
                        member_id(path.stem, member), path, path.with_suffix(".wav"), "train", music=path.stem,
                        group=path.stem, member=member, declared=(("place", str(place)),),
                        role=("leader", "follower")[place] if len(members) == 2 else "",
                        keys=(("video", path.stem[:1]),), columns=(("level", place),),
                    )
                )  # fmt: skip
        return Scan("ensemble", tuple(sorted(clips, key=lambda ref: ref.id)))

    def load(self, ref: ClipRef) -> Motion:
        place = int(dict(ref.declared)["place"])
        with np.load(ref.motion_path) as file:
            n = int(file["lengths"][place])
            poses, trans = file["poses"][place][:n], file["trans"][place][:n]
        if np.isnan(trans).any():
            raise DataError("NaN", reason="nan", where=ref.motion_path)
        return Motion(trans, poses, FrameGrid.of(60), SMPL24, trim_start=place)

    def segments(self, ref: ClipRef) -> list[Segment]:
        moves = Segment(MOVES, Fraction(1), Fraction(2), "left turn", ("turns left",), ("turns right",))
        return [moves, Segment(WORDS, Fraction(0), Fraction(5, 2), "", (f"dancer {ref.member}",))]


def write(folder: Path, name: str, size: int, **change: Any) -> None:
    """Dancers 1.2 m apart; the second, if there is one, is carried 60 cm up."""
    rng = np.random.default_rng(len(name) + size)
    folder.mkdir(exist_ok=True)
    n = 360
    trans = np.cumsum(rng.normal(scale=0.01, size=(size, n, 3)), axis=1)
    trans += [[[1.2 * k, 0.9 + 0.6 * (k == 1), 0.4 * k]] for k in range(size)]
    poses = np.cumsum(rng.normal(scale=0.01, size=(size, n, 24, 3)), axis=1)
    arrays = {"trans": trans, "poses": poses, "lengths": np.full(size, n), "members": np.arange(size)} | change
    np.savez(folder / f"{name}.npz", **arrays)
    soundfile.write(folder / f"{name}.wav", rng.normal(scale=0.1, size=6 * 16_000), 16_000)


def build(source: Path, out: Path, cache: Path, **keys: Any) -> Store:
    document = {
        "recipe": 1, "name": "groups", "dataset": {"ensemble": {}}, "fps": 30,
        "windows": {"length_s": 2, "stride_s": 1}, "motion": {"joints": {}, "edge151": {}}, "audio": {},
    } | keys  # fmt: skip
    return dancedata.build(document, source, out, jobs=1, cache=cache, progress=False).open()


def roots(store: Store, group: str, field: str = "joints") -> np.ndarray:
    """Roots of a group's dancers, (P, T, 3)."""
    clips = [clip for clip in store if clip.group == group]
    return np.stack([clip.read(field)[:, :3] for clip in clips]).astype(np.float64)


def distances(roots: np.ndarray) -> np.ndarray:
    return np.stack([np.linalg.norm(a - b, axis=-1) for a, b in itertools.combinations(roots, 2)])


def test_a_group_is_built_whole(tmp_path: Path, cache: Path) -> None:
    source = tmp_path / "source"
    write(source, "a", 3)
    write(source, "b", 2)
    store = build(source, tmp_path / "out", cache, audio={"librosa35": {}})
    assert verify_store(tmp_path / "out") == []
    assert [(c.id, c.group, c.member, c.role) for c in store] == [
        ("a_p0", "a", 0, ""), ("a_p1", "a", 1, ""), ("a_p2", "a", 2, ""),
        ("b_p0", "b", 0, "leader"), ("b_p1", "b", 1, "follower"),
    ]  # fmt: skip
    assert store["b_p1"].columns == {"video": "b", "level": 1}
    # The largest trim of the group, at the store's rate; the rows of one song.
    assert {c.trim_start for c in store if c.group == "a"} == {1}
    assert len({store._locate(store[c].windows()[0], "librosa35").first for c in ("a_p0", "a_p1", "a_p2")}) == 1
    source_roots = np.load(source / "a.npz")["trans"][:, ::2]
    offset = np.asarray(SMPL24.offsets)[0] if np.ndim(SMPL24.offsets) == 2 else 0.0
    np.testing.assert_allclose(distances(roots(store, "a")), distances(source_roots + offset), atol=1e-5)
    sample = GroupDataset(store, fields=("joints", "librosa35"), scale=None)[0]
    assert sample["joints"].shape == (3, 60, 72)
    assert [line.split()[:3] for line in describe_store(tmp_path / "out").split("\n")[3:5]] == [
        ["split", "clips", "groups"], ["train", "5", "2"],
    ]  # fmt: skip
    tables = store._tables
    assert [int(n) for n in tables.groups["n_source"]] == [3, 2]
    assert len(tables.songs["id"]) == 2


def test_a_group_lacks_no_dancer_silently(tmp_path: Path, cache: Path) -> None:
    source = tmp_path / "source"
    write(source, "a", 3)
    write(source, "b", 2)
    trans = dict(np.load(source / "a.npz"))["trans"]
    trans[1, 7] = np.nan
    write(source, "a", 3, trans=trans)
    store = build(source, tmp_path / "out", cache)
    assert {clip.group for clip in store} == {"b"}
    reasons = {row["clip"]: row["reason"] for row in store.rejects}
    assert reasons == {"a_p0": "incomplete_group", "a_p1": "nan", "a_p2": "incomplete_group"}
    kept = build(source, tmp_path / "kept", cache, groups={"incomplete": "keep"})
    assert {row["clip"]: row["reason"] for row in kept.rejects} == {"a_p1": "nan"}
    assert [c.member for c in kept.clips() if c.group == "a"] == [0, 2]
    assert list(kept.group_sizes.values()) == [3, 2]
    # Without the bad dancer from the start, the rows are the same.
    alone = {key: value[[0, 2]] for key, value in np.load(source / "a.npz").items()}
    write(tmp_path / "without", "a", 2, **alone)
    without = build(tmp_path / "without", tmp_path / "b", cache)
    np.testing.assert_array_equal(roots(kept, "a"), roots(without, "a"))


@pytest.mark.parametrize(("shorter", "frames"), [(4, 178), (20, None)])
def test_dancers_are_cut_to_the_shortest_within_a_tolerance(tmp_path, cache, shorter, frames):
    source = tmp_path / "source"
    write(source, "a", 2, lengths=np.array([360, 360 - shorter]))
    write(source, "b", 2)
    store = build(source, tmp_path / "out", cache)
    lengths = {clip.n_frames for clip in store if clip.group == "a"}
    assert lengths == ({frames} if frames else set())
    if not frames:
        assert {row["reason"] for row in store.rejects} == {"length_mismatch"}


@pytest.mark.parametrize("augmentation", ["yaw", "root_offset", "mirror", "tempo"])
def test_copies_are_of_one_world(tmp_path: Path, cache: Path, augmentation: str) -> None:
    source = tmp_path / "source"
    write(source, "a", 3)
    parameters: dict[str, Any] = {"speeds": [1.1]} if augmentation == "tempo" else {}
    store = build(source, tmp_path / "out", cache, augment={augmentation: parameters or True})
    copy = f"a__{augmentation}"
    assert [c.id for c in store if c.group == copy] == [f"a_p{k}__{augmentation}" for k in range(3)]
    assert verify_store(tmp_path / "out") == []
    before, after = distances(roots(store, "a")), distances(roots(store, copy))
    frames = slice(0, 1) if augmentation == "tempo" else slice(None)
    np.testing.assert_allclose(after[:, frames], before[:, frames], atol=2e-6)
    assert not np.allclose(roots(store, "a")[0][:20], roots(store, copy)[0][:20])


@pytest.mark.parametrize("changes", ["rows", "motion"])
def test_copies_of_a_group_say_what_they_change(tmp_path, cache, monkeypatch, changes):
    write(tmp_path / "source", "a", 2)
    monkeypatch.setattr(AUGMENTATIONS.get("yaw"), "acts_on", None)
    monkeypatch.setattr(AUGMENTATIONS.get("yaw"), "changes", changes)
    with raises_message(UsageError, "acts_on"):
        build(tmp_path / "source", tmp_path / "out", cache, augment={"yaw": True})


def test_one_floor_keeps_a_lifted_partner_in_the_air(tmp_path: Path, cache: Path) -> None:
    source = tmp_path / "source"
    write(source, "a", 2)
    store = build(source, tmp_path / "out", cache, motion={"lodge139": {}, "joints": {}})
    heights = [store[f"a_p{k}"].read("lodge139")[:, 5] for k in range(2)]  # 4 contacts, then x y z
    joints = [store[f"a_p{k}"].read("joints")[:, 1] for k in range(2)]
    np.testing.assert_allclose(heights[1] - heights[0], joints[1] - joints[0], atol=1e-5)


def test_keys_hold_the_files_of_all_dancers(tmp_path: Path, cache: Path) -> None:
    """A partner's file shapes the length, floor and place of a dancer."""
    from dancedata.recipes.parse import load_recipe

    recipe = replace(load_recipe("aist++", ("audio={}",)), dataset=Ensemble())
    refs = [ClipRef(f"a_p{k}", Path(f"a{k}.npz"), None, "train", group="a", member=k) for k in range(2)]
    one, two = (
        keys_of(recipe, take_of(recipe, [(refs[0], "1" * 64), (refs[1], other * 64)])) for other in ("2", "3")
    )
    assert [name for name in one if one[name] == two[name]] == []


@pytest.mark.parametrize(
    "keys",
    [
        {"motion": {"humanml263": {}}, "fps": 20},
        {"transforms": ["slices"], "windows": {"length_s": 5, "stride_s": 1}},
        {"transforms": [{"retarget": {"skeleton": "smpl24"}}]},
        {"transforms": [{"repair": {"floor": True}}]},
    ],
    ids=str,
)
def test_what_cannot_hold_a_group_is_refused(tmp_path: Path, cache: Path, keys: dict[str, Any]) -> None:
    write(tmp_path / "source", "a", 2)
    with raises_message(UsageError, "groups"):
        build(tmp_path / "source", tmp_path / "out", cache, **keys)


def test_a_spike_of_one_dancer_is_repaired_or_leaves_out_the_windows_of_all(tmp_path: Path, cache: Path) -> None:
    poses, steps = np.zeros((2, 360, 24, 3)), np.linspace(0, 1, 360)[:, None] * (0.3, 0, 0)
    trans = np.stack([steps, steps + np.array([1.2, 0, 0])])
    write(tmp_path / "clean", "a", 2, poses=poses, trans=trans)
    clean = build(tmp_path / "clean", tmp_path / "c", cache)
    spoilt = trans.copy()
    spoilt[1, 180, 1] += 0.3
    write(tmp_path / "source", "a", 2, poses=poses, trans=spoilt)
    curated = build(tmp_path / "source", tmp_path / "out", cache, rules={"curate": {"spikes": True}})
    windows = {clip.id: [w.start for w in curated[clip.id].windows()] for clip in curated.clips()}
    assert windows == {"a_p0": [0, 30, 120], "a_p1": [0, 30, 120]}
    assert {(r["clip"], r["window"]) for r in curated.rejects} == {(c, s) for c in windows for s in (60, 90)}
    assert "of partner a_p1" in next(r["detail"] for r in curated.rejects if r["clip"] == "a_p0")
    repaired = build(tmp_path / "source", tmp_path / "r", cache, transforms=[{"repair": {"spikes": True}}])
    assert {(q["clip"], q["kind"], q["frame"]) for q in repaired.quality} == {("a_p1", "repaired_spike", 180)}
    np.testing.assert_allclose(roots(repaired, "a"), roots(clean, "a"), atol=1e-6)
    np.testing.assert_array_equal(
        roots(repaired, "a", "joints.original"), roots(build(tmp_path / "source", tmp_path / "p", cache), "a")
    )


def test_diff_names_words_and_free_columns(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "source", "a", 2)
    build(tmp_path / "source", tmp_path / "one", cache)
    monkeypatch.setattr(Ensemble, "segments", lambda self, ref: [Segment(WORDS, Fraction(0), Fraction(1), "other")])
    build(tmp_path / "source", tmp_path / "two", cache)
    found = {d.kind: d for d in comparison.diff(tmp_path / "one", tmp_path / "two") if d.kind != "note"}
    assert list(found) == ["segments"]
    assert found["segments"].names == ("a_p0", "a_p1")


def test_segments_come_back_and_go_with_copies(tmp_path: Path, cache: Path) -> None:
    write(tmp_path / "source", "a", 2)
    store = build(tmp_path / "source", tmp_path / "out", cache, augment={"mirror": True, "tempo": {"speeds": [1.25]}})
    assert verify_store(tmp_path / "out") == []
    assert {layer["name"]: layer["rows"] for layer in store.info["layers"]} == {"moves": 6, "words": 4}
    (reject,) = (row for row in store.rejects if row["reason"] == "unmirrored_words")
    assert "2 segments of 2 clips: layer words, language fr" in reject["detail"]
    plain, mirrored, faster = (store.segments(f"a_p0{copy}") for copy in ("", "__mirror", "__tempo"))
    assert sorted(plain, key=lambda s: s.layer.name) == sorted(
        Ensemble().segments(ClipRef("", Path(), None, "", member=0)), key=lambda s: s.layer.name
    )
    assert [(s.label, s.texts, s.texts_mirrored) for s in mirrored] == [
        ("right turn", ("turns right",), ("turns left",))
    ]
    assert store.segments("a_p0__tempo", "moves")[0].end == Fraction(8, 5)
    assert len(faster) == 2
    with raises_message(UsageError, "wrods", where="out"):
        store.segments("a_p0", "wrods")


@pytest.mark.parametrize("incomplete", ["set_aside", "keep"])
def test_a_plan_counts_the_groups_of_a_build(tmp_path: Path, cache: Path, incomplete: str) -> None:
    source = tmp_path / "source"
    write(source, "a", 3)
    trans = dict(np.load(source / "a.npz"))["trans"]
    trans[1, 7] = np.nan
    write(source, "a", 3, trans=trans)
    write(source, "b", 2, lengths=np.array([360, 352]))
    write(source, "c", 2, lengths=np.array([360, 200]))
    document = {
        "recipe": 1, "name": "groups", "dataset": {"ensemble": {}}, "fps": 30,
        "windows": {"length_s": 2, "stride_s": "1/5"}, "motion": {"edge151": {}}, "audio": {"librosa35": {}},
        "augment": {"tempo": {"speeds": [0.9, 1.1]}, "mirror": True}, "groups": {"incomplete": incomplete},
    }  # fmt: skip
    places = {"jobs": 1, "cache": cache, "progress": False}
    plan = make_plan(document, source, tmp_path / "out", **places)
    store = dancedata.build(document, source, tmp_path / "out", **places).open()
    planned, counts = plan.to_json()["splits"]["train"], store.info["splits"]["train"]
    assert planned == {name: counts[name] for name in planned}
    # Words are of no concern to a plan.
    left_out = {(r["clip"], r["reason"]) for r in store.rejects if r["clip"] and r["reason"] != "unmirrored_words"}
    assert {(r.clip, r.reason) for r in plan.rejects if r.clip} == left_out
    assert {("a_p1", "nan"), ("c_p0", "length_mismatch"), ("c_p1", "length_mismatch")} <= left_out
    again = make_plan(document, source, tmp_path / "out", **places).to_json()["cached"]
    assert all(units["cached"] == units["of"] > 0 for units in again.values())


def test_columns_without_places_with_places_beside_them(tmp_path: Path, cache: Path) -> None:
    source = tmp_path / "source"
    write(source, "a", 2)
    store = build(source, tmp_path / "out", cache, fps=20, motion={"humanml263": {}, "root_place": {}})
    assert verify_store(tmp_path / "out") == []
    places = [store[clip].read("root_place")[0] for clip in ("a_p0", "a_p1")]
    pelves = Ensemble().scan(source).clips
    true = [Ensemble().load(ref).joints()[0, 0] for ref in pelves]
    np.testing.assert_allclose(places[1][:3] - places[0][:3], true[1] - true[0], atol=1e-5)
    with raises_message(UsageError, "optional", where="recipe"):
        build(source, tmp_path / "b", cache, fps=30, motion={"humanml263": {"fps": 20}, "root_place": {}})
