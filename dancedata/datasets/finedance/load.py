"""One FineDance motion file -> canonical motion; each defect has a reason code."""

from pathlib import Path

from dancedata.core.bodies import SMPLX52
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.skeleton import Skeleton
from dancedata.datasets._rotations import check_rows, rotations_of
from dancedata.datasets.finedance.facts import MAX_DIFFERENCE
from dancedata.datasets.motion_checks import DOWNLOAD_AGAIN, no_frames, require_finite
from dancedata.files.regular_file import open_regular
from dancedata.formats.arrays import ArrayFile
from dancedata.formats.values import open_arrays


def length_note(motion: Path, music: Path, frame_rate: int) -> str:
    """Return both lengths if they differ by more than `MAX_DIFFERENCE` frames; "" if not, or if one is unknown.

    The length of an unreadable file is unknown; loading it reports the error.
    """
    frames, (n_samples, sample_rate) = motion_length(motion), _music_length(music)
    if frames is None or not n_samples:
        return ""
    # The rows of audio features: one for every frame that begins within the audio.
    rows = FrameGrid.of(sample_rate).rows_up(n_samples, of=FrameGrid.of(frame_rate))
    if abs(frames - rows) <= MAX_DIFFERENCE:
        return ""
    return f"motion {frames / frame_rate:.2f} s, music {n_samples / sample_rate:.2f} s"


def _music_length(path: Path) -> tuple[int, int]:
    """Return samples and sample rate in the header; 0 samples if the length is unknown."""
    import soundfile

    try:
        with open_regular(path) as file:
            info = soundfile.info(file)
    except (soundfile.SoundFileError, OSError, ValueError, TypeError):
        return 0, 1
    return max(int(info.frames), 0), max(int(info.samplerate), 1)


JOINTS = SMPLX52.n_joints
COLUMNS = 3 + 6 * JOINTS


def load_motion(path: Path, frame_rate: int, skeleton: Skeleton, trim_start: int = 0) -> Motion:
    """Read a (T, 315) array: translation 3, then 52 joints x 6D (two rows of each matrix).

    `path`: .npy file. Nothing in it is executed; its header is checked before memory is allocated.
    `frame_rate`: Frames per second, 30 for FineDance.
    `skeleton`: SMPL-X's 55 joints with the bones to use.
    `trim_start`: First frame of the dance.
    Returns: rotations (T, 55, 3) axis-angle in radians, jaw and eyes zero; translation (T, 3) in metres as in the
        file; +Y up. The 6D columns of the result equal the file's within the precision of float32.
    Raises DataError: reason ``broken_file``, ``unsafe_pickle``, ``too_large``, ``bad_shape``, ``empty``, ``nan``,
        ``bad_rotation`` or ``too_short`` (no frame is left after the trim).
    """
    with open_arrays(path) as arrays:
        _length(arrays)
        array = arrays.read("")
    require_finite(path, "the motion", array, DOWNLOAD_AGAIN, columns=True)
    rows = array[:, 3:].reshape(len(array), JOINTS, 6)
    check_rows(path, rows)
    if trim_start >= len(array):
        raise DataError("no frame of the motion is left after the trim", reason="too_short", where=str(path),
                        found=f"{len(array)} frames, the first {trim_start} of them to be trimmed",
                        fix="check that this is the file of that id, or set trim: false")  # fmt: skip
    return Motion(array[:, :3], rotations_of(rows), FrameGrid.of(frame_rate), skeleton, trim_start)


def motion_length(path: Path) -> int | None:
    """Return the number of frames in the file's header; None if the file is not a readable motion."""
    try:
        with open_arrays(path) as arrays:
            return _length(arrays)
    except DataError:
        return None


def _length(arrays: ArrayFile) -> int:
    """Check the shape in the header, (T, 315), and return T."""
    shape = arrays.shape("")
    if len(shape) != 2 or shape[1] != COLUMNS:
        raise DataError("the motion file has the wrong shape", reason="bad_shape", where=str(arrays.path),
                        found=str(shape),
                        allowed=f"(T, {COLUMNS}) of floats: translation 3, then {JOINTS} joints x 6D",
                        fix=_shape_advice(shape))  # fmt: skip
    if shape[0] == 0:
        raise no_frames(arrays.path)
    return shape[0]


def _shape_advice(shape: tuple[int, ...]) -> str:
    """Return the fix for the most likely cause of a wrong shape."""
    if len(shape) == 2 and shape[1] == COLUMNS + 4:
        return (
            "319 columns are features made by the scripts of FineDance or Lodge (contacts first; Lodge's are also "
            "trimmed and grounded): use the motion/ folder as published"
        )
    if len(shape) == 2 and shape[0] == COLUMNS:
        return "rows and columns are swapped: transpose the array"
    return DOWNLOAD_AGAIN
