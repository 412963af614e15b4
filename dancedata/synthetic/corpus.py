"""The corpus on disk: AIST++ in its official layout, with ground truth and a marker with its parameters."""

from __future__ import annotations

import dataclasses
import io
import json
import pickle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dancedata.core.errors import SourceError
from dancedata.core.motion import Motion
from dancedata.core.text import listed, shown
from dancedata.files import atomic
from dancedata.files.locks import writing_lock
from dancedata.files.regular_file import read_regular
from dancedata.files.strict_json import read_json
from dancedata.synthetic.plan import ClipPlan, Plan, SongPlan, generator, make_plan, music_of

if TYPE_CHECKING:
    from dancedata.synthetic.motion import MotionTruth
    from dancedata.synthetic.music import SyntheticSong

#: Incremented whenever the bytes for equal parameters change.
VERSION = 1
MARKER = "synthetic.json"
_MAX_MARKER_BYTES = 1 << 16
_UNFINISHED = "synthetic.partial.json"


def write_synthetic(
    folder: Path | str, *, seed: int = 0, songs: int = 11, clips_per_song: int = 4, clip_s: float = 13.5
) -> Path:
    """Write the corpus into `folder`, unless it already contains this corpus.

    The next call resumes an interrupted one. Equal arguments give equal bytes, and no clip or song depends on the
    number of others.

    Parameters
    ----------
    folder
        Created if missing; otherwise it must be empty or contain this corpus.
    seed, songs, clips_per_song, clip_s
        As in the dataset `synthetic`.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    SourceError
        If the folder contains something else, or a synthetic corpus with other parameters, or is not writable.
    UsageError
        If a parameter is out of range.

    Examples
    --------
    >>> from dancedata.synthetic import write_synthetic
    >>> folder = write_synthetic("synthetic", songs=2, clips_per_song=2, clip_s=6)
    >>> sorted(path.name for path in folder.iterdir())
    ['cameras', 'ignore_list.txt', 'motions', 'splits', 'synthetic.json', 'truth', 'wavs']
    """
    made_by = _made_by(seed, songs, clips_per_song, clip_s)
    _write(Path(folder), make_plan(songs, clips_per_song, clip_s), made_by)
    return Path(folder)


def write_example(
    folder: Path | str, *, seed: int = 0, songs: int = 11, clips_per_song: int = 4, clip_s: float = 13.5
) -> None:
    """Write the example of a corpus: four clips of six seconds, two of train, one of val, one of test; two songs."""
    made_by = {**_made_by(seed, songs, clips_per_song, clip_s), "example": True}
    _write(Path(folder), make_plan(songs=2, clips_per_song=2, clip_s=6.0), made_by)


def is_example(folder: Path, *, seed: int, songs: int, clips_per_song: int, clip_s: float) -> bool:
    """Return whether a folder contains the complete example of a corpus."""
    return _matching_marker(folder, {**_made_by(seed, songs, clips_per_song, clip_s), "example": True}) == MARKER


def _made_by(seed: int, songs: int, clips_per_song: int, clip_s: float) -> dict[str, Any]:
    made_by = {"version": VERSION, "seed": seed, "songs": songs, "clips_per_song": clips_per_song}
    return {**made_by, "clip_s": float(clip_s)}


def synthesise_song(
    music: str, *, seed: int = 0, length_s: float = 14.5, sample_rate: int = 48_000, n_channels: int = 2
) -> SyntheticSong:
    """Generate one song in memory.

    Parameters
    ----------
    music
        AIST++ music id, which encodes the tempo: ``mBR0`` or ``BR0``.
    length_s
        Seconds. The beats do not depend on it.

    Returns
    -------
    SyntheticSong
        .signal (mono AudioSignal), .pcm (n, channels) int16, .beat_times_s, .downbeat_times_s, .chord_roots,
        .tempo_bpm.

    Raises
    ------
    UsageError
        If `music` is not an AIST++ music id.

    Examples
    --------
    >>> from dancedata.synthetic import synthesise_song
    >>> synthesise_song("mBR0", length_s=2).signal
    AudioSignal(96000 samples at 48000 Hz, 2.00 s)
    """
    from dancedata.synthetic.music import make_song

    return make_song(SongPlan(music_of(music), sample_rate, n_channels, length_s), seed)


def synthesise_motion(name: str, *, seed: int = 0, n_frames: int = 810) -> tuple[Motion, MotionTruth]:
    """Generate one clip in memory, in full precision (files are float32).

    Parameters
    ----------
    name
        AIST++ clip name, such as ``gBR_sBM_cAll_d04_mBR0_ch01``; its song defines the beats.
    n_frames
        Length in frames at 60 per second.

    Returns
    -------
    (Motion, MotionTruth)
        MotionTruth: .beat_times_s, .beat_frames, .key_frames, .planted (N, 4), .moving (N, 4),
        .foot_positions (N, 4, 3), .floor_height_m.

    Raises
    ------
    UsageError
        If the name contains no AIST++ music id.

    Examples
    --------
    >>> from dancedata.synthetic import synthesise_motion
    >>> motion, truth = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=120)
    >>> motion
    Motion(120 frames at 60 FPS, 2.00 s, skeleton smpl24)
    """
    from dancedata.synthetic.motion import make_motion

    return make_motion(name, n_frames, seed)


