"""Evaluation in a training loop: batches of generated columns come in, a protocol's numbers come out."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import count, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy.typing as npt

from dancedata.core.dance import MusicBeats
from dancedata.core.errors import DataError, UsageError
from dancedata.core.text import counted, listed
from dancedata.evaluation.evaluate import pool_for
from dancedata.evaluation.inputs.clip import MemoryClip
from dancedata.evaluation.inputs.store import columns_problem, reader_for
from dancedata.evaluation.measuring import MeasuredClip, measure_pose
from dancedata.evaluation.music import ClipMusic, about_windows, beat_field
from dancedata.evaluation.pool import Pool
from dancedata.evaluation.protocol import Protocol, protocol_named
from dancedata.evaluation.report import Report, report_of
from dancedata.evaluation.request import Request
from dancedata.evaluation.samples import Trace, as_numpy, gather_by_torch, process_rank, sample_lengths
from dancedata.store import Store
from dancedata.store.beats import BEAT, field_beats
from dancedata.store.like import Reader, opened, scaling_of, store_of
from dancedata.store.motion_fields import ColumnsReader
from dancedata.store.normalize import Scaler
from dancedata.store.schema import Field

if TYPE_CHECKING:
    from torch import Tensor

#: Takes a list of objects of this process and returns those of all, as accelerate.utils.gather_object does.
Gather = Callable[[list[Any]], list[Any]]
#: Samples of a process: measured, left out with the reason, names that the process chose, and traces.
_Part = tuple[list[MeasuredClip], list[tuple[str, str]], list[str], dict[str, Trace]]
#: End of the ids of readers, after that of the clip: first frame, length, and augmentations.
_WINDOW = re.compile(r"@\d+\+\d+(:.*)?$", re.DOTALL)
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

    Samples are decoded and measured as they come; only their numbers are kept. Made by `Evaluator.of`.

    Parameters
    ----------
    protocol
        Name of a protocol, or an object of one.
    reader
        Reader of the columns.
    pool
        Numbers that samples are compared with; None: metrics that need a pool are not computed.
    music_field
        Audio field that rows of music are of; None without music.

    Attributes
    ----------
    store, field
        Dataset that `of` was given, and its motion field; None and "" for an evaluator that was made otherwise.

    Examples
    --------
    >>> from torch.utils.data import DataLoader
    >>> from dancedata import Evaluator
    >>> from dancedata.readers import WindowDataset
    >>> evaluator = Evaluator.of("data/aistpp", "edge151", protocol="dancedata", normalized=True)
    >>> for batch in DataLoader(WindowDataset("data/aistpp", "val", normalize=True), batch_size=4):
    ...     samples = batch["edge151"]  # of a model that has heard batch["librosa35"]
    ...     evaluator.update(samples, music=batch["librosa35"], ids=batch["id"])
    >>> evaluator.gather().compute()["fid_k"] >= 0
    True
    """

    def __init__(
        self,
        protocol: str | Protocol,
        reader: ColumnsReader,
        pool: Pool | None = None,
        *,
        music_field: Field | None = None,
    ) -> None:
        self.protocol = _of_dancers(protocol)
        self.reader = reader
        self.pool = pool
        self.music_field = music_field
        self.store: Store | None = None
        self.field = ""
        self._about_music: tuple[str, ...] = ()
        problem = columns_problem(reader, self.protocol.motion)
        if problem:
            raise UsageError(f"{self.protocol.name} cannot be computed from these columns", found=problem)
        if pool is not None:
            pool.require(self.protocol, str(self.protocol.motion.grid or reader.grid))
        self.reset()

    @classmethod
    def of(
        cls,
        store: str | Path | Store | Reader,
        field: str | None = None,
        *,
        protocol: str | Protocol = "dancedata",
        pool: str | Path | Store | None = None,
        split: str | None = None,
        music: str | None = None,
        normalized: bool | None = None,
        scaler: Scaler | str | Path | None = None,
        clip: bool = False,
        jobs: int = 1,
        cache: str | Path | None = None,
    ) -> Self:
        """Make the evaluator of a model that was trained on a dataset.

        Parameters
        ----------
        store
            The dataset, or a reader of it: its columns, scaler and rate are those of the samples. A reader states
            whether samples are normalised, as its own are.
        field
            Motion field that the model generates. Default: the first one that has the protocol's joints.
        protocol
            Name of a protocol, or an object of one.
        pool
            Another dataset, or a file of ``--save-pool``, to compare samples with. Default: `store`.
        split
            Splits of the pool. Default: the protocol's, such as train.
        music
            Audio field that `update` gets rows of. Default: the one with the protocol's beats, if the dataset has it.
        normalized
            Whether samples are normalised by the dataset's scaler; with a dataset it has to be stated.
        scaler
            Another scaler, or the file of its ``save``: samples are normalised by it.
        clip
            Whether normalised values are cut to [-1, 1] before, as EDGE and Lodge do.
        jobs, cache
            As in `dancedata.evaluate`, for the pool, which is measured now.

        Raises
        ------
        UsageError
            If the field does not have the protocol's joints, the pool is of another protocol, version, rate or
            scaler, or nothing states whether samples are normalised.
        """
        rules = _of_dancers(protocol)
        like = opened(store)
        dataset = store_of(like)
        name, reader = reader_for(dataset, rules.motion, field)
        columns = reader.representation.columns.labels
        scaling = scaling_of(like, name, columns, normalized=normalized, scaler=scaler, clip=clip)
        if scaling.normalized is None:
            raise scaling.unstated(f"{dataset.path}, field {name}")
        reader = replace(reader, scaling=scaling)
        beats = music or (None if rules.music is None else beat_field(dataset, rules.music, rules.generated))
        request = Request(
            what={},
            protocol=rules,
            pool=pool,
            pool_split=split,
            like=dataset,
            field=name,
            normalized=scaling.normalized,
            scaler=scaling.scaler if scaling.normalized else None,
        )
        pool_of_truth = pool_for(request, jobs=jobs, cache=None if cache is None else Path(cache))
        evaluator = cls(rules, reader, pool_of_truth, music_field=None if beats is None else dataset.field(beats))
        evaluator.store, evaluator.field = dataset, name
        evaluator._about_music = () if rules.music is None else tuple(about_windows(dataset, rules.music))
        return evaluator

    def __len__(self) -> int:
        """Return the number of samples, those of other processes too after `gather`."""
        return len(self._measured) + len(self._left_out)

    def __repr__(self) -> str:
        return f"Evaluator({self.protocol.name!r}, {counted(len(self), 'sample')})"

    def reset(self) -> None:
        """Forget all samples, for the next epoch."""
        self._measured: dict[str, MeasuredClip] = {}
        self._left_out: dict[str, str] = {}
        self._unnamed: list[str] = []
        self._traces: dict[str, Trace] = {}

    def update(
        self,
        motion: npt.ArrayLike | Tensor,
        *,
        ids: Sequence[str] | None = None,
        music: npt.ArrayLike | Tensor | None = None,
        lengths: npt.ArrayLike | Tensor | None = None,
    ) -> None:
        """Measure a batch.

        Parameters
        ----------
        motion
            (B, L, D) columns, torch or numpy, on any device.
        ids
            Names of the samples: ``batch["id"]`` of a reader. A repeated one, with the same motion, counts once:
            samplers repeat samples to fill up. Default: the number of the process and of the sample.
        music
            (B, M, D') rows of the audio field, or (B, M) its column of beats; None: beat metrics are not computed.
            They have the motion's length at the field's rate, within two rows.
        lengths
            (B,) rows of motion that each sample has, where it is padded: ``batch["lengths"]["edge151"]`` of
            `pad_clips`. Motion and music after them do not count. Default: all.

        Raises
        ------
        UsageError
            For arrays that are not such a batch, padded motion without lengths, music of another length, or another
            motion or music under a name that exists.
        """
        batch = as_numpy(motion)
        if batch.ndim != 3:
            raise UsageError("a batch of motion has three axes", found=f"shape {batch.shape}", allowed="(B, L, D)")
        width = self.reader.representation.columns.width
        if batch.shape[2] != width:
            raise UsageError(f"a batch of motion is not columns of {self.reader.representation.name}",
                             found=f"shape {batch.shape}", allowed=f"(B, L, {width})")  # fmt: skip
        named = self._numbered(len(batch)) if ids is None else [str(i) for i in ids]
        if len(named) != len(batch):
            raise UsageError("ids and motion differ in length", found=f"{len(named)} and {len(batch)}")
        sizes = sample_lengths(batch, named, None if lengths is None else as_numpy(lengths))
        rows = None if music is None else self._beats(as_numpy(music), batch.shape[1], sizes, lengths is not None)
        if ids is None:
            self._unnamed += named
        for k, name in enumerate(named):
            beats, columns = None if rows is None else rows[k], batch[k, : sizes[k]]
            if not self._repeats(name, Trace.of(columns, beats)):
                self._measure(name, columns, beats)

    def _numbered(self, n: int) -> list[str]:
        """Return unique names for samples without ids."""
        numbers = (f"{process_rank()}/{k}" for k in count(len(self)))
        return list(islice((name for name in numbers if name not in self._traces), n))

    def _repeats(self, name: str, trace: Trace) -> bool:
        """Whether a sample is a repeated one; UsageError if it has the name of another one."""
        first = self._traces.setdefault(name, trace)
        if not first.same(trace):
            raise UsageError(
                "samples that differ have one id", found=name, fix='give each its own, as readers do: ids=batch["id"]'
            )
        return first is not trace

    def _measure(self, name: str, columns: npt.NDArray[Any], beats: MusicBeats | None) -> None:
        music = None if beats is None else ClipMusic(beats)
        try:
            pose = self.reader.pose(columns, where=f"sample {name}")
            numbers = measure_pose(self.protocol, "generated", range(len(self.protocol.measures)), pose, music)
        except DataError as error:
            self._left_out[name] = str(error)
            return
        measured = MeasuredClip.of(MemoryClip(id=name, joints=pose.joints, grid=pose.grid), numbers)
        # Windows of a clip are not independent: intervals leave out the clip as a whole.
        self._measured[name] = replace(measured, clip=_WINDOW.sub("", name))

    def _beats(self, music: npt.NDArray[Any], whole: int, sizes: Sequence[int], padded: bool) -> list[MusicBeats]:
        """Return the beats of each sample, of motion of `sizes` rows in a batch of `whole` rows."""
        field = self.music_field
        if field is None:
            raise UsageError(
                "the dataset has no beats of this protocol", found=f"protocol {self.protocol.name}",
                fix="leave out music, or name the audio field: Evaluator.of(..., music=FIELD)",
            )  # fmt: skip
        if music.ndim not in (2, 3):
            raise UsageError(
                "music has two or three axes", found=f"shape {music.shape}", allowed="(B, M, D) or (B, M)"
            )
        if music.ndim == 3 and music.shape[2] != field.columns.width:
            raise UsageError("music is not of the audio field of the dataset", found=f"shape {music.shape}",
                             allowed=f"(B, M, {field.columns.width}), "
                             f"beats in column {field.columns.slice(BEAT).start}, or (B, M)")  # fmt: skip
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
                fix="give the rows of the same frames; a field of another rate: Evaluator.of(..., music=FIELD)",
            )  # fmt: skip
        return [field_beats(rows[:end], field) for rows, end in zip(music, ends, strict=True)]

    def gather(self, gather: Gather | None = None, *, repeated: Literal["same", "first"] = "same") -> Self:
        """Join the samples of all processes; every process has to call it, and then has all of them.

        Parameters
        ----------
        gather
            Returns the objects of all processes, such as ``accelerate.utils.gather_object``. Default:
            torch.distributed, where it is initialised, as under Lightning; a single process keeps its own.
        repeated
            "same": samples of two processes with one id have the same motion and music, as of a model without noise.
            "first": that of the first process counts, and the others are not compared.

        Raises
        ------
        UsageError
            If samples without ids have equal numbers in two processes: they run without torch.distributed. If samples
            that differ have one id.
        """
        part: _Part = (list(self._measured.values()), list(self._left_out.items()), self._unnamed, self._traces)
        parts: list[_Part] = (gather or gather_by_torch)([part])
        unnamed = Counter(name for _, _, names, _ in parts for name in names)
        twice = [name for name, n in unnamed.items() if n > 1]
        if twice:
            raise UsageError("samples of two processes have one name", found=listed(twice),
                             fix="name them: update(..., ids=[...])")  # fmt: skip
        first: dict[str, Trace] = {}
        differ = {
            name
            for *_, traces in parts
            for name, trace in traces.items()
            if not first.setdefault(name, trace).same(trace)
        }
        if differ and repeated == "same":
            raise UsageError(
                "samples of two processes differ, and have one id", found=listed(sorted(differ)),
                fix='give each its own, as readers do: ids=batch["id"]; where samplers repeat samples to fill up, '
                'and a model with noise makes other motion of them: gather(..., repeated="first")',
            )  # fmt: skip
        # The first process that has a sample counts: the same one in every process.
        self.reset()
        self._traces = first
        for measured, left_out, _, _ in parts:
            for clip in measured:
                if clip.id not in self._left_out:
                    self._measured.setdefault(clip.id, clip)
            for name, reason in left_out:
                if name not in self._measured:
                    self._left_out.setdefault(name, reason)
        return self

    def compute(self, *, bootstrap: int = 0) -> Report:
        """Return the report of all samples so far.

        Parameters
        ----------
        bootstrap
            How many times scores are computed again for intervals, at most; 0: no intervals.

        Raises
        ------
        UsageError
            If no sample could be measured, with the reason of the first.
        """
        if not self._measured:
            reason = next(iter(self._left_out.values()), "no batch was given to update")
            raise UsageError("no sample could be measured", found=reason)
        clips = [self._measured[name] for name in sorted(self._measured)]
        with_music = any(trace.beats is not None for trace in self._traces.values())
        return report_of(
            self.protocol, clips, self.pool, role="generated", source="samples of a model", draws=bootstrap,
            warnings=self._about_music if with_music else self._without_music(),
            left_out=sorted(self._left_out.items()),
        )  # fmt: skip

    def _without_music(self) -> list[str]:
        """Return a warning if all samples are without music, and the protocol takes it."""
        if not any(measure.metric.needs_music for measure in self.protocol.measures):
            return []
        field = self.music_field
        if field is None:
            return ["no beats of music: the dataset has no audio field with those of this protocol"]
        return [f"no beats of music: give update(..., music=batch[{field.name!r}])"]
