"""How the dancers of a dataset move, and how their key motions lie to the beats of the music."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from dancedata.report.measure import PROMINENT, SLIDE_M_S, STILL_M_S, ClipNumbers, Measured
from dancedata.report.scales import Scales
from dancedata.report.tally import Histogram, Tally, five_numbers

__all__ = ["movement", "music"]

_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


def movement(found: Measured, scales: Scales) -> dict[str, Any]:
    """Return the section of the document."""
    reader = found.reader
    contact = {
        name: (int(on) / int(frames) if frames else None)
        for name, (on, frames) in zip(found.feet, found.contact.tolist(), strict=True)
    }
    return {
        "field": reader.motion.name if reader.motion is not None else None,
        "joints": len(found.joints),
        "speed_m_s": Histogram.of_tally(found.speed, scales.speed).to_json(),
        "joint_speed_m_s": {name: _quantiles(tally) for name, tally in found.joint_speed.items()},
        "still": {"below_m_s": STILL_M_S, **_over_clips(found, lambda n: n.still)},
        "root_extent_m": _of_clips(found, scales.root_extent_m, lambda n: n.root_extent_m),
        "floor_m": _of_clips(found, scales.floor_m, lambda n: n.floor_m),
        "lowest_m": _over_clips(found, lambda n: n.low_m),
        "highest_m": _over_clips(found, lambda n: n.high_m),
        "turns": _of_clips(found, scales.turns, lambda n: n.turns),
        "contact": contact,
        "sliding_m_s": {
            **Histogram.of_tally(found.sliding, scales.sliding).to_json(),
            "above_m_s": SLIDE_M_S,
            "share_above": found.sliding.share_above(SLIDE_M_S),
        },
        "paths_m": {clip: [list(p) for p in numbers.path] for clip, numbers in found.clips.items() if numbers.path},
    }


def music(found: Measured, scales: Scales) -> dict[str, Any]:
    """Return the section of the document: key motions beside beats, and beside beats moved by half a period."""
    reader = found.reader
    numbers = found.clips.values()
    tempos = [
        {"clip": c.id, "stated": c.tempo_bpm, "found": tempo}
        for c in found.store.clips
        if not c.source and c.tempo_bpm is not None and (tempo := found.clips[c.id].tempo_found) is not None
    ]
    return {
        "beats_from": reader.music.name if reader.music is not None else None,
        "key_motions_from": reader.keymotion.name if reader.keymotion is not None else None,
        "prominence_share": PROMINENT,
        "key_motions": sum(n.key_motions for n in numbers),
        "offset_ms": Histogram.of_tally(found.offset_ms, scales.offset_ms).to_json(),
        "shifted_ms": Histogram.of_tally(found.shifted_ms, scales.offset_ms).to_json(),
        "mean_distance_ms": _weighted(found, lambda n: n.key_beat_ms),
        "mean_distance_shifted_ms": _weighted(found, lambda n: n.key_shifted_ms),
        "bas": _mean(found, lambda n: n.bas),
        "bas_chance": _mean(found, lambda n: n.bas_chance),
        "tempo_bpm": tempos,
    }


def _quantiles(tally: Tally) -> dict[str, float | None]:
    return {f"p{round(100 * q)}": tally.quantile(q) for q in _QUANTILES}


def _values(found: Measured, value: Callable[[ClipNumbers], float | None]) -> list[float]:
    return [v for v in map(value, found.clips.values()) if v is not None]


def _over_clips(found: Measured, value: Callable[[ClipNumbers], float | None]) -> dict[str, float | None]:
    return five_numbers(_values(found, value))


def _of_clips(
    found: Measured, edges: tuple[float, ...], value: Callable[[ClipNumbers], float | None]
) -> dict[str, Any]:
    return Histogram.of_values({"all": _values(found, value)}, edges).to_json()


def _mean(found: Measured, value: Callable[[ClipNumbers], float | None]) -> float | None:
    values = _values(found, value)
    return float(np.mean(values)) if values else None


def _weighted(found: Measured, value: Callable[[ClipNumbers], float | None]) -> float | None:
    """Return the mean over key motions of a number that is a mean over those of a clip."""
    pairs = [(v, n.key_motions) for n in found.clips.values() if (v := value(n)) is not None]
    weight = sum(k for _, k in pairs)
    return sum(v * k for v, k in pairs) / weight if weight else None
