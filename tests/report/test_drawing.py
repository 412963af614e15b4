"""What figures show: both numbers of a comparison, units, few values as a sentence, splits, names that break well."""

import base64
import re
import struct
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.building import describe
from dancedata.core.columns import Columns, Group
from dancedata.pages import write_report
from dancedata.pages.bin_counts import ClipHistogram
from dancedata.pages.document import ColumnRange, Document, LeftOut
from dancedata.pages.figures import FigureSpec, contents_figures, movement_figures
from dancedata.pages.findings import findings
from dancedata.pages.heat import Timeline, joint_map
from dancedata.pages.markup import name_text, rounded
from dancedata.pages.scaling import scaled_groups
from dancedata.pages.svg import bars, by_joint, histogram, strips
from dancedata.scene.pieces import ClipReader
from dancedata.scene.pose_space import frontal
from dancedata.store import open_store
from dancedata.testing.stores import write_random_store


def texts(svg: str, kind: str) -> list[tuple[float, str]]:
    """Return the places and texts of one class."""
    return [(float(x), text) for x, text in re.findall(rf'<text x="([\d.]+)"[^>]*class="{kind}">([^<]*)<', svg)]


def ends(svg: str, kind: str) -> list[float]:
    """Return the right ends of the rectangles of one class."""
    boxes = re.findall(rf'<rect class="{kind}" x="([\d.]+)"[^>]*width="([\d.]+)"', svg)
    return [float(x) + float(width) for x, width in boxes]


def test_both_numbers_of_a_row_stand_at_their_own_ends() -> None:
    svg = bars({"gBR": {"train": 20}, "d01": {"train": 5}}, "x", other={"gBR": 200, "d01": 5})
    own, other = texts(svg, "value"), texts(svg, "beside")
    assert [text for _, text in own] == ["20", "5"]
    assert [text for _, text in other] == ["(200)", "(5)"]
    for (x, _), end in zip(own, ends(svg, "s0"), strict=True):
        assert 0 < x - end < 10
    assert 0 < other[0][0] - ends(svg, "other")[0] < 10
    assert other[1][0] >= own[1][0] + 14, "not over this dataset's number"
    assert all(x + 7 * len(text) <= 420 for x, text in [*own, *other])
    assert texts(bars({"gBR": {"train": 20}}, "x"), "beside") == []


def test_datasets_of_different_sizes_are_compared_by_shares(numbers: Document) -> None:
    double = {name: {s: 2 * n for s, n in by.items()} for name, by in numbers.contents.windows_by_genre.items()}
    other = replace(numbers, contents=replace(numbers.contents, windows_by_genre=double))
    figures = {figure.key: figure for figure in contents_figures(FigureSpec(numbers, other))}
    genre, split = figures["windows_by_genre"], figures["windows_by_split"]
    shares = texts(genre.body, "value")
    assert shares
    assert sum(float(text.removesuffix(" %")) for _, text in shares) == pytest.approx(100, abs=0.5)
    assert [f"({text})" for _, text in shares] == [text for _, text in texts(genre.body, "beside")]
    assert re.match(r"% of each dataset's sum, [\d,]+ and [\d,]+", genre.note)
    counts = [sum(by.values()) for by in numbers.contents.windows_by_genre.values()]
    assert [row[-1] for row in genre.rows] == [2 * n for n in counts], "the table has counts"
    assert "%" not in split.body
    assert not split.note.startswith("%")


def test_every_histogram_names_the_unit_of_its_heights(numbers: Document) -> None:
    drawing = FigureSpec(numbers)
    figures = [*contents_figures(drawing), *movement_figures(drawing, ())]
    drawn = {f.key: f.note.split(";")[0] for f in figures if f.head[:2] == ("from", "to")}
    assert drawn["speed_m_s"] == "% of frames"
    assert drawn["root_extent_m"] == "% of clips"
    assert drawn["sliding_m_s"] == "% of frames of feet in contact"
    assert {note[:5] for note in drawn.values()} == {"% of "}


@pytest.mark.parametrize(("values", "distinct"), [
    ([13.5] * 4, ((13.5, 4),)), ([-0.178, -0.176, -0.177], ((-0.177, 3),)),
    ([9.6, 13.5, 13.5], ((9.6, 1), (13.5, 2))), ([9.6, 13.5, 20.0], ()), ([], ()),
])  # fmt: skip
def test_few_values_are_counted(values: list[float], distinct: tuple[tuple[float, int], ...]) -> None:
    edges = np.arange(-1, 41) * 0.5
    assert ClipHistogram.of_groups({"all": values}, edges.tolist()).distinct == distinct


