"""write_video: a clip with its music as an mp4 file, for papers and user studies."""

import io
import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.packages import load, require
from dancedata.core.rotations import Float64Array
from dancedata.core.system import shielded
from dancedata.core.terms import require_shareable
from dancedata.core.text import shown
from dancedata.files import atomic
from dancedata.files.atomic import require_free
from dancedata.formats.body_mesh import BodyMesh
from dancedata.kernel import Store, open_store
from dancedata.plot.frames import Frames
from dancedata.plot.timeline import THEMES
from dancedata.scene.figure import Figure
from dancedata.scene.motion_page import PlayedMotion, motion_scenes_of
from dancedata.scene.palette import Theme
from dancedata.scene.scene_list import Scene
from dancedata.scene.scenes import Scenes
from dancedata.scene.selection import ViewRequest, ViewSelection
from dancedata.scene.source import ClipSound, ClipSource


def _write_mp4(
    path: Path,
    frames: Iterable[npt.NDArray[np.uint8]],
    size: tuple[int, int],
    rate: Fraction,
    sound: AudioSignal | None,
    *,
    comment: str = "",
) -> None:
    """Write RGBA frames (height, width, 4) as H.264 and a sound as AAC; no date and no version is stored."""
    ffmpeg = load("imageio_ffmpeg", "video")
    exact = f"{rate.numerator}/{rate.denominator}"
    with atomic.atomic_file(path) as temporary, TemporaryDirectory(prefix="dancedata-video-") as folder:
        wav = Path(folder, "sound.wav")
        if sound is not None:
            _write_wav(wav, sound)
        options = {} if sound is None else {"audio_path": str(wav), "audio_codec": "aac"}
        output = ["-preset", "veryfast", "-crf", "20", "-movflags", "+faststart", "-fflags", "+bitexact",
                  "-flags:v", "+bitexact", "-flags:a", "+bitexact", "-map_metadata", "-1",
                  "-metadata", f"comment={comment}", "-f", "mp4"]  # fmt: skip
        output += ["-b:a", "160k"] if sound is not None else []
        writer = ffmpeg.write_frames(
            str(temporary), size, pix_fmt_in="rgba", fps=float(rate), input_params=["-r", exact], codec="libx264",
            quality=None, macro_block_size=2, ffmpeg_log_level="error", output_params=output, **options,
        )  # fmt: skip
        try:
            with shielded():  # a signal while ffmpeg starts would leave it running
                writer.send(None)
            count = sum(1 for frame in frames if writer.send(frame) is None)
            writer.close()  # waits for ffmpeg, but does not tell how it ended: the file is asked what it holds
            held, _ = ffmpeg.count_frames_and_secs(str(temporary))
        except (OSError, RuntimeError) as error:
            lines = str(error).replace(str(temporary), path.name).strip().splitlines()
            raise _failed(path, lines[0 if isinstance(error, OSError) else -1]) from error
        finally:
            writer.close()
        if held != count:
            raise _failed(path, f"{held} of {count} frames")


def _failed(path: Path, found: str) -> StoreError:
    fix = "name a file on a disk with free space; an ffmpeg in IMAGEIO_FFMPEG_EXE must have libx264 and aac"
    return StoreError("ffmpeg cannot write the video", where=path, found=shown(found, 600), fix=fix)


def _write_wav(path: Path, sound: AudioSignal) -> None:
    import soundfile

    data = io.BytesIO()  # soundfile reports a full disk as an error of another type
    soundfile.write(data, sound.samples, sound.sample_rate, subtype="PCM_16", format="WAV")
    with data.getbuffer() as content:
        path.write_bytes(content)


#: Smallest and largest side of the picture, pixels; H.264 needs even ones.
_SIDES = (128, 4096)


