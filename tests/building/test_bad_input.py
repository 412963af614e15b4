"""Bad input among good: each has a reason and a clear message, and the rest is built intact."""

import os
import pickle
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

import dancedata
from dancedata.core.errors import StoreError
from dancedata.store import verify_store
from tests.formats.test_safe_pickle import Call

GOOD = "gHO_sBM_cAll_d19_mHO3_ch03"
RATE = 48_000


def name_of(number: int) -> str:
    """Name of a clip that is not in the corpus, danced to a song that is."""
    return f"gHO_sBM_cAll_d19_mHO3_ch{number:02d}"


def tone(seconds: float) -> np.ndarray[Any, Any]:
    """Clicks over a tone."""
    time_s = np.arange(int(seconds * RATE)) / RATE
    return 0.3 * np.sin(2 * np.pi * 220 * time_s) + 0.3 * (time_s % 0.5 < 0.01)


#: Clip -> (what is wrong, reason, the message in addition to the file's name).
MOTIONS = {
    name_of(11): ("truncated", "broken_file", "truncated"), name_of(12): ("attack", "unsafe_pickle", "posix.system"),
    name_of(13): ("nan", "nan", "frame 7"), name_of(14): ("shape", "bad_shape", "(360, 71)"),
    name_of(15): ("no frames", "empty", "no frames"), name_of(16): ("no scaling", "missing_key", "smpl_scaling"),
    name_of(17): ("lengths", "length_mismatch", "360 and 359 frames"),
    name_of(18): ("short", "too_short", "120 frames at 60 per second (2.00 s)"),
    name_of(19): ("no bytes", "broken_file", "EOFError"),
}  # fmt: skip
#: Song -> (what is wrong, reason, the message in addition to the file's name).
SONGS = {
    "mBR1": ("0 samples", "empty_audio", "0 samples"), "mBR2": ("0 bytes", "broken_audio", "0 bytes"),
    "mBR3": ("no audio", "broken_audio", "cannot be decoded"), "mBR4": ("nan", "nan", "NaN"),
    "mBR5": ("short", "short_audio", "shorter than a window: 3.0 s"), "mPO1": ("missing", "missing_music", "mPO1"),
}  # fmt: skip


def clip_to(song: str) -> str:
    """Name of a clip danced to a song."""
    return f"g{song[1:3]}_sBM_cAll_d04_{song}_ch01"


