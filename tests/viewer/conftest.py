"""A dataset with odd names and music in four formats, a server for it, and a browser."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata.viewer.view import ViewRequest
from tests.viewer.helpers import FORMATS, FPS, HOSTILE, Browser, clicks, jumping, serving


@pytest.fixture(scope="session")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One clip for each format of music, and one for each hostile name."""
    folder = tmp_path_factory.mktemp("odd") / "source"
    (folder / "motions").mkdir(parents=True)
    (folder / "music").mkdir()
    for number, name in enumerate([*FORMATS, *HOSTILE]):
        poses, trans = jumping(name)
        np.savez(folder / "motions" / f"{name}.npz", poses=poses, trans=trans, mocap_framerate=FPS)
        fmt = name if name in FORMATS else FORMATS[number % 2]
        clicks(fmt, folder / "music" / f"{name}.{fmt}")
    return folder


@pytest.fixture(scope="session")
def odd(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset built from it."""
    out = tmp_path_factory.mktemp("odd-built") / "odd"
    dataset = {"folder": {"fps": FPS, "up": "y", "unit": "m"}}
    recipe = {"recipe": 1, "name": "odd", "dataset": dataset, "windows": {"length_s": 2, "stride_s": 0.5},
              "motion": {"edge151": {}}, "audio": {"librosa35": {}}}  # fmt: skip
    dancedata.build(recipe, source, out, jobs=1, cache=out.parent / "cache", progress=False)
    return out


@pytest.fixture(scope="session")
def served(odd: Path, source: Path) -> Iterator[str]:
    """Address of the dataset with its music."""
    with serving(ViewRequest(odd, source=source)) as address:
        yield address


def _missing() -> str:
    try:
        import selenium  # noqa: F401
    except ImportError:
        return "selenium is not installed"
    return next((f"no {name}" for name in ("chromium", "chromedriver") if shutil.which(name) is None), "")


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """One browser for all tests; skips where there is none, unless DANCEDATA_REQUIRE_BROWSER is set."""
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
        f"user-data-dir={tmp_path_factory.mktemp('chromium')}",
    ]  # fmt: skip
    for flag in [*flags, *(["no-sandbox"] if os.geteuid() == 0 else [])]:
        options.add_argument(f"--{flag}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(str(shutil.which("chromedriver"))))
    driver.set_script_timeout(120)
    yield Browser(driver)
    driver.quit()
