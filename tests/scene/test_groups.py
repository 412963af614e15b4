"""A group plays whole: one entry of the list, all dancers in one world, distances and contacts between them."""

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata.core.columns import Columns, Group, Mirror
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.segments import Layer, Segment
from dancedata.core.skeleton import SMPL24
from dancedata.metrics import facing_angles
from dancedata.scene.comparisons import comparison_of, comparison_payload, file_format
from dancedata.scene.figure import Figure, Movement
from dancedata.scene.group_scene import GroupScene
from dancedata.scene.page import clip_page
from dancedata.scene.palette import DANCERS
from dancedata.scene.payload import item_rows, link, scene_payload
from dancedata.scene.scene_list import Rhythm
from dancedata.scene.scenes import Scenes, rhythm_of
from dancedata.scene.selection import ViewSelection
from dancedata.scene.source import ClipSource
from dancedata.store import open_store, write_store
from dancedata.store.schema import Field
from dancedata.viewer.notebook import html_of
from dancedata.viewer.server import Site
from dancedata.viewer.view import ViewRequest, export_page
from tests.groups_store import HEADER, SIZES, stored
from tests.messages import raises_message
from tests.report.test_colours import contrast, luminance
from tests.scene.helpers import serving
from tests.scene.test_scenes import unpacked

TWO, SEVEN = "-Ab_cdEf123_01_0_180", "plainid0123_04_829_1009"


@pytest.fixture(scope="module")
def groups(crowd: Path) -> Scenes:
    return Scenes(dancedata.open(crowd))


def test_the_list_is_group_by_group(groups: Scenes) -> None:
    sizes = {item.id: len(item.members) for item in groups.items}
    assert sorted(sizes.values()) == [2, 2, 3, 5, 7, 7]
    assert [item.number for item in groups.items] == list(range(6))
    assert sum(sizes.values()) == len(groups.store.clips())
    copy = groups.find(f"{TWO}__mirror")
    assert (copy.source, copy.members[1].source) == (TWO, f"{TWO}_p1")
    rows = item_rows(groups.items, tuple(groups.flag_count(item) for item in groups.items))
    names = [rows["clips"][row[0]][0] for row in rows["items"]]
    assert names == [item.id for item in groups.items]
    assert [m[:2] for m in rows["clips"][names.index(TWO)][6]] == [[f"{TWO}_p0", 0], [f"{TWO}_p1", 1]]
    assert rows["palette"] == DANCERS


def test_a_dancer_is_found_by_himself_and_a_group_by_its_name(groups: Scenes) -> None:
    group, dancer = groups.find(SEVEN), groups.find(f"{SEVEN}_p3")
    assert (dancer.number, dancer.members, dancer.part) == (group.number, (), "3")
    assert groups.scene(dancer).figure is not None
    assert link(group, at=1.5) == f"#group={SEVEN}&t=1.500"
    assert link(dancer) == f"#clip={SEVEN}_p3"
    with pytest.raises(UsageError, match=r"no clip or group named .* The nearest names: .*; 32 names in all: "):
        groups.find(f"{SEVEN}_p9")


def test_all_dancers_are_in_the_payload_at_their_places(groups: Scenes) -> None:
    scene = groups.scene(groups.find(SEVEN))
    payload = json.loads(json.dumps(scene_payload(scene)))
    for k, member in enumerate(payload["members"]):
        wanted = dancedata.decode(groups.store[f"{SEVEN}_p{k}"].read("edge151"), "edge151", fps=30).joints()
        assert np.abs(unpacked(member["figure"]) - wanted).max() <= 0.0005 + 1e-6
        assert (member["clip"], member["member"], member["part"]) == (f"{SEVEN}_p{k}", k, str(k))
        assert {"speed", "keys", "flags"} <= set(member)
    floor = round(min(s.figure.floor for s in scene.members), 4)
    assert {member["figure"]["floor"] for member in payload["members"]} == {floor}
    assert len(payload["pairs"]) == 21
    assert (payload["figure"], payload["group"], payload["id"]) == (None, SEVEN, SEVEN)
    assert payload["beats"] == scene_payload(scene.members[0])["beats"]


def test_missing_dancers_are_named(groups: Scenes, lacking: Path) -> None:
    scenes = Scenes(dancedata.open(lacking))
    scene = scenes.scene(scenes.find(SEVEN))
    assert scene.item.n_source == 7
    assert "5 of 7 dancers are stored: 0, 2, 3, 5, 6; the others were left out" in scene.notes
    assert [m["member"] for m in scene_payload(scene)["members"]] == [0, 2, 3, 5, 6]
    assert not any("stored" in note for note in groups.scene(groups.find(SEVEN)).notes)


