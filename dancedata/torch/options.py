"""What a reader reads, as frozen values that know no store and can stand in presets, YAML files and checkpoints."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self, TypeAlias, get_args

from dancedata.core.arguments import names, probability, whole
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.text import shown
from dancedata.store.columns import MAX_ROWS
from dancedata.store.normalize import Scaler, TrainingData
from dancedata.torch.music_beats import StartAt

if TYPE_CHECKING:
    from dancedata.core.plugins import WindowFilter
    from dancedata.core.sample_steps import Augment

MirrorWords = Literal["error", "keep"]
#: Of Lodge's primitives: as its paper has them, or as its code finds them.
Variant = Literal["paper", "code"]
Choose = Literal["stored", "seed", "left_to_right"]
ScaleKind = Literal["minmax", "zscore", "zscore_grouped"]
Over = Literal["train", "all"]
Share = float
#: A filter as callers name it: a plug-in, or its name and parameters as in a recipe.
FilterLike: TypeAlias = "WindowFilter | Mapping[str, Any] | None"
#: A scaler as callers name it: itself, its file, those of several fields, or a reader that has them.
ScalerLike = Scaler | str | Path | Mapping[str, Scaler | str | Path] | TrainingData


@dataclass(frozen=True)
class Value:
    """A frozen value that prints as it is typed, and that plain data of YAML, JSON and checkpoints hold."""

    def __post_init__(self) -> None:
        """Check the parameters by their types; lists become tuples."""
        for f in fields(self):
            kind, value = str(f.type), getattr(self, f.name)
            check = _CHECKS.get(kind.removesuffix(" | None"))
            if check is not None and not (value is None and kind.endswith(" | None")):
                object.__setattr__(self, f.name, check(f"{type(self).__name__}.{f.name}", value))

    def __repr__(self) -> str:
        stated = dict(self.stated())
        required = (repr(stated.pop(f.name)) for f in fields(self) if f.default is f.default_factory is MISSING)
        return f"{type(self).__name__}({', '.join((*required, *(f'{n}={v!r}' for n, v in stated.items())))})"

    @classmethod
    def taken(cls, value: Any) -> Self:
        """Return an argument of a reader, by default the value without parameters; UsageError for anything else."""
        if not isinstance(value, cls | None):
            raise UsageError(f"not a value of {cls.__name__}", found=shown(value), fix=f"give {cls.__name__}(...)")
        return cls() if value is None else value

    def stated(self) -> Iterator[tuple[str, Any]]:
        """Yield names and values of what differs from the defaults."""
        for f in fields(self):
            value = getattr(self, f.name)
            if value != (f.default if f.default_factory is MISSING else f.default_factory()):
                yield f.name, value

    def _not_both(self, first: str, second: str) -> None:
        values = {name: getattr(self, name) for name in (first, second)}
        if all(value and value not in ("minmax", "train") for value in values.values()):
            both = [f"{name}={value!r}" for name, value in values.items()]
            raise clash(both[0], both[1], f"{type(self).__name__} takes one of them")


def _text(what: str, value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise UsageError(f"{what} is not a text", found=shown(value))
    return value


def _truth(what: str, value: Any) -> bool:
    if not isinstance(value, bool):
        raise UsageError(f"{what} must be True or False", found=shown(value), allowed="True, False")
    return value


def _one_of(choices: Any, what: str, value: Any) -> str:
    if not isinstance(value, str) or value not in get_args(choices):
        raise UsageError(f"{what} is unknown: {shown(value)}", fix=did_you_mean(str(value), get_args(choices)))
    return value


def _where(what: str, value: Any) -> Any:
    """Return columns with tuples of values; `require_where` checks them against a dataset."""
    if not isinstance(value, Mapping):
        return value
    return {name: tuple(v) if isinstance(v, list | set) else v for name, v in value.items()}


#: What values of a type are checked by, and what they become.
_CHECKS: Mapping[str, Callable[[str, Any], Any]] = {
    "bool": _truth, "str": _text, "tuple[str, ...]": names, "int": partial(whole, least=1, most=MAX_ROWS),
    "Share": probability, "Augment": lambda _, value: tuple(value) if isinstance(value, list) else value,
    "Mapping[str, Any]": _where,
    **{kind: partial(_one_of, choices) for kind, choices in {
        "StartAt": StartAt, "ScaleKind": ScaleKind, "Over": Over, "Variant": Variant, "MirrorWords": MirrorWords,
        "Choose": Choose,
    }.items()},
}  # fmt: skip


def clash(first: object, second: object, why: str) -> UsageError:
    """Return the error of two values that do not go together."""
    return UsageError(f"two values do not go together: {why}", found=f"{first} and {second}", fix="leave out one")


@dataclass(frozen=True, repr=False)
class Windows(Value):
    """Where windows lie; what is None is as stored.

    Attributes
    ----------
    length_s, stride_s, length, stride
        Length and stride, in seconds or in frames: at most one of each pair. Windows end where the clip ends, or the
        first of the fields in it.
    fps
        Rate that the frames are meant at: a dataset at a different rate is refused.
    start_at
        "downbeat" or "beat": windows begin there, at least a stride apart, instead of a stride after each other.
        Clips without any are in `rejects` ("filtered"). The beats are those of the first of the fields that has such
        a column, else of the first field of the dataset.
    trim
        Whether windows begin at each clip's trim_start, where the dance begins according to the source.
    """

    length_s: float | str | None = None
    stride_s: float | str | None = None
    length: int | None = None
    stride: int | None = None
    fps: int | None = None
    start_at: StartAt | None = None
    trim: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        self._not_both("length_s", "length")
        self._not_both("stride_s", "stride")

    @property
    def length_and_stride(self) -> dict[str, Any]:
        """Arguments of `Store.windows`."""
        return {name: getattr(self, name) for name in ("length_s", "stride_s", "length", "stride")}


@dataclass(frozen=True, repr=False)
class Select(Value):
    """Which clips and windows are read.

    Attributes
    ----------
    where
        Values that clips may have, by column, ``{"x/level": (3, 4), "genre": "waltz"}``: one of several values; of a
        column of lists, lists that have one of them; ``{"clip": IDS}`` are those clips. Others are in `rejects`
        ("filtered").
    ignore
        Names of lists whose clips are left out; "ignored.<protocol>" is then left out as well. "LAYER:LABEL" leaves
        out windows that overlap a segment of this layer and label, such as "mark:reject" of the viewer's marks.
    protocol
        Such as "cross_genre": lists of that name ("cross_genre.train"), and not the stored splits, define which clips
        a split has.
    filter
        A window filter, or its name and parameters as in a recipe, ``{"movement": {"min_std": 0.07}}``.
    """

    where: Mapping[str, Any] = field(default_factory=dict)
    ignore: tuple[str, ...] = ()
    protocol: str | None = None
    filter: FilterLike = None


@dataclass(frozen=True, repr=False)
class Scale(Value):
    """How fields are scaled.

    Attributes
    ----------
    kind
        "minmax": to [-1, 1] by the range in train, as EDGE; values beyond come back whole. "zscore"; or
        "zscore_grouped": one deviation for the columns of a group, as HumanML3D.
    fields
        Names of the fields that are scaled; None: those of motion.
    clamp
        Whether values are cut to [-1, 1], as EDGE and Lodge do.
    covers
        Augmentations, as readers take them, whose results the range covers. Every reader and command that meets the
        model's columns then needs that scaler by name.
    over
        "train", or "all": every row of every clip, as Lodge's released scaler was fitted. It includes test data, and
        is here to reproduce Lodge's results.
    scaler
        A scaler of another reader, such as one that is wider: itself, the file of its ``save``, either by field, or
        the reader. ``scale=SCALER`` is ``scale=Scale(scaler=SCALER)``.
    """

    kind: ScaleKind = "minmax"
    fields: tuple[str, ...] | None = None
    clamp: bool = False
    covers: Augment = ()
    over: Over = "train"
    scaler: ScalerLike | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("clamp", "covers", "over", "scaler"):
            self._not_both("kind", name)
        self._not_both("scaler", "covers")
        self._not_both("scaler", "over")

    @classmethod
    def of(cls, scale: Scale | ScalerLike | None) -> Scale:
        """Return what the argument `scale` of readers stands for: None scales nothing."""
        if isinstance(scale, bool):
            raise UsageError(
                "scale cannot be True or False", found=scale, allowed="Scale(...), a scaler, its file, or None"
            )
        if scale is None:
            return cls(fields=())
        return scale if isinstance(scale, cls) else cls(scaler=scale)  # type: ignore[arg-type]


@dataclass(frozen=True, repr=False)
class Relative(Value):
    """A motion field whose translation is relative to the window's first frame.

    Such motion cannot be scaled: a scaler is fitted on absolute positions.
    """

    field: str


@dataclass(frozen=True, repr=False)
class Primitives(Value):
    """Lodge's primitives of the first motion field, of local segments of `n` frames.

    `variant` "paper" takes the clip's stored key motions, "code" what Lodge's released code finds in the window,
    shifted by a bias in -2 .. 2 that is a pure function of (seed, epoch, index).
    """

    n: int = 256
    variant: Variant = "paper"


@dataclass(frozen=True, repr=False)
class Text(Value):
    """``"text"``: one text of a layer of segments, drawn for each (seed, epoch, index); "" where there is none.

    Attributes
    ----------
    layer
        Name of the layer.
    min_share
        Share of a window that a segment covers at least if its text may be drawn.
    empty
        Share of windows with "" as their text, for guidance.
    mirror_words
        Mirrored windows have the words of a mirrored dancer. "error": a layer that may name sides and has no mirrored
        words cannot be read mirrored. "keep": its words are given as they are.
    """

    layer: str
    min_share: Share = 0.5
    empty: Share = 0.0
    mirror_words: MirrorWords = "error"


@dataclass(frozen=True, repr=False)
class Segments(Value):
    """``"segments"``: a list of the segments that a window overlaps, `PlacedSegment`.

    `mirror_words` is that of `Text`.
    """

    mirror_words: MirrorWords = "error"


@dataclass(frozen=True, repr=False)
class Dancers(Value):
    """Which dancers of a group a sample has.

    Attributes
    ----------
    persons
        Dancers of a sample, P. Default: those of the split's largest group.
    exactly
        Only groups of this many dancers, which is then P.
    choose
        Which dancers where there are more than P, and their order. "stored": the first, as in the source. "seed":
        drawn for each (seed, epoch, index), in a new order also where there are exactly P, as GCD does.
        "left_to_right": by x in the first frame, as given out.
    singles
        Whether single dancers are groups of one; else they are left out and counted in `rejects`.
    """

    persons: int | None = None
    exactly: int | None = None
    choose: Choose = "stored"
    singles: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        self._not_both("persons", "exactly")


#: An entry of `fields`: the name of a field, or of a free column, "x/NAME"; or what is made of them.
Item = str | Relative | Primitives | Text | Segments
