"""Small windows, waiting, and long clips in a real browser."""

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.scene.scenes import Scenes
from dancedata.viewer import server
from dancedata.viewer.server import Site
from dancedata.viewer.view import ViewRequest
from tests.browser import Browser
from tests.scene.helpers import FPS, HOSTILE, SECONDS, serving
from tests.viewer.test_browser import DRAWN, V, at

BOX = "const b = document.querySelector(`[data-dd=${arguments[0]}]`).getBoundingClientRect(); return b.toJSON()"
#: Keeps the texts that pictures have from now on.
TEXTS = (
    "window.texts = []; const p = CanvasRenderingContext2D.prototype, text = p.fillText;"
    "p.fillText = function (t, ...r) { texts.push(t); return text.call(this, t, ...r) };"
)


@pytest.fixture(autouse=True)
def _usual_size(browser: Browser) -> Iterator[None]:
    yield
    browser.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def box(browser: Browser, name: str) -> dict[str, float]:
    """Place of an element, CSS pixels."""
    return browser.js(BOX, name)


def pointer(browser: Browser, name: str, kind: str, x: float, y: float, **more: Any) -> None:
    """Send a pointer event to an element, at a place in the window."""
    browser.js(
        "const [name, kind, x, y, more] = arguments; const e = document.querySelector(`[data-dd=${name}]`);"
        "e.setPointerCapture = () => {};"
        "e.dispatchEvent(new PointerEvent(kind, {bubbles: true, clientX: x, clientY: y, pointerId: 1, ...more}))",
        name, kind, x, y, more,
    )  # fmt: skip


@pytest.mark.parametrize(("size", "least"), [((1024, 600), 300), ((800, 700), 380)])
def test_low_windows_leave_room_for_the_dancer(browser, served, size, least):
    browser.size(*size)
    browser.open(at(served, "wav", "&t=1"))
    browser.wait(f"return {V}.state.clip.sound")
    browser.later(DRAWN)
    assert box(browser, "stage")["height"] >= least
    assert box(browser, "bar")["height"] <= 36  # one row
    assert box(browser, "play")["height"] == 26
    assert box(browser, "foot")["height"] <= 24
    assert box(browser, "foot")["bottom"] <= size[1]
    assert browser.js("return document.documentElement.scrollWidth <= innerWidth")
    assert browser.js("return document.documentElement.scrollHeight <= innerHeight")
    legend = browser.js("return document.querySelector('.legend').getBoundingClientRect().toJSON()")
    assert legend["bottom"] < box(browser, "stage")["bottom"]
    assert (legend["height"] > 40) == (size[0] <= 900)


def test_controls_that_find_no_room_are_in_a_sheet(browser: Browser, served: str) -> None:
    browser.size(420, 860)
    browser.open(at(served, HOSTILE[0], "&t=1"))
    assert browser.js("return document.documentElement.scrollWidth <= innerWidth")
    browser.later(DRAWN)
    shown = "return document.querySelector(`[data-dd=${arguments[0]}]`).offsetParent !== null"
    for name in ("prev", "play", "next", "rate", "loop", "more"):
        assert browser.js(shown, name), name
        assert box(browser, name)["right"] <= 420
    assert not browser.js(shown, "mirror")
    # The lanes are directly below the stage, and a finger can scroll past both.
    assert box(browser, "tl")["top"] == pytest.approx(box(browser, "stage")["bottom"], abs=1)
    assert box(browser, "bar")["top"] >= box(browser, "tl")["bottom"] - 1
    touch = "return getComputedStyle(document.querySelector('[data-dd=figure]')).touchAction"
    assert browser.js(touch) == "pan-y"
    browser.js("document.querySelector('[data-dd=more]').click()")
    for name in ("mirror", "body", "theme", "help"):
        assert browser.js(shown, name), name
        assert box(browser, name)["right"] <= 420
    browser.js("document.querySelector('[data-dd=mirror]').click()")
    assert browser.js(f"return {V}.state.mirror")
    browser.size(1920, 900)
    browser.wait("return document.querySelector('[data-dd=more]').offsetParent === null")
    assert browser.js(shown, "mirror")


