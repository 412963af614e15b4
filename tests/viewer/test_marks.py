"""Marks: set by keys, kept in the browser, saved as rows of segments, and taken by datasets and readers."""

import json
from pathlib import Path

import dancedata
from dancedata.core.errors import UsageError
from dancedata.torch import Select, WindowDataset
from tests.browser import Browser
from tests.messages import raises_message
from tests.scene.helpers import FPS
from tests.viewer.test_browser import at

V = "window.dancedataViewer"


def test_marks_are_kept_and_saved(browser: Browser, served: str, odd: Path, tmp_path: Path) -> None:
    browser.open(at(served, "wav", "&t=1.5"))
    browser.js("localStorage.clear(); location.reload()")
    browser.wait("return document.querySelector('[data-dd=root]')?.dataset.ready === '1'")
    keys = browser.js("return [...document.querySelectorAll('kbd')].map(k => k.textContent.toLowerCase())")
    assert {"k", "x", "n"} <= set(keys)
    browser.js("window.prompt = () => 'the arm jumps'")
    browser.key("k")
    browser.key("n")
    browser.open(at(served, "flac", "&t=0.5"))
    browser.key("x")
    browser.key("k")
    browser.key("k")  # and off again
    assert browser.text("marks") == "Marks (3)"
    browser.open(at(served, "wav", "&t=0"))
    assert browser.text("marks") == "Marks (3)"
    signs = browser.js(
        "return [...document.querySelectorAll('.item')].map(row => row.querySelector('.n').textContent)"
    )
    assert sum("★✎" in sign for sign in signs) == 1
    assert sum("✕" in sign for sign in signs) == 1
    path = tmp_path / "marks.jsonl"
    path.write_text(browser.js(f"return {V}.marksFile()"))
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    assert [(row["clip"], row["start"], row["label"]) for row in rows] == [
        ("wav", "1.500", "star"), ("wav", "1.500", "note"), ("flac", "0.000", "reject"),
    ]  # fmt: skip
    ds = dancedata.open(odd, segments=path)
    assert [(s.label, float(s.start)) for s in ds.segments("wav", "mark")] == [("star", 1.5), ("note", 1.5)]
    assert ds.segments("wav", "mark")[1].texts == ("the arm jumps",)
    train = WindowDataset(ds, "train", select=Select(ignore=("mark:reject",)))
    assert "flac" not in {window.clip for window in train.windows}
    assert len(train) == len(WindowDataset(ds, "train")) - len(ds["flac"].windows())
    browser.js("localStorage.clear()")
    assert browser.log() == []


def test_windows_that_overlap_a_mark_are_left_out(odd: Path, tmp_path: Path) -> None:
    path = tmp_path / "marks.jsonl"
    path.write_text(
        '{"clip": "wav", "start": "2", "end": "2.5", "layer": "mark", "label": "reject", "sided": "no"}\n'
        '{"clip": "mp3", "start": "1", "end": "1.04", "layer": "mark", "label": "star", "sided": "no"}\n'
    )
    ds = dancedata.open(odd, segments=path)
    train, plain = WindowDataset(ds, "train", select=Select(ignore=("mark:reject",))), WindowDataset(ds, "train")
    wanted = [
        (window.clip, window.start)
        for window in plain.windows
        if window.clip != "wav" or not (window.start < 2.5 * FPS and window.start + window.length > 2 * FPS)
    ]
    assert [(window.clip, window.start) for window in train.windows] == wanted
    assert len(wanted) < len(plain)
    left_out = {(r.clip, r.window) for r in train.rejects if r.reason == "ignored"}
    assert left_out == {(w.clip, w.start) for w in plain.windows} - set(wanted)
    assert train.scaler("edge151").sha256 == plain.scaler("edge151").sha256
    with raises_message(UsageError, "mark", where="odd"):
        WindowDataset(dancedata.open(odd), "train", select=Select(ignore=("mark:reject",)))
