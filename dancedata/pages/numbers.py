"""The numbers of a report, gathered from a measured dataset into its document."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import zip_longest
from typing import Any

import numpy as np

from dancedata.core.hashing import dataset_hashes
from dancedata.core.terms import clips_by_terms, terms_text
from dancedata.kernel import AlikeSongs, Clip, Store, alike_songs, songs_of, sound_field
from dancedata.pages.bin_counts import ClipHistogram, FiveNumbers, FrameHistogram, Quantiles, counted_between
from dancedata.pages.document import (
    About,
    ClipRow,
    ColumnRange,
    Contents,
    Counts,
    Document,
    FieldNumbers,
    Flags,
    LeftOut,
    Movement,
    Music,
    MusicGaps,
    Shared,
    Sliding,
    SongShift,
    Splits,
    Still,
    Suspect,
    Tempo,
    Totals,
)
from dancedata.pages.groups import groups_of
from dancedata.pages.measure import PROMINENT, SLIDE_M_S, STILL_M_S, Measured
from dancedata.pages.outliers import outliers
from dancedata.pages.scales import ClipValue, Scales, clip_values, music_gaps
from dancedata.pages.scaling import scaled_groups
from dancedata.scene.pose_space import Space, poses_of

#: Stands for a genre, dancer or song that the dataset does not name.
UNKNOWN = "unknown"
#: Smaller ranges are those of a column that does not change.
_CONSTANT = 1e-6
#: Quantiles of columns.
_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
#: Reasons for looking at a clip, in the order in which their lists take turns, and the value above which they hold.
_WHY = {"flags": 0.0, "sliding": 0.05, "still": 0.3}
#: Borders of the bins of angles, degrees.
_FACING_DEG = tuple(float(angle) for angle in range(0, 181, 10))


def document(measured: Measured, scales: Scales) -> Document:
    """Return every number of a report of one dataset; two that are compared have the same scales."""
    store = measured.store
    return Document(
        about=_about(store),
        totals=_totals(measured),
        contents=_contents(measured, scales),
        movement=_movement(measured, scales),
        groups=groups_of(store, measured.groups, scales.distance_m, _FACING_DEG),
        music=_music(measured, scales),
        splits=splits(store),
        outliers=outliers(measured.clips),
        poses=poses_of(measured.space or Space.of(store, {}), store.splits),
        fields={name: _field(store, name) for name in store.fields},
        left_out=_left_out(store.rejects),
        flags=_flags(store),
        segments=store.layer_numbers(),
        columns=store.free_columns(),
        ranking=_ranking(measured),
        clips=tuple(_row(measured, clip) for clip in store if not clip.source),
    )


def _about(store: Store) -> About:
    keys = ("name", "fps", "windows", "licence", "citation")
    record: dict[str, Any] = {key: store.info.get(key) for key in keys}
    return About(
        **record,
        dataset=store.info.get("source", {}).get("reader"),
        dancedata=store.info.get("versions", {}).get("dancedata"),
        recipe_sha256=dataset_hashes(store.info).get("recipe_sha256"),
        description=store.info.get("recipe", {}).get("description", ""),
        notes=tuple(store.info.get("source", {}).get("notes", [])),
        skeleton={"name": store.skeleton.name, "joints": store.skeleton.n_joints},
        weights=store.weights,
        licences=tuple(terms_text(clips_by_terms(store))),
    )


def _totals(measured: Measured) -> Totals:
    clips = measured.store.clips()
    originals = [c for c in clips if not c.source]
    return Totals(
        clips=len(originals),
        groups=len({c.group for c in originals if c.group}),
        copies=len(clips) - len(originals),
        windows=sum(measured.windows.values()),
        minutes=float(measured.store.grid.seconds(sum(c.n_frames for c in originals)) / 60),
        songs=len(set(songs_of(clips).values())),
        dancers=len({c.dancer for c in clips if c.dancer}),
        genres=len({c.genre for c in clips if c.genre}),
        left_out=len(measured.store.rejects),
        flags=len(measured.store.quality),
        flagged_clips=sum(c.n_flags > 0 for c in originals),
    )


def _contents(measured: Measured, scales: Scales) -> Contents:
    store = measured.store
    originals = [c for c in store if not c.source]
    songs = songs_of(store.clips())
    tempos = {s: [c.tempo_bpm for c in originals if c.split == s and c.tempo_bpm is not None] for s in store.splits}
    lengths = {s: [float(store.grid.seconds(c.n_frames)) for c in originals if c.split == s] for s in store.splits}
    genres = _windows_by(measured, lambda c: c.genre)
    gaps = music_gaps(measured)
    shorter = tuple(sorted(clip for clip, gap in gaps.items() if gap < 0))
    return Contents(
        splits=tuple(store.splits),
        by_split={split: dict(store.info["splits"].get(split, {})) for split in store.splits},
        windows_by_split=_windows_by(measured, lambda c: c.split),
        windows_by_genre=genres,
        windows_by_dancer=_windows_by(measured, lambda c: c.dancer),
        windows_by_song=_windows_by(measured, lambda c: songs.get(c.id, "")),
        alike=_alike(genres),
        length_s=ClipHistogram.of_groups(lengths, scales.length_s),
        tempo_bpm=ClipHistogram.of_groups(tempos, scales.tempo_bpm),
        source_rates=dict(sorted(Counter(c.source_rate or UNKNOWN for c in originals).items())),
        music_minus_motion_s=MusicGaps.of_groups(
            {"all": list(gaps.values())}, scales.music_minus_motion_s, shorter=shorter
        ),
    )


def _windows_by(measured: Measured, key: Callable[[Clip], str]) -> Counts:
    """Count the windows by a name of their clip, then by split; copies count, as a trainer draws them too."""
    counts: dict[str, Counter[str]] = {}
    for clip in measured.store.clips():
        counts.setdefault(key(clip) or UNKNOWN, Counter())[clip.split] += measured.windows.get(clip.id, 0)
    splits = measured.store.splits
    place = {split: number for number, split in enumerate(splits)}
    ordered = sorted(counts, key=lambda name: (name == UNKNOWN, name not in place, place.get(name, 0), name))
    return {name: {split: counts[name][split] for split in splits} for name in ordered}


def _alike(names: Iterable[str]) -> tuple[tuple[str, ...], ...]:
    """Return names that differ only in case, spaces or punctuation: "Jazz" and "jazz"."""
    by_letters: dict[str, list[str]] = {}
    for name in names:
        by_letters.setdefault("".join(filter(str.isalnum, name.casefold())), []).append(name)
    return tuple(tuple(sorted(similar)) for similar in by_letters.values() if len(similar) > 1)


def _movement(measured: Measured, scales: Scales) -> Movement:
    motion = measured.reader.motion
    contact = zip(measured.feet, measured.contact.tolist(), strict=True)
    clips = measured.clips.items()
    splits = measured.store.splits
    of_splits = {
        s: measured.split_speed[s].histogram(scales.speed).tolist() for s in splits if s in measured.split_speed
    }
    return Movement(
        field=None if motion is None else motion.name,
        joints=len(measured.joints),
        speed_m_s=FrameHistogram.of(measured.speed, scales.speed, by_split=of_splits),
        joint_speed_m_s={name: Quantiles.of_tally(tally) for name, tally in measured.joint_speed.items()},
        still=Still(**vars(_over_clips(measured, lambda n: n.still)), below_m_s=STILL_M_S),
        root_extent_m=_of_clips(measured, scales.root_extent_m, lambda n: n.root_extent_m),
        floor_m=_of_clips(measured, scales.floor_m, lambda n: n.floor_m),
        feet_m=_over_clips(measured, lambda n: n.feet_m),
        lowest_m=_over_clips(measured, lambda n: n.low_m),
        highest_m=_over_clips(measured, lambda n: n.high_m),
        turns=_of_clips(measured, scales.turns, lambda n: n.turns),
        contact={name: int(on) / int(frames) if frames else None for name, (on, frames) in contact},
        sliding_m_s=Sliding.of(
            measured.sliding, scales.sliding, above_m_s=SLIDE_M_S, share_above=measured.sliding.share_above(SLIDE_M_S)
        ),
        paths_m={clip: numbers.path for clip, numbers in clips if numbers.path},
        stage=measured.stage.numbers(),
    )


def _music(measured: Measured, scales: Scales) -> Music:
    reader = measured.reader
    tempos = tuple(
        Tempo(c.id, c.tempo_bpm, tempo)
        for c in measured.store.clips()
        if not c.source and c.tempo_bpm is not None and (tempo := measured.clips[c.id].tempo_found) is not None
    )
    return Music(
        beats_from=None if reader.music is None else reader.music.name,
        key_motions_from=None if reader.keymotion is None else reader.keymotion.name,
        prominence_share=PROMINENT,
        key_motions=sum(n.key_motions for n in measured.clips.values()),
        offset_ms=FrameHistogram.of(measured.offset_ms, scales.offset_ms),
        shifted_ms=FrameHistogram.of(measured.shifted_ms, scales.offset_ms),
        mean_distance_ms=_weighted(measured, lambda n: n.key_beat_ms),
        mean_distance_shifted_ms=_weighted(measured, lambda n: n.key_shifted_ms),
        bas=_mean(measured, lambda n: n.bas),
        bas_chance=_mean(measured, lambda n: n.bas_chance),
        tempo_bpm=tempos,
        songs=_songs(measured, scales),
    )


def _songs(measured: Measured, scales: Scales) -> tuple[SongShift, ...]:
    songs = [
        SongShift(
            song,
            o.clips,
            o.tally.n,
            round(o.shift_ms, 1),
            round(o.strength, 3),
            tuple(o.tally.histogram(scales.offset_ms).tolist()),
        )
        for song, o in measured.song_offsets.items()
        if o.shift_ms is not None
    ]
    return tuple(sorted(songs, key=lambda song: (not song.is_shifted, -abs(song.shift_ms), song.song)))


def _over_clips(measured: Measured, value: ClipValue) -> FiveNumbers:
    return FiveNumbers.of(clip_values(measured, value))


def _of_clips(measured: Measured, edges: tuple[float, ...], value: ClipValue) -> ClipHistogram:
    store = measured.store
    by_split: dict[str, list[float]] = {split: [] for split in store.splits}
    for clip in store:
        if clip.id in measured.clips and (v := value(measured.clips[clip.id])) is not None:
            by_split[clip.split].append(v)
    counts = counted_between(by_split, edges)
    return ClipHistogram.of_groups({"all": clip_values(measured, value)}, edges, by_split=counts)


def _mean(measured: Measured, value: ClipValue) -> float | None:
    values = clip_values(measured, value)
    return float(np.mean(values)) if values else None


def _weighted(measured: Measured, value: ClipValue) -> float | None:
    """Return the mean over key motions of a number that is a mean over those of a clip."""
    pairs = [(v, n.key_motions) for n in measured.clips.values() if (v := value(n)) is not None]
    weight = sum(k for _, k in pairs)
    return sum(v * k for v, k in pairs) / weight if weight else None


def splits(store: Store) -> Splits:
    """Return the songs, dancers and clips that splits share."""
    songs = songs_of(store.clips())
    alike = None if sound_field(store) is None else alike_songs(store, songs)
    return Splits(
        compared_by_sound=alike is not None,
        songs=_shared(store, lambda c: songs.get(c.id, ""), alike or ()),
        dancers=_shared(store, lambda c: c.dancer),
        clips=_shared(store, lambda c: c.original),
    )


def _shared(store: Store, key: Callable[[Clip], str], alike: Sequence[AlikeSongs] = ()) -> Shared:
    names = {split: {key(c) for c in store if c.split == split and key(c)} for split in store.splits}
    both = {(a, b): sorted(names[a] & names[b]) for a in store.splits for b in store.splits}
    for pair in alike:
        for a, b in both:
            if a != b and any(a in one and b in other for one, other in (pair.splits, pair.splits[::-1])):
                both[a, b].append(f"{pair.songs[0]} (sounds as {pair.songs[1]}, likeness {pair.likeness:.2f})")
    counts = {a: {b: len(both[a, b]) for b in store.splits} for a in store.splits}
    pairs = [(a, b) for i, a in enumerate(store.splits) for b in store.splits[i + 1 :]]
    return Shared(counts, {f"{a} and {b}": tuple(both[a, b]) for a, b in pairs if both[a, b]})


def column_ranges(store: Store, name: str) -> tuple[ColumnRange, ...]:
    """Return the range of each column of a field over the rows that train windows cover."""
    f, stats = store.field(name), store.stats["fields"].get(name)
    if stats is None or f.codebook is not None:
        return ()
    quantiles = store.quantiles(name, _QUANTILES).tolist()
    rows = zip(f.columns.labels, stats["min"], *quantiles, stats["max"], stats["mean"], strict=True)
    return tuple(ColumnRange(label, *map(float, numbers)) for label, *numbers in rows)


def _field(store: Store, name: str) -> FieldNumbers:
    """Return a field with the numbers of stats.json, over the rows that train windows cover."""
    field, stats = store.field(name), store.stats["fields"].get(name)
    columns = column_ranges(store, name)
    return FieldNumbers(
        kind=field.kind,
        width=field.columns.width,
        rate=str(field.rate),
        dtype=field.dtype,
        axes=store.field(name).axes or None,
        groups=tuple({"name": g.name, "width": g.width, "unit": g.unit} for g in field.columns.groups),
        rows=0 if stats is None else stats["n"],
        constant=tuple(column.label for column in columns if column.max - column.min < _CONSTANT),
        columns=columns,
        scaling=scaled_groups(store, name),
    )


def _left_out(rejects: Sequence[Mapping[str, Any]]) -> dict[str, LeftOut]:
    """Return what was left out by reason, those with most clips first."""
    by_reason: dict[str, list[Mapping[str, Any]]] = {}
    for reject in rejects:
        by_reason.setdefault(str(reject["reason"]), []).append(reject)
    ordered = sorted(by_reason.items(), key=lambda item: (-len(item[1]), item[0]))
    return {
        reason: LeftOut(
            n=len(of_reason),
            names=tuple(dict.fromkeys(str(r.get("clip") or r.get("file", "")) for r in of_reason)),
            detail=next((str(r["detail"]) for r in of_reason if r.get("detail")), ""),
        )
        for reason, of_reason in ordered
    }


def _flags(store: Store) -> Flags:
    kinds = Counter(str(flag.get("kind", "unknown")) for flag in store.quality)
    joints = Counter(str(flag.get("joint", "whole clip")) for flag in store.quality)
    return Flags(dict(sorted(kinds.items())), dict(sorted(joints.items(), key=lambda item: (-item[1], item[0]))))


def _ranking(measured: Measured) -> tuple[Suspect, ...]:
    """Return the clips to look at first.

    Three lists take turns: flags per second (above 0), share of the frames of feet in contact that slide (above 5 %),
    share of frames that stand still (above 30 %); the largest come first. A clip comes once, where it comes first.
    """
    suspects: dict[str, Suspect] = {}
    for turn in zip_longest(*(_suspects(measured, why) for why in _WHY)):
        for suspect in turn:
            if suspect is not None:
                suspects.setdefault(suspect.clip, suspect)
    return tuple(suspects.values())


def _suspects(measured: Measured, why: str) -> list[Suspect]:
    suspects = []
    for clip in measured.store.clips():
        if clip.source:
            continue
        flags_per_second = clip.n_flags / float(measured.store.grid.seconds(clip.n_frames))
        value = flags_per_second if why == "flags" else getattr(measured.clips[clip.id], why)
        if value is not None and value > _WHY[why]:
            suspects.append(Suspect(clip.id, why, float(value)))
    return sorted(suspects, key=lambda suspect: (-suspect.value, suspect.clip))


def _row(measured: Measured, clip: Clip) -> ClipRow:
    return ClipRow(
        clip=clip.id,
        split=clip.split,
        genre=clip.genre,
        song=clip.music,
        dancer=clip.dancer,
        group=clip.group,
        member=clip.member,
        slice_of=clip.slice_of,
        role=clip.role,
        frames=clip.n_frames,
        windows=measured.windows.get(clip.id, 0),
        flags=clip.n_flags,
        tempo_stated=clip.tempo_bpm,
        source_rate=clip.source_rate,
        trim_start=clip.trim_start,
        numbers=measured.clips[clip.id],
    )
