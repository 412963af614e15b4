"""The cache of units of work: keys say all that shapes a result, entries are whole, a key is computed once."""

import os
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dancedata.building import signals as audio_units
from dancedata.building.compute import cached_results
from dancedata.building.fields.music import MusicField
from dancedata.building.signals import SignalId
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import DataError, UsageError
from dancedata.execution import cache as cache_module
from dancedata.execution.cache import Cache, EntryLostError
from dancedata.files import cache_files
from dancedata.files.documents import content_hashes
from dancedata.music.signal import load_audio
from dancedata.recipes.parse import load_recipe
from dancedata.recipes.recipe import Recipe
from tests.commands import in_processes, killed_afterwards
from tests.messages import raises_message
from tests.takes import keys_of, made, makers_of, take_of, unit_of

KEY = "ab" + "0" * 62
HOLDER = """
import pathlib, sys, time
from dancedata.execution.cache import Cache

with Cache(pathlib.Path(sys.argv[1])).lock("features", sys.argv[2]):
    print("ready", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def own(tmp_path: Path) -> Cache:
    """A cache of the test's own."""
    return Cache(tmp_path / "cache")


def motion_keys(cache: Cache, recipe: Recipe, ref: ClipRef, sha: str) -> dict[str, str]:
    return keys_of(recipe, take_of(recipe, [(ref, sha)], content_hashes(recipe.dataset, cache.file_sha256)))


def music(recipe: Recipe) -> MusicField:
    (field,) = recipe.audio
    assert isinstance(field, MusicField)
    return field


def feature_key(*overrides: str, bpm: float | None = 120.0, sha: str = "s") -> str:
    recipe = load_recipe("aist++", overrides)
    return music(recipe).song_key(bpm, sha)


@pytest.mark.parametrize(
    ("other", "same"),
    [
        ({"overrides": ["audio.librosa35.tightness=1"]}, False),
        ({"overrides": ["fps=60"]}, False),
        ({"overrides": ["transforms=[slices]"]}, False),
        ({"bpm": 121.0}, False),
        ({"bpm": None}, False),
        ({"sha": "t"}, False),
        ({"bpm": 120}, True),  # a number however it is written
        ({"overrides": ["windows.stride_s=1", "name=another", "store.shard_mb=1", "motion={joints: {}}"]}, True),
    ],
)
def test_what_shapes_a_feature_is_in_its_key_and_nothing_else(other: dict[str, Any], same: bool):
    assert (feature_key(*other.pop("overrides", ()), **other) == feature_key()) is same


@pytest.mark.parametrize("package", ["librosa", "numpy", "scipy", "soxr"])
def test_another_version_of_a_package_is_another_key(package: str, monkeypatch: pytest.MonkeyPatch):
    before = feature_key()
    monkeypatch.setattr(
        "dancedata.building.fields.music.package_version", lambda name: "9.9" if name == package else "1.0"
    )
    one = feature_key()
    monkeypatch.setattr("dancedata.building.fields.music.package_version", lambda name: "1.0")
    assert len({before, one, feature_key()}) == 3


def window_key(song: str = "sha", number: int = 6, rate: int = 44100, *overrides: str) -> str:
    recipe = load_recipe("aist++-edge-exact", overrides)
    return music(recipe).slice_key(120.0, SignalId(Path("song.wav"), "file", song, rate, 10**6), number)


def test_a_window_is_identified_by_its_song_and_position(monkeypatch: pytest.MonkeyPatch):
    """Not by its samples alone, nor by its number: another stride that gives the same place finds its rows."""
    assert len({window_key(), window_key("other"), window_key(number=7), window_key(rate=48000)}) == 4
    before = window_key()
    assert window_key("sha", 2, 44100, "transforms.slices.stride_s=1.5") == before
    # A version of a feature raised by hand.
    monkeypatch.setattr(type(load_recipe("aist++-edge-exact").audio[0].feature), "version", 10**6)
    assert window_key() != before


def test_another_body_model_is_another_key(own: Cache, tmp_path: Path):
    model = tmp_path / "model.npz"
    recipe = load_recipe("finedance", [f"dataset={{folder: {{body_model: '{model}'}}}}", "audio={}"])
    ref = ClipRef("001", tmp_path / "001.npy", None, music="001", split="train")
    model.write_bytes(b"one")
    one = motion_keys(own, recipe, ref, "m")
    model.write_bytes(b"two")
    two = motion_keys(own, recipe, ref, "m")
    assert [name for name in one if one[name] == two[name]] == []