def write_scene(
    target: Path,
    scene: Scene,
    sound: ClipSound | None,
    *,
    size: tuple[int, int],
    theme: Theme = "dark",
    start_s: float = 0.0,
    length_s: float | None = None,
    credit: str = "",
) -> Path:
    """Write a scene as a video; arguments and errors are those of `write_video`."""
    _require_drawable(size, theme)
    figure = next((dancer.figure for dancer in scene.dancers), None)
    if figure is None:
        raise UsageError("nothing of this clip can be drawn", where=scene.item.id, found="; ".join(scene.notes))
    times = _times(scene, figure, start_s, length_s)
    music = None if sound is None else _part(sound.signal, times, figure)
    frames = Frames(scene, size, times, theme, credit, None if sound is None else sound.signal)
    try:
        _write_mp4(target, frames, size, figure.grid.rate, music, comment=credit)
    except OSError as error:
        fix = "name a file in a folder that you can write to, on a disk with free space; nothing was left there"
        raise StoreError("the video cannot be written", where=target, found=str(error), fix=fix) from error
    return target


def write_video(
    store: Store | str | Path | PlayedMotion,
    clip: str,
    path: str | Path,
    *,
    music: str | Path | None = None,
    source: str | Path | None = None,
    field: str | None = None,
    start_s: float = 0.0,
    length_s: float | None = None,
    size: tuple[int, int] = (1280, 720),
    theme: Theme = "dark",
    body_model: str | Path | None = None,
    betas: npt.ArrayLike | None = None,
    rights: str | None = None,
    overwrite: bool = False,
) -> Path:
    """Write a clip or a group as a video: the dancers, and below music, speed and contacts in time.

    Parameters
    ----------
    store
        A built dataset, open or its folder; or a Motion, or several by name.
    clip
        Id of a clip, or name of a group; of motions their name, "" for the first.
    path
        File to write, ``.mp4``.
    music
        Of motions: a music file, or folder of files named as they are; None: a silent video.
    source
        Of a dataset: folder with the music that it was built from; None: a silent video.
    field
        Motion field to draw; default: the best one.
    start_s, length_s
        Part of the clip, seconds; default: all of it.
    size
        Width and height, pixels.
    theme
        "dark" or "light".
    body_model, betas
        File of SMPL, SMPL-H or SMPL-X that is drawn in the place of limbs, and its shape (n,); default: its mean.
    rights
        Why the caller may pass the music on where the dataset's licence does not allow it; it is published.
    overwrite
        Replace an existing file.

    Returns
    -------
    Path
        The file: one picture per frame of the motion, at its rate, and the music of the same time.

    Raises
    ------
    UsageError
        If matplotlib or ffmpeg is not installed, the licence does not allow the music to be passed on, there is no
        music for the clip, or an argument is invalid.
    DataError, StoreError
        If the clip or the music cannot be read, or the file cannot be written.

    Examples
    --------
    >>> from dancedata import plot
    >>> plot.write_video("data/demo", "gBR_sBM_cAll_d04_mBR4_ch03", "dance.mp4", source="data/demo-source")
    PosixPath('dance.mp4')
    """
    target = Path(path)
    _require_video_name(target)
    _require_drawable(size, theme)
    part: dict[str, Any] = {"start_s": start_s, "length_s": length_s}
    mesh = None if body_model is None else BodyMesh.read(body_model, betas)

    def drawn(scene: Scene) -> Scene:
        return scene if mesh is None else scene.with_mesh(mesh)

    if not isinstance(store, Store | str | Path):
        motions = motion_scenes_of(store, music)
        item = motions.find(clip) if clip else motions.items[0]
        target = require_free(target, [], "video", overwrite=overwrite)
        return write_scene(target, drawn(motions.scene(item)), motions.sound(item), size=size, theme=theme, **part)
    ds = store if isinstance(store, Store) else open_store(store)
    target = require_free(target, [ds.path], "video", overwrite=overwrite)
    credit = "" if source is None else require_shareable(ds, rights=rights)
    scenes = Scenes(ds, field)
    item = scenes.find(clip)
    sound = None
    if source is not None:
        sound = ClipSource(ds, Path(source).expanduser()).sound(item)
        if sound is None:
            raise UsageError("there is no music for this clip", where=source, found=f"clip {shown(item.id)}")
    return write_scene(target, drawn(scenes.scene(item)), sound, size=size, theme=theme, credit=credit, **part)


