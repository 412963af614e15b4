"""Hashes, and files that appear whole or not at all."""

import hashlib
import os
import stat
from pathlib import Path

import numpy as np
import pytest

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import DataError, UsageError
from dancedata.core.hashing import canonical_json, json_sha256, sha256_bytes
from dancedata.core.resources import resource, resources
from dancedata.files import atomic
from dancedata.files.atomic import atomic_file, require_free, write_bytes, write_json, write_text
from dancedata.files.regular_file import sha256_file
from tests.messages import raises_message


def test_hashes(tmp_path: Path) -> None:
    (tmp_path / "abc").write_bytes(b"abc")
    # FIPS 180-2, appendix B.1
    abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert sha256_file(tmp_path / "abc") == sha256_bytes(b"a", b"", memoryview(b"bc")) == abc
    assert sha256_bytes() == hashlib.sha256().hexdigest()


def test_json_has_one_text() -> None:
    assert canonical_json({"b": [1, 2.5], "a": {"ü": None}}) == '{"a":{"ü":null},"b":[1,2.5]}'
    assert json_sha256({"a": 1, "b": 2}) == json_sha256({"b": 2, "a": 1})
    assert json_sha256({"a": 1}) != json_sha256({"a": 1.5})
    with pytest.raises(ValueError, match="JSON"):
        canonical_json(float("nan"))


def test_written_whole_and_readable_by_other_users(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_json(tmp_path / "x.json", {"b": 1, "a": "é"})
    finally:
        os.umask(before)
    assert (tmp_path / "x.json").read_bytes() == '{\n "a": "é",\n "b": 1\n}\n'.encode()
    assert stat.S_IMODE((tmp_path / "x.json").stat().st_mode) == 0o640
    write_text(tmp_path / "x.json", "new\n")
    assert (tmp_path / "x.json").read_bytes() == b"new\n"
    assert os.listdir(tmp_path) == ["x.json"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, OSError])
def test_failure_leaves_the_old_file_and_no_other(tmp_path: Path, error: type[BaseException]) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"old")

    def fail() -> None:
        with atomic_file(path) as temporary:
            assert temporary.parent == tmp_path
            temporary.write_bytes(b"half")
            assert path.read_bytes() == b"old"
            raise error("stop")

    with pytest.raises(error, match="stop"):
        fail()
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["x"]


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_disk_that_fails_at_the_last_moment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"old")

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(atomic.os, call, fail)
    with pytest.raises(OSError, match="No space left"):
        write_bytes(path, b"new")
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["x"]


def test_json_that_cannot_be_written_touches_nothing(tmp_path: Path) -> None:
    write_json(tmp_path / "x", 1)
    with pytest.raises(ValueError, match="JSON"):
        write_json(tmp_path / "x", [float("inf")])
    assert (tmp_path / "x").read_text() == "1\n"


@pytest.mark.parametrize(
    ("what", "name"), [("report", "figures.pdf"), ("page", "page"), ("page", "p.mp4"), ("card", "card.html")]
)
def test_a_file_whose_ending_states_another_format(tmp_path: Path, what: str, name: str) -> None:
    with pytest.raises(UsageError, match=r"is not a file of this kind; found .*; allowed: a name that ends in \."):
        require_free(tmp_path / name, [], what, overwrite=True)


def test_endings_in_capitals(tmp_path: Path) -> None:
    for what, name in (("report", "A.HTML"), ("page", "a.htm"), ("card", "README.MD"), ("video", "a.mov")):
        assert require_free(tmp_path / name, [], what, overwrite=False).name == name


def test_resources() -> None:
    for kind in ("pipelines", "manifests"):
        for name in resources(kind):
            assert resource(kind, name).is_file()
    with raises_message(UsageError, r"aistp\.yaml"):
        resource("manifests", "aistp.yaml")
    with raises_message(UsageError, r"aistpp\.yaml"):
        resource("manifests", "x/../aistpp.yaml")


def test_audio_signal() -> None:
    samples = np.array([0.5, -1, 0.25], dtype=np.float64)
    signal = AudioSignal(samples, 48000)  # type: ignore[arg-type]
    samples[:] = 0
    assert signal.samples.dtype == np.float32
    assert signal.samples.tolist() == [0.5, -1, 0.25]
    assert not signal.samples.flags.writeable
    assert signal.n_samples == 3
    assert signal.part(1, 3).samples.tolist() == [-1, 0.25]


def test_audio_signal_is_known_by_samples_and_rate() -> None:
    signal = AudioSignal(np.zeros(5, np.float32), 48000)
    assert signal.sha256 == AudioSignal(np.zeros(5, np.float32), 48000).sha256
    others = [(np.zeros(5), 44100), (np.zeros(6), 48000), (np.full(5, 1e-9), 48000)]
    assert len({signal.sha256, *(AudioSignal(s.astype(np.float32), r).sha256 for s, r in others)}) == 4


def test_invalid_audio_signal() -> None:
    with raises_message(UsageError, "AudioSignal"):
        AudioSignal(np.zeros((5, 2), np.float32), 48000)
    with raises_message(UsageError, "sample"):
        AudioSignal(np.zeros(5, np.float32), 0)
    with raises_message(DataError, "infinity", reason="nan"):
        AudioSignal(np.array([0, 0, 0, np.nan, np.inf], np.float32), 48000)