def test_hashes_of_files_are_remembered_until_the_file_changes(own: Cache, tmp_path: Path):
    path = tmp_path / "file"
    path.write_bytes(b"one")
    assert own.cached_sha256(path) is None
    first = own.file_sha256(path)
    assert own.cached_sha256(path) == first
    os.utime(path, ns=(0, 1))  # another time of change
    assert own.cached_sha256(path) is None
    own.file_sha256(path)
    # Of the same size and time of change, but another file.
    (tmp_path / "new").write_bytes(b"two")
    os.utime(tmp_path / "new", ns=(0, 1))
    os.replace(tmp_path / "new", path)
    assert own.cached_sha256(path) is None
    assert own.file_sha256(path) != first
    # As `tar xf` leaves it: the same size, time of change and inode.
    path.write_bytes(b"six")
    os.utime(path, ns=(0, 1))
    assert own.cached_sha256(path) is None


def damage(folder: Path) -> int:
    """Change a bit of the last value of every array in a folder; returns how many there are."""
    paths = sorted(folder.rglob("*.npy"))
    for path in paths:
        data = bytearray(path.read_bytes())
        data[-20] ^= 1
        path.write_bytes(data)
    return len(paths)


@pytest.mark.parametrize(
    "array",
    [np.arange(12, dtype=np.float32).reshape(4, 3), np.zeros((0, 5, 2), np.float16),
     np.asfortranarray(np.arange(6.0).reshape(2, 3)), np.array(3, np.int64)],
)  # fmt: skip
def test_an_array_comes_back(own: Cache, array: Any):
    assert own.array("features", KEY) is None
    assert not own.contains("features", KEY)
    own.put_array("features", KEY, array)
    assert own.contains("features", KEY)
    found = own.array("features", KEY)
    assert found is not None
    assert found.shape == array.shape
    for rows in (np.asarray(found), found.mapped()):
        assert rows.dtype == array.dtype
        np.testing.assert_array_equal(rows, array)
    # It is a file that numpy reads, for inspection.
    np.testing.assert_array_equal(np.load(found.path), array)


@pytest.mark.parametrize("cut", [1, 10, 60, 127])
def test_a_shortened_entry_counts_as_missing(own: Cache, cut: int):
    path = own.put_array("features", KEY, np.arange(3.0)).path
    os.truncate(path, path.stat().st_size - cut)
    assert own.array("features", KEY) is None


def test_a_changed_bit_is_found_when_it_is_read_and_the_entry_removed(own: Cache):
    found = own.put_array("features", KEY, np.arange(3.0))
    assert damage(own.root / "features") == 1
    with raises_message(EntryLostError, "entry"):
        np.asarray(found)
    assert own.array("features", KEY) is None
    own.put_json("segments", KEY, [1, 2])
    path = next((own.root / "segments").rglob("*.json"))
    path.write_bytes(path.read_bytes().replace(b"2", b"3", 1))
    assert own.json("segments", KEY) is None


def test_many_processes_that_want_one_entry_compute_it_once(own: Cache, tmp_path: Path):
    def compute() -> Any:
        with (tmp_path / "log").open("a") as log:
            log.write("computed\n")
        time.sleep(0.2)
        return np.arange(5.0)

    sums = in_processes(6, lambda: float(np.asarray(own.once("features", KEY, compute)).sum()))
    assert sums == [10.0] * 6
    assert (tmp_path / "log").read_text() == "computed\n"
    assert list((own.root / "locks").iterdir()) == list((own.root / "tmp").iterdir()) == []


def test_who_waits_for_a_process_that_is_killed_computes(own: Cache):
    with killed_afterwards(HOLDER, own.root, KEY) as process:
        threading.Timer(0.2, process.kill).start()
        assert np.asarray(own.once("features", KEY, lambda: np.ones(2))).tolist() == [1, 1]


def test_two_that_publish_one_key_leave_a_whole_entry(own: Cache):
    def publish() -> bool:
        for _ in range(50):
            own.put_array("features", KEY, np.arange(5000.0), durable=False)
            np.asarray(own.array("features", KEY))
        return True

    assert in_processes(3, publish) == [True] * 3
    assert list((own.root / "tmp").iterdir()) == []


def test_a_computation_that_fails_leaves_nothing(own: Cache):
    def fail() -> Any:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        own.once("features", KEY, fail)
    assert own.array("features", KEY) is None
    assert [p.name for p in own.root.rglob("*") if p.is_file()] == [cache_files.MARKER]


def test_the_last_use_is_noted_once_an_hour(own: Cache):
    path = own.put_array("features", KEY, np.ones(1)).path
    for used, noted in ((-1800.0, False), (-2 * cache_files.USE_GRANULARITY_S, True), (1e8, True)):
        before = time.time() + used
        os.utime(path, (before, before))
        own.array("features", KEY)
        assert (abs(path.stat().st_mtime - before) > 1) is noted


