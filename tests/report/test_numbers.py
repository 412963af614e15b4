"""Numbers of a report equal those that numpy computes from the store."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.building import leaks
from dancedata.core.clip import Reject
from dancedata.core.dance import Dance
from dancedata.metrics.beats import BeatAlignment
from dancedata.pages import write_report
from dancedata.pages.document import Document
from dancedata.pages.findings import findings
from dancedata.store import open_store


@pytest.fixture(scope="module")
def joints(demo: Path) -> dict[str, np.ndarray]:
    with open_store(demo) as ds:
        return {c.id: dancedata.decode(c.read("edge151"), "edge151", fps=ds.fps).joints() for c in ds}


def test_windows_are_counted_by_split_and_name(demo: Path, document: Any) -> None:
    with open_store(demo) as ds:
        music = {c.id: c.music for c in ds}
        for split in ds.splits:
            windows = ds.windows(split)
            assert document["contents"]["windows_by_split"][split][split] == len(windows)
            for song, counts in document["contents"]["windows_by_song"].items():
                assert counts[split] == sum(music[w.clip] == song for w in windows)
        assert document["totals"]["windows"] == sum(len(ds.windows(s)) for s in ds.splits)


def test_speed_is_that_of_22_joints(document: Any, joints: dict[str, np.ndarray]) -> None:
    speeds = {c: np.linalg.norm(np.diff(j[:, :22], axis=0), axis=2) * 30 for c, j in joints.items()}
    speed = document["movement"]["speed_m_s"]
    of_frames = np.concatenate([s.mean(axis=1) for s in speeds.values()])
    assert speed["n"] == len(of_frames)
    assert speed["mean"] == pytest.approx(of_frames.mean())
    edges = np.array(speed["edges"])
    counts = np.histogram(np.minimum(of_frames, edges[-1]), edges)[0]
    np.testing.assert_array_equal(speed["counts"]["all"], counts)
    assert speed["p50"] == pytest.approx(np.quantile(of_frames, 0.5), abs=0.01)
    wrist = np.concatenate([s[:, 20] for s in speeds.values()])
    assert document["movement"]["joint_speed_m_s"]["left_wrist"]["p95"] == pytest.approx(
        np.quantile(wrist, 0.95), abs=0.01
    )
    for row in document["clips"]:
        assert row["speed"] == pytest.approx(speeds[row["clip"]].mean())


def test_the_beat_alignment_is_of_frames_from_trim_start_on(relabelled: Any, joints: dict[str, np.ndarray]) -> None:
    path = relabelled(lambda k: {"trim_start": 40})
    for row in write_report(path).document["clips"]:
        with open_store(path) as ds:
            clip = next(clip for clip in ds if clip.id == row["clip"])
            music = ds.field("librosa35")
            heard = dancedata.metrics.MusicBeats.of_rows(clip.read("librosa35"), music.columns, music.grid, late=1)
        cut = dancedata.metrics.MusicBeats(
            heard.frames[heard.frames >= 40] - 40, ds.grid, heard.seconds[heard.frames >= 40] - 40 / 30
        )
        dance = Dance(joints[clip.id][40:, :22], ds.grid, cut)
        assert row["bas"] == pytest.approx(BeatAlignment(joints=22).measure(dance)[0])


def test_floor_path_and_contacts(demo: Path, document: Any, joints: dict[str, np.ndarray]) -> None:
    with open_store(demo) as ds:
        labels = {c.id: c.read("edge151")[:, :4] > 0.5 for c in ds}
    for row in document["clips"]:
        j = joints[row["clip"]]
        assert row["feet_m"] == pytest.approx(np.quantile(j[:, [7, 8, 10, 11], 1], 0.02))
        toes = j[:, [10, 11], 1][labels[row["clip"]][:, 2:]]
        assert row["floor_m"] == pytest.approx(np.median(toes) - 0.025, abs=0.003)  # a body of 1.7 m or so
        assert row["root_extent_m"] == pytest.approx(np.ptp(j[:, 0][:, [0, 2]], axis=0).max())
        contact = labels[row["clip"]]
        speed = np.linalg.norm(np.diff(j[:, [7, 8, 10, 11]][..., [0, 2]], axis=0), axis=2) * 30
        standing = speed[contact[:-1] & contact[1:]]
        assert row["sliding"] == pytest.approx((standing > 0.15).mean())
    shares = np.concatenate(list(labels.values())).mean(axis=0)
    contacts = document["movement"]["contact"]
    assert list(contacts) == ["left_ankle", "right_ankle", "left_foot", "right_foot"]
    np.testing.assert_allclose(list(contacts.values()), shares)


def test_key_motions_lie_nearer_to_beats_than_chance(demo: Path, document: Any) -> None:
    music = document["music"]
    assert music["mean_distance_ms"] < 0.6 * music["mean_distance_shifted_ms"]
    assert sum(music["offset_ms"]["counts"]["all"]) == music["key_motions"] > 20
    edges = np.diff(music["offset_ms"]["edges"])
    assert edges.min() == pytest.approx(1000 / 30, abs=0.5)
    assert music["bas"] > 2 * music["bas_chance"]
    with open_store(demo) as ds:
        clip = ds.clips()[0]
        beats = np.flatnonzero(clip.read_song("librosa35")[:, -1])
    row = next(r for r in document["clips"] if r["clip"] == clip.id)
    assert row["tempo_found"] == pytest.approx(60 * 30 / np.median(np.diff(beats)))


def test_columns_are_those_of_stats_json(demo: Path, document: Any) -> None:
    with open_store(demo) as ds:
        stats = ds.stats["fields"]["edge151"]
        labels = ds.fields["edge151"].labels
    field = document["fields"]["edge151"]
    assert [row["label"] for row in field["columns"]] == list(labels)
    assert [row["mean"] for row in field["columns"]] == stats["mean"]
    constant = [label for label, a, b in zip(labels, stats["min"], stats["max"], strict=True) if b - a < 1e-6]
    assert field["constant"] == constant
    assert constant


def test_val_and_test_may_share_a_song_and_train_may_not(numbers: Document, relabelled: Any) -> None:
    assert numbers.splits.compared_by_sound
    assert numbers.splits.songs.counts["train"]["test"] == 0
    assert [f.kind for f in findings(numbers) if f.figure == "shared_songs"] == ["good", "note"]
    leaky = write_report(relabelled(lambda k: {"music": "one"})).numbers
    assert leaky.splits.songs.names["train and test"] == ("one",)
    kinds = [f.kind for f in findings(leaky) if f.figure == "shared_songs"]
    assert "bad" in kinds
    assert "good" not in kinds


def test_songs_not_compared_by_sound_are_reported(demo, tmp_path, monkeypatch):
    monkeypatch.setattr(leaks, "MAX_PAIRS", 1)
    write_report(demo, tmp_path / "page.html")
    assert "compared by name and samples, not by sound" in (tmp_path / "page.html").read_text()


def test_genres_that_differ_in_case_are_named(relabelled: Any) -> None:
    numbers = write_report(relabelled(lambda k: {"genre": ("Jazz", "jazz", "Hip hop")[k % 3]})).numbers
    assert numbers.contents.alike == (("Jazz", "jazz"),)
    assert any("Jazz and jazz" in f.text for f in findings(numbers))


def test_the_worst_clips_come_first_and_each_once(relabelled: Any) -> None:
    path = relabelled(
        lambda k: {"n_flags": {1: 5, 2: 9}.get(k, 0)}, rejects=[Reject("nan", clip="x", detail="NaN in frame 3")]
    )
    document = write_report(path).document
    with open_store(path) as ds:
        ids = [c.id for c in ds]
    flagged = [row["clip"] for row in document["ranking"] if row["why"] == "flags"]
    assert flagged == [ids[2], ids[1]]
    assert document["ranking"][0]["clip"] == ids[2]
    assert len({row["clip"] for row in document["ranking"]}) == len(document["ranking"])
    assert document["left_out"] == {"nan": {"n": 1, "names": ["x"], "detail": "NaN in frame 3"}}


def test_slices_that_overlap_are_measured_once(slices: Path) -> None:
    document = write_report(slices).document
    with open_store(slices) as ds:
        clips = {clip.id: clip for clip in ds}
    assert len({clip.slice_start for clip in clips.values()}) > 1
    measured = [row for row in document["clips"] if row["seconds"]]
    assert {row["clip"] for row in measured} == {clip.id for clip in clips.values() if clip.slice_start == 0}
    assert {(row["seconds"], row["music_s"]) for row in measured} == {(5.0, 5.0)}
    assert document["music"]["key_motions"] > 0
    assert document["totals"]["clips"] == document["totals"]["windows"] == len(clips)


def test_copies_are_counted_and_not_measured_again(tmp_path: Path, demo: Path) -> None:
    small = {"dataset.synthetic": {"songs": 4, "clips_per_song": 2, "clip_s": 6}, "audio": {}}
    out = tmp_path / "mirrored"
    dancedata.build(
        "demo", out=out, source=None, overrides={**small, "augment.mirror": True}, jobs=1,
        cache=demo.parent / "cache", progress=False,
    )  # fmt: skip
    document = write_report(out).document
    with open_store(out) as ds:
        copies = sum(bool(c.source) for c in ds)
        assert document["totals"]["copies"] == copies > 0
        assert document["totals"]["clips"] == len(ds) - copies == len(document["clips"])
        assert document["totals"]["windows"] == sum(len(ds.windows(s)) for s in ds.splits)
    assert document["music"]["beats_from"] is None
    assert document["music"]["bas"] is None
