"""What figures show: both numbers of a comparison, units, few values as a sentence, splits, names that break well."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.clip import Reject
from dancedata.report import write_report
from dancedata.report.document import LeftOut, findings
from dancedata.report.figures import Drawing, contents_figures, movement_figures
from dancedata.report.markup import name_text, rounded, table
from dancedata.report.svg import bars, histogram
from dancedata.report.tally import ClipHistogram


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


def test_datasets_of_different_sizes_are_compared_by_shares(demo: Path) -> None:
    numbers = write_report(demo).numbers
    double = {name: {s: 2 * n for s, n in by.items()} for name, by in numbers.contents.windows_by_genre.items()}
    other = replace(numbers, contents=replace(numbers.contents, windows_by_genre=double))
    figures = {figure.key: figure for figure in contents_figures(Drawing(numbers, other))}
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


def test_every_histogram_names_the_unit_of_its_heights(demo: Path) -> None:
    drawing = Drawing(write_report(demo).numbers)
    figures = [*contents_figures(drawing), *movement_figures(drawing, ())]
    drawn = {f.key: f.note.split(";")[0] for f in figures if f.head[:2] == ("from", "to")}
    assert drawn["speed_m_s"] == "% of frames"
    assert drawn["root_extent_m"] == "% of clips"
    assert drawn["sliding_m_s"] == "% of frames of feet in contact"
    assert {note[:5] for note in drawn.values()} == {"% of "}


@pytest.mark.parametrize(
    ("values", "distinct"),
    [
        ([13.5] * 4, ((13.5, 4),)),
        ([-0.178, -0.176, -0.177], ((-0.177, 3),)),
        ([9.6, 13.5, 13.5], ((9.6, 1), (13.5, 2))),
        ([9.6, 13.5, 20.0], ()),
        ([], ()),
    ],
)
def test_few_values_are_counted(values: list[float], distinct: tuple[tuple[float, int], ...]) -> None:
    edges = np.arange(-1, 41) * 0.5
    assert ClipHistogram.of_groups({"all": values}, edges.tolist()).distinct == distinct


def test_few_values_are_one_sentence(demo: Path) -> None:
    numbers = write_report(demo).numbers
    (length,) = (f for f in contents_figures(Drawing(numbers)) if f.key == "length_s")
    assert length.body == "<p>6 seconds in 8 clips</p>"
    assert length.rows == ()
    other = replace(numbers, about=replace(numbers.about, name="old"))
    (length,) = (f for f in contents_figures(Drawing(numbers, other)) if f.key == "length_s")
    assert length.body == "<p>6 seconds in 8 clips</p><p>6 seconds in 8 clips <small>(old)</small></p>"


def test_movement_has_a_line_for_each_split(demo: Path) -> None:
    numbers = write_report(demo).numbers
    speed = numbers.movement.speed_m_s
    assert list(speed.by_split) == ["train", "val", "test"]
    assert np.sum(list(speed.by_split.values()), axis=0).tolist() == speed.counts["all"]
    extent = numbers.movement.root_extent_m
    assert np.sum(list(extent.by_split.values()), axis=0).tolist() == extent.counts["all"]
    (figure,) = (f for f in movement_figures(Drawing(numbers), ()) if f.key == "speed_m_s")
    assert figure.head == ("from", "to", "all", "train", "val", "test")
    assert figure.legend == ("train", "val", "test")
    assert re.findall(r'<path class="line (s\d)"', figure.body) == ["s0", "s1", "s2"]
    svg = histogram((0, 1, 2), {"all": [3, 1]}, "x", lines={"train": [1, 0], "test": [1, 1]})
    first, second = re.findall(r'<path class="line s\d" d="([^"]*)"', svg)
    assert first.count("V") == second.count("V") == 3
    assert svg.count('<rect class="pale"') == 2
    compared = [f for f in movement_figures(Drawing(numbers, numbers), ()) if f.key == "speed_m_s"]
    assert "line s" not in compared[0].body, "the outline of the other dataset stands alone"


def test_names_break_after_underscores_only(demo: Path, tmp_path: Path) -> None:
    assert name_text("g<_a") == "g&lt;_<wbr>a"
    write_report(demo, tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert "gBR_<wbr>" in page or "gJB_<wbr>" in page
    style = re.findall(r"\.list a,\s+\.paths a \{([^}]*)\}", page)
    assert any("text-decoration: none" in rule for rule in style)


@pytest.mark.parametrize(
    ("value", "text"),
    [(138.9, "140"), (226.8, "230"), (3.046, "3.0"), (0.4119, "0.41"), (-0.177, "−0.18"), (0.0, "0"), (None, "–")],
)
def test_measured_numbers_have_two_digits(value: float | None, text: str) -> None:
    assert rounded(value) == text


def test_a_partial_download_is_a_note(demo: Path) -> None:
    numbers = write_report(demo).numbers
    left_out = {
        "missing_motion": LeftOut(988, (), ""),
        "broken_file": LeftOut(2, (), ""),
        "ignored": LeftOut(1, (), ""),
    }
    found = [f for f in findings(replace(numbers, left_out=left_out, totals=replace(numbers.totals, left_out=991)))
             if f.figure == "left_out"]  # fmt: skip
    assert [f.kind for f in found] == ["look", "note"]
    assert found[0].text == "left out: broken_file 2"
    assert found[1].text.startswith("left out: missing_motion 988, ignored 1; files that were not downloaded")


def test_rows_of_lists_are_cards_on_small_screens() -> None:
    html = table(("clip", "split <b>"), [("a", "train")], "list")
    assert '<td data-label="split &lt;b&gt;">train</td>' in html
    assert "data-label" not in table(("", "train"), [("train", 1)], "matrix")


def test_left_out_reasons_of_a_build_are_notes(relabelled: Any) -> None:
    path = relabelled(lambda k: {}, rejects=[Reject("missing_motion", "c1"), Reject("ignored", "c2")])
    found = [f for f in findings(write_report(path).numbers) if f.figure == "left_out"]
    assert [f.kind for f in found] == ["note"]
