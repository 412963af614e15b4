"""Groups in a report: their numbers equal those of the metrics, and each is listed whole."""

import itertools
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.metrics import collisions, contact_spans, facing_angles, intersection_frequency, root_distances
from dancedata.pages import Report, write_report
from dancedata.pages.findings import findings
from dancedata.store import StoredClip, open_store
from dancedata.store.schema import StoreHeader
from dancedata.store.writer import write_store
from tests.scene.conftest import crowd, crowd_source, duets, lacking  # noqa: F401 (the groups of the viewer's tests)
from tests.scene.helpers import page_data

DUET, SEVEN = "Waltz_5_0", "plainid0123_04_829_1009"


@pytest.fixture(scope="module")
def report(duets: Path) -> Report:  # noqa: F811
    return write_report(duets)


@pytest.fixture(scope="module")
def joints(duets: Path) -> np.ndarray:  # noqa: F811
    """Of the duet, (2, T, 24, 3)."""
    with open_store(duets) as store:
        return np.stack([store[f"{DUET}_0{k}"].read("joints").reshape(-1, 24, 3) for k in (0, 1)]).astype(float)


@pytest.fixture
def moved(duets: Path, tmp_path: Path) -> Callable[[Callable[[int], Any]], Path]:  # noqa: F811
    """Write the duets with what a function of the member adds to the joints."""

    def make(shift: Callable[[int], Any], **attributes: Any) -> Path:
        with open_store(duets) as store:
            columns = (store.field("joints"),)
            clips = [
                StoredClip(
                    **vars(replace(clip.record, **attributes)), starts=(0,),
                    motion={"joints": (clip.read("joints").reshape(-1, 24, 3) + shift(clip.member)).reshape(-1, 72)},
                )
                for clip in store.clips()
            ]  # fmt: skip
            header = StoreHeader(store.grid.rate, 60, 15, columns, store.skeleton, meta={"name": "moved"})
            (tmp_path / "moved").mkdir()
            write_store(tmp_path / "moved", header, clips)
        return tmp_path / "moved"

    return make


def test_numbers_are_those_of_the_metrics(report: Report, joints: np.ndarray) -> None:
    row = next(row for row in report.document["groups"]["groups"] if row["group"] == DUET)
    apart = root_distances(joints)[0, 1]
    assert [row[f"distance_{q}_m"] for q in ("min", "p50", "max")] == pytest.approx(
        [apart.min(), np.median(apart), apart.max()]
    )
    meet = collisions(joints)[0, 1]
    assert row["collision_share"] == pytest.approx(meet.mean())
    assert row["intersections"] == pytest.approx(intersection_frequency(joints))
    spans = contact_spans(*joints)
    touched = np.zeros(len(meet), dtype=bool)
    for span in spans:
        touched[span.start : span.end] = True
    assert (row["contacts"], row["contact_share"]) == (len(spans), pytest.approx(touched.mean()))
    angles = facing_angles(joints)
    assert row["facing_share"] == pytest.approx(((angles[0, 1] <= 45) & (angles[1, 0] <= 45)).mean())
    assert row["nearest"] == row["colliding"] == [f"{DUET}_00", f"{DUET}_01"]
    assert (row["roles"], row["members"], row["n_source"]) == (["follower", "leader"], [0, 1], 2)


def test_groups_are_counted_by_size_and_hours(report: Report, crowd: Path) -> None:  # noqa: F811
    groups = report.document["groups"]
    assert groups["by_size"] == {"2": {"train": 1, "test": 2}}
    frames = [row["frames"] for row in groups["groups"]]
    assert groups["group_hours"] == pytest.approx(sum(frames) / 30 / 3600)
    assert groups["dancer_hours"] == pytest.approx(2 * groups["group_hours"])
    assert groups["distance_m"]["n"] == sum(frames)
    assert groups["facing_deg"]["n"] == 2 * sum(frames)
    assert report.document["totals"]["groups"] == 3
    of_crowd = write_report(crowd).document
    assert {size: sum(n.values()) for size, n in of_crowd["groups"]["by_size"].items()} == dict.fromkeys("2357", 1)
    assert {row["group"] for row in of_crowd["groups"]["groups"]} == {
        row["group"] for row in of_crowd["clips"]
    }  # without mirrored copies
    assert json.loads(json.dumps(of_crowd)) == of_crowd


def test_frames_before_trim_start_are_left_out(moved: Any, joints: np.ndarray) -> None:
    row = next(r for r in write_report(moved(lambda k: 0, trim_start=100)).numbers.groups.groups if r.group == DUET)
    assert row.distance_min_m == pytest.approx(root_distances(joints)[0, 1, 100:].min(), abs=1e-6)
    assert row.collision_share == pytest.approx(collisions(joints)[0, 1, 100:].mean())


def test_collisions_are_found(report: Report) -> None:
    texts = {f.text: f for f in findings(report.numbers) if f.figure == "groups_list"}
    ((text, finding),) = texts.items()
    assert text.startswith(f"bodies intersect in 2 of 3 groups: {DUET} in 59 % of its frames")
    assert finding.kind == "look"


def test_impossible_distances_are_found(moved: Any) -> None:
    far = findings(write_report(moved(lambda k: np.array([40.0 * k, 0, 0]))).numbers)
    assert any(f.text.startswith("dancers are more than 30 m apart in 3 groups: ") for f in far)


def test_one_dancer_tracked_twice_is_found(duets: Path, moved: Any) -> None:  # noqa: F811
    with open_store(duets) as store:
        follower, leader = (store[f"{DUET}_0{k}"].read("joints")[0, :3] for k in (0, 1))
    near = findings(write_report(moved(lambda k: k * (follower - leader))).numbers)
    assert any(f.text.startswith("two dancers are in one place, less than 10 cm apart, in ") for f in near)


def test_missing_dancers_are_a_note(lacking: Path, tmp_path: Path) -> None:  # noqa: F811
    found = write_report(lacking, tmp_path / "page.html")
    assert f"1 group without all dancers: {SEVEN} (5 of 7)" in [f.text for f in findings(found.numbers)]
    assert " and 2 left out" in (tmp_path / "page.html").read_text()


def test_the_page_plays_groups_and_lists_them_whole(crowd: Path, tmp_path: Path) -> None:  # noqa: F811
    write_report(crowd, tmp_path / "page.html", clips="all")
    page = (tmp_path / "page.html").read_text()
    assert page.count(f'href="#group={SEVEN}"') == 1
    for k in range(7):
        assert f'href="#clip={SEVEN}_p{k}">{k}</a>' in page
    data = page_data(page)
    assert len(data["list"]["items"]) == len(data["clips"]) == 4
    assert len({row[0] for row in data["list"]["clips"]}) == 4
    assert sorted(len(clip["members"]) for clip in data["clips"].values())[-1] == 7
    assert "▶ 4 groups" in page


def test_a_dataset_of_groups_is_compared_with_one_of_dancers(duets: Path, demo: Path, tmp_path: Path) -> None:  # noqa: F811
    for number, pair in enumerate(itertools.permutations((duets, demo))):
        write_report(pair[0], tmp_path / f"{number}.html", against=pair[1], clips="none")
        page = (tmp_path / f"{number}.html").read_text()
        assert ("Groups by size" in page) == (pair[0] == duets)
    write_report(duets, tmp_path / "again.html", against=demo, clips="none")
    assert (tmp_path / "again.html").read_bytes() == (tmp_path / "0.html").read_bytes()
