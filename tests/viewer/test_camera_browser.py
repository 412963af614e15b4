"""Camera, history, volume, an ended server and the list's empty state in a real browser."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import UsageError
from dancedata.torch import Select, WindowDataset
from tests.browser import Browser
from tests.messages import raises_message
from tests.scene.helpers import FPS, HOSTILE
from tests.viewer.test_body_browser import sides
from tests.viewer.test_browser import V, at, stage
from tests.viewer.test_layout_browser import box, pointer

CAMERA = f"return {V}.camera"


def centre(browser: Browser) -> np.ndarray:
    """Mean place of the coloured limbs, (x, y) pixels of the stage."""
    picture = stage(browser).astype(int)
    blue = (picture[..., 2] - picture[..., 0] > 50) | (picture[..., 0] - picture[..., 2] > 90)
    return np.argwhere(blue).mean(axis=0)[::-1]


def drag(browser: Browser, by: tuple[int, int], **more: object) -> None:
    """Drag the stage."""
    place = box(browser, "figure")
    x, y = place["left"] + 300, place["top"] + 150
    pointer(browser, "figure", "pointerdown", x, y, **more)
    for k in (1, 2):
        pointer(browser, "figure", "pointermove", x + k * by[0] / 2, y + k * by[1] / 2, **more)
    pointer(browser, "figure", "pointerup", x + by[0], y + by[1], **more)


def test_a_drag_turns_and_with_shift_moves(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav", "&t=1"))
    first, before = browser.js(CAMERA), centre(browser)
    drag(browser, (60, -30), shiftKey=True)
    moved = browser.js(CAMERA)
    assert (moved["yaw"], moved["pitch"]) == (first["yaw"], first["pitch"])
    np.testing.assert_allclose(centre(browser) - before, (60, -30), atol=6)
    drag(browser, (50, 20))
    turned = browser.js(CAMERA)
    assert turned["yaw"] == pytest.approx(first["yaw"] - 50 * 0.008)
    assert turned["pitch"] == pytest.approx(first["pitch"] + 20 * 0.006)
    assert turned["right"] == moved["right"]
    browser.js("document.querySelector('[data-dd=figure]').dispatchEvent(new MouseEvent('dblclick'))")
    np.testing.assert_allclose(centre(browser), before, atol=1)


def test_two_pointers_zoom_and_move(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav", "&t=1"))
    small = len(sides(stage(browser))[0])
    place = box(browser, "figure")
    x, y = place["left"] + 300, place["top"] + 150
    pointer(browser, "figure", "pointerdown", x, y)
    pointer(browser, "figure", "pointerdown", x + 100, y, pointerId=2)
    pointer(browser, "figure", "pointermove", x + 150, y, pointerId=2)
    camera = browser.js(CAMERA)
    assert camera["zoom"] == pytest.approx(100 / 150)
    assert camera["yaw"] == 0.55
    assert camera["right"] == pytest.approx(25 / place["height"], rel=1e-3)
    pointer(browser, "figure", "pointerup", x + 150, y, pointerId=2)
    pointer(browser, "figure", "pointerup", x, y)
    assert len(sides(stage(browser))[0]) > 1.5 * small


def test_keys_turn_the_camera_and_look_from_four_sides(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav", "&t=1"))
    first = browser.js(CAMERA)
    for key, name, by in (("a", "yaw", -0.15), ("e", "yaw", 0.15), ("w", "pitch", 0.1), ("s", "pitch", -0.1)):
        before = browser.js(CAMERA)[name]
        browser.key(key)
        assert browser.js(CAMERA)[name] == pytest.approx(before + by), key
    look = browser.js(f"const l = {V}.state.clip.figure.look; return Math.atan2(l[90], l[92])")
    # F1 to F4
    views = (("\ue031", 0, 0.08), ("\ue032", np.pi / 2, 0.08), ("\ue033", np.pi, 0.08), ("\ue034", 0, 1.5))
    for key, turn, pitch in views:
        browser.key(key)
        camera = browser.js(CAMERA)
        assert camera["pitch"] == pytest.approx(pitch)
        assert camera["yaw"] == pytest.approx(look + turn, abs=0.02)
    browser.key("r")
    assert browser.js(CAMERA) | {"still": True} == first | {"still": True}
    # From the front the left arm is on the right of the picture; the menu does as the keys do.
    browser.js(
        "const s = document.querySelector('[data-dd=camera]'); s.value = 'front';s.dispatchEvent(new Event('change'))"
    )
    assert browser.js(CAMERA)["pitch"] == pytest.approx(0.08)
    for sign in (1, -1):
        picture = stage(browser)
        left = np.argwhere(picture[..., 2] - picture[..., 0] > 50)[:, 1].mean()
        right = np.argwhere(picture[..., 0] - picture[..., 2] > 90)[:, 1].mean()
        assert sign * left > sign * right
        browser.key("\ue033")


def test_the_camera_follows_or_stays(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav", "&t=1"))
    browser.js(f"const f = {V}.state.clip.figure; for (let i = 2700; i < f.places.length; i += 3) f.places[i] += 1")
    followed = centre(browser)
    browser.js(f"{V}.seek(4)")
    np.testing.assert_allclose(centre(browser), followed, atol=12)
    browser.key("t")
    assert browser.js("return document.querySelector('[data-dd=follow]').getAttribute('aria-pressed')") == "false"
    stayed = browser.js(CAMERA)
    browser.js(f"{V}.seek(1)")
    assert np.abs(centre(browser) - followed).max() > 40
    assert browser.js(CAMERA)["x"] == stayed["x"]


@pytest.fixture
def tab(browser: Browser) -> Iterator[Browser]:
    """The browser with a tab of its own, as a tab keeps 50 entries of history."""
    before = browser.driver.current_window_handle
    browser.driver.switch_to.new_window("tab")
    yield browser
    browser.driver.close()
    browser.driver.switch_to.window(before)


def test_back_returns_to_the_clip_before(tab: Browser, served: str) -> None:
    browser = tab
    browser.open(at(served, "wav", "&t=1"))
    length = browser.js("return history.length")
    browser.js(f"{V}.seek(2)")
    browser.later(f"await {V}.openItem({V}.items.find(i => i.id === {json.dumps(HOSTILE[0])}))")
    browser.later(f"await {V}.openItem({V}.items.find(i => i.id === 'mp3'))")
    assert browser.js("return history.length") == length + 2
    browser.js(f"{V}.seek(3)")
    browser.wait("return location.hash.includes('t=3.000')")
    assert browser.js("return history.length") == length + 2  # moving in time adds none
    browser.js("history.back()")
    browser.wait(f"return {V}.state.clip.id === arguments[0]", HOSTILE[0])
    browser.js("history.back()")
    browser.wait(f"return {V}.state.clip.id === 'wav'")
    assert browser.js(f"return {V}.state.t") == pytest.approx(2, abs=0.01)
    browser.js("history.forward()")
    browser.wait(f"return {V}.state.clip.id === arguments[0]", HOSTILE[0])
    assert browser.log() == []


def test_a_server_that_has_ended(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav"))
    ended = "return document.querySelector('[data-dd=root]').classList.contains('ended')"
    browser.js("window.plain = fetch; window.fetch = () => Promise.reject(new TypeError('Failed to fetch'))")
    browser.later(f"await {V}.openItem({V}.items.find(i => i.id === 'flac'))")
    assert browser.js(ended)
    notes = browser.text("notes")
    assert "start dancedata view again" in notes
    assert "Failed" not in notes
    assert float(browser.js("return getComputedStyle(document.querySelector('[data-dd=list]')).opacity")) < 0.5
    browser.js("window.fetch = plain")  # it is there again
    browser.later(f"await {V}.openItem({V}.items.find(i => i.id === 'flac'))")
    assert not browser.js(ended)
    assert browser.log() == []


def test_a_filter_that_finds_nothing_can_be_cleared(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav"))
    browser.js(
        "const q = document.querySelector('[data-dd=q]'); q.value = 'zzz<b>'; q.dispatchEvent(new Event('input'))"
    )
    shown = "return document.querySelector('[data-dd=none]').offsetParent !== null"
    assert browser.js(shown)
    assert browser.text("nonetext") == "no clip matches 'zzz<b>'"
    browser.js("document.querySelector('[data-dd=clear]').click()")
    assert not browser.js(shown)
    assert browser.js(f"return {V}.shown.length") == browser.js(f"return {V}.items.length")


def test_names_are_cut_in_the_middle(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav"))
    name = HOSTILE[2]
    parts = browser.js(
        "const row = [...document.querySelectorAll('.item b')].find(b => b.parentElement.title === arguments[0]);"
        "row.style.width = '140px'; window.row = row; return [...row.children].map(e => e.textContent)",
        name,
    )
    assert "".join(parts) == name
    assert parts[1] == name[-12:]
    cut = browser.js("return [...row.children].map(e => e.scrollWidth > e.clientWidth)")
    assert cut == [True, False]
    assert browser.js("return row.lastChild.getBoundingClientRect().right <= row.getBoundingClientRect().right + 1")
    assert browser.js("return window.PWN") is None


def test_volume_and_mute(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav"))
    browser.wait(f"return {V}.state.clip.sound")
    browser.later(f"await {V}.play(true)")
    browser.wait(f"return !!{V}.gain")
    gain = f"return {V}.gain.gain.value"
    slide = (
        "const v = document.querySelector('[data-dd=volume]'); v.value = arguments[0];"
        "v.dispatchEvent(new Event('input')); v.dispatchEvent(new Event('change'))"
    )
    browser.js(slide, "0.3")
    assert browser.js(gain) == pytest.approx(0.3)
    browser.key("u")
    assert browser.js(gain) == 0
    browser.js(slide, "0.6")  # unmutes
    assert browser.js(gain) == pytest.approx(0.6)
    browser.later(f"await {V}.play(false)")


# Marks: set by keys, kept in the browser, saved as rows of segments, and taken by datasets and readers.


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
