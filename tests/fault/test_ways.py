"""Equal bytes for any number of jobs, parts and order of files. Clusters are in test_clusters."""

import json
from pathlib import Path

import pytest

from dancedata.building.part import Part
from dancedata.core.clip import ClipRef
from dancedata.datasets.aistpp import AistPP


def test_two_jobs_give_the_same_bytes(slow, corpus, out, undisturbed, hashes, songs):
    slow.build(corpus, out, "--jobs", 2)
    assert hashes(out) == undisturbed
    assert sorted(slow.calls()) == sorted(songs)
    assert slow.strays() == []


def test_parts_that_are_collected_give_the_same_bytes(slow, corpus, out, undisturbed, hashes, songs):
    clips = 0
    # In any order, and one of them twice.
    for part in ("2/2", "1/2", "2/2"):
        about = json.loads(slow.build(corpus, out, "--jobs", 1, "--part", part, "--json"))["result"]
        assert about["part"] == part
        clips += about["clips"] if part != "2/2" else about["clips"] / 2
        assert not out.exists()
    assert clips == about["clips_in_all"] == 8
    assert sorted(slow.calls()) == sorted(songs)
    slow.build(corpus, out, "--jobs", 1)
    assert hashes(out) == undisturbed
    assert sorted(slow.calls()) == sorted(songs), "the build that collects computes nothing"


def test_dancers_of_a_group_are_in_one_part() -> None:
    clips = [
        ClipRef(f"g{g}_p{m}", Path(f"g{g}.pkl"), None, "train", group=f"g{g}", member=m)
        for g in range(10)
        for m in range(1 + g % 4)
    ]
    parts = [{ref.group for ref in Part(k, 4).of(clips)} for k in range(1, 5)]
    assert sorted(group for part in parts for group in part) == [f"g{g}" for g in range(10)]


@pytest.mark.parametrize("count", [1, 3, 16])
def test_parts_share_the_clips_out(corpus: Path, count: int):
    clips = AistPP().scan(corpus).clips
    parts = [Part(k, count).of(clips) for k in range(1, count + 1)]
    assert sorted(ref.id for part in parts for ref in part) == sorted(ref.id for ref in clips)
    assert [Part(k, count).of(clips) for k in range(1, count + 1)] == parts
    sizes = [len(part) for part in parts]
    assert max(sizes) - min(sizes) <= 2
    for part in parts:
        paths = {ref.audio_path for ref in part}
        assert not paths & {ref.audio_path for other in parts if other is not part for ref in other}
