"""The page in a real browser. `pytest -m nightly tests/viewer` runs the slow ones too."""

import base64
import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from urllib.parse import quote

import numpy as np
import pytest

import dancedata
from dancedata.scene.page import clip_page, page_data, whole_page
from dancedata.scene.payload import scene_payload
from dancedata.scene.scenes import Scenes
from dancedata.store.schema import Field
from dancedata.testing.stores import random_columns, write_random_store
from dancedata.viewer.notebook import html_of
from dancedata.viewer.view import ViewRequest
from tests.browser import Browser
from tests.scene.helpers import CLICKS, FORMATS, FPS, HOSTILE, TURNED, serving

V = "dancedataViewer"


#: Width and pixels of the stage: red, green, blue and opacity, in base64.
PIXELS = (
    "const c = document.querySelector('[data-dd=figure]');"
    "const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; let text = '';"
    "for (let i = 0; i < d.length; i += 32768) text += String.fromCharCode.apply(null, d.subarray(i, i + 32768));"
    "return [c.width, btoa(text)]"
)
DRAWN = "await new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)))"


def stage(browser: Browser) -> np.ndarray:
    """The stage, (H, W, 3)."""
    browser.later(f"{V}.state.dirty = true; {DRAWN}")
    width, values = browser.js(PIXELS)
    return np.frombuffer(base64.b64decode(values), np.uint8).reshape(-1, width, 4)[..., :3].astype(int)


def count_of(picture: np.ndarray, colour: str) -> int:
    """Pixels of a picture (H, W, 3) that have a colour."""
    return int((picture == [int(colour[k : k + 2], 16) for k in (1, 3, 5)]).all(axis=-1).sum())


def colour_count(browser: Browser, name: str) -> int:
    """Pixels of the stage that have a colour of the theme."""
    return count_of(stage(browser), browser.js(
        "return getComputedStyle(document.documentElement).getPropertyValue('--' + arguments[0]).trim()", name
    ))  # fmt: skip


def at(served: str, clip: str, more: str = "") -> str:
    """Address of a clip."""
    return f"{served.partition('#')[0]}#clip={quote(clip, safe='')}{more}"


def state(browser: Browser) -> dict:
    """State of the page."""
    return browser.js(
        f"const s = {V}.state; return {{id: s.clip.id, t: s.t, loop: s.loop, drawn: s.drawn, playing: s.playing}}"
    )


def test_links_open_the_same_moment(browser: Browser, served: str) -> None:
    for clip in ("wav", *HOSTILE):
        browser.open(at(served, clip, "&t=3.21&loop=30-120"))
        first = state(browser)
        assert first["id"] == clip
        assert abs(first["t"] - 3.21) < 0.01
        assert first["loop"] == [30, 120]
        browser.wait("return location.hash.includes('loop=')")
        written = browser.js("return location.hash")
        browser.open(served.partition("#")[0] + written)
        assert state(browser) == first
        browser.wait(f"return {V}.state.clip.sound !== undefined")
    assert browser.js("return window.PWN") is None
    assert browser.js("return document.scripts.length") == 2
    assert browser.js("return document.querySelectorAll('img, iframe').length") == 0
    assert browser.log() == []


