"""Bailando's JSON and FACT's records at 60 frames per second."""

import json
import struct
import wave
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import DataError, StoreError
from dancedata.exports import bailando as songs
from dancedata.exports.bailando import json_of
from dancedata.exports.fact import crc32c, example, record
from tests.exports.conftest import RECIPES


def arrays(path: Path) -> dict[str, Any]:
    return {key: np.array(value) for key, value in json.loads(path.read_text()).items()}


@pytest.fixture(scope="module")
def bailando(built, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bailando's folder data/."""
    made = built("sixty")
    out = tmp_path_factory.mktemp("bailando") / "out"
    return dancedata.export(made.path, "bailando", out, source=made.source, progress=False).path / "data"


def test_bailandos_sequences(bailando: Path, built) -> None:
    out, store = bailando, built("sixty").store
    for folder, splits in (("aistpp_train_wav", ("train",)), ("aistpp_test_full_wav", ("test", "val"))):
        clips = {c.id: c for c in store.clips if c.split in splits}
        assert {p.stem for p in (out / folder).iterdir()} == set(clips)
        for name, clip in clips.items():
            plain, turned = (arrays(out / f / f"{name}.json") for f in (folder, f"{folder}_rotmat"))
            assert str(plain["id"]) == name
            rows, music = clip.read("bailando72"), clip.read_song("bailando438")
            n = min(len(rows), len(music)) if splits == ("train",) else None
            np.testing.assert_array_equal(plain["dance_array"].astype(np.float32), rows[:n])
            np.testing.assert_array_equal(plain["music_array"].astype(np.float32), music[:n])
            np.testing.assert_array_equal(turned["dance_array"].astype(np.float32), clip.read("fact219")[:n])
            # The loader moves positions to the root and back: in these it is the same dance.
            joints = dancedata.decode(turned["dance_array"], "fact219", fps=60).joints().reshape(-1, 72)
            np.testing.assert_allclose(plain["dance_array"], joints, atol=1e-5)
            assert plain["music_array"].dtype == np.float64


def test_bailandos_songs(bailando: Path, built) -> None:
    made = built("sixty")
    out, store = bailando, made.store
    music = {clip.music for clip in store.clips}
    for folder in ("aistpp_music_feat_7.5fps", "aistpp_music_feat_60fps"):
        assert {p.stem for p in (out / folder).iterdir()} == music
    name = sorted(music)[0]
    slow = arrays(out / "aistpp_music_feat_7.5fps" / f"{name}.json")["music_array"]
    wanted = dancedata.extract("bailando438", made.source / "wavs" / f"{name}.wav", fps=7.5)
    np.testing.assert_array_equal(slow.astype(np.float32), wanted)
    assert not slow[:, 52:].any()  # the era's zeros
    assert slow.dtype == np.float64
    fast = arrays(out / "aistpp_music_feat_60fps" / f"{name}.json")["music_array"]
    clip = next(c for c in store.clips if c.music == name)
    np.testing.assert_array_equal(fast.astype(np.float32), clip.read_song("bailando438"))
    assert len(fast) > clip.n_frames


def test_songs_that_are_not_the_beginning_of_another_are_refused(built, tmp_path: Path, monkeypatch) -> None:
    made = built("sixty")
    store = made.store
    loads = iter(range(100))
    monkeypatch.setattr(songs, "_begins", lambda part, whole: next(loads) < 0)
    monkeypatch.setattr("dancedata.pipeline.source_music.DIGITS", 0)
    from dancedata.exports.base.job import ExportJob

    job = ExportJob(store, tmp_path, made.source)
    clips = [c for c in job.clips() if c.music == store.clips[0].music]
    assert len(clips) == 2
    object.__setattr__(job.music, "hashes", {clip.id: clip.id for clip in clips})
    monkeypatch.setattr(type(job.music), "load", lambda self, clip: _signal(self, clip))
    _, missing = songs.find_songs(job, clips)
    assert "is not the beginning of that of" in missing[0].problem


def _signal(music: Any, clip: Any) -> Any:
    from dancedata.audio.signal import load_audio

    return load_audio(music.files[clip.id])


@pytest.mark.parametrize("value", [1 / 3, 1e-38, 123456.789, -0.0, 7.0])
def test_json_gives_back_every_float32(value: float) -> None:
    rows = np.array([[value, 0], [2, value]], np.float32)
    found = np.array(json.loads(json_of("a", {"x": rows}))["x"])
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found.astype(np.float32), rows)


# The check value of CRC-32C, and the examples of RFC 3720, B.4.
@pytest.mark.parametrize(
    ("data", "crc"),
    [
        (b"", 0),
        (b"123456789", 0xE3069283),
        (bytes(32), 0x8A9136AA),
        (b"\xff" * 32, 0x62A8AB43),
        (bytes(range(32)), 0x46DD794E),
        (bytes(range(31, -1, -1)), 0x113FDB5C),
    ],
)
def test_crc32c(data: bytes, crc: int) -> None:
    assert crc32c(data) == crc


