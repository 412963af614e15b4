"""The skin: turns as the page gets them against plain kinematics, its mesh, its matrices and its pixels."""

import base64
import gzip
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dancedata.core.grid import FrameGrid
from dancedata.core.skeleton import SMPL24
from dancedata.scene.figure import Figure
from dancedata.scene.page import clip_page
from dancedata.scene.payload import scene_payload, turns_payload
from dancedata.scene.scenes import Scenes
from dancedata.synthetic import synthesise_motion
from tests.browser import Browser
from tests.viewer.test_browser import DRAWN, V, stage


def dance(n_frames: int = 240) -> Figure:
    motion = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=n_frames)[0]
    figure = Figure.of_joints(motion.joints(), motion.skeleton, motion.grid)
    return replace(figure, rotations=motion.rotations)


def unpacked(payload: dict[str, Any]) -> np.ndarray:
    """Turns (T, J, 3) of a payload, radians."""
    planes = np.frombuffer(gzip.decompress(base64.b64decode(payload["data"])), np.uint8).reshape(2, -1)
    steps = (planes[0] | planes[1].astype(np.uint16) << 8).astype(np.uint16)
    columns = steps.reshape(len(payload["rest"]), -1).cumsum(axis=1, dtype=np.uint16).astype(np.int16)
    return (columns.T * payload["unit"]).reshape(columns.shape[1], -1, 3)


def kinematics(turns: np.ndarray, rest: np.ndarray, parents: tuple[int, ...], root: np.ndarray) -> np.ndarray:
    """Joints (T, J, 3) of turns, one joint after another."""
    joints, world = np.empty((*turns.shape[:2], 3)), []
    for joint, parent in enumerate(parents):
        local = Rotation.from_rotvec(turns[:, joint])
        world.append(local if parent < 0 else world[parent] * local)
        joints[:, joint] = root if parent < 0 else joints[:, parent] + world[parent].apply(rest[joint] - rest[parent])
    return joints


CHANGES: dict[str, Callable[[Figure], Figure]] = {
    "whole": lambda figure: figure, "part": lambda figure: figure.part(1.0, 2.0), "mirrored": Figure.mirrored,
    "resampled": lambda figure: figure.resampled(FrameGrid.of(30), 4.0),
    "without rotations": lambda figure: replace(figure, rotations=None),
}  # fmt: skip


@pytest.mark.parametrize("change", CHANGES)
def test_turns_give_the_joints(change: str) -> None:
    """Within 2 mm: steps of 0.01 degrees add up; the left and the right of SMPL differ by more."""
    figure = CHANGES[change](dance())
    payload = turns_payload(figure)
    assert payload is not None
    rest = np.array(payload["rest"]).reshape(-1, 3)
    joints = kinematics(unpacked(payload), rest, figure.skeleton.parents, figure.joints[:, 0])
    far = np.linalg.norm(joints - figure.joints, axis=-1)
    assert far.max() < (0.03 if change == "mirrored" else 0.002)


def test_turns_beyond_half_a_circle_and_opposite_bones() -> None:
    figure = dance(4)
    length = np.linalg.norm(figure.rotations, axis=-1, keepdims=True)
    spun = figure.rotations * (1 + 2 * np.pi / np.maximum(length, 1e-6))
    payload = turns_payload(replace(figure, rotations=spun))
    assert np.abs(unpacked(payload)).max() <= np.pi + 1e-3
    joints = kinematics(unpacked(payload), np.reshape(payload["rest"], (-1, 3)), SMPL24.parents, figure.joints[:, 0])
    np.testing.assert_allclose(joints, figure.joints, atol=0.002)
    down = -np.cumsum(np.tile(SMPL24.offsets, (3, 1, 1)), axis=1)
    assert np.isfinite(Figure.of_joints(down, SMPL24, FrameGrid.of(30)).turns).all()


def test_pages_have_turns_and_reports_have_none(scenes: Callable[[str], Scenes]) -> None:
    clips = scenes("thirty")
    scene = clips.scene(clips.items[0])
    assert "turns" not in scene_payload(scene)["figure"]
    assert set(scene_payload(scene, turns=True)["figure"]["turns"]) == {"rest", "ahead", "unit", "data"}


@pytest.fixture(scope="module")
def page(scenes: Callable[[str], Scenes], tmp_path_factory: pytest.TempPathFactory) -> str:
    clips = scenes("thirty")
    path = tmp_path_factory.mktemp("skin") / "page.html"
    path.write_text(clip_page(clips, clips.items[:1]), encoding="utf-8")
    return path.as_uri()


