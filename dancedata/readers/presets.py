"""Presets: fields, windows and options of published trainers, by name."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Window
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.filters.movement import Movement
from dancedata.keymotion.characteristic_primitives import Variant, borders, primitives
from dancedata.keymotion.minima import KeyMotion
from dancedata.store.dataset import Store

#: The name of primitives in `fields`.
PRIMITIVES = "primitives"


@dataclass(frozen=True)
class PrimitiveSpec:
    """Computation of primitives from the windows of a field.

    `field`: Motion field that they are rows of.
    `key_motion`: Key motion field that holds the clip's minima; None where they are not read: for variant "code",
        which uses only the window, and for windows of n frames.
    `n`: Frames of a local segment. A window of n frames gets its 4 + 4 border frames, a longer one hard and soft
        cues.
    """

    field: str
    key_motion: str | None
    n: int
    variant: Variant

    def refuse_scaling(self, length: int) -> None:
        """Raise UsageError if primitives of windows of `length` frames cannot be normalised."""
        if self.variant == "code" and length != self.n:
            raise UsageError(
                "variant code makes the root relative to each piece's first frame, which cannot be normalised: the "
                "scaler was fitted on absolute positions",
                fix="pass normalize=False and scale afterwards, or take primitive_variant='paper'",
            )

    def of(self, store: Store, window: Window, rows: npt.NDArray[Any], bias: int) -> dict[str, npt.NDArray[Any]]:
        """Return the primitives of a window's rows (N, D), mirrored but not normalised, as entries of a sample."""
        if window.length == self.n:
            return {PRIMITIVES: borders(rows)}
        if self.key_motion is None:
            cues = primitives(rows, window.length, self.n, variant=self.variant, bias=bias)
        else:
            stored = KeyMotion.from_rows(store.read(window, self.key_motion))
            cues = primitives(rows, window.length, self.n, minima=stored.minima, prominence=stored.prominence)
        return {
            PRIMITIVES: cues.frames,
            "primitive_start": np.asarray(cues.start, dtype=np.int64),
            "primitive_hard": np.asarray(cues.hard, dtype=np.bool_),
            "primitive_filled": np.asarray(cues.filled, dtype=np.bool_),
        }


def primitive_spec(store: Store, fields: tuple[str, ...], length: int, n: int, variant: Variant) -> PrimitiveSpec:
    """Return the fields and lengths for primitives, and check them.

    UsageError if no motion field at the store's rate is read, or the store does not hold key motions.
    """
    motion = [f.name for f in map(store.field, fields) if f.kind == "motion" and f.rate == store.fps]
    if not motion:
        raise UsageError(
            "primitives need a motion field to be read with them", found=", ".join(fields), fix="read lodge139"
        )
    if length % n:
        raise UsageError("a window is not a whole number of local segments",
                         found=f"windows of {length} frames, primitive_n={n}",
                         fix="choose a primitive_n that divides the window's length")  # fmt: skip
    names = [f.name for f in store.fields_with(kind="keymotion")]
    reads = variant == "paper" and length != n
    if reads and not names:
        raise UsageError("the store does not hold key motions", where=str(store.path),
                         fix="build with keymotion: {lodge: {}}, or take primitive_variant='code'")  # fmt: skip
    return PrimitiveSpec(motion[0], names[0] if reads else None, n, variant)


#: Fields that are read by default.
DEFAULT_FIELDS = ("edge151", "librosa35")


@dataclass(frozen=True)
class Preset:
    """Fields, windows and options of one trainer.

    `fields`, `optional`: Fields that it needs; fields that it reads if they are stored.
    `fps`: Frames per second of the store.
    `windows`: Length and stride of windows, as `Store.windows` takes them.
    `trim`: Whether windows begin at the trim_start of their clip.
    `ignore`: Lists whose clips are left out.
    `protocol`: Name of lists such as "cross_genre.train", which define the clips of a split instead of the stored
        splits.
    `filter`: Filter of the windows.
    `relative_root`: Whether the root's translation is relative to the window's first frame.
    `normalize`: Whether motion is scaled to [-1, 1].
    `clip`: Whether scaled values are cut to [-1, 1].
    """

    fields: tuple[str, ...]
    optional: tuple[str, ...]
    fps: int
    windows: Mapping[str, Any]
    trim: bool = False
    ignore: tuple[str, ...] = ()
    protocol: str | None = None
    filter: Movement | None = None
    relative_root: bool = False
    normalize: bool = True
    clip: bool = False


