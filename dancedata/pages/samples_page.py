"""The page of a model's samples beside the dataset that it was trained on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from dancedata.core.bodies import SMPLX22
from dancedata.core.text import counted, listed
from dancedata.pages.bin_counts import nice_edges
from dancedata.pages.figures import FigureSpec
from dancedata.pages.markup import Figure, Markup, escaped, percent, rounded, scrolled, table
from dancedata.pages.measure import ClipNumbers
from dancedata.pages.page import chapter_links, chapters_html, grid, outlier_figures, whole_page
from dancedata.pages.player import Player
from dancedata.pages.samples_document import SAMPLES, NearestPose, SampleRow, SamplesReport, of_sample
from dancedata.pages.space_figures import pose_figures, split_space_figures
from dancedata.pages.svg import histogram
from dancedata.scene.stills import still

#: Numbers of clips that are compared: name, unit, and least width of a bin.
MEASURES: Mapping[str, tuple[str, str, float]] = {
    "speed": ("speed of the body", "m/s", 0.01),
    "still": ("standing still", "share of frames", 0.01),
    "root_extent_m": ("floor that a clip covers", "m", 0.05),
    "turns": ("turn of the body", "full turns", 0.05),
    "floor_drift_m": ("drift of the floor", "m", 0.005),
    "below_floor_m": ("lowest joint below the floor", "m", 0.005),
    "jerk": ("jerk", "m/s³", 1.0),
    "key_beat_ms": ("key motions from the nearest beat", "ms", 1.0),
}
_POSES = 12


def describe(report: SamplesReport) -> list[str]:
    """Return the lines that ``dancedata report`` prints."""
    poses, other = report.dataset.poses, report.dataset.about.name
    lines = [report.scores.matched] if report.scores.matched else []
    lines += [] if report.path is None else [f"{report.path}: {report.path.stat().st_size / 1e6:.1f} MB"]
    lines += [report.scores.verdict, *report.scores.table()]
    if near := poses.to_train.get(SAMPLES):
        usual = "" if poses.chance is None else f" (two halves of train: {rounded(100 * poses.chance.p50)} cm)"
        lines.append(f"  poses: {rounded(100 * near.p50)} cm from the nearest of train{usual}")
    copies = sum(SAMPLES in pair.splits for pair in poses.duplicates)
    if copies:
        lines.append(f"  look: {counted(copies, 'pair')} of windows of samples and of train are nearly equal")
    if report.outliers:
        names = listed([outlier.clip for outlier in report.outliers], 3)
        lines.append(f"  look: {counted(len(report.outliers), 'sample')} unlike the clips of {other}: {names}")
    left_out = report.scores.left_out
    return [*lines, f"  left out: {counted(len(left_out), 'sample')}"] if left_out else lines


def samples_page(report: SamplesReport, player: Player) -> str:
    """Return the HTML of the page."""
    links = {**player.links, **{of_sample(clip): address for clip, address in player.links.items()}}
    d = FigureSpec(replace(report.dataset, outliers=report.outliers), links=links)
    unlike = outlier_figures(d, f"the clips of {report.dataset.about.name}")
    of_train = [pair for pair in report.dataset.poses.duplicates if SAMPLES in pair.splits]
    poses = replace(report.dataset.poses, duplicates=tuple(of_train))
    d = replace(d, numbers=replace(d.numbers, poses=poses))
    chapters = [
        ("scores", "Scores", _scores(report)),
        ("look", "Look at these first", grid(unlike)),
        ("movement", "How they move", grid([_medians(report), *_histograms(report)])),
        ("poses", "Poses", grid([*pose_figures(d), *_nearest(d, report.nearest), *split_space_figures(d)])),
        ("songs", "By song", grid(_songs(report))),
        ("clips", "Every sample", grid([_clips(d, report)])),
        ("left-out", "Left out, and remarks", _remarks(report)),
    ]
    chapters = [chapter for chapter in chapters if chapter[2]]
    name, other = escaped(report.name), escaped(report.dataset.about.name)
    scores = report.scores
    facts = (
        f"{counted(len(report.rows), 'sample')} at {scores.fps} frames per second, protocol {scores.protocol.name}; "
        f"ground truth: {scores.truth_source}"
    )
    sections = chapter_links(chapters, player, "sample")
    main = (
        f'<p class="verdict {"void" * all(s.verdict == "void" for s in scores.scores)}">{escaped(scores.verdict)}</p>'
        f"<header><h1>{name} <small>samples, against {other}</small></h1>"
        f'<p class="sub">{escaped(facts, 600)}</p></header>'
        f'<nav aria-label="Sections">{sections}</nav>{chapters_html(chapters)}'
    )
    return whole_page(f"{report.name}: samples", main, player)


def _scores(report: SamplesReport) -> str:
    head, rows = report.scores.cells()
    cells: dict[bool, list[tuple[Markup, ...]]] = {False: [], True: []}
    for score, row in zip(report.scores.scores, rows, strict=True):
        span = f'<span class="{score.verdict}" title="{escaped(score.reason)}">'
        cells[score.verdict == "void"].append(tuple(Markup(f"{span}{escaped(str(cell))}</span>") for cell in row))
    note = (
        "after ~: of these samples alone, not comparable with another set. The truth is measured under the same "
        "protocol against the same pool; at this n: as many real dances against the pool"
    )
    body = scrolled(head, cells[False]) if cells[False] else ""
    if void := cells[True]:
        named = listed([str(r[0]) for s, r in zip(report.scores.scores, rows, strict=True) if s.verdict == "void"], 9)
        summary = f"{counted(len(void), 'score')} without a meaning: {escaped(named)}"
        body += f"<details><summary>{summary}</summary>{scrolled(head, void)}</details>"
    return Figure("scores", f"Protocol {report.scores.protocol.name}", note, body, kind="wide").to_html()


def _values(clips: Sequence[ClipNumbers], measure: str) -> list[float]:
    return [float(v) for clip in clips if (v := getattr(clip, measure)) is not None]


def _both(report: SamplesReport, measure: str) -> tuple[list[float], list[float]]:
    return _values([row.numbers for row in report.rows], measure), _values(list(report.clips.values()), measure)


def _medians(report: SamplesReport) -> Figure:
    rows = []
    for measure, (name, unit, _) in MEASURES.items():
        samples, clips = _both(report, measure)
        if samples and clips:
            rows.append((f"{name}, {unit}", *(_spread(values) for values in (samples, clips))))
    head = ("of a clip", "samples", report.dataset.about.name)
    note = "median over clips, in brackets 5 and 95 %"
    return Figure("medians", "Movement of clips", note, table(head, rows), kind="wide")


def _spread(values: Sequence[float]) -> Markup:
    low, middle, high = (rounded(float(v)) for v in np.quantile(values, (0.05, 0.5, 0.95)))
    return Markup(f"{middle} ({low} to {high})")


def _histograms(report: SamplesReport) -> list[Figure]:
    figures = []
    for measure, (name, unit, least) in MEASURES.items():
        samples, clips = _both(report, measure)
        if not samples or not clips:
            continue
        edges = nice_edges(min(*samples, *clips), max(*samples, *clips), least=least)
        counts, outline = (np.histogram(values, edges)[0].tolist() for values in (samples, clips))
        title = f"{name[0].upper()}{name[1:]}"
        body = histogram(edges, {"samples": counts}, unit, other=outline)
        rows = tuple(zip(edges, edges[1:], counts, outline, strict=False))
        head = ("from", "to", "samples", report.dataset.about.name)
        other = f"outline: {report.dataset.about.name}"
        figures.append(Figure(f"of_{measure}", title, "% of clips", body, head, rows, other=other))
    return figures


def _nearest(d: FigureSpec, nearest: Sequence[NearestPose]) -> list[Figure]:
    """Return the strangest pose of each sample beside the pose of train that is nearest to it."""
    shown = [near for near in nearest if len(near.pose) == SMPLX22.n_joints][:_POSES]
    if not shown:
        return []
    cells = ""
    for near in shown:
        sample = still(np.array(near.pose), SMPLX22, f"a pose of {near.clip}")
        train = still(np.array(near.train_pose), SMPLX22, f"the nearest pose of train, of {near.train_clip}")
        away = f"{rounded(100 * near.distance_m)} cm from {d.link(near.train_clip)}"
        cells += f"<li>{sample}{train}<small>{d.link(near.clip)} at {near.seconds:.1f} s, {away}</small></li>"
    body = f'<ul class="stills pairs">{cells}</ul>'
    note = "of each sample the pose farthest from all poses of train, above, and the nearest pose of train, below"
    return [Figure("nearest", "The strangest poses", note, body, kind="wide")]


def _of_metrics(report: SamplesReport) -> dict[str, dict[str, float]]:
    """Return the numbers of the metrics, means over the pieces of each sample, by metric."""
    values: dict[str, dict[str, list[float]]] = {}
    for row in report.scores.per_clip:
        for name, value in row.items():
            if name not in ("clip", "piece", "frames") and isinstance(value, int | float):
                values.setdefault(name, {}).setdefault(row["clip"], []).append(float(value))
    return {name: {clip: float(np.mean(of)) for clip, of in by_clip.items()} for name, by_clip in values.items()}


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _songs(report: SamplesReport) -> list[Figure]:
    metrics = _of_metrics(report)
    songs: dict[str, list[SampleRow]] = {}
    for row in report.rows:
        if row.song:
            songs.setdefault(row.song, []).append(row)
    if not songs:
        return []
    rows = [
        (song, len(of), *(_mean(by_clip.get(row.sample) for row in of) for by_clip in metrics.values()),
         _mean(row.numbers.speed for row in of), _mean(row.to_train_m for row in of))
        for song, of in sorted(songs.items())
    ]  # fmt: skip
    head = ("song", "samples", *(report.scores.label(name) for name in metrics), "speed m/s", "to train m")
    note = "means over the samples of a song; to train: median distance of their poses to the nearest pose of train"
    return [Figure("songs", "Songs", note, scrolled(head, rows, "list sortable"), kind="wide")]


def _clips(d: FigureSpec, report: SamplesReport) -> Figure:
    metrics = _of_metrics(report)
    cells = [
        (d.link(row.clip), row.song or "–", row.numbers.seconds,
         *(by_clip.get(row.sample) for by_clip in metrics.values()), percent(row.numbers.still), row.numbers.speed,
         row.numbers.floor_drift_m, row.numbers.jerk, row.to_train_m)
        for row in sorted(report.rows, key=lambda row: row.clip)
    ]  # fmt: skip
    head = ("sample", "song", "seconds", *(report.scores.label(name) for name in metrics), "still", "speed m/s",
            "floor drift m", "jerk m/s³", "to train m")  # fmt: skip
    body = scrolled(head, cells, "list sortable")
    return Figure("samples", "Numbers of each sample", "the head of a column sorts", body, kind="wide")


def _remarks(report: SamplesReport) -> str:
    scores = report.scores
    entries = [("left out", f"{clip}: {reason}") for clip, reason in scores.left_out]
    entries += [("warning", text) for text in scores.warnings]
    entries += [("not computable", f"{name}: {why}") for name, why in scores.protocol.not_computable.items()]
    entries += [("note", text) for text in scores.notes]
    lines = "".join(f"<li><b>{escaped(kind)}</b>: {escaped(text, 2000)}</li>" for kind, text in entries)
    return f'<ul class="terms">{lines}</ul>' if lines else ""