def test_few_values_are_one_sentence(numbers: Document) -> None:
    (length,) = (f for f in contents_figures(FigureSpec(numbers)) if f.key == "length_s")
    assert length.body == "<p>6 seconds in 8 clips</p>"
    assert length.rows == ()
    other = replace(numbers, about=replace(numbers.about, name="old"))
    (length,) = (f for f in contents_figures(FigureSpec(numbers, other)) if f.key == "length_s")
    assert length.body == "<p>6 seconds in 8 clips</p><p>6 seconds in 8 clips <small>(old)</small></p>"


def test_movement_has_a_line_for_each_split(numbers: Document) -> None:
    speed = numbers.movement.speed_m_s
    assert list(speed.by_split) == ["train", "val", "test"]
    assert np.sum(list(speed.by_split.values()), axis=0).tolist() == speed.counts["all"]
    extent = numbers.movement.root_extent_m
    assert np.sum(list(extent.by_split.values()), axis=0).tolist() == extent.counts["all"]
    (figure,) = (f for f in movement_figures(FigureSpec(numbers), ()) if f.key == "speed_m_s")
    assert figure.head == ("from", "to", "all", "train", "val", "test")
    assert figure.legend == ("train", "val", "test")
    assert re.findall(r'<path class="line (s\d)"', figure.body) == ["s0", "s1", "s2"]
    svg = histogram((0, 1, 2), {"all": [3, 1]}, "x", lines={"train": [1, 0], "test": [1, 1]})
    first, second = re.findall(r'<path class="line s\d" d="([^"]*)"', svg)
    assert first.count("V") == second.count("V") == 3
    assert svg.count('<rect class="pale"') == 2
    compared = [f for f in movement_figures(FigureSpec(numbers, numbers), ()) if f.key == "speed_m_s"]
    assert "line s" not in compared[0].body, "the outline of the other dataset stands alone"


def test_names_break_after_underscores_only(demo_page: Path) -> None:
    assert name_text("g<_a") == "g&lt;_<wbr>a"
    page = demo_page.read_text()
    assert "gBR_<wbr>" in page or "gJB_<wbr>" in page
    style = re.findall(r"\.list a,\s+\.stills a,\s+\.paths a \{([^}]*)\}", page)
    assert any("text-decoration: none" in rule for rule in style)


@pytest.mark.parametrize(
    ("value", "text"),
    [(138.9, "140"), (226.8, "230"), (3.046, "3.0"), (0.4119, "0.41"), (-0.177, "−0.18"), (0.0, "0"), (None, "–")],
)
def test_measured_numbers_have_two_digits(value: float | None, text: str) -> None:
    assert rounded(value) == text


def test_a_partial_download_is_a_note(numbers: Document) -> None:
    left_out = {
        "missing_motion": LeftOut(988, (), ""), "broken_file": LeftOut(2, (), ""), "ignored": LeftOut(1, (), ""),
    }  # fmt: skip
    found = [f for f in findings(replace(numbers, left_out=left_out, totals=replace(numbers.totals, left_out=991)))
             if f.figure == "left_out"]  # fmt: skip
    assert [f.kind for f in found] == ["look", "note"]
    assert found[0].text == "left out: broken_file 2"
    assert found[1].text.startswith("left out: missing_motion 988, ignored 1; files that were not downloaded")


# Values over time


def test_a_map_of_joints_has_seconds_and_beats() -> None:
    speed = np.zeros((60, 3))
    speed[:30, 1] = 2.0
    html = joint_map(speed, ["pelvis", "left_hip", "<b>"], Timeline(2.0, (0.5, 1.0, 7.0)), "x")
    assert "--height:240px" in html
    assert re.findall(r'<i style="left:([\d.]+)%">', html) == ["25.00", "50.00"]
    assert re.findall(r"<span style=.left:([\d.]+)%.>([\d.]+)<", html)[-1] == ("100.00", "2")
    assert re.findall(r"<li[^>]*>(.*?)</li>", html) == ["pelvis", "left hip", "&lt;b&gt;"]
    assert pixels(html).shape == (3, 60)
    assert (pixels(html) == 31).tolist() == [[False] * 60, [True] * 30 + [False] * 30, [False] * 60]


