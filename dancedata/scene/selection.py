"""The request of `dancedata view`: a dataset or motion files, music, other motions, and the first clip."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext, suppress
from dataclasses import KW_ONLY, dataclass, fields, replace
from pathlib import Path

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.clip import member_id
from dancedata.core.errors import DataError, SourceError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.sample_id import SampleId
from dancedata.core.skeleton import SMPL24
from dancedata.core.terms import OVERRIDE, require_shareable
from dancedata.core.text import counted, listed, shown
from dancedata.formats.body_mesh import BodyMesh
from dancedata.samples.saved import saved_samples
from dancedata.scene.comparisons import Comparison, OriginalComparison, comparison_of, file_format
from dancedata.scene.inputs.files import FileFormat, field_of_width
from dancedata.scene.motions import MotionScenes, motion_scenes
from dancedata.scene.payload import link
from dancedata.scene.scene_list import Item, SceneList
from dancedata.scene.scenes import Scenes
from dancedata.scene.source import ClipSource, Sounds
from dancedata.scene.wall import Wall, WallSounds
from dancedata.scene.windows import SampleScenes, samples_in
from dancedata.store import Store, open_store
from dancedata.store.schema import DATASET_FILE

#: Attributes of a request whose option has another name.
_OPTIONS = {"normalized": "--normalized or --not-normalized"}
#: Those that say how motion files are read.
_OF_FILES = ("normalized", "scaler", "clamp", "fps", "up", "unit", "overlay")


@dataclass(frozen=True)
class ViewRequest:
    """Options of `dancedata view`."""

    # `path`, `clip`: A dataset, a folder of motion files or one such file, and the clip or group to begin with; ""
    # for the best. A dancer of a group is shown alone. ``CLIP@START+LENGTH`` loops that window, ``~mirror`` mirrors.
    path: Path
    clip: str = ""
    _: KW_ONLY
    # Motion field to draw, and what columns of motion files are. Default: the best one; that of their width.
    field: str | None = None
    like: Path | None = None  # the dataset with the scaler and rate of motion files at `path`
    # of a dataset the folder that it was built from, with its music and the original motion; of motion files see
    # `MusicFiles.beside`
    music: Path | None = None
    compare: Sequence[Path] = ()  # datasets, folders of motion files, or files
    # `normalized`, `scaler`, `clamp`, `fps`, `up`, `unit`: how motion files are read; see `file_format`
    normalized: bool | None = None
    fps: str | None = None
    up: str = "y"
    unit: str | None = None
    at: float = 0.0
    scaler: Path | None = None
    clamp: bool = False
    overlay: bool = False
    # whether all stand on one stage: each clip and what it is compared with, or the clips of each song
    wall: bool = False
    # `body_model`, `betas`: body model that is drawn in the place of limbs, and its shape; default: its mean
    body_model: Path | None = None
    betas: Sequence[float] | None = None

    def mesh(self) -> BodyMesh | None:
        """Read the body model; None without one."""
        if self.body_model is None:
            if self.betas is not None:
                raise UsageError("betas are the shape of a body model", fix="name its file")
            return None
        return BodyMesh.read(self.body_model, self.betas)

    def beside_truth(self) -> ViewRequest:
        """Return the request for samples that say what they are: the dances of their dataset, and they beside."""
        saved = saved_samples(self.path)
        if saved is None or self.field is not None or self.compare or (self.path / DATASET_FILE).exists():
            return self
        place = saved.dataset if self.like is None else self.like
        saved.like(open_store(place))
        return replace(self, path=place, compare=(self.path,), like=None)

    def scenes(self) -> SceneList:
        """Open the dataset, or read the motion files; UsageError if there is nothing to show."""
        if (self.path / DATASET_FILE).exists():
            self._refuse("is only for motion files, and this is a dataset", ("like",))
            if not self.compare:
                self._refuse("would have no effect without --compare", _OF_FILES, "name the files: --compare FOLDER")
            store = open_store(self.path)
            samples = samples_in(store, [path for path in self.compare if not (path / DATASET_FILE).exists()])
            scenes = SampleScenes(store, self.field, samples) if samples else Scenes(store, self.field)
            if samples and not scenes.items:
                raise DataError("samples of groups cannot be shown beside the truth, on a wall or in a study",
                                reason="groups_left_out", where=listed([path.name for path in self.compare]),
                                found=listed([str(sample.id) for sample in samples]),
                                allowed="samples of single dancers, such as GROUP@0+150~p0",
                                fix="save each dancer by himself; or watch groups: state like= and field=",
                                options="save each dancer by himself; or watch groups: dancedata view SAMPLES --like "
                                "DATASET --field FIELD")  # fmt: skip
            if not scenes.items:
                raise UsageError("this dataset has no clips to show", where=str(self.path))
            return scenes
        if not self.compare:
            self._refuse("would have no effect without --compare", ("overlay",))
        like = None if self.like is None else open_store(self.like)
        form = self._format(like, None if like is None else like.grid, self.path)
        return motion_scenes(self.path, form, self.music, SMPL24 if like is None else like.skeleton, like)

    def comparisons(self, scenes: SceneList, source: Sounds | None) -> tuple[Comparison, ...]:
        """Return the comparisons; equal names get a number."""
        store = scenes.store if isinstance(scenes, Scenes) else None
        if store is None and self.like is not None:
            store = open_store(self.like)
        comparisons: list[Comparison] = [OriginalComparison(source=source)] if isinstance(source, ClipSource) else []
        for path in self.compare:
            comparisons.append(comparison_of(path, scenes, self._format(store, scenes.grid, path)))
            if not matched(comparisons[-1], scenes):
                clips = listed([item.id for item in scenes.items], 2)
                raise DataError(
                    "nothing here has the name of a clip that is shown", reason="nothing_matched", where=str(path),
                    found=comparisons[-1].held, allowed=f"CLIP or CLIP@START+LENGTH; clips are {clips}",
                    fix="write samples with save_samples, or give the files such names",
                )  # fmt: skip
        names = [comparison.name for comparison in comparisons]
        return tuple(
            replace(comparison, name=f"{comparison.name} ({n})") if comparison.name in names[:n] else comparison
            for n, comparison in enumerate(comparisons)
        )

    def _refuse(self, problem: str, names: Sequence[str], fix: str = "leave it out") -> None:
        defaults = {field.name: field.default for field in fields(self)}
        used = [_OPTIONS.get(name, f"--{name}") for name in names if getattr(self, name) != defaults[name]]
        if used:
            raise UsageError(f"{' and '.join(used)} {problem}", where=self.path, fix=fix)

    def _format(self, store: Store | None, grid: FrameGrid | None, path: Path) -> FileFormat:
        """Return how the motion files of a path are read."""
        saved = None if self.field is not None else saved_samples(path)
        field = self.field if saved is None else saved.field
        scaler = self.scaler if saved is None else saved.chosen_scaler(self.scaler, self.normalized)
        if field is None and store is not None:
            field = field_of_width(store, path)
        if (self.normalized is not None or self.scaler is not None) and field is None:
            named = "--scaler" if self.normalized is None else "--normalized"
            raise UsageError(f"{named} needs columns, and none are named", where=path, fix="name them: field=",
                             options="name them: --field FIELD")  # fmt: skip
        return file_format(
            store, grid=grid, field=field, normalized=self.normalized, scaler=scaler, clamp=self.clamp, fps=self.fps,
            up=self.up, unit=self.unit,
        )  # fmt: skip

    def first(self, scenes: SceneList, compared: Sequence[Comparison] = ()) -> tuple[Item, tuple[int, int] | None]:
        """Return the item to begin with, and the loop; without a clip the first that most of `compared` have."""
        if not (self.clip or self.wall or compared):
            return scenes.best(), None
        if not self.clip:
            item = max(scenes.items, key=lambda item: sum(comparison.has(item) for comparison in compared))
            return item, None
        named = SampleId.parse(self.clip)
        if scenes.has(self.clip) or named == SampleId(named.clip):
            return scenes.find(self.clip), None
        item = scenes.find(named.clip if named.dancer is None else member_id(named.clip, named.dancer))
        if named.start is None or named.length is None:
            return item, None
        if named.start + named.length > item.n_frames or not named.length:
            raise UsageError("the window is not within its clip", where=self.clip,
                             found=f"frames {named.start} to {named.start + named.length}",
                             allowed=f"0 to {item.n_frames} of {item.name}")  # fmt: skip
        return item, (named.start, named.start + named.length)

    @property
    def mirrored(self) -> bool:
        """Whether the dancer is mirrored."""
        return bool(self.clip) and SampleId.parse(self.clip).mirrored


def matched(comparison: Comparison, scenes: SceneList) -> int:
    """Return how many of the items have something to compare with."""
    return sum(comparison.has(item) for item in scenes.items)


@dataclass(frozen=True, eq=False)
class ViewSelection:
    """Contents of a request."""

    request: ViewRequest
    scenes: SceneList
    sounds: Sounds | None
    comparisons: tuple[Comparison, ...]
    # `item`, `loop`: the item to begin with; first frame and end of the loop, None without one
    item: Item
    loop: tuple[int, int] | None
    compared: str  # the comparison that is shown at the beginning; "" for none

    @classmethod
    def of(cls, request: ViewRequest) -> ViewSelection:
        """Open the data of a request."""
        asked, request = request, request.beside_truth()
        scenes = request.scenes()
        sounds: Sounds | None = None
        if isinstance(scenes, Scenes):
            music = request.music or scenes.store.source_folder
            with suppress(SourceError) if request.music is None else nullcontext():
                sounds = None if music is None else ClipSource(scenes.store, music)
        elif isinstance(scenes, MotionScenes) and scenes.music is not None:
            sounds = scenes
        comparisons = request.comparisons(scenes, sounds if request.music is not None else None)
        added = comparisons[len(comparisons) - len(request.compare) :]
        item, loop = request.first(scenes, added)
        if request.wall:
            wall = Wall(scenes, added, "truth" if request is not asked else "", apart=not request.overlay)
            item = wall.wall_of(item) if request.clip or (added and not item.members) else wall.items[0]
            return cls(request, wall, None if sounds is None else WallSounds(wall, sounds), (), item, loop, "")
        return cls(request, scenes, sounds, comparisons, item, loop, added[0].name if added else "")

    @property
    def matched(self) -> list[str]:
        """How many of the clips each thing that is compared has, in words."""
        n = len(self.scenes.items)
        added = self.comparisons[len(self.comparisons) - len(self.request.compare) :] if self.comparisons else ()
        return [f"{one.name}: {matched(one, self.scenes)} of {counted(n, 'clip')} matched" for one in added]

    @property
    def address(self) -> str:
        """Fragment of the page's address that shows it."""
        begin = 0.0 if self.loop is None else float(self.scenes.grid.seconds(self.loop[0]))
        return link(
            self.item, at=self.request.at or begin, loop=self.loop, field=self.request.field or "",
            compared=self.compared, mirrored=self.request.mirrored, overlay=self.request.overlay,
        )  # fmt: skip

    @property
    def start(self) -> str:
        """Fragment of the page's address that begins with it: it plays where no clip is named."""
        return self.address + ("" if self.request.clip or self.request.at else "&play=1")

    @property
    def span(self) -> tuple[float, float | None]:
        """Begin and length of the part that a video shows, seconds; the loop, else from `at` to the end (None)."""
        if self.loop is None:
            return self.request.at, None
        begin, end = (float(self.scenes.grid.seconds(frame)) for frame in self.loop)
        return begin, end - begin

    @property
    def credit(self) -> str:
        """Licence and citation of what is shown."""
        about = self.scenes.about()
        return " ".join(filter(None, (about["licence"], about["citation"])))

    def notice(self, rights: str | None) -> str:
        """Return the notice that goes with a copy of the music; UsageError if nothing allows to pass it on."""
        base = self.scenes.scenes if isinstance(self.scenes, Wall) else self.scenes
        if isinstance(base, Scenes):
            return require_shareable(base.store, rights=rights)
        if rights is None:
            raise UsageError("nothing states that this music may be passed on", where=self.request.music,
                             fix=f"leave the music out, or state your right: {OVERRIDE}")  # fmt: skip
        return f"Music: included on the statement of the maker of this file that it may be shared: {rights}"

    def music_to_pass_on(self, rights: str | None, *, silent: bool = False) -> tuple[AudioSignal | None, str, str]:
        """Return the music of the item, the notice that goes with a copy of it, and a line for the user.

        Without music, the line says why. Raises UsageError: for `rights` without music.
        """
        line = "without music"
        if not silent and self.sounds is None:
            line = "no music in it: none is known; --music PATH names it"
        elif not silent and self.sounds is not None:
            try:
                notice = self.notice(rights)
            except UsageError as error:
                line = f"no music in it: {error.problem}; {OVERRIDE} states your right"
            else:
                if (sound := self.sounds.sound(self.item)) is not None:
                    return sound.signal, notice, "  with its music"
                line = f"no music in it: there is none of {shown(self.item.name)}"
        if rights is not None:
            raise UsageError("--rights is about music, and there is none", found=line, fix="name it: --music PATH")
        return None, "", f"  {line}"
