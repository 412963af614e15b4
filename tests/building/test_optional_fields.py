"""Clips that an optional field cannot take: kept for the other fields, and never read as data of that one."""

import json
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import dancedata
from dancedata.building.check import check
from dancedata.building.plan import make_plan
from dancedata.comparison import diff
from dancedata.core.audio_signal import wav_bytes
from dancedata.core.clip import Window
from dancedata.core.errors import RecipeError, StoreError, UsageError
from dancedata.core.motion import Motion
from dancedata.core.plugins import CopyAugmentation
from dancedata.core.registry import AUGMENTATIONS
from dancedata.keymotion.lodge import Lodge
from dancedata.metrics.key_motion import key_motion
from dancedata.pages.measure import measure
from dancedata.recipes.parse import load_recipe, parse_recipe
from dancedata.scene.scenes import Scenes
from dancedata.store import open_store, verify_store, write_store
from dancedata.store.schema import Field
from dancedata.store.stored_clip import StoredClip
from dancedata.synthetic import synthesise_motion, synthesise_song
from dancedata.torch import ClipDataset, Dancers, GroupDataset, Primitives, Scale, WindowDataset, Windows
from dancedata.torch.scalers import scaler_of
from dancedata.torch.selection import WindowQuery
from examples.make_captures import write_take
from tests.groups_store import HEADER, SIZES, stored

#: BVH has 24 joints, AMASS's npz 52: name, file, split, synthetic dance, song.
TAKES = (
    ("bvh_1", "a.bvh", "train", "gBR_sBM_cAll_d04_mBR0_ch01", "mBR0"),
    ("bvh_2", "b.bvh", "test", "gKR_sBM_cAll_d28_mKR5_ch03", "mKR5"),
    ("hands_1", "c_poses.npz", "train", "gHO_sBM_cAll_d19_mHO3_ch02", "mHO3"),
    ("hands_2", "d_poses.npz", "test", "gLO_sBM_cAll_d13_mLO2_ch01", "mLO2"),
)
FIELD = "finedance319"
WITHOUT = {"bvh_1", "bvh_2"}
RECIPE: dict[str, Any] = {
    "recipe": 1, "name": "mixed", "dataset": {"folder": {"unit": "cm"}}, "windows": {"length_s": 1, "stride_s": 0.5},
    "motion": {"edge151": {}, FIELD: {"optional": True}}, "audio": {"librosa35": {}},
}  # fmt: skip


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captures")
    rows = ["id,motion,audio,split"]
    for name, file, split, dance, music in TAKES:
        write_take(folder / file, synthesise_motion(dance, n_frames=240)[0])
        song = synthesise_song(music, length_s=5)
        (folder / f"{name}.wav").write_bytes(wav_bytes(song.pcm, song.signal.sample_rate))
        rows.append(f"{name},{file},{name}.wav,{split}")
    (folder / "manifest.csv").write_text("\n".join(rows) + "\n")
    return folder


