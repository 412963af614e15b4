"""check --published: a copy of a dataset against its published rows."""

from pathlib import Path

from dancedata.core.errors import SourceError, UsageError
from dancedata.evaluation.self_test import self_test
from tests.commands import as_json
from tests.messages import raises_message


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