def export_video(
    request: ViewRequest,
    to: Path,
    *,
    size: str = "1280x720",
    silent: bool = False,
    rights: str | None = None,
    overwrite: bool = False,
    say: Callable[[str], None] = print,
) -> Path:
    """Write one clip as a video; what it is compared with stands beside it, or over it."""
    _require_video_name(to)
    sides = size.lower().split("x")
    if len(sides) != 2 or not all(side.isdecimal() for side in sides):
        raise UsageError("invalid size of a video", found=size, allowed="WIDTHxHEIGHT, such as 1080x1920")
    pixels = int(sides[0]), int(sides[1])
    _require_drawable(pixels, "dark")
    to = require_free(to, [request.path], "video", overwrite=overwrite)
    mesh = request.mesh()
    opened = ViewSelection.of(replace(request, wall=request.wall or bool(request.compare)))
    if not request.clip and len(opened.scenes.items) > 1:
        raise UsageError("a video shows one clip, group or wall",
                         fix="name it: dancedata view DATASET CLIP --out FILE.mp4")  # fmt: skip
    signal, notice, line = opened.music_to_pass_on(rights, silent=silent)
    say(line)
    sound, credit = None if signal is None else ClipSound(signal), f"{opened.credit} {notice}".strip()
    scene = opened.scenes.scene(opened.item, request.field)
    scene = scene if mesh is None else scene.with_mesh(mesh)
    for note in scene.notes:
        say(f"  note: {note}")
    if request.mirrored:
        scene = scene.mirrored()
    begin, end = opened.span
    return write_scene(to, scene, sound, size=pixels, start_s=begin, length_s=end, credit=credit)


def _require_video_name(path: Path) -> None:
    if path.suffix.lower() != ".mp4":
        raise UsageError("a video is an mp4 file", found=shown(path.name), allowed="a name that ends in .mp4")


def _require_drawable(size: tuple[int, int], theme: str) -> None:
    low, high = _SIDES
    if not all(low <= n <= high and n % 2 == 0 for n in size):
        raise UsageError("invalid size of a video", found=f"{size}", allowed=f"even numbers from {low} to {high}")
    if theme not in THEMES:
        raise UsageError("unknown theme", found=shown(theme), allowed=" or ".join(THEMES))
    require("video", ["imageio_ffmpeg", "matplotlib"], what="a video")


def _times(scene: Scene, figure: Figure, start_s: float, length_s: float | None) -> Float64Array:
    """Return the instants of the frames of a part of a clip."""
    rate = float(figure.grid.rate)
    finite = math.isfinite(start_s) and math.isfinite(length_s or 0.0)
    first = round(start_s * rate) if finite else -1
    last = figure.n_frames if length_s is None or not finite else min(figure.n_frames, first + round(length_s * rate))
    if not 0 <= first < last:
        raise UsageError("this part of the clip has no frames", where=f"clip {shown(scene.item.id)}",
                         found=f"from {start_s:g} s" + ("" if length_s is None else f", {length_s:g} s long"),
                         allowed=f"within 0 to {figure.n_frames / rate:.2f} s")  # fmt: skip
    return np.arange(first, last) / rate


def _part(music: AudioSignal, times: Float64Array, figure: Figure) -> AudioSignal:
    """Return the music of the frames; silence where it ends before them."""
    first = round(float(times[0]) * music.sample_rate)
    n = round(float(figure.grid.seconds(len(times))) * music.sample_rate)
    part = music.samples[first : first + n]
    return AudioSignal(np.pad(part, (0, n - len(part))), music.sample_rate)
