"""A source as takes: its clips measured, dancers of a group together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from typing import NamedTuple

from dancedata.building.inputs import Music
from dancedata.building.sources import Sources
from dancedata.building.take import Dancer, Recording, SourceReader, Take, Time
from dancedata.core.clip import ClipRef, Reject
from dancedata.core.plugins import Dataset
from dancedata.core.rejects import reject_on_error
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs, run_units
from dancedata.files.documents import clip_identity

#: Dancers of a group are cut to the shortest, if none is longer by more than this.
_TOLERANCE_S = Fraction(1, 4)


class _Measured(NamedTuple):
    """A dancer, and the time of his motion."""

    dancer: Dancer
    time: Time


def takes_of(
    cache: Cache, dataset: Dataset, sources: Sources, *, jobs: Jobs, progress: Progress
) -> tuple[list[Take], list[Reject]]:
    """Measure the motion of all identified clips, and form takes of those that can be used."""
    reader = SourceReader(dataset, sources.content)
    calls = [(cache, reader, clip.ref, clip.motion_sha256) for clip in sources.clips]
    cached = [_cached_time(*call) for call in calls]
    times = run_units(measure, calls, cached=cached, jobs=jobs, label="measuring motion", progress=progress)
    rejects, units = [], dict[tuple[str, str], list[_Measured]]()
    for clip, time in zip(sources.clips, times, strict=True):
        if isinstance(time, Reject):
            rejects.append(replace(time, clip=clip.ref.id))
        elif clip.input_problem is None:
            ref = clip.ref
            music = Music(clip.signal, ref.audio_start, ref.tempo_bpm, ref.music)
            dancer = Dancer(ref.id, ref, clip.motion_sha256, music, clip.files, clip.made_of)
            units.setdefault((ref.group, "" if ref.group else ref.id), []).append(_Measured(dancer, time))
    takes = []
    for members in units.values():
        take = _take(reader, sorted(members, key=lambda member: member.dancer.ref.member))
        if isinstance(take, Reject):
            files = [(member.dancer.id, str(member.dancer.ref.motion_path)) for member in members]
            rejects += [replace(take, clip=name, file=file) for name, file in files]
        else:
            takes.append(take)
    return takes, rejects


def measure(cache: Cache, reader: SourceReader, ref: ClipRef, sha256: str) -> Time | Reject:
    """Return the time of a clip's motion, measured once until its file changes; a Reject where it cannot be read."""
    time = reject_on_error(lambda: _measured(cache, reader, ref, sha256), ref.motion_path, ref.id)
    if isinstance(time, Reject):
        return time
    cache.put_json("times", _time_key(reader, ref, sha256), [time.n_frames, str(time.rate), time.trim])
    return time


def _measured(cache: Cache, reader: SourceReader, ref: ClipRef, sha256: str) -> Time:
    """Measure a clip's motion, loading that of a group's dancers; DataError if it is not the file that was hashed."""
    stated = None if ref.group else reader.dataset.time_of(ref)
    if stated is None:
        motion = reader.dataset.load(ref)
        stated = motion.n_frames, motion.grid.rate, motion.trim_start
    Recording(reader, ((ref, sha256),)).check(cache)
    return Time(*stated)


def _cached_time(cache: Cache, reader: SourceReader, ref: ClipRef, sha256: str) -> Time | None:
    """Return the cached result of `measure`, None if there is none."""
    row = cache.json("times", _time_key(reader, ref, sha256))
    return None if row is None else Time(row[0], Fraction(row[1]), row[2])


def _time_key(reader: SourceReader, ref: ClipRef, sha256: str) -> str:
    return Cache.key("time", version=1, reader=reader.key, clip=clip_identity(ref), file=sha256)


def _take(reader: SourceReader, members: Sequence[_Measured]) -> Take | Reject:
    """Form the take of a single dancer, or of a group in one time; a Reject where there is none."""
    dancers, times = tuple(m.dancer for m in members), [m.time for m in members]
    shortest, longest = min(t.n_frames for t in times), max(t.n_frames for t in times)
    group, grid = dancers[0].ref.group, times[0].grid
    rates = sorted({str(time.grid) for time in times})
    if len(rates) > 1:
        detail = f"group {group}: the dancers of a group differ in their rate: {', '.join(rates)} per second"
        return Reject("other_rate", detail=detail)
    if grid.seconds(longest - shortest) > _TOLERANCE_S:
        lengths = ", ".join(f"{d.id} {t.n_frames} frames" for d, t in zip(dancers, times, strict=True))
        detail = f"group {group}: the dancers of a group differ in length: {lengths}; at most "
        return Reject("length_mismatch", detail=f"{detail}{float(_TOLERANCE_S):g} s of difference are allowed")
    recording = Recording(reader, tuple((d.ref, d.sha256) for d in dancers))
    trim = min(max(time.trim for time in times), shortest - 1)
    return Take(recording, dancers, Time(shortest, times[0].rate, trim), group=group)
