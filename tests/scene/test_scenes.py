"""The page draws the content of the dataset."""

import base64
import gzip
import shutil
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.columns import Columns, Group
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.skeleton import SMPL24
from dancedata.scene.comparisons import comparison_of, comparison_payload, file_format
from dancedata.scene.figure import Figure
from dancedata.scene.payload import curve, figure_payload, link, scene_payload
from dancedata.scene.scenes import Scenes, rhythm_fields
from dancedata.scene.source import ClipSource, cut
from dancedata.store.schema import Field
from dancedata.testing.stores import random_columns, write_random_store
from tests.messages import raises_message
from tests.scene.conftest import RECIPES


def unpacked(packed: dict) -> np.ndarray:
    """Joints (T, J, 3) of a payload, as the page computes them."""
    planes = np.frombuffer(gzip.decompress(base64.b64decode(packed["data"])), np.uint8).reshape(2, -1)
    steps = (planes[0] | planes[1].astype(np.uint16) << 8).astype(np.int16)
    columns = np.cumsum(steps.reshape(-1, packed["frames"]), axis=1, dtype=np.int16)
    return columns.T.reshape(packed["frames"], -1, 3) * packed["unit"] + packed["origin"]


@pytest.mark.parametrize(
    ("recipe", "field"), [(name, field) for name, recipe in RECIPES.items() for field in recipe["motion"]]
)
def test_drawn_joints_are_the_decoded_ones(scenes, recipe: str, field: str) -> None:
    dataset = scenes(recipe)
    plugin_decodes = dataset.readers[field].representation.decodes
    for item in dataset.items[:3]:
        rows = dataset.store[item.id].read(field) if item.window is None else dataset.store.read(item.window, field)
        if plugin_decodes:
            wanted = dancedata.decode(rows, field, fps=dataset.store.field(field).rate).joints()
        else:
            wanted = rows.reshape(len(rows), -1, 3)
        drawn = unpacked(scene_payload(dataset.scene(item, field))["figure"])
        assert np.abs(drawn - wanted).max() <= 0.0005 + 1e-6


def test_every_representation_that_has_joints_is_tested() -> None:
    tested = {name for recipe in RECIPES.values() for name in recipe["motion"]}
    assert set(REPRESENTATIONS.names()) == tested | {"lda61", "root_place"}


def test_a_dancer_far_away_takes_a_coarser_unit() -> None:
    joints = np.zeros((3, 24, 3))
    joints[1] += (200.0, 0, 0)
    packed = figure_payload(Figure.of_joints(joints, SMPL24, FrameGrid.of(30)))
    assert packed["unit"] == pytest.approx(0.004)
    assert np.abs(unpacked(packed) - joints).max() <= 0.002 + 1e-9


def test_stored_contacts_are_drawn_and_missing_ones_computed(scenes) -> None:
    dataset = scenes("thirty")
    item = dataset.items[0]
    stored, computed = dataset.scene(item, "edge151"), dataset.scene(item, "joints")
    assert stored.figure.contacts_stored
    assert not computed.figure.contacts_stored
    assert (stored.figure.contacts == (dataset.store[item.id].read("edge151")[:, :4] > 0.5)).all()
    assert not any("contacts" in note for note in stored.notes)
    assert any("velocity" in note for note in computed.notes)
    assert stored.movement.stored == "lodge"
    assert len(stored.movement.key_times) > 3
    names = [computed.figure.skeleton.joints[j] for j in computed.figure.contact_joints]
    assert names == ["left_ankle", "right_ankle", "left_foot", "right_foot"]


def test_columns_of_contacts_go_by_their_names(scenes) -> None:
    figure = scenes("twenty").scene(scenes("twenty").items[0]).figure
    names = [figure.skeleton.joints[j] for j in figure.contact_joints]
    assert figure.contacts_stored
    assert names == ["left_ankle", "left_foot", "right_ankle", "right_foot"]