def test_the_edge_above_the_lanes_is_moved(browser: Browser, served: str) -> None:
    browser.size(1366, 768)
    browser.open(at(served, "wav"))
    browser.later(DRAWN)
    before, edge = box(browser, "stage")["height"], box(browser, "edge")
    y = edge["top"] + 2
    pointer(browser, "edge", "pointerdown", 500, y)
    pointer(browser, "edge", "pointermove", 500, y + 60)
    pointer(browser, "edge", "pointerup", 500, y + 60)
    assert box(browser, "stage")["height"] == pytest.approx(before + 60, abs=1)
    assert int(browser.js("return document.querySelector('[data-dd=edge]').getAttribute('aria-valuenow')")) < 90
    browser.js("document.querySelector('[data-dd=edge]').focus()")
    browser.key("\ue013")  # up
    assert box(browser, "stage")["height"] == pytest.approx(before + 44, abs=1)
    browser.js("document.querySelector('[data-dd=edge]').dispatchEvent(new MouseEvent('dblclick'))")
    assert box(browser, "stage")["height"] == pytest.approx(before, abs=1)


def test_a_page_that_waits_for_its_clip(browser: Browser, served: str, monkeypatch: pytest.MonkeyPatch) -> None:
    plain, go_on = Site._clip, threading.Event()

    def slow(site: Site, *more: Any) -> server.Answer:
        go_on.wait(60)
        return plain(site, *more)

    monkeypatch.setattr(Site, "_clip", slow)
    browser.get(at(served, "flac"))
    disabled = "return document.querySelector('[data-dd=play]').disabled"
    browser.wait(f"return {V}.state.clip === null && document.querySelector('[data-dd=play]').disabled")
    assert box(browser, "lanes")["height"] > 120
    assert box(browser, "stage")["height"] > 300
    browser.wait("return document.querySelector('[data-dd=notes]').textContent === 'loading flac…'")
    assert not browser.js("return document.querySelector('[data-dd=theme]').disabled")
    waiting = box(browser, "stage")["height"]
    go_on.set()
    browser.wait(f"return {V}.state.clip")
    assert not browser.js(disabled)
    assert "loading" not in browser.text("notes")
    assert abs(box(browser, "stage")["height"] - waiting) < 40  # nothing jumps
    browser.wait("return document.querySelector('[data-dd=root]').dataset.ready === '1'")


def test_the_first_minute_of_a_long_clip_comes_first(browser, odd, monkeypatch):
    monkeypatch.setattr(server, "FIRST_S", 2.0)
    monkeypatch.setattr(server, "LONG_S", 5.0)
    read: list[float | None] = []
    plain, go_on = Scenes.scene, threading.Event()

    def counted(scenes: Scenes, *more: Any, first_s: float | None = None) -> Any:
        read.append(first_s)
        if first_s is None:
            go_on.wait(60)
        return plain(scenes, *more, first_s=first_s)

    monkeypatch.setattr(Scenes, "scene", counted)
    with serving(ViewRequest(odd, "wav")) as address:
        browser.open(address + "&t=5")
        assert browser.js(f"return [{V}.state.clip.partial, {V}.state.clip.figure.frames]") == [True, 2 * FPS]
        assert "the rest is loading" in browser.text("meta")
        assert browser.js(f"return {V}.state.t") == pytest.approx(5)
        assert browser.js(f"return {V}.state.clip.windows.length") == 9  # of the whole clip
        go_on.set()
        browser.wait(f"return {V}.state.clip.figure.frames === {SECONDS * FPS}")
        browser.later(DRAWN)
        drawn = browser.js(f"return [{V}.state.drawn, {V}.state.clip.speed.values.length]")
        assert drawn == [5 * FPS, SECONDS * FPS - 1]
        assert "loading" not in browser.text("meta")
        browser.open(address + "&t=1")
        browser.wait(f"return !{V}.state.clip.partial")
    # Once each, though the server warms up with the first clip and the page was opened twice.
    assert sorted(read, key=str) == [2.0, None]
    assert browser.log() == []


LONG = f"""
const c = {V}.state.clip, f = c.figure, n = 54000;
f.places = Float32Array.from({{length: n * f.width}}, (_, i) => f.places[i % f.places.length]);
f.frames = n; f.look = null; f.contacts = new Uint8Array(n); c.seconds = 1800; c.n = n;
c.beats = Array.from({{length: 3600}}, (_, k) => k / 2);
c.windows = Array.from({{length: 3500}}, (_, k) => [15 * k, 60]);
c.flags = Array.from({{length: 600}}, (_, k) => [k * k * 0.005, 'fast_turn', 'head', 1, 'deg']);
"""


