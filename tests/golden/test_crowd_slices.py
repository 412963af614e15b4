"""Windows as TCDiff's and POPDG's loaders have them, POPDG's PBC; LDA's styles and lists, STREAM's ramps."""

import io
import json
from collections.abc import Sequence
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

from dancedata.contacts.velocity import Velocity
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.motion import Motion
from dancedata.core.segments import Segment
from dancedata.datasets.aioz_gdance import load_dancers, read_sizes
from dancedata.datasets.motorica.labels import joined, read_labels
from dancedata.datasets.motorica.reader import GENRES, IN_BOTH, TEST, TRAIN_COUNT, parse_name
from dancedata.datasets.popdanceset import PopDanceSet
from dancedata.exports._slices import quantised_wav
from dancedata.metrics import pbc, pfc
from dancedata.representations.edge151 import Edge151
from dancedata.store.normalize import Scaler
from tests.golden.conftest import load

LENGTH, STRIDE, ENDS = 150, 15, [0, 1, 148, 149]
#: Joints of POPDG's nine contacts.
POPDG_CONTACTS = [7, 8, 10, 11, 15, 20, 21, 22, 23]


def facts_of(crowd: Path, name: str) -> Any:
    return json.loads((crowd / name / "facts.json").read_text())


def edge151(motion: Motion) -> np.ndarray:
    return Edge151().encode(motion, Velocity(max_speed_m_s=0.3))


# ---- TCDiff: contacts first, +Z up, all dancers of a window together


@pytest.fixture(scope="module")
def trios(crowd: Path) -> dict[str, np.ndarray]:
    """Windows (3, 150, 151) of the groups of three, by TCDiff's names."""
    windows = {}
    for name in chain(*facts_of(crowd, "tcdiff")["names"].values()):
        group, number = name.rsplit("_slice", 1)
        path = crowd / "inputs" / "aioz_gdance" / "motions_smpl" / f"{group}.pkl"
        first = STRIDE * int(number)
        motions = load_dancers(path, range(read_sizes(path).dancers))
        windows[name] = np.stack([edge151(motion.part(first, first + LENGTH)) for motion in motions])
    return windows


def near_to_call(facts: Any) -> set[tuple[Any, ...]]:
    return {tuple(place) for place in facts["contacts_too_near_to_call"]}


def test_windows_of_groups_are_tcdiffs(crowd: Path, trios: dict[str, np.ndarray]) -> None:
    facts, golden = facts_of(crowd, "tcdiff"), load(crowd / "tcdiff" / "windows.npz")
    for part, names in facts["names"].items():
        found = [trios[name] for name in names]
        assert all(list(window.shape) == facts["item_shape"] for window in found)
        for k, (name, window) in enumerate(zip(names, found, strict=True)):
            wanted = golden[f"{part}{k}.raw_first_last"]
            np.testing.assert_allclose(window[:, ENDS, 4:], wanted[..., 4:], rtol=0, atol=1e-5)
            if f"{part}{k}.raw_dancer1" in golden:
                one = golden[f"{part}{k}.raw_dancer1"]
                np.testing.assert_allclose(window[1, :, 4:], one[:, 4:], rtol=0, atol=1e-5)
            differs = np.argwhere(window[..., :4] != golden[f"{part}{k}.contacts"])
            assert {(name, *map(int, place)) for place in differs} <= near_to_call(facts)
        near = sum(place[0] in names for place in near_to_call(facts))
        rate = np.mean([window[..., :4] for window in found])
        assert abs(rate - facts["contact_rate"][part]) * len(found) * LENGTH * 3 * 4 <= near + 0.01