def test_beats_are_the_stored_ones_a_row_earlier(scenes) -> None:
    dataset = scenes("thirty")
    item = dataset.items[0]
    rows, column = dataset.store[item.id].read("librosa35"), dataset.store.fields["librosa35"].slice("beat")
    late = np.flatnonzero(rows[:, column].ravel()) / 30 - dataset.scene(item).rhythm.beats
    assert 0.5 / 30 - 1e-9 <= late.min() <= late.max() <= 1.5 / 30 + 1e-9
    envelope = rows[:, dataset.store.fields["librosa35"].slice("onset_envelope")].ravel()
    assert dataset.scene(item).rhythm.onset == pytest.approx(envelope[1:] / envelope.max())
    assert any("no beats" in note for note in scenes("twenty").scene(scenes("twenty").items[0]).notes)


def test_beats_of_librosa35_come_first(tmp_path: Path) -> None:
    columns = Columns((Group("beat", 1, "1"),))
    fields = tuple(Field(name, "audio", columns, Fraction(30)) for name in ("beats", "librosa35.own", "other"))
    fields = (Field("joints", "motion", random_columns(3), Fraction(30)), *fields)
    written = write_random_store(tmp_path / "store", fields=fields)
    assert rhythm_fields(dancedata.open(written.path)) == ("librosa35.own", "beats", "other")


def test_slices_are_items(scenes) -> None:
    dataset = scenes("slices")
    assert [item.id for item in dataset.items] == [clip.id for clip in dataset.store.clips()]
    scene = dataset.scene(dataset.items[0])
    assert scene.figure.n_frames == 60
    assert scene.windows == ((0, 60),)
    assert link(scene.item, at=0.5) == f"#clip={scene.item.clip.id}&t=0.500"


def test_links_escape_names(scenes) -> None:
    item = scenes("thirty").items[0]
    hostile = replace(item, clip=replace(item.clip, id='a"b<script>#&%?+ \u202e'))
    assert link(hostile, at=5.8, loop=(90, 240), field="edge151.second") == (
        "#clip=a%22b%3Cscript%3E%23%26%25%3F%2B%20%E2%80%AE&t=5.800&loop=90-240&field=edge151.second"
    )


@pytest.mark.parametrize("wrong", [{"rate": "0"}, {"rate": "sixty"}, {"frame": 10**400}])
def test_a_flag_without_a_time_is_one_of_the_whole_clip(scenes, wrong: dict) -> None:
    dataset = Scenes(scenes("slices").store)
    item = dataset.items[0]
    row = {"clip": item.clip.id, "kind": "fast_turn", "frame": 3, "rate": "60", "value": 50.0, "unit": "deg", **wrong}
    dataset.__dict__["_quality"] = {item.clip.id: [row]}
    assert [flag.time for flag in dataset.scene(item).flags] == [None]


def test_a_dataset_without_joints_says_so(tmp_path: Path) -> None:
    fields = (Field("pose", "motion", random_columns(7), Fraction(30)),)
    dataset = Scenes(dancedata.open(write_random_store(tmp_path / "store", fields=fields).path))
    scene = dataset.scene(dataset.items[0])
    assert scene.figure is None
    assert scene.movement is None
    assert "pose holds neither rotations nor joint positions" in scene.notes[0]
    assert scene_payload(scene)["figure"] is None
    with raises_message(UsageError, "install"):
        dataset.scene(dataset.items[0], "pose")


def test_music_begins_where_the_clip_begins(scenes, dances: Path) -> None:
    dataset = scenes("slices")
    clip_source = ClipSource(dataset.store, dances)
    item = next(item for item in dataset.items if item.clip.slice_start == 30)
    whole = clip_source.music.load(dataset.store[item.clip.id])
    sound = clip_source.sound(item)
    first = whole.sample_rate
    assert np.array_equal(sound.signal.samples, whole.samples[first : first + 2 * whole.sample_rate])
    assert sound.notes == ()


