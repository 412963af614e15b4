"""Options of an evaluation, and the set, the pool and the music that they name, as clips that can be measured."""

import os
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from dataclasses import field as field_of
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import DataError, UsageError, did_you_mean
from dancedata.core.grid import FrameGrid, Number
from dancedata.core.motion import Motion
from dancedata.core.plugins import Representation
from dancedata.core.registry import METRICS, REPRESENTATIONS
from dancedata.core.text import counted, listed, quoted, shown
from dancedata.evaluation.clips import ClipSet, named_reader, store_clips, truth_of
from dancedata.evaluation.music import MusicPlans, music_plan
from dancedata.evaluation.pool import Pool, check_target, load_pool
from dancedata.evaluation.protocol import ROLES, Protocol, Role
from dancedata.evaluation.report import LABELS
from dancedata.evaluation.scores import DRAWS
from dancedata.files.addresses import local_folder
from dancedata.kernel import DATASET_FILE, Sample, Scaler, Store, TrainingData, make_named, open_store
from dancedata.scene.inputs.clip import ClipInput, GroupClip, MemoryClip
from dancedata.scene.inputs.files import FileFormat, columns_width, field_of_width, path_clips
from dancedata.scene.inputs.naming import named_clips
from dancedata.scene.inputs.songs import MusicSources
from dancedata.scene.like import scaling_of
from dancedata.scene.poses import ColumnsReader, motion_readers
from dancedata.scene.scaling import Scaling

#: Joint positions (T, J, 3) or motions, by the id of a clip.
Motions = Mapping[str, "npt.ArrayLike | Motion"]
MotionInput = str | Path | Store | Motions


@dataclass(frozen=True, kw_only=True, eq=False)
class Inputs:
    """The inputs of an evaluation, not loaded."""

    protocol: Protocol
    clip_set: ClipSet
    # `numbers`, `pool_numbers`: measures of the protocol that are computed of the set and of the pool
    numbers: list[int]
    pool: ClipSet | Pool | None  # clips, or the pool of a file; None: metrics that need one are not computed
    pool_numbers: list[int]
    # the dances of the dataset that generated ones are of, or to the same songs; None without a dataset
    truth: ClipSet | None = None
    draws: int = DRAWS
    dataset: str = ""  # the reader of the real dances, "" without any; only its published figures compare

    @property
    def in_pool(self) -> int:
        """How many of the clips that are judged are in the pool that they are compared with."""
        pool, judged = self.pool, self.clip_set
        if not isinstance(pool, ClipSet) or pool.store is None or judged.store is None:
            return 0
        if pool.store.info.get("self_sha256") != judged.store.info.get("self_sha256"):
            return 0
        ids = {clip.clip for clip in judged.clips}
        return sum(clip.clip in ids for clip in pool.clips)


