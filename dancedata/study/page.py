"""The page of a study: one file that works offline, asks, and gives the answers as a CSV file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache, cached_property
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import UsageError
from dancedata.core.hashing import sha256_bytes
from dancedata.core.tables import json_text
from dancedata.core.text import counted
from dancedata.files.atomic import require_free
from dancedata.files.page_files import save_page
from dancedata.kernel import ClipRecord, Store, open_store
from dancedata.scene.opus import opus
from dancedata.scene.page import PageSound, Parts, page_data, whole_page
from dancedata.scene.payload import page_json, scene_payload
from dancedata.scene.scene_list import Item, Rhythm, Scene, SceneList
from dancedata.scene.scenes import Scenes
from dancedata.scene.selection import ViewRequest, ViewSelection
from dancedata.scene.source import Sounds
from dancedata.scene.wall import places
from dancedata.scene.windows import SampleScenes, samples_in
from dancedata.study.trials import Trial, begin_of, clip_of, common_clips, left_out, make_trials, shown_figures

#: What raters are asked, and the reasons that they may give.
QUESTION = "Which of the two dances better to the music?"
REASONS = (
    "on the beat",
    "fits the music",
    "natural",
    "expressive",
    "fewer faults: sliding, shaking, impossible poses",
)
#: Columns of the results, in the page's script too.
COLUMNS = (
    "study", "participant", "order", "trial", "song", "clip", "left", "right", "choice", "chosen", "expected",
    "reasons", "plays", "seconds", "time",
)  # fmt: skip


@dataclass(frozen=True)
class StudyRequest:
    """Options of `dancedata study`; the music is that of the first system, and in a check one dancer stands still."""

    systems: Mapping[str, ViewRequest]
    songs: int = 12
    checks: int = 2
    seconds: float = 15.0  # longest trial
    seed: int = 0  # decides on clips, sides, and every rater's order


class _Samples(SceneList):
    """Samples that say what they are, in the place of the dances that they are of."""

    def __init__(self, view: ViewSelection) -> None:
        self._truth, self._samples = view.scenes, view.comparisons[-1]
        self.place, self.grid, self.body = view.scenes.place, view.scenes.grid, view.scenes.body

    @cached_property
    def items(self) -> tuple[Item, ...]:
        """The dances that the samples are of."""
        return tuple(item for item in self._truth.items if self._samples.has(item))

    def scene(self, item: Item, field: str | None = None, *, first_s: float | None = None) -> Scene:
        """Return the scene of a sample."""
        scene = self._truth.scene(item, field, first_s=first_s)
        return replace(scene, figure=self._samples.figure(scene))

    def about(self) -> dict[str, Any]:
        """Return the head of a page of the dances."""
        return self._truth.about()


class _Trials(SceneList):
    """The trials as items of a page, which shows nothing but two dancers."""

    def __init__(self, scenes: Mapping[int, Scene], first: SceneList) -> None:
        self.place, self.grid, self.body, self._scenes = "study", first.grid, first.body, scenes

    @property
    def items(self) -> tuple[Item, ...]:
        """The trials in their order."""
        return tuple(scene.item for scene in self._scenes.values())

    def scene(self, item: Item, field: str | None = None, *, first_s: float | None = None) -> Scene:
        """Return the scene of a trial."""
        return self._scenes[item.number]

    def about(self) -> dict[str, Any]:
        """Return the head of the page, which names no system."""
        return {
            "name": "study", "fps": float(self.grid.rate), "rate": str(self.grid), "clips": 0, "windows": 0,
            "hours": 0, "groups": len(self._scenes), "licence": "", "citation": "",
        }  # fmt: skip


def write_study(
    request: StudyRequest,
    to: Path,
    *,
    rights: str | None = None,
    overwrite: bool = False,
    say: Callable[[str], object] = lambda line: None,
) -> tuple[Trial, ...]:
    """Write the page of a study; `rights`: why the caller may pass the music on, which is published."""
    to = require_free(to, [view.path for view in request.systems.values()], "page", overwrite=overwrite)
    if not 2 <= request.seconds <= 120:
        raise UsageError("invalid length of trials", found=request.seconds, allowed="2 to 120 s")
    views = {name: ViewSelection.of(view) for name, view in request.systems.items()}
    systems = {name: _system(view, list(views.values())) for name, view in views.items()}
    clips = common_clips(systems)
    differ = [name for name, items in clips.items() if len(set(map(clip_of, items.values()))) > 1]
    how = f", {len(differ)} of them by song alone" if differ else ""
    for name, system in systems.items():
        say(f"{name}: {len(clips)} of {counted(len(system.items), 'clip')} matched{how}{left_out(system)}")
    first = next(iter(systems))
    songs = {name: items[first].clip.music or name for name, items in clips.items()}
    trials = make_trials(songs, list(systems), songs=request.songs, checks=request.checks, seed=request.seed)
    notice = views[first].notice(rights)
    sounds = views[first].sounds
    if sounds is None:
        raise UsageError("a study needs the music", fix="name a song, a folder of songs, or a list")
    scenes = {trial.number: _scene(trial, clips[trial.clip], systems, request.seconds) for trial in trials}
    music = {
        trial.number: _music(
            sounds, clips[trial.clip][first], scenes[trial.number], begin_of(clips[trial.clip], systems)
        )
        for trial in trials
    }
    page = _page(request, trials, _Trials(scenes, systems[first]), PageSound(music, notice))
    save_page(to, page)
    return trials


def _system(view: ViewSelection, views: Sequence[ViewSelection]) -> SceneList:
    """Return what a system shows: of a dataset the dances that samples of the others are of, mirrored as they are."""
    if view.request.compare:
        return _Samples(view)
    if not isinstance(view.scenes, Scenes):
        return view.scenes
    store = view.scenes.store
    samples = samples_in(store, [path for system in views for path in _samples_of(system, store)])
    return SampleScenes(store, view.request.field, samples) if samples else view.scenes


def _samples_of(view: ViewSelection, store: Store) -> Sequence[Path]:
    """Return the files or folder of the samples of a dataset that a system shows; empty if it shows none."""
    request, scenes = view.request, view.scenes
    if request.compare and isinstance(scenes, Scenes):
        like, paths = scenes.store, request.compare
    elif request.like is not None:
        like, paths = open_store(request.like), [request.path]
    else:
        return ()
    return paths if like.info["self_sha256"] == store.info["self_sha256"] else ()


def _scene(trial: Trial, items: Mapping[str, Item], systems: Mapping[str, SceneList], seconds: float) -> Scene:
    """Return the two dancers side by side; nothing in it tells who they are."""
    # Contacts and the direction of the face would tell which of the two has rotations, or contacts of its own.
    figures = [
        replace(figure, contacts=np.zeros_like(figure.contacts), contacts_stored=False, facing=None)
        for figure in shown_figures(trial, items, systems, seconds)
    ]
    grid = figures[0].grid
    clip = ClipRecord(id=f"pair {trial.number}", split="", n_frames=figures[0].n_frames)
    pair = []
    for side in ("left", "right"):
        dancer = replace(clip, id=f"{clip.id} {side}", group=clip.id, member=0)
        pair.append(Item(trial.number, dancer, 0, clip.n_frames, called=side))
    members = tuple(
        Scene(item, grid, "", figure.shifted(shift), None, Rhythm.none(), (), (), ())
        for item, figure, shift in zip(pair, figures, places(figures), strict=True)
    )
    group = replace(pair[0], members=tuple(pair), n_source=2, called="")
    return Scene(group, grid, "", None, None, Rhythm.none(), (), (), (), members)


def _music(sounds: Sounds, item: Item, scene: Scene, begin: Fraction) -> bytes:
    """Return the music of a trial, from `begin` seconds after that of the item."""
    sound = sounds.sound(item)
    if sound is None:
        raise UsageError("there is no music for this clip", found=item.id, fix="name a folder with all songs")
    rate = sound.signal.sample_rate
    samples = np.zeros(round(scene.seconds * rate), np.float32)
    first = round(begin * rate)
    cut = sound.signal.samples[first : first + len(samples)]
    samples[: len(cut)] = cut
    return opus(AudioSignal(samples, rate))


def _page(request: StudyRequest, trials: tuple[Trial, ...], scenes: _Trials, sound: PageSound) -> str:
    payloads = {item.number: {**scene_payload(scenes.scene(item)), "number": item.number} for item in scenes.items}
    document = page_data(scenes, scenes.items, clips=payloads, sound=sound, single=True)
    rows = [
        {"song": t.song, "clip": t.clip, "left": t.left, "right": t.right, "expected": t.expected} for t in trials
    ]
    study = {
        "question": QUESTION, "reasons": list(REASONS), "trials": rows, "seed": request.seed,
        "columns": list(COLUMNS),
    }  # fmt: skip
    study["id"] = sha256_bytes(json_text(study).encode())[:12]
    data = f'<script type="application/json" id="dd-study">{page_json(study)}</script>'
    more = _parts()
    return whole_page(document, "study", meta_policy=True, more=replace(more, html=more.html + data))


@cache
def _parts() -> Parts:
    folder = files("dancedata.study") / "static"
    css, body, script = (
        folder.joinpath(f"study.{kind}").read_text(encoding="utf-8") for kind in ("css", "html", "js")
    )
    return Parts(css, body, f"(() => {{\n{script}}})();\n")
