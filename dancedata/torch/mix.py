"""Mix: samples of several datasets, in stated shares."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.arguments import names, whole
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.sample_id import SampleId, safe_name
from dancedata.core.text import listed, shown
from dancedata.core.typing import override
from dancedata.store.columns import MAX_ROWS
from dancedata.store.dataset import Store
from dancedata.store.normalize import Scaler
from dancedata.torch.batch_reader import Array, Layout, ReadBatch
from dancedata.torch.draws import uniform
from dancedata.torch.epochs import EpochDataset, require_scalers
from dancedata.torch.sampler import permutation
from dancedata.torch.split_dataset import SplitDataset
from dancedata.torch.windows import WindowDataset

IntArray = npt.NDArray[np.int64]
#: Stream of random numbers that choose samples of a source; 1 to 9 are those of orders, changes and texts.
_SOURCE_STREAM = 10


class Mix(EpochDataset):
    """Samples of several datasets of windows, clips or groups; each epoch has exact shares of each.

    ``Mix({"aist": a, "finedance": b}, weights=(1, 3))`` has as many samples as both together, a quarter of them of
    `a`. A source is read pass after pass, each in a new order: of a large one each epoch has another part, a small
    one is repeated, and over any number of epochs the counts of its samples differ by one at most. A sample is as its
    dataset gives it, with ``"source"`` (name), ``"source_id"`` (number) and an ``"id"`` that begins with the source.

    Samplers, ranks, workers and resuming are as for one dataset: `EpochSampler`, `BatchLoader`, `BatchStream`. Each
    field has one scaler, whose range covers those of all sources: decode a model's columns with ``scaler=mix``.

    Parameters
    ----------
    datasets
        Readers of one kind, by name.
    weights
        Shares of the samples of an epoch, in any unit. Default: every sample once an epoch.
    n_samples
        Samples of an epoch. Default: as many as the datasets have together.
    seed
        Whole number >= 0, of the order in which sources are read.

    Raises
    ------
    UsageError
        If the datasets differ in kind, fields, rates, columns or body, which lists all that differs; for weights that
        are not shares, and where a source would have no sample.

    Attributes
    ----------
    sources
        Names of the datasets.
    datasets
        The datasets as they are read, copies of those that were passed; each reads ids that begin with its name, too.
    counts
        Samples of each source in an epoch. Exact shares are rounded by largest remainders, ties to the first.

    Notes
    -----
    The samples of an epoch are a pure function of (seed, epoch), and their random changes of the datasets' seeds and
    the number of the pass. Without an epoch, under shuffling by torch, shares are exact too, but samples of a source
    that is not read whole are drawn by torch's generator, and may repeat.

    Examples
    --------
    >>> from dancedata.torch import Mix, WindowDataset
    >>> parts = {split: WindowDataset("data/aistpp", split) for split in ("train", "test")}
    >>> Mix(parts, weights=(3, 1), n_samples=8).counts
    (6, 2)
    """

    def __init__(
        self,
        datasets: Mapping[str, SplitDataset],
        *,
        weights: Sequence[float] | None = None,
        n_samples: int | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__()
        by_name = dict(datasets) if isinstance(datasets, Mapping) else {}
        if not by_name or not all(isinstance(reader, SplitDataset) for reader in by_name.values()):
            raise UsageError("a mix is made of readers", found=shown(datasets), allowed="readers by name")
        self.sources = names("datasets", by_name)
        _require_alike(by_name)
        self.seed = whole("seed", seed)
        sizes = [len(dataset) for dataset in by_name.values()]
        total = sum(sizes) if n_samples is None else whole("n_samples", n_samples, 1, MAX_ROWS)
        self.counts = _counts(self.sources, sizes, _shares(sizes, weights), total)
        first = next(iter(by_name.values()))
        self.fields, self.normalized = first.fields, first.normalized
        scalers = {name: _joint([d.scaler(name) for d in by_name.values()]) for name in self.normalized}
        self.datasets = tuple(d.rescaled(scalers, name) for name, d in by_name.items())
        self._begin = np.concatenate([[0], np.cumsum(self.counts)])
        whole_sources = all(count % size == 0 for count, size in zip(self.counts, sizes, strict=True))
        self._is_random = not whole_sources or any(dataset._is_random for dataset in self.datasets)
        self._chosen: tuple[int, list[tuple[IntArray, IntArray]]] | None = None

    @override
    def __len__(self) -> int:
        return int(self._begin[-1])

    def __repr__(self) -> str:
        parts = ", ".join(f"{name}: {count:,}" for name, count in zip(self.sources, self.counts, strict=True))
        return f"Mix({parts}; fields: {', '.join(self.fields)})"

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_chosen": None}

    def __getitem__(self, index: int | str | SampleId) -> dict[str, Any]:
        """Return one sample; negative indices count from the end; IndexError outside the mix. An id is read again."""
        if not isinstance(index, str | SampleId):
            return self.samples([index])[0]
        of = SampleId.parse(index)
        if of.source not in self.sources:
            raise UsageError("the mix has no such source", where=str(index), found=of.source,
                             fix=did_you_mean(of.source, self.sources))  # fmt: skip
        number = self.sources.index(of.source)
        sample = self.datasets[number]._read_again(of)
        return sample | self._about(number, sample["id"], sample["genre"])

    @override
    def samples(self, indices: Sequence[int], epoch: int | None = None) -> list[dict[str, Any]]:
        samples: list[dict[str, Any]] = [{}] * len(indices)
        for number, rows, places, of_part in self._parts(indices, epoch):
            of_source = self.datasets[number].samples(places, of_part)
            for row, sample in zip(rows, of_source, strict=True):
                sample |= self._about(number, sample["id"], sample["genre"])
                samples[row] = sample
        return samples

    @property
    def store(self) -> Store:
        """The dataset of which all sources are; UsageError where they are of several."""
        stores = {str(dataset.store.info.get("self_sha256")): dataset.store for dataset in self.datasets}
        if len(stores) > 1:
            raise UsageError("a mix of several datasets is like none of them", found=listed(self.sources),
                             fix="name one of the datasets, and scaler=mix")  # fmt: skip
        return next(iter(stores.values()))

    def scaler(self, field: str) -> Scaler:
        """Return the scaler of a field, over all sources: its range covers those of their scalers."""
        return _joint([dataset.scaler(field) for dataset in self.datasets])

    def state_dict(self) -> dict[str, Any]:
        """Return the hashes of the scalers, {"scalers": {field: hash}}."""
        hashes = self.datasets[0].state_dict()["scalers"]
        return {"scalers": {name: hashes[name] for name in self.normalized}}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Check that the model of a checkpoint was trained with these scalers; UsageError if not; changes nothing."""
        require_scalers(state, self.state_dict(), "mix the datasets of that training")

    @cached_property
    def genre_ids(self) -> Mapping[str, int]:
        """The number of each genre: as the datasets number them if they agree, else 0, 1, ... by name, over all."""
        numbers: dict[str, int] = {}
        for of_source in (dataset.genre_ids for dataset in self.datasets):
            numbers |= {name: number for name, number in of_source.items() if name not in numbers}
        pairs = {pair for dataset in self.datasets for pair in dataset.genre_ids.items()}
        if len(pairs) == len(numbers) == len(set(numbers.values())):
            return numbers
        return {name: number for number, name in enumerate(sorted(numbers))}

    def _about(self, number: int, sample_id: str, genre: str) -> dict[str, Any]:
        source = self.sources[number]
        genre_id = self.genre_ids.get(genre, -1)
        return {"id": f"{safe_name(source)}={sample_id}", "genre_id": genre_id, "source": source, "source_id": number}

    def _parts(self, indices: Sequence[int], epoch: int | None) -> Iterator[tuple[int, list[int], list[int], int]]:
        """Yield source, rows of the batch, places in the source and the epoch there, for each source and pass."""
        epoch_number = self.epoch if epoch is None else whole("epoch", epoch)
        at = np.array([self._place(index) for index in indices], dtype=np.int64)
        source = np.searchsorted(self._begin, at, side="right") - 1
        by_chance = self._drawn_epoch(None) if epoch_number is None else 0
        for number in np.unique(source).tolist():
            rows = np.flatnonzero(source == number)
            nth = at[rows] - self._begin[number]
            if epoch_number is None:
                passes, places = np.full(len(nth), by_chance), self._by_chance(number, nth, by_chance)
            else:
                passes, places = (values[nth] for values in self._choice(epoch_number)[number])
            for turn in np.unique(passes).tolist():
                of_turn = passes == turn
                yield number, rows[of_turn].tolist(), places[of_turn].tolist(), turn

    def _choice(self, epoch: int) -> list[tuple[IntArray, IntArray]]:
        """Return pass and place of the samples of an epoch, (count,) each, for every source."""
        if self._chosen is None or self._chosen[0] != epoch:
            numbers = range(len(self.datasets))
            self._chosen = epoch, [self._of_source(number, epoch * self.counts[number]) for number in numbers]
        return self._chosen[1]

    def _of_source(self, number: int, first: int) -> tuple[IntArray, IntArray]:
        """Return pass and place of a source's samples from position `first` of its endless order on, sorted."""
        size, count = len(self.datasets[number]), self.counts[number]
        turns = range(first // size, (first + count - 1) // size + 1)
        orders = np.concatenate([permutation(size, self.seed, _SOURCE_STREAM, number, turn) for turn in turns])
        skipped = first - turns[0] * size
        passes = np.repeat(np.array(turns, dtype=np.int64), size)[skipped : skipped + count]
        places = orders[skipped : skipped + count]
        order = np.lexsort((places, passes))  # a source that is read whole comes in its own order
        return passes[order], places[order]

    def _by_chance(self, number: int, nth: IntArray, draw: int) -> IntArray:
        size = len(self.datasets[number])
        if self.counts[number] % size == 0:
            return nth % size
        drawn = uniform(self.seed, _SOURCE_STREAM + number, draw, nth.tolist())
        return np.floor(drawn * size).astype(np.int64)

    # What a BatchLoader asks of a WindowDataset.

    @property
    def _layout(self) -> Layout:
        return _windows(self.datasets[0])._layout

    def _planned(self, indices: Sequence[int], epoch: int | None = None) -> ReadBatch:
        parts = [
            (number, rows, _windows(self.datasets[number])._planned(places, of_part))
            for number, rows, places, of_part in self._parts(indices, epoch)
        ]

        def read(out: Mapping[str, Array]) -> dict[str, list[Any]]:
            values: dict[str, list[Any]] = {}
            for number, rows, read_part in parts:
                arrays = {name: np.empty((len(rows), *array.shape[1:]), array.dtype) for name, array in out.items()}
                of_part = read_part(arrays)
                for name, array in arrays.items():
                    out[name][rows] = array
                labels = zip(of_part["id"], of_part["genre"], strict=True)
                about = [self._about(number, sample_id, genre) for sample_id, genre in labels]
                of_part |= {key: [entry[key] for entry in about] for key in about[0]}
                for key, column in of_part.items():
                    target = values.setdefault(key, [None] * len(indices))
                    for row, value in zip(rows, column, strict=True):
                        target[row] = value
            return values

        return read


def _windows(dataset: SplitDataset) -> WindowDataset:
    if not isinstance(dataset, WindowDataset):
        raise UsageError(
            "a BatchLoader reads windows", found=type(dataset).__name__, fix="read clips with a DataLoader"
        )
    return dataset


def _shares(sizes: Sequence[int], weights: Sequence[float] | None) -> list[Fraction]:
    if weights is None:
        return [Fraction(size, max(sum(sizes), 1)) for size in sizes]
    try:
        numbers = [float(weight) for weight in weights]
    except (TypeError, ValueError, OverflowError):
        numbers = []
    if len(numbers) != len(sizes) or not all(0 < number < float("inf") for number in numbers):
        raise UsageError("weights do not fit the sources", found=shown(weights),
                         allowed=f"{len(sizes)} numbers above 0, one for each source")  # fmt: skip
    parts = [Fraction(number) for number in numbers]
    return [part / sum(parts) for part in parts]


def _counts(sources: Sequence[str], sizes: Sequence[int], shares: Sequence[Fraction], total: int) -> tuple[int, ...]:
    """Round shares of `total` samples by largest remainders."""
    exact = [share * total for share in shares]
    counts = [int(value) for value in exact]
    by_remainder = sorted(range(len(exact)), key=lambda k: (counts[k] - exact[k], k))
    for k in by_remainder[: total - sum(counts)]:
        counts[k] += 1
    for name, size, count in zip(sources, sizes, counts, strict=True):
        if not size or not count:
            raise UsageError("a source of the mix would have no sample", where=name,
                             found=f"{size:,} samples, {count:,} in an epoch of {total:,}",
                             fix="leave it out, or give n_samples or another weight")  # fmt: skip
    return tuple(counts)


def _joint(scalers: Sequence[Scaler]) -> Scaler:
    """Return the scaler whose range covers those of all, or that all have; it is of no dataset."""
    first = scalers[0]
    kinds = {scaler.kind for scaler in scalers}
    if len({scaler.sha256 for scaler in scalers}) == 1 and kinds == {"zscore"}:
        return first
    if kinds != {"minmax"}:
        raise UsageError(
            "z-scores of several sources do not join", found=listed(map(repr, scalers)),
            fix="name one for all sources, scale={FIELD: Scaler(...)}",
        )  # fmt: skip
    low, high = (np.stack([getattr(s, name) for s in scalers]) for name in ("data_min", "data_max"))
    return Scaler(
        "minmax", low.min(axis=0), high.max(axis=0), dtype=first.dtype, field=first.field, columns=first.columns
    )


def _require_alike(by_name: Mapping[str, SplitDataset]) -> None:
    (first_name, first), *others = by_name.items()
    expected, problems = _properties(first), []
    for name, dataset in others:
        properties = _properties(dataset)
        # What one of them lacks follows from the kind and the fields.
        for key in [key for key in expected if key in properties]:
            here, there = properties[key], expected[key]
            if here != there:
                problems.append(f"{name}: {key}: {shown(here, 80)}; {first_name}: {shown(there, 80)}")
    if problems:
        raise UsageError("datasets of a mix do not agree\n  - " + "\n  - ".join(problems),
                         fix="read them with the same arguments; build again what differs in fields, rates or body "
                         "(the transform retarget gives one body)")  # fmt: skip


def _properties(dataset: SplitDataset) -> dict[str, str]:
    store = dataset.store
    recipe = store.info.get("recipe") or {}
    properties = {
        "kind": type(dataset).__name__,
        "fields": ", ".join(dataset.fields),
        "normalised": ", ".join(dataset.normalized) or "nothing",
        "clamp": str(dataset.clamp),
        "values beside the fields": ", ".join(n for n in dataset.samples([0], 0)[0] if n not in dataset.fields),
        "frames per second": str(store.grid),
        "body": store.skeleton.name,
        "offsets of the body": str(store.skeleton.offsets.round(6).tolist()),
    }
    if isinstance(dataset, WindowDataset):
        properties["relative to their first frame"] = ", ".join(dataset._items.relative) or "none"
        properties |= {f"shape of {name}": f"{shape} of {dtype}" for name, (shape, dtype) in dataset._layout.items()}
    for name in dataset.fields:
        field = store.field(name)
        properties[f"rate of {name}"] = str(field.rate)
        properties[f"columns of {name}"] = f"{field.columns.width}, {', '.join(field.columns.labels)}"
        properties[f"parameters of {name}"] = str((recipe.get(field.kind) or {}).get(name, ""))
        if field.codebook is not None:
            properties[f"codebook of {name}"] = str(field.codebook.to_json())
    return properties
