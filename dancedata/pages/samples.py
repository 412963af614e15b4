"""write_samples_report: samples of a model against the dataset that it was trained on, as a page and as numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.clip import Window
from dancedata.core.rotations import Float64Array
from dancedata.core.text import shown
from dancedata.files.atomic import require_free
from dancedata.files.page_files import PageFiles
from dancedata.kernel import ClipRecord, Progress, Store, open_store
from dancedata.pages.measure import Measured, clip_numbers, measure
from dancedata.pages.numbers import document
from dancedata.pages.outliers import outliers
from dancedata.pages.player import scene_player
from dancedata.pages.samples_document import (
    SAMPLES,
    NearestPose,
    SampleRow,
    SamplesReport,
    Scores,
    of_sample,
    sample_of,
)
from dancedata.pages.samples_page import samples_page
from dancedata.pages.scales import Scales
from dancedata.scene.figure import Figure
from dancedata.scene.motions import MotionScenes
from dancedata.scene.pieces import Piece, figure_key_motion
from dancedata.scene.pose_space import Space, poses_of
from dancedata.scene.scene_list import Item

#: Poses at a time whose distances are computed.
_BLOCK = 1000


def require_free_page(page: str | Path | None, like: str | Path, *, overwrite: bool) -> None:
    """Raise UsageError where a page cannot be written: to be asked before the evaluation, which takes long."""
    if page is not None:
        require_free(Path(page), [Path(like)], "report", overwrite=overwrite)


def write_samples_report(
    scores: Scores,
    against: str | Path,
    to: str | Path | None = None,
    *,
    clips: int = 12,
    max_mb: float = 20,
    overwrite: bool = False,
    progress: bool = False,
) -> SamplesReport:
    """Compare samples of a model with the dataset that it was trained on, as ``dancedata report SAMPLES`` does.

    `scores`: What `dancedata.evaluate` says of the samples, with the dataset as `like`.
    `against`: The built dataset.
    `clips`: Number of samples that the page plays, the most suspicious first.
    `to`, `max_mb`, `overwrite`, `progress`: As in `write_report`.
    """
    target = None
    if to is not None:
        target = PageFiles.of(Path(to), [Path(against)], max_mb=max_mb, overwrite=overwrite)
    with open_store(against) as store:
        store.require_intact()
        beats = {clip: of_clip.beats.seconds for clip, of_clip in scores.music.items()}
        scenes = MotionScenes(scores.inputs, Path(scores.source).name, None, store.skeleton, beats)
        report, dancers = _compared(scenes, measure(store, Progress(quiet=not progress)), scores)
    if target is None:
        return report
    suspects = {outlier.clip: number for number, outlier in enumerate(report.outliers)}
    order = sorted(dancers, key=lambda clip: (suspects.get(clip, len(suspects)), clip))
    items = {dancers[clip].number: dancers[clip] for clip in order[:clips]}
    player = scene_player(scenes, list(items.values()), target.folder.name)
    target.write(samples_page(report, player).encode(), player.side_files())
    return replace(report, path=target.path)


def _compared(scenes: MotionScenes, measured: Measured, scores: Scores) -> tuple[SamplesReport, dict[str, Item]]:
    """Measure the samples as the dataset was, and return the report and the item of each sample."""
    store, music = measured.store, scores.music
    numbers = document(measured, Scales.of([measured]))
    space = measured.space or Space.of(store, {})
    # Copies of windows of train are looked for, not those that the splits share.
    kept = [k for k, (_, split, _) in enumerate(space.window_of) if split == "train"]
    space.windows, space.window_of = [space.windows[k] for k in kept], [space.window_of[k] for k in kept]
    first = len(space.pose_of)
    named = {c.id: c.music for c in scores.inputs if c.id in music}
    dancers, rows = {}, {}
    for item in scenes.items:
        for dancer in item.members or (item,):
            figure = scenes.scene(dancer).figure
            if figure is None:
                continue  # the scores name it among those that are left out
            clip, sample = dancer.clip.id, dancer.clip.group or dancer.clip.id
            piece = _piece(figure, music.get(sample))
            dancers[clip], rows[clip] = item, (sample, named.get(sample, ""), clip_numbers(piece))
            record = replace(dancer.clip, id=of_sample(clip), split=SAMPLES, n_frames=_frames(store, figure))
            space.add(record, piece, _windows(store, record))
    nearest, to_train = _nearest(space, first)
    numbers = replace(numbers, poses=poses_of(space, [*store.splits, SAMPLES]))
    sample_rows = tuple(SampleRow(clip, *of_clip, to_train.get(of_sample(clip))) for clip, of_clip in rows.items())
    unlike = outliers({row.clip: row.numbers for row in sample_rows}, measured.clips)
    clips = {clip: of_clip for clip, of_clip in measured.clips.items() if of_clip.seconds}
    return SamplesReport(shown(scenes.place), scores, sample_rows, unlike, nearest, numbers, clips), dancers


def _piece(figure: Figure, music: Any) -> Piece:
    beats, end_s = (None, None) if music is None else (music.beats, music.end_s)
    return Piece(figure, figure_key_motion(figure), beats, end_s)


def _frames(store: Store, figure: Figure) -> int:
    return store.grid.frames_up(figure.grid.seconds(figure.n_frames))


def _windows(store: Store, record: ClipRecord) -> list[Window]:
    """Return the windows that the dataset would cut of a sample."""
    length, stride = store.info["windows"]["length"], store.info["windows"]["stride"]
    starts = range(0, record.n_frames - length + 1, stride)
    return [Window(record.id, start, length) for start in starts]


def _nearest(space: Space, first: int) -> tuple[tuple[NearestPose, ...], dict[str, float]]:
    """Return of each sample the pose farthest from train, and the median distance of its poses."""
    poses = np.concatenate(space.poses).astype(np.float64) if space.poses else np.zeros((0, 1))
    train = np.array([k for k, (_, split, _) in enumerate(space.pose_of) if split == "train"], dtype=np.int64)
    ours = np.arange(first, len(poses))
    if not len(train) or not len(ours):
        return (), {}
    numbers, away = np.zeros(len(ours), dtype=np.int64), np.zeros(len(ours))
    squares = (poses[train] ** 2).sum(axis=1)
    for k in range(0, len(ours), _BLOCK):
        block = poses[ours[k : k + _BLOCK]]
        numbers[k : k + _BLOCK] = (squares - 2 * block @ poses[train].T).argmin(axis=1)
    pairs = train[numbers]
    away = np.sqrt(((poses[ours] - poses[pairs]) ** 2).sum(axis=1) / len(space.joints))
    of_clip: dict[str, list[int]] = {}
    for k, number in enumerate(ours.tolist()):
        of_clip.setdefault(space.pose_of[number][0], []).append(k)
    nearest = []
    for clip, places in of_clip.items():
        k = max(places, key=lambda place: (round(float(away[place]), 6), -place))
        train_clip, _, train_seconds = space.pose_of[int(pairs[k])]
        seconds = space.pose_of[first + k][2]
        both = (_as_pose(poses[ours[k]]), _as_pose(poses[pairs[k]]))
        distance = round(float(away[k]), 4)
        nearest.append(
            NearestPose(sample_of(clip), round(seconds, 3), train_clip, round(train_seconds, 3), distance, *both)
        )
    medians = {clip: round(float(np.median(away[places])), 4) for clip, places in of_clip.items()}
    return tuple(sorted(nearest, key=lambda near: (-near.distance_m, near.clip))), medians


def _as_pose(row: Float64Array) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(round(v, 4) for v in joint) for joint in row.reshape(-1, 3).tolist())
