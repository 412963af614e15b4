"""Poses of splits, duplicates, Frechet distances, outliers, offsets of songs: planted cases and plain numpy."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from dancedata.core.bodies import BODY_JOINTS
from dancedata.core.grid import FrameGrid
from dancedata.core.skeleton import SMPL24
from dancedata.pages import write_report
from dancedata.pages.document import Document
from dancedata.pages.findings import findings
from dancedata.pages.measure import ClipNumbers, SongOffsets, physics
from dancedata.pages.outliers import outliers, robust_z
from dancedata.scene.pieces import ClipReader, Piece
from dancedata.scene.pose_space import Space, components, duplicates, frechet_levels, frontal
from dancedata.store import open_store


@pytest.fixture(scope="module")
def poses(demo: Path) -> dict[str, dict[str, np.ndarray]]:
    """All poses (T, 22, 3) of each clip, by split; the report samples every frame of so small a dataset."""
    found: dict[str, dict[str, np.ndarray]] = {}
    with open_store(demo) as store:
        reader = ClipReader.of(store)
        for clip in store:
            piece = reader.piece(clip)
            assert piece is not None
            joints = frontal(piece.figure.joints, piece.figure.skeleton.joints)[:, :22]
            found.setdefault(clip.split, {})[clip.id] = joints
    return found


# The map


def test_components_are_those_of_a_singular_value_decomposition() -> None:
    rng = np.random.default_rng(1)
    rows = (
        rng.normal(size=(300, 9))
        * np.array([5, 3, 1, 0.5, 0.4, 0.3, 0.2, 0.1, 0.1])
        @ np.linalg.qr(rng.normal(size=(9, 9)))[0]
    )
    places, shares = components(rows)
    _, values, axes = np.linalg.svd(rows - rows.mean(axis=0), full_matrices=False)
    expected = (rows - rows.mean(axis=0)) @ axes[:5].T
    for k in range(5):
        assert min(np.abs(places[:, k] - s * expected[:, k]).max() for s in (-1, 1)) <= 0.0006
        axis = axes[k] * np.sign(places[:, k] @ expected[:, k])
        assert axis[np.abs(axis).argmax()] > 0
    np.testing.assert_allclose(shares, (values**2 / (values**2).sum())[:5], atol=6e-4)
    assert components(rows[:1])[1] == ()


def test_the_map_holds_every_pose_in_its_nearest_hexagon(numbers: Document, poses: Any) -> None:
    found = numbers.poses
    assert found.joints == BODY_JOINTS
    assert found.n == {split: sum(map(len, of.values())) for split, of in poses.items()}
    assert {s: sum(h.counts[s] for h in found.hexagons) for s in found.n} == found.n
    centres = np.array([(h.x, h.y) for h in found.hexagons])
    gaps = np.hypot(*(centres[:, None] - centres[None]).transpose(2, 0, 1))
    assert gaps[gaps > 0].min() == pytest.approx(np.sqrt(3) * found.radius, rel=0.02)
    every = np.concatenate([pose.reshape(len(pose), -1) for of in poses.values() for pose in of.values()])
    places = components(every)[0][:, :2]
    nearest = np.hypot(*(places[:, None] - centres[None]).transpose(2, 0, 1)).min(axis=1)
    assert nearest.max() <= found.radius * 1.02
    hexagon = max(found.hexagons, key=lambda h: sum(h.counts.values()))
    (split,) = (s for s in poses if hexagon.clip in poses[s])
    pose = poses[split][hexagon.clip][round(hexagon.seconds * 30)]
    np.testing.assert_allclose(np.array(hexagon.pose) / 1000, pose[:, :2], atol=6e-4)


def test_the_map_shows_poses_and_leads_to_their_moments(demo_page: Path) -> None:
    figure = re.findall(r'<figure id="r-poses"(.*?)</figure>', demo_page.read_text(), re.S)[0]
    n = figure.count('class="cell"') + 1
    assert figure.count('class="cell most"') == 1  # whose pose is there before a pointer is
    assert n == figure.count('class="hex s0"') == figure.count("<title>")
    assert figure.count('class="pose bone mid"') == n
    links = re.findall(r'href="#clip=[^"&]+&amp;t=([\d.]+)"', figure)
    assert len(links) == n
    assert 0 <= min(map(float, links)) <= max(map(float, links)) <= 6


def test_a_dataset_without_train_has_a_map(demo: Path, relabelled: Callable[..., Path], tmp_path: Path) -> None:
    path = relabelled(lambda k: {"split": "all"})
    found = write_report(path, tmp_path / "page.html", clips="none").numbers.poses
    assert (found.to_train, found.chance, found.n_duplicates) == ({}, None, 0)
    figure = re.findall(r'<figure id="r-poses"(.*?)</figure>', (tmp_path / "page.html").read_text(), re.S)[0]
    assert "more poses of all" in figure
    assert 'class="ring' not in figure
    assert 'fill-opacity="1.00"' in figure


# Distances


def brute(poses: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return the rms distance over joints of each of poses (N, J, 3) to the nearest of others."""
    return np.array([np.sqrt(((others - pose) ** 2).sum(axis=2).mean(axis=1)).min() for pose in poses])


