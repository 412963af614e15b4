"""Checks of what a build is made of: fields, transforms, annotators and window rules."""

from __future__ import annotations

import json
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.building.fields.key_motion import KeyMotionField
from dancedata.building.fields.motion import MotionField, RepresentationField
from dancedata.building.inputs import Music
from dancedata.building.plugins import Annotator, Field, Seen, WindowRule
from dancedata.building.result import Result, Rows
from dancedata.building.take import Dancer, Recording, Scene, Scenes, SourceReader, Take, Time, Transform
from dancedata.core.clip import ClipRef
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import CONTACTS, DATASETS, KEYMOTIONS, REPRESENTATIONS
from dancedata.core.segments import Layer, Segment
from dancedata.testing.examples import FPS
from dancedata.testing.plugin_checks import check_plugin, require

_ROWS = 300


def check_field(cls: type[Field]) -> None:
    """Check a field of motion: rows of every dancer, as many as the time of a take has; equal motions, equal rows."""
    check_plugin(cls)
    field = cls().on(FPS)
    require(field.kind in ("motion", "keymotion", "audio"), "kind is motion, keymotion or audio")
    require(bool(field.sha256) and field.sha256 == cls().on(FPS).sha256, "equal fields have one hash")
    for n_dancers in (1, 2):
        take, scene = _example(n_dancers)
        asks = [ask for ask in field.asks(take) if ask.source is take.recording]
        before = _arrays(scene)
        first, second = ([] if not asks else field.make(Scenes(scene), [a.part for a in asks]) for _ in range(2))
        require(_equal(_arrays(scene), before), "it does not write into the motion")
        require(_equal(first, second), "equal motions give equal rows")
        for k, rows in enumerate(first):
            shape = (field.n_rows(take, k), field.columns.width)
            require(rows.shape == shape, f"rows are {shape}, not {rows.shape}")
            require(rows.dtype == field.dtype and bool(np.isfinite(rows).all()), f"rows are finite {field.dtype}")


def check_transform(cls: type[Transform]) -> None:
    """Check a transform: the takes that it makes are as long as their motion, equal motions give equal results."""
    check_plugin(cls)
    step = cls().on(FPS)
    require(bool(json.dumps(step.key())) and step.sha256 == cls().on(FPS).sha256, "its key is JSON")
    for n_dancers in (1, 2):
        take, scene = _example(n_dancers)
        if n_dancers > 1 and step.not_for_groups:
            continue
        try:
            takes = step.expand(take)
        except UsageError as error:
            require(n_dancers > 1 and bool(str(error)), f"takes of single dancers can be changed: {error}")
            continue
        require(len({d.id for t in takes for d in t.dancers}) == sum(len(t.dancers) for t in takes), "ids are unique")
        for expanded in takes[:3]:
            before = _arrays(scene)
            first, second = (Scenes(scene).after(expanded.motion_steps) for _ in range(2))
            require(_equal(_arrays(scene), before), "`scene` does not write into the motion")
            require(_equal(_arrays(first), _arrays(second)), "equal motions give equal results")
            require(all(np.isfinite(a).all() for a in _arrays(first)), "motion is finite")
            times = {(m.n_frames, m.grid.rate) for m in first.motions}
            require(
                times == {(expanded.time.n_frames, expanded.time.rate)}, f"a take has the time of its motion, {times}"
            )
            flags = [[flag.to_json() for flag in of] for of in first.flags]
            require(len(flags) == n_dancers and json.loads(json.dumps(flags)) == flags, "flags are JSON")
            segment = step.segment(Segment(Layer("words"), Fraction(1), Fraction(2), "turn"), expanded)
            require(segment is None or segment.start <= segment.end, "a segment of a copy ends after its start")


