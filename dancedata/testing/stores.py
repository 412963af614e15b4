"""Small random stores for tests, of this project and of projects that use it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import slice_name
from dancedata.core.columns import Columns, Group, Mirror
from dancedata.core.grid import WindowGrid
from dancedata.core.skeleton import SMPL24
from dancedata.store.schema import Field, StoreHeader
from dancedata.store.stored_clip import AudioBlock, StoredClip
from dancedata.store.writer import write_store

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class RandomStore:
    """A store on disk and its source arrays."""

    path: Path
    header: StoreHeader
    clips: tuple[StoredClip, ...]  # as given to the writer; their arrays are the expected values

    def clip(self, clip_id: str) -> StoredClip:
        """Return a clip by id."""
        return next(c for c in self.clips if c.id == clip_id)

    def rows(self, clip_id: str, field: str, start: int, length: int) -> Array:
        """Return the rows of a window of frames from the source arrays, (rows, D), which a reader must return."""
        clip = self.clip(clip_id)
        f = next(f for f in self.header.fields if f.name == field)
        rows = slice(*(self.header.grid.rows_down(frame, of=f.grid) for frame in (start, start + length)))
        if f.per_clip:
            values = np.asarray(clip.motion[field])[rows]
        else:
            block = clip.audio[field]
            values = np.asarray(block.array)[block.offset :][rows]
        return values.astype(f.dtype)


def random_columns(width: int, *, mirror: bool = True) -> Columns:
    """Make columns in groups "a" and "b"; the mirror swaps adjacent columns and negates every third pair."""
    first = max(1, width // 3)
    groups = [Group("a", first, "m")] + ([Group("b", width - first, "1")] if width > first else [])
    if not mirror:
        return Columns(tuple(groups), None)
    order = list(range(width))
    for i in range(0, width - 1, 2):
        order[i], order[i + 1] = order[i + 1], order[i]
    # Both columns of a swapped pair have the same sign, so that mirroring twice is the identity.
    signs = [-1 if (i // 2) % 3 == 0 else 1 for i in range(width)]
    return Columns(tuple(groups), Mirror(tuple(order), tuple(signs)))


def random_fields(motion: Mapping[str, int], audio: Mapping[str, int], **rates: float | str) -> tuple[Field, ...]:
    """Make fields from name -> width; rates by name, by default 30 per second."""
    fields: list[Field] = []
    for kind, widths in (("motion", motion), ("audio", audio)):
        for name, width in widths.items():
            columns = random_columns(width, mirror=kind == "motion")
            rate = Fraction(str(rates.get(name, 30)))
            fields.append(Field(name, "motion" if kind == "motion" else "audio", columns, rate))
    return tuple(fields)


def write_random_store(
    out: Path,
    *,
    clips: Mapping[str, int] | None = None,
    fields: Sequence[Field] | None = None,
    fps: Fraction = Fraction(30),
    length: int = 30,
    stride: int = 15,
    n_frames: tuple[int, int] = (40, 140),
    clips_per_song: int = 2,
    shard_bytes: int = 1 << 20,
    seed: int = 0,
    slices: bool = False,
    meta: Mapping[str, Any] | None = None,
    **writer: Any,
) -> RandomStore:
    """Write a store of random arrays.

    Parameters
    ----------
    clips
        Number of clips per split. Default: train 6, val 2, test 2. Ids are ``<split>_c00`` and so on.
    fields
        Default: edge151 (151 columns) and librosa35 (35), both 30 per second.
    n_frames
        Least and largest length of a clip, drawn at random. Equal ones give a known number of windows.
    clips_per_song
        Adjacent clips of a split share a song: one timeline, with an offset per clip.
    slices
        Whether each window is a clip of its own, ``<split>_c00_slice1``.
    meta
        Additional keys of dataset.json.
    **writer
        Arguments of `write_store`: rejects, quality, card, ...

    Examples
    --------
    >>> from pathlib import Path
    >>> from dancedata.testing.stores import write_random_store
    >>> write_random_store(Path("random"), clips={"train": 2}).path.name
    'random'
    """
    rng = np.random.default_rng(seed)
    chosen = tuple(fields) if fields is not None else random_fields({"edge151": 151}, {"librosa35": 35})
    header = StoreHeader(
        fps=fps, length=length, stride=stride, fields=chosen, skeleton=SMPL24,
        meta=dict(meta or {"recipe": {"name": "random"}, "licence": "CC0-1.0"}),
    )  # fmt: skip
    stored: list[StoredClip] = []
    for split, count in (clips or {"train": 6, "val": 2, "test": 2}).items():
        lengths = rng.integers(n_frames[0], n_frames[1] + 1, size=count).tolist()
        for first in range(0, count, clips_per_song):
            ids = [f"{split}_c{i:02d}" for i in range(first, min(first + clips_per_song, count))]
            song = f"song_{split}_{first // clips_per_song:02d}"
            stored += _song(rng, header, split, song, dict(zip(ids, lengths[first:], strict=False)))
    stored = [piece for clip in stored for piece in slices_of(header, clip)] if slices else stored
    out.mkdir(parents=True, exist_ok=True)
    write_store(out, header, stored, shard_bytes=shard_bytes, **writer)
    return RandomStore(out, header, tuple(stored))


def _song(
    rng: np.random.Generator, header: StoreHeader, split: str, song: str, lengths: Mapping[str, int]
) -> list[StoredClip]:
    """Make clips that share a song."""
    offsets = {f.name: int(rng.integers(0, 5)) for f in header.fields}
    longest = max(lengths.values())
    timelines = {
        f.name: _random(rng, f, (_rows(f, header, longest) + offsets[f.name] + 3,))
        for f in header.fields
        if f.kind == "audio"
    }
    clips: list[StoredClip] = []
    windows = WindowGrid(header.length, header.stride)
    for number, (clip_id, n) in enumerate(lengths.items()):
        starts = tuple(windows.starts(windows.count(n)))
        clips.append(
            StoredClip(
                id=clip_id,
                split=split,
                n_frames=n,
                starts=starts,
                motion={f.name: _random(rng, f, (_rows(f, header, n),)) for f in header.fields if f.per_clip},
                audio={
                    name: AudioBlock(f"{song}/{name}", timeline, offsets[name])
                    for name, timeline in timelines.items()
                },
                genre=("break", "house")[number % 2],
                music=song,
                dancer=f"d{number:02d}",
                tempo_bpm=None if number % 2 else 80.0 + number,
                n_flags=number,
                lists=(split, "all") if number % 2 else (),
            )
        )
    return clips


def slices_of(header: StoreHeader, clip: StoredClip) -> Iterator[StoredClip]:
    """Yield the windows of a clip as clips of their own."""
    for number, start in enumerate(clip.starts):
        rows = {f.name: [_rows(f, header, frame) for frame in (start, start + header.length)] for f in header.fields}
        motion = {name: np.asarray(array)[slice(*rows[name])] for name, array in clip.motion.items()}
        audio = {
            name: AudioBlock(f"{block.key}/{start}", np.asarray(block.array)[block.offset :][slice(*rows[name])])
            for name, block in clip.audio.items()
        }
        yield replace(
            clip, id=slice_name(clip.id, number), n_frames=header.length, starts=(0,), motion=motion, audio=audio,
            audio_start=header.grid.seconds(start), slice_of=clip.id, slice_start=start,
        )  # fmt: skip


def _rows(f: Field, header: StoreHeader, frames: int) -> int:
    return header.grid.rows_up(frames, of=f.grid)


def _random(rng: np.random.Generator, f: Field, shape: tuple[int, ...]) -> Array:
    return rng.normal(size=(*shape, f.columns.width)).astype(f.dtype)