def test_lanes_of_half_an_hour_can_be_read(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav", "&theme=dark"))
    browser.wait(f"return {V}.state.clip.sound")
    browser.js(LONG)
    browser.js(
        f"{TEXTS} window.lines = 0; const line = p.lineTo;"
        "p.lineTo = function (...r) { lines++; return line.call(this, ...r) };"
    )
    lanes = browser.driver.find_element("css selector", "[data-dd=lanes]")
    browser.js("arguments[0].dispatchEvent(new MouseEvent('dblclick'))", lanes)
    browser.later(DRAWN)
    assert {"0:00", "10:00", "28:00"} <= set(browser.js("return texts"))
    browser.js("lines = 0")
    browser.js(f"{V}.state.dirty = true")
    browser.later(DRAWN)
    drawn = browser.js("return lines")
    assert 300 < drawn < 2600  # per picture, of two, with the floor: not 27,000
    # Two steps in by the button: a fourth of the time.
    browser.js("for (let k = 0; k < 2; k++) document.querySelector('[data-dd=zoomin]').click(); texts.length = 0;")
    browser.later(DRAWN)
    assert {"0:30", "7:00"} <= set(browser.js("return texts"))
    browser.js("document.querySelector('[data-dd=zoomout]').click(); texts.length = 0;")
    browser.later(DRAWN)
    assert "14:00" in browser.js("return texts")
    browser.driver.refresh()


def test_a_window_under_the_pointer_is_named_and_a_click_loops_it(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav"))
    browser.later(DRAWN)
    lanes = box(browser, "lanes")
    row = browser.js(f"return {V}.rows.windows")
    x = lanes["left"] + 74 + (lanes["width"] - 74) * 1.02 / SECONDS
    y = lanes["top"] + row["y"] + 4
    pointer(browser, "lanes", "pointermove", x, y)
    browser.wait("return document.querySelector('[data-dd=toast]').textContent")
    assert browser.text("toast") == "window 2: frames 30 to 89"
    pointer(browser, "lanes", "pointermove", x, lanes["top"] + 40)
    browser.wait("return !document.querySelector('[data-dd=toast]').textContent")
    pointer(browser, "lanes", "pointerdown", x, y)
    assert browser.js(f"return {V}.state.loop") == [30, 90]


@pytest.fixture(scope="module")
def walls(odd: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[int, str]]:
    """Addresses of a clip beside 8 and 11 comparisons, by the number of dancers."""
    folder = tmp_path_factory.mktemp("walls")
    joints = dancedata.decode(dancedata.open(odd)["wav"].read("edge151"), "edge151", fps=FPS).joints()
    for k in range(11):
        (folder / f"model-{k}").mkdir()
        np.savez(folder / f"model-{k}" / "wav.npz", joints=joints, fps=FPS)
    models = [tuple(folder / f"model-{k}" for k in range(n)) for n in (8, 11)]
    eight, eleven = (serving(ViewRequest(odd, "wav", compare=of, wall=True)) for of in models)
    with eight as nine, eleven as twelve:
        yield {9: nine, 12: twelve}


@pytest.mark.parametrize(("dancers", "size"), [(12, (1366, 625)), (9, (800, 900)), (12, (420, 860))])
def test_the_dancers_of_a_wall_have_most_of_the_page(browser, walls, dancers, size):
    browser.size(*size)
    browser.open(walls[dancers])
    browser.later(DRAWN)
    stage = box(browser, "stage")["height"]
    assert stage >= 0.55 * size[1] - 1
    assert browser.js("return document.querySelector('[data-dd=dancers]').children.length") == dancers + 1
    assert box(browser, "dancers")["height"] <= 30  # one row
    assert browser.js("return document.documentElement.scrollWidth <= innerWidth")
    wide = size[0] > 1000
    if wide:  # numbers stand in the lanes, of which none is hidden
        tl = "const b = document.querySelector('[data-dd=tl]'); return b.scrollHeight - b.clientHeight"
        assert browser.js(tl) <= 0
        assert browser.js("return document.documentElement.scrollHeight <= innerHeight")
    small = "return document.querySelector('[data-dd=dancers] small').offsetParent !== null"
    assert browser.js(small) != wide
    titles = browser.js("return [...document.querySelector('[data-dd=dancers]').children].map(b => b.title)")
    assert all("sliding" in title for title in titles[1:])
    assert browser.log() == []


def test_numbers_of_a_wall_stand_beside_its_lanes(browser: Browser, walls: dict[int, str]) -> None:
    browser.size(1366, 625)
    browser.open(walls[12])
    browser.js(f"{TEXTS} dispatchEvent(new Event('resize')); document.querySelector('[data-dd=zoomin]').click();")
    browser.later(DRAWN)
    texts = browser.js("return texts")
    numbers = browser.js(f"return {V}.state.clip.members.map(m => m.numbers)")
    assert {name for pairs in numbers for name, _ in pairs} <= set(texts)
    assert {value for pairs in numbers for _, value in pairs} <= set(texts)
    assert len(numbers) == 12
    browser.driver.refresh()


def test_the_overview_of_a_long_clip_moves_the_lanes(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav", "&theme=dark"))
    browser.wait(f"return {V}.state.clip.sound")
    assert browser.js(f"return {V}.rows.map") is None  # six seconds need none
    browser.js(LONG + f"{V}.state.clip.flagTimes = []; dispatchEvent(new Event('resize'));")
    browser.js("document.querySelector('[data-dd=lanes]').dispatchEvent(new MouseEvent('dblclick'))")
    browser.later(DRAWN)
    lanes, row = box(browser, "lanes"), browser.js(f"return {V}.rows.map")
    y = lanes["top"] + row["y"] + 8

    def x(second: float) -> float:
        return float(lanes["left"] + 74 + (lanes["width"] - 74) * second / 1800)

    def drag(start: float, end: float) -> list[float]:
        pointer(browser, "lanes", "pointerdown", x(start), y)
        pointer(browser, "lanes", "pointermove", x(end), y)
        pointer(browser, "lanes", "pointerup", x(end), y)
        pointer(browser, "lanes", "pointermove", x(1), y)  # no longer held
        browser.later(DRAWN)
        return browser.js(f"return [{V}.view.from, {V}.view.to]")

    near = 1.5 * 1800 / (lanes["width"] - 74)  # of a pixel and a half
    assert drag(600, 900) == pytest.approx([600, 900], abs=near)  # a new range
    assert drag(700, 1000) == pytest.approx([900, 1200], abs=2 * near)  # all of it
    assert drag(1200, 1500) == pytest.approx([900, 1500], abs=3 * near)  # its end
    assert drag(900, 1400) == pytest.approx([1400, 1500], abs=4 * near)  # its begin
    assert drag(200, 200) == pytest.approx([150, 250], abs=5 * near)  # beside it
    assert drag(200, -900) == pytest.approx([0, 100], abs=6 * near)
    assert browser.js(f"return {V}.state.t") == 0  # nothing was sought
    # The other way: what is sought is shown, and keys move the range.
    browser.js(f"{V}.seek(1000)")
    browser.later(DRAWN)
    begin, end = browser.js(f"return [{V}.view.from, {V}.view.to]")
    assert begin < 1000 < end
    browser.js("document.activeElement.blur()")
    browser.key(".")
    browser.later(DRAWN)
    assert browser.js(f"return {V}.view.from") == pytest.approx(begin + (end - begin) / 2)
    assert browser.log() == []
    browser.driver.refresh()


def test_left_and_right_are_told_apart_without_colours(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav", "&theme=dark"))
    browser.js(TEXTS.replace("push(t)", "push([t, ...r])") + f"{V}.state.dirty = true")
    browser.later(DRAWN)
    assert not {"L", "R"} & {text for text, *_ in browser.js("return texts")}
    pointer(browser, "figure", "pointerenter", 500, 200)
    browser.later(DRAWN)
    written = {text: (x, y) for text, x, y in browser.js("return texts") if text in {"L", "R"}}
    hands = browser.js(
        f"const f = {V}.state.clip.figure; return ['left_hand', 'right_hand'].map(name => f.joints.indexOf(name))"
    )
    places = browser.js(f"return {V}.pointsNow()")
    for text, joint in zip("LR", hands, strict=True):
        assert written[text] == pytest.approx(places[joint][:2], abs=0.5)
    pointer(browser, "figure", "pointerleave", 500, 200)
    browser.js("texts.length = 0")
    browser.later(DRAWN)
    assert not {"L", "R"} & {text for text, *_ in browser.js("return texts")}
    browser.driver.refresh()
