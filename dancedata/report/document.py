"""Every number of a report, as plain JSON data: the page is drawn from this document, so both agree."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dancedata.report.contents import contents, total_windows
from dancedata.report.fields import fields
from dancedata.report.left_out import flags, left_out, ranking
from dancedata.report.measure import Measured
from dancedata.report.movement import movement, music
from dancedata.report.scales import Scales
from dancedata.report.sharing import splits
from dancedata.store import Store
from dancedata.store.songs import songs_of

__all__ = ["SCHEMA", "Document", "document"]

#: Raised whenever a key of the document is removed or means something else.
SCHEMA = 1

Document = Mapping[str, Any]


def document(found: Measured, scales: Scales) -> Document:
    """Return every number of a report of one dataset.

    Parameters
    ----------
    scales
        Borders of the bins of histograms; those of two datasets that are compared are the same.
    """
    store = found.store
    return {
        "about": _about(store),
        "totals": _totals(found),
        "contents": contents(found, scales),
        "movement": movement(found, scales),
        "music": music(found, scales),
        "splits": splits(store),
        "fields": fields(store),
        "left_out": left_out(store.rejects),
        "flags": flags(store),
        "ranking": ranking(found),
        "clips": _clips(found),
    }


def _about(store: Store) -> dict[str, Any]:
    keys = ("name", "dataset", "scope", "fps", "windows", "licence", "citation", "dancedata", "recipe_sha256")
    about = {key: store.meta.get(key) for key in keys}
    description = store.meta.get("recipe", {}).get("description", "")
    notes = list(store.meta.get("source", {}).get("notes", []))
    skeleton = {"name": store.skeleton.name, "joints": store.skeleton.n_joints}
    return {**about, "description": description, "notes": notes, "skeleton": skeleton, "weights": store.weights}


def _totals(found: Measured) -> dict[str, Any]:
    clips = found.store.clips
    originals = [c for c in clips if not c.source]
    return {
        "clips": len(originals),
        "copies": len(clips) - len(originals),
        "windows": total_windows(found),
        "minutes": float(found.store.grid.seconds(sum(c.n_frames for c in originals)) / 60),
        "songs": len(set(songs_of(clips, found.store.meta).values())),
        "dancers": len({c.dancer for c in clips if c.dancer}),
        "genres": len({c.genre for c in clips if c.genre}),
        "left_out": len(found.store.rejects),
        "flags": len(found.store.quality),
        "flagged_clips": sum(c.n_flags > 0 for c in originals),
    }


_CLIP_NUMBERS: Sequence[str] = (
    "seconds", "speed", "speed_p95", "still", "root_extent_m", "root_path_m", "floor_m", "low_m", "high_m", "turns",
    "sliding", "key_motions", "key_beat_ms", "key_shifted_ms", "bas", "bas_chance", "tempo_found", "music_s",
)  # fmt: skip


def _clips(found: Measured) -> list[dict[str, Any]]:
    """Return a row for each clip that is not a copy: what the dataset says, and what was measured."""
    rows = []
    for clip in found.store.clips:
        if clip.source:
            continue
        numbers = found.clips[clip.id]
        about = {
            "clip": clip.id, "split": clip.split, "genre": clip.genre, "song": clip.music, "dancer": clip.dancer,
            "frames": clip.n_frames, "windows": found.windows.get(clip.id, 0), "flags": clip.n_flags,
            "tempo_stated": clip.tempo_bpm, "source_rate": clip.source_rate, "trim_start": clip.trim_start,
        }  # fmt: skip
        rows.append(about | {name: getattr(numbers, name) for name in _CLIP_NUMBERS})
    return rows