def test_distances_to_train_are_those_of_a_loop(numbers: Document, poses: Any) -> None:
    train = np.concatenate(list(poses["train"].values()))
    for split in ("val", "test"):
        of_split = np.concatenate(list(poses[split].values()))
        expected = np.quantile(brute(of_split, train), (0.5, 0.95))
        found = numbers.poses.to_train[split]
        assert found.n == len(of_split)
        np.testing.assert_allclose((found.p50, found.p95), expected, atol=1.5e-4)
    clips = list(poses["train"])
    half = [clips[k] for k in np.random.default_rng(0).permutation(len(clips))[: len(clips) // 2]]
    one = np.concatenate([poses["train"][clip] for clip in half])
    two = np.concatenate([poses["train"][clip] for clip in clips if clip not in half])
    assert numbers.poses.chance is not None
    np.testing.assert_allclose(numbers.poses.chance.p50, np.median(brute(one, two)), atol=1.5e-4)


# Splits


def test_a_clip_of_train_in_test_is_found(demo: Path, numbers: Document, relabelled: Callable[..., Path]) -> None:
    """One clip of test is a clip of train with 3 mm of noise on the root: every window has its partner."""
    with open_store(demo) as store:
        rows = [np.array(clip.read("edge151")) for clip in store]
        splits = [clip.split for clip in store]
        ids, starts = [clip.id for clip in store], [len(store[clip.id].windows()) for clip in store]
    copied, to = splits.index("train"), splits.index("test")
    turned = rows[copied].copy()
    turned[:, 4:7] += np.float32([2.0, 0.0, -1.0])  # at another place of the floor
    made = relabelled(lambda k: {"motion": {"edge151": turned if k == to else rows[k]}})
    found = write_report(made).numbers
    assert found.poses.windows == {
        s: sum(n for n, of in zip(starts, splits, strict=True) if of == s) for s in set(splits)
    }
    pairs = [pair for pair in found.poses.duplicates if pair.seconds[0] == pair.seconds[1]]
    assert [pair.clips for pair in pairs] == [(ids[copied], ids[to])] * starts[copied]
    assert {pair.splits for pair in pairs} == {("train", "test")}
    assert max(pair.distance_m for pair in pairs) < 1e-3
    (sentence,) = (f for f in findings(found) if f.figure == "duplicates")
    assert sentence.kind == "look"
    assert "windows in two splits nearer than 2 cm" in sentence.text
    assert numbers.poses.n_duplicates == 0


def test_windows_are_one_below_two_centimetres() -> None:
    base = np.random.default_rng(0).normal(size=(10, 22, 3))
    moved = {clip: base.copy() for clip in ("near", "far", "once")}
    moved["near"][:, :, 1] += 0.0199
    moved["far"][:, :, 1] += 0.0201
    moved["once"][0, 0, 0] += 0.29  # one joint at one moment: an rms of 0.29 / sqrt(220), 1.96 cm
    space = Space(FrameGrid.of(30), 1, 1, joints=BODY_JOINTS)
    for clip, split, window in [("a", "train", base), *((clip, "test", w) for clip, w in moved.items())]:
        space.windows.append(window.reshape(-1).astype(np.float32))
        space.window_of.append((clip, split, 0.5))
    n, pairs = duplicates(space)
    assert n == 2
    assert [(pair.clips, pair.distance_m) for pair in pairs] == [(("a", "once"), 0.0196), (("a", "near"), 0.0199)]


def test_frechet_distances_have_their_chance() -> None:
    rng = np.random.default_rng(5)
    train, same = rng.normal(size=(60, 4)), rng.normal(size=(20, 4))
    levels = frechet_levels(same, train)
    assert levels.chance_min <= levels.chance_p50 <= levels.chance_max
    assert levels.value < 2 * levels.chance_max
    assert frechet_levels(same + 3, train).value > 5 * levels.chance_max

    def plain(a: np.ndarray, b: np.ndarray) -> float:
        c, d = np.cov(a.T), np.cov(b.T)
        root = np.sqrt(np.linalg.eigvals(c @ d).real.clip(0)).sum()
        return float(((a.mean(axis=0) - b.mean(axis=0)) ** 2).sum() + np.trace(c) + np.trace(d) - 2 * root)

    scale = train.std(axis=0)
    assert levels.value == pytest.approx(plain(same / scale, train / scale), abs=1e-3)
    draws = np.random.default_rng(0)
    orders = [draws.permutation(60) for _ in range(20)]
    chance = [plain(train[o[:20]] / scale, train[o[20:]] / scale) for o in orders]
    np.testing.assert_allclose(
        (levels.chance_min, levels.chance_p50, levels.chance_max), np.quantile(chance, (0, 0.5, 1)), atol=1e-3
    )


# Outliers


def test_robust_z() -> None:
    values = np.random.default_rng(2).normal(size=101)
    mad = np.median(np.abs(values - np.median(values)))
    np.testing.assert_allclose(robust_z(values.tolist()), 0.6745 * (values - np.median(values)) / mad)
    assert robust_z([1.0] * 9) == [0.0] * 9
    assert robust_z([1.0] * 9 + [2.0])[-1] == pytest.approx(1 / (0.1 * 1.2533))


def test_physics_of_planted_faults() -> None:
    times = np.arange(120) / 30
    joints = np.repeat(SMPL24.offsets.cumsum(axis=0)[None], 120, axis=0)
    joints[:, :, 0] += times[:, None] ** 3
    drift, jerk, spread = physics(joints, 30.0, SMPL24)
    assert (drift, spread) == (pytest.approx(0), pytest.approx(0, abs=1e-12))
    assert jerk == pytest.approx(6.0)
    sinking = joints.copy()
    sinking[60:, :, 1] -= 0.12
    assert physics(sinking, 30.0, SMPL24)[0] == pytest.approx(0.12)
    longer = joints.copy()
    longer[:, 20] += np.linspace(0, 0.1, 120)[:, None] * np.array([1, 0, 0])
    lengths = np.linalg.norm(longer[:, 20] - longer[:, SMPL24.parents[20]], axis=1)
    others = np.linalg.norm(longer[:, 22] - longer[:, 20], axis=1)
    expected = max(np.ptp(np.quantile(values, (0.01, 0.99))) for values in (lengths, others))
    assert physics(longer, 30.0, SMPL24)[2] == pytest.approx(expected)
    assert physics(joints[:2], 30.0, SMPL24) == (0.0, 0.0, 0.0)


def test_outliers_have_their_reasons() -> None:
    rng = np.random.default_rng(4)
    clips = {f"c{k}": ClipNumbers(jerk=100 + rng.normal(), floor_drift_m=0.001 * rng.random()) for k in range(30)}
    clips["drifts"] = ClipNumbers(jerk=100.0, floor_drift_m=0.12)
    clips["shakes"] = ClipNumbers(jerk=900.0, floor_drift_m=0.3)
    clips["calm"] = ClipNumbers(jerk=1.0, floor_drift_m=0.0)
    clips["tiny"] = ClipNumbers(jerk=100.0, floor_drift_m=0.015)  # many deviations away, but below 2 cm
    found = {outlier.clip: outlier.reasons for outlier in outliers(clips)}
    assert list(found) == ["shakes", "drifts"]
    assert {reason.measure for reason in found["shakes"]} == {"jerk", "floor_drift_m"}
    (drift,) = found["drifts"]
    values = [clip.floor_drift_m for clip in clips.values()]
    assert drift.median == np.median(values)
    assert drift.z == pytest.approx(robust_z(values)[list(clips).index("drifts")], abs=0.01)
    assert outliers({}) == outliers({"a": ClipNumbers()}) == ()


# Songs


def test_a_song_that_is_late_is_found(numbers: Document) -> None:
    rng = np.random.default_rng(0)
    piece = cast("Piece", SimpleNamespace(beat_times=np.arange(20) * 0.5))
    late, loose = SongOffsets(), SongOffsets()
    late.add(0.08 + 0.01 * rng.normal(size=40), piece)
    loose.add(rng.uniform(-0.25, 0.25, 200), piece)
    assert late.shift_ms == pytest.approx(80, abs=5)
    assert late.strength > 0.9
    assert loose.strength < 0.3
    late.add(np.zeros(0), piece)
    assert late.clips == 1
    across = SongOffsets()
    across.add(np.array([0.24, -0.24]), piece)  # both nearly half a beat away
    assert abs(across.shift_ms or 0) == pytest.approx(250, abs=1)
    song = replace(numbers.music.songs[0], shift_ms=80.0, strength=0.9, key_motions=40)
    shifted = replace(numbers, music=replace(numbers.music, songs=(song, *numbers.music.songs[1:])))
    (sentence,) = (f for f in findings(shifted) if f.figure == "song_offsets")
    assert sentence.text == f"1 song with dance late or early by more than 60 ms: {song.song} +80 ms"
    assert not [f for f in findings(numbers) if f.figure == "song_offsets"]


def test_offsets_of_songs_are_those_of_all(numbers: Document) -> None:
    songs = numbers.music.songs
    assert np.sum([song.counts for song in songs], axis=0).tolist() == numbers.music.offset_ms.counts["all"]
    assert sum(song.key_motions for song in songs) == numbers.music.key_motions


def test_alignment_of_clips_is_listed_the_worst_first(demo_page: Path, numbers: Document) -> None:
    figure = re.findall(r'<figure id="r-bas_clips"(.*?)</figure>', demo_page.read_text(), re.S)[0]
    listed = [re.sub("<[^>]*>", "", cell) for cell in re.findall(r'<th scope="row">(.*?)</th>', figure)]
    gains = {row.clip: row.numbers.bas - row.numbers.bas_chance for row in numbers.clips}  # type: ignore[operator]
    assert listed == sorted(gains, key=lambda clip: (gains[clip], clip))