@dataclass(frozen=True, kw_only=True, eq=False)
class EvaluationOptions:
    """The options of an evaluation; see `dancedata.evaluate` for their meaning."""

    what: MotionInput
    protocol: Protocol
    pool: MotionInput | None = None
    split: str | None = None
    pool_split: str | None = None
    role: Role | None = None
    like: Store | None = None
    reader: TrainingData | None = None
    field: str | None = None
    normalized: bool | None = None
    scaler: Scaler | str | Path | None = None
    clamp: bool = False
    fps: Number | None = None
    up: str | None = None
    unit: str | None = None
    body: str | None = None
    music: MusicSources = field_of(default_factory=MusicSources)
    intervals: bool = True
    metrics: tuple[str, ...] = ()
    save_pool: Path | None = None

    def __post_init__(self) -> None:
        if self.role not in (None, *ROLES):
            raise UsageError("unknown role", found=self.role, allowed=", ".join(ROLES))
        if self.normalized and self.like is None and self.scaler is None:
            raise UsageError(
                "normalised columns need the scaler of a dataset",
                fix="name it: like= or scaler=", options="name it: --like DATASET or --scaler FILE",
            )  # fmt: skip
        if self.scaler is not None and self.like is None and self.field is None:
            raise UsageError("a scaler applies only to columns, and none are named", fix="name them: like= or field=",
                             options="name them: --like DATASET or --field NAME")  # fmt: skip
        if self.field is None and self.like is not None:
            path = Path(self.what).expanduser() if isinstance(self.what, str | Path) else None
            object.__setattr__(self, "field", None if path is None else field_of_width(self.like, path))

    @property
    def numbers(self) -> list[int]:
        """Numbers of the measures that are computed: all, or those of `metrics`; UsageError for an unknown name."""
        names = [{measure.metric.name, *measure.metric.better} for measure in self.protocol.measures]
        printed = {label: name for name, label in LABELS.items()}
        chosen = {printed.get(metric, metric) for metric in self.metrics}
        allowed = set().union(*names)
        for metric in sorted(chosen - allowed):
            raise UsageError(f"the protocol has no metric {quoted(metric)}", where=f"protocol {self.protocol.name}",
                             fix=did_you_mean(metric, sorted(allowed), METRICS.names()))  # fmt: skip
        return [k for k, of_measure in enumerate(names) if not chosen or of_measure & chosen]

    def inputs(self) -> Inputs:
        """Return the clips, the pool and the music; UsageError if one cannot be read as the options state."""
        if self.save_pool is not None:
            check_target(self.save_pool, self.protocol)
        numbers = self.numbers
        # A pool that is saved has the metrics that this report leaves out, too.
        pool, pool_numbers = self.pool_input(numbers if self.save_pool is None else None)
        if self.save_pool is not None and pool is None:
            raise UsageError("no pool was given, so none can be saved", fix="name a dataset: pool=",
                             options="name a dataset: --pool STORE")  # fmt: skip
        store = _as_store(self.what)
        split = self.split or ("test" if store is not None and "test" in store.splits else None)
        clip_set = self._clip_set(self.what, split, self.role)
        ids = {clip.id for clip in clip_set.clips}
        if unknown := sorted(set(self.music.songs) - ids):
            raise UsageError("the list of songs names unknown clips", found=listed(unknown))
        if unknown := sorted(set(self.music.beats) - ids):
            raise UsageError("beats given for unknown clips", found=listed(unknown))
        if self.body is not None and store is None and _are_columns(clip_set.clips):
            raise UsageError("a body applies only to joint positions, and these files hold columns",
                             where=clip_set.source, found=f"body {self.body}", fix="leave it out")  # fmt: skip
        clip_set, real = self._named(clip_set), store or self.like
        return Inputs(
            protocol=self.protocol, clip_set=clip_set, numbers=numbers, pool=pool, pool_numbers=pool_numbers,
            truth=self._truth(clip_set), draws=DRAWS if self.intervals else 0,
            dataset="" if real is None else real.reader_name,
        )  # fmt: skip

    @property
    def music_sources(self) -> MusicSources | None:
        """Sources of beats; None: no metric that is computed takes them."""
        rules = self.protocol
        takes_music = rules.music is not None and any(rules.measures[n].metric.needs_music for n in self.numbers)
        return replace(self.music, like=self.like) if takes_music else None

    def music_plans(self, inputs: Inputs) -> MusicPlans:
        """Return where the beats of the clips are, and those of the real dances beside them."""
        sources = self.music_sources
        if sources is None:
            return None, None
        of_dataset = MusicSources(files=sources.files, like=sources.like)
        truth = None if inputs.truth is None else music_plan(self.protocol, inputs.truth, of_dataset)
        return music_plan(self.protocol, inputs.clip_set, sources), truth

    def _named(self, clip_set: ClipSet) -> ClipSet:
        """Return clips with what their names say."""
        named = named_clips(clip_set.clips, self.music, self.like or clip_set.store)
        clip_set, music = replace(clip_set, clips=named.clips, samples=named.samples), self.music_sources
        if self.like is None or clip_set.store is not None:
            return clip_set
        nothing = None
        if music is not None and not {*music.songs, *music.beats, *music.files}:
            nothing = named.nothing_matched(clip_set.source, self.like)
        _require_rate(self.fps, named.samples)
        unknown = [clip for clip in named.unknown if music is None or clip not in music.beats]
        left = f"{counted(len(unknown), 'file')} of {len(named.clips)} without a clip, window or song of "
        warning = [f"{left}{self.like.path.name}, so without music: {listed(unknown)}"] if unknown else []
        warning += _about_samples(named.samples, of_groups=self.protocol.of_groups)
        return replace(clip_set, matched=named.found(Path(clip_set.source).name, self.like), warnings=tuple(warning),
                       nothing_matched=nothing)  # fmt: skip

    def _truth(self, clip_set: ClipSet) -> ClipSet | None:
        """Return the dances of the dataset that samples are of; else those of its split test to their songs."""
        like = self.like
        if like is None or clip_set.role == "truth" or clip_set.store is not None:
            return None
        if clip_set.samples and self.split is None:
            clips = truth_of(clip_set.samples, self.protocol, self.field)
            samples = {str(replace(of.id, take=0)): of for of in clip_set.samples.values()}
            return ClipSet(clips, f"the same dances of {like.path.name}", clip_set.role, like, samples=samples)
        split = self.split or ("test" if "test" in like.splits else None)
        truth = self._clip_set(like, split, "truth")
        songs = {clip.music for clip in clip_set.clips}
        to_them = tuple(clip for clip in truth.clips if clip.music in songs)
        return replace(truth, clips=to_them or truth.clips)

    def pool_input(self, numbers: Iterable[int] | None = None) -> tuple[ClipSet | Pool | None, list[int]]:
        """Return the pool, by default that of --like or of the dataset itself, and the measures that need one."""
        measures = self.protocol.measures
        numbers = [n for n in (range(len(measures)) if numbers is None else numbers) if measures[n].metric.needs_pool]
        if isinstance(self.pool, str | Path) and Path(self.pool).suffix == ".npz":
            pool = load_pool(Path(self.pool).expanduser(), self.protocol)
            pool.require(self.protocol, pool.fps, self.scaler_sha256)
            return pool, numbers
        if not numbers:
            return None, numbers
        source = self.pool if self.pool is not None else self.like or _as_store(self.what)
        if source is None:
            return None, numbers
        split, store = self.pool_split, _as_store(source)
        if split is None and store is not None and self.protocol.pool_split in store.splits:
            split = self.protocol.pool_split
        return self._clip_set(source, split, "truth"), numbers

    def _clip_set(self, what: MotionInput, split: str | None, role: Role | None) -> ClipSet:
        store = _as_store(what)
        if store is not None:
            role = role or "truth"
            clips, left_out = store_clips(store, self.protocol, split=split, field=self.field, role=role)
            place = os.path.normpath(store.path) if store.origin is None else store.origin.address
            source = f"{place}" + (f", split {split}" if split else "")
            return ClipSet(clips, source, role, store, left_out=left_out)
        if split is not None and self.like is None:
            raise UsageError("only a dataset has splits", found=f"split {split}",
                             where=what if isinstance(what, str | Path) else "clips in memory")  # fmt: skip
        role = role or "generated"
        if isinstance(what, Mapping):
            of = _groups_in_memory if self.protocol.of_groups else _in_memory
            clips = of(what, self._grid(), self.body)
            return ClipSet(clips, "clips in memory", role, scaler_sha256=self.scaler_sha256)
        path = Path(what).expanduser() if isinstance(what, str | Path) else what.path
        form = FileFormat(
            fps=None if self._grid() is None else str(self._grid()), up=self.up, unit=self.unit, body=self.body,
            columns=self._columns(), groups=self.protocol.of_groups,
        )  # fmt: skip
        # Absolute: on a cluster, a relative path would name another file.
        return ClipSet(path_clips(path.absolute(), form), str(path), role, scaler_sha256=self.scaler_sha256)

    def _grid(self) -> FrameGrid | None:
        if self.fps is not None:
            return FrameGrid.of(self.fps)
        return None if self.like is None else self.like.grid

    def _columns(self) -> ColumnsReader | None:
        """Return the reader of two-dimensional arrays; None if no option states one."""
        if self.like is not None:
            name = self.field or next(iter(motion_readers(self.like)), "")
            stored = named_reader(self.like, name)
            grid = stored.grid if self.fps is None else FrameGrid.of(self.fps)
            return ColumnsReader(stored.representation, grid, self._scaling(name, stored.representation))
        if self.field is None or _as_store(self.what) is not None:
            return None
        if self.fps is None:
            raise UsageError(
                "the frame rate of the columns is unknown", fix="declare it: fps= or like=",
                options="declare it: --fps RATE or --like DATASET",
            )  # fmt: skip
        plugin: Representation = make_named(REPRESENTATIONS, "motion", self.field, {})
        return ColumnsReader(plugin, FrameGrid.of(self.fps), self._scaling(self.field, plugin))

    @property
    def scaler_sha256(self) -> str:
        """Hash of the scaler that columns are stated to be normalised by; "" without one."""
        stated = self.normalized or self.scaler is not None or self.reader is not None
        columns = self._columns() if stated else None
        scaler = None if columns is None or not columns.scaling.normalized else columns.scaling.scaler
        return "" if scaler is None else scaler.sha256

    def _scaling(self, field: str, plugin: Representation) -> Scaling:
        return scaling_of(
            self.reader or self.like, field, plugin.columns.labels, normalized=self.normalized, scaler=self.scaler,
            clamp=self.clamp,
        )  # fmt: skip