def test_the_cache_is_where_the_environment_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A home folder that no shell has put in is meant."""
    monkeypatch.setenv("HOME", str(tmp_path))
    for named in (str(tmp_path / "named"), "~/named"):
        monkeypatch.setenv("DANCEDATA_CACHE", named)
        assert cache_module.default_cache() == tmp_path / "named"
    monkeypatch.setenv("DANCEDATA_CACHE", "~nobody-has-this-name/cache")
    with raises_message(UsageError, "DANCEDATA_CACHE"):
        cache_module.default_cache()
    monkeypatch.delenv("DANCEDATA_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_module.default_cache() == tmp_path / "dancedata"


def test_a_song_is_known_by_its_samples_not_its_name(corpus: Path, own: Cache, tmp_path: Path):
    song = sorted((corpus / "wavs").glob("*.wav"))[0]
    copy = tmp_path / "another.wav"
    copy.write_bytes(song.read_bytes())
    assert audio_units.SignalId.cached(own, song) is None
    found = [audio_units.identify_audio(own, path) for path in (song, copy)]
    assert all(isinstance(signal, SignalId) for signal in found)
    assert len({signal.sha256 for signal in found}) == 1
    assert audio_units.SignalId.cached(own, song) == found[0]


def test_a_link_to_a_file_is_known_by_the_file(own: Cache, tmp_path: Path):
    (tmp_path / "real").mkdir()
    path, link, linked = tmp_path / "real" / "file", tmp_path / "link", tmp_path / "folder"
    path.write_bytes(b"one")
    link.symlink_to(path)
    linked.symlink_to(path.parent)
    own.file_sha256(path)
    assert own.cached_sha256(link) == own.cached_sha256(linked / "file") == own.cached_sha256(path) is not None
    other = tmp_path / "other"
    other.write_bytes(b"two")
    link.unlink()
    link.symlink_to(other)
    assert own.cached_sha256(link) is None
    link.unlink()
    link.symlink_to(link)
    with pytest.raises(OSError, match="link"):  # links that go round are an error of the file
        own.file_sha256(link)


@pytest.mark.parametrize("what", ["motion", "body model"])
def test_motion_that_changes_during_a_build_is_set_aside(corpus: Path, own: Cache, what: str):
    recipe = load_recipe("aist++")
    (ref, *_) = recipe.dataset.scan(corpus).clips
    sha = own.file_sha256(ref.motion_path) if what == "body model" else "another"
    # As if a model had been there when the keys were made.
    take = take_of(recipe, [(ref, sha)], {"body_model/model.npz": "0"} if what == "body model" else {})
    edge151 = makers_of(recipe)["edge151"]
    found = made(own, edge151, take)
    assert isinstance(found, Reject)
    assert found.reason == "changed"
    assert what == "motion" or "body_model/model.npz" in found.detail
    assert cached_results(own, unit_of(edge151, take)) is None


def test_a_song_that_changes_during_a_build_is_set_aside(corpus: Path, own: Cache, tmp_path: Path):
    first, second = sorted((corpus / "wavs").glob("*.wav"))[:2]
    song = tmp_path / "song.wav"
    song.write_bytes(first.read_bytes())
    identified = audio_units.identify_audio(own, song)
    assert isinstance(identified, SignalId)
    os.utime(song, (0, 0))
    identified.load()  # the same samples
    song.write_bytes(second.read_bytes())
    with raises_message(DataError, "changed", where="song.wav", reason="changed"):
        identified.load()


def test_a_song_that_changes_while_it_is_looked_at_is_not_remembered(corpus, own, tmp_path, monkeypatch):
    song = tmp_path / "song.wav"
    song.write_bytes(next((corpus / "wavs").glob("*.wav")).read_bytes())
    before = song.stat()
    plain = load_audio

    def load(path: Path) -> AudioSignal:
        os.utime(path, (0, 0))
        return plain(path)

    monkeypatch.setattr("dancedata.music.signal.load_audio", load)
    found = audio_units.identify_audio(own, song)
    assert isinstance(found, Reject)
    assert found.reason == "changed"
    os.utime(song, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert audio_units.SignalId.cached(own, song) is None


def test_an_entry_that_a_network_file_system_does_not_show_yet(own: Cache, monkeypatch: pytest.MonkeyPatch):
    array = own.put_array("features", KEY, np.arange(3.0))
    looked: list[Path] = []
    plain_list, plain_read = os.listdir, cache_files.read_array

    def listdir(path: Path) -> list[str]:
        looked.append(path)
        return plain_list(path)

    def read(path: Path) -> np.ndarray:
        if not looked:
            raise FileNotFoundError(path)
        return plain_read(path)

    monkeypatch.setattr(os, "listdir", listdir)
    monkeypatch.setattr(cache_files, "read_array", read)
    assert np.array_equal(np.asarray(array), np.arange(3.0))
    assert looked == [array.path.parent]
