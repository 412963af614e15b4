"""Words next to figures: what is measured, in which field and unit, and numbers that are not cut."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.building import describe
from dancedata.core.columns import Columns, Group
from dancedata.pages import write_report
from dancedata.pages.document import ColumnRange
from dancedata.pages.heat import heat_map
from dancedata.pages.svg import strips
from dancedata.store import open_store
from dancedata.testing.stores import write_random_store


def rows(n: int) -> list[ColumnRange]:
    return [ColumnRange(f"c{k}", 0.00166, 0.05, 0.1, 0.2, 0.3, 0.4, 0.765) for k in range(n)]


def test_a_panel_names_columns_and_units() -> None:
    columns = Columns((Group("contact", 4, "1"), Group("beat", 1, "0/1"), Group("layer7", 450, "m")))
    drawn = strips(columns, rows(455))
    assert re.findall(r'text-anchor="start">(.*?)</text>', drawn) == [
        "contact: 4 columns", "beat, 0/1: 1 column", "layer7, m: 450 columns, one of 3 is drawn",
    ]  # fmt: skip


def test_numbers_of_a_panel_lie_within_the_picture() -> None:
    """A text of 15 units in the wide picture has digits of up to 9 units."""
    drawn = strips(Columns((Group("beat", 1, "0/1"),)), rows(1))
    for x, number in re.findall(r'<text x="([\d.]+)" y="[\d.]+" text-anchor="end">(.*?)</text>', drawn):
        assert float(x) - 8 * len(number) > 0


def test_names_next_to_a_heat_map_have_room() -> None:
    columns = Columns((Group("onset_envelope", 1, "dB"), Group("mfcc", 32, "dB"), Group("beat", 2, "0/1")))
    (height,) = re.findall(r"height:(\d+)px", heat_map(np.zeros((9, 35)), columns, "x"))
    assert int(height) / 35 >= 12
    (height,) = re.findall(r"height:(\d+)px", heat_map(np.zeros((9, 32)), Columns((Group("layer7", 32, "1"),)), "x"))
    assert int(height) == 7 * 32


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