def test_a_link_that_is_opened_while_the_address_is_written_is_followed(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav"))
    wanted = f"clip={quote(HOSTILE[0], safe='')}&t=1.5"
    # As in a busy page: the address is due to be written before the event of the link arrives.
    browser.js(
        f"{V}.seek(1); history.replaceState(null, '', '#{wanted}'); "
        "setTimeout(() => window.dispatchEvent(new HashChangeEvent('hashchange')), 300)"
    )
    browser.wait(f"return {V}.state.clip.id === {json.dumps(HOSTILE[0])}")


def test_music_that_is_loading_is_not_missing(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav"))
    assert " · Cite: " in " ".join(browser.text("foot").split())
    browser.js("const plain = window.fetch; window.fetch = (url, ...more) => "
               "String(url).includes('/music') ? new Promise(() => {}) : plain(url, ...more)")  # fmt: skip
    browser.js(f"location.hash = 'clip={quote(HOSTILE[0], safe='')}'")
    browser.wait(f"return {V}.state.clip.id !== 'wav'")
    browser.wait("return document.querySelector('[data-dd=clock]').textContent.includes('music is loading')")
    assert "no music" not in browser.text("meta")


def test_bidirectional_characters_are_shown_as_codes(browser: Browser, odd: Path, tmp_path: Path) -> None:
    dataset = Scenes(dancedata.open(odd))
    items = [replace(item, clip=replace(item.clip, genre=TURNED, music=TURNED)) for item in dataset.items]
    data = page_data(
        dataset, items, clips={0: {**scene_payload(dataset.scene(items[0])), "id": TURNED, "clip": TURNED}}
    )
    data["list"]["clips"][0][0] = TURNED
    page = tmp_path / "turned.html"
    page.write_text(whole_page(data, TURNED, meta_policy=True))
    browser.open(f"{page.as_uri()}#clip={quote(TURNED, safe='')}&t=3.21")
    assert state(browser)["id"] == TURNED
    shown = browser.js(
        "return [...document.querySelectorAll('h2, .item b, .item small')].map(e => e.textContent).join()"
    )
    assert not set(shown) & set("\u202e\u2028")
    assert r"left\u202eright\u2028end" in shown
    browser.wait("return location.hash.includes('t=3.21')")
    browser.open(page.as_uri() + browser.js("return location.hash"))
    assert state(browser)["id"] == TURNED
    assert abs(state(browser)["t"] - 3.21) < 0.01
    assert browser.log() == []


def test_only_its_own_server_is_contacted(browser: Browser, served: str) -> None:
    browser.driver.get_log("performance")
    browser.open(at(served, "wav"))
    browser.wait(f"return {V}.state.clip.sound")
    sent = [json.loads(entry["message"])["message"] for entry in browser.driver.get_log("performance")]
    asked = [m["params"]["request"]["url"] for m in sent if m["method"] == "Network.requestWillBeSent"]
    assert asked
    base = served.partition("?")[0]
    assert [url for url in asked if not url.startswith((base, "data:", "about:"))] == []


def test_keys(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav", "&t=1"))
    image = "return document.querySelector('[data-dd=figure]').toDataURL()"
    before = browser.js(image)
    browser.key("\ue014")  # right
    assert state(browser)["t"] == pytest.approx(1 + 1 / FPS, abs=1e-6)
    browser.js(f"{V}.seek(2.3)")  # after a jump
    browser.wait(f"return {V}.state.drawn === 69")
    assert browser.js(image) != before
    browser.key("l")
    assert len(state(browser)["loop"]) == 2
    browser.key("l")
    assert state(browser)["loop"] is None
    browser.key("\ue011")
    assert state(browser)["t"] == 0
    browser.key("m")
    assert browser.js("return document.querySelector('[data-dd=mirror]').getAttribute('aria-pressed')") == "true"
    browser.key("2")
    assert browser.js(f"return {V}.state.rate") == 0.5
    first = state(browser)["id"]
    browser.key("]")
    browser.wait(f"return {V}.state.clip.id !== arguments[0]", first)
    browser.key("?")
    assert browser.js("const keys = document.querySelector('[data-dd=keys]'); return keys.open && !keys.scrollTop")


def test_a_sentence_says_what_a_lane_is(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav"))
    move = (
        "const lanes = document.querySelector('[data-dd=lanes]'), box = lanes.getBoundingClientRect();"
        f"const row = {V}.rows[arguments[0]]; lanes.dispatchEvent(new PointerEvent('pointermove', {{"
        "clientX: box.left + arguments[1], clientY: box.top + row.y + row.h / 2})); return lanes.title"
    )
    said = [browser.js(move, lane, 20) for lane in ("music", "speed", "contact", "windows", "flags")]
    assert all(said)
    assert len(set(said)) == 5
    assert browser.js(move, "music", 300) == ""


def test_the_best_clip_moves_at_once_and_sounds_at_the_first_click(browser: Browser, served: str, odd: Path) -> None:
    scenes = ViewRequest(odd).scenes()
    items = [item for item in scenes.items if not (item.source or scenes.flag_count(item))] or scenes.items
    opened = [scenes.scene(item) for item in items]
    hits = {scene.item.name: len(scene.hits) / max(1, len(scene.offsets)) for scene in opened}
    browser.open(served)
    assert hits[state(browser)["id"]] == max(hits.values())
    sentences = "return [...document.querySelectorAll('.sentences p')].map(p => p.textContent)"
    browser.js("localStorage.clear()")
    browser.open(served)
    browser.wait(f"return {V}.state.playing && {V}.state.t > 0 && !{V}.context")
    browser.wait("return document.querySelector('.sentences')")
    said = browser.js(sentences)
    assert len(said) == len(set(said)) >= 4
    browser.driver.find_element("css selector", "[data-dd=sound]").click()
    browser.wait(f"return {V}.context?.state === 'running' && {V}.state.playing")
    assert browser.js("return document.querySelector('[data-dd=sound]').hidden")
    assert browser.js(sentences) == []
    browser.open(served)
    browser.wait(f"return {V}.state.playing && {V}.state.t > 0.5")
    assert browser.js(sentences) == []  # once


def test_flags_are_visited_one_after_the_other(browser: Browser, odd: Path, tmp_path: Path) -> None:
    dataset = Scenes(dancedata.open(odd))
    clip = dataset.find("wav").clip.id
    frames = [13, 55, 56, 56, 90, 151]
    about = {"clip": clip, "kind": "fast_turn", "joint": "left_knee", "rate": "60", "value": 50.0, "unit": "deg"}
    dataset.__dict__["_quality"] = {clip: [{**about, "frame": frame} for frame in frames]}
    page = tmp_path / "flags.html"
    page.write_text(clip_page(dataset, dataset.items))
    browser.open(f"{page.as_uri()}#clip=wav")
    for frame in sorted(set(frames)):
        browser.key("f")
        assert abs(state(browser)["t"] - frame / 60) <= 1 / FPS
        browser.wait(
            "return document.querySelector('[data-dd=toast]').textContent.includes('fast turn left knee 50 deg')"
        )
    browser.key("f")
    assert state(browser)["t"] == pytest.approx(13 / 60, abs=1e-4)
    assert browser.js("return performance.getEntriesByType('resource').length") == 0
    assert browser.log() == []


def test_every_control_has_a_name_and_can_be_reached(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav"))
    nodes = browser.driver.execute_cdp_cmd("Accessibility.getFullAXTree", {})["nodes"]
    roles = ("button", "slider", "combobox", "checkbox", "searchbox", "listbox", "textbox")
    controls = [n for n in nodes if n.get("role", {}).get("value") in roles]
    assert len(controls) > 12
    assert [n for n in controls if not n.get("name", {}).get("value")] == []
    focusable = browser.js(
        "return [...document.querySelectorAll('button,select,input,canvas[role=slider],[role=listbox]')]"
        ".filter(e => e.offsetParent && !e.disabled && e.tabIndex < 0).length"
    )
    assert focusable == 0
    slider = browser.js("return document.querySelector('[role=slider]').getAttribute('aria-valuetext')")
    assert slider.startswith("0.00 seconds, frame 0")


def test_contacts_are_rings_on_the_stage(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav", "&t=1"))
    assert browser.js(f"return {V}.state.clip.figure.contacts[30]") == 15  # it stands still
    assert colour_count(browser, "contact") > 50


def test_fourteen_hundred_clips(browser: Browser, tmp_path: Path) -> None:
    # As many clips as AIST++ has; what they hold does not matter for the list.
    fields = (Field("pose", "motion", random_columns(3), Fraction(30)),)
    clips = {"train": 980, "val": 214, "test": 214}
    stored = write_random_store(tmp_path / "many", clips=clips, fields=fields, n_frames=(60, 90))
    with serving(ViewRequest(stored.path)) as address:
        browser.open(address)
        size = browser.js("return performance.getEntriesByType('navigation')[0].decodedBodySize")
        assert size < 1_000_000
        assert browser.js("return document.querySelectorAll('.item').length") < 60
        shown = browser.js(
            "const q = document.querySelector('[data-dd=q]'); q.value = arguments[0];"
            f"q.dispatchEvent(new Event('input')); return {V}.shown.length", stored.clips[7].id,
        )  # fmt: skip
        assert 0 < shown < 1408
        log = browser.log()
    assert log == []


TAP = """
const v = dancedataViewer, c = v.context, tap = c.createAnalyser(), log = [], heard = [];
tap.fftSize = 32768; v.gain.connect(tap);
const data = new Float32Array(tap.fftSize), end = c.currentTime + arguments[0];
const done = arguments[arguments.length - 1];
const draw = () => {
  log.push([c.currentTime, c.outputLatency || 0, v.state.t, v.state.drawn]);
  if (c.currentTime < end) requestAnimationFrame(draw);
};
const listen = () => {
  const now = c.currentTime;
  tap.getFloatTimeDomainData(data);
  for (let i = 0; i < data.length; i++) {
    if (Math.abs(data[i]) > 0.25) { heard.push(now - (data.length - i) / c.sampleRate); i += c.sampleRate * 0.1; }
  }
  if (now < end) setTimeout(listen, 60); else { v.gain.disconnect(tap); done([log, heard]); }
};
requestAnimationFrame(draw); setTimeout(listen, 60);
"""


def sync_error(browser: Browser, begin: str, seconds: float, loop: tuple[float, float] | None = None) -> float:
    """Greatest difference between the drawn time and that of a click, when the click is heard, seconds."""
    errors: list[float] = []
    for _ in range(20):  # a busy machine draws few pictures per second; a click between distant ones proves nothing
        browser.later(f"{begin}; if (!{V}.state.playing) await {V}.play(true)")
        errors += errors_of_clicks(*(np.array(p) for p in browser.driver.execute_async_script(TAP, seconds)), loop)
        if len(errors) >= 2:
            return max(errors)
    raise AssertionError(f"{len(errors)} clicks between near pictures")


def errors_of_clicks(log: np.ndarray, heard: np.ndarray, loop: tuple[float, float] | None) -> list[float]:
    """Differences between the drawn times, (n, 4) of TAP, and those of the clicks that were heard."""
    clock, drawn = log[:, 0] - log[:, 1], log[:, 2]
    once: list[list[float]] = []
    for instant in np.sort(heard):
        if once and instant - once[-1][-1] < 0.08:
            once[-1].append(instant)
        else:
            once.append([instant])
    errors = []
    for instant in (float(np.median(group)) for group in once):
        k = int(np.searchsorted(clock, instant))
        if not 0 < k < len(clock) or not -1e-6 < drawn[k] - drawn[k - 1] < 0.3:
            continue  # before the first picture, or across the end of a loop
        share = (instant - clock[k - 1]) / (clock[k] - clock[k - 1])
        shown = drawn[k - 1] + share * (drawn[k] - drawn[k - 1])
        errors.append(float(np.abs(CLICKS - shown).min()))
    if loop is not None:
        assert drawn.min() >= loop[0] - 1e-6
        assert drawn.max() < loop[1] + 1e-6
    return errors


def play_from(browser: Browser, seconds: float) -> None:
    """Seek, play, and wait for the first movement."""
    browser.later(f"{V}.seek({seconds}); await {V}.play(true)")
    browser.wait(f"return {V}.state.playing && {V}.context.state === 'running' && {V}.state.t > {seconds} + 0.05")


@pytest.mark.parametrize(
    ("fmt", "whole"), [("ogg", False), *[pytest.param(fmt, True, marks=pytest.mark.nightly) for fmt in FORMATS]]
)
def test_clicks_are_heard_when_they_are_drawn(browser: Browser, served: str, fmt: str, whole: bool) -> None:
    browser.open(at(served, fmt))
    browser.wait(f"return {V}.state.clip.sound")
    frame = 1 / FPS
    play_from(browser, 0.0)
    assert sync_error(browser, f"{V}.state.t < 3 || {V}.seek(0)", 1.2) <= frame  # play
    assert sync_error(browser, f"{V}.seek(3.1)", 1.2) <= frame  # seek while it plays
    browser.js(f"{V}.setLoop([60, 75])")
    browser.later("await new Promise(r => setTimeout(r, 1100))")
    assert sync_error(browser, "0", 1.2, (2.0, 2.5)) <= frame  # the third pass of a loop
    if whole:
        browser.js(f"{V}.setLoop(null)")
        browser.key("2")
        assert sync_error(browser, f"{V}.seek(1.0)", 3.0) <= frame  # half speed
    browser.later(f"await {V}.play(false)")


def test_a_comparison_is_drawn_and_measured(browser: Browser, odd: Path, source: Path) -> None:
    with serving(ViewRequest(odd, "wav", music=source, compare=(odd, odd))) as address:
        browser.open(address + "&with=original&over=1&t=1")
        browser.wait(f"return {V}.state.other")
        assert browser.js(f"return {V}.state.other.mean") < 0.01
        assert "mm from original" in browser.text("clock")
        assert colour_count(browser, "other") > 20
        names = browser.js("return [...document.querySelectorAll('[data-dd=with] > option')].map(o => o.text)")
        assert names == ["compare with…", "original", odd.name, f"{odd.name} (2)"]
    assert browser.log() == []


def test_a_clip_in_a_notebook_plays(browser: Browser, odd: Path, tmp_path: Path) -> None:
    page = tmp_path / "notebook.html"
    page.write_text(f"<!doctype html><meta charset=utf-8>{html_of(dancedata.open(odd)['wav'])}")
    browser.driver.get(page.as_uri())
    browser.driver.switch_to.frame(0)
    browser.wait("return document.querySelector('[data-dd=root]')?.dataset.ready === '1'")
    assert state(browser)["id"] == "wav"
    assert colour_count(browser, "left") > 200
    browser.driver.switch_to.default_content()
    assert browser.log() == []


def test_another_clip_of_the_dataset_stands_beside(browser: Browser, served: str, odd: Path) -> None:
    browser.open(at(served, "wav", "&t=1"))
    options = browser.js("return [...document.querySelectorAll('[data-dd=with] optgroup option')].map(o => o.value)")
    assert set(options) == {item for item in browser.js(f"return {V}.items.map(i => i.name)") if item != "wav"}
    browser.js(
        "const box = document.querySelector('[data-dd=with]'); box.value = 'mp3';"
        "box.dispatchEvent(new Event('change'))"
    )
    browser.wait(f"return {V}.state.other?.name === 'mp3'")
    with dancedata.open(odd) as store:
        joints = [
            dancedata.decode(store[name].read("edge151"), "edge151", fps=FPS).joints() for name in ("wav", "mp3")
        ]
    apart = 1000 * np.linalg.norm(joints[0] - joints[1], axis=-1).mean(axis=-1)
    assert browser.js(f"return {V}.state.other.mean") == pytest.approx(apart.mean(), abs=0.2)
    browser.wait("return location.hash.includes('with=mp3')")
    written = browser.js("return location.hash")
    browser.open(served.partition("#")[0] + written)
    assert browser.js(f"return {V}.state.other.name") == "mp3"
    assert browser.js("return document.querySelector('[data-dd=with]').value") == "mp3"
    # The next clip stands alone again.
    browser.later(f"await {V}.openItem({V}.items.find(i => i.id === 'flac'))")
    assert browser.js(f"return {V}.state.other") is None
    assert browser.log() == []