def test_crc32c_of_long_data_is_that_of_its_bytes_one_by_one() -> None:
    table = []
    for n in range(256):
        for _ in range(8):
            n = n >> 1 ^ (0x82F63B78 if n & 1 else 0)
        table.append(n)
    data = np.random.default_rng(0).bytes(3001)
    state = 0xFFFFFFFF
    for byte in data:
        state = table[(state ^ byte) & 0xFF] ^ state >> 8
    assert crc32c(data) == state ^ 0xFFFFFFFF


def test_an_example_is_what_protobuf_writes() -> None:
    # google.protobuf, SerializeToString(deterministic=True) of the same tf.train.Example.
    wanted = "0a2e0a0b0a016112060a040a0278790a110a0166120c120a0a080000803f000000400a0c0a016e12071a050a03ac0201"
    assert example({"n": (300, 1), "a": b"xy", "f": np.array([1, 2], np.float32)}).hex() == wanted


def varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at


def fields(data: bytes) -> Iterator[tuple[int, bytes]]:
    at = 0
    while at < len(data):
        key, at = varint(data, at)
        assert key & 7 == 2
        size, at = varint(data, at)
        yield key >> 3, data[at : at + size]
        at += size


def records(path: Path) -> Iterator[dict[str, Any]]:
    data, at = path.read_bytes(), 0
    while at < len(data):
        (size,) = struct.unpack_from("<Q", data, at)
        payload = data[at + 12 : at + 12 + size]
        assert data[at : at + 16 + size] == record(payload)
        at += 16 + size
        (features,) = (content for _, content in fields(payload))
        found: dict[str, Any] = {}
        for _, entry in fields(features):
            (_, name), (_, value) = fields(entry)
            ((kind, content),) = fields(value)
            ((_, raw),) = fields(content)
            found[name.decode()] = raw if kind == 1 else np.frombuffer(raw, "<f4") if kind == 2 else list(raw)
            if kind == 3:
                found[name.decode()], place = [], 0
                while place < len(raw):
                    number, place = varint(raw, place)
                    found[name.decode()].append(number)
        yield found


def test_facts_records(export, built) -> None:
    out, store = export("sixty", "fact", source=None).path / "data", built("sixty").store
    seen = []
    for name, splits in (("train", ("train",)), ("testval", ("test", "val"))):
        files = sorted(out.glob(f"aist_tfrecord-{name}-*"))
        assert [p.name for p in files] == [f"aist_tfrecord-{name}-{k:05d}-of-00020" for k in range(20)]
        for found in (one for path in files for one in records(path)):
            clip = store.clip(found["motion_name"].decode())
            assert clip.split in splits
            assert found["audio_name"].decode() == clip.music
            motion = found["motion_sequence"].reshape(found["motion_sequence_shape"])
            music = found["audio_sequence"].reshape(found["audio_sequence_shape"])
            np.testing.assert_array_equal(motion, clip.read("fact219")[: len(music)])
            np.testing.assert_array_equal(music, clip.read_song("librosa35"))
            again = dancedata.encode(dancedata.decode(motion, "fact219", fps=60), "fact219")
            np.testing.assert_allclose(again, motion, atol=1e-5)
            seen.append(clip.id)
    assert sorted(seen) == sorted(clip.id for clip in store.clips)


