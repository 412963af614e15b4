"""Segments on the time axis, key motions on beats, and downbeats: each against plain numpy on planted cases."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from dancedata.core.columns import Columns, Group, Mirror
from dancedata.core.grid import FrameGrid
from dancedata.core.segments import Layer, Segment
from dancedata.scene.figure import Movement
from dancedata.scene.payload import scene_payload
from dancedata.scene.scene_list import Rhythm
from dancedata.scene.scenes import Scenes, rhythm_of
from dancedata.store import open_store, write_store
from dancedata.store.schema import Field
from tests.groups_store import HEADER, SIZES, stored

MOVES = Layer("moves", language="en", sided="no")
SCENE = Layer("scene", sided="no")
FLAGS = Layer("quality", sided="no")


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> Scenes:
    out = tmp_path_factory.mktemp("words")
    clips = []
    for clip in stored(SIZES):
        rows = [Segment(MOVES, Fraction(1, 3), Fraction(2, 3), "turn", (f"turn of {clip.id}",))]
        if clip.id == "train0_p0":
            rows += [Segment(SCENE, Fraction(0), Fraction(1), "enter", whole=True)]
            rows += [Segment(FLAGS, Fraction(0), Fraction(1), "spike")]
        clips.append(replace(clip, segments=tuple(rows)))
    write_store(out, HEADER, clips, shard_bytes=300_000)
    return Scenes(open_store(out))


def test_a_clip_has_its_segments_and_those_of_its_group(scenes: Scenes) -> None:
    alone = scenes.scene(scenes.find("train0_p1"))
    assert [(w.layer, w.text, w.member) for w in alone.words] == [
        ("moves en", "turn of train0_p1", 1), ("scene", "enter", -1),
    ]  # fmt: skip
    fps = float(scenes.grid.rate)
    turn = alone.words[0]
    assert (turn.begin, turn.end) == (np.ceil(fps / 3) / fps, np.ceil(2 * fps / 3) / fps)
    assert scene_payload(alone)["words"]["scene"][0][2:] == ["enter", -1]


def test_a_group_has_each_segment_once(scenes: Scenes) -> None:
    group = scenes.scene(scenes.find("train0"))
    words = scene_payload(group)["words"]
    assert [w[2:] for w in words["moves en"]] == [["turn of train0_p0", 0], ["turn of train0_p1", 1]]
    assert [w[2:] for w in words["scene"]] == [["enter", -1]]
    assert "quality" not in words


def test_offsets_are_those_of_the_nearest_key_motion(scenes: Scenes) -> None:
    beats = np.array([0.5, 1.0, 1.5, 2.0])
    keys = np.array([0.53, 0.93, 1.9])
    scene = scenes.scene(scenes.find("train0_p0"))
    movement = Movement(np.zeros(90), FrameGrid.of(30), keys, np.ones(3))
    planted = replace(scene, movement=movement, rhythm=Rhythm(beats, np.zeros(0)))
    wanted = [keys[np.abs(keys - beat).argmin()] - beat for beat in beats]
    np.testing.assert_allclose(planted.offsets, wanted, rtol=0, atol=1e-12)
    assert scene_payload(planted)["offsets"] == [30, -70, 400, -100]
    none = replace(planted, movement=replace(movement, key_times=np.zeros(0), prominence=np.zeros(0)))
    assert "offsets" not in scene_payload(none)


def test_downbeats_are_marked() -> None:
    rows = np.zeros((60, 2), np.float32)
    rows[[5, 20, 35, 50], 0] = 1
    rows[[20, 50], 1] = 1
    columns = Columns((Group("beat", 1, "1"), Group("downbeat", 1, "1")), Mirror((0, 1), (1, 1)))
    rhythm = rhythm_of(rows, Field("own", "audio", columns, Fraction(30)))
    np.testing.assert_allclose(rhythm.beats, np.array([5, 20, 35, 50]) / 30)
    assert rhythm.downbeats == (1, 3)
    assert (
        rhythm_of(
            rows[:, :1], Field("own", "audio", Columns(columns.groups[:1], Mirror((0,), (1,))), Fraction(30))
        ).downbeats
        == ()
    )


def test_words_are_drawn_and_said(browser, tmp_path: Path, scenes: Scenes) -> None:  # noqa: ANN001
    from dancedata.scene.page import clip_page

    page = tmp_path / "words.html"
    page.write_text(clip_page(scenes, [scenes.find("train0"), scenes.find("train1")]))
    browser.open(f"file://{page}#group=train0&t=0.5")
    browser.wait("return document.querySelector('[data-dd=clock]').textContent.includes('enter')")
    said = browser.text("clock")
    assert "turn of train0_p" in said
    assert browser.log() == []