def check_annotator(cls: type[Annotator]) -> None:
    """Check an annotator: rows of every dancer as JSON, and segments of them; equal motions give equal rows."""
    check_plugin(cls)
    annotator = cls()
    require(cls.copies in ("own", "parent", "none"), "copies is own, parent or none")
    for n_dancers in (1, 2):
        take, scene = _example(n_dancers)
        before = _arrays(scene)
        first, second = (annotator.annotate(scene) for _ in range(2))
        require(_equal(_arrays(scene), before), "`annotate` does not write into the motion")
        require(len(first) == n_dancers, "`annotate` gives rows of each dancer")
        again = json.loads(json.dumps(first))
        require(again == json.loads(json.dumps(second)), "equal motions give equal rows, which are JSON")
        for k, rows in enumerate(again):
            for segment in annotator.segments(rows, take, k):
                require(segment.start <= segment.end and bool(segment.layer.name), "segments have a layer and an end")
                require(not segment.other or segment.other in {d.id for d in take.dancers}, "`other` is a dancer")


def check_rule(cls: type[WindowRule]) -> None:
    """Check a window rule: it rejects windows that there are, or a dancer, and equal takes get equal answers."""
    check_plugin(cls)
    rule = cls()
    require(cls.of_group in ("any", "all"), "of_group is any or all")
    take, scene = _example(2)
    starts = tuple(range(0, _ROWS - 60, 30))
    segments = [_segments([*rule.annotators], take, scene, k) for k in range(2)]
    fields = _fields()
    rows = {f.id: f.make(Scenes(scene), [ask.part for ask in f.asks(take)]) for f in fields}
    results = {
        of: [Rows(r, "") if isinstance(r, np.ndarray) else r for r in of_field] for of, of_field in rows.items()
    }
    seen = Seen(Result(take, starts, (0, 1), made=results), fields, FPS, 60, segments)
    for k in range(2):
        rejects = rule.judge(seen, k, starts)
        require(rejects == rule.judge(seen, k, starts), "equal takes get equal answers")
        require({r.window for r in rejects} <= {*starts, None}, "rejects name first frames of windows, or none")
        require(all(bool(r.reason and r.detail) for r in rejects), "rejects have a reason and a detail")
        require(all(json.dumps(r.to_json()) for r in rejects), "rejects are JSON")
    require(all(isinstance(note, str) for note in rule.notes(("train",))), "notes are texts")


def _fields() -> list[MotionField]:
    """Return all fields of motion, as a recipe may have them, for rules that read rows."""
    fields: list[MotionField] = []
    for name in REPRESENTATIONS.names():
        plugin = REPRESENTATIONS.make(name, {})
        rule = None if plugin.default_contacts is None else CONTACTS.make(plugin.default_contacts, {})
        grid = FPS if plugin.rate is None else FrameGrid(plugin.rate)
        fields.append(RepresentationField(name, grid, plugin, rule, optional=True))
    return [*fields, *(KeyMotionField(n, FPS, KEYMOTIONS.make(n, {}), optional=True) for n in KEYMOTIONS.names())]


def _segments(annotators: Sequence[Annotator], take: Take, scene: Scene, dancer: int) -> list[Segment]:
    return [
        s for a in annotators for s in a.segments(json.loads(json.dumps(a.annotate(scene)))[dancer], take, dancer)
    ]


def _example(n_dancers: int) -> tuple[Take, Scene]:
    """Return a take of ten seconds, and its motion: dances beside each other."""
    from dancedata.synthetic import synthesise_motion

    names = ("gHO_sBM_cAll_d17_mHO1_ch01", "gJS_sBM_cAll_d25_mJS3_ch02")[:n_dancers]
    motions = [synthesise_motion(name, n_frames=2 * _ROWS)[0].resampled(FPS) for name in names]
    group = "duo" if n_dancers > 1 else ""
    refs = [
        ClipRef(name, Path(f"{name}.npz"), None, "train", "", group=group, member=k) for k, name in enumerate(names)
    ]
    recording = Recording(SourceReader(DATASETS.get("synthetic")(), {}), tuple((ref, "0" * 64) for ref in refs))
    dancers = tuple(Dancer(ref.id, ref, "0" * 64, Music(None)) for ref in refs)
    take = Take(recording, dancers, Time(motions[0].n_frames, motions[0].grid.rate), group=group)
    return take, Scene(tuple(motions), tuple(refs), ((),) * n_dancers)


def _arrays(scene: Scene) -> list[Any]:
    return [np.array(a) for m in scene.motions for a in (m.translation, m.rotations)]


def _equal(one: Sequence[Any], other: Sequence[Any]) -> bool:
    return len(one) == len(other) and all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))