def pixels(html: str) -> np.ndarray:
    data = base64.b64decode(re.findall(r"base64,([^\"]*)", html)[0])
    width, height = struct.unpack(">II", data[16:24])
    start = data.index(b"IDAT") + 4
    return np.frombuffer(zlib.decompress(data[start:]), np.uint8).reshape(height, width + 1)[:, 1:]


def test_the_page_folds_columns_and_shows_joints(demo_page: Path) -> None:
    figures = dict(re.findall(r'<figure id="r-(\w+)"(.*?)</figure>', demo_page.read_text(), re.S))
    body, _, fold = figures["heat_edge151"].partition("<summary>all columns</summary>")
    assert body.count('class="heat joints"') == 1
    assert body.count("<li") == 24
    assert 'class="heat"' in fold
    assert "joints" not in figures["heat_librosa35"]


# Columns


def test_columns_of_a_joint_are_one_mark_and_those_of_0_and_1_are_shares() -> None:
    parts = ("hip.0x", "hip.1x", "knee.0x", "knee.1x")
    columns = Columns((Group("rot", 4, "1", parts), Group("state", 2, "1", ("l", "r"))))
    ranges = [
        ColumnRange("rot.hip.0x", -1, -0.5, -0.2, 0.0, 0.2, 0.5, 0.9, 0.0),
        ColumnRange("rot.hip.1x", -0.8, -0.6, -0.1, 0.0, 0.3, 0.4, 1.0, 0.0),
        ColumnRange("rot.knee.0x", 0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.3),
        ColumnRange("rot.knee.1x", 0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.3),
        ColumnRange("state.l", 0, 0, 0, 1, 1, 1, 1, 0.75),
        ColumnRange("state.r", 0, 0, 0, 0, 0, 0, 1, 0.02),
    ]
    hip, knee = by_joint(ranges[:4])
    assert hip == ColumnRange("rot.hip", -1, -0.6, -0.2, None, 0.3, 0.5, 1.0)
    assert knee.max == 0.7
    drawn = strips(columns, ranges)
    assert "rot: 4 columns, one mark for each of 2 joints" in drawn
    assert drawn.count('class="whisker"') == 2
    assert [text for _, text in texts(drawn, "value")] == ["75 %", "2 %"]


def test_columns_that_explode_are_found(demo: Path, relabelled: Any) -> None:
    """A column that train hardly moves, and test does: the scaler divides by 5e-4."""
    with open_store(demo) as store:
        rows = {clip.id: np.array(clip.read("edge151")) for clip in store}
        splits = {clip.id: clip.split for clip in store}
        labels = store.fields["edge151"].labels
    planted = 4 + 2  # of the translation
    for clip, of_clip in rows.items():
        of_clip[:, planted] = np.linspace(0, 5e-4, len(of_clip))
        of_clip[7, planted] += 0.4 * (splits[clip] == "test")
        of_clip[7, 0] += 3 * (splits[clip] == "val")
    with open_store(relabelled(lambda k: {"motion": {"edge151": list(rows.values())[k]}})) as store:
        groups = {group.group: group for group in scaled_groups(store, "edge151")}
        assert scaled_groups(store, "librosa35") == ()
        covered = {(w.clip, frame) for w in store.windows("train") for frame in range(w.start, w.start + w.length)}
    train = np.array([rows[clip][frame] for clip, frame in sorted(covered)])
    train, rest = train.astype(np.float64), np.concatenate([v for k, v in rows.items() if splits[k] != "train"])
    low, high = train.min(axis=0), train.max(axis=0)
    divisor = np.where(high - low < 1e-6, 1.0, high - low)
    largest = np.abs(2 * (rest - low) / divisor - 1).max(axis=0)
    five = [np.abs(2 * (train.mean(axis=0) + k * train.std(axis=0) - low) / divisor - 1) for k in (-5, 5)]
    moved = groups["translation"]
    assert moved.narrow == (labels[planted],)
    assert [label for label, _ in moved.exploding] == [labels[planted]]
    assert moved.exploding[0][1] == pytest.approx(largest[planted], rel=1e-3)
    assert moved.largest == pytest.approx(largest[4:7].max(), rel=1e-3)
    assert moved.five_sigma == pytest.approx(np.max(five, axis=0)[4:7].max(), rel=1e-3)
    columns = {"contact": slice(0, 4), "rotation_6d": slice(7, 151)}
    for name, span in columns.items():
        assert groups[name].five_sigma == pytest.approx(np.max(five, axis=0)[span].max(), rel=1e-3)
        assert groups[name].largest == pytest.approx(largest[span].max(), rel=1e-3)
    assert (moved.min, moved.max) == (low[4:7].min(), high[4:7].max())
    assert moved.std == pytest.approx(np.median(train.std(axis=0)[4:7]), rel=1e-3)
    assert groups["rotation_6d"].exploding == ()


