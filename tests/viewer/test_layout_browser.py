"""Small windows, waiting, and long clips in a real browser."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.viewer import Scenes, server
from dancedata.viewer.server import Site
from dancedata.viewer.view import ViewRequest
from tests.viewer.helpers import FPS, SECONDS, Browser, serving
from tests.viewer.test_browser import V, at

BOX = "const b = document.querySelector(`[data-dd=${arguments[0]}]`).getBoundingClientRect(); return b.toJSON()"
DRAWN = "await new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)));"


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


@pytest.mark.parametrize(("size", "least"), [((1366, 625), 340), ((1024, 600), 300), ((800, 700), 380)])
def test_low_windows_leave_room_for_the_dancer(
    browser: Browser, served: str, size: tuple[int, int], least: int
) -> None:
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
    browser.open(at(served, "wav", "&t=1"))
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
    plain = Site._clip

    def slow(site: Site, *more: Any) -> server.Answer:
        time.sleep(1.2)
        return plain(site, *more)

    monkeypatch.setattr(Site, "_clip", slow)
    browser.driver.get("about:blank")
    browser.driver.get(at(served, "flac"))
    disabled = "return document.querySelector('[data-dd=play]').disabled"
    notes = "return document.querySelector('[data-dd=notes]').textContent"
    browser.wait(f"return {V}.state.clip === null && document.querySelector('[data-dd=play]').disabled")
    assert box(browser, "lanes")["height"] > 120
    assert box(browser, "stage")["height"] > 300
    browser.wait("return document.querySelector('[data-dd=notes]').textContent === 'loading flac…'")
    assert not browser.js("return document.querySelector('[data-dd=theme]').disabled")
    waiting = box(browser, "stage")["height"]
    browser.wait(f"return {V}.state.clip")
    assert not browser.js(disabled)
    assert "loading" not in browser.js(notes)
    assert abs(box(browser, "stage")["height"] - waiting) < 40  # nothing jumps
    browser.wait("return document.querySelector('[data-dd=root]').dataset.ready === '1'")


def test_the_first_minute_of_a_long_clip_comes_first(
    browser: Browser, odd: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "FIRST_S", 2.0)
    monkeypatch.setattr(server, "LONG_S", 5.0)
    read: list[float | None] = []
    plain = Scenes.scene

    def counted(scenes: Scenes, *more: Any, first_s: float | None = None) -> Any:
        read.append(first_s)
        if first_s is None:
            time.sleep(0.8)
        return plain(scenes, *more, first_s=first_s)

    monkeypatch.setattr(Scenes, "scene", counted)
    with serving(ViewRequest(odd, "wav")) as address:
        browser.open(address + "&t=5")
        assert browser.js(f"return [{V}.state.clip.partial, {V}.state.clip.figure.frames]") == [True, 2 * FPS]
        assert "the rest is loading" in browser.js("return document.querySelector('[data-dd=meta]').textContent")
        assert browser.js(f"return {V}.state.t") == pytest.approx(5)
        assert browser.js(f"return {V}.state.clip.windows.length") == 9  # of the whole clip
        browser.wait(f"return {V}.state.clip.figure.frames === {SECONDS * FPS}")
        browser.later(DRAWN)
        assert browser.js(f"return [{V}.state.drawn, {V}.state.clip.speed.values.length]") == [
            5 * FPS,
            SECONDS * FPS - 1,
        ]
        assert "loading" not in browser.js("return document.querySelector('[data-dd=meta]').textContent")
        browser.open(address + "&t=1")
        browser.wait(f"return !{V}.state.clip.partial")
    # Once each, though the server warms up with the first clip and the page was opened twice.
    assert sorted(read, key=str) == [2.0, None]
    assert browser.log() == []


LONG = f"""
const c = {V}.state.clip, f = c.figure, n = 54000;
f.places = Float32Array.from({{length: n * f.width}}, (_, i) => f.places[i % f.places.length]);
f.frames = n; f.contacts = new Uint8Array(n); c.seconds = 1800; c.n = n;
c.beats = Array.from({{length: 3600}}, (_, k) => k / 2);
c.windows = Array.from({{length: 3500}}, (_, k) => [15 * k, 60]);
c.flags = Array.from({{length: 600}}, (_, k) => [k * k * 0.005, 'fast_turn', 'head', 1, 'deg']);
"""


def test_lanes_of_half_an_hour_can_be_read(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav", "&theme=dark"))
    browser.wait(f"return {V}.state.clip.sound")
    browser.js(LONG)
    browser.js(
        "window.texts = []; window.lines = 0; const p = CanvasRenderingContext2D.prototype;"
        "const text = p.fillText, line = p.lineTo;"
        "p.fillText = function (t, ...r) { texts.push(t); return text.call(this, t, ...r) };"
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
    row = lane_rows(browser)
    accent, flag = (242, 184, 75), (255, 111, 82)
    assert np.abs(row["music"] - accent).sum(axis=-1).min() > 40  # no beats
    red = row["flags"][..., 0].astype(int) - row["flags"][..., 2]
    assert (red > 20).mean() > 0.5  # a strip
    assert (np.abs(row["flags"] - flag).sum(axis=-1) < 30).any()
    windows = (np.abs(row["windows"] - (0x7A, 0x88, 0x9C)).sum(axis=-1) < 60).mean(axis=0) > 0.5
    assert 0.2 < windows.mean() < 0.7  # ticks that do not touch
    # Two steps in by the button: a fourth of the time.
    browser.js("for (let k = 0; k < 2; k++) document.querySelector('[data-dd=zoomin]').click(); texts.length = 0;")
    browser.later(DRAWN)
    assert {"0:30", "7:00"} <= set(browser.js("return texts"))
    browser.js("document.querySelector('[data-dd=zoomout]').click(); texts.length = 0;")
    browser.later(DRAWN)
    assert "14:00" in browser.js("return texts")
    browser.driver.refresh()


def lane_rows(browser: Browser) -> dict[str, np.ndarray]:
    """Pixels of lanes right of the labels."""
    found = browser.js(
        "const c = document.querySelector('[data-dd=lanes]'), p = c.getContext('2d'), out = {};"
        f"for (const [name, row] of Object.entries({V}.rows)) {{"
        "const d = p.getImageData(80, row.y, c.width - 90, row.h);"
        "out[name] = [d.width, d.height, Array.from(d.data)]; } return out"
    )
    return {name: np.array(data).reshape(height, width, 4)[..., :3] for name, (width, height, data) in found.items()}


def test_a_window_under_the_pointer_is_named_and_a_click_loops_it(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav"))
    browser.later(DRAWN)
    lanes = box(browser, "lanes")
    row = browser.js(f"return {V}.rows.windows")
    x = lanes["left"] + 74 + (lanes["width"] - 74) * 1.02 / SECONDS
    y = lanes["top"] + row["y"] + 4
    pointer(browser, "lanes", "pointermove", x, y)
    toast = "return document.querySelector('[data-dd=toast]').textContent"
    browser.wait("return document.querySelector('[data-dd=toast]').textContent")
    assert browser.js(toast) == "window 2: frames 30 to 89"
    pointer(browser, "lanes", "pointermove", x, lanes["top"] + 40)
    browser.wait("return !document.querySelector('[data-dd=toast]').textContent")
    pointer(browser, "lanes", "pointerdown", x, y)
    assert browser.js(f"return {V}.state.loop") == [30, 90]
