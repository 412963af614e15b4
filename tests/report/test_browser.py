"""A report in a browser: names lead to their clips and back, nothing runs that a dataset named, no requests."""

from pathlib import Path
from urllib.parse import quote, unquote

import dancedata
from dancedata.pages import write_report
from tests.browser import Browser
from tests.report.conftest import HOSTILE
from tests.scene.conftest import duets  # noqa: F401 (the duets of the tests of the viewer)

LINKS = "[...document.querySelectorAll('#r-report .paths a')]"
SHOWN = """
const v = window.dancedataViewer, root = document.querySelector('[data-dd=root]');
return document.body.dataset.page === 'clips' && v && root.dataset.ready === '1' && v.state.clip && !v.state.dirty
  && v.state.clip.id === arguments[0];
"""
DRAWN = """
const c = document.querySelector("[data-dd=lanes]");
const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
return d.some((value, k) => k % 4 === 3 && value > 0);
"""


def test_names_lead_to_their_clips_and_back(browser: Browser, hostile: Path, tmp_path: Path) -> None:
    write_report(hostile, tmp_path / "hostile.html", clips=8)
    driver = browser.driver
    driver.get((tmp_path / "hostile.html").as_uri())
    browser.log()
    assert driver.execute_script("return document.body.dataset.page") == "report"
    assert driver.execute_script("return window.dancedataViewer") is None
    hrefs = driver.execute_script(f"return {LINKS}.map(a => a.getAttribute('href'))")
    assert len(hrefs) == 8
    for number, href in enumerate(hrefs[:4]):
        driver.execute_script(f"{LINKS}[{number}].click()")
        browser.wait(SHOWN, unquote(href[len("#clip=") :]))
        assert driver.execute_script(DRAWN)
        driver.execute_script("document.getElementById('r-back').click()")
        browser.wait("return document.body.dataset.page === 'report' && location.hash === '#r-paths'")
    driver.back()
    browser.wait("return document.body.dataset.page === 'clips'")
    assert driver.execute_script("return window.PWN") is None
    assert driver.execute_script("return performance.getEntriesByType('resource').length") == 0
    assert browser.log() == []


def test_a_bar_leads_to_the_list_of_its_clips(browser: Browser, demo: Path, tmp_path: Path) -> None:
    write_report(demo, tmp_path / "demo.html", clips=8)
    browser.get((tmp_path / "demo.html").as_uri())
    bars = "[...document.querySelectorAll('#r-windows_by_genre svg a')]"
    names = browser.js(f"return {bars}.map(a => a.querySelector('title').textContent)")
    assert len(names) == len({clip.genre for clip in dancedata.open(demo).clips()})
    browser.js(f"{bars}[0].focus()")
    browser.key("\ue007")  # Enter
    browser.wait("return window.dancedataViewer && document.body.dataset.page === 'clips'")
    browser.wait("return document.querySelector('[data-dd=root]').dataset.ready === '1'")
    shown = browser.js("return window.dancedataViewer.shown.map(item => item.id)")
    of_genre = [clip.id for clip in dancedata.open(demo).clips() if clip.genre == names[0]]
    assert set(shown) <= set(of_genre)
    assert shown
    assert browser.js("return window.dancedataViewer.state.clip.genre") == names[0]


def test_a_group_is_opened_whole_and_a_dancer_alone(browser: Browser, duets: Path, tmp_path: Path) -> None:  # noqa: F811
    write_report(duets, tmp_path / "page.html")
    browser.driver.get((tmp_path / "page.html").as_uri())
    browser.wait("return document.body.dataset.page === 'report'")  # its script has run, and sees the click
    browser.js("document.querySelector('a[href=\"#group=Waltz_5_0\"]').click()")
    browser.wait("return window.dancedataViewer?.state.clip?.members?.length === 2")
    assert browser.js("return dancedataViewer.state.dancer") is None
    browser.js("document.getElementById('r-back').click()")
    browser.wait("return document.body.dataset.page === 'report'")
    assert browser.js("return location.hash") == "#r-groups_list"
    browser.js("document.querySelector('a[href=\"#clip=Waltz_5_0_01\"]').click()")
    browser.wait("return dancedataViewer.state.dancer === 1")
    assert browser.log() == []


def test_untrusted_names_of_groups_and_roles_run_nothing(browser: Browser, relabelled, tmp_path: Path) -> None:
    names = [f"{name}{k}" for k, name in enumerate(HOSTILE)]
    path = relabelled(lambda k: {"group": names[k % 6] + "-" * (k // 6), "member": 0, "role": names[k % 6]})
    write_report(path, tmp_path / "page.html", clips=8)
    for name in names:
        browser.get(f"{(tmp_path / 'page.html').as_uri()}#group={quote(name, safe='')}")
        browser.wait("return window.dancedataViewer?.state.clip?.group === arguments[0]", name)
        browser.key("d")
        assert browser.js("return dancedataViewer.state.dancer") == 0
        chips = browser.text("dancers")
        assert "\u202e" not in chips
    assert browser.js("return window.PWN") is None
    pictures = "return [...document.querySelectorAll('img, iframe')].map(e => e.closest('figure')?.id)"
    assert all(place.startswith("r-heat_") for place in browser.js(pictures))
    assert browser.log() == []


def test_tables_are_sorted_by_their_heads(browser: Browser, demo: Path, tmp_path: Path) -> None:
    """By the keyboard, too: heads are buttons; numbers by value, in both directions."""
    report = write_report(demo, tmp_path / "page.html", clips="none")
    browser.driver.get((tmp_path / "page.html").as_uri())
    browser.js("document.querySelector('#r-bas_clips details').open = true")
    cells = (
        "return [...document.querySelectorAll('#r-bas_clips tbody tr')].map(r => r.cells[arguments[0]].textContent)"
    )
    scores = {row["clip"]: row["bas"] for row in report.document["clips"]}
    press = "document.querySelectorAll('#r-bas_clips thead button')[arguments[0]]"
    browser.driver.execute_script(f"{press}.focus()", 3)
    browser.driver.switch_to.active_element.send_keys("\ue007")
    assert browser.driver.execute_script(cells, 0) == sorted(scores, key=lambda clip: scores[clip])
    assert browser.js("return document.querySelectorAll('#r-bas_clips [aria-sort=ascending]').length") == 1
    browser.driver.switch_to.active_element.send_keys(" ")
    assert browser.driver.execute_script(cells, 0) == sorted(scores, key=lambda clip: -scores[clip])
    hidden = browser.js("const row = document.querySelector('#r-bas_clips tbody tr'); row.cells[3].textContent = '–';"
                        "return row.cells[0].textContent")  # fmt: skip
    for _ in range(2):  # a dash comes last in both directions
        browser.driver.execute_script(f"{press}.click()", 3)
        assert browser.driver.execute_script(cells, 0)[-1] == hidden
    browser.driver.execute_script(f"{press}.click()", 0)
    assert browser.driver.execute_script(cells, 0) == sorted(scores)
    assert browser.log() == []
