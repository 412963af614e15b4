"""Songs that splits or datasets share: by name, by samples, and by features of their sound."""

import itertools
from collections import defaultdict
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from dancedata.core.text import counted, listed, shown
from dancedata.store import Clip, Field, Problem, Store, open_store
from dancedata.store.songs import music_hashes, songs_of

Rows = npt.NDArray[np.float32]
_Mask = npt.NDArray[np.bool_]

#: Two songs of at least this likeness are one recording; docs/archive/measured.md has what was measured.
LIKENESS = 0.74
#: Least overlap of two songs that are compared, seconds; slow changes, over longer than SLOW_S, do not count.
_OVERLAP_S, _SLOW_S = 5, 2
#: Likeness is that of the pieces of PIECE_S seconds at this quantile: a copy is alike everywhere.
_PIECE_S, _WEAKEST = 0.5, 0.1
#: Rows per second that are compared, about; pieces with less than this share of the mean energy are silence.
_RATE, _SILENT = 30, 0.01
#: Most names in one message.
_SHOWN = 10
#: Songs whose spectra are in memory at once, and the most pairs that are compared, which takes some minutes.
_BLOCK, MAX_PAIRS = 32, 2_000_000


class AlikeSongs(NamedTuple):
    """Two songs of different splits, or with `between` of different datasets, that sound like one recording.

    `likeness`: 1 for equal features, about 0 for music that has nothing in common.
    `shift_s`: Seconds from an instant of the first to the same one of the second.
    """

    songs: tuple[str, str]
    splits: tuple[frozenset[str], frozenset[str]]
    likeness: float
    shift_s: float
    between: bool = False

    @property
    def leaks(self) -> bool:
        """Whether train is one of the splits that share the recording."""
        return "train" in self.splits[0] | self.splits[1]

    @property
    def message(self) -> str:
        """One sentence, for a check."""
        both = zip(self.songs, self.splits, strict=True)
        places = [f"{shown(song)} of {', '.join(sorted(splits))}" for song, splits in both]
        numbers = f"likeness {self.likeness:.2f} at {self.shift_s:+.2f} s, one recording from {LIKENESS} on"
        songs = "songs" if self.between else "songs of different splits"
        return f"{songs} sound alike: {' and '.join(places)} ({numbers})"


def leaks(path: str | Path) -> list[Problem]:
    """Return what splits of a sound dataset share: errors where train shares, unless splits are official."""
    with open_store(path) as store:
        songs = songs_of(store.clips())
        alike = alike_songs(store, songs)
        official, where = store.info.get("source", {}).get("split_rule") == "official", str(path)
        split_of = {clip.id: clip.split for clip in store}
        by_split = defaultdict(set)
        for clip in store:
            # A copy of a clip of another split is a problem of its own.
            if clip.id in songs and split_of.get(clip.source, clip.split) == clip.split:
                by_split[clip.split].add(songs[clip.id])
    problems = []
    for one, other in (("train", "val"), ("train", "test"), ("val", "test")):
        shared = sorted(by_split[one] & by_split[other])
        message = f"{one} and {other} share songs"
        if official and one == "train":
            message = f"the official train and {other} share {counted(len(shared), 'song')}"
        if shared:
            severity: Literal["error", "note"] = "error" if one == "train" and not official else "note"
            problems.append(Problem(severity, where, f"{message}: {listed(shared, _SHOWN)}"))
    if alike is None:
        why = f"there are more than {MAX_PAIRS:,} pairs"
        message = f"songs were compared by name and samples, not by their sound: {why}"
        problems.append(Problem("note", where, message))
    return problems + [
        Problem("error" if pair.leaks and not official else "note", where, pair.message) for pair in alike or ()
    ]


