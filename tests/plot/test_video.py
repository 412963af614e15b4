"""Videos: as many pictures as frames, as much sound as pictures, and only music that may be shared."""

import gc
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata import plot
from dancedata.cli import interrupts
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.terms import require_shareable
from dancedata.music.samples import resample
from dancedata.music.signal import load_audio
from dancedata.plot.frames import Frames
from dancedata.scene.scene_list import Scene
from dancedata.scene.scenes import Scenes
from tests.messages import raises_message

pytest.importorskip("matplotlib")
imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
SIZE = (192, 160)


def decoded(path: Path, *options: str) -> bytes:
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-loglevel", "error", "-i", str(path), *options, "pipe:1"]
    return subprocess.run(command, check=True, capture_output=True).stdout


def pictures(path: Path) -> np.ndarray:
    data = decoded(path, "-f", "rawvideo", "-pix_fmt", "rgb24", "-fps_mode", "passthrough")
    return np.frombuffer(data, np.uint8).reshape(-1, SIZE[1], SIZE[0], 3)


def sound(path: Path) -> np.ndarray:
    return np.frombuffer(decoded(path, "-f", "f32le", "-ac", "1", "-ar", "22050"), np.float32)


def test_a_video_has_the_frames_and_the_sound_of_its_clip(demo: Path, tmp_path: Path) -> None:
    ds = dancedata.open(demo)
    clip = ds.clips()[0]
    source = demo.parent / "demo-source"
    path = plot.write_video(
        ds, clip.id, tmp_path / "a.mp4", source=source, start_s=1, length_s=2, size=SIZE, theme="light"
    )
    shown = pictures(path)
    assert len(shown) == 60
    samples = sound(path)
    assert abs(len(samples) / 22050 - 2) < 0.06
    # The music is that of the same time; players and ffmpeg undo the delay of the encoder.
    signal = load_audio(source / "wavs" / f"{clip.music}.wav")
    there = resample(signal.samples, signal.sample_rate, 22050)[22050 : 3 * 22050]
    lags = range(-400, 401, 10)
    fits = [float(np.dot(samples[1000:40000], there[1000 + k : 40000 + k])) for k in lags]
    assert abs(list(lags)[int(np.argmax(fits))]) <= 30
    # The picture of a frame is the drawing of that frame, up to the encoder's loss.
    scenes = Scenes(ds)
    scene = scenes.scene(scenes.find(clip.id))
    music = AudioSignal(signal.samples[: round(scene.seconds * signal.sample_rate)], signal.sample_rate)
    frames = Frames(scene, SIZE, np.arange(30, 90) / 30, "light", require_shareable(ds), music)
    wanted = list(frames)[45][..., :3].astype(int)
    gaps = [np.abs(wanted - picture).mean() for picture in shown]
    assert int(np.argmin(gaps)) == 45
    assert min(gaps) < 4


def first_scene(demo: Path) -> Scene:
    scenes = Scenes(dancedata.open(demo))
    return scenes.scene(scenes.items[0])


