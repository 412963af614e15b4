"""What a call is to be like: a dataset, or a reader of it, whose scaler and choice of normalising count."""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.kernel import Scaler, Store, TrainingData, open_store
from dancedata.scene.scaling import Scaling
from dancedata.store.normalize import scaler_from

#: An open dataset, or a reader of it.
Like = Store | TrainingData
#: What samples are like: a dataset, open or not, or a reader of it.
DatasetLike: TypeAlias = Like | str | Path | None
#: A scaler, or its file.
ScalerLike: TypeAlias = Scaler | str | Path | None


def opened(like: Like | str | Path) -> Like:
    """Return a dataset or reader, opened if it is a path."""
    if isinstance(like, str | Path):
        return open_store(Path(like).expanduser())
    if not hasattr(like, "scaler"):
        raise UsageError("like is neither a dataset nor a reader", found=type(like).__name__,
                         fix="give the WindowDataset or ClipDataset that it holds")  # fmt: skip
    return like


def store_of(like: Like) -> Store:
    """Return the dataset, or that of a reader."""
    return like if isinstance(like, Store) else like.store


def scaling_of(
    like: Like | None,
    field: str,
    columns: tuple[str, ...],
    *,
    normalized: bool | None = None,
    scaler: Scaler | str | Path | TrainingData | None = None,
    clamp: bool = False,
) -> Scaling:
    """Return the scaling of a field that a caller states."""
    store = None if like is None else store_of(like)
    if scaler is not None:
        if normalized is False:
            raise UsageError("a scaler is given for columns that are not normalised",
                             fix="leave out the one that is wrong")  # fmt: skip
        read = scaler_from(scaler, field)
        stored = None if store is None else _stored(store, field)
        dataset = "" if stored is None else stored.sha256
        return Scaling(read.require(field=field, columns=columns, dataset=dataset), True, clamp)
    if like is None or store is None:
        if normalized:
            raise UsageError("normalised columns need the scaler of a dataset", fix="name it: like= or scaler=",
                             options="name it: --like DATASET or --scaler FILE")  # fmt: skip
        return Scaling(None, False)
    if field not in store.fields:
        raise UsageError(f"no field named {field!r}", where=store.path, fix=did_you_mean(field, store.fields))
    if not isinstance(like, Store) and field in like.fields:
        normalized = field in like.normalized if normalized is None else normalized
        if normalized or field in like.normalized:
            return Scaling(like.scaler(field), normalized, clamp)
    stored_scaler = store.scaler(field) if normalized else _stored(store, field)
    return Scaling(stored_scaler, False if stored_scaler is None else normalized, clamp)


def _stored(store: Store, field: str) -> Scaler | None:
    if field not in store.fields or store.field(field).codebook is not None or field not in store.stats["fields"]:
        return None
    return store.scaler(field)
