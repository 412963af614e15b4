"""Songs by their music id: the longest signal of each, of which the others have to be the beginning."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from dancedata.core.text import shown
from dancedata.exports.base.job import ExportJob, Lack

if TYPE_CHECKING:
    from dancedata.core.audio_signal import AudioSignal
    from dancedata.store import ClipView


def find_songs(job: ExportJob, clips: list[ClipView]) -> tuple[dict[str, ClipView], list[Lack]]:
    """Return the clip with the longest signal of each music id, and ids with signals that are different music.

    Datasets that hold the music of each sequence by itself have several files for one id, of which loaders read one:
    that is right where the shorter ones are the beginning of the longest.
    """
    found: dict[str, ClipView] = {}
    lacks: list[Lack] = []
    for music, mine in sorted(_by_music(clips).items()):
        different = list(
            {job.music.hashes.get(clip.id, str(job.music.files[clip.id])): clip for clip in mine}.values()
        )
        signals = [job.music.load(clip) for clip in different] if len(different) > 1 else []
        longest = max(range(len(different)), key=lambda k: signals[k].n_samples) if signals else 0
        found[music] = different[longest]
        other = [different[k] for k, s in enumerate(signals) if not _begins(s, signals[longest])]
        if other:
            problem = (
                f"one file per song is read, and the music {shown(music)} of {shown(other[0].id)} is not the "
                f"beginning of that of {shown(found[music].id)}"
            )
            lacks.append(Lack(problem, "a source with one audio file per song, as the official AIST++ has"))
    return found, lacks


def _by_music(clips: list[ClipView]) -> Mapping[str, list[ClipView]]:
    found: dict[str, list[ClipView]] = {}
    for clip in clips:
        found.setdefault(clip.music, []).append(clip)
    return found


def _begins(part: AudioSignal, whole: AudioSignal) -> bool:
    return part.sample_rate == whole.sample_rate and np.array_equal(part.samples, whole.samples[: part.n_samples])
