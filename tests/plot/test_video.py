"""Videos: as many pictures as frames, as much sound as pictures, and only music that may be shared."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata import plot
from dancedata.cli import interrupts
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import StoreError, UsageError
from dancedata.plot import video as mux
from dancedata.plot.bodies import draw_shadow
from dancedata.plot.frames import Camera, Frames
from dancedata.plot.video import find_ffmpeg
from dancedata.store.licence import require_shareable
from dancedata.viewer import Scenes
from tests.messages import raises_message

pytest.importorskip("PIL")
pytest.importorskip("imageio_ffmpeg")
SIZE = (192, 160)


def decoded(path: Path, *options: str) -> bytes:
    command = [find_ffmpeg(), "-loglevel", "error", "-i", str(path), *options, "pipe:1"]
    return subprocess.run(command, check=True, capture_output=True).stdout


def pictures(path: Path) -> np.ndarray:
    data = decoded(path, "-f", "rawvideo", "-pix_fmt", "rgb24", "-fps_mode", "passthrough")
    return np.frombuffer(data, np.uint8).reshape(-1, SIZE[1], SIZE[0], 3)


def sound(path: Path) -> np.ndarray:
    return np.frombuffer(decoded(path, "-f", "f32le", "-ac", "1", "-ar", "22050"), np.float32)


def test_a_video_has_the_frames_and_the_sound_of_its_clip(demo: Path, tmp_path: Path) -> None:
    ds = dancedata.open(demo)
    clip = ds.clips[0]
    source = demo.parent / "demo-source"
    path = plot.write_video(
        ds, clip.id, tmp_path / "a.mp4", source=source, start_s=1, length_s=2, size=SIZE, theme="light"
    )
    shown = pictures(path)
    assert len(shown) == 60
    samples = sound(path)
    assert abs(len(samples) / 22050 - 2) < 0.06
    # The music is that of the same time; players and ffmpeg undo the delay of the encoder.
    wav = dancedata.AudioSignal
    from dancedata.audio.signal import load_audio, resample

    signal = load_audio(source / "wavs" / f"{clip.music}.wav")
    assert isinstance(signal, wav)
    there = resample(signal.samples, signal.sample_rate, 22050)[22050 : 3 * 22050]
    lags = range(-400, 401, 10)
    fits = [float(np.dot(samples[1000:40000], there[1000 + k : 40000 + k])) for k in lags]
    assert abs(list(lags)[int(np.argmax(fits))]) <= 30
    # The picture of a frame is the drawing of that frame, up to the encoder's loss.
    scenes = Scenes(ds)
    scene = scenes.scene(scenes.find(clip.id))
    music = AudioSignal(signal.samples[: round(scene.seconds * signal.sample_rate)], signal.sample_rate)
    frames = Frames(scene, scene.figure, SIZE, np.arange(30, 90) / 30, "light", require_shareable(ds), music)
    wanted = np.asarray(frames.image(45)).astype(int)
    gaps = [np.abs(wanted - picture).mean() for picture in shown]
    assert int(np.argmin(gaps)) == 45
    assert min(gaps) < 4


def test_the_dancer_is_drawn_where_the_joints_are(demo: Path) -> None:
    scenes = Scenes(dancedata.open(demo))
    scene = scenes.scene(scenes.items[0])
    frames = Frames(scene, scene.figure, (640, 480), np.arange(scene.figure.n_frames) / 30, "dark")
    picture = np.asarray(frames.image(20))[:390]
    left, right = (
        (np.abs(picture.astype(int) - rgb).sum(axis=2) < 12).sum() for rgb in ((122, 204, 248), (212, 133, 0))
    )
    assert left > 300
    assert right > 300
    moved = np.asarray(frames.image(60))[:390]
    assert (picture != moved).any()
    np.testing.assert_array_equal(np.asarray(frames.image(20))[:390], picture)


def test_bodies_are_shaded_and_shadows_fade_with_height(demo: Path) -> None:
    from PIL import Image, ImageDraw

    scenes = Scenes(dancedata.open(demo))
    scene = scenes.scene(scenes.items[0])
    assert scene.figure is not None

    frames = Frames(scene, scene.figure, (640, 480), np.zeros(1), "light")
    picture = np.asarray(frames.image(0))[:390].astype(int)
    blue = picture[picture[..., 2] - picture[..., 0] > 60]
    assert len(blue) > 500
    assert len(np.unique(blue // 24, axis=0)) > 12  # strips from the edge to the highlight

    def darkness(lift: float) -> float:
        image = Image.new("L", (640, 480), "white")
        figure = replace(scene.figure, joints=scene.figure.joints + np.array([0, lift, 0]))
        root, floor = scene.figure.joints[0, 0], scene.figure.floor
        camera = Camera(640, 480, (root[0], floor, root[2]))
        draw_shadow(ImageDraw.Draw(image), camera, figure, 0, floor, "#000000", "#ffffff")
        return float(255 - np.asarray(image).min())

    assert darkness(0.0) > 200
    assert 30 < darkness(0.6) < 0.4 * darkness(0.0)
    assert darkness(2.0) == 0


def test_the_music_of_the_timeline_is_its_waveform(demo: Path) -> None:
    scenes = Scenes(dancedata.open(demo))
    scene = scenes.scene(scenes.items[0])
    assert scene.figure is not None
    samples = np.zeros(round(scene.seconds * 1000), np.float32)
    samples[len(samples) // 2 :: 2] = -0.4
    samples[3 * len(samples) // 4 :] *= 0.5
    music = AudioSignal(samples, 1000)
    scene = replace(scene, rhythm=replace(scene.rhythm, beats=np.zeros(0)))
    frames = Frames(scene, scene.figure, (1280, 720), np.zeros(1), "dark", "", music)
    picture = np.asarray(frames.image(0)).astype(int)
    wave = (np.abs(picture[600:, 200:1240] - (0x7A, 0x86, 0x98)).sum(axis=-1) < 40)[:40].sum(axis=0)
    quarter = [wave[240:480].mean(), wave[560:740].mean(), wave[830:1000].mean()]
    assert quarter[0] <= 2  # silence is a line
    assert quarter[2] == pytest.approx(quarter[1] / 2, rel=0.15)
    assert quarter[1] > 24


def test_music_needs_the_right(demo: Path, relabelled, tmp_path: Path) -> None:
    path = relabelled(lambda k: {}, {"dataset": "aist++", "licence": "no redistribution"})
    clip = dancedata.open(path).clips[0].id
    options = {"source": demo.parent / "demo-source", "length_s": 0.2, "size": SIZE}
    with raises_message(UsageError, "allow", where="relabelled"):
        plot.write_video(path, clip, tmp_path / "a.mp4", **options)
    assert not (tmp_path / "a.mp4").exists()
    plot.write_video(path, clip, tmp_path / "a.mp4", may_share=True, **options)
    assert b"on the statement of the maker of this file" in (tmp_path / "a.mp4").read_bytes()
    plot.write_video(path, clip, tmp_path / "silent.mp4", length_s=0.2, size=SIZE)
    assert len(pictures(tmp_path / "silent.mp4")) == 6


def test_equal_bytes(demo: Path, tmp_path: Path) -> None:
    clip = dancedata.open(demo).clips[0].id
    files = [plot.write_video(demo, clip, tmp_path / f"{k}.mp4", length_s=0.3, size=SIZE) for k in "ab"]
    assert files[0].read_bytes() == files[1].read_bytes()


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a.avi", {}),
        ("no/a.mp4", {}),
        ("a.mp4", {"size": (101, 100)}),
        ("a.mp4", {"theme": "red"}),
        ("a.mp4", {"start_s": 99}),
        ("a.mp4", {"length_s": 0}),
        ("a.mp4", {"start_s": float("nan")}),
        ("a.mp4", {"length_s": float("inf")}),
    ],
)
def test_errors_say_what_is_allowed(demo: Path, tmp_path: Path, name: str, options: dict) -> None:
    clip = dancedata.open(demo).clips[0].id
    with raises_message(UsageError, "exists|part|theme|video"):
        plot.write_video(demo, clip, tmp_path / name, **options)
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_stays(demo: Path, tmp_path: Path) -> None:
    clip = dancedata.open(demo).clips[0].id
    (tmp_path / "a.mp4").write_bytes(b"mine")
    with raises_message(UsageError, "already", where="a.mp4"):
        plot.write_video(demo, clip, tmp_path / "a.mp4")
    plot.write_video(demo, clip, tmp_path / "a.mp4", length_s=0.1, size=SIZE, overwrite=True)
    assert len(pictures(tmp_path / "a.mp4")) == 3


def test_without_ffmpeg_the_error_names_the_fix(demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clip = dancedata.open(demo).clips[0].id
    monkeypatch.setattr(mux.shutil, "which", lambda name: None)
    monkeypatch.setitem(__import__("sys").modules, "imageio_ffmpeg", None)
    with raises_message(UsageError, "imageio_ffmpeg"):
        plot.write_video(demo, clip, tmp_path / "a.mp4")


def test_an_ffmpeg_that_fails_leaves_nothing(demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = _ffmpeg(tmp_path / "bin", "echo 'Unknown encoder libx264' >&2; exit 3")
    monkeypatch.setattr(mux.shutil, "which", lambda name: str(program))
    clip = dancedata.open(demo).clips[0].id
    out = tmp_path / "out"
    out.mkdir()
    with raises_message(StoreError, "ffmpeg", where="out/a.mp4"):
        plot.write_video(demo, clip, out / "a.mp4", length_s=1, size=SIZE)
    assert list(out.iterdir()) == []


def _ffmpeg(folder: Path, script: str) -> Path:
    folder.mkdir()
    program = folder / "ffmpeg"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    return program


@pytest.mark.parametrize(
    "script",
    ["echo 'Error writing trailer: No space left on device' >&2; exit 1", "kill -XFSZ $$"],
    ids=["message", "signal"],
)
def test_a_full_disk_is_not_the_fault_of_ffmpeg(
    demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str
) -> None:
    program = str(_ffmpeg(tmp_path / "bin", script))
    monkeypatch.setattr(mux.shutil, "which", lambda name: program)
    out = tmp_path / "out"
    out.mkdir()
    with raises_message(StoreError, "video", where="out/a.mp4"):
        plot.write_video(demo, dancedata.open(demo).clips[0].id, out / "a.mp4", length_s=0.1, size=SIZE)
    assert list(out.iterdir()) == []


def test_a_signal_leaves_nothing(demo: Path, tmp_path: Path) -> None:
    # The pipe fills up, and the command waits.
    _ffmpeg(tmp_path / "bin", f"echo $$ > {tmp_path}/pid; while kill -0 $PPID; do sleep 0.1; done")
    for name in ("out", "tmp"):
        (tmp_path / name).mkdir()
    clip = dancedata.open(demo).clips[0].id
    process = subprocess.Popen(
        [sys.executable, "-m", "dancedata", "view", demo, clip, "--video", tmp_path / "out" / "a.mp4"],
        env={**os.environ, "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}", "TMPDIR": str(tmp_path / "tmp")},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    while process.poll() is None and not (tmp_path / "pid").is_file():
        time.sleep(0.01)
    process.terminate()
    printed, errors = process.communicate(timeout=60)
    assert (process.returncode, printed, errors) == (128 + signal.SIGTERM, "", f"{interrupts.LINE}\n")
    assert not Path("/proc", (tmp_path / "pid").read_text().strip()).exists()
    assert [list((tmp_path / name).iterdir()) for name in ("out", "tmp")] == [[], []]


def test_a_folder_that_cannot_be_written_is_an_error_with_its_name(demo: Path) -> None:
    clip = dancedata.open(demo).clips[0].id
    with pytest.raises(StoreError, match=r"/proc/a\.mp4.*cannot be written"):
        plot.write_video(demo, clip, "/proc/a.mp4", length_s=0.1, size=SIZE)
    with raises_message(UsageError, "listed", where="demo/a.mp4"):
        plot.write_video(demo, clip, demo / "a.mp4", length_s=0.1, size=SIZE)
