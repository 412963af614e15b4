"""Pools: the features of all clips that a set is compared with, and their files."""

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.errors import DataError, StoreError, UsageError
from dancedata.core.hashing import json_sha256
from dancedata.core.plugins import Metric
from dancedata.core.rotations import Float64Array
from dancedata.core.text import counted, quoted, shown
from dancedata.core.version import __version__
from dancedata.evaluation.measuring import MeasuredClip
from dancedata.evaluation.protocol import Protocol
from dancedata.files.atomic import write_bytes
from dancedata.files.documents import document_of
from dancedata.files.strict_json import parse_json
from dancedata.formats.values import open_arrays
from dancedata.metrics.set_statistics import checked_rows

#: Layout of pool files. 2: with the hash of what numbers depend on.
POOL_FORMAT = 2
_AGAIN = "make a pool of this protocol: --pool DATASET --out FILE.npz"
_HEADER, _IDS, _ROWS, _CLIPS = "about", "clips", "rows_", "clip_of_rows_"


@dataclass(frozen=True, eq=False)
class Pool:
    """The numbers of a pool, for each metric of a protocol that needs one."""

    protocol: str
    version: int
    fps: str
    ids: tuple[str, ...]
    rows: Mapping[int, Float64Array]  # (M, C) by the number of the measure
    source: str
    undefined: Mapping[str, int]  # pieces without features, by outcome
    scaler: str  # hash of the scaler that its columns were normalised by; "" if they were not
    clips: Mapping[int, Float64Array]  # (M,) number of the clip of each row, by the number of the measure

    @property
    def n(self) -> int:
        """Number of vectors: those of the first metric."""
        return max((len(rows) for rows in self.rows.values()), default=0)

    def to_json(self) -> dict[str, Any]:
        """Return JSON data for reports."""
        return {"source": self.source, "clips": len(self.ids), "vectors": self.n, "undefined": dict(self.undefined)}

    def require(self, protocol: Protocol, fps: str, scaler: str = "") -> None:
        """Raise UsageError unless it was measured by this protocol, in this version, at this rate, by this scaler."""
        if self.scaler and scaler and self.scaler != scaler:
            raise UsageError("the columns of the pool were normalised by another scaler", where=self.source,
                             found=self.scaler, allowed=scaler, fix=_AGAIN)  # fmt: skip
        if (self.protocol, self.version) != (protocol.name, protocol.version):
            raise UsageError("the pool was measured by another protocol", where=self.source,
                             found=f"{quoted(self.protocol)}, version {self.version}", allowed=protocol.label,
                             fix=_AGAIN)  # fmt: skip
        if self.fps != fps:
            raise UsageError(
                "the pool was measured at another frame rate, and such distances mean nothing",
                where=self.source,
                found=f"{self.fps} frames per second in the pool, {fps} in the set",
                fix="generate at the rate of the pool, or build the pool at that of the set",
            )


def pool_of(protocol: Protocol, measured: Sequence[MeasuredClip], source: str, scaler: str = "") -> Pool:
    """Make the pool of measured clips; UsageError if clips have different rates, or there are none."""
    measured = sorted(measured, key=lambda m: m.id)  # sums do not depend on the order of files
    rows: dict[int, Float64Array] = {}
    clips: dict[int, Float64Array] = {}
    undefined: dict[str, int] = {}
    for number, measure in enumerate(protocol.measures):
        if measure.metric.needs_pool:
            numbers = rows_of(measured, number, measure.metric)
            rows[number], clips[number] = numbers.rows, numbers.clips
            for outcome, ids in numbers.undefined.items():
                undefined[outcome] = max(len(ids), undefined.get(outcome, 0))
    ids = tuple(m.id for m in measured)
    fps = one_rate(measured, source)
    return Pool(protocol.name, protocol.version, fps, ids, rows, source, undefined, scaler, clips)


@dataclass(frozen=True, eq=False)
class MetricRows:
    """The numbers of one metric for all pieces of a set."""

    rows: Float64Array  # (N, C) numbers of the pieces that have a value
    clips: Float64Array  # (N,) number of the clip of each
    ids: tuple[str, ...]  # id of each piece: the clip's, with its number after # where it has several
    undefined: dict[str, tuple[str, ...]]  # ids of pieces without a value, by outcome


def rows_of(measured: Sequence[MeasuredClip], number: int, metric: Metric) -> MetricRows:
    """Return the numbers of the measure `number` of a protocol."""
    rows: list[tuple[float, ...]] = []
    clips: list[int] = []
    ids: list[str] = []
    undefined: dict[str, list[str]] = {}
    order = {clip: k for k, clip in enumerate(dict.fromkeys(m.clip for m in measured))}
    for m in measured:
        outcomes = m.rows.get(number)
        if outcomes is None:
            undefined.setdefault("no_music", []).append(m.id)
            continue
        if not outcomes:
            undefined.setdefault("short", []).append(m.id)
        for k, outcome in enumerate(outcomes):
            name = m.id if len(outcomes) == 1 else f"{m.id}#{k}"
            if isinstance(outcome, str):
                undefined.setdefault(outcome, []).append(name)
            else:
                rows.append(outcome)
                clips.append(order[m.clip])
                ids.append(name)
    array = np.array(rows, dtype=np.float64).reshape(len(rows), len(metric.columns))
    return MetricRows(
        array, np.array(clips, dtype=np.float64), tuple(ids), {k: tuple(v) for k, v in undefined.items()}
    )


