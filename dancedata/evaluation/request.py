"""What is asked for: the set, the pool and the music, as paths or values, become clips that can be measured."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from dataclasses import field as made
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.dance import MusicBeats
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.grid import FrameGrid, Number
from dancedata.core.motion import Motion
from dancedata.core.plugins import Representation
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.text import listed, quoted, shown
from dancedata.evaluation.inputs.clip import ClipInput, MemoryClip
from dancedata.evaluation.inputs.columns import named_reader
from dancedata.evaluation.inputs.files import FileClip, FileFormat, folder_clips
from dancedata.evaluation.inputs.store import store_clips
from dancedata.evaluation.protocol import PROTOCOLS, ROLES, Protocol, Role
from dancedata.evaluation.report import LABELS
from dancedata.evaluation.song_beats import song_files
from dancedata.metrics.intervals import MIN_CLIPS
from dancedata.recipes.plugins import make_named
from dancedata.representations.stored import ColumnsReader, motion_readers
from dancedata.store import Store, open_store
from dancedata.store.normalize import MinMax
from dancedata.store.scaling import Reader, Scaling
from dancedata.store.schema import DATASET_FILE

__all__ = ["Request", "Side", "protocol_named"]

#: Joint positions (T, J, 3) or motions, by the id of a clip.
Motions = Mapping[str, "npt.ArrayLike | Motion"]
What = str | Path | Store | Motions


@dataclass(frozen=True)
class Side:
    """One side of a comparison: clips, and the store that they are from."""

    clips: tuple[ClipInput, ...]
    source: str
    role: Role
    store: Store | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Request:
    """The options of an evaluation; see `dancedata.evaluate` for their meaning."""

    what: What
    protocol: Protocol
    pool: What | None = None
    split: str | None = None
    pool_split: str | None = None
    role: Role | None = None
    like: Store | None = None
    reader: Reader | None = None
    field: str | None = None
    representation: str | None = None
    normalized: bool | None = None
    scaler: MinMax | str | Path | None = None
    clip: bool = False
    fps: Number | None = None
    up: str | None = None
    unit: str | None = None
    body: str | None = None
    source: Path | None = None
    songs: Mapping[str, str] = made(default_factory=dict)
    beats: Mapping[str, Any] = made(default_factory=dict)
    draws: int = 200
    metrics: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check options that belong together."""
        if self.role not in (None, *ROLES):
            raise UsageError("unknown role", found=self.role, allowed=", ".join(ROLES))
        if self.draws != 0 and self.draws < MIN_CLIPS:
            raise UsageError(
                "invalid number of bootstrap draws", found=self.draws, allowed=f"0, or {MIN_CLIPS} and above"
            )
        if self.normalized and self.like is None and self.scaler is None:
            raise UsageError(
                "normalised columns need the scaler of a dataset", fix="name it: --like STORE, or --scaler FILE"
            )
        if self.scaler is not None and self.like is None and self.representation is None:
            raise UsageError("a scaler is of columns", fix="name them: --like STORE, or --representation NAME")

    @property
    def numbers(self) -> list[int]:
        """Numbers of the protocol's measures that are asked for: all, or those of `metrics`.

        Raises
        ------
        UsageError
            If the protocol does not have a metric or score of that name.
        """
        names = [{measure.metric.name, *measure.metric.better} for measure in self.protocol.measures]
        printed = {label: name for name, label in LABELS.items()}
        wanted = {printed.get(asked, asked) for asked in self.metrics}
        known = {name for own in names for name in own}
        for asked in sorted(wanted - known):
            raise UsageError(
                f"the protocol has no metric {quoted(asked)}", where=f"protocol {self.protocol.name}",
                fix=did_you_mean(asked, sorted(known)),
            )  # fmt: skip
        return [k for k, own in enumerate(names) if not wanted or own & wanted]

    def set_side(self) -> Side:
        """Return the clips that are evaluated."""
        return self._side(self.what, self.split, self.role, self.field)

    def pool_side(self) -> Side | None:
        """Return the clips of the pool: by default all of the dataset that is evaluated, or that --like names."""
        if self.pool is not None:
            return self._side(self.pool, self.pool_split, "truth", self.field)
        own = self.like or _as_store(self.what)
        return None if own is None else self._side(own, self.pool_split, "truth", self.field)

    def _side(self, what: What, split: str | None, role: Role | None, field: str | None = None) -> Side:
        store = _as_store(what)
        if store is not None:
            own_role: Role = role or "truth"
            clips = store_clips(store, self.protocol, split=split, field=field, role=own_role)
            named = f"{store.path}" + (f", split {split}" if split else "")
            return Side(_filled(clips, named), named, own_role, store)
        if split is not None:
            raise UsageError("only a dataset has splits", found=f"split {split}", where=_name(what))
        own_role = role or "generated"
        if isinstance(what, Mapping):
            return Side(
                _filled(_in_memory(what, self._grid(), self.body), "clips in memory"), "clips in memory", own_role
            )
        path = Path(what).expanduser() if isinstance(what, str | Path) else what.path
        form = FileFormat(
            fps=None if self._grid() is None else str(self._grid()), up=self.up, unit=self.unit, body=self.body,
            columns=self._columns(),
        )  # fmt: skip
        if path.is_dir():
            return Side(folder_clips(path, form), str(path), own_role)
        if not path.exists():
            raise UsageError("there is nothing to evaluate", where=path, allowed="a built dataset, a folder, a file")
        return Side((FileClip(id=path.stem, path=path, format=form),), str(path), own_role)

    def _grid(self) -> FrameGrid | None:
        if self.fps is not None:
            return FrameGrid.of(self.fps)
        return None if self.like is None else self.like.grid

    def _columns(self) -> ColumnsReader | None:
        """Return how two-dimensional arrays are read; None if nothing says so."""
        if self.like is not None:
            name = self.field or next(iter(motion_readers(self.like)), "")
            stored = named_reader(self.like, name)
            grid = stored.grid if self.fps is None else FrameGrid.of(self.fps)
            return ColumnsReader(stored.representation, grid, self._scaling(name, stored.representation))
        if self.representation is None:
            return None
        if self.fps is None:
            raise UsageError(
                "the frame rate of the columns is unknown", fix="declare it: --fps RATE, or --like STORE"
            )
        plugin: Representation = make_named(REPRESENTATIONS, "motion", self.representation, {})
        return ColumnsReader(plugin, FrameGrid.of(self.fps), self._scaling(self.representation, plugin))

    @property
    def scaler_sha256(self) -> str:
        """Hash of the scaler that columns are stated to be normalised by; "" without one."""
        stated = self.normalized or self.scaler is not None or self.reader is not None
        columns = self._columns() if stated else None
        scaler = None if columns is None or not columns.scaling.normalized else columns.scaling.scaler
        return "" if scaler is None else scaler.sha256

    def _scaling(self, field: str, plugin: Representation) -> Scaling:
        return Scaling.of(
            self.reader or self.like, field, plugin.columns.labels, normalized=self.normalized, scaler=self.scaler,
            clip=self.clip,
        )  # fmt: skip

    def music_files(self) -> dict[str, Path]:
        """Return the music files by song; empty where none are given."""
        return {} if self.source is None else song_files(self.source)

    def given_beats(self, clips: Sequence[ClipInput]) -> dict[str, MusicBeats]:
        """Return the beats that the caller gives, frames at the protocol's rate."""
        unknown = sorted(set(self.beats) - {clip.id for clip in clips})
        if unknown:
            raise UsageError("beats are given for clips that are not there", found=listed(unknown))
        found = {}
        for clip, beats in self.beats.items():
            if isinstance(beats, MusicBeats):
                found[clip] = beats
                continue
            grid = self.protocol.music.grid if self.protocol.music is not None else None
            if grid is None:
                raise UsageError(
                    f"{self.protocol.name} has no rate for beats of its own", where=f"clip {clip}",
                    fix="give dancedata.metrics.MusicBeats.of(frames, grid)",
                )  # fmt: skip
            found[clip] = MusicBeats.of(np.asarray(beats), grid)
        return found


