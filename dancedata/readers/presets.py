"""Presets: fields, windows and options of published trainers, by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.filters.movement import Movement
from dancedata.readers.primitives import PRIMITIVES
from dancedata.store.dataset import Store

#: Fields that are read by default.
DEFAULT_FIELDS = ("edge151", "librosa35")


@dataclass(frozen=True)
class Preset:
    """Fields, windows and options of one trainer.

    Attributes
    ----------
    fields, optional
        Fields that it needs; fields that it reads if they are stored.
    fps
        Frames per second of the store.
    windows
        Length and stride of windows, as `Store.windows` takes them.
    trim
        Whether windows begin at the trim_start of their clip.
    ignore
        Lists whose clips are left out.
    protocol
        Name of lists such as "cross_genre.train", which define the clips of a split instead of the stored splits.
    filter
        Which windows are kept.
    relative_root
        Whether the root's translation is relative to the window's first frame.
    normalize
        Whether motion is scaled to [-1, 1].
    clip
        Whether scaled values are cut to [-1, 1].
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


def given_or_preset(value: Any, preset: Preset | None, name: str, default: Any) -> Any:
    """Return the caller's value, or the preset's where it is None, or the default without a preset."""
    if value is not None:
        return value
    return default if preset is None else getattr(preset, name)


def preset_fields(store: Store, preset: Preset) -> tuple[str, ...]:
    """Return the fields that a preset reads from a store."""
    return (*preset.fields, *(field for field in preset.optional if field in store.fields))


def preset_windows(preset: Preset | None, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return length and stride as given; where they are not, those of the preset."""
    filled = dict(given)
    for key, value in (preset.windows if preset is not None else {}).items():
        what = key.split("_")[0]
        if given[f"{what}_s"] is None and given[f"{what}_frames"] is None:
            filled[key] = value
    return filled


def field_names(store: Store, fields: Sequence[str] | str, preset: str | None = None) -> tuple[str, ...]:
    """Check that the store has the fields, each named once; `preset` is the preset that names them."""
    names = (fields,) if isinstance(fields, str) else tuple(fields)
    if not names or len(set(names)) != len(names):
        raise UsageError("fields must name at least one field, each once", found=", ".join(names) or "none")
    for name in names:
        if name not in store.fields:
            raise _missing_field(store, name, preset)
    return names


def fields_to_read(
    store: Store, preset: Preset | None, fields: Sequence[str] | None, preset_name: str | None
) -> tuple[tuple[str, ...], bool]:
    """Return the stored fields to read, and whether primitives are computed beside them.

    Where neither the caller nor a preset names any: edge151 and librosa35, or all if the store lacks one of them.
    """
    usual = DEFAULT_FIELDS if set(DEFAULT_FIELDS) <= set(store.fields) else tuple(store.fields)
    default = usual if preset is None else preset_fields(store, preset)
    given = default if fields is None else (fields,) if isinstance(fields, str) else tuple(fields)
    with_primitives = PRIMITIVES in given and PRIMITIVES not in store.fields
    stored = tuple(name for name in given if not (with_primitives and name == PRIMITIVES))
    named = preset_name if fields is None or not stored else None
    return field_names(store, stored or (preset.fields if preset is not None else stored), named), with_primitives


def _missing_field(store: Store, name: str, preset: str | None) -> UsageError:
    """Return the error of a field that the dataset lacks; it names the shipped recipes that compute the field."""
    from dancedata.recipes.yaml import recipes_with  # here, as readers need no YAML

    makers = recipes_with(name)
    build = f"build with a recipe that has it, such as {' or '.join(makers)}, or add it to a recipe of your own"
    if not makers:
        fix = did_you_mean(name, store.fields)
    else:
        fix = build if preset else f"name fields that the dataset has, or {build}"
    why = f", which the preset {preset!r} reads" if preset else ""
    return UsageError(
        f"the dataset has no field {name!r}{why}",
        where=str(store.path),
        found=", ".join(store.fields),
        fix=fix,
    )
