"""Files that are none: pipes, sockets, devices and folders are refused at once; JSON within bounds."""

import json
import os
import socket
from pathlib import Path

import pytest

from dancedata.files.regular_file import NotRegularError, open_regular, read_regular, sha256_file
from dancedata.files.strict_json import MAX_DEPTH, parse_json, read_json


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


def test_a_file_is_read_through_links(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"abc")
    (tmp_path / "link").symlink_to("file")
    with open_regular(tmp_path / "link") as file:
        assert file.read() == b"abc"
        assert file.name == str(tmp_path / "link") or file.name == tmp_path / "link"
    assert read_regular(tmp_path / "file", 3) == b"abc"


def test_a_file_that_is_too_big_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"abcd")
    with pytest.raises(OSError, match="larger than 3 bytes"):
        read_regular(tmp_path / "file", 3)
    with open(tmp_path / "sparse", "wb") as file:
        file.truncate(1 << 42)
    with pytest.raises(OSError, match="larger than 1,000,000 bytes"):
        read_regular(tmp_path / "sparse", 10**6)


def test_a_pipe_is_not_waited_for(pipe: Path) -> None:
    for read in (open_regular, sha256_file):
        with pytest.raises(NotRegularError, match="a named pipe, not a regular file"):
            read(pipe)
    pipe.with_name("link").symlink_to(pipe)
    with pytest.raises(NotRegularError):
        open_regular(pipe.with_name("link"))


def test_sockets_devices_and_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_UNIX) as listening:
        monkeypatch.chdir(tmp_path)  # names of sockets are short
        listening.bind("socket")
        with pytest.raises(NotRegularError, match="a socket"):
            open_regular(tmp_path / "socket")
    with pytest.raises(NotRegularError, match="a device"):
        open_regular("/dev/zero")
    with pytest.raises(IsADirectoryError):
        open_regular(tmp_path)
    with pytest.raises(FileNotFoundError):
        open_regular(tmp_path / "none")


def test_a_file_that_is_swapped_for_a_pipe(tmp_path: Path, pipe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Between the look at it and the opening of it."""
    (tmp_path / "file").write_bytes(b"abc")
    opened = os.open
    monkeypatch.setattr(os, "open", lambda path, flags, mode: opened(pipe, flags, mode))
    with pytest.raises(NotRegularError):
        open_regular(tmp_path / "file")


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