@pytest.fixture(scope="module")
def mixed(captures: Path, cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("mixed") / "mixed"
    dancedata.build(RECIPE, captures, out, cache=cache)
    return out


def test_a_clip_that_one_field_cannot_take_is_kept_for_the_others(mixed: Path, captures: Path, cache: Path) -> None:
    ds = open_store(mixed)
    assert {clip.id for clip in ds if FIELD not in clip} == WITHOUT
    assert all(("edge151" in clip) and clip["edge151"].shape == (120, 151) for clip in ds)
    rejects = {row["clip"]: row for row in ds.rejects}
    assert set(rejects) == WITHOUT
    assert {row["reason"] for row in ds.rejects} == {"no_field"}
    assert rejects["bvh_1"]["detail"].startswith(f"kept without {FIELD}: the motion has no fingers")
    assert rejects["bvh_1"]["file"] == "a.bvh"
    assert ds.optional_fields == (FIELD,)
    # A strict build, and one from the cache alone, are the same.
    again = mixed.parent / "again"
    dancedata.build(RECIPE, captures, again, cache=cache, strict=True)
    assert (again / "dataset.json").read_bytes() == (mixed / "dataset.json").read_bytes()
    held = make_plan(RECIPE, captures, cache=cache).to_json()["cached"]
    assert all(units["cached"] == units["of"] for units in held.values()), held


def test_rows_that_a_field_has_are_those_of_a_build_without_the_key(mixed: Path, captures: Path, cache: Path) -> None:
    plain = mixed.parent / "plain"
    dancedata.build({**RECIPE, "motion": {"edge151": {}, FIELD: {}}}, captures, plain, cache=cache)
    one, two = open_store(mixed), open_store(plain)
    # Without the key a clip without fingers has hands that do not move, also where an entry without rows is cached.
    assert all(clip[FIELD].shape == (120, 319) for clip in two)
    for clip in one:
        assert np.array_equal(clip["edge151"], two[clip.id]["edge151"])
        if clip.id not in WITHOUT:
            assert np.array_equal(clip[FIELD], two[clip.id][FIELD])
    found = {line.kind: line for line in diff(mixed, plain)}
    assert set(found["values"].names) == WITHOUT


def test_a_direct_read_of_a_missing_field_is_an_error(mixed: Path) -> None:
    ds = open_store(mixed)
    window = Window("bvh_1", 0, 30)
    assert ds.read(window, "edge151").shape == (30, 151)
    out = np.zeros((30, 319), np.float32)
    reads = [
        lambda: ds.read(window, FIELD), lambda: ds.read(window, FIELD, out), lambda: ds["bvh_1"][FIELD],
        lambda: ds["bvh_1"].rows_within(FIELD), lambda: ds["bvh_1"].motion(FIELD),
    ]  # fmt: skip
    for read in reads:
        with pytest.raises(UsageError, match=f"no rows of field {FIELD}|no field of motion"):
            read()
    assert ds["bvh_1"].joints().shape == (120, 24, 3)


def test_readers_leave_such_clips_out_with_a_reason(mixed: Path) -> None:
    with_field = WindowDataset(mixed, "train", [FIELD, "librosa35"])
    assert {window.clip for window in with_field.windows} == {"hands_1"}
    rejected = {(reject.clip, reject.reason) for reject in with_field.rejects}
    assert rejected == {("bvh_1", "no_field")}
    batch = with_field.samples(range(len(with_field)))
    raw = open_store(mixed)
    normalised = raw.scaler(FIELD).normalize(raw.read(with_field.windows[2], FIELD))
    assert np.array_equal(batch[2][FIELD].numpy(), normalised)
    assert {window.clip for window in WindowDataset(mixed, "train", ["edge151"]).windows} == {"bvh_1", "hands_1"}
    assert not WindowDataset(mixed, "train", ["edge151"]).rejects
    clips = ClipDataset(mixed, "all", [FIELD])
    assert {clips[k]["clip"] for k in range(len(clips))} == {"hands_1", "hands_2"}
    assert {reject.clip for reject in clips.rejects} == WITHOUT


def test_statistics_and_scalers_are_of_the_rows_that_there_are(mixed: Path) -> None:
    ds = open_store(mixed)
    # Train windows begin every 15 of 120 frames: they cover all of a clip.
    rows = ds["hands_1"][FIELD].astype(np.float64)
    stats = ds.stats["fields"][FIELD]
    assert stats["n"] == len(rows) == 120
    assert ds.stats["fields"]["edge151"]["n"] == 240
    np.testing.assert_allclose(stats["mean"], rows.mean(axis=0), atol=1e-6)  # float32 rows, sums in float64
    np.testing.assert_array_equal(stats["min"], rows.min(axis=0))
    np.testing.assert_array_equal(stats["max"], rows.max(axis=0))
    both = np.concatenate([ds[clip][FIELD] for clip in ("hands_1", "hands_2")])
    scaler = scaler_of(ds, FIELD, WindowQuery((FIELD,)), Scale(over="all"))
    np.testing.assert_array_equal(scaler.data_max, both.max(axis=0))


def test_a_field_that_no_train_clip_has_has_no_statistics(captures: Path, cache: Path, tmp_path: Path) -> None:
    source = tmp_path / "source"
    source.mkdir()
    for file in captures.iterdir():
        text = file.name == "manifest.csv"
        (source / file.name).write_bytes(
            file.read_bytes().replace(b"hands_1.wav,train", b"hands_1.wav,test") if text else file.read_bytes()
        )
    dancedata.build(RECIPE, source, tmp_path / "out", cache=cache)
    ds = open_store(tmp_path / "out")
    assert set(ds.stats["fields"]) == {"edge151", "librosa35"}
    assert not [p for p in verify_store(tmp_path / "out") if p.severity == "error"]
    with pytest.raises(StoreError, match=f"no scaler without train windows that have field {FIELD}"):
        ds.scaler(FIELD)
    with pytest.raises(StoreError, match=f"no quantiles without train windows that have field {FIELD}"):
        ds.quantiles(FIELD, (0.5,))
    with pytest.raises(UsageError, match="left out: no_field"):
        WindowDataset(tmp_path / "out", "train", [FIELD])
    assert len(WindowDataset(tmp_path / "out", "test", [FIELD], scale=None)) == 14


def test_check_report_view_and_tables_know_it(mixed: Path, captures: Path) -> None:
    assert [str(p) for p in check(mixed)] == []
    notes = [p for p in check(captures, recipe=parse_recipe(RECIPE)) if "no_field" in p.message]
    assert len(notes) == 2
    assert {p.severity for p in notes} == {"note"}
    ds = open_store(mixed)
    table = ds.to_pandas().set_index("id")["without"]
    assert table.to_dict() == {clip.id: [FIELD] if clip.id in WITHOUT else [] for clip in ds}
    assert len(ds.to_pandas("windows")) == sum(split["windows"] for split in ds.info["splits"].values())
    assert {clip: numbers.seconds for clip, numbers in measure(ds).clips.items()} == {clip.id: 4.0 for clip in ds}
    scenes = Scenes(ds, FIELD)
    drawn = {item.clip.id: scenes.scene(item) for item in scenes.items}
    assert {clip: scene.field for clip, scene in drawn.items()} == {
        clip: "edge151" if clip in WITHOUT else FIELD for clip in drawn
    }
    item = next(item for item in scenes.items if item.clip.id == "bvh_1")
    scene = scenes.scene(item, FIELD)
    assert scene.figure is None
    assert f"no figure: the clip was kept without {FIELD}" in scene.notes


def test_exports_leave_out_clips_without_a_field_that_they_read(mixed: Path, tmp_path: Path) -> None:
    note = f"2 clips kept without {FIELD}, or of a group with one, are not exported: bvh_1, bvh_2"
    result = dancedata.export(mixed, "npz", tmp_path / "npz")
    assert note in result.notes
    assert {file.stem for file in (tmp_path / "npz/clips").iterdir()} == {"hands_1", "hands_2"}
    index = json.loads((tmp_path / "npz/index.json").read_text())
    assert {row[0] for rows in index["windows"].values() for row in rows} == {"hands_1", "hands_2"}
    parquet = dancedata.export(mixed, "parquet", tmp_path / "parquet", fields=[FIELD])
    assert note in parquet.notes
    for to, options in (("npz", {"fields": ["edge151"]}), ("bvh", {}), ("parquet", {"fields": ["edge151"]})):
        result = dancedata.export(mixed, to, tmp_path / f"{to}-edge", **options)
        assert not any("kept without" in text for text in result.notes)
    assert len(list((tmp_path / "npz-edge/clips").iterdir())) == 4
    assert len(list((tmp_path / "bvh-edge").rglob("*.bvh"))) == 4


def test_evaluation_names_the_clips_that_it_leaves_out(mixed: Path, cache: Path) -> None:
    splits = ",".join(open_store(mixed).splits)
    chosen = dancedata.evaluate(mixed, field=FIELD, split=splits, cache=cache)
    assert {clip for clip, _ in chosen.left_out} == WITHOUT
    assert not dancedata.evaluate(mixed, split=splits, cache=cache).left_out


def test_augmentations_do_not_see_rows_that_are_not_there(captures: Path, cache: Path, tmp_path: Path) -> None:
    class Fragile(CopyAugmentation):
        changes: ClassVar = "rows"
        version: ClassVar[int] = 1

        def change_rows(self, rows: Any, *_: Any, **__: Any) -> Any:
            return rows - rows[:1].max()  # an error for no rows

        def check(self, columns: Any) -> None:
            pass

    AUGMENTATIONS.register("fragile")(dataclass(frozen=True)(Fragile))
    try:
        built = dancedata.build({**RECIPE, "augment": {"fragile": True}}, captures, tmp_path / "out", cache=cache)
    finally:
        del AUGMENTATIONS._classes["fragile"]
    assert FIELD not in built.open()["bvh_1__fragile"]


def test_key_motions_may_be_optional(captures: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    analyse = Lodge.analyse

    def of_hands(self: Lodge, motion: Motion) -> Any:
        if motion.skeleton.n_joints < 52:
            raise UsageError(f"a motion on skeleton {motion.skeleton.name} has no key motions")  # as `transfer_to`
        return analyse(self, motion)

    monkeypatch.setattr(Lodge, "analyse", of_hands)
    recipe = {**RECIPE, "motion": {"edge151": {}}, "keymotion": {"lodge": {"optional": True}}, "audio": {}}
    recipe["dataset"] = {"folder": {"unit": "cm", "music": "optional"}}
    out = tmp_path / "out"
    dancedata.build(recipe, captures, out, cache=tmp_path / "cache", jobs=1, strict=True)
    assert not [p for p in verify_store(out) if p.severity == "error"]
    ds = open_store(out)
    assert ds.optional_fields == ("lodge",)
    assert {clip.id for clip in ds if "lodge" not in clip} == WITHOUT
    details = {row["clip"]: row["detail"] for row in ds.rejects if row["reason"] == "no_field"}
    assert set(details) == WITHOUT
    assert details["bvh_1"].startswith("kept without lodge: a motion on skeleton smpl24:bvh-")
    with pytest.raises(UsageError, match="no rows of field lodge"):
        ds["bvh_1"]["lodge"]
    # Primitives are of the clips that have the minima that they are chosen by; those that need none, of all.
    options: dict[str, Any] = {"windows": Windows(length=96), "scale": None}
    with_minima = WindowDataset(ds, "train", fields=["edge151", Primitives(n=48)], **options)
    assert {window.clip for window in with_minima.windows} == {"hands_1"}
    assert {(r.clip, r.reason, r.detail) for r in with_minima.rejects} == {
        ("bvh_1", "no_field", "kept without lodge")
    }
    assert with_minima[0]["primitives"].shape == (7, 8, 151)  # 3 hard ones and 2 x 2 soft ones
    borders = WindowDataset(ds, "train", fields=["edge151", Primitives(n=96)], **options)
    assert {window.clip for window in borders.windows} == {"bvh_1", "hands_1"}
    # Reports and pages find key motions by themselves where none are stored, as in a dataset without the field.
    scenes = Scenes(ds)
    for item in scenes.items:
        scene = scenes.scene(item)
        assert scene.movement.stored == ("" if item.clip.id in WITHOUT else "lodge")
        if item.clip.id in WITHOUT:
            assert len(scene.movement.key_times) == len(key_motion(scene.figure.joints, 5).minima)
    assert all(numbers.key_motions for numbers in measure(ds).clips.values())


def test_a_skeleton_that_a_field_refuses_is_an_error_of_its_file(captures: Path, tmp_path: Path) -> None:
    dataset = {"folder": {"unit": "cm", "music": "optional"}}
    recipe = {**RECIPE, "dataset": dataset, "motion": {"edge151": {}, "lda61": {"optional": True}}, "audio": {}}
    dancedata.build(recipe, captures, tmp_path / "out", cache=tmp_path / "cache", jobs=1)
    ds = open_store(tmp_path / "out")
    assert not any(("lda61" in clip) for clip in ds)
    assert "kept without lda61: lda61 needs the joints of Motorica" in ds.rejects[0]["detail"]
    with pytest.raises(UsageError, match=r"a\.bvh: lda61 needs the joints of Motorica"):
        dancedata.build(
            {**recipe, "motion": {"edge151": {}, "lda61": {}}}, captures, tmp_path / "no",
            cache=tmp_path / "cache", jobs=1,
        )  # fmt: skip


LODGE: dict[str, Any] = {"keymotion": {"lodge": {"optional": True}}, "rules": {"movement": {"field": "lodge"}}}
LODGE139: dict[str, Any] = {
    "motion": {"edge151": {}, "lodge139": {"optional": True}}, "rules": {"movement": {"field": "lodge139"}},
}  # fmt: skip
MISTAKES = [
    ({"motion": {"edge151": {"optional": True}}}, "all fields are optional"),
    ({"motion": {"edge151": {}, FIELD: {"optional": "yes"}}}, "optional: must be true or false; found 'yes'"),
    ({"keymotion": {"lodge": {"optional": 1}}}, "keymotion.lodge.optional: must be true or false; found 1"),
    ({"motion": {"edge151": {}, "root_place": {"optional": True}}}, "places of dancers cannot be left out"),
    (LODGE, "lodge is optional, and clips without it cannot be filtered"),
    (LODGE139, "lodge139 is optional, and clips without it cannot be filtered"),
]


@pytest.mark.parametrize(("change", "message"), MISTAKES)
def test_what_cannot_be_optional_is_a_mistake_in_the_recipe(change: dict[str, Any], message: str) -> None:
    with pytest.raises(RecipeError, match=message):
        parse_recipe({**RECIPE, **change})


def test_the_key_is_in_the_hash_and_false_is_its_absence() -> None:
    plain = parse_recipe({**RECIPE, "motion": {"edge151": {}, FIELD: {}}})
    assert parse_recipe({**RECIPE, "motion": {"edge151": {}, FIELD: {"optional": False}}}).sha256 == plain.sha256
    optional = parse_recipe(RECIPE)
    assert optional.sha256 != plain.sha256
    assert parse_recipe(optional.document).sha256 == optional.sha256
    assert load_recipe(RECIPE, [f"motion.{FIELD}.optional=false"]).sha256 == plain.sha256
    key_motions = {"keymotion": {"lodge": {"optional": True}}}
    stored = parse_recipe({**RECIPE, **key_motions})
    assert stored.sha256 == parse_recipe(stored.document).sha256 != optional.sha256
    assert stored.document["keymotion"] == {"lodge": {"sigma_frames": 5.0, "optional": True}}


def without_joints(clips: list[StoredClip], names: set[str]) -> list[StoredClip]:
    empty = np.empty((0, clips[0].motion["joints"].shape[1]), np.float32)
    return [replace(c, motion={**c.motion, "joints": empty}) if c.id in names else c for c in clips]


@pytest.mark.parametrize("shard_bytes", [2**28, 1])
def test_a_group_with_a_dancer_without_the_field_is_left_out(tmp_path: Path, shard_bytes: int) -> None:
    optional = tuple(replace(f, optional=f.name == "joints") for f in HEADER.fields)
    lacking = {"train1_p1", "alone"}
    clips = without_joints(stored(SIZES), lacking)
    with pytest.raises(StoreError, match="rows and frames do not match"):
        write_store(tmp_path, HEADER, clips)
    # With one byte a shard holds one group, and that of "alone" no rows of the field.
    write_store(tmp_path, replace(HEADER, fields=optional), clips, shard_bytes=shard_bytes)
    assert not [p for p in verify_store(tmp_path) if p.severity == "error"]
    ds = open_store(tmp_path)
    groups = GroupDataset(ds, "train", fields=["edge151", "joints"], dancers=Dancers(singles=True), scale=None)
    names = {groups[k]["group"] for k in range(len(groups))}
    assert names == {"train0", "train2", "train3"}
    reason = [r.detail for r in groups.rejects if r.reason == "no_field"]
    assert "group train1: train1_p1 kept without joints" in reason
    assert "kept without joints" in reason
    for k in range(len(groups)):
        sample = groups[k]
        for place, clip in enumerate(filter(None, sample["clips"])):
            start, rows = sample["start"], ds[clip]["joints"]
            assert np.array_equal(sample["joints"][place].numpy(), rows[start : start + 20])
    others = GroupDataset(ds, "train", fields=["edge151"], scale=None)
    assert {others[k]["group"] for k in range(len(others))} == {f"train{k}" for k in range(len(SIZES["train"]))}
    assert len(measure(ds).groups.rows) == 6


def test_fields_that_cannot_be_optional_are_not_written(tmp_path: Path) -> None:
    every = tuple(replace(f, optional=f.kind == "motion") for f in HEADER.fields)
    with pytest.raises(StoreError, match="every motion field is optional"):
        write_store(tmp_path, replace(HEADER, fields=every), stored(SIZES))
    audio = tuple(replace(f, optional=f.kind == "audio") for f in HEADER.fields)
    with pytest.raises(StoreError, match="field tune cannot be optional"):
        write_store(tmp_path, replace(HEADER, fields=audio), stored(SIZES))
    field = Field("joints", "motion", HEADER.fields[1].columns, Fraction(30), optional=True)
    assert Field.from_json(field.to_json()) == field
    assert "optional" not in HEADER.fields[0].to_json()
