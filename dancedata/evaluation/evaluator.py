"""Evaluation in a training loop: batches of generated columns come in, a protocol's numbers come out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy.typing as npt

from dancedata.core.arguments import as_numpy
from dancedata.core.dance import MusicBeats
from dancedata.core.errors import DataError, UsageError
from dancedata.core.text import counted, listed, shown
from dancedata.evaluation.clips import reader_for, truth_of
from dancedata.evaluation.evaluate import pool_for
from dancedata.evaluation.measuring import MeasuredClip, measure_pose
from dancedata.evaluation.music import ClipMusic, about_slices, beat_field, music_of
from dancedata.evaluation.options import EvaluationOptions
from dancedata.evaluation.protocol import Protocol, protocol_named
from dancedata.evaluation.report import Report, report_of
from dancedata.evaluation.samples import Trace, gather_by_torch, sample_lengths
from dancedata.evaluation.scores import DRAWS
from dancedata.kernel import Cache, Sample, Samples, Scaler, Store, TrainingData
from dancedata.scene.inputs.clip import MemoryClip
from dancedata.scene.inputs.naming import of_sample
from dancedata.scene.like import opened, scaling_of, store_of

if TYPE_CHECKING:
    from torch import Tensor

#: Takes a list of objects of this process and returns those of all, as accelerate.utils.gather_object does.
Gather = Callable[[list[Any]], list[Any]]
#: Samples of a process: measured, left out with the reason, and traces.
_Part = tuple[list[MeasuredClip], list[tuple[str, str]], dict[str, Trace]]
#: Largest difference in length of music and motion, rows.
_ROWS = 2


def _of_dancers(protocol: str | Protocol) -> Protocol:
    """Return a protocol; UsageError for one of groups."""
    named = protocol_named(protocol)
    if named.of_groups:
        raise UsageError(
            f"{named.name} measures groups, and an Evaluator single dancers",
            fix="save the samples, a group in each file, and give them to dancedata.evaluate",
        )
    return named


class Evaluator:
    """Collects the numbers of generated samples over an epoch, and compares them with a pool at its end.

    Samples are decoded and measured as they come; only their numbers are kept. Their ids say which dances of the
    dataset they are of: the same samples have the same numbers here and as files of these names.

    Parameters
    ----------
    like
        The dataset that the model was trained on, or a reader of it: its columns, scaler and rate are those of the
        samples. A reader states whether samples are normalised, as its own are.
    field
        Motion field that the model generates. Default: the first one that has the protocol's joints.
    protocol
        Name of a protocol, or an object of one.
    pool
        Another dataset, or a file of `save_pool`, to compare samples with. Default: `like`.
    split
        Splits of the pool. Default: the protocol's, such as train.
    music
        Audio field of the beats, of which `update` may get other rows. Default: the one with the protocol's beats.
    normalized
        Whether samples are normalised by the dataset's scaler; with a dataset it has to be stated.
    scaler
        Another scaler, or the file of its ``save``: samples are normalised by it.
    clamp
        Whether normalised values are cut to [-1, 1] before, as EDGE and Lodge do.
    jobs, cache
        As in `dancedata.evaluate`, for the pool, which is measured now.

    Attributes
    ----------
    store, field
        The dataset, and its motion field.

    Raises
    ------
    UsageError
        If the field does not have the protocol's joints, the pool is of another protocol, version, rate or scaler, or
        nothing states whether samples are normalised.

    Examples
    --------
    >>> from torch.utils.data import DataLoader
    >>> from dancedata import Evaluator
    >>> from dancedata.torch import WindowDataset
    >>> evaluator = Evaluator("data/aistpp", "edge151", normalized=True)
    >>> for batch in DataLoader(WindowDataset("data/aistpp", "val"), batch_size=4):
    ...     samples = batch["edge151"]  # of a model that has heard batch["librosa35"]
    ...     evaluator.update(samples, batch["id"])
    >>> evaluator.gather().compute()["fid_k"].value >= 0
    True
    """

    def __init__(
        self,
        like: str | Path | Store | TrainingData,
        field: str | None = None,
        *,
        protocol: str | Protocol = "dancedata",
        pool: str | Path | Store | None = None,
        split: str | None = None,
        music: str | None = None,
        normalized: bool | None = None,
        scaler: Scaler | str | Path | None = None,
        clamp: bool = False,
        jobs: int = 1,
        cache: str | Path | None = None,
    ) -> None:
        self.protocol = rules = _of_dancers(protocol)
        reader = opened(like)
        self.store = store_of(reader)
        self.field, columns = reader_for(self.store, rules.motion, field)
        labels = columns.representation.columns.labels
        scaling = scaling_of(reader, self.field, labels, normalized=normalized, scaler=scaler, clamp=clamp)
        if scaling.normalized is None:
            raise scaling.unstated(f"{self.store.path}, field {self.field}")
        self.reader = replace(columns, scaling=scaling)
        request = EvaluationOptions(
            what={}, protocol=rules, pool=pool, pool_split=split, like=self.store, field=self.field,
            normalized=scaling.normalized, scaler=scaling.scaler if scaling.normalized else None,
        )  # fmt: skip
        self._cache = Cache.at(cache)
        self.pool = pool_for(request, self._cache, jobs=jobs)
        if self.pool is not None:
            self.pool.require(rules, str(rules.motion.grid or self.reader.grid))
        self._samples = Samples(self.store)
        name = music or (None if rules.music is None else beat_field(self.store, rules.music, rules.generated))
        self.music_field = None if name is None else self.store.field(name)
        self._music_of = lru_cache(maxsize=4096)(partial(music_of, self.store, name or ""))
        self._real: dict[str, MeasuredClip] = {}
        self.reset()

    def __len__(self) -> int:
        """Return the number of samples, those of other processes too after `gather`."""
        return len(self._measured) + len(self._left_out)

    def __repr__(self) -> str:
        return f"Evaluator({self.protocol.name!r}, {counted(len(self), 'sample')})"

    def reset(self) -> None:
        """Forget all samples, for the next epoch."""
        self._measured: dict[str, MeasuredClip] = {}
        self._left_out: dict[str, str] = {}
        self._traces: dict[str, Trace] = {}

    def update(
        self,
        samples: npt.ArrayLike | Tensor,
        ids: Sequence[str],
        *,
        lengths: npt.ArrayLike | Tensor | None = None,
        music: npt.ArrayLike | Tensor | None = None,
    ) -> None:
        """Measure a batch.

        Parameters
        ----------
        samples
            (B, L, D) columns, torch or numpy, on any device.
        ids
            What the samples are of the dataset: ``batch["id"]`` of a reader. A repeated one, with the same motion,
            counts once: samplers repeat samples to fill up. Further samples of a window are numbered, ``~s1``.
        lengths
            (B,) rows of motion that each sample has, where it is padded: ``batch["lengths"]["edge151"]`` of
            `pad_clips`. Motion and music after them do not count. Default: all.
        music
            Other music than that of the dataset: (B, M, D') rows of the audio field, or (B, M) its column of beats.
            They have the motion's length at the field's rate, within two rows.

        Raises
        ------
        UsageError
            For arrays that are not such a batch, padded motion without lengths, music of another length, or another
            motion or music under an id that exists.
        DataError
            "no_clip" and "outside", for ids that are not of the dataset.
        """
        batch = as_numpy(samples)
        if batch.ndim != 3:
            raise UsageError("a batch of motion has three axes", found=f"shape {batch.shape}", allowed="(B, L, D)")
        width = self.reader.representation.columns.width
        if batch.shape[2] != width:
            raise UsageError(f"a batch of motion does not have the columns of {self.reader.representation.name}",
                             found=f"shape {batch.shape}", allowed=f"(B, L, {width})")  # fmt: skip
        if isinstance(ids, str) or len(ids) != len(batch):
            raise UsageError("ids do not match the samples", found=shown(ids),
                             allowed=f'{len(batch)}, as batch["id"] has them')  # fmt: skip
        of_dataset = [self.sample(name) for name in ids]
        sizes = sample_lengths(batch, ids, None if lengths is None else as_numpy(lengths))
        rows = None if music is None else self._beats(as_numpy(music), batch.shape[1], sizes, lengths is not None)
        for k, sample in enumerate(of_dataset):
            beats, columns = None if rows is None else rows[k], batch[k, : sizes[k]]
            if not self._repeats(str(sample.id), Trace.of(columns, beats)):
                self._measure(sample, columns, None if beats is None else ClipMusic(beats))

    def sample(self, name: str) -> Sample:
        """Return what an id names in the dataset; DataError "no_clip" or "outside" if it names nothing."""
        return self._samples.require(name)

    def _repeats(self, name: str, trace: Trace) -> bool:
        """Whether a sample is a repeated one; UsageError if it has the id of another one."""
        first = self._traces.setdefault(name, trace)
        if not first.same(trace):
            raise UsageError("different samples have the same id", found=name,
                             fix=f"number them: {name}, {name}~s1 and so on")  # fmt: skip
        return first is not trace

    def _measure(self, sample: Sample, columns: npt.NDArray[Any], music: ClipMusic | None) -> None:
        name = str(sample.id)
        try:
            pose = self.reader.pose(columns, where=f"sample {name}")
            clip = of_sample(MemoryClip(id=name, joints=pose.joints, grid=pose.grid), sample)
            pose = clip.as_stated(pose)
            if music is None and self.music_field is not None:
                music = self._music(sample)
            numbers = measure_pose(self.protocol, "generated", range(len(self.protocol.measures)), pose, music)
        except DataError as error:
            self._left_out[name] = str(error)
            return
        self._measured[name] = MeasuredClip.of(clip, numbers)

    def _music(self, sample: Sample) -> ClipMusic:
        return self._music_of(sample.clip.id).from_second(sample.music_start_s - sample.clip.audio_start)

    def _beats(self, music: npt.NDArray[Any], whole: int, sizes: Sequence[int], padded: bool) -> list[MusicBeats]:
        """Return the beats of each sample, of motion of `sizes` rows in a batch of `whole` rows."""
        field = self.music_field
        if field is None:
            raise UsageError(
                "the dataset has no beats of this protocol", found=f"protocol {self.protocol.name}",
                fix="leave out music, or name the audio field: Evaluator(..., music=FIELD)",
            )  # fmt: skip
        if music.ndim not in (2, 3):
            raise UsageError(
                "music has two or three axes", found=f"shape {music.shape}", allowed="(B, M, D) or (B, M)"
            )
        if music.ndim == 3 and music.shape[2] != field.columns.width:
            raise UsageError("music does not fit the audio field of the dataset", found=f"shape {music.shape}",
                             allowed=f"(B, M, {field.columns.width}), "
                             f"beats in column {field.columns.slice('beat').start}, or (B, M)")  # fmt: skip
        if len(music) != len(sizes):
            raise UsageError("music and motion differ in length", found=f"{len(music)} and {len(sizes)}")
        grid, n = self.reader.grid, music.shape[1]
        ends, longest = [grid.rows_up(size, of=field.grid) for size in sizes], grid.rows_up(whole, of=field.grid)
        padded_more = padded and field.grid != grid  # fields of other rates are padded by other amounts
        if n < max(ends, default=0) - _ROWS or (n > longest + _ROWS and not padded_more):
            raise UsageError(
                "music and motion of a batch differ in length",
                found=f"{n} rows of music, {whole} of motion",
                allowed=f"{longest} rows of {field.name}, which has {field.grid.rate} per second, within {_ROWS}",
                fix="give the rows of the same frames; a field of a different rate: Evaluator(..., music=FIELD)",
            )  # fmt: skip
        return [field.beats(rows[:end]) for rows, end in zip(music, ends, strict=True)]

    def gather(self, gather: Gather | None = None, *, repeated: Literal["same", "first"] = "same") -> Self:
        """Join the samples of all processes; every process has to call it, and then has all of them.

        Parameters
        ----------
        gather
            Returns the objects of all processes, such as ``accelerate.utils.gather_object``. Default:
            torch.distributed, where it is initialised, as under Lightning; a single process keeps its own.
        repeated
            "same": samples of two processes with the same id agree in motion and music, as those of a model without
            noise do.
            "first": that of the first process counts, and the others are not compared.

        Raises
        ------
        UsageError
            If different samples have the same id.
        """
        part: _Part = (list(self._measured.values()), list(self._left_out.items()), self._traces)
        parts: list[_Part] = (gather or gather_by_torch)([part])
        first: dict[str, Trace] = {}
        differ = {
            name
            for *_, traces in parts
            for name, trace in traces.items()
            if not first.setdefault(name, trace).same(trace)
        }
        if differ and repeated == "same":
            raise UsageError(
                "different samples of two processes have the same id", found=listed(sorted(differ)),
                fix='give each its own, as readers do: ids=batch["id"]; where samplers repeat samples to fill up, '
                'and a model with noise makes other motion of them: gather(..., repeated="first")',
            )  # fmt: skip
        # The first process that has a sample counts: the same one in every process.
        self.reset()
        self._traces = first
        for measured, left_out, _ in parts:
            for clip in measured:
                if clip.id not in self._left_out:
                    self._measured.setdefault(clip.id, clip)
            for name, reason in left_out:
                if name not in self._measured:
                    self._left_out.setdefault(name, reason)
        return self

    def compute(self, *, intervals: bool = True) -> Report:
        """Return the report of all samples so far.

        Parameters
        ----------
        intervals
            Whether scores have intervals of 95 percent, as of `dancedata.evaluate`.

        Raises
        ------
        UsageError
            If no sample could be measured, with the reason of the first.
        """
        if not self._measured:
            reason = next(iter(self._left_out.values()), "no batch was given to update")
            raise UsageError("no sample could be measured", found=reason)
        clips = [self._measured[name] for name in sorted(self._measured)]
        return report_of(
            self.protocol, clips, self.pool, role="generated", source="samples of a model",
            draws=DRAWS if intervals else 0, warnings=self._about_music(), left_out=sorted(self._left_out.items()),
            truth=self._truth(), truth_source=f"the same dances of {self.store.path.name}",
            dataset=self.store.reader_name, cache=self._cache,
        )  # fmt: skip

    def _truth(self) -> list[MeasuredClip]:
        """Measure the dances of the dataset that the samples are of, each once for all epochs."""
        samples = {str(sample.id): sample for sample in map(self._samples.require, self._measured)}
        for clip in truth_of(samples, self.protocol, self.field):
            if clip.id not in self._real:
                sample = self._samples.require(clip.id)
                music = None if self.music_field is None else self._music(sample)
                numbers = range(len(self.protocol.measures))
                with suppress(DataError):
                    measured = measure_pose(self.protocol, "generated", numbers, clip.load(), music)
                    self._real[clip.id] = MeasuredClip.of(clip, measured)
        ids = {str(replace(sample.id, take=0)) for sample in samples.values()}
        return [self._real[name] for name in sorted(ids & self._real.keys())]

    def _about_music(self) -> list[str]:
        """Return what is to be known of the beats of the dataset."""
        if self.protocol.music is None or self.music_field is None:
            needed = any(measure.metric.needs_music for measure in self.protocol.measures)
            return ["no beats of music: the dataset has no audio field with those of this protocol"] * needed
        return about_slices(self.store, self.protocol.music)
