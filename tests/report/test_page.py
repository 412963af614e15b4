"""The page: its tables hold the numbers of the document, nothing in it runs or is fetched, equal bytes every time."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest

from dancedata import comparison
from dancedata.core.errors import UsageError
from dancedata.files.page_files import PageFiles
from dancedata.pages import Report, write_report
from dancedata.pages.markup import Figure, number
from dancedata.pages.page import grid
from dancedata.scene.page import source_hash
from dancedata.store import open_store
from tests.messages import raises_message
from tests.report.conftest import HOSTILE

VOID = {"meta", "link", "img", "br", "wbr", "input", "hr"}


class Page(HTMLParser):
    """Elements of a page: attributes, texts of scripts, tables of figures; tags have to match."""

    def __init__(self, page: Path | str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.scripts: list[tuple[dict[str, str], str]] = []
        self.styles: list[str] = []
        self.tables: dict[str, list[list[str]]] = {}
        self.stack: list[str] = []
        self.figure = ""
        self.text = page if isinstance(page, str) else page.read_text(encoding="utf-8")
        self.feed(self.text)
        self.close()
        assert self.stack == []

    def handle_starttag(self, tag, attrs):
        about = {k: v or "" for k, v in attrs}
        self.elements.append((tag, about))
        if tag not in VOID:
            self.stack.append(tag)
        if tag == "script":
            self.scripts.append((about, ""))
        if tag == "figure":
            self.figure = about["id"]
        if tag == "tr":
            self.tables.setdefault(self.figure, []).append([])
        if tag in ("td", "th"):
            self.tables[self.figure][-1].append("")

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, {k: v or "" for k, v in attrs}))

    def handle_endtag(self, tag):
        assert self.stack.pop() == tag

    def handle_data(self, data):
        if self.stack and self.stack[-1] == "script":
            about, text = self.scripts[-1]
            self.scripts[-1] = about, text + data
        elif self.stack and self.stack[-1] == "style":
            self.styles.append(data)
        elif {"td", "th"} & set(self.stack) and self.figure in self.tables:
            self.tables[self.figure][-1][-1] += data

    def policy(self) -> str:
        return next(a["content"] for t, a in self.elements if t == "meta" and "Content-Security" in str(a))


def check_safe(page: Page) -> None:
    """Nothing is fetched, and only scripts whose hash is in the policy run."""
    for tag, about in page.elements:
        assert not [name for name in about if name.startswith("on")], (tag, about)
        for name in ("src", "href", "action", "data", "srcset", "poster", "formaction", "xlink:href"):
            value = about.get(name, "#")
            assert value.startswith(("#", "data:image/png;base64,")) or value == "data:,", (tag, name, value[:80])
        assert tag not in ("iframe", "object", "embed", "base", "form") or about.get("method") == "dialog"
        assert "refresh" not in about.get("http-equiv", "")
    assert "url(" not in page.text.split("</style>")[0]
    policy = page.policy()
    assert policy.startswith("default-src 'none'; ")
    assert "unsafe-inline" not in policy.split("script-src")[1].split(";")[0]
    assert "unsafe-eval" not in policy
    for about, text in page.scripts:
        if not about.get("type"):
            assert source_hash(text) in policy
    assert "data:audio" not in page.text


def test_the_page_is_complete_and_makes_no_requests(demo_page: Path) -> None:
    page = Page(demo_page)
    check_safe(page)
    assert demo_page.stat().st_size < 1_500_000
    ids = [a["id"] for _, a in page.elements if "id" in a]
    assert len(ids) == len(set(ids))
    links = [a["href"] for t, a in page.elements if t == "a"]
    assert [h for h in links if not h.startswith("#clip=") and h[1:] not in ids] == []
    for tag, about in page.elements:
        if tag == "svg" and "aria-hidden" not in about:
            assert about["role"] == "img"
            assert about["aria-label"]


def test_tables_have_the_numbers_of_the_document(demo_page: Path, report: Report) -> None:
    page, document = Page(demo_page), json.loads(json.dumps(report.document))
    genres = document["contents"]["windows_by_genre"]
    rows = page.tables["r-windows_by_genre"]
    splits = document["contents"]["splits"]
    assert rows == [["genre", *splits], *([g, *(number(counts[s]) for s in splits)] for g, counts in genres.items())]
    speed = document["movement"]["speed_m_s"]
    assert [row[2] for row in page.tables["r-speed_m_s"][1:]] == [number(n) for n in speed["counts"]["all"]]
    assert [row[0] for row in page.tables["r-speed_m_s"][1:]] == [number(e) for e in speed["edges"][:-1]]
    columns = document["fields"]["librosa35"]["columns"]
    assert [row[0] for row in page.tables["r-columns_librosa35"][1:]] == [c["label"] for c in columns]
    assert [row[4] for row in page.tables["r-columns_librosa35"][1:]] == [number(c["p50"]) for c in columns]
    offsets = document["music"]["offset_ms"]["counts"]["all"]
    assert [row[2] for row in page.tables["r-key_beats"][1:]] == [number(n) for n in offsets]
    matrix = page.tables["r-shared_songs"]
    counts = document["splits"]["songs"]["counts"]
    assert matrix[1 : len(splits) + 1] == [[a, *(number(counts[a][b]) for b in splits)] for a in splits]


def test_two_runs_give_equal_bytes(demo_page: Path, demo: Path, tmp_path: Path) -> None:
    write_report(demo, tmp_path / "demo.html")
    assert (tmp_path / "demo.html").read_bytes() == demo_page.read_bytes()
    assert str(demo.parent).encode() not in demo_page.read_bytes()


def test_untrusted_names_stay_text(hostile: Path, tmp_path: Path) -> None:
    path = tmp_path / "hostile.html"
    write_report(hostile, path, clips=8)
    page = Page(path)
    check_safe(page)
    assert len([about for about, _ in page.scripts if not about.get("type")]) == 2, "the player, and tables"
    assert "\u202e" not in page.text
    with open_store(hostile) as store:
        ids = {c.id for c in store}
    linked = {
        unquote(a["href"][6:].split("&")[0]) for t, a in page.elements if a.get("href", "").startswith("#clip=")
    }
    assert linked == ids
    data = next(text for about, text in page.scripts if about.get("id") == "dd-data")
    assert {clip[0] for clip in json.loads(data)["list"]["clips"]} == ids


def test_untrusted_names_of_groups_stay_text(relabelled, tmp_path: Path) -> None:
    names = [f"{HOSTILE[k % len(HOSTILE)]}{k}" for k in range(8)]
    path = tmp_path / "hostile.html"
    write_report(relabelled(lambda k: {"group": names[k], "member": 0, "role": names[k]}), path, clips=8)
    page = Page(path)
    check_safe(page)
    assert "\u202e" not in page.text
    hrefs = [a["href"] for tag, a in page.elements if a.get("href", "").startswith("#group=")]
    assert {unquote(href[len("#group=") :].split("&")[0]) for href in hrefs} == set(names)


def test_against_another_dataset(demo: Path, hostile: Path, tmp_path: Path) -> None:
    path = tmp_path / "both.html"
    report = write_report(hostile, path, clips="none", against=demo, differences=comparison.diff)
    page = Page(path)
    check_safe(page)
    assert len([a for t, a in page.elements if t == "script"]) == 1, "no player"
    assert report.other is not None
    assert report.document["movement"]["speed_m_s"]["edges"] == report.other["movement"]["speed_m_s"]["edges"]
    assert "clips" in {d.kind for d in report.differences}
    assert page.tables["r-speed_m_s"][0][3] == "demo"
    assert [row[3] for row in page.tables["r-speed_m_s"][1:]] == [
        number(n) for n in report.other["movement"]["speed_m_s"]["counts"]["all"]
    ]
    assert json.loads(json.dumps(report.to_json()))["schema"] == 1


def test_every_figure_has_the_other_dataset_as_outline(hostile: Path, tmp_path: Path) -> None:
    path = tmp_path / "both.html"
    write_report(hostile, path, clips="none", against=hostile)
    figures = re.findall(r'<figure id="r-(\w+)"(.*?)</figure>', path.read_text(), flags=re.DOTALL)
    charts = {key: body for key, body in figures if "<svg" in body}
    # Paths, poses, stages and offsets are those of single clips and songs; the score of the other has its own bar.
    assert {"joint_speed", "key_beats", "tempo_pairs", "flags", "columns_edge151"} <= charts.keys()
    without = {key for key, body in charts.items() if not re.search(r'<(path|rect|circle) class="other', body)}
    assert without == {"paths", "bas", "poses", "bas_clips", "song_offsets", "balance", "facing", "stage"}
    assert [key for key in charts.keys() - without if '<i class="other">' not in charts[key]] == []
    # Outlines of equal numbers lie on the bars, and marks on the medians.
    box = re.search(
        r'<path class="median" d="M([\d.]+) .*?<path class="other" d="[^"]*zM([\d.]+)', charts["joint_speed"]
    )
    assert box
    assert box[1] == box[2]
    assert charts["tempo_pairs"].count('class="other"') == charts["tempo_pairs"].count('class="s0"') + 1  # the legend


def test_names_of_the_other_dataset_alone_have_a_bar(demo: Path, report: Report, relabelled, tmp_path: Path) -> None:
    path = tmp_path / "both.html"
    write_report(relabelled(lambda k: {"genre": "Tap"}), path, clips="none", against=demo)
    (genres,) = re.findall(r'<figure id="r-windows_by_genre"(.*?)</figure>', path.read_text(), flags=re.DOTALL)
    others = {row["genre"] for row in report.document["clips"]}
    chart = genres.partition("</svg>")[0]
    assert chart.count('<rect class="other"') == len(others)
    assert all(f"<title>{genre}</title>" in chart for genre in {"Tap", *others})


def test_a_dataset_is_the_same_as_itself(demo: Path, tmp_path: Path) -> None:
    report = write_report(demo, tmp_path / "same.html", clips="none", against=demo, differences=comparison.diff)
    assert report.differences == []
    assert report.document == report.other
    assert "the same data" in (tmp_path / "same.html").read_text()


def test_clips_beyond_twelve_are_files_next_to_the_page(relabelled, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("dancedata.pages.player.INLINE", 3)
    path = relabelled(lambda k: {})
    page_path = tmp_path / "all report.html"
    write_report(path, page_path, clips="all")
    folder = tmp_path / "all report_files"
    assert sorted(p.name for p in folder.iterdir()) == [*(f"clip-{k:05d}.js" for k in range(3, 8)), "export.json"]
    page = Page(page_path)
    assert "'self'" in page.policy()
    data = json.loads(next(text for about, text in page.scripts if about.get("id") == "dd-data"))
    assert data["side"]["3"] == "all%20report_files/clip-00003.js"
    assert set(data["clips"]) == {"0", "1", "2"}
    text = (folder / "clip-00003.js").read_text()
    number_of, payload = re.fullmatch(r"dancedataClip\((\d+), (.*)\);\n", text, flags=re.DOTALL).groups()
    assert json.loads(payload)["id"] == data["list"]["clips"][int(number_of)][0]
    with raises_message(UsageError, "already", where="all report.html"):
        write_report(path, page_path)
    write_report(path, page_path, clips=4, overwrite=True)
    assert sorted(p.name for p in folder.iterdir()) == ["clip-00003.js", "export.json"]
    write_report(path, page_path, clips="none", overwrite=True)
    assert not folder.exists()
    folder.mkdir()
    (folder / "mine.txt").write_text("x")
    with raises_message(UsageError, "further", where="all report_files"):
        write_report(path, page_path, overwrite=True)


@pytest.mark.parametrize("to", ["inside/demo.html", "nowhere/x.html", "."])
def test_where_a_report_is_not_written(demo: Path, tmp_path: Path, monkeypatch, to: str) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "inside").symlink_to(demo)
    with raises_message(UsageError, "exists|report"):
        write_report(demo, to)


@pytest.mark.parametrize(("wrong", "words"), [
    ({"max_mb": 0.1}, r"allowed: 0\.1 MB.*--clips 4"), ({"clips": -1}, "number"), ({"clips": "some"}, "number"),
    ({"audio": "link"}, "embed"),
])  # fmt: skip
def test_arguments_that_cannot_be(demo: Path, tmp_path: Path, wrong: dict[str, Any], words: str) -> None:
    with raises_message(UsageError, words):
        write_report(demo, tmp_path / "x.html", **wrong)
    assert list(tmp_path.iterdir()) == []


def _with_a_folder(page: Path, number: int = 12) -> Path:
    """Write a report with one clip next to its page; returns the folder."""
    side = {f"clip-{number:05d}.js": lambda: f"dancedataClip({number}, {{}});\n".encode()}
    target = PageFiles.of(page, [], max_mb=1, overwrite=True)
    target.write(b"page", side)
    return target.folder


@pytest.mark.parametrize("change", ["clip", "changed", "folder", "link"])
def test_foreign_files_next_to_the_page_stay(tmp_path: Path, change: str) -> None:
    page = tmp_path / "r.html"
    folder = _with_a_folder(page)
    theirs = folder / ("clip-00050.js" if change in ("clip", "folder") else "clip-00012.js")
    if change == "folder":
        folder.rename(tmp_path / "old").with_name("r_files").mkdir()
    if change == "link":
        folder.symlink_to(folder.rename(tmp_path / "elsewhere"))
    else:
        theirs.write_text("mine")
    before = theirs.read_bytes()
    with raises_message(UsageError, "further", where="r_files"):
        _with_a_folder(page, 14)
    target = PageFiles(page, 1)
    target.write(b"page", {})  # of a report that started before they were created
    assert theirs.read_bytes() == before


def test_two_pages_whose_folders_have_one_name(tmp_path: Path) -> None:
    folder = _with_a_folder(tmp_path / "r.html")
    with raises_message(UsageError, "further", where="r_files"):
        _with_a_folder(tmp_path / "r.htm", 13)
    assert (folder / "clip-00012.js").exists()
    _with_a_folder(tmp_path / "r.html", 13)
    assert sorted(path.name for path in folder.iterdir()) == ["clip-00013.js", "export.json"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r.html", "r_files"]


def test_wide_figures_stand_before_or_after_the_columns() -> None:
    kinds = ("wide", "", "wide", "", "")
    page = grid([Figure(f"f{k}", "", "", "", kind=kind) for k, kind in enumerate(kinds)])
    assert re.findall(r'id="r-(f\d)"', page) == ["f0", "f1", "f3", "f4", "f2"]
    assert grid([]) == ""