def checked_lines(counts: Mapping[str, Mapping[str, Any]], shared: Sequence[Problem]) -> list[str]:
    """Return a warning for each leak between splits, and a line on what was checked besides."""
    leaks = [f"warning: {problem.message}" for problem in shared if problem.severity == "error"]
    notes = [problem.message for problem in shared if problem.severity == "note"]
    have_songs = {split for split, n in counts.items() if n["songs"]}
    is_clean = not leaks and all(note.startswith("val and test ") for note in notes)
    if is_clean and "train" in have_songs and len(have_songs) > 1:
        notes.insert(0, "no song of train is in val or test")
    return [*leaks, *([f"checked: {'; '.join(notes)}"] if notes else [])]


@dataclass(frozen=True)
class _Recording:
    """Rows (T, D) of a song that are compared, of mean 0 and deviation 1; 0 where `stored` (T,) is false."""

    song: str
    splits: frozenset[str]
    rows: Rows
    stored: _Mask
    dataset: int = 0  # number of the dataset

    def spectrum(self, n: int) -> npt.NDArray[np.complex64]:
        """Return the Fourier transforms of n rows: (n // 2 + 1, D + 2) of `rows`, their energy, and `stored`."""
        from scipy import fft

        energy = (self.rows * self.rows).sum(axis=1)
        return np.asarray(fft.rfft(np.column_stack([self.rows, energy, self.stored.astype(np.float32)]), n, axis=0))


def sound_field(store: Store) -> Field | None:
    """Return the audio field whose columns show how a song sounds, MFCC and chroma; None without one."""
    return next((f for f in store.fields_with() if len(_sound_columns(f)) > 12), None)


def _sound_columns(field: Field) -> list[int]:
    """Return MFCC without the first, which is the loudness, and chroma."""
    columns, numbers = field.columns, range(field.columns.width)
    chroma = (numbers[columns.slice(name)] for name in columns.names if name.startswith("chroma"))
    return [*(numbers[columns.slice("mfcc")][1:] if "mfcc" in columns.names else ()), *itertools.chain(*chroma)]


def alike_songs(store: Store, songs: Mapping[str, str]) -> list[AlikeSongs] | None:
    """Find songs of different splits that sound like one recording, such as a song and its MP3 copy.

    The rows of `sound_field` are compared at the shift of their largest normalised cross-correlation, in pieces of
    half a second; the likeness is the correlation of the piece at the lowest tenth. At least 5 s have to be in both.
    Another speed or key is another song. Of slices, those of the clip with the most are taken.

    Returns by falling likeness; None where there are more than MAX_PAIRS pairs. `songs`: See `songs_of`.
    """
    field = sound_field(store)
    if field is None or len(store.splits) < 2:
        return []
    chosen = _clips_of_song(store, songs)
    if len(chosen) * (len(chosen) - 1) // 2 > MAX_PAIRS:
        return None
    recordings = list(_recordings(store, songs, chosen, field))
    # Songs that are not both in one split alone.
    return _alike(recordings, _compared_rate(field), lambda a, b: a.song != b.song and len(a.splits | b.splits) > 1)


def alike_between(one: Store, other: Store, equal: Container[tuple[str, str]] = ()) -> list[AlikeSongs] | str:
    """Find songs of one dataset that sound like one of another, but `equal` ones; text: why they are not compared."""
    pairs = itertools.product(filter(_compared, one.fields_with()), filter(_compared, other.fields_with()))
    fields = next((pair for pair in pairs if _compared(pair[0]) == _compared(pair[1])), None)
    if fields is None:
        return "they have no field with MFCC and chroma in common, as librosa35"
    stores = (one, other)
    songs = [songs_of(store.clips()) for store in stores]
    chosen = [_clips_of_song(store, of_store) for store, of_store in zip(stores, songs, strict=True)]
    if len(chosen[0]) * len(chosen[1]) > MAX_PAIRS:
        return f"there are more than {MAX_PAIRS:,} pairs"
    recordings = [r for k in (0, 1) for r in _recordings(stores[k], songs[k], chosen[k], fields[k], k)]

    def are_compared(a: _Recording, b: _Recording) -> bool:
        return (
            a.dataset != b.dataset and ((a.song, b.song) if a.dataset < b.dataset else (b.song, a.song)) not in equal
        )

    return _alike(recordings, _compared_rate(fields[0]), are_compared)


