"""Bailando's JSON and FACT's records at 60 frames per second."""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import DataError, StoreError
from dancedata.exports.bailando import json_of
from dancedata.exports.base.run import ExportResult
from dancedata.exports.fact import crc32c, example, record
from tests.exports.conftest import cut
from tests.messages import raises_message

#: The clips of both songs.
BREAK = ["gBR_sBM_cAll_d04_mBR0_ch01", "gBR_sBM_cAll_d05_mBR0_ch02"]
HOUSE = ["gHO_sBM_cAll_d19_mHO3_ch03", "gHO_sFM_cAll_d20_mHO3_ch01"]


pytestmark = pytest.mark.usefixtures("quick_bailando438")


def arrays(path: Path) -> dict[str, Any]:
    return {key: np.array(value) for key, value in json.loads(path.read_text()).items()}


@pytest.fixture(scope="module")
def bailando(built, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Bailando's folder data/."""
    dataset = built("bailando")
    out = tmp_path_factory.mktemp("bailando") / "out"
    return dancedata.export(dataset.path, "bailando", out, source=dataset.source, progress=False).path / "data"


def test_bailandos_sequences(bailando: Path, built) -> None:
    out, store = bailando, built("bailando").store
    for folder, splits in (("aistpp_train_wav", ("train",)), ("aistpp_test_full_wav", ("test", "val"))):
        clips = {c.id: c for c in store if c.split in splits}
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
    dataset = built("bailando")
    out, store = bailando, dataset.store
    music = {clip.music for clip in store}
    for folder in ("aistpp_music_feat_7.5fps", "aistpp_music_feat_60fps"):
        assert {p.stem for p in (out / folder).iterdir()} == music
    name = sorted(music)[0]
    slow = arrays(out / "aistpp_music_feat_7.5fps" / f"{name}.json")["music_array"]
    wanted = dancedata.features(dataset.source / "wavs" / f"{name}.wav", "bailando438", fps=7.5)
    np.testing.assert_array_equal(slow.astype(np.float32), wanted)
    assert slow.dtype == np.float64
    fast = arrays(out / "aistpp_music_feat_60fps" / f"{name}.json")["music_array"]
    clip = next(c for c in store if c.music == name)
    np.testing.assert_array_equal(fast.astype(np.float32), clip.read_song("bailando438"))
    assert len(fast) > clip.n_frames


def test_files_of_one_song(built, aist, tmp_path: Path) -> None:
    """Loaders read one file per song: that of one sequence, if those of the others are its beginning."""

    def songs(name: str, sound: bytes) -> dict[str, bytes]:
        if name == "mBR0":
            return {BREAK[0]: sound, BREAK[1]: cut(sound, 6, first=0.1)}
        return {HOUSE[0]: cut(sound, 6), HOUSE[1]: sound}

    dataset = built("bailando", aist(songs=songs))
    with raises_message(StoreError, "gBR_sBM_cAll_d05_mBR0_ch02", where="bailando") as caught:
        dancedata.export(dataset.path, "bailando", tmp_path / "out", source=dataset.source, progress=False)
    problem = "one file per song is read, and the music mBR0 of gBR_sBM_cAll_d0{}_mBR0_ch0{} is not the beginning of"
    assert any(problem.format(*numbers) in str(caught.value) for numbers in ((4, 1), (5, 2)))
    assert "mHO3" not in str(caught.value)


@pytest.mark.parametrize("value", [1 / 3, 1e-38, 123456.789, -0.0, 7.0])
def test_json_gives_back_every_float32(value: float) -> None:
    rows = np.array([[value, 0], [2, value]], np.float32)
    found = np.array(json.loads(json_of("a", {"x": rows}))["x"])
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found.astype(np.float32), rows)


def test_crc32c() -> None:
    """The check value of CRC-32C, and the examples of RFC 3720, B.4."""
    given = {
        b"": 0, b"123456789": 0xE3069283, bytes(32): 0x8A9136AA, b"\xff" * 32: 0x62A8AB43,
        bytes(range(32)): 0x46DD794E, bytes(range(31, -1, -1)): 0x113FDB5C,
    }  # fmt: skip
    assert {data: crc32c(data) for data in given} == given


def test_an_example_equals_protobufs_output() -> None:
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
            clip = store[found["motion_name"].decode()]
            assert clip.split in splits
            assert found["audio_name"].decode() == clip.music
            motion = found["motion_sequence"].reshape(found["motion_sequence_shape"])
            music = found["audio_sequence"].reshape(found["audio_sequence_shape"])
            np.testing.assert_array_equal(motion, clip.read("fact219")[: len(music)])
            np.testing.assert_array_equal(music, clip.read_song("librosa35"))
            again = dancedata.encode(dancedata.decode(motion, "fact219", fps=60), "fact219")
            np.testing.assert_allclose(again, motion, atol=1e-5)
            seen.append(clip.id)
    assert sorted(seen) == sorted(clip.id for clip in store)