def _as_store(what: MotionInput) -> Store | None:
    if isinstance(what, Store):
        return what
    if isinstance(what, str | Path):
        path = local_folder(what)
        if (path / DATASET_FILE).exists():
            return open_store(path)
    return None


def _are_columns(clips: Iterable[ClipInput]) -> bool:
    """Return whether all clips are files of columns."""
    try:
        return all(clip.file is not None and columns_width(clip.file) > 0 for clip in clips)
    except DataError:  # of a file that cannot be read: its `load` gives the reason
        return False


def _require_rate(fps: Number | None, samples: Mapping[str, Sample]) -> None:
    """Raise UsageError for windows of a dataset, whose frames their ids count, at another rate."""
    for name, sample in samples.items():
        if fps is not None and sample.id.start is not None and FrameGrid.of(fps) != sample.store.grid:
            raise UsageError("the id of a window counts frames of its dataset, which has a different rate",
                             where=name, reason="wrong_rate",
                             found=f"{FrameGrid.of(fps)} frames per second",
                             allowed=f"{sample.store.grid}, as {sample.store.path.name} has",
                             fix="omit fps; a model at a different rate needs a dataset at that rate")  # fmt: skip


def _about_samples(samples: Mapping[str, Sample], *, of_groups: bool) -> list[str]:
    """Return what is to be known of samples whose truth is not all that was read, and of dancers of groups."""
    changes = Counter(change for of in samples.values() for change in {*of.id.changes} - {"mirror"})
    lost = (
        f"{', '.join(changes)} of {counted(sum(changes.values()), 'sample')} cannot be made again without the reader"
    )
    groups = {of.id.clip for of in samples.values() if of.id.dancer is not None or of.clip.group}
    alone = f"{counted(len(groups), 'group')} measured dancer by dancer; together: --protocol groups"
    return [f"{lost}; their truth is as stored"] * bool(changes) + [alone] * bool(groups and not of_groups)