def _compared(field: Field) -> tuple[object, ...] | None:
    """Return what fields of two datasets have in common where their rows are compared; None for other fields."""
    is_sound = len(_sound_columns(field)) > 12
    return (field.name, field.columns.labels, _compared_rate(field)) if is_sound else None


def _compared_rate(field: Field) -> float:
    return float(field.rate) / max(1, round(float(field.rate) / _RATE))


def _clips_of_song(store: Store, songs: Mapping[str, str]) -> dict[tuple[str, str | None], list[Clip]]:
    """Return a clip for every song and signal, or all slices of the clip that has most."""
    hashes = music_hashes(store.clips())
    candidates: dict[tuple[str, str | None], dict[str, list[Clip]]] = defaultdict(dict)
    for clip in store:
        if clip.id in songs and not clip.source:
            candidates[songs[clip.id], hashes.get(clip.id)].setdefault(clip.original, []).append(clip)
    return {key: max(by_original.values(), key=len) for key, by_original in candidates.items()}


def _recordings(
    store: Store,
    songs: Mapping[str, str],
    chosen: Mapping[tuple[str, str | None], Sequence[Clip]],
    field: Field,
    dataset: int = 0,
) -> Iterator[_Recording]:
    """Yield the songs of a dataset that are long enough to be compared."""
    splits = defaultdict(set)
    for clip in store:
        if clip.id in songs:
            splits[songs[clip.id]].add(clip.split)
    rate, columns = _compared_rate(field), _sound_columns(field)
    step = round(float(field.rate) / rate)
    for (song, _), clips in chosen.items():
        rows, stored = _rows_of(store, clips, field)
        compared, exists = _comparable(rows[:, columns], stored, step, rate)
        if exists.sum() >= _OVERLAP_S * rate:
            yield _Recording(song, frozenset(splits[song]), compared, exists, dataset)


def _rows_of(store: Store, clips: Sequence[Clip], field: Field) -> tuple[Rows, _Mask]:
    """Return the rows of the song of a clip, or of the slices of one, and which there are; the mean of slices."""
    if not clips[0].slice_of:
        clip = clips[0]
        later = clip.music_offset < 0
        song = clip.rows_within(field.name)[1] if later else clip.read_song(field.name)
        return song, np.ones(len(song), dtype=bool)
    first, last = min(c.slice_start for c in clips), max(c.slice_start + c.n_frames for c in clips)
    rows = np.zeros((store.grid.rows(last - first, of=field.grid), field.columns.width), dtype=np.float32)
    count = np.zeros((len(rows), 1), dtype=np.float32)
    for clip in clips:
        begin = store.grid.rows(clip.slice_start - first, of=field.grid)
        part = clip.read(field.name)
        rows[begin : begin + len(part)] += part
        count[begin : begin + len(part)] += 1
    return (rows / np.maximum(count, 1)).astype(np.float32), count[:, 0] > 0


def _comparable(rows: npt.NDArray[Any], stored: _Mask, step: int, rate: float) -> tuple[Rows, _Mask]:
    """Return means of `step` rows, without slow changes, each column divided by its deviation; and which exist."""
    count, span = len(rows) // step, int(_SLOW_S * rate) | 1
    exists = np.asarray(stored[: count * step].reshape(count, step).all(axis=1))
    means = rows[: count * step].astype(np.float64).reshape(count, step, -1).mean(axis=1) * exists[:, None]
    if exists.any():
        from scipy.ndimage import uniform_filter1d

        weights = uniform_filter1d(exists.astype(np.float64), span, mode="nearest")[:, None]
        means -= uniform_filter1d(means, span, axis=0, mode="nearest") / np.maximum(weights, 1e-9)
        means -= means[exists].mean(axis=0)
        means /= np.maximum(means[exists].std(axis=0), 1e-9)
    return np.asarray(means * exists[:, None], dtype=np.float32), exists


