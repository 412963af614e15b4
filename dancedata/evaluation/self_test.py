"""Comparison of a user's copy of a dataset with the ground-truth rows published under each protocol."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from dancedata.core.arguments import folder_of
from dancedata.core.clip import ClipRef
from dancedata.core.errors import UsageError
from dancedata.core.plugins import Dataset
from dancedata.core.registry import FEATURES
from dancedata.core.tables import table
from dancedata.core.text import counted, listed, shown
from dancedata.evaluation.clips import ClipSet
from dancedata.evaluation.evaluate import evaluate_inputs
from dancedata.evaluation.music import music_plan
from dancedata.evaluation.options import Inputs
from dancedata.evaluation.protocol import PROTOCOLS, PaperResult, Protocol, protocol_named
from dancedata.evaluation.report import LABELS, Report
from dancedata.evaluation.scores import DRAWS
from dancedata.kernel import Progress, jobs_of, scan_folder
from dancedata.scene.inputs.clip import DatasetClip
from dancedata.scene.inputs.songs import MusicSources


@dataclass(frozen=True)
class SelfTest:
    """The reports of all protocols that have a published ground-truth row for a dataset, each with that row.

    `skipped`: Protocols that could not be computed, with the reason.
    """

    dataset: str
    source: str
    reports: tuple[tuple[Report, PaperResult], ...]
    skipped: tuple[tuple[str, str], ...] = ()

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each published figure."""
        rows: list[dict[str, Any]] = []
        for report, published in self.reports:
            values = {score.name: score.value for score in report.scores}
            for name, figure in published.values.items():
                value = values.get(name)
                rows.append({
                    "protocol": report.protocol.name, "score": name, "measured": value, "published": figure,
                    "difference": None if value is None else value - figure, "clips": len(report.clips),
                    "pool": None if report.pool is None else len(report.pool.ids),
                })  # fmt: skip
        return rows

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


def self_test(
    source: str | Path,
    *,
    protocol: str | Protocol | None = None,
    intervals: bool = True,
    jobs: int | None = 1,
    cache: str | Path | None = None,
    progress: bool = False,
) -> SelfTest:
    """Compare a copy of AIST++ or FineDance with published ground truth, as ``dancedata check --published`` does.

    `source`: Folder with the dataset's files, as for `build`.
    `protocol`: Only this one. Default: every one that has a published row of the dataset.
    `intervals`, `jobs`, `cache`, `progress`: As in `evaluate`.
    Raises SourceError: if no reader recognises the folder.
    Raises UsageError: if nothing was published for it.
    """
    source = Path(source).expanduser()
    how: dict[str, Any] = {"jobs": jobs_of(jobs), "cache": folder_of(cache), "progress": Progress(quiet=not progress)}
    reader, _ = scan_folder(source)
    protocols = (
        [protocol_named(protocol)] if protocol is not None else [PROTOCOLS.get(n)() for n in PROTOCOLS.names()]
    )
    rows = [(p, row) for p in protocols for row in p.published if row.dataset == reader.name and row.splits]
    if not rows:
        datasets = sorted({row.dataset for p in protocols for row in p.published if row.splits})
        raise UsageError("no row of this dataset was published under the protocol", where=source, found=reader.name,
                         allowed=listed(datasets) or "none")  # fmt: skip
    reader = _with(reader, music="optional")
    chosen, everything = reader.scan(source).clips, _with(reader, split="all").scan(source).clips
    reports, skipped = [], []
    for tested, published in rows:
        truth = [ref for ref in chosen if ref.split in published.splits]
        if not truth:
            skipped.append((tested.name, f"no clip of {' or '.join(published.splits)}"))
            continue
        numbers = list(range(len(tested.measures)))
        pool_numbers = [number for number in numbers if tested.measures[number].metric.needs_pool]
        clip_set = _clip_set(reader, truth, source)
        music = music_plan(tested, clip_set, MusicSources(files=_music_files(tested, truth)))
        inputs = Inputs(
            protocol=tested, clip_set=clip_set, numbers=numbers, draws=DRAWS if intervals else 0, dataset=reader.name,
            pool=_clip_set(reader, everything, source) if pool_numbers else None, pool_numbers=pool_numbers,
        )  # fmt: skip
        reports.append((evaluate_inputs(inputs, (music, None), **how), published))
    return SelfTest(reader.name, str(source), tuple(reports), tuple(skipped))


def _with(reader: Dataset, **values: str) -> Dataset:
    """Return a reader with other parameters, where it has them and accepts the values."""
    names = {f.name for f in fields(reader)}
    try:
        return replace(reader, **{name: value for name, value in values.items() if name in names})
    except UsageError:
        return reader


def _clip_set(reader: Dataset, refs: Sequence[ClipRef], source: Path) -> ClipSet:
    clips = [
        DatasetClip(
            id=ref.id, music=ref.music, tempo_bpm=ref.tempo_bpm, audio_start=ref.audio_start, dataset=reader, ref=ref
        )
        for ref in refs
    ]
    return ClipSet(tuple(clips), str(source), "truth")


def _music_files(protocol: Protocol, refs: Sequence[ClipRef]) -> dict[str, Path]:
    """Return the music of clips, where the protocol's feature is installed."""
    rule = protocol.music
    if rule is None or rule.features[0] not in FEATURES.names():
        return {}
    return {ref.music: ref.audio_path for ref in refs if ref.audio_path is not None}
