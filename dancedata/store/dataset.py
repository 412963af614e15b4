"""Store: a built dataset, read with numpy only."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import FreeColumn, Window
from dancedata.core.errors import StoreError, UsageError, did_you_mean
from dancedata.core.segments import LayerNumbers
from dancedata.core.text import shown
from dancedata.files.addresses import Origin, local_folder, origin_of
from dancedata.files.regular_file import sha256_file
from dancedata.store.clip_choice import clips_with, require_where
from dancedata.store.clip_columns import ClipRecord
from dancedata.store.dataset_json import REBUILD, field_weights
from dancedata.store.listed_file import FileHash, open_listed, rebuilt_error
from dancedata.store.normalize import Scaler
from dancedata.store.row_queries import RowQueries
from dancedata.store.schema import SEGMENTS_FILE, STATS_FILE, TABLES_FILE, Field
from dancedata.store.window_list import IntArray

_KINDS = ("minmax", "zscore", "zscore_grouped")

if TYPE_CHECKING:
    from pandas import DataFrame

    from dancedata.store.clip_view import Clip, Clips
    from dancedata.store.segment_overlay import SegmentOverlay


def open_store(path: str | Path, *, segments: str | Path | Sequence[str | Path] = (), mapped: bool = True) -> Store:
    """Open a built dataset: dataset.json and the sizes of shards are checked, the others read on first use.

    Parameters
    ----------
    path
        Folder that a build wrote, or the address of one, such as ``hf://datasets/ORG/NAME@REVISION``: its files
        are fetched into the cache when they are first read, see `dancedata.remote`.
    segments
        Files of segments, .csv or .jsonl, that are laid over those of the dataset: marks and corrections. A row
        replaces segments of the same layer, start and end.
    mapped
        False: readers read by position, for files that may be overwritten in place, or file systems that map poorly.

    Returns
    -------
    Store

    Raises
    ------
    StoreError
        If the folder has no finished dataset or one of another format version, dataset.json was changed after the
        build, or a shard is missing or has another size.
    SourceError
        For a mistake in a file of segments.

    Examples
    --------
    >>> import dancedata
    >>> ds = dancedata.open("data/aistpp")
    >>> ds.read(ds.windows("train")[3], "edge151").shape
    (150, 151)
    """
    files = [segments] if isinstance(segments, str | Path) or not isinstance(segments, Iterable) else list(segments)
    for place in (path, *files):
        if not isinstance(place, str | os.PathLike):
            raise UsageError("not a path", found=shown(place), allowed="a folder or an address; files of segments")
    folder = local_folder(path).absolute()
    description, listed = open_listed(folder)
    store = Store(folder, description, listed)
    store._mapped = mapped
    if files:
        from dancedata.store.segment_overlay import SegmentOverlay

        store.overlay = SegmentOverlay.read(
            [Path(f).expanduser() for f in files], store._description.self_sha256, store._seconds_of
        )
    return store


class Store(RowQueries):
    """A built dataset.

    Safe to pickle, to fork and to read from several threads: tables are read once, rows straight from the
    file by position. Made by `open_store`.

    Attributes
    ----------
    path
        Absolute path of the folder.
    splits
        Names of the splits that have clips: train, val, test, then others.
    fields
        Columns of every field, by name.
    fps, grid
        Frames per second of window starts and lengths: int if whole, else Fraction; and as a `FrameGrid`.
    skeleton, info
        The motion's skeleton, and dataset.json.
    overlay
        Segments of files that were named when the dataset was opened, and notes on them; None without.
    """

    def __reduce__(self) -> tuple[Any, ...]:
        return reopen, (*self.reference, self.overlay, self._mapped)

    def __repr__(self) -> str:
        return f"Store({str(self.path)!r}, splits={self.splits}, fields={tuple(self.fields)}, fps={self.fps})"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the files; a later read opens them again."""
        for shard in self._shard_readers:
            shard.close()

    def require_intact(self, clips: Iterable[str] | None = None, sha256: FileHash = sha256_file) -> None:
        """Raise StoreError if bytes of shards or tables differ from the build's; reading rows does not compare them.

        Only the files of `clips` are read, by default all; `sha256` gives the hash of a file.
        """
        numbers: Iterable[int] = range(len(self._shard_readers))
        if clips is not None:
            numbers = set(self._tables.shard_of([self._row(clip) for clip in clips]).tolist())
        for name in (TABLES_FILE, SEGMENTS_FILE):
            if name in self._files:
                self._files[name].require_bytes(sha256)
        for number in numbers:
            self._shard_readers[number].require_bytes(sha256)

    def clips(self, split: str | None = None, **where: Any) -> Clips:
        """Return the clips of a split with some values, ``ds.clips("train", genre=("gBR", "gPO"))``; default: all.

        Parameters
        ----------
        split
            One of ``ds.splits``; default: all, split by split, in stored order.
        **where
            One value or several that a clip may have, by column of ``to_pandas()``; of a column of lists, lists that
            have one of them. Free columns, ``**{"x/level": 3}``, and `clip`, the id.

        Raises
        ------
        UsageError
            For an unknown split or column, or values of another type.
        """
        rows = range(self._tables.n_clips)
        chosen = rows if split is None else rows[self._rows_of_split(split).clips]
        if not where:
            return self._clips(chosen)
        keep = np.ones(len(rows), dtype=np.bool_)
        for name, values in require_where(self, where).items():
            keep &= clips_with(self._tables, name, values)
        return self._clips(np.flatnonzero(keep[chosen.start : chosen.stop]) + chosen.start)

    def _clips(self, rows: range | IntArray) -> Clips:
        from dancedata.store.clip_view import Clips  # readers of windows need none

        return Clips(self, rows)

    @property
    def origin(self) -> Origin | None:
        """Address of a dataset that was fetched, of a hub with its commit; None for one of the local disk."""
        return origin_of(self.path)

    @property
    def weights(self) -> dict[str, str]:
        """By field that a network computed: name, commit and hash of its weights, and their licence."""
        weights = {name: field_weights(self.info, name) for name in self._fields}
        return {name: text for name, text in weights.items() if text}

    def quantiles(self, field: str, q: Sequence[float]) -> npt.NDArray[np.float64]:
        """Return quantiles of the columns of a field over the rows that train windows cover, (len(q), D).

        By linear interpolation. Raises UsageError: for codes; StoreError: without rows of the field in train windows.
        """
        f = self.field(field)
        self._require_statistics(f, "quantiles")
        from dancedata.store.train_rows import train_quantiles

        return train_quantiles(self, f, q)

    def free_columns(self) -> tuple[FreeColumn, ...]:
        """Return the free columns of the table of clips in numbers, by name."""
        from dancedata.store.numbers import free_columns

        return free_columns(self, self.clips())

    def layer_numbers(self) -> tuple[LayerNumbers, ...]:
        """Return the numbers of each layer of segments, in the order of `layers`."""
        from dancedata.store.numbers import layer_numbers

        return layer_numbers(self)

    def __len__(self) -> int:
        """Return the number of clips."""
        return self._tables.n_clips

    def __bool__(self) -> bool:
        """Return True, also without clips."""
        return True

    def __iter__(self) -> Iterator[Clip]:
        """Yield the clips, split by split, in stored order."""
        return iter(self.clips())

    def __getitem__(self, clip_id: str) -> Clip:
        """Return a clip by id, ``ds["ID"]["edge151"]`` are its rows of a field; UsageError with the closest id."""
        return self.clips()[self._row(clip_id)]

    def __contains__(self, clip_id: object) -> bool:
        """Return whether there is a clip of this id."""
        return self._tables.find(str(clip_id)) is not None

    def to_pandas(self, table: str = "clips") -> DataFrame:
        """Return a table as a pandas DataFrame, for filters, plots, CSV and parquet (``df.to_parquet``).

        Parameters
        ----------
        table
            "clips": a row a clip, with free columns as "x/NAME", of whole numbers as Int64 where a clip has none;
            where fields are optional, with the names of those that it does not have as "without".
            "windows": clip, split, first frame and length.
            "rejects": what the build left out, and why. "quality": quality flags.

        Raises
        ------
        UsageError
            For another table.
        MissingPackageError
            Without pandas.
        """
        from dancedata.store.tables_out import table_of

        return table_of(self, self.clips(), table)

    def table_row(self, of: ClipRecord | Window) -> dict[str, Any]:
        """Return the row of a clip or a window in its table, see `to_pandas`."""
        from dancedata.store.tables_out import clip_row, window_row

        return window_row(self, self[of.clip].split, of) if isinstance(of, Window) else clip_row(self, of)

    def scaler(self, field: str, kind: Literal["minmax", "zscore", "zscore_grouped"] = "minmax") -> Scaler:
        """Return a scaler of a field, fitted on train, for readers (``scale=``), decoding and evaluation.

        Parameters
        ----------
        field
            Name of the field.
        kind
            "minmax": to [-1, 1] by the range, as EDGE. "zscore": by mean and standard deviation; "zscore_grouped": by
            one deviation for the columns of a group, such as the positions, the mean of theirs, as HumanML3D's
            ``Std.npy`` (Guo et al. 2022, cal_mean_variance.ipynb).

        Raises
        ------
        StoreError
            If there are no train windows to fit it on.
        UsageError
            For an unknown field or kind, or a field of codes.
        """
        f = self.field(field)
        stored = self._stored_scaler(f)
        if kind not in _KINDS:
            raise UsageError(f"unknown kind of scaler {kind!r}", fix=did_you_mean(kind, _KINDS))
        if kind == "minmax":
            return stored
        numbers = self.stats["fields"][field]
        try:
            mean, std = (np.array(numbers[name], dtype=np.float64) for name in ("mean", "std"))
            if kind == "zscore_grouped":
                for part in map(f.columns.slice, f.columns.names):
                    std[part] = std[part].mean()
            sha256, columns = stored.sha256, stored.columns
            return Scaler("zscore", mean, std, dtype=f.dtype, field=field, columns=columns, dataset=sha256)
        except (KeyError, TypeError, ValueError, UsageError) as error:
            raise StoreError(f"the {kind} scaler of field {field} cannot be used",
                             where=str(self.path / STATS_FILE), found=shown(error),
                             fix=REBUILD) from error  # fmt: skip

    def _require_statistics(self, f: Field, what: str) -> None:
        if f.codebook is not None:
            raise UsageError(f"codes have no {what}: they are names, not amounts", where=str(self.path),
                             found=f"field {f.name}, codes of {f.codebook.name}",
                             fix="leave the field out")  # fmt: skip
        if f.name not in self.stats["fields"]:
            raise StoreError(
                f"no {what} without train windows" + (f" that have field {f.name}" if f.optional else ""),
                where=str(self.path), found=f"splits {', '.join(self.splits)}",
                fix="read with scale=None, or build with a train split",
            )  # fmt: skip

    def _stored_scaler(self, f: Field) -> Scaler:
        self._require_statistics(f, "scaler")
        try:
            low, high = (self.stats["fields"][f.name]["scaler"][name] for name in ("data_min", "data_max"))
            scaler = Scaler("minmax", low, high, dtype=f.dtype, field=f.name, columns=f.columns.labels)
            scaler.dataset = scaler.sha256
            problem = f"{scaler.width} columns"
        except (KeyError, TypeError, ValueError, OverflowError, UsageError) as error:
            scaler, problem = None, shown(error)
        if scaler is None or scaler.width != f.columns.width:
            raise StoreError(f"the scaler of field {f.name} cannot be used", where=str(self.path / STATS_FILE),
                             found=problem, allowed=f"data_min and data_max of {f.columns.width} columns",
                             fix=REBUILD)  # fmt: skip
        return scaler


def reopen(path: str, sha256: str, overlay: SegmentOverlay | None = None, mapped: bool = True) -> Store:
    """Open a dataset again, in another process; StoreError if it was replaced in the meantime."""
    store = open_store(path, mapped=mapped)
    store.overlay = overlay
    if store._description.self_sha256 != sha256:
        raise rebuilt_error(store.path, "dataset.json has changed")
    return store