def _alike(
    recordings: Sequence[_Recording], rate: float, are_compared: Callable[[_Recording, _Recording], bool]
) -> list[AlikeSongs]:
    """Return the pairs of recordings that reach LIKENESS, by falling likeness."""
    from scipy import fft

    ordered = sorted(recordings, key=lambda r: len(r.rows))
    place_of = {id(r): k for k, r in enumerate(recordings)}
    end, alike = 0, []
    while end < len(ordered):
        begin, end = end, min(len(ordered), end + _BLOCK)
        block = ordered[begin:end]
        # No recording before these is longer than the longest of them.
        n = fft.next_fast_len(2 * len(block[-1].rows), real=True)
        spectra = np.stack([r.spectrum(n) for r in block])
        for place, one in enumerate(ordered[: end - 1]):
            others = [k for k, r in enumerate(block) if begin + k > place and are_compared(one, r)]
            if others:
                x, y = one.spectrum(n).conj(), spectra[others]
                both = np.einsum("fd,bfd->bf", x[:, :-2], y[..., :-2])
                products = [both, x[:, -2] * y[..., -1], x[:, -1] * y[..., -2], x[:, -1] * y[..., -1]]
                for k, sums in zip(others, fft.irfft(np.stack(products, axis=1), n), strict=True):
                    likeness, shift = _likeness(one, block[k], sums, rate)
                    if likeness >= LIKENESS:
                        turned = place_of[id(one)] > place_of[id(block[k])]
                        a, b, shift = (block[k], one, -shift) if turned else (one, block[k], shift)
                        songs, splits = (a.song, b.song), (a.splits, b.splits)
                        alike.append(AlikeSongs(songs, splits, likeness, shift / rate, a.dataset != b.dataset))
    return sorted(alike, key=lambda pair: -pair.likeness)


def _likeness(a: _Recording, b: _Recording, sums: npt.NDArray[Any], rate: float) -> tuple[float, int]:
    """Return the likeness of two songs, and the shift in rows from `a` to `b` at which they are most alike.

    `sums`: (4, n) over the rows t that both have, with ``t + shift`` of `b`, at index `shift`; negative shifts count
        from the end: of the products, the energy of `a`, the energy of `b`, and their number.
    """
    least = round(_OVERLAP_S * rate)
    shifts = np.arange(least - len(a.rows), len(b.rows) - least + 1)
    products, *energies, n = sums[:, shifts]
    floor = _SILENT * a.rows.shape[1] * np.maximum(n, 1)
    alike = products / np.sqrt(np.maximum(energies[0], floor) * np.maximum(energies[1], floor))
    best = int(np.argmax(np.where(np.rint(n) >= least, alike, -np.inf)))
    if round(n[best]) < least:
        return 0.0, 0
    shift, size = int(shifts[best]), max(1, round(_PIECE_S * rate))
    begin, end = max(0, -shift), min(len(a.rows), len(b.rows) - shift)
    end -= (end - begin) % size
    parts = slice(begin, end), slice(begin + shift, end + shift)
    whole = np.asarray((a.stored[parts[0]] & b.stored[parts[1]]).reshape(-1, size).all(axis=1))
    x, y = (r.rows[part].reshape(len(whole), -1)[whole] for r, part in zip((a, b), parts, strict=True))
    x2, y2 = (x * x).sum(axis=1), (y * y).sum(axis=1)
    heard = np.maximum(x2, y2) > _SILENT * max(x2.mean(), y2.mean()) if whole.any() else whole[:0]
    pieces = (x * y).sum(axis=1)[heard] / np.sqrt(np.maximum(x2 * y2, 1e-9))[heard]
    return (float(np.quantile(pieces, _WEAKEST)), shift) if heard.any() else (0.0, 0)