def _in_memory(motions: Motions, grid: FrameGrid | None, body: str | None) -> tuple[ClipInput, ...]:
    clips: list[ClipInput] = []
    for name, motion in motions.items():
        if not isinstance(name, str):
            raise UsageError("a clip's id must be a string", found=f"{shown(name)}, {type(name).__name__}")
        if isinstance(motion, Motion):
            clips.append(MemoryClip(id=name, motion=motion))
        elif grid is None:
            raise UsageError("the frame rate of the joints is unknown", where=f"clip {name}", fix="give fps=")
        else:
            clips.append(MemoryClip(id=name, joints=_positions(motion, name), grid=grid, body=body))
    return tuple(clips)


def _groups_in_memory(motions: Motions, grid: FrameGrid | None, body: str | None) -> tuple[ClipInput, ...]:
    """Return groups, each positions (P, T, J, 3) or a sequence of motions."""
    groups = []
    for name, group in motions.items():
        if isinstance(group, Motion) or (isinstance(group, np.ndarray) and group.ndim != 4):
            raise UsageError("this is not a group", where=f"group {shown(name)}",
                             found=f"shape {group.shape}" if isinstance(group, np.ndarray) else "a motion",
                             allowed="positions (P, T, J, 3), or a list of motions")  # fmt: skip
        dancers: Motions = {f"{name}, dancer {k}": dancer for k, dancer in enumerate(group)}  # type: ignore[arg-type]
        groups.append(GroupClip(id=name, members=_in_memory(dancers, grid, body)))
    return tuple(groups)


def _positions(joints: npt.ArrayLike, name: str) -> npt.NDArray[np.float64]:
    try:
        array = np.asarray(joints)
    except (TypeError, ValueError, RuntimeError) as error:
        raise UsageError("the joints are not an array", where=f"clip {shown(name)}", found=shown(error)) from error
    if array.dtype.kind not in "fiu":
        raise UsageError("the joints are not real numbers", where=f"clip {shown(name)}", found=array.dtype.name)
    return array.astype(np.float64)
