"""dancedata evaluate: one command gives the whole table."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import SourceError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import FEATURES
from dancedata.core.skeleton import SMPL24
from dancedata.evaluation.self_test import self_test
from dancedata.store import Store
from tests import commands
from tests.commands import as_json
from tests.messages import raises_message


def run(*arguments: object, code: int = 0) -> str:
    return commands.run("evaluate", *arguments, code=code).output


def scores_of(*arguments: object) -> Any:
    """Return the only report of the command's document."""
    (report,) = as_json("evaluate", *arguments)["reports"]
    return report


@pytest.fixture(scope="module")
def walk(store: Store, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Random walks as generated columns, and the songs of the dataset's test clips for them."""
    folder = tmp_path_factory.mktemp("walk") / "generated"
    folder.mkdir()
    songs = sorted({c.music for c in store})
    with open(folder.parent / "songs.csv", "w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["clip", "song"])
        for k in range(6):
            rng = np.random.default_rng(k)
            rotations = rng.normal(0, 0.02, (200, 24, 3)).cumsum(axis=0)
            root = rng.normal(0, 0.01, (200, 3)).cumsum(axis=0) + np.array([0, 1, 0])
            columns = dancedata.encode(Motion(root, rotations, FrameGrid.of(30), SMPL24), "edge151")
            np.save(folder / f"walk{k}.npy", columns)
            rows.writerow([f"walk{k}", f"{songs[k % len(songs)]}.wav"])
    return folder


def test_a_random_walk_gives_a_full_table(walk: Path, store: Store, tmp_path: Path) -> None:
    rows = tmp_path / "rows.csv"
    text = run(
        walk, "--like", store.path, "--music", walk.parent / "songs.csv", "--out", rows, "--jobs", 1,
        "--quiet", "--not-normalized",
    )  # fmt: skip
    assert text.startswith("generated: 6 samples: 6 by song, from its second 0\n")
    assert f"\ndancedata, version 2: {walk} as generated\n  6 samples of 4 clips, 6 pieces, 30 frames" in text
    for score in ("FID_k", "Div_k", "FID_g", "Div_g", "BAS", "PFC", "FSR"):
        (line,) = (
            line
            for line in text.splitlines()
            if line.startswith(f"  {score} ") and "left" not in line and "right" not in line
        )
        assert ("4 clips; needs 20" in line) == (score[:3] in ("FID", "Div")), line
    assert "without a meaning" in text
    with open(rows, encoding="utf-8", newline="") as file:
        table = list(csv.DictReader(file))
    assert [row["clip"] for row in table] == [f"walk{k}" for k in range(6)]
    assert {"bas", "bas_chance", "pfc", "skating_left"} <= table[0].keys()


def test_music_files_agree_with_the_store(store: Store, folder: Path) -> None:
    stored = scores_of(store.path, "--jobs", 1)
    wavs = folder / "small-source" / "wavs"
    assert wavs.is_dir(), sorted(p.name for p in (folder / "small-source").iterdir())
    computed = scores_of(store.path, "--jobs", 1, "--music", wavs)
    assert computed["scores"]["bas"]["value"] == stored["scores"]["bas"]["value"]
    root = scores_of(store.path, "--jobs", 1, "--music", wavs.parent)
    assert root["scores"]["bas"]["value"] == stored["scores"]["bas"]["value"]
    refused = run(store.path, "--jobs", 1, "--music", store.path, code=2)
    assert "no music in the folder; allowed: files .wav" in refused
    assert "here or in music/, wavs/" in refused


def test_beats_of_windows_are_computed_each_by_itself(store: Store, folder: Path) -> None:
    without = scores_of(store.path, "--protocol", "dgsdp", "--split", "test", "--jobs", 1)
    assert any("no beats of music" in warning for warning in without["warnings"])
    assert without["scores"]["pfc"]["n"]["vectors"] > 0
    wavs = folder / "small-source" / "wavs"
    found = scores_of(store.path, "--protocol", "dgsdp", "--split", "test", "--music", wavs, "--jobs", 1)
    assert found["scores"]["bas"]["n"]["vectors"] == found["pieces"]


def test_a_missing_feature(store: Store, folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(FEATURES, "names", lambda: ("librosa35",))
    wavs = folder / "small-source" / "wavs"
    np.save(tmp_path / "a.npy", np.random.default_rng(0).normal(size=(200, 24, 3)))
    text = run(
        tmp_path, "--protocol", "bailando-aistpp", "--fps", 60, "--up", "y", "--music", wavs, "--quiet", code=2
    )
    assert "from the audio feature bailando438, which is not installed" in text


# check --published: a copy of a dataset against its published rows.


def test_every_published_row_of_aistpp(folder: Path) -> None:
    found = self_test(folder / "small-source", intervals=False)
    assert found.dataset == "aist++"
    assert {row["protocol"] for row in found.rows()} == {"bailando-aistpp", "motius-aistpp", "edge-aistpp"}
    rows = {(row["protocol"], row["score"]): row for row in found.rows()}
    fid = rows["bailando-aistpp", "fid_k"]
    assert fid["published"] == 17.10
    assert fid["measured"] is not None
    assert fid["difference"] == fid["measured"] - 17.10
    assert fid["clips"] == 4  # of val and test
    assert fid["pool"] >= 8  # of all splits, and of none
    assert rows["edge-aistpp", "pfc"]["pool"] is None
    assert rows["edge-aistpp", "bas"]["measured"] is None  # its code was not released
    assert {row.source: of["pfc"].published for of, row in found.reports if of.protocol.name == "edge-aistpp"} == {
        "EDGE, table 1": 1.332
    }
    text = str(found)
    assert "published in EDGE, table 1: only PFC has code" in text
    assert "clips of val and test, 60 frames per second" in text


def test_one_protocol_and_json(folder: Path) -> None:
    found = self_test(folder / "small-source", protocol="edge-aistpp").to_json()
    assert {row["protocol"] for row in found["rows"]} == {"edge-aistpp"}
    assert found["reports"][0]["fps"] == "30"
    assert any("every 2. frame" in note for note in found["reports"][0]["notes"])
    assert as_json("check", folder / "small-source", "--published", "-j", 1)["dataset"] == "aist++"


def test_nothing_published(tmp_path: Path, folder: Path) -> None:
    with raises_message(UsageError, "under", where="small-source"):
        self_test(folder / "small-source", protocol="lodge-finedance")
    with raises_message(SourceError, r"VIDEO_SEGMENT_START_END\.pkl"):
        self_test(tmp_path)
