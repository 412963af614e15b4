"""The functions of the package's front door: extract, encode, decode."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid, Number
from dancedata.core.hashing import sha256_file
from dancedata.core.motion import Motion
from dancedata.core.registry import CONTACTS, FEATURES, REPRESENTATIONS
from dancedata.core.text import shown
from dancedata.execution.execute import exactly, on_one_thread
from dancedata.recipes.plugins import make_named, one_of, raise_problems


def extract(
    feature: str,
    song: str | Path | AudioSignal,
    *,
    fps: Number = 30,
    start_bpm: float | None = None,
    **parameters: Any,
) -> npt.NDArray[Any]:
    """Compute an audio feature of a whole song (scope: track).

    Parameters
    ----------
    feature
        Name of a registered audio feature, such as "librosa35".
    song
        An audio file or an AudioSignal.
    fps
        Rows a second.
    start_bpm
        Tempo to start from, where the feature tracks beats; None: it is estimated.
    parameters
        The feature's own, as in a recipe.

    Returns
    -------
    (T, D) array
    """
    from dancedata.audio.signal import load_audio

    plugin = make_named(FEATURES, "audio", feature, parameters).resolved(sha256_file)
    signal = song if isinstance(song, AudioSignal) else load_audio(song)
    compute = exactly if plugin.exact else on_one_thread
    rows: npt.NDArray[Any] = compute(partial(plugin.extract, start_bpm=start_bpm), signal, FrameGrid.of(fps))
    return rows


def encode(
    motion: Motion, representation: str, *, contacts: Any = None, **parameters: Any
) -> npt.NDArray[np.float32]:
    """Encode a motion at its own frame rate; (T, D) float32.

    `contacts` is a rule's name or ``{name: {parameters}}``; default: the representation's own. UsageError for
    anything but a Motion: an array lacks the rate, the skeleton and the translation.
    """
    if not isinstance(motion, Motion):
        raise UsageError(
            "encode takes a Motion",
            found=shown(motion),
            fix="make one: dancedata.core.motion.Motion(translation, rotations, FrameGrid.of(30), SMPL24)",
        )
    plugin = make_named(REPRESENTATIONS, "motion", representation, parameters)
    rule = contacts if contacts is not None else plugin.default_contacts
    problems: list[str] = []
    made = None if rule is None else one_of(CONTACTS, "contacts", rule, problems)
    raise_problems(problems)
    array: npt.NDArray[np.float32] = plugin.encode(motion, made)
    return array


def decode(array: npt.NDArray[Any], representation: str, *, fps: Number = 30, **parameters: Any) -> Motion:
    """Decode columns (T, D), not normalised, into a motion at `fps` frames per second.

    UsageError for a representation of positions, which cannot be decoded.
    """
    plugin = make_named(REPRESENTATIONS, "motion", representation, parameters)
    if not plugin.decodes:
        raise UsageError(
            f"{representation} cannot be decoded: positions do not say how a bone turns about itself",
            fix="use the positions as they are, or store a representation that holds rotations as well",
        )
    return plugin.decode(array, FrameGrid.of(fps))
