"""The body in a real browser: cones as in Python, two tones of grey, a face, and shadows by height."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw
from scipy import ndimage

import dancedata
from dancedata.core.skeleton import SMPL24
from dancedata.formats.body_mesh import BodyMesh
from dancedata.scene.scenes import Scenes
from dancedata.viewer.view import ViewRequest
from tests.body_models import body_model
from tests.browser import Browser
from tests.report.test_colours import luminance
from tests.scene.helpers import serving
from tests.viewer.test_browser import DRAWN, V, at, stage


def sides(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Luminances (WCAG) of the pixels of blue and of orange limbs."""
    red, _, blue = np.moveaxis(picture, -1, 0)
    light = np.where(picture / 255 <= 0.03928, picture / 255 / 12.92, ((picture / 255 + 0.055) / 1.055) ** 2.4)
    light = light @ (0.2126, 0.7152, 0.0722)
    return light[blue - red > 50], light[red - blue > 90]


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_limbs_of_both_sides_have_two_tones_of_grey(browser: Browser, served: str, theme: str) -> None:
    browser.open(at(served, "wav", f"&t=1&theme={theme}"))
    assert browser.js("return document.documentElement.dataset.theme") == theme
    assert luminance("#ffffff") == 1
    left, right = sides(stage(browser))
    assert min(len(left), len(right)) > 500
    assert (np.median(left) + 0.05) / (np.median(right) + 0.05) >= 1.5


def test_b_switches_between_body_and_sticks(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav", "&t=1"))
    level = "return document.querySelector('[data-dd=body]').textContent"
    assert browser.js(level) == "Limbs"
    body = stage(browser)
    browser.key("b")
    assert browser.js(level) == "Sticks"
    sticks = stage(browser)
    # A body is more than twice as wide, and shaded.
    assert len(sides(body)[0]) > 1.3 * len(sides(sticks)[0]) > 200
    assert len(np.unique(sides(body)[0])) > 2 * len(np.unique(sides(sticks)[0]))
    browser.wait("return location.hash.includes('body=0')")
    browser.open(served.partition("#")[0] + browser.js("return location.hash"))
    np.testing.assert_array_equal(stage(browser), sticks)
    browser.key("b")
    np.testing.assert_array_equal(stage(browser), body)
    assert browser.log() == []


def test_cones_are_those_of_python(browser: Browser, served: str, odd: Path) -> None:
    scenes = Scenes(dancedata.open(odd))
    figure = scenes.scene(scenes.find("wav")).figure
    assert figure is not None
    browser.open(at(served, "wav", "&t=2"))
    browser.later(DRAWN)
    found = browser.js(f"return {V}.cones")
    wanted = figure.limbs.cones(figure.joints[60], figure.look[60])
    np.testing.assert_allclose([cone[0] for cone in found], wanted.begin, atol=0.004)
    np.testing.assert_allclose([cone[1] for cone in found], wanted.end, atol=0.004)
    np.testing.assert_allclose([cone[2:4] for cone in found], wanted.radii, atol=1e-4)
    assert [cone[4] for cone in found] == list(wanted.tones)


def test_a_face_is_seen_from_the_front_only(browser: Browser, served: str) -> None:
    browser.open(at(served, "wav", "&t=1&theme=dark"))
    turn = f"const l = {V}.state.clip.figure.look; {V}.camera.yaw = Math.atan2(l[90], l[92]) + arguments[0];"
    changed = []
    for yaw in (0.0, np.pi):
        browser.js(f"{V}.camera.zoom = 1; {turn}", yaw)
        with_face = stage(browser)
        faceless = f"const f = {V}.state.clip.figure; window.skull = f.skull; f.skull = skull.slice(0, 2)"
        browser.js(faceless)  # without nose and eyes
        changed.append(int((stage(browser) != with_face).any(axis=-1).sum()))
        browser.js(f"{V}.state.clip.figure.skull = window.skull")
    assert changed[0] > 15
    assert changed[1] < 0.1 * changed[0]


# A body model on the page in a real browser: sent once, and where plain numpy puts it.


Of = Callable[[str], Scenes]


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return body_model(tmp_path_factory.mktemp("model") / "SMPL_MALE.npz", SMPL24)


@pytest.fixture(scope="module")
def address(scenes: Of, model: Path) -> Iterator[str]:
    dances = scenes("thirty")
    with serving(ViewRequest(dances.store.path, dances.items[0].name, body_model=model, at=1.0)) as served:
        yield served


def test_the_model_is_drawn_where_numpy_puts_it(webgl_browser, address, model, scenes):
    webgl_browser.open(address)
    webgl_browser.wait(f"return {V}.state.clip.figure.turning")
    assert webgl_browser.text("body") == "Skin"
    webgl_browser.js(f"Object.assign({V}.camera, {{yaw: 0.4, pitch: 0.1, zoom: 1}})")
    picture = stage(webgl_browser)
    camera, far = webgl_browser.js(f"return {V}.camera"), webgl_browser.js(f"return {V}.far")
    mesh = BodyMesh.read(model)
    plain = scenes("thirty")
    figure = plain.scene(plain.items[0]).figure
    assert figure is not None
    vertices = figure.with_mesh(replace(mesh, correctives=mesh.correctives * 0)).vertices(30)
    assert vertices is not None
    moved = vertices - [camera["x"], camera["y"], camera["z"]]
    (sy, cy), (sp, cp) = (np.sin(0.4), np.cos(0.4)), (np.sin(0.1), np.cos(0.1))
    across, along = moved[:, 0] * cy - moved[:, 2] * sy, moved[:, 0] * sy + moved[:, 2] * cy
    height, width = picture.shape[:2]
    scale = 1.25 * height / (far - moved[:, 1] * sp - along * cp)
    places = np.stack([width / 2 + across * scale, height / 2 - (moved[:, 1] * cp - along * sp) * scale], axis=1)
    image = Image.new("1", (width, height))
    for triangle in places[mesh.faces, :2]:
        ImageDraw.Draw(image).polygon(triangle.ravel().tolist(), fill=1)
    wanted = np.asarray(image)
    inside = wanted & np.roll(wanted, 1, 0) & np.roll(wanted, -1, 0) & np.roll(wanted, 1, 1) & np.roll(wanted, -1, 1)
    assert inside.sum() > 500
    webgl_browser.js(f"{V}.state.follow = false; {V}.camera.x += 50")
    background = stage(webgl_browser)
    differs = np.abs(picture - background).max(axis=2) > 24
    assert differs[inside].mean() > 0.97
    red, _, blue = np.moveaxis(picture, -1, 0)
    coloured = (np.abs(red - blue) > 90) & differs
    near = ndimage.binary_dilation(wanted, iterations=3)
    assert (coloured & ~near).sum() < 0.05 * coloured.sum()  # a skin that is grown is far wider
    assert webgl_browser.log() == []


def test_the_model_is_fetched_once(webgl_browser: Browser, address: str) -> None:
    webgl_browser.open(address)
    webgl_browser.wait(f"return {V}.state.clip.figure.turning")
    webgl_browser.key("]")
    webgl_browser.wait(f"return {V}.state.clip.number === 1 && {V}.state.clip.figure.turning")
    fetched = webgl_browser.js("return performance.getEntriesByType('resource').map(e => new URL(e.name).pathname)")
    assert fetched.count("/model") == 1
    assert webgl_browser.log() == []