def test_duets_have_roles_distances_contacts_and_collisions(duets: Path) -> None:
    scenes = Scenes(dancedata.open(duets))
    scene = scenes.scene(scenes.find("Waltz_5_0"))
    assert [member.item.part for member in scene.members] == ["0 follower", "1 leader"]
    (pair,) = scene.together.pairs
    roots = [member.figure.joints[:, 0] for member in scene.members]
    assert pair.distance_m == pytest.approx(np.linalg.norm(roots[0] - roots[1], axis=1))
    assert pair.contacts
    assert pair.collisions
    payload = scene_payload(scene)["pairs"][0]
    assert payload["collisions"] == [list(span) for span in pair.collisions]
    assert payload["contacts"][0][:4] == list(pair.contacts[0][:4])
    assert payload["contacts"][0][4] == round(1000 * pair.contacts[0].distance_m)


def test_a_request_begins_with_a_group_a_dancer_or_a_window(crowd: Path) -> None:
    loop = f"group={TWO}&t=1.000&loop=30-90"
    for name, shown in ((TWO, f"group={TWO}"), (f"{TWO}~p1", f"clip={TWO}_p1"), (f"{TWO}@30+60", loop)):
        with serving(ViewRequest(crowd, name)) as address:
            assert address.partition("#")[2] == shown
    request = ViewRequest(crowd, f"{TWO}@0+9999")
    with raises_message(UsageError, "within", where="9999"):
        request.first(request.scenes())
    page = export_page(ViewRequest(crowd, f"{TWO}@15+60"), crowd.parent / "loop.html").read_text()
    assert f'"at":"#group={TWO}\\u0026t=0.500\\u0026loop=15-75"' in page


def test_facing_is_the_angle_to_the_other() -> None:
    place = np.zeros((2, 1, 3, 3))
    place[:, :, 1:] = [[[0.1, 0, 0], [-0.1, 0, 0]]]  # left hip at +X: both face +Z
    place[1, :, :, 2] += 1.0
    angles = facing_angles(place)
    assert angles[0, 1] == pytest.approx([0.0], abs=1e-6)
    assert angles[1, 0] == pytest.approx([180.0], abs=1e-6)
    assert np.isnan(angles[0, 0]).all()
    z_up = place[..., [0, 2, 1]] * [1, -1, 1]
    assert facing_angles(z_up, up="z")[0, 1] == pytest.approx([0.0], abs=1e-6)
    place[1] = place[0] + [0, 1, 0]
    assert np.isnan(facing_angles(place)[0, 1]).all()  # above each other


def test_a_lifted_partner_stays_in_the_air_and_far_bodies_do_not_meet() -> None:
    joints = np.repeat(np.random.default_rng(0).random((1, 22, 3)), 4, axis=0)
    skeleton, grid = SMPL24.subset("body", SMPL24.joints[:22]), dancedata.core.grid.FrameGrid.of(30)
    lifted = joints + np.array([[0, 0.8, 0], [3, 0.8, 0], [0, 0.8, 9], [0, 0.8, 0]])[:, None]
    together = GroupScene.of([Figure.of_joints(j, skeleton, grid) for j in (joints, lifted)])
    assert together.floor == pytest.approx(Figure.of_joints(joints, skeleton, grid).floor)
    assert together.pairs[0].collides[[1, 2]].tolist() == [False, False]
    assert together.pairs[0].collides[0] == together.pairs[0].collides[3]
    other = SMPL24.subset("part", SMPL24.joints[:12])
    short = GroupScene.of([Figure.of_joints(j[:, :12], other, grid) for j in (joints, joints)])
    assert not short.touch
    assert short.pairs[0].collisions == ()


def test_a_group_is_compared_dancer_by_dancer(groups: Scenes, crowd: Path, tmp_path: Path) -> None:
    scene = groups.scene(groups.find(TWO))
    first = scene.members[0]
    np.save(tmp_path / f"{first.item.clip.id}.npy", first.figure.joints + np.array((0.003, 0.0, 0.004)))
    files = comparison_of(tmp_path, groups, file_format(groups.store))
    payload = comparison_payload(files, scene)
    assert payload["mean"] == pytest.approx(5.0, abs=1e-3)
    assert payload["note"].endswith("has no file for this clip (dancers 1)")
    assert ["figure" in member for member in payload["members"]] == [True, False]
    same = comparison_payload(comparison_of(crowd, groups, file_format(groups.store)), scene)
    assert (same["mean"], same["note"]) == (0.0, "")


