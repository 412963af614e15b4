"""Evaluation in a training loop: batches of generated columns come in, a protocol's numbers come out."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from dancedata.core.dance import MusicBeats
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.text import counted, listed
from dancedata.evaluation.clip_music import BEAT, ClipMusic
from dancedata.evaluation.evaluate import pool_for, report_of
from dancedata.evaluation.inputs.clip import MemoryClip
from dancedata.evaluation.inputs.columns import ColumnsReader, reader_for
from dancedata.evaluation.measuring import MeasuredClip, measure_pose
from dancedata.evaluation.music import beat_field
from dancedata.evaluation.pool import Pool
from dancedata.evaluation.protocol import Protocol
from dancedata.evaluation.report import Report
from dancedata.evaluation.request import Request, protocol_named
from dancedata.store import Store, open_store

__all__ = ["Evaluator"]

#: Takes a list of objects of this process and returns those of all, as accelerate.utils.gather_object does.
Gather = Callable[[list[Any]], list[Any]]
#: What a process has measured: samples, those that could not be, and which of their names were made here.
_Part = tuple[list[MeasuredClip], list[tuple[str, str]], list[str]]


class Evaluator:
    """Collects the numbers of generated samples over an epoch, and compares them with a pool at its end.

    Samples are decoded and measured as they come; only their numbers are kept. Made by `Evaluator.of`.

    Parameters
    ----------
    protocol
        Name of a protocol, or an object of one.
    reader
        How columns are decoded.
    pool
        What samples are compared with; None: metrics that need a pool are not computed.
    beat_column, music_grid
        Column of the beats in rows of music, and the rate of the rows; None without music.

    Examples
    --------
    >>> from dancedata.metrics import Evaluator
    >>> evaluator = Evaluator.of("data/aistpp", "edge151", protocol="dancedata")
    >>> for batch in loader:
    ...     evaluator.update(model.sample(batch["librosa35"]), music=batch["librosa35"])
    >>> report = evaluator.gather().compute()
    >>> report["fid_k"]
    """

    def __init__(
        self,
        protocol: str | Protocol,
        reader: ColumnsReader,
        pool: Pool | None = None,
        *,
        beat_column: int | None = None,
        music_grid: FrameGrid | None = None,
    ) -> None:
        self.protocol = protocol_named(protocol)
        self.reader = reader
        self.pool = pool
        self._beat_column, self._music_grid = beat_column, music_grid
        problem = reader.problem(self.protocol.motion)
        if problem:
            raise UsageError(f"{self.protocol.name} cannot be computed from these columns", found=problem)
        if pool is not None:
            pool.require(self.protocol, str(self.protocol.motion.grid or reader.grid))
        self.reset()

    @classmethod
    def of(
        cls,
        store: str | Path | Store,
        field: str | None = None,
        *,
        protocol: str | Protocol = "dancedata",
        pool: str | Path | Store | None = None,
        split: str | None = None,
        music: str | None = None,
        normalized: bool = True,
        jobs: int = 1,
        cache: str | Path | None = None,
    ) -> Self:
        """Make the evaluator of a model that was trained on a dataset.

        Parameters
        ----------
        store
            The dataset: its columns, scaler and rate are those of the samples.
        field
            Motion field that the model generates. Default: the first one that has the protocol's joints.
        protocol
            Name of a protocol, or an object of one.
        pool
            What samples are compared with: another dataset, or a file of ``--save-pool``. Default: `store`.
        split
            Splits of the pool. Default: all.
        music
            Audio field that `update` gets rows of. Default: the one with the protocol's beats, if the dataset has it.
        normalized
            Whether samples are in [-1, 1], as the dataset's readers give them.
        jobs, cache
            As in `dancedata.evaluate`, for the pool, which is measured now.

        Raises
        ------
        UsageError
            If the field does not have the protocol's joints, or the pool is of another protocol, version or rate.
        """
        made = protocol_named(protocol)
        dataset = store if isinstance(store, Store) else open_store(store)
        name, reader = reader_for(dataset, made.motion, field)
        if normalized:
            reader = replace(reader, scaler=dataset.normalizer(name))
        beats = music or (None if made.music is None else beat_field(dataset, made.music, made.generated))
        request = Request(what={}, protocol=made, pool=pool, pool_split=split, like=dataset, field=name)
        found = pool_for(request, jobs=jobs, cache=None if cache is None else Path(cache))
        return cls(
            made,
            reader,
            found,
            beat_column=None if beats is None else dataset.fields[beats].slice(BEAT).start,
            music_grid=None if beats is None else dataset.field(beats).grid,
        )

    def __len__(self) -> int:
        """Return the number of samples, those of other processes too after `gather`."""
        return len(self._measured) + len(self._left_out)

    def __repr__(self) -> str:
        """Show the protocol and the number of samples."""
        return f"Evaluator({self.protocol.name!r}, {counted(len(self), 'sample')})"

    def reset(self) -> None:
        """Forget all samples, for the next epoch."""
        self._measured: dict[str, MeasuredClip] = {}
        self._left_out: dict[str, str] = {}
        self._unnamed: list[str] = []

    def update(self, motion: Any, *, ids: Sequence[str] | None = None, music: Any = None) -> None:
        """Measure a batch.

        Parameters
        ----------
        motion
            (B, L, D) columns, torch or numpy, on any device.
        ids
            Names of the samples. One that was there before is left out: samplers of several processes repeat samples
            to fill up. Default: the number of the process and of the sample.
        music
            (B, M, D') rows of the audio field, or (B, M) its column of beats; None: beat metrics are not computed.
        """
        batch = _as_numpy(motion)
        if batch.ndim != 3:
            raise UsageError("a batch of motion has three axes", found=f"shape {batch.shape}", allowed="(B, L, D)")
        width = self.reader.representation.columns.width
        if batch.shape[2] != width:
            raise UsageError(
                f"a batch of motion is not columns of {self.reader.representation.name}",
                found=f"shape {batch.shape}",
                allowed=f"(B, L, {width})",
            )
        named = [f"{_rank()}/{len(self) + k}" for k in range(len(batch))] if ids is None else [str(i) for i in ids]
        rows = None if music is None else self._beats(_as_numpy(music))
        for what, n in (("ids", len(named)), ("music", len(batch) if rows is None else len(rows))):
            if n != len(batch):
                raise UsageError(f"{what} and motion differ in length", found=f"{n} and {len(batch)}")
        if ids is None:
            self._unnamed += named
        for k, name in enumerate(named):
            if name not in self._measured and name not in self._left_out:
                self._measure(name, batch[k], None if rows is None else rows[k])

    def _measure(self, name: str, columns: npt.NDArray[Any], beats: npt.NDArray[np.bool_] | None) -> None:
        grid = self._music_grid
        music = None if beats is None or grid is None else ClipMusic(MusicBeats.of(np.flatnonzero(beats), grid))
        try:
            pose = self.reader.pose(columns)
            found = measure_pose(self.protocol, "generated", range(len(self.protocol.measures)), pose, music)
        except DataError as error:
            self._left_out[name] = str(error)
            return
        clip = MemoryClip(id=name, joints=pose.joints, grid=pose.grid)
        self._measured[name] = MeasuredClip.of(clip, found)

    def _beats(self, music: npt.NDArray[Any]) -> npt.NDArray[np.bool_]:
        """Return which rows (B, M) are beats."""
        if self._music_grid is None or self._beat_column is None:
            raise UsageError(
                "the dataset has no beats of this protocol", found=f"protocol {self.protocol.name}",
                fix="leave out music, or name the audio field: Evaluator.of(..., music=FIELD)",
            )  # fmt: skip
        if music.ndim not in (2, 3):
            raise UsageError(
                "music has two or three axes", found=f"shape {music.shape}", allowed="(B, M, D) or (B, M)"
            )
        if music.ndim == 3 and music.shape[2] <= self._beat_column:
            raise UsageError(
                "music is not of the audio field of the dataset", found=f"shape {music.shape}",
                allowed=f"(B, M, D) with the beats in column {self._beat_column}, or (B, M)",
            )  # fmt: skip
        return np.asarray((music if music.ndim == 2 else music[..., self._beat_column]) > 0.5)

    def gather(self, gather: Gather | None = None) -> Self:
        """Join the samples of all processes; every process has to call it, and then has all of them.

        Parameters
        ----------
        gather
            Returns the objects of all processes, such as ``accelerate.utils.gather_object``. Default:
            torch.distributed, where it is initialised, as under Lightning; a single process keeps its own.

        Raises
        ------
        UsageError
            If samples without ids have equal numbers in two processes: they run without torch.distributed.
        """
        own: _Part = (list(self._measured.values()), list(self._left_out.items()), self._unnamed)
        parts: list[_Part] = (gather or _gather_by_torch)([own])
        unnamed = Counter(name for _, _, names in parts for name in names)
        twice = [name for name, n in unnamed.items() if n > 1]
        if twice:
            raise UsageError(
                "samples of two processes have one name", found=listed(twice),
                fix="name them: update(..., ids=[...])",
            )  # fmt: skip
        # The first process that has a sample counts: the same one in every process.
        self.reset()
        for measured, left_out, _ in parts:
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
        report = report_of(
            self.protocol, clips, self.pool, role="generated", source="samples of a model", draws=bootstrap
        )
        return replace(report, left_out=tuple(sorted(self._left_out.items())))


def _as_numpy(batch: Any) -> npt.NDArray[Any]:
    if hasattr(batch, "detach"):
        batch = batch.detach().float().cpu().numpy()
    return np.asarray(batch)


def _torch_distributed() -> Any:
    torch = sys.modules.get("torch")
    distributed = getattr(torch, "distributed", None)
    ready = distributed is not None and distributed.is_available() and distributed.is_initialized()
    return distributed if ready else None


def _rank() -> int:
    distributed = _torch_distributed()
    return 0 if distributed is None else int(distributed.get_rank())


def _gather_by_torch(own: list[Any]) -> list[Any]:
    distributed = _torch_distributed()
    if distributed is None:
        return own
    parts: list[Any] = [None] * distributed.get_world_size()
    distributed.all_gather_object(parts, own)
    return [part for listed in parts for part in listed]
