"""The body model of a user on the page that is served: its numbers, what is drawn as it, and what is measured."""

import base64
import gzip
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.core.bodies import SMPLX55
from dancedata.core.skeleton import SMPL24
from dancedata.formats.body_mesh import BodyMesh, skinned
from dancedata.scene.comparisons import comparison_of, comparison_payload, file_format
from dancedata.scene.scenes import Scenes
from dancedata.viewer.model import as_model, model_payload
from dancedata.viewer.server import Site
from dancedata.viewer.view import ViewRequest
from tests.body_models import body_model
from tests.scene.helpers import serving
from tests.scene.test_scenes import unpacked
from tests.viewer.test_server import Client

Of = Callable[[str], Scenes]


@pytest.fixture
def mesh(tmp_path: Path) -> BodyMesh:
    return BodyMesh.read(body_model(tmp_path / "m.npz", SMPLX55), np.linspace(-1, 1, 10))


def numbers(text: str, dtype: str, width: int) -> Any:
    return np.frombuffer(gzip.decompress(base64.b64decode(text)), dtype).reshape(-1, width)


def test_its_numbers_are_the_mesh(mesh: BodyMesh) -> None:
    payload = {name: data for name, _, data in json.loads(json.dumps(model_payload(mesh)))}
    places = numbers(payload["at"], "<f4", 3) + mesh.rest[0]
    np.testing.assert_allclose(places, mesh.vertices, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(numbers(payload["normal"], "<f4", 3), mesh.normals)
    np.testing.assert_array_equal(numbers(payload["faces"], "<u4", 3), mesh.faces)
    joints, weights = numbers(payload["bones"], "u1", 4), numbers(payload["weights"], "u1", 4) / 255
    dense = np.zeros_like(mesh.weights)
    np.put_along_axis(dense, joints.astype(int), weights.astype(np.float32), axis=1)
    moves = np.random.default_rng(0).normal(0, 0.3, (55, 3))
    shown = skinned(mesh.vertices, dense / dense.sum(axis=1, keepdims=True), np.tile(np.eye(3), (55, 1, 1)), moves)
    wanted = skinned(mesh.vertices, mesh.weights, np.tile(np.eye(3), (55, 1, 1)), moves)
    np.testing.assert_allclose(shown, wanted, rtol=0, atol=0.005)
    tint = numbers(payload["tint"], "u1", 4)
    np.testing.assert_allclose(tint[:, :2] / 255, mesh.sides[:, 1:], atol=0.003)
    left = mesh.weights[:, [SMPLX55.index(name) for name in ("left_knee", "left_wrist")]].sum(axis=1)
    assert (tint[left > 0.9, 0] > 220).all()


def test_a_site_draws_its_dancers_as_the_model(scenes: Of, mesh: BodyMesh) -> None:
    plain = scenes("thirty")
    site, before = Site(plain, mesh=mesh), Site(plain)
    clip, was = (json.loads(of.answer("/clip/0", None).body) for of in (site, before))
    assert clip["figure"]["joints"] == list(SMPLX55.joints)
    assert was["figure"]["joints"] == list(SMPL24.joints)
    wanted = plain.scene(plain.items[0]).with_mesh(mesh).figure
    assert wanted is not None
    np.testing.assert_allclose(unpacked(clip["figure"]), wanted.joints, rtol=0, atol=6e-4)
    assert "the body model has no left_hand, right_hand, which turn in the motion" in clip["notes"]
    assert clip["speed"] == was["speed"]
    assert json.loads(site.answer("/model", None).body) == [list(entry) for entry in model_payload(mesh)]
    assert before.answer("/model", None).status == 404


def test_view_serves_it(scenes: Of, tmp_path: Path) -> None:
    model = body_model(tmp_path / "m.npz", SMPLX55)
    with serving(ViewRequest(scenes("thirty").store.path, body_model=model, betas=(2.0,))) as address:
        client = Client(address)
        status, headers, body = client.get("/model")
        assert (status, headers["content-type"], headers["cache-control"]) == (200, "application/json", "no-store")
        expected = model_payload(BodyMesh.read(model, [2.0]))
        assert json.loads(body) == [list(entry) for entry in expected]
        assert json.loads(client.get("/clip/0")[2])["figure"]["model"] is True
        turns = json.loads(client.get("/clip/0?part=turns")[2])
        assert len(turns[0]["rest"]) == 3 * 55
        page = client.get("/")[2].decode()
    assert '"model":true' in page
    assert expected[0][2] not in page


def test_positions_stay_limbs_with_a_note(scenes: Of, mesh: BodyMesh) -> None:
    site = Site(scenes("thirty"), mesh=mesh)
    clip = json.loads(site.answer("/clip/0", "joints").body)
    assert clip["figure"]["joints"] == list(SMPL24.joints)
    assert clip["notes"][-1].startswith("no body model: positions of joints do not turn a body model")


def test_what_is_measured_is_the_motion_as_it_was_read(scenes: Of, mesh: BodyMesh, tmp_path: Path) -> None:
    plain = scenes("thirty")
    item = plain.items[0]
    figure = plain.scene(item).figure
    assert figure is not None
    np.save(tmp_path / f"{item.id}.npy", figure.joints + 0.01)
    other = comparison_of(tmp_path, plain, file_format(plain.store, grid=plain.grid))
    dressed = as_model(plain.scene(item), mesh)
    compared, wanted = (comparison_payload(other, scene) for scene in (dressed, plain.scene(item)))
    assert compared["mean"] == wanted["mean"] == pytest.approx(10 * np.sqrt(3), abs=0.1)
    assert compared["figure"]["joints"] == list(SMPL24.joints)  # positions alone
    assert dressed.figure is not None
    assert dressed.figure.sliding == figure.sliding


def test_another_dressed_clip_is_measured_as_it_was_read(scenes: Of, mesh: BodyMesh) -> None:
    plain = scenes("thirty")
    one, other = plain.scene(plain.items[0]), plain.scene(plain.items[1])
    wanted = one.figure.distance_mm(other.figure)
    dressed = one.with_mesh(mesh).figure.distance_mm(other.with_mesh(mesh).figure.part(0.0, one.seconds))
    np.testing.assert_allclose(dressed, wanted, rtol=0, atol=1e-9)
    part = other.with_mesh(mesh).figure.part(0.5, 1.0)
    assert part.sliding == other.figure.part(0.5, 1.0).sliding
    moved = other.with_mesh(mesh).figure.shifted((0.0, 0.0, 1.0))
    assert moved.distance_mm(other.figure).mean() == pytest.approx(1000)