def test_the_server_gives_groups_by_number(groups: Scenes, crowd_source: Path) -> None:
    site = Site(groups, ClipSource(groups.store, crowd_source))
    number = groups.find(SEVEN).number
    assert len(json.loads(site.answer(f"/clip/{number}", None).body)["members"]) == 7
    assert site.answer(f"/clip/{number}/music", None).kind == "audio/flac"
    assert b'"group"' in site.answer(f"/clip/{number}", "edge151").body


def test_a_group_and_a_dancer_are_exported(crowd: Path, tmp_path: Path) -> None:
    page = export_page(ViewRequest(crowd, TWO), tmp_path / "group.html").read_text()
    assert page.count('"part":') == 2
    alone = export_page(ViewRequest(crowd, f"{TWO}_p1"), tmp_path / "alone.html").read_text()
    assert '"members":' not in alone.partition("</script>")[0]
    scenes = Scenes(dancedata.open(crowd))
    original = ViewSelection.of(ViewRequest(crowd, TWO)).comparisons
    assert clip_page(scenes, [scenes.find(TWO)], comparisons=original) == page
    assert "palette" not in alone.partition("</script>")[0]


def test_a_dancer_shows_himself_in_a_notebook(crowd: Path) -> None:
    shown = html_of(dancedata.open(crowd)[f"{TWO}_p1"])
    assert "&quot;members&quot;" not in shown
    assert f"{TWO}_p1" in shown


@pytest.mark.parametrize(("theme", "background"), [("dark", "#14161a"), ("light", "#f6f7f8")])
def test_colours_of_dancers_stand_out(theme: str, background: str) -> None:
    assert len({tones[0] for tones in DANCERS[theme]}) == 8
    for middle, left, right in DANCERS[theme]:
        assert luminance(left) > luminance(middle) > luminance(right)
        for colour in (middle, left, right):
            assert contrast(colour, background) >= 3


# Segments on the time axis, key motions on beats, and downbeats: each against plain numpy on planted cases.


MOVES = Layer("moves", language="en", sided="no")
SCENE = Layer("scene", sided="no")
FLAGS = Layer("quality", sided="no")


@pytest.fixture(scope="module")
def worded(tmp_path_factory: pytest.TempPathFactory) -> Scenes:
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


def test_a_clip_has_its_segments_and_those_of_its_group(worded: Scenes) -> None:
    alone = worded.scene(worded.find("train0_p1"))
    assert [(w.layer, w.text, w.member) for w in alone.words] == [
        ("moves en", "turn of train0_p1", 1), ("scene", "enter", -1),
    ]  # fmt: skip
    fps = float(worded.grid.rate)
    turn = alone.words[0]
    assert (turn.begin, turn.end) == (np.ceil(fps / 3) / fps, np.ceil(2 * fps / 3) / fps)
    assert scene_payload(alone)["words"]["scene"][0][2:] == ["enter", -1]


def test_a_group_has_each_segment_once(worded: Scenes) -> None:
    group = worded.scene(worded.find("train0"))
    words = scene_payload(group)["words"]
    assert [w[2:] for w in words["moves en"]] == [["turn of train0_p0", 0], ["turn of train0_p1", 1]]
    assert [w[2:] for w in words["scene"]] == [["enter", -1]]
    assert "quality" not in words


def test_offsets_are_those_of_the_nearest_key_motion(worded: Scenes) -> None:
    beats = np.array([0.5, 1.0, 1.5, 2.0])
    keys = np.array([0.53, 0.93, 1.9])
    scene = worded.scene(worded.find("train0_p0"))
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


def test_words_are_drawn_and_said(browser, tmp_path: Path, worded: Scenes) -> None:  # noqa: ANN001
    page = tmp_path / "words.html"
    page.write_text(clip_page(worded, [worded.find("train0"), worded.find("train1")]))
    browser.open(f"file://{page}#group=train0&t=0.5")
    browser.wait("return document.querySelector('[data-dd=clock]').textContent.includes('enter')")
    said = browser.text("clock")
    assert "turn of train0_p" in said
    assert browser.log() == []