def test_slices_are_tcdiffs(crowd: Path) -> None:
    """All groups, as long as motion and sound allow; TCDiff's test is the val list."""
    facts = facts_of(crowd, "tcdiff")
    source = crowd / "inputs" / "aioz_gdance"
    for of_part in facts["slices"].values():
        assert of_part["motion"] == of_part["wav"]
        for group in {name.rsplit("_slice", 1)[0] for name in of_part["motion"]}:
            frames = read_sizes(source / "motions_smpl" / f"{group}.pkl").frames
            sound = soundfile.info(source / "musics" / f"{group}.wav")
            rate = sound.samplerate
            cut = soundfile.info(io.BytesIO(quantised_wav(AudioSignal(np.zeros(5 * rate, np.float32), rate))))
            found = {"rate": cut.samplerate, "frames": cut.frames, "channels": cut.channels, "subtype": cut.subtype}
            assert found == facts["sliced_wav"]
            windows_of_sound = (sound.frames - 5 * rate) // (rate // 2)
            n = 1 + min((frames - LENGTH) // STRIDE, windows_of_sound)
            named = sorted(name for name in of_part["motion"] if name.startswith(f"{group}_slice"))
            assert named == [f"{group}_slice{k}" for k in range(n)]


def test_each_train_window_has_a_scaler_of_its_own_and_the_last_is_kept(crowd, trios):
    facts, golden = facts_of(crowd, "tcdiff"), load(crowd / "tcdiff" / "windows.npz")
    for k, name in enumerate(facts["names"]["train"]):
        rows = trios[name].reshape(-1, 151)
        scaler = Scaler("minmax", rows.min(axis=0), rows.max(axis=0))
        np.testing.assert_allclose(scaler.data_min[4:], golden["scale.train_window_min"][k, 4:], rtol=0, atol=1e-5)
        np.testing.assert_allclose(scaler.data_max[4:], golden["scale.train_window_max"][k, 4:], rtol=0, atol=1e-5)
        found = scaler.normalize(trios[name], clamp=True)[:, ENDS]
        assert_normalised(found, golden[f"train{k}.normalised_first_last"], scaler, slice(4, None))
    np.testing.assert_allclose(scaler.data_min, golden["scale.kept_min"], rtol=0, atol=1e-5)
    np.testing.assert_allclose(scaler.data_max, golden["scale.kept_max"], rtol=0, atol=1e-5)
    (name,) = facts["names"]["test"]
    found = scaler.normalize(trios[name], clamp=True)[:, ENDS]
    assert_normalised(found, golden["test0.normalised_first_last"], scaler, slice(4, None))
    outside = (trios[name] < scaler.data_min) | (trios[name] > scaler.data_max)
    assert outside.mean() == pytest.approx(facts["test_values_outside_the_kept_range"], abs=1e-3)


def assert_normalised(found: Any, wanted: Any, scaler: Scaler, columns: slice, error: float = 4e-5) -> None:
    """Within 1e-4 and the error of a position or rotation over the column's range."""
    limit = 1e-4 + error / np.maximum(scaler.data_range, 1e-3)
    assert (np.abs(found - wanted) < limit)[..., columns].all()


# ---- POPDG: contacts last, nine of them


@pytest.fixture(scope="module")
def slices(crowd: Path) -> dict[str, list[Motion]]:
    """Windows of PopDanceSet by part, in the loader's order."""
    source, reader = crowd / "inputs" / "popdanceset", PopDanceSet(scale="multiply")
    refs = {clip.id: clip for clip in reader.scan(source).clips}
    windows: dict[str, list[Motion]] = {}
    for part, names in facts_of(crowd, "popdg")["order"].items():
        windows[part] = []
        for name in names:
            clip, number = name.rsplit("_slice", 1)
            first = STRIDE * int(number)
            windows[part].append(reader.load(refs[clip]).part(first, first + LENGTH))
    return windows


def columns_of(motions: list[Motion]) -> np.ndarray:
    """POPDG's 156 columns (W, 150, 156): EDGE's without contacts, and nine contacts."""
    rows = []
    for motion in motions:
        places = motion.joints()[:, POPDG_CONTACTS]
        steps = np.linalg.norm(np.diff(places, axis=0, append=places[-1:]), axis=-1)
        rows.append(np.concatenate([edge151(motion)[:, 4:], steps < 0.01], axis=1))
    return np.stack(rows)


def test_popdgs_scaler_and_normalised_windows(crowd: Path, slices: dict[str, list[Motion]]) -> None:
    """It is fitted on all train windows; test is clipped."""
    facts, golden = facts_of(crowd, "popdg"), load(crowd / "popdg" / "windows.npz")
    columns = {part: columns_of(windows) for part, windows in slices.items()}
    rows = columns["train"].reshape(-1, 156)
    scaler = Scaler("minmax", rows.min(axis=0), rows.max(axis=0))
    np.testing.assert_allclose(scaler.data_min, golden["data_min"], rtol=0, atol=2e-5)
    np.testing.assert_allclose(scaler.data_max, golden["data_max"], rtol=0, atol=2e-5)
    np.testing.assert_allclose(columns["train"][..., :3], golden["train.position"], rtol=0, atol=1e-5)
    for part, windows in columns.items():
        assert list(windows.shape) == facts["shape"][part]
        np.testing.assert_allclose(
            windows[:, ENDS, :147], golden[f"{part}.raw_first_last"][..., :147], rtol=0, atol=1e-5
        )
        found = scaler.normalize(windows, clamp=True)[:, ENDS]
        assert_normalised(found, golden[f"{part}.normalised_first_last"], scaler, slice(147), 8e-5)
    contacts = np.concatenate([columns["train"]])[..., 147:].mean(axis=(0, 1))
    assert np.abs(contacts - facts["contact_rate_by_joint"]).max() * 4 * LENGTH <= len(near_to_call(facts)) + 0.01


def test_popdgs_clips_and_their_windows(crowd: Path) -> None:
    """Listed clips with both files; as many windows of five seconds as both allow."""
    facts, source = facts_of(crowd, "popdg"), crowd / "inputs" / "popdanceset"
    clips = {clip.id: clip.split for clip in PopDanceSet(scale="multiply").scan(source).clips}
    for part, names in facts["copied"].items():
        assert set(names) == {clip for clip, split in clips.items() if split == part}
        assert sorted(facts["slices"][part]["motion"]) == facts["order"][part]


@pytest.mark.parametrize("name", ["a", "b", "c"])
def test_pbc_and_pfc_are_popdgs(crowd: Path, name: str) -> None:
    joints = load(crowd / "popdg" / "pbc_joints.npz")[name]
    wanted = json.loads((crowd / "popdg" / "pbc.json").read_text())[name]
    assert pbc(joints, 30, variant="code", up="z") == pytest.approx(wanted["pbc"], rel=1e-4)
    assert pfc(joints, 30, variant="code", up="z") == pytest.approx(wanted["pfc"], rel=1e-4)


# ---- Motorica


@pytest.fixture(scope="module")
def facts(crowd: Path) -> Any:
    return json.loads((crowd / "motorica" / "facts.json").read_text())


def test_styles_and_lists(crowd: Path, facts: Any) -> None:
    golden, about, lists = load(crowd / "motorica" / "expmap61.npz"), facts["dataset"], facts["released_lists"]
    styles = sorted(f"g{code}" for code in GENRES)
    assert styles == about["styles"] == sorted(lists["train"]["styles"]) == sorted(lists["test"]["styles"])
    first = [GENRES[style[1:]] for style in styles].index(parse_name(about["list"][0][:-3]).genre)
    np.testing.assert_array_equal(golden["dataset.window_start0_style"], np.tile(np.eye(8)[first], (12, 1)))
    assert list(IN_BOTH) == lists["in_both"]
    assert (lists["train"]["recordings"], lists["train"]["lines"]) == (TRAIN_COUNT, 4 * TRAIN_COUNT)
    assert (lists["test"]["recordings"], lists["test"]["lines"]) == (len(TEST), 2 * len(TEST))
    assert lists["test"]["first"] == f"{TEST[0]}_00"
    for code, genre in GENRES.items():
        assert 2 * sum(parse_name(name).genre == genre for name in TEST) == lists["test"]["styles"][f"g{code}"]


# ---- STREAM's ramps, which are rounded to 3 decimals, of whole clips to 2


def ramps(segments: Sequence[tuple[int, int]], length: int) -> np.ndarray:
    """0 to 1 from the first to the last frame of each segment, of a single frame 0; the later segment wins."""
    out = np.zeros(length)
    for start, end in segments:
        out[start:end] = np.linspace(0, 1, end - start)
    return out


def frames(segment: Segment) -> tuple[int, int]:
    return int(segment.start * 30), int(segment.end * 30)


def test_ramps_of_chunks(crowd: Path) -> None:
    """Gaps are 0."""
    golden = load(crowd / "stream" / "labels.npz")
    folder = crowd / "inputs" / "motorica_pp" / "motorica" / "sliced_labels"
    chunks = [key.removesuffix(".label_index") for key in golden if key.endswith(".label_index")]
    assert len(chunks) == 5
    for chunk in chunks:
        found = ramps([frames(segment) for segment in joined({(0, False): folder / f"{chunk}_label.json"})], 150)
        np.testing.assert_allclose(found, golden[f"{chunk}.label_index"], rtol=0, atol=5.1e-4)


def test_ramps_of_whole_clips(crowd: Path) -> None:
    """Gaps are segments with a ramp of their own."""
    golden = load(crowd / "stream" / "labels.npz")
    ((_, segments),) = read_labels(crowd / "inputs" / "motorica_pp").of.items()
    held = [frames(segment) for segment in segments]
    gaps = [(before[1], after[0]) for before, after in pairwise(held) if before[1] < after[0]]
    assert gaps
    whole = ramps([*held, *gaps], held[-1][1])
    for k in range(5):
        found = whole[30 * k : 30 * k + 150]
        np.testing.assert_allclose(found, golden[f"window{k}.clip_ramp"], rtol=0, atol=5.1e-3)