def _write(folder: Path, plan: Plan, made_by: dict[str, Any]) -> None:
    """Write the planned files unless they exist; a second writer waits for the first."""
    if _check_folder(folder, made_by):
        return
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with writing_lock(folder, "process", wait=True):
            if not _check_folder(folder, made_by):
                _write_all(folder, plan, made_by)
    except OSError as error:
        raise SourceError("synthetic: the corpus is generated on first use, but cannot be written here",
                          where=str(folder), found=str(error),
                          fix="set SOURCE to a writable folder on a disk with enough space") from error  # fmt: skip


def _write_all(folder: Path, plan: Plan, made_by: dict[str, Any]) -> None:
    _claim(folder, made_by)
    _write_lists(folder, plan)
    for song in plan.songs:
        _write_song(folder, song, made_by["seed"])
    for clip in plan.clips:
        _write_clip(folder, clip, made_by["seed"])
    atomic.write_json(folder / MARKER, made_by)
    (folder / _UNFINISHED).unlink()


def _matching_marker(folder: Path, made_by: dict[str, Any]) -> str | None:
    """Return the marker in the folder that has exactly these parameters, if there is one."""
    for name in (MARKER, _UNFINISHED):
        try:
            content = read_json(folder / name, _MAX_MARKER_BYTES)
        except (OSError, ValueError):
            continue
        if content == made_by:
            return name
    return None


def _check_folder(folder: Path, made_by: dict[str, Any]) -> bool:
    """Return whether the complete corpus exists (True) or may be written (False); else SourceError."""
    if folder.exists() and not folder.is_dir():
        raise SourceError(
            "synthetic: the source is not a folder", where=str(folder), fix="set SOURCE to a new folder"
        )
    names = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    names = [name for name in names if not atomic.is_temporary(name)]
    marker = _matching_marker(folder, made_by)
    if marker is not None or not names:
        return marker == MARKER
    existing = next((name for name in (MARKER, _UNFINISHED) if name in names), None)
    if existing is None:
        raise SourceError(
            "synthetic: the source folder contains files that this dataset did not write; nothing was changed",
            where=str(folder),
            found=listed(names, 8),
            allowed=f"a new folder, an empty folder, or one with a {MARKER}",
            fix="set SOURCE to a separate folder",
        )
    raise SourceError(
        "synthetic: the source folder contains a synthetic corpus with other parameters; nothing was changed",
        where=str(folder / existing),
        found=_marker_text(folder / existing),
        allowed=json.dumps(made_by),
        fix="use those parameters, delete the folder, or set SOURCE to another one",
    )


def _marker_text(path: Path) -> str:
    try:
        return shown(read_regular(path, _MAX_MARKER_BYTES).decode("utf-8", "replace").strip())
    except OSError as error:
        return shown(error)


def _claim(folder: Path, made_by: dict[str, Any]) -> None:
    """Create the folders; the marker of an incomplete corpus comes first, so that an interrupted write can resume."""
    folder.mkdir(parents=True, exist_ok=True)
    atomic.write_json(folder / _UNFINISHED, made_by)
    for name in ("motions", "wavs", "cameras", "splits", "truth"):
        (folder / name).mkdir(exist_ok=True)
    for left in folder.rglob("*"):
        if atomic.is_temporary(left.name):  # of a process that was killed
            left.unlink()


def _write_lists(folder: Path, plan: Plan) -> None:
    mapping = "".join(f"{clip.name} setting1\n" for clip in plan.clips)
    atomic.write_text(folder / "cameras" / "mapping.txt", mapping)
    for split in ("train", "val", "test"):
        text = "".join(f"{name}\n" for name in plan.names(split))
        atomic.write_text(folder / "splits" / f"crossmodal_{split}.txt", text)
    atomic.write_text(folder / "ignore_list.txt", "".join(f"{name}\n" for name in plan.ignored))


def _write_song(folder: Path, plan: SongPlan, seed: int) -> None:
    from dancedata.core.audio_signal import wav_bytes
    from dancedata.synthetic.music import make_song

    song = make_song(plan, seed)
    atomic.write_bytes(folder / "wavs" / f"m{plan.music}.wav", wav_bytes(song.pcm, plan.sample_rate))
    names = ("beat_times_s", "downbeat_times_s", "chord_roots", "tempo_bpm")
    truth = {name: np.asarray(getattr(song, name)) for name in names}
    _write_npz(folder / "truth" / f"m{plan.music}.npz", truth)


def _write_clip(folder: Path, plan: ClipPlan, seed: int) -> None:
    from dancedata.synthetic.motion import make_motion

    motion, truth = make_motion(plan.name, plan.n_frames, seed)
    rng = generator(seed, "scaling", plan.name)
    scaling = rng.uniform(89.0, 99.0, 1).astype(np.float32)
    content = {
        "smpl_loss": float(rng.uniform(1.0, 2.5)),
        "smpl_poses": motion.rotations.reshape(-1, 72).astype(np.float32),
        "smpl_scaling": scaling,
        "smpl_trans": (motion.translation * float(scaling[0])).astype(np.float32),
    }
    atomic.write_bytes(folder / "motions" / f"{plan.name}.pkl", pickle.dumps(content, protocol=4))
    arrays = {field.name: np.asarray(getattr(truth, field.name)) for field in dataclasses.fields(truth)}
    _write_npz(folder / "truth" / f"{plan.name}.npz", arrays)


def _write_npz(path: Path, arrays: dict[str, Any]) -> None:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    atomic.write_bytes(path, stream.getvalue())
