"""Compares a user's own copy of a dataset with the ground-truth rows that were published under each protocol."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from dancedata.core.clip import ClipRef
from dancedata.core.errors import UsageError
from dancedata.core.plugins import Dataset
from dancedata.core.registry import FEATURES
from dancedata.core.text import counted, listed, shown, table
from dancedata.evaluation.evaluate import evaluate
from dancedata.evaluation.inputs.clip import ClipInput, DatasetClip
from dancedata.evaluation.protocol import PROTOCOLS, Protocol, Published
from dancedata.evaluation.report import LABELS, Report
from dancedata.evaluation.request import Request, Side, protocol_named
from dancedata.execution.progress import Progress
from dancedata.pipeline.check import scan_folder

__all__ = ["SelfTest", "self_test"]


@dataclass(frozen=True)
class SelfTest:
    """The reports of all protocols that have a published ground-truth row of a dataset.

    Attributes
    ----------
    dataset, source
        Name of the reader, and the folder.
    reports
        One for each protocol, with its published row.
    skipped
        Protocols that could not be computed, with the reason.
    """

    dataset: str
    source: str
    reports: tuple[tuple[Report, Published], ...]
    skipped: tuple[tuple[str, str], ...] = ()

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each published figure."""
        found = []
        for report, published in self.reports:
            values = {score.name: score.value for score in report.scores}
            for name, figure in published.values.items():
                value = values.get(name)
                found.append(
                    {
                        "protocol": report.protocol.name,
                        "score": name,
                        "measured": value,
                        "published": figure,
                        "difference": None if value is None else value - figure,
                        "clips": len(report.clips),
                        "pool": None if report.pool is None else report.pool["clips"],
                    }
                )
        return found

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {
            "dataset": self.dataset,
            "source": self.source,
            "rows": self.rows(),
            "reports": [report.to_json() for report, _ in self.reports],
            "skipped": [{"protocol": name, "reason": why} for name, why in self.skipped],
        }

    def __str__(self) -> str:
        """Show the table, and below it the pools, the lengths and the warnings of each protocol."""
        head = ("protocol", "score", "measured", "published", "difference", "clips", "pool")
        rows = [
            (
                row["protocol"], LABELS.get(row["score"], row["score"]), _number(row["measured"]),
                f"{row['published']:g}", _number(row["difference"]), row["clips"], row["pool"] or "",
            )
            for row in self.rows()
        ]  # fmt: skip
        lines = [f"{self.dataset}: {shown(self.source)}", *table(head, rows)]
        for report, published in self.reports:
            low, middle, high = report.seconds
            lines += [
                f"{report.protocol.label}: {counted(len(report.clips), 'clip')} of {' and '.join(published.splits)}, "
                f"{report.fps} frames per second, {low:.1f} to {high:.1f} s, median {middle:.1f} s",
                f"  published in {published.source}" + (f": {published.note}" if published.note else ""),
                *(f"  warning: {warning}" for warning in report.warnings),
            ]
        return "\n".join([*lines, *(f"{name}: not computed: {why}" for name, why in self.skipped)])


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4f}"


@dataclass(frozen=True, kw_only=True, eq=False)
class _DatasetRequest(Request):
    """A request whose set, pool and music are clips of a source folder."""

    truth: Side
    everything: Side
    files: Mapping[str, Path]

    def set_side(self) -> Side:
        """See `Request.set_side`."""
        return self.truth

    def pool_side(self) -> Side:
        """See `Request.pool_side`."""
        return self.everything

    def music_files(self) -> dict[str, Path]:
        """See `Request.music_files`."""
        return dict(self.files)


def self_test(
    source: Path,
    *,
    protocol: str | Protocol | None = None,
    draws: int = 200,
    jobs: int = 1,
    cache: Path | None = None,
    progress: Progress | None = None,
) -> SelfTest:
    """Measure the ground truth of a dataset under every protocol that has a published row of it.

    Parameters
    ----------
    source
        Folder with the dataset's files, as for ``dancedata build``; music is used where it is there.
    protocol
        Only this protocol.

    Raises
    ------
    SourceError
        If no reader recognises the folder.
    UsageError
        If nothing was published of it.
    """
    reader, _ = scan_folder(source)
    asked = [protocol_named(protocol)] if protocol is not None else [PROTOCOLS.get(n)() for n in PROTOCOLS.names()]
    rows = [(p, row) for p in asked for row in p.published if row.dataset == reader.name]
    if not rows:
        known = sorted({row.dataset for p in asked for row in p.published if row.dataset})
        raise UsageError(
            "no row of this dataset was published under the protocol", where=source, found=reader.name,
            allowed=listed(known) or "none",
        )  # fmt: skip
    own = _with(reader, music="optional")
    split, everything = own.scan(source).clips, _with(own, split="all").scan(source).clips
    reports, skipped = [], []
    for own_protocol, published in rows:
        truth = [ref for ref in split if ref.split in published.splits]
        if not truth:
            skipped.append((own_protocol.name, f"no clip of {' or '.join(published.splits)}"))
            continue
        request = _DatasetRequest(
            what={},
            protocol=own_protocol,
            draws=draws,
            truth=_side(own, truth, source),
            everything=_side(own, everything, source),
            files=_files(own_protocol, truth),
        )
        reports.append((evaluate(request, jobs=jobs, cache=cache, progress=progress), published))
    return SelfTest(reader.name, str(source), tuple(reports), tuple(skipped))


def _with(reader: Dataset, **values: str) -> Dataset:
    """Return a reader with other parameters, as far as it has them and takes the values."""
    known = {f.name for f in fields(reader)}
    try:
        return replace(reader, **{name: value for name, value in values.items() if name in known})
    except UsageError:
        return reader


def _side(reader: Dataset, refs: list[ClipRef] | tuple[ClipRef, ...], source: Path) -> Side:
    clips: tuple[ClipInput, ...] = tuple(
        DatasetClip(id=ref.id, music=ref.music, tempo_bpm=ref.tempo_bpm, dataset=reader, ref=ref) for ref in refs
    )
    return Side(clips, str(source), "truth")


def _files(protocol: Protocol, refs: list[ClipRef]) -> dict[str, Path]:
    """Return the music of clips, where the protocol's feature is installed."""
    rule = protocol.music
    if rule is None or rule.features[0] not in FEATURES.names():
        return {}
    return {ref.music: ref.audio_path for ref in refs if ref.audio_path is not None}
