"""Songs of clips, by name and by their samples, and the numbers of a split."""

from collections.abc import Iterable, Mapping, Sequence

from dancedata.core.clip import union_find
from dancedata.core.grid import FrameGrid
from dancedata.core.text import listed
from dancedata.store.clip_columns import ClipRecord

#: Digits of a hash of `ClipRecord.made_of`; those of a clip without music are zeros.
_DIGITS = 12


def music_hash(clip: ClipRecord) -> str:
    """Return the first digits of the hash of a clip's samples of music; "" without music, or if not recorded."""
    digits = clip.made_of[_DIGITS : 2 * _DIGITS]
    return digits if digits.strip("0") else ""


def music_hashes(clips: Iterable[ClipRecord]) -> dict[str, str]:
    """Return `music_hash` by clip, of those that have music."""
    return {clip.id: digits for clip in clips if (digits := music_hash(clip))}


def songs_of(clips: Sequence[ClipRecord]) -> dict[str, str]:
    """Return the song of each clip with music, by id: equal names or equal samples are one song, copies too."""
    records = {clip.id: clip for clip in clips}
    keys: dict[str, list[tuple[str, str]]] = {}
    for clip in records.values():
        origin = records.get(clip.source, clip)
        pairs = (("name", origin.music), ("", music_hash(origin)))
        keys[clip.id] = [(kind, value) for kind, value in pairs if value]
    names: dict[tuple[str, str], str] = {}
    for group in union_find(keys.values()):
        first, *others = sorted(value for kind, value in group if kind) or sorted(value for _, value in group)
        label = f"{first} (also {listed(others, 3)})" if others else first
        names |= dict.fromkeys(group, label)
    return {clip: names[of_clip[0]] for clip, of_clip in keys.items() if of_clip}


def split_counts(
    clips: Sequence[ClipRecord], n_windows: int, songs: Mapping[str, str], grid: FrameGrid
) -> dict[str, int | float]:
    """Return the numbers of a split; `hours` count each dancer of a group, `scene_hours` each group once."""
    frames, groups = sum(clip.n_frames for clip in clips), {clip.group for clip in clips if clip.group}
    counts: dict[str, int | float] = {
        "clips": len(clips), "windows": n_windows, "frames": frames,
        "hours": float(grid.seconds(frames) / 3600),
        "songs": len({songs[clip.id] for clip in clips if clip.id in songs}),
    }  # fmt: skip
    if groups:
        scenes = sum({clip.group or clip.id: clip.n_frames for clip in clips}.values())
        counts |= {"groups": len(groups), "scene_hours": float(grid.seconds(scenes) / 3600)}
    return counts
