"""Takes -> clips to store."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from dancedata.building.plugins import Annotator, Field
from dancedata.building.result import Nothing, Result
from dancedata.building.segments import unmirrored
from dancedata.core.clip import Reject
from dancedata.core.grid import FrameGrid
from dancedata.core.licence import Licence
from dancedata.store import Signal, StoredClip


class BuiltClips(NamedTuple):
    """The content of a dataset."""

    clips: Sequence[StoredClip]  # by id; copies after all others
    rejects: Sequence[Reject]  # everything that was left out
    quality: Sequence[dict[str, Any]]  # rows of quality.jsonl


class _Stays(NamedTuple):
    """A dancer to store: his take, that of the source, and his number."""

    result: Result
    origin: Result
    k: int

    @property
    def id(self) -> str:
        """Id to store it under."""
        return self.result.take.dancers[self.k].id

    def flags(self, annotators: Sequence[Annotator]) -> list[dict[str, Any]]:
        """Return the quality flags of motion and music; of a copy those of its source."""
        take = self.origin.take
        of_motion = [flag for a in annotators for flag in a.flags(self.origin.made[a.id][self.k])]
        return [*of_motion, *take.dancers[self.k].music.flags(take.time.seconds)]


def stored(
    results: Sequence[Result],
    fields: Sequence[Field],
    annotators: Sequence[Annotator],
    sizes: Mapping[str, int],
    grid: FrameGrid,
) -> BuiltClips:
    """Return the clips to store, all rejects, and flags of every clip but copies; `sizes`: dancers by group."""
    origins = {r.take.id: r for r in results}
    staying = [_Stays(r, origins[r.take.origin.id], k) for r in results for k in r.stay]
    staying.sort(key=lambda stays: (stays.result is not stays.origin, stays.id))
    return BuiltClips(
        [_clip(stays, fields, annotators, sizes, grid) for stays in staying],
        [
            *(reject for r in results for reject in r.rejects),
            *(reject for stays in staying for reject in _without(stays, fields)),
            *unmirrored(results, annotators),
        ],
        [{"clip": p.id, **flag} for p in staying if p.result is p.origin for flag in p.flags(annotators)],
    )


def _clip(
    stays: _Stays, fields: Sequence[Field], annotators: Sequence[Annotator], sizes: Mapping[str, int], grid: FrameGrid
) -> StoredClip:
    result, origin, k = stays
    take, dancer = result.take, result.take.dancers[k]
    ref, music, is_copy = dancer.ref, dancer.music, result is not origin
    signal = music.signal if music.is_file else None
    rows: dict[str, dict[str, Any]] = {"motion": {}, "audio": {}}
    for field in fields:
        rows[field.stored_as][field.name] = field.block(result.made[field.id][k], take, k, grid)
    measured = {name: value for a in annotators for name, value in a.measured(result.made[a.id][k]).items()}
    return StoredClip(
        id=dancer.id,
        split=ref.split,
        genre=ref.genre,
        music=music.name,
        dancer=ref.dancer,
        tempo_bpm=music.bpm,
        source=origin.take.dancers[k].id if is_copy else "",
        n_flags=len(stays.flags(annotators)),
        trim_start=take.time.trim_on(grid),
        source_rate=str(origin.take.time.recorded or origin.take.time.rate),
        lists=ref.lists,
        n_frames=take.time.frames_on(grid),
        starts=result.starts,
        motion=rows["motion"],
        audio=rows["audio"],
        group=take.group,
        member=ref.member,
        role=ref.role,
        song="" if signal is None else music.name or signal.sha256[:12],
        signal=None if signal is None else Signal(signal.sha256, signal.sample_rate, signal.n_samples),
        slice_of=dancer.slice_of,
        slice_start=take.time.grid.rows_up(take.time.first, of=grid),
        source_start=ref.source_start,
        source_end=ref.source_end,
        audio_start=music.start,
        audio_start_by=ref.audio_start_by,
        terms=Licence(ref.licence, ref.citation) if ref.licence or ref.citation else None,
        made_of="" if is_copy else dancer.made_of,
        columns={**dict(ref.keys), **dict(ref.columns)},
        segments=tuple(s for a in annotators if a.stored for s in result.segments[a.name][k]),
        group_size=sizes.get(ref.group, 0),
        **measured,
    )


def _without(stays: _Stays, fields: Sequence[Field]) -> list[Reject]:
    """Return a reject for each field that a dancer is kept without; none for a copy whose source lacks it too."""
    rejects = []
    for field in fields:
        rows, of_origin = (result.made[field.id][stays.k] for result in (stays.result, stays.origin))
        if isinstance(rows, Nothing) and (stays.result is stays.origin or not isinstance(of_origin, Nothing)):
            file = str(stays.result.take.dancers[stays.k].ref.motion_path)
            rejects.append(Reject("no_field", stays.id, file, detail=f"kept without {field.name}: {rows.reason}"))
    return rejects
