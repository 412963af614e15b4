"""A body model on the page in a real browser: sent once, and where plain numpy puts it."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw
from scipy import ndimage

from dancedata.core.skeleton import SMPL24
from dancedata.formats.body_mesh import BodyMesh
from dancedata.scene.scenes import Scenes
from dancedata.viewer.view import ViewRequest
from tests.body_models import body_model
from tests.browser import Browser
from tests.scene.helpers import serving
from tests.viewer.test_body_browser import stage
from tests.viewer.test_browser import V

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