def bad_pickle(kind: str, good: bytes, marker: Path) -> bytes:
    content = pickle.loads(good)
    poses = content["smpl_poses"]
    if kind == "nan":
        poses[7, 3] = np.nan
    changes: dict[str, Any] = {
        "shape": {"smpl_poses": poses[:, :71]},
        "no frames": {"smpl_poses": poses[:0], "smpl_trans": content["smpl_trans"][:0]},
        "lengths": {"smpl_trans": content["smpl_trans"][:-1]},
        "short": {"smpl_poses": poses[:120], "smpl_trans": content["smpl_trans"][:120]},
        "attack": {"smpl_loss": Call(os.system, f"touch '{marker}'")},
    }
    content.update(changes.get(kind, {}))
    if kind == "no scaling":
        del content["smpl_scaling"]
    data = pickle.dumps(content)
    return data[: {"truncated": len(data) // 2, "no bytes": 0}.get(kind, len(data))]


def write_bad_song(path: Path, kind: str) -> None:
    if kind in ("0 bytes", "no audio"):
        path.write_bytes(b"" if kind == "0 bytes" else b"this is no music at all" * 100)
    elif kind != "missing":
        samples = tone({"0 samples": 0, "short": 3}.get(kind, 7))
        if kind == "nan":
            samples[1000] = np.nan
        soundfile.write(path, samples, RATE, subtype="FLOAT")


class Bad:
    """A source with every kind of error, and the dataset built from it."""

    def __init__(self, root: Path, corpus: Path) -> None:
        self.source = shutil.copytree(corpus, root / "bad source ø")
        self.out = root / "out"
        self.marker = root / "executed"
        motions, wavs = self.source / "motions", self.source / "wavs"
        good = (motions / f"{GOOD}.pkl").read_bytes()
        for clip, (kind, _, _) in MOTIONS.items():
            (motions / f"{clip}.pkl").write_bytes(bad_pickle(kind, good, self.marker))
        for song, (kind, _, _) in SONGS.items():
            (motions / f"{clip_to(song)}.pkl").write_bytes(good)
            write_bad_song(wavs / f"{song}.wav", kind)
        # 5.6 s of music for 6 s of motion: the third window has none.
        (motions / f"{clip_to('mKR0')}.pkl").write_bytes(good)
        soundfile.write(wavs / "mKR0.wav", tone(5.6), RATE)
        (motions / "my dance ☃.pkl").write_bytes(good)
        (wavs / "my song ☃.wav").write_bytes((wavs / "mKR0.wav").read_bytes())


@pytest.fixture(scope="module")
def bad(corpus: Path, run_build: Any, tmp_path_factory: pytest.TempPathFactory) -> Bad:
    made = Bad(tmp_path_factory.mktemp("bad"), corpus)
    run_build(made.source, made.out, set=["dataset.aist++.split=all"])
    return made


def reject_of(bad: Bad, rejects: Any, **wanted: Any) -> dict[str, Any]:
    found = [r for r in rejects(bad.out) if all(r.get(k) == v for k, v in wanted.items())]
    assert len(found) == 1, f"{wanted} occurs {len(found)} times"
    return found[0]


@pytest.mark.parametrize(("clip", "kind", "reason", "message"), [(c, *v) for c, v in MOTIONS.items()])
def test_a_bad_motion_is_set_aside(bad: Bad, rejects: Any, clip: str, kind: str, reason: str, message: str):
    reject = reject_of(bad, rejects, clip=clip)
    assert reject["reason"] == reason
    assert reject["file"] == f"motions/{clip}.pkl"
    assert clip in reject["detail"]
    assert message in reject["detail"]


def test_the_attack_was_not_run(bad: Bad):
    path = bad.source / "motions" / f"{name_of(12)}.pkl"
    assert not bad.marker.exists()
    pickle.loads(path.read_bytes())
    assert bad.marker.exists(), "the test's attack does not work"


@pytest.mark.parametrize(("song", "kind", "reason", "message"), [(s, *v) for s, v in SONGS.items()])
def test_a_clip_to_a_bad_song_is_set_aside(bad: Bad, rejects: Any, song: str, kind: str, reason: str, message: str):
    found = [r for r in rejects(bad.out) if r.get("clip") == clip_to(song) and r["reason"] != "no_audio"]
    assert [r["reason"] for r in found] == [reason]
    assert song in found[0]["detail"]
    assert message in found[0]["detail"]


def test_windows_beyond_the_end_of_the_music_are_left_out_one_by_one(bad: Bad, rejects: Any):
    clip = clip_to("mKR0")
    reject = reject_of(bad, rejects, reason="no_audio", clip=clip)
    assert (reject["window"], reject["numbers"]) == (30, {"audio_s": 5.6})
    assert "mKR0.wav" in reject["detail"]
    with dancedata.open(bad.out) as ds:
        assert [w.start for w in ds.windows("all") if w.clip == clip] == [0, 15]


@pytest.mark.parametrize("file", ["motions/my dance ☃.pkl", "wavs/my song ☃.wav"])
def test_a_file_with_an_unknown_name_is_reported(bad: Bad, rejects: Any, file: str):
    assert "named" in reject_of(bad, rejects, reason="extra_file", file=file)["detail"]


def test_the_other_clips_are_unharmed(bad: Bad, built: Path):
    assert [p for p in verify_store(bad.out) if p.severity == "error"] == []
    with dancedata.open(bad.out) as ds, dancedata.open(built) as whole:
        ids = {c.id for c in whole.clips()}
        assert {c.id for c in ds} == ids | {clip_to("mKR0")}
        for clip in ids:
            for field in ("edge151", "librosa35"):
                assert ds[clip].read(field).tobytes() == whole[clip].read(field).tobytes()
            starts = [[w.start for w in s.windows(s[clip].record.split) if w.clip == clip] for s in (ds, whole)]
            assert starts[0] == starts[1] != []


def test_slices_of_bad_input_are_set_aside(bad: Bad, run_build: Any, rejects: Any, out: Path):
    # A few clips are enough: rejects before takes are cut are tested above.
    few = shutil.copytree(bad.source, out.parent / "few")
    keep = [clip_to(s) for s in ("mBR1", "mBR5", "mKR0")] + [name_of(13), name_of(18)]
    for path in (few / "motions").iterdir():
        if path.stem not in keep:
            path.unlink()
    run_build(few, out, "aist++-edge-exact", set=["dataset.aist++.split=all"])
    found = {(r["reason"], r["clip"], r.get("window")) for r in rejects(out) if "clip" in r}
    assert {f for f in found if f[0] != "missing_motion"} == {
        ("empty_audio", clip_to("mBR1"), None), ("nan", name_of(13), None), ("too_short", name_of(18), None),
        *(("short_audio", f"{clip_to('mBR5')}_slice{k}", None) for k in range(3)),
        ("no_audio", f"{clip_to('mKR0')}_slice2", None),
    }  # fmt: skip
    with dancedata.open(out) as ds:
        assert [w.clip for w in ds.windows("all")] == [f"{clip_to('mKR0')}_slice{k}" for k in range(2)]


@pytest.mark.parametrize("place", ["a file", "below a file", "/proc/dancedata/out", "/sys/dancedata"])
def test_an_output_that_cannot_be_written_is_named(run_build: Any, corpus: Path, tmp_path: Path, place: str):
    # Not by permissions, which root ignores: tests may run as root. A file in the way and /proc do.
    file = tmp_path / "file"
    file.write_text("mine")
    out = {"a file": file, "below a file": file / "out"}.get(place, Path(place))
    with pytest.raises(StoreError, match=f"{out}: the output folder cannot be written"):
        run_build(corpus, out)
    assert file.read_text() == "mine"


@pytest.mark.parametrize("place", ["a file", "/proc/dancedata"])
def test_a_cache_that_cannot_be_written_is_named(run_build: Any, corpus: Path, tmp_path: Path, out: Path, place: str):
    file = tmp_path / "file"
    file.write_text("mine")
    cache = file if place == "a file" else Path(place)
    with pytest.raises(StoreError, match=f"{cache}: the cache cannot be written.*Set DANCEDATA_CACHE"):
        run_build(corpus, out, cache=cache)
    assert not out.exists()