def _lodge(length: int, stride: int) -> Preset:
    """Lodge (Li et al., CVPR 2024): trimmed tracks, cross-genre split, without training windows that stand still."""
    return Preset(
        fields=("lodge139",),
        optional=("librosa35",),
        fps=30,
        windows={"length_frames": length, "stride_frames": stride},
        trim=True,
        ignore=("ignored",),
        protocol="cross_genre",
        filter=Movement(field="lodge139"),
        clip=True,
    )


PRESETS = {
    # EDGE (Tseng et al. 2023, data/slice.py): 5 s every 0.5 s.
    "edge": Preset(("edge151",), ("librosa35",), 30, {"length_s": 5, "stride_s": 0.5}, clip=True),
    "lodge-global": _lodge(1024, 1024 // 10),
    "lodge-local": _lodge(256, 256 // 8),
    # FineDance (Li et al. 2023): whole tracks, 130 ignored as well, the root relative to each window's first frame.
    "finenet": Preset(
        fields=("finedance319",),
        optional=("librosa35",),
        fps=30,
        windows={"length_frames": 120, "stride_frames": 12},
        ignore=("ignored", "ignored.finenet"),
        protocol="cross_genre",
        filter=Movement(field="finedance319"),
        relative_root=True,
        normalize=False,
    ),
}


def find_preset(store: Store, name: str | None) -> Preset | None:
    """Return a preset by name, if the store has its frame rate."""
    if name is None:
        return None
    preset = PRESETS.get(name)
    if preset is None:
        raise UsageError(f"unknown preset {name!r}", fix=did_you_mean(name, PRESETS))
    if store.fps != preset.fps:
        raise UsageError(
            f"preset {name!r} is for {preset.fps} frames per second",
            where=str(store.path),
            found=f"{store.fps} frames per second",
            fix=f"build with fps: {preset.fps}, or name fields and windows instead of a preset",
        )
    return preset


def value_or_preset(value: Any, preset: Preset | None, name: str, default: Any) -> Any:
    """Return the caller's value, or the preset's where it is None, or the default without a preset."""
    if value is not None:
        return value
    return default if preset is None else getattr(preset, name)


def preset_windows(preset: Preset | None, requested: Mapping[str, Any]) -> dict[str, Any]:
    """Return length and stride as given; where they are not, those of the preset."""
    filled = dict(requested)
    for key, value in (preset.windows if preset is not None else {}).items():
        size = key.split("_")[0]
        if requested[f"{size}_s"] is None and requested[f"{size}_frames"] is None:
            filled[key] = value
    return filled


def fields_to_read(
    store: Store, preset: Preset | None, fields: Sequence[str] | None, preset_name: str | None
) -> tuple[tuple[str, ...], bool]:
    """Return stored fields to read, by default edge151 and librosa35 or all; and whether to compute primitives."""
    usual = DEFAULT_FIELDS if set(DEFAULT_FIELDS) <= set(store.fields) else tuple(store.fields)
    if preset is not None:
        usual = (*preset.fields, *(field for field in preset.optional if field in store.fields))
    requested = usual if fields is None else (fields,) if isinstance(fields, str) else tuple(fields)
    with_primitives = PRIMITIVES in requested and PRIMITIVES not in store.fields
    stored = tuple(name for name in requested if not (with_primitives and name == PRIMITIVES))
    named_by = preset_name if fields is None or not stored else None
    names = stored or (preset.fields if preset is not None else stored)
    if not names or len(set(names)) != len(names):
        raise UsageError("fields must name at least one field, each once", found=", ".join(names) or "none")
    for name in names:
        if name not in store.fields:
            raise _missing_field(store, name, named_by)
    return names, with_primitives


def _missing_field(store: Store, name: str, preset: str | None) -> UsageError:
    """Return the error of a field that the dataset lacks; it names the shipped recipes that compute the field."""
    from dancedata.files.yaml import recipes_with  # here, as readers need no YAML

    makers = recipes_with(name)
    build = f"build with a recipe that has it, such as {' or '.join(makers)}, or add it to your own recipe"
    if not makers:
        fix = did_you_mean(name, store.fields)
    else:
        fix = build if preset else f"name fields that the dataset has, or {build}"
    why = f", which the preset {preset!r} reads" if preset else ""
    return UsageError(
        f"the dataset has no field {name!r}{why}", where=str(store.path), found=", ".join(store.fields), fix=fix
    )