def test_a_copy_at_another_tempo_has_stretched_music(scenes, dances: Path) -> None:
    dataset = scenes("thirty")
    copy = next(item for item in dataset.items if item.id.endswith("__tempo"))
    clip_source = ClipSource(dataset.store, dances)
    original = clip_source.music.load(dataset.store[copy.clip.source])
    sound = clip_source.sound(copy)
    assert copy.n_frames < dataset.find(copy.clip.source).n_frames
    assert sound.signal.n_samples == round(float(dataset.store.grid.seconds(copy.n_frames)) * original.sample_rate)
    assert not np.array_equal(sound.signal.samples[:1000], original.samples[:1000])


def test_other_music_is_used_with_a_note(scenes, dances: Path, tmp_path: Path) -> None:
    dataset, other = scenes("slices"), tmp_path / "other"
    shutil.copytree(dances, other)
    songs = sorted((other / "wavs").iterdir())
    shutil.copy(songs[0], songs[1])
    item = next(i for i in dataset.items if i.clip.music == songs[1].stem)
    assert "not the music that the dataset was built from" in ClipSource(dataset.store, other).sound(item).notes[0]


def test_music_before_its_begin_and_after_its_end_is_silence() -> None:
    signal = AudioSignal(np.arange(1, 11, dtype=np.float32), 10)
    assert cut(signal, Fraction(-1, 2), Fraction(1)).samples.tolist() == [0, 0, 0, 0, 0, 1, 2, 3, 4, 5]
    assert cut(signal, Fraction(1, 2), Fraction(1)).samples.tolist() == [6, 7, 8, 9, 10, 0, 0, 0, 0, 0]


def test_the_original_is_the_source_of_the_build(scenes, dances: Path) -> None:
    dataset = scenes("slices")
    clip_source = ClipSource(dataset.store, dances)
    for item in dataset.items[:4]:
        scene = dataset.scene(item)
        assert np.nanmax(scene.figure.distance_mm(clip_source.original(scene, item))) < 0.001


def test_generated_columns_are_compared(scenes, tmp_path: Path) -> None:
    dataset = scenes("thirty")
    item = dataset.items[0]
    rows = dataset.store[item.id].read("edge151")
    np.savez(tmp_path / "generated.npz", columns=dataset.store.scaler("edge151").normalize(rows))
    form = file_format(dataset.store, field="edge151", normalized=True)
    comparison = comparison_of(tmp_path / "generated.npz", dataset, form)
    assert comparison_payload(comparison, dataset.scene(item))["mean"] < 0.01


def test_another_dataset_is_compared(scenes) -> None:
    dataset, other = scenes("thirty"), scenes("sixty")
    comparison = comparison_of(other.store.path, dataset, file_format(dataset.store))
    assert comparison_payload(comparison, dataset.scene(dataset.items[0]))["mean"] < 1
    copy = next(item for item in dataset.items if item.clip.source)
    assert "no clip of this name" in comparison_payload(comparison, dataset.scene(copy))["note"]


def test_distance_is_taken_at_equal_instants() -> None:
    walk = np.zeros((31, 24, 3))
    walk[..., 0] = np.arange(31)[:, None] / 30
    slow, fast = (Figure.of_joints(walk[::step], SMPL24, FrameGrid.of(rate)) for step, rate in ((2, 15), (1, 30)))
    assert np.abs(fast.distance_mm(slow)).max() < 1e-6
    assert np.isnan(fast.distance_mm(Figure.of_joints(walk[:8], SMPL24, FrameGrid.of(30)))[8:]).all()


def test_curves_keep_their_values() -> None:
    values = np.array([0.0, 1.5, np.nan, 3.0, np.inf])
    packed = curve(values, 30.0)
    steps = np.frombuffer(gzip.decompress(base64.b64decode(packed["data"])), "<u2")
    assert steps / 65535 * packed["max"] == pytest.approx([0, 1.5, 0, 3, 0], abs=1e-4)
