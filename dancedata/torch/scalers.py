"""The scalers and mirrors of the fields that a reader reads."""

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.clip import Window
from dancedata.core.columns import Mirror
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.text import listed, shown
from dancedata.store.dataset import Store
from dancedata.store.normalize import Scaler, scaler_from
from dancedata.store.schema import Field
from dancedata.torch.options import Relative, Scale, ScalerLike, Select, clash
from dancedata.torch.selection import WindowQuery, select

_log = logging.getLogger(__name__)


def named_scalers(store: Store, fields: tuple[str, ...], scaler: ScalerLike | None) -> dict[str, Scaler]:
    """Return the scalers that the caller names, by field; UsageError for those of other columns or datasets."""
    if scaler is None:
        return {}
    by_field: Mapping[str, Scaler | str | Path]
    if isinstance(scaler, Mapping):
        by_field = scaler
    elif isinstance(scaler, Scaler | str | Path):
        single = scaler if isinstance(scaler, Scaler) else Scaler.load(scaler)
        fitting = [name for name in fields if store.fields[name].width == single.width]
        by_field = {single.field or (fitting[0] if len(fitting) == 1 else ""): single}
    elif not hasattr(scaler, "normalized"):
        raise UsageError("this is not a scaler", found=shown(scaler),
                         fix="give Scale(...), a reader, store.scaler(FIELD), its file, or None")  # fmt: skip
    else:
        shared = [name for name in scaler.fields if name in fields]
        by_field = {n: scaler.scaler(n) for n in shared if n in scaler.normalized or _is_real_motion(store.field(n))}
        if not by_field:
            raise UsageError("the reader that names the scaler reads no motion field of this one",
                             found=listed(scaler.fields), allowed=listed(fields),
                             fix="name a reader of the same fields, or scale={FIELD: ...}")  # fmt: skip
    for name in by_field or [""]:
        if name not in fields:
            raise UsageError("the scaler was not fitted on a field that is read", found=shown(name),
                             allowed=", ".join(fields), fix="name the field: scale={FIELD: ...}")  # fmt: skip
    scalers = {}
    for name, choice in by_field.items():
        has_own = store.field(name).codebook is None and name in store.stats["fields"]
        dataset = store.scaler(name).sha256 if has_own else ""
        scaler_ = scaler_from(choice, name)
        scalers[name] = scaler_.require(field=name, columns=store.fields[name].labels, dataset=dataset)
    return scalers


def normalized_fields(store: Store, fields: tuple[str, ...], names: tuple[str, ...] | None) -> tuple[str, ...]:
    """Return the fields to scale: those of `names`, or motion."""
    for name in names or ():
        if name not in fields:
            raise UsageError(f"scale names a field that is not read: {name!r}", allowed=", ".join(fields),
                             fix=did_you_mean(name, fields))  # fmt: skip
        if (codebook := store.field(name).codebook) is not None:
            raise UsageError(f"codes are never scaled: field {name!r}", where=str(store.path),
                             found=f"codes of {codebook.name}", fix="leave the field out of scale")  # fmt: skip
    return tuple(name for name in fields if _is_real_motion(store.field(name))) if names is None else names


def _is_real_motion(field: Field) -> bool:
    return field.kind == "motion" and field.codebook is None


def mirrors_of(store: Store, fields: tuple[str, ...]) -> dict[str, Mirror]:
    """Return the mirror of every motion field; audio has none and is not mirrored."""
    mirrors: dict[str, Mirror] = {}
    for field in map(store.field, fields):
        if field.kind == "motion":
            if field.codebook is not None:
                raise UsageError(
                    f"field {field.name!r} cannot be mirrored: codes have no mirror image",
                    where=str(store.path),
                    fix="read it without mirror; the codes of mirrored dances are those of a dataset of their own",
                )
            if field.columns.mirror is None:
                raise UsageError(f"field {field.name!r} cannot be mirrored: its columns do not define a mirror image",
                                 where=str(store.path),
                                 fix="read it without mirror, or leave the field out")  # fmt: skip
            mirrors[field.name] = field.columns.mirror
    return mirrors


def root_columns(store: Store, relative: Sequence[str], scaled: Sequence[str]) -> dict[str, slice]:
    """Return the columns of the translation of `relative` fields; UsageError for one without it, or a scaled one."""
    columns = {}
    for name in relative:
        if "translation" not in store.fields[name].names:
            raise UsageError(f"field {name!r} has no translation to make relative", where=str(store.path))
        if name in scaled:
            raise clash(Relative(name), f"scaled {name}", "a scaler is fitted on absolute positions; give scale=None")
        columns[name] = store.fields[name].slice("translation")
    return columns


def scaler_of(store: Store, name: str, choice: WindowQuery, scale: Scale) -> Scaler:
    """Return the scaler of a field: the stored one, or one over the windows that the caller names.

    The protocol of `choice` defines the train split. Over "all" it is fitted on every row of every clip, from the
    trim on if windows are trimmed, as Lodge's released scaler was (test included).
    """
    if scale.over == "all":
        return _fit(store, name, _all_rows(store, name, choice.trim))
    train = _other_train(store, choice)
    if train is None:
        return store.scaler(name, scale.kind)
    if scale.kind != "minmax":
        why = "z-scores are those of the stored split train; fit others, Scaler('zscore', mean, std)"
        raise clash(scale, Select(protocol=choice.protocol), why)
    _log.warning(
        "the scaler of %s is that of the train split of protocol %s, not the stored one: save it with the model, "
        "reader.scaler(%r).save(FILE), and name it wherever columns are decoded or measured",
        name, choice.protocol, name,
    )  # fmt: skip
    return _fit(store, name, (store.read(window, name) for window in train))


def _other_train(store: Store, choice: WindowQuery) -> Sequence[Window] | None:
    """Return the stored train windows of a protocol, or None if they are of the same clips as the statistics."""
    if choice.protocol is None:
        return None
    windows = select(store, "train", replace(choice, windows={}, trim=False, filter=None, start_at=None)).windows
    if "train" in store.splits and {w.clip for w in windows} == {
        w.clip for w in store.windows("train", fields=choice.fields)
    }:
        return None
    return windows


def _all_rows(store: Store, name: str, trim: bool) -> Iterable[npt.NDArray[Any]]:
    for clip in (clip for clip in store if (name in clip)):
        first = store.grid.rows_down(clip.trim_start, of=store.field(name).grid) if trim else 0
        lead, rows = store[clip.id].rows_within(name)
        yield rows[max(0, first - lead) :]


def _fit(store: Store, name: str, pieces: Iterable[npt.NDArray[Any]]) -> Scaler:
    field = store.field(name)
    low, high = np.full(field.columns.width, np.inf), np.full(field.columns.width, -np.inf)
    for rows in pieces:
        if len(rows):
            low, high = np.minimum(low, rows.min(axis=0)), np.maximum(high, rows.max(axis=0))
    if not np.isfinite(low).all():
        raise UsageError("there are no rows to fit a scaler on", fix="give scale=None")
    stored = store.scaler(name).sha256 if name in store.stats["fields"] else ""
    return Scaler("minmax", low, high, dtype=field.dtype, field=name, columns=field.columns.labels, dataset=stored)