# Poses


def test_poses_face_the_front(demo: Path) -> None:
    with open_store(demo) as store:
        piece = ClipReader.of(store).piece(store.clips()[0])
    assert piece is not None
    joints, names = piece.figure.joints, piece.figure.skeleton.joints
    poses = frontal(joints, names)
    across = poses[:, names.index("left_hip")] - poses[:, names.index("right_hip")]
    assert np.abs(across[:, 2]).max() < 1e-12
    assert across[:, 0].min() > 0
    assert np.abs(poses[:, 0]).max() == 0
    bones = np.linalg.norm(joints[:, 5] - joints[:, 2], axis=1)
    np.testing.assert_allclose(np.linalg.norm(poses[:, 5] - poses[:, 2], axis=1), bones)
    turned = joints @ np.array([[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]]) + [3, 0, -2]
    np.testing.assert_allclose(frontal(turned, names), poses, atol=1e-12)
    np.testing.assert_array_equal(frontal(joints, ["a"] * len(names)), joints - joints[:, :1])


def test_stills_lead_to_their_clips(demo: Path, tmp_path: Path) -> None:
    write_report(demo, tmp_path / "page.html", clips=3)
    strip = (tmp_path / "page.html").read_text().partition('<ul class="stills"')[2].partition("</ul>")[0]
    assert strip.count("<svg") == strip.count("<li>") == 8
    assert strip.count('href="#clip=') == 3
    numbers = [float(x) for x in re.findall(r"[ML](-?[\d.]+)", strip)]
    assert min(numbers) >= 0
    assert max(numbers) <= 90


# Words next to figures: what is measured, in which field and unit, and numbers that are not cut.


def rows(n: int) -> list[ColumnRange]:
    return [ColumnRange(f"c{k}", 0.00166, 0.05, 0.1, 0.2, 0.3, 0.4, 0.765) for k in range(n)]


def test_a_panel_names_columns_and_units() -> None:
    columns = Columns((Group("contact", 4, "1"), Group("beat", 1, "0/1"), Group("layer7", 450, "m")))
    drawn = strips(columns, rows(455))
    assert re.findall(r'text-anchor="start">(.*?)</text>', drawn) == [
        "contact: 4 columns", "beat, 0/1: 1 column", "layer7, m: 450 columns, one of 3 is drawn",
    ]  # fmt: skip


def test_licences_of_weights_are_on_the_page_and_in_info(relabelled: Any, tmp_path: Path) -> None:
    stated = {"librosa35": {"model": "<mert>", "licence": "cc-by-nc-4.0"}, "gone": {"licence": "x"}}
    out = relabelled(lambda k: {}, meta={"encoders": stated})
    with open_store(out) as store:
        assert store.weights == {"librosa35": "<mert>, licence: cc-by-nc-4.0"}
    assert "  weights of librosa35: <mert>, licence: cc-by-nc-4.0" in describe.describe_store(out).splitlines()
    write_report(out, tmp_path / "page.html", clips="none")
    page = (tmp_path / "page.html").read_text()
    assert "<b>weights of librosa35</b>: &lt;mert&gt;, licence: cc-by-nc-4.0" in page


def test_info_rounds_minutes_as_the_card_does(tmp_path: Path) -> None:
    """81 s are 1.35 minutes: 1.4 on both, though 0.0225 * 60 is less in binary."""
    write_random_store(tmp_path, clips={"val": 1}, n_frames=(2430, 2430))
    lines = describe.describe_store(tmp_path).splitlines()
    assert [line.split()[-1] for line in lines if line.startswith("  val ")] == ["1.4"]