def test_bodies_are_shaded_and_shadows_fade_with_height(demo: Path) -> None:
    scene = first_scene(demo)
    (picture,) = Frames(scene, (640, 480), np.zeros(1), "light")
    blue = picture[:390].astype(int)[picture[:390, :, 2] - picture[:390, :, 0].astype(int) > 60]
    assert len(blue) > 500
    assert len(np.unique(blue // 24, axis=0)) > 12  # strips from the edge to the highlight

    def shadow(lift: float) -> int:
        """Return how many pixels of the picture are shadow, of one dancer on the floor and one above it."""
        assert scene.figure is not None
        members = tuple(replace(scene, figure=scene.figure.shifted(by)) for by in ((0, 0, 0), (1.5, lift, 0)))
        (pair,) = Frames(replace(scene, members=members), (640, 480), np.zeros(1), "light")
        tones = pair[100:370, :, :3].astype(int)
        return int(((tones.max(axis=2) < 208) & (np.ptp(tones, axis=2) < 20)).sum())

    low, higher, high = (shadow(lift) for lift in (0.0, 0.6, 2.0))
    assert low - high > 1.5 * (higher - high) > 0
    assert high > 0.3 * low


def test_the_music_of_the_timeline_is_its_waveform(demo: Path) -> None:
    scene = first_scene(demo)
    samples = np.zeros(round(scene.seconds * 1000), np.float32)
    samples[len(samples) // 2 :: 2] = -0.4
    samples[3 * len(samples) // 4 :] *= 0.5
    music = AudioSignal(samples, 1000)
    scene = replace(scene, rhythm=replace(scene.rhythm, beats=np.zeros(0)))
    (picture,) = Frames(scene, (1280, 720), np.zeros(1), "dark", "", music)
    wave = (np.abs(picture[600:640, 200:1240, :3].astype(int) - (0x7A, 0x86, 0x98)).sum(axis=-1) < 40).sum(axis=0)
    quarter = [wave[240:480].mean(), wave[560:740].mean(), wave[830:1000].mean()]
    assert quarter[0] <= 2  # silence is a line
    assert quarter[2] == pytest.approx(quarter[1] / 2, rel=0.15)
    assert quarter[1] > 24


def test_music_needs_the_right(demo: Path, relabelled, tmp_path: Path) -> None:
    path = relabelled(lambda k: {}, {"source": {"reader": "aist++"}, "licence": "no redistribution"})
    clip = dancedata.open(path).clips()[0].id
    options = {"source": demo.parent / "demo-source", "length_s": 0.2, "size": SIZE}
    with raises_message(UsageError, "allow", where="relabelled"):
        plot.write_video(path, clip, tmp_path / "a.mp4", **options)
    assert not (tmp_path / "a.mp4").exists()
    plot.write_video(path, clip, tmp_path / "a.mp4", rights="granted to the tests", **options)
    assert b"on the statement of the maker of this file" in (tmp_path / "a.mp4").read_bytes()
    plot.write_video(path, clip, tmp_path / "silent.mp4", length_s=0.2, size=SIZE)
    assert len(pictures(tmp_path / "silent.mp4")) == 6


def test_equal_bytes(demo: Path, tmp_path: Path) -> None:
    clip = dancedata.open(demo).clips()[0].id
    files = [plot.write_video(demo, clip, tmp_path / f"{k}.mp4", length_s=0.3, size=SIZE) for k in "ab"]
    assert files[0].read_bytes() == files[1].read_bytes()


@pytest.mark.parametrize(("name", "options"), [
    ("a.avi", {}), ("no/a.mp4", {}), ("a.mp4", {"size": (101, 100)}), ("a.mp4", {"theme": "red"}),
    ("a.mp4", {"start_s": 99}), ("a.mp4", {"length_s": 0}), ("a.mp4", {"start_s": float("nan")}),
    ("a.mp4", {"length_s": float("inf")}),
])  # fmt: skip
def test_errors_say_what_is_allowed(demo: Path, tmp_path: Path, name: str, options: dict) -> None:
    clip = dancedata.open(demo).clips()[0].id
    with raises_message(UsageError, "exists|part|theme|video"):
        plot.write_video(demo, clip, tmp_path / name, **options)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_stays(demo: Path, tmp_path: Path) -> None:
    clip = dancedata.open(demo).clips()[0].id
    (tmp_path / "a.mp4").write_bytes(b"mine")
    with raises_message(UsageError, "already", where="a.mp4"):
        plot.write_video(demo, clip, tmp_path / "a.mp4")
    plot.write_video(demo, clip, tmp_path / "a.mp4", length_s=0.1, size=SIZE, overwrite=True)
    assert len(pictures(tmp_path / "a.mp4")) == 3


def test_without_ffmpeg_the_error_names_the_fix(demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clip = dancedata.open(demo).clips()[0].id
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", None)
    with raises_message(UsageError, "imageio_ffmpeg"):
        plot.write_video(demo, clip, tmp_path / "a.mp4")


# imageio-ffmpeg does not close the pipe of a program that has ended.
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    "script",
    ["exit 3", "cat > /dev/null; exit 1", "cat > /dev/null; for file; do :; done; head -c 99999 /dev/zero > $file"],
    ids=["start", "end", "silent"],
)
def test_an_ffmpeg_that_fails_leaves_nothing(demo, tmp_path, monkeypatch, script):
    program = tmp_path / "ffmpeg"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(program))
    monkeypatch.chdir(tmp_path)  # where imageio-ffmpeg tries an encoder, the last argument is "-"
    out = tmp_path / "out"
    out.mkdir()
    with raises_message(StoreError, "ffmpeg.* disk", where="out/a.mp4"):
        plot.write_video(demo, dancedata.open(demo).clips()[0].id, out / "a.mp4", length_s=0.2, size=SIZE)
    assert list(out.iterdir()) == []
    gc.collect()  # imageio-ffmpeg leaves the pipe open, which is a warning of whichever test runs then


def test_a_full_disk_leaves_nothing(demo: Path, tmp_path: Path) -> None:
    clip = dancedata.open(demo).clips()[0].id
    code = f"from dancedata import plot; plot.write_video({str(demo)!r}, {clip!r}, 'a.mp4', length_s=2, size={SIZE})"
    result = subprocess.run(
        ["sh", "-c", 'ulimit -f 8; exec "$@"', "sh", sys.executable, "-B", "-c", code],
        cwd=tmp_path, capture_output=True, text=True,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},  # they would be cut, too
    )  # fmt: skip
    assert "a.mp4: ffmpeg cannot write the video" in result.stderr
    assert "disk" in result.stderr
    assert list(tmp_path.iterdir()) == []


# Not at once: a signal in the instruction that makes a file or folder is not told its name.
@pytest.mark.parametrize("after", [0.05, 0.3])
def test_a_signal_leaves_nothing(demo: Path, tmp_path: Path, after: float) -> None:
    for name in ("out", "tmp"):
        (tmp_path / name).mkdir()
    clip = dancedata.open(demo).clips()[0].id
    process = subprocess.Popen(
        [sys.executable, "-m", "dancedata", "view", demo, clip, "--out", tmp_path / "out" / "a.mp4"],
        env={**os.environ, "TMPDIR": str(tmp_path / "tmp")},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while process.poll() is None and not list((tmp_path / "out").iterdir()):
        time.sleep(0.01)
    time.sleep(after)
    process.terminate()
    printed, errors = process.communicate(timeout=60)
    assert (process.returncode, printed) == (128 + signal.SIGTERM, "")
    assert errors.endswith(f"{interrupts.LINE}\n")
    assert [list((tmp_path / name).iterdir()) for name in ("out", "tmp")] == [[], []]


@pytest.mark.parametrize("fps", ["30000/1001", 60])
def test_the_rate_is_exact(demo: Path, tmp_path: Path, fps: int | str) -> None:
    motion = dancedata.decode(dancedata.open(demo).clips()[0].read("edge151")[:12], "edge151", fps=fps)
    plot.write_video({"mine": motion}, "", tmp_path / "a.mp4", size=SIZE)
    assert len(pictures(tmp_path / "a.mp4")) == 12
    meta = next(imageio_ffmpeg.read_frames(str(tmp_path / "a.mp4")))
    assert meta["fps"] == pytest.approx(float(Fraction(fps)), abs=0.01)
    assert meta["duration"] == pytest.approx(12 / Fraction(fps), abs=0.01)


def test_a_folder_that_cannot_be_written_is_an_error_with_its_name(demo: Path) -> None:
    clip = dancedata.open(demo).clips()[0].id
    with pytest.raises(StoreError, match=r"/proc/a\.mp4.*cannot be written"):
        plot.write_video(demo, clip, "/proc/a.mp4", length_s=0.1, size=SIZE)
    with raises_message(UsageError, "listed", where="demo/a.mp4"):
        plot.write_video(demo, clip, demo / "a.mp4", length_s=0.1, size=SIZE)