def one_rate(measured: Sequence[MeasuredClip], source: str) -> str:
    """Return the rate of all clips; UsageError if they have different ones, or there are none."""
    rates: dict[str, list[str]] = {}
    for m in measured:
        if m.fps:  # otherwise it has no music, and only metrics of music are computed
            rates.setdefault(m.fps, []).append(m.id)
    if not rates:
        raise UsageError("no clip could be measured", where=source)
    if len(rates) > 1:
        raise UsageError(
            "clips have different frame rates, and their numbers do not compare", where=source,
            found="; ".join(f"{fps} per second: {counted(len(ids), 'clip')}, {ids[0]}" for fps, ids in rates.items()),
            fix="evaluate those of one rate, or build a dataset, which has one",
        )  # fmt: skip
    return next(iter(rates))


def check_target(path: Path, protocol: Protocol) -> None:
    """Raise UsageError unless a pool of a protocol can be written to `path`; only pools of it are replaced."""
    if path.suffix != ".npz":
        raise UsageError("a pool is an .npz file", found=str(path), allowed="NAME.npz")
    if path.exists():
        load_pool(path, protocol)
    elif not path.parent.is_dir():
        raise UsageError("the folder of the pool does not exist", where=path, fix="make it")


def _measured_by(protocol: Protocol) -> str:
    """Return the hash of what a pool's numbers depend on, for a protocol whose version was not raised."""
    metrics = [
        [m.metric.name, m.metric.version, document_of(m.metric), m.fps, m.frames("truth"), *["steady"] * m.steady]
        for m in protocol.measures
        if m.metric.needs_pool
    ]
    return json_sha256([repr(protocol.motion), protocol.truth.identity, metrics])


def save_pool(path: Path, protocol: Protocol, pool: Pool) -> None:
    """Write a pool to an .npz file that `check_target` allows, atomically; the same pool gives the same bytes."""
    header = {"pool": POOL_FORMAT, "protocol": pool.protocol, "version": pool.version, "fps": pool.fps}
    header["measured"] = _measured_by(protocol)
    header |= {"dancedata": __version__, "undefined": dict(pool.undefined)}
    header |= {"scaler": pool.scaler} if pool.scaler else {}
    arrays: dict[str, Any] = {
        _HEADER: _as_bytes(json.dumps(header, sort_keys=True)),
        _IDS: _as_bytes("\n".join(json.dumps(i) for i in pool.ids)),
    }
    arrays |= {f"{_ROWS}{number}": rows for number, rows in pool.rows.items()}
    arrays |= {f"{_CLIPS}{number}": clips for number, clips in pool.clips.items()}
    data = io.BytesIO()
    np.savez(data, allow_pickle=False, **arrays)
    try:
        write_bytes(path, data.getvalue())
    except OSError as error:
        raise StoreError("the pool cannot be written", where=path, found=str(error)) from error


def load_pool(path: Path, protocol: Protocol) -> Pool:
    """Read a pool; nothing in the file is executed; UsageError if it is not one of this protocol and version."""
    try:
        with open_arrays(path) as arrays:
            header = parse_json(_text(arrays.read(_HEADER)) if _HEADER in arrays.names else "null")
            layout, measured = header["pool"], header.get("measured")
            ids = [str(parse_json(line)) for line in _text(arrays.read(_IDS)).split("\n") if line]
            names = [name for name in arrays.names if name.startswith(_ROWS)]
            rows = {int(name.removeprefix(_ROWS)): checked_rows(arrays.read(name)) for name in names}
            clips = {n: np.ravel(arrays.read(f"{_CLIPS}{n}")) for n in rows}
            if any(len(clips[n]) != len(rows[n]) for n in clips):
                raise ValueError("not one clip for each row")
        pool = Pool(
            str(header["protocol"]), int(header["version"]), str(header["fps"]), tuple(ids), rows, str(path),
            {str(k): int(v) for k, v in header["undefined"].items()}, str(header.get("scaler", "")), clips,
        )  # fmt: skip
    except (DataError, LookupError, TypeError, ValueError, AttributeError) as error:
        raise UsageError(
            "not a pool", where=path, found=str(error), allowed="an .npz file of --out, or a built dataset"
        ) from error
    if layout != POOL_FORMAT:
        raise UsageError("the pool has another layout", where=path, found=layout, allowed=POOL_FORMAT, fix=_AGAIN)
    pool.require(protocol, pool.fps)
    if measured != _measured_by(protocol):
        raise UsageError("the pool was measured by other metrics, or by other parameters of them", where=path,
                         found=f"{protocol.label}, of dancedata {shown(header.get('dancedata'))}",
                         fix=_AGAIN)  # fmt: skip
    for number, measure in enumerate(protocol.measures):
        width = len(measure.metric.columns)
        array = pool.rows.get(number)
        if measure.metric.needs_pool and (array is None or array.shape[1] != width):
            raise UsageError("the pool lacks features of the protocol", where=path, found=measure.metric.name)
    return pool


def _as_bytes(text: str) -> Any:
    return np.frombuffer(text.encode("utf-8"), np.uint8)


def _text(numbers: Float64Array) -> str:
    return numbers.astype(np.uint8).tobytes().decode("utf-8")
