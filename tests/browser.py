"""Chromium for the tests of pages: one for all rooms, and one that draws WebGL."""

import os
import shutil
from collections.abc import Callable, Iterator
from itertools import count
from typing import Any

import pytest


class Browser:
    """Chromium without a display, and without any network except 127.0.0.1."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver
        self.js: Callable[..., Any] = driver.execute_script
        self._pages = count()

    def get(self, address: str) -> None:
        """Load a page, though only its fragment differs from that of the page before.

        By way of about:blank it would have another process for each, which takes as long as all that a test does.
        """
        page, sharp, fragment = address.partition("#")
        self.driver.get(f"{page}{'&' if '?' in page else '?'}page={next(self._pages)}{sharp}{fragment}")

    def open(self, address: str) -> None:
        """Load a page and wait for its clip, and for two pictures: the first may have another layout."""
        self.get(address)
        self.wait("return document.querySelector('[data-dd=root]')?.dataset.ready === '1'")
        self.later("await new Promise(r => requestAnimationFrame(() => requestAnimationFrame(r)))")

    def rest(self) -> None:
        """Leave the page, which would draw, or play, while tests of other modules run."""
        self.driver.get("about:blank")

    def wait(self, script: str, *arguments: Any) -> Any:
        """Wait until a script returns something true."""
        from selenium.webdriver.support.ui import WebDriverWait

        return WebDriverWait(self.driver, 60, poll_frequency=0.05).until(
            lambda d: d.execute_script(script, *arguments)
        )

    def later(self, script: str) -> Any:
        """Return the result of a script of promises."""
        code = (
            "const done = arguments[arguments.length - 1]; (async () => {"
            + script
            + "})().then(done, e => done('' + e))"
        )
        return self.driver.execute_async_script(code)

    def size(self, width: int, height: int) -> None:
        """Set the size of the page, CSS pixels."""
        about = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", about)

    def text(self, name: str) -> str:
        """Return what an element of the viewer says."""
        return str(self.js("return document.querySelector(`[data-dd=${arguments[0]}]`).textContent", name))

    def key(self, text: str) -> None:
        """Press a key."""
        self.driver.switch_to.active_element.send_keys(text)

    def log(self) -> list[str]:
        """Messages of the console since the last call, without Chromium's advice on reading pixels."""
        messages = [entry["message"] for entry in self.driver.get_log("browser")]
        return [m for m in messages if "willReadFrequently" not in m and "GPU stall due to ReadPixels" not in m]


def _missing() -> str:
    try:
        import selenium  # noqa: F401
    except ImportError:
        return "selenium is not installed"
    return next((f"no {name}" for name in ("chromium", "chromedriver") if shutil.which(name) is None), "")


@pytest.fixture(scope="session")
def plain_chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    yield from _browser(tmp_path_factory, "disable-3d-apis")


@pytest.fixture(scope="session")
def webgl_chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    yield from _browser(tmp_path_factory, "enable-unsafe-swiftshader")


@pytest.fixture(scope="module")
def browser(plain_chromium: Browser) -> Iterator[Browser]:
    """One browser for all tests, without WebGL; skips where there is none."""
    yield plain_chromium
    plain_chromium.rest()


@pytest.fixture(scope="module")
def webgl_browser(webgl_chromium: Browser) -> Iterator[Browser]:
    """A browser that draws WebGL by software."""
    yield webgl_chromium
    webgl_chromium.rest()


def _browser(tmp_path_factory: pytest.TempPathFactory, *more: str) -> Iterator[Browser]:
    """Start a browser; skip where there is none, unless DANCEDATA_REQUIRE_BROWSER is set."""
    problem = _missing()
    if problem and os.environ.get("DANCEDATA_REQUIRE_BROWSER"):
        pytest.fail(f"DANCEDATA_REQUIRE_BROWSER is set, but {problem}")
    if problem:
        pytest.skip(f"browser tests: {problem}")
    os.environ["SE_OFFLINE"] = "true"
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = str(shutil.which("chromium"))
    flags = [
        "headless", "disable-gpu", "disable-quic", "no-first-run", "disable-background-networking",
        "disable-component-update", "disable-sync", "autoplay-policy=no-user-gesture-required",
        "host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1", "window-size=1440,900",
        f"user-data-dir={tmp_path_factory.mktemp('chromium')}", *more,
    ]  # fmt: skip
    for flag in [*flags, *(["no-sandbox"] if os.geteuid() == 0 else [])]:
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(str(shutil.which("chromedriver"))))
    driver.set_script_timeout(120)
    yield Browser(driver)
    driver.quit()