@pytest.fixture(scope="module")
def short(sources, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A dataset of two songs, of which one ends a second before its dances, the other before four seconds."""
    folder = tmp_path_factory.mktemp("short")
    source = folder / "source"
    (source / "wavs").mkdir(parents=True)
    for path, seconds in zip(sorted((sources["aist++"] / "wavs").iterdir()), (5, 3.5), strict=True):
        with wave.open(str(path)) as file:
            parameters, data = file.getparams(), file.readframes(int(seconds * file.getframerate()))
        with wave.open(str(source / "wavs" / path.name), "wb") as file:
            file.setparams(parameters)
            file.writeframes(data)
    for part in ("motions", "splits", "ignore_list.txt", "cameras"):
        (source / part).symlink_to(sources["aist++"] / part)
    recipe = {
        **RECIPES["sixty"],
        "name": "short",
        "dataset": {"aist++": {"split": "all"}},
        "windows": {"length_s": 2, "stride_s": 0.5},
        "audio": {"librosa35": {}, "bailando438": {"onset_fmax": "nyquist"}},
    }
    dancedata.build(recipe, source, folder / "store", jobs=1, cache=folder / "cache", progress=False)
    return folder / "store", source


def test_music_that_ends_before_the_dance(short: tuple[Path, Path], tmp_path: Path, monkeypatch) -> None:
    """Motion ends with it, and what is then too short is left out of FACT, and noted by Bailando."""
    path, source = short
    store = dancedata.open(path)
    monkeypatch.setattr("dancedata.exports.fact.PARTS", {"train": ("all",), "test": ("all",)})
    monkeypatch.setattr("dancedata.exports.fact.needs_splits", lambda *_: [])
    done = dancedata.export(path, "fact", tmp_path / "fact", progress=False)
    n_rows = {clip.id: len(clip.read_song("librosa35")) for clip in store.clips}
    kept = {clip for clip, rows in n_rows.items() if rows >= 240}
    assert len(kept) == 2
    assert all(len(store.read_clip(clip, "fact219")) > n_rows[clip] for clip in kept)
    assert all(
        any(clip in note and "left out" in note for note in done.notes) == (clip not in kept) for clip in n_rows
    )
    found = [one for p in sorted((done.path / "data").glob("*-train-*")) for one in records(p)]
    assert {one["motion_name"].decode() for one in found} == kept
    for one in found:
        assert one["motion_sequence_shape"] == [n_rows[one["motion_name"].decode()], 219]
        assert one["audio_sequence_shape"] == [n_rows[one["motion_name"].decode()], 35]
    for name in ("fact", "bailando"):
        monkeypatch.setattr(f"dancedata.exports.{name}.PARTS", {"train": ("all",), "test": ()})
        monkeypatch.setattr(f"dancedata.exports.{name}.needs_splits", lambda *_: [])
    out = dancedata.export(path, "bailando", tmp_path / "out", source=source, progress=False).path / "data"
    for clip in store.clips:
        held = arrays(out / "aistpp_train_wav" / f"{clip.id}.json")
        music = clip.read("bailando438")
        assert len(held["music_array"]) == len(held["dance_array"]) == len(music) < len(clip.read("bailando72"))
    # The feature at 7.5 rows per second is the stored one, with its parameters.
    name = store.clips[0].music
    slow = arrays(out / "aistpp_music_feat_7.5fps" / f"{name}.json")["music_array"].astype(np.float32)
    wanted = dancedata.extract("bailando438", source / "wavs" / f"{name}.wav", fps=7.5, onset_fmax="nyquist")
    np.testing.assert_array_equal(slow, wanted)
    assert slow[:, 52].any()


def test_unpaired_motion_needs_another_song(export) -> None:
    """All test clips of the fixture are danced to one song: every pair would be the motion's own."""
    with pytest.raises(StoreError, match=r"all sequences of test have one song: mBR0"):
        export("sixty", "fact", unpaired=1)


def test_unpaired_records_are_drawn_from_a_seed(export, built, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dancedata.exports.fact.PARTS", {"train": ("train",), "test": ("train", "val", "test")})
    results = [export("sixty", "fact", name, unpaired=3).path / "data" for name in ("one", "two")]
    songs = {c.id: c.music for c in built("sixty").store.clips}
    test = list(songs)
    found = [[r for p in sorted(out.glob("*testval*")) for r in records(p)] for out in results]
    names = [[r["motion_name"].decode() for r in one] for one in found]
    own = [songs[r["motion_name"].decode()] == r["audio_name"].decode() for r in found[0]]
    assert own.count(True) == len(test)  # the pairs that are meant, and no other
    assert names[0] == names[1]
    assert sorted(names[0]) == sorted(test * 4)
    assert [p.read_bytes() for p in sorted(results[0].iterdir())] == [
        p.read_bytes() for p in sorted(results[1].iterdir())
    ]


@pytest.mark.parametrize("to", ["bailando", "fact"])
def test_ignored_clips_are_left_out(built, tmp_path: Path, to: str, monkeypatch: pytest.MonkeyPatch) -> None:
    made = built("sixty")
    monkeypatch.setattr("dancedata.exports.bailando.as_in_builds", lambda exact: lambda *_: np.zeros((9, 438), "f4"))
    clip = next(c.id for c in made.store.clips if c.split == "train")
    monkeypatch.setattr("dancedata.exports.bailando.is_ignored", lambda c: c.id == clip)
    monkeypatch.setattr(f"dancedata.exports.{to}.is_ignored", lambda c: c.id == clip)
    done = dancedata.export(made.path, to, tmp_path / "out", source=made.source, progress=False)
    assert any(clip in note and "ignore list" in note for note in done.notes)
    held = b"".join(p.read_bytes() for p in (done.path / "data").rglob("*train*") if p.is_file())
    assert clip.encode() not in held
    assert not list(done.path.rglob(f"{clip}.json"))


def test_ignored_clips_that_the_dataset_lacks_are_named(
    built, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from dancedata.store import Store

    made = built("sixty")
    monkeypatch.setattr(Store, "rejects", [{"reason": "ignored", "clip": "gBR_x"}])
    with pytest.raises(
        StoreError, match=r"not in the dataset: gBR_x\n.*fix: dataset: \{aist\+\+: \{ignore: none\}\}"
    ):
        dancedata.export(
            made.path, "bailando", tmp_path / "out", source=made.source, keep_ignored=True, progress=False
        )


def test_other_music_is_refused(built, tmp_path: Path) -> None:
    made = built("sixty")
    source = tmp_path / "music"
    source.mkdir()
    for path in (made.source / "wavs").iterdir():
        data = bytearray(path.read_bytes())
        data[-1000:] = bytes(1000)
        (source / path.name).write_bytes(data)
    with pytest.raises(DataError, match="this music does not match the dataset"):
        dancedata.export(made.path, "bailando", tmp_path / "out", source=source, progress=False)
    assert not (tmp_path / "out").exists()
