"""A group in a real browser: all dancers, one of them alone, links, keys and pages."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.scene.palette import DANCERS
from dancedata.scene.scenes import Scenes
from dancedata.viewer.view import ViewRequest
from tests.browser import Browser
from tests.scene.helpers import serving
from tests.scene.test_groups import SEVEN, TWO
from tests.viewer.test_browser import V, count_of, stage


def tones(browser: Browser) -> int:
    """How many dancers are drawn in colours of their own: their middle tones on the stage."""
    picture, palette = stage(browser), DANCERS[browser.js("return document.documentElement.dataset.theme")]
    return sum(count_of(picture, middle) > 0 for middle, _, _ in palette)


@pytest.fixture(scope="module")
def served(crowd: Path, crowd_source: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    folder = tmp_path_factory.mktemp("compared") / "moved"
    folder.mkdir()
    scenes = Scenes(dancedata.open(crowd))
    for member in scenes.scene(scenes.find(TWO)).members:
        np.save(folder / f"{member.item.clip.id}.npy", member.figure.joints + np.array((0.003, 0.0, 0.004)))
    with serving(ViewRequest(crowd, music=crowd_source, compare=(folder,))) as address:
        yield address.partition("#")[0]


def shown(browser: Browser) -> dict[str, Any]:
    return browser.js(
        f"const s = {V}.state, f = n => document.querySelector(`[data-dd=${{n}}]`); "
        "return {dancer: s.dancer, title: f('title').textContent, meta: f('meta').textContent, t: s.t, "
        "hash: location.hash, clock: f('clock').textContent, mirror: f('mirror').disabled, loop: s.loop, "
        "chips: [...f('dancers').children].map(b => [b.textContent, b.getAttribute('aria-pressed')])}"
    )


def test_a_group_plays_whole_and_a_dancer_alone(browser: Browser, served: str) -> None:
    browser.size(1440, 900)
    browser.open(f"{served}#group={SEVEN}&t=2.5&loop=30-120")
    now = shown(browser)
    assert (now["dancer"], now["title"], now["loop"]) == (None, SEVEN, [30, 120])
    assert "7 dancers" in now["meta"]
    assert now["chips"] == [["all", "true"], *([str(k), "false"] for k in range(7))]
    assert "m apart" in now["clock"]
    assert now["mirror"]
    assert tones(browser) == 7
    browser.key("m")
    assert "choose a dancer" in browser.text("toast")
    browser.key("d")
    browser.key("d")
    alone = shown(browser)
    assert (alone["dancer"], alone["title"], alone["mirror"]) == (1, f"{SEVEN}_p1", False)
    assert (alone["t"], alone["loop"]) == (now["t"], [30, 120])
    browser.wait(f"return location.hash.startsWith('#clip={SEVEN}_p1&')")
    written = browser.js("return location.hash")
    assert tones(browser) < 7
    browser.key("g")
    assert shown(browser)["dancer"] is None
    browser.wait(f"return location.hash.startsWith('#group={SEVEN}&')")
    browser.open(served + written)
    assert (shown(browser)["dancer"], shown(browser)["loop"]) == (1, [30, 120])
    browser.key("[")
    browser.wait(f"return {V}.state.item.id !== {SEVEN!r}")
    assert shown(browser)["dancer"] is None
    assert browser.log() == []


def test_a_click_on_a_dancer_or_his_lane_shows_him_alone(browser: Browser, served: str) -> None:
    browser.open(f"{served}#group={TWO}&t=1")
    click = """
    const [name, x, y] = arguments, target = document.querySelector(`[data-dd=${name}]`);
    const box = target.getBoundingClientRect();
    const about = {clientX: box.left + x, clientY: box.top + y, pointerId: 1, bubbles: true};
    target.setPointerCapture = () => {};
    target.dispatchEvent(new PointerEvent('pointerdown', about));
    target.dispatchEvent(new PointerEvent('pointerup', about));
    """
    picture = stage(browser)
    tone = DANCERS[browser.js("return document.documentElement.dataset.theme")][1][1]
    found = np.argwhere((picture == [int(tone[k : k + 2], 16) for k in (1, 3, 5)]).all(axis=-1))
    wide = browser.js("return document.querySelector('[data-dd=figure]').getBoundingClientRect().width")
    y, x = (found[len(found) // 2] * wide / picture.shape[1]).tolist()
    browser.js(click, "figure", x, y)
    assert shown(browser)["dancer"] == 1
    browser.js(f"{V}.chooseDancer(null)")
    browser.js(click, "figure", 3, 3)
    assert shown(browser)["dancer"] is None
    browser.js(click, "lanes", 20, browser.js(f"return {V}.rows.dancer0.y") + 4)
    assert shown(browser)["dancer"] == 0


def test_a_group_is_compared(browser: Browser, served: str) -> None:
    browser.open(f"{served}#group={TWO}&t=1&with=moved")
    browser.wait(f"return {V}.state.other?.members?.length === 2")
    browser.wait("return document.querySelector('[data-dd=clock]').textContent.includes('5.0 mm from moved')")
    browser.key("o")
    browser.key("d")
    assert browser.js(f"return !!{V}.state.other.figure && {V}.state.other.name") == "moved"
    assert browser.log() == []


def test_a_group_that_is_not_there_and_a_dancer_in_the_list(browser: Browser, served: str) -> None:
    browser.open(f"{served}#group=gone")
    assert browser.text("notes") == "This dataset has no group gone"
    found = browser.js(
        "const q = document.querySelector('[data-dd=q]'); q.value = '_p6'; "
        f"q.dispatchEvent(new Event('input')); const n = {V}.shown.map(i => i.name); "
        "q.value = ''; q.dispatchEvent(new Event('input')); return n"
    )
    assert found == [SEVEN, f"{SEVEN}__mirror"]


def test_collisions_are_said(browser: Browser, duets: Path) -> None:
    with serving(ViewRequest(duets)) as address:
        browser.open(f"{address.partition('#')[0]}#group=Waltz_5_0&t=4.1")
        clock = shown(browser)["clock"]
        assert "0 follower and 1 leader" in clock
        assert clock.endswith("collide")
        assert " at 1 leader " in clock
        assert "facing" in clock
    assert browser.log() == []
