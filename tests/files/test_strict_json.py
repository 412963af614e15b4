"""JSON within bounds: every failure is a ValueError or an OSError."""

import json
from pathlib import Path

import pytest

from dancedata.files.strict_json import MAX_DEPTH, parse_json, read_json


def nested(depth: int) -> str:
    return '{"a": [' * (depth // 2) + "]}" * (depth // 2)


def test_documents_as_json_has_them() -> None:
    document = {"a": [1, {"b": None}], "c": "\ud800"}
    assert parse_json(json.dumps(document)) == document
    assert parse_json("3") == 3
    assert parse_json(nested(MAX_DEPTH)) == json.loads(nested(MAX_DEPTH))


@pytest.mark.parametrize("depth", [MAX_DEPTH + 2, 900, 200_000])
def test_nesting_is_bounded(depth: int) -> None:
    with pytest.raises(ValueError, match="nested"):
        parse_json(nested(depth))


@pytest.mark.parametrize("text", ["NaN", "[-Infinity]", '{"a": 1e999}', "[1e-5, -1e400]"])
def test_numbers_are_finite(text: str) -> None:
    with pytest.raises(ValueError, match=r"is not JSON|out of range"):
        parse_json(text)


def test_files(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text('{"a": "é"}', encoding="utf-8")
    assert read_json(tmp_path / "a.json", 100) == {"a": "é"}
    with pytest.raises(OSError, match="larger than 5 bytes"):
        read_json(tmp_path / "a.json", 5)
    (tmp_path / "a.json").write_bytes(b'"\xff"')
    with pytest.raises(ValueError, match="utf-8"):
        read_json(tmp_path / "a.json", 100)
    with pytest.raises(FileNotFoundError):
        read_json(tmp_path / "none.json", 100)