def test_music_that_ends_before_the_dance(built, aist, tmp_path: Path) -> None:
    """Motion ends with it, and what is then too short is left out of FACT, and noted by Bailando."""
    source = aist(
        songs=lambda name, sound: {name: cut(sound, 5 if name == "mBR0" else 3.5)},
        splits={"train": [BREAK[0], *HOUSE], "val": [], "test": [BREAK[1]]},
    )
    audio = {"librosa35": {}, "bailando438": {"onset_fmax": "nyquist"}}
    dataset = built("sixty", source, windows={"length_s": 2, "stride_s": 0.5}, audio=audio)
    store = dataset.store
    done = dancedata.export(dataset.path, "fact", tmp_path / "fact", progress=False)
    n_rows = {clip.id: len(clip.read_song("librosa35")) for clip in store}
    assert {clip for clip, rows in n_rows.items() if rows >= 240} == set(BREAK)
    assert all(len(store[clip].read("fact219")) > n_rows[clip] for clip in BREAK)
    assert all(
        any(clip in note and "left out" in note for note in done.notes) == (clip not in BREAK) for clip in n_rows
    )
    written = [one for p in sorted((done.path / "data").iterdir()) for one in records(p)]
    assert {one["motion_name"].decode() for one in written} == set(BREAK)
    for one in written:
        assert one["motion_sequence_shape"] == [n_rows[one["motion_name"].decode()], 219]
        assert one["audio_sequence_shape"] == [n_rows[one["motion_name"].decode()], 35]
    out = dancedata.export(dataset.path, "bailando", tmp_path / "out", source=source, progress=False).path / "data"
    for clip in (clip for clip in store if clip.split == "train"):
        held = arrays(out / "aistpp_train_wav" / f"{clip.id}.json")
        music = clip.read("bailando438")
        assert len(held["music_array"]) == len(held["dance_array"]) == len(music) < len(clip.read("bailando72"))
    # The feature at 7.5 rows per second is the stored one, with its parameters.
    slow = arrays(out / "aistpp_music_feat_7.5fps" / "mBR0.json")["music_array"].astype(np.float32)
    wanted = dancedata.features(source / "wavs" / "mBR0.wav", "bailando438", fps=7.5, onset_fmax="nyquist")
    np.testing.assert_array_equal(slow, wanted)


def test_unpaired_motion_needs_another_song(export) -> None:
    """All test clips of the fixture are danced to one song: every pair would be the motion's own."""
    with raises_message(StoreError, "unpaired", where="sixty"):
        export("sixty", "fact", unpaired=1)


def test_unpaired_records_are_drawn_from_a_seed(built, aist, tmp_path: Path) -> None:
    dataset = built("sixty", aist(splits={"train": BREAK[:1], "val": HOUSE[:1], "test": [BREAK[1], HOUSE[1]]}))
    results = [
        dancedata.export(dataset.path, "fact", tmp_path / name, unpaired=3, progress=False).path / "data"
        for name in ("one", "two")
    ]
    songs = {c.id: c.music for c in dataset.store.clips() if c.split != "train"}
    pairs = [[r for p in sorted(out.glob("*testval*")) for r in records(p)] for out in results]
    names = [[r["motion_name"].decode() for r in one] for one in pairs]
    same = [songs[r["motion_name"].decode()] == r["audio_name"].decode() for r in pairs[0]]
    assert same.count(True) == len(songs)  # only the intended pairs
    assert names[0] == names[1]
    assert sorted(names[0]) == sorted([*songs] * 4)
    files = [sorted(out.iterdir()) for out in results]
    assert [p.read_bytes() for p in files[0]] == [p.read_bytes() for p in files[1]]


#: A sequence on the ignore list of AIST++.
IGNORED = "gBR_sBM_cAll_d04_mBR0_ch07"


@pytest.mark.parametrize("to", ["bailando", "fact"])
@pytest.mark.parametrize("ignore", ["none", "list"])
def test_ignored_clips(built, aist, tmp_path: Path, to: str, ignore: str) -> None:
    """Exports leave them out; kept on request, they have to be in the dataset."""
    source = aist(splits={"train": [IGNORED, *HOUSE]}, named={IGNORED: BREAK[0]})
    (source / "ignore_list.txt").write_text(f"{IGNORED}\n")
    dataset = built("bailando" if to == "bailando" else "sixty", source, dataset={"aist++": {"ignore": ignore}})

    def run(out: str, **options: Any) -> ExportResult:
        return dancedata.export(dataset.path, to, tmp_path / out, source=source, progress=False, **options)

    def names(result: ExportResult) -> bytes:
        return b"".join(p.read_bytes() for p in (result.path / "data").rglob("*train*") if p.is_file())

    done = run("out")
    assert any(IGNORED in note and "ignore list" in note for note in done.notes) == (ignore == "none")
    assert IGNORED.encode() not in names(done)
    assert HOUSE[0].encode() in names(done) or to == "bailando"
    assert bool(list(done.path.rglob(f"{HOUSE[0]}.json"))) == (to == "bailando")
    assert not list(done.path.rglob(f"{IGNORED}.json"))
    if to == "fact":
        return
    if ignore == "none":
        assert list(run("kept", keep_ignored=True).path.rglob(f"{IGNORED}.json"))
        return
    with raises_message(StoreError, "gBR_sBM_cAll_d04_mBR0_ch07", where="bailando"):
        run("kept", keep_ignored=True)


def test_other_music_is_refused(built, aist, tmp_path: Path) -> None:
    source = aist(songs=lambda name, sound: {name: sound[:-1000] + bytes(1000)})
    with raises_message(DataError, "does not match", where="aist/wavs/mBR0.wav", reason="other_music"):
        dancedata.export(built("bailando").path, "bailando", tmp_path / "out", source=source, progress=False)
    assert not (tmp_path / "out").exists()