def test_the_mesh_is_closed_and_moves_with_its_joints(webgl_browser: Browser, page: str) -> None:
    webgl_browser.open(f"{page}#t=1&body=2")
    webgl_browser.wait(f"return {V}.state.clip.figure.turning")
    names = ["at", "normal", "bones", "weights", "tint", "faces"]
    at, normal, bones, weights, tint, faces = (
        np.array(part)
        for part in webgl_browser.js(f"const m = {V}.skin(); return {names}.map(k => Array.from(m[k]))")
    )
    at, normal, bones, weights = (
        at.reshape(-1, 3), normal.reshape(-1, 3), bones.reshape(-1, 4), weights.reshape(-1, 4),
    )  # fmt: skip
    faces, tint = faces.reshape(-1, 3), tint.reshape(-1, 4)
    assert 4_000 < len(at) < 20_000
    edges = Counter(tuple(edge) for face in faces for edge in np.stack([face, np.roll(face, -1)]).T.tolist())
    assert set(edges.values()) == {1}  # every edge once in each direction: closed, and of one orientation
    assert all((b, a) in edges for a, b in edges)
    volume = np.einsum("fa,fa->f", at[faces[:, 0]], np.cross(at[faces[:, 1]], at[faces[:, 2]])).sum() / 6
    assert 0.05 < volume < 0.12  # cubic metres of a person; negative inside out
    assert (np.abs(weights.sum(axis=1) - 255) <= 2).all()
    assert bones.max() < 24
    left, right = at[tint[:, 0] > 200, 0], at[tint[:, 1] > 200, 0]
    assert left.min() > -0.01
    assert right.max() < 0.01
    soles = at[:, 1] < at[:, 1].min() + 0.004
    assert soles.sum() > 30  # flat
    assert webgl_browser.log() == []


@pytest.mark.parametrize("swap", [False, True])
def test_matrices_are_those_of_numpy(webgl_browser, page, scenes, swap):
    clips = scenes("thirty")
    figure = clips.scene(clips.items[0]).figure
    webgl_browser.open(f"{page}#t=1.31&body=2")
    webgl_browser.wait(f"return {V}.state.clip.figure.turning")
    webgl_browser.later(DRAWN)
    rows = np.reshape(webgl_browser.js(f"return {V}.placingNow({str(swap).lower()})"), (-1, 3, 4))
    first, share = divmod(webgl_browser.js(f"return {V}.state.t") * 30, 1)
    order = np.arange(24)
    for a, b in SMPL24.pairs:
        order[a], order[b] = b, a
    around = np.stack([Rotation.from_rotvec(np.array(figure.turns[int(first) + k])).as_quat() for k in (0, 1)])
    around[1] *= np.sign((around[0] * around[1]).sum(axis=-1))[:, None]
    turns = Rotation.from_quat(around[0] * (1 - share) + around[1] * share).as_rotvec()
    turns = turns[order] * (1, -1, -1) if swap else turns
    world: list[Rotation] = []
    for joint, parent in enumerate(SMPL24.parents):
        local = Rotation.from_rotvec(turns[joint])
        world.append(local if parent < 0 else world[parent] * local)
    np.testing.assert_allclose(rows[..., :3], [w.as_matrix() for w in world], atol=2e-3)
    places = figure.joints[int(first)] * (1 - share) + figure.joints[int(first) + 1] * share
    if swap:
        places = places[order] * (-1, 1, 1) + (2 * figure.joints[0, 0, 0], 0, 0)  # about the root at the start
    found = rows[..., 3] + np.einsum("jab,jb->ja", rows[..., :3], figure.rest)
    np.testing.assert_allclose(found, places, atol=2e-3)


def test_without_webgl_limbs_are_drawn(browser: Browser, page: str) -> None:
    pictures = []
    for asked in ("&body=1", "&body=2"):
        browser.open(f"{page}#t=1{asked}")
        browser.wait("return document.querySelector('[data-dd=body]').textContent === 'Limbs'")
        pictures.append(stage(browser))
    np.testing.assert_array_equal(*pictures)


def test_a_lost_context_gives_limbs(webgl_browser: Browser, page: str) -> None:
    webgl_browser.open(f"{page}#t=1&body=1")
    limbs = stage(webgl_browser)
    webgl_browser.open(f"{page}#t=1&body=2")
    webgl_browser.wait(f"return {V}.state.clip.figure.turning")
    assert (stage(webgl_browser) != limbs).any()
    webgl_browser.js(f"{V}.skinPicture.getContext('webgl2').getExtension('WEBGL_lose_context').loseContext()")
    webgl_browser.wait("return document.querySelector('[data-dd=body]').textContent === 'Limbs'")
    np.testing.assert_array_equal(stage(webgl_browser), limbs)