def protocol_named(protocol: str | Protocol) -> Protocol:
    """Return a protocol by its name; UsageError with the closest one for an unknown name."""
    return PROTOCOLS.get(protocol)() if isinstance(protocol, str) else protocol


def _as_store(what: What) -> Store | None:
    if isinstance(what, Store):
        return what
    if isinstance(what, str | Path):
        path = Path(what).expanduser()
        if (path / DATASET_FILE).exists():
            return open_store(path)
    return None


def _name(what: What) -> str:
    return str(what) if isinstance(what, str | Path) else "clips in memory"


def _filled(clips: Iterable[ClipInput], source: str) -> tuple[ClipInput, ...]:
    found = tuple(clips)
    if not found:
        raise UsageError("there are no clips to evaluate", where=source)
    return found


def _in_memory(motions: Motions, grid: FrameGrid | None, body: str | None) -> tuple[ClipInput, ...]:
    clips: list[ClipInput] = []
    for name, given in motions.items():
        if not isinstance(name, str):
            raise UsageError("a clip's id is a text", found=f"{shown(name)}, {type(name).__name__}")
        if isinstance(given, Motion):
            clips.append(MemoryClip(id=name, motion=given))
        elif grid is None:
            raise UsageError("the frame rate of the joints is unknown", where=f"clip {name}", fix="give fps=")
        else:
            clips.append(MemoryClip(id=name, joints=_numbers(given, name), grid=grid, body=body))
    return tuple(clips)


def _numbers(joints: npt.ArrayLike, name: str) -> npt.NDArray[np.float64]:
    try:
        array = np.asarray(joints)
    except (TypeError, ValueError, RuntimeError) as error:
        raise UsageError("the joints are not an array", where=f"clip {shown(name)}", found=shown(error)) from error
    if array.dtype.kind not in "fiu":
        raise UsageError("the joints are not real numbers", where=f"clip {shown(name)}", found=array.dtype.name)
    return array.astype(np.float64)
