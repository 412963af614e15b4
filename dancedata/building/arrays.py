"""encode, and features of a song: one song or one motion, without a dataset."""

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import RecipeError, UsageError
from dancedata.core.grid import FrameGrid, Number
from dancedata.core.motion import Motion
from dancedata.core.registry import CONTACTS, FEATURES, REPRESENTATIONS
from dancedata.core.text import shown
from dancedata.execution.units import unit_runner
from dancedata.files.regular_file import sha256_file
from dancedata.recipes.plugins import make_named, single_plugin


def extract(feature: str, song: str | Path | AudioSignal, *, fps: Number = 30) -> npt.NDArray[Any]:
    """Compute an audio feature (T, D) of a whole song, as a build of whole clips does."""
    from dancedata.music.signal import load_audio

    plugin = make_named(FEATURES, "audio", feature, {}).resolved(sha256_file)
    signal = song if isinstance(song, AudioSignal) else load_audio(song)
    rows: npt.NDArray[Any] = unit_runner(plugin.exact)(plugin.extract, signal, FrameGrid.of(fps))
    return rows


def encode(
    motion: Motion, representation: str, *, contacts: Any = None, **parameters: Any
) -> npt.NDArray[np.float32]:
    """Encode a motion as the columns of a representation, at the motion's frame rate.

    Parameters
    ----------
    motion
        Translation in metres, rotations in radians, +Y up.
    representation
        Name of a registered representation, such as "edge151".
    contacts
        Contact rule: its name, or ``{name: {parameters}}``. Default: that of the representation.
    parameters
        Parameters of the representation, as in a recipe.

    Returns
    -------
    (T, D) array
        float32, a row per frame, not normalised.

    Raises
    ------
    UsageError
        For an unknown representation, rule or parameter, and for a `motion` that is not a Motion.
    DataError
        If the representation cannot hold this motion, such as one on another skeleton.

    Examples
    --------
    >>> import dancedata
    >>> from dancedata.synthetic import synthesise_motion
    >>> motion = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=150)[0]
    >>> dancedata.encode(motion, "edge151", contacts={"velocity": {"max_speed_m_s": 0.3}}).shape
    (150, 151)
    """
    if not isinstance(motion, Motion):
        raise UsageError("encode takes a Motion: an array has no frame rate and no skeleton", found=shown(motion),
                         fix="make one: Motion(translation, rotations, FrameGrid.of(30), SMPL24)")  # fmt: skip
    plugin = make_named(REPRESENTATIONS, "motion", representation, parameters)
    rule = contacts if contacts is not None else plugin.default_contacts
    problems: list[str] = []
    contact_rule = None if rule is None else single_plugin(CONTACTS, "contacts", rule, problems)
    if problems:
        raise RecipeError("; ".join(problems))
    array: npt.NDArray[np.float32] = plugin.encode(motion, contact_rule)
    return array
