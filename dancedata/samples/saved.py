"""Samples of a model as files that say what they are: for `evaluate`, `view`, `report` and `decode`."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from dancedata.core.arguments import as_numpy
from dancedata.core.errors import DataError, StoreError, UsageError
from dancedata.core.hashing import dataset_hashes
from dancedata.core.text import listed, quoted, shown
from dancedata.core.version import __version__
from dancedata.files import atomic
from dancedata.files.strict_json import read_json
from dancedata.samples import Samples
from dancedata.store.dataset import Store, open_store
from dancedata.store.normalize import Scaler

if TYPE_CHECKING:
    from torch import Tensor

#: What all samples of a folder have in common, and their scaler.
ABOUT, SCALER = "samples.json", "scaler.json"
_HASHES = ("self_sha256", "recipe_sha256", "source_sha256")
_MAX_BYTES = 1 << 20


@dataclass(frozen=True)
class SavedSamples:
    """What the file samples.json of a folder states."""

    folder: Path
    dataset: Path  # path of the dataset that the samples are of
    hashes: tuple[str, ...]  # of its dataset.json, its recipe and its source
    field: str  # motion field that the samples are of
    scaler: Path | None  # file of the scaler that normalises them; None if they are not normalised

    def like(self, store: Store | None = None) -> Store:
        """Return the dataset, or another copy of it; DataError "other_dataset" if it is another one."""
        store = open_store(self.dataset) if store is None else store
        (of_samples, *built_from), (of_store, *store_from) = self.hashes, _hashes(store).values()
        if of_samples == of_store or (
            all(built_from) and built_from == store_from
        ):  # built again, by another version of numpy
            return store
        raise DataError("these samples belong to another dataset", reason="other_dataset", where=str(self.folder),
                        found=f"{self.dataset.name} {of_samples[:12]}", allowed=f"{store.path.name} {of_store[:12]}",
                        fix="name the dataset of the training: like=; or delete samples.json",
                        options="name the dataset of the training: --like DATASET; or delete samples.json",
                        )  # fmt: skip

    def chosen_scaler(
        self, scaler: Scaler | str | Path | None, normalized: bool | None
    ) -> Scaler | str | Path | None:
        """Return the caller's scaler, else that of the samples unless the caller states that they have none."""
        return self.scaler if scaler is None and normalized is not False else scaler


def saved_samples(path: object) -> SavedSamples | None:
    """Return what a folder of samples, or that of a file of one, states; None if it states nothing."""
    if not isinstance(path, str | Path):
        return None
    folder = Path(path).expanduser()
    folder = folder if folder.is_dir() else folder.parent
    if not (folder / ABOUT).is_file():
        return None
    try:
        about = read_json(folder / ABOUT, _MAX_BYTES)
        dataset, field, is_normalized = about["dataset"], about["field"], about["normalized"]
        place, hashes = str(dataset["path"]), tuple(str(dataset[name]) for name in _HASHES)
        if not isinstance(field, str) or not isinstance(is_normalized, bool):
            raise TypeError("field or normalized")
    except (OSError, ValueError, LookupError, TypeError, UsageError, DataError) as error:
        raise UsageError("this file does not say what the samples are", where=folder / ABOUT, found=shown(error),
                         fix="delete it, and state like= and field=",
                         options="delete it, and state --like and --field") from error  # fmt: skip
    scaler = folder / SCALER if is_normalized else None
    if scaler is not None and Scaler.load(scaler).sha256 != about.get("scaler_sha256"):
        raise UsageError("the scaler is not that of the samples", where=scaler,
                         found=f"another hash than in {ABOUT}", fix="save the samples again")  # fmt: skip
    return SavedSamples(folder, folder / place, hashes, field, scaler)


def save_samples(
    store: Store,
    folder: str | Path,
    ids: Sequence[str],
    samples: npt.ArrayLike | Tensor,
    *,
    field: str,
    scaler: Scaler | None,
    overwrite: bool = False,
) -> list[Path]:
    """Write each sample of a batch (B, L, D) to ``ID.npz``, and what they are to samples.json."""
    if isinstance(ids, str):
        raise UsageError("one id is given for a batch", found=shown(ids), allowed='a list of ids, as batch["id"] is',
                         fix=f"give [{ids!r}], and samples (1, L, D)")  # fmt: skip
    path, batch, of = Path(folder).expanduser(), as_numpy(samples), store.field(field)
    if batch.ndim != 3 or len(batch) != len(ids) or batch.shape[2] != of.columns.width:
        raise UsageError("these are not samples of the field", found=f"shape {batch.shape}, {len(ids)} ids",
                         allowed=f"(B, L, {of.columns.width}) and B ids")  # fmt: skip
    finder, files = Samples(store), {}
    about = _about(store, path, field, scaler)
    for name, rows in zip(map(str, ids), batch, strict=True):
        sample = finder.require(name)
        n = store.grid.rows_up(sample.length, of=of.grid)
        if n > len(rows):
            raise DataError("the sample is shorter than its id states", reason="wrong_length", where=name,
                            found=f"{len(rows)} rows", allowed=f"{n} rows")  # fmt: skip
        if not np.isfinite(rows[:n]).all():
            raise DataError("the sample is not finite", reason="nan", where=name, found="nan or inf",
                            fix="look at the model, or leave it out")  # fmt: skip
        if path / f"{sample.id}.npz" in files:
            raise DataError("two samples have the same id", reason="two_samples", where=name,
                            fix=f"number them: {sample.id}~s1")  # fmt: skip
        files[path / f"{sample.id}.npz"] = {
            "samples": rows[:n], "id": str(sample.id), "field": field, "fps": str(of.grid),
            "normalized": scaler is not None, "scaler_sha256": "" if scaler is None else scaler.sha256,
        }  # fmt: skip
    _require_free(path, files, overwrite=overwrite)
    try:
        path.mkdir(parents=True, exist_ok=True)
        if not (path / ABOUT).exists():
            if scaler is not None:
                scaler.save(path / SCALER)
            atomic.write_json(path / ABOUT, about)
        for file, arrays in files.items():
            data = io.BytesIO()
            np.savez(data, allow_pickle=False, **arrays)
            atomic.write_bytes(file, data.getvalue())
    except OSError as error:
        raise StoreError("the samples cannot be written", where=path, found=str(error)) from error
    return list(files)


def _hashes(store: Store) -> dict[str, str]:
    """Return the hashes of the dataset, its recipe and its source; "" where one is not stated."""
    stated = dataset_hashes(store.info)
    return {name: stated.get(name, "") for name in _HASHES}


def _about(store: Store, path: Path, field: str, scaler: Scaler | None) -> dict[str, Any]:
    """Return the content of samples.json; UsageError if that of the folder is another."""
    place = os.path.relpath(store.path.absolute(), path.absolute())
    hashes = _hashes(store)
    about = {
        "dancedata": __version__, "dataset": {"name": store.info.get("name", ""), "path": place, **hashes},
        "field": field, "normalized": scaler is not None, "scaler_sha256": "" if scaler is None else scaler.sha256,
    }  # fmt: skip
    if (path / ABOUT).exists():
        stated = read_json(path / ABOUT, _MAX_BYTES)
        differ = [key for key in ("dataset", "field", "scaler_sha256") if stated.get(key) != about[key]]
        if differ:
            raise UsageError("the folder holds samples of another dataset, field or scaler", where=path / ABOUT,
                             found=listed(f"{key} {quoted(stated.get(key))}" for key in differ),
                             fix="choose another folder")  # fmt: skip
    return about


def _require_free(folder: Path, files: Sequence[Path] | dict[Path, Any], *, overwrite: bool) -> None:
    names = [file.name for file in files]
    there = {p.name for p in folder.iterdir()} if folder.is_dir() else set()
    lower: dict[str, str] = {name.lower(): name for name in there}
    for name in names:
        if lower.setdefault(name.lower(), name) != name:
            raise UsageError("two ids differ only in case, and would be the same file on some systems", where=folder,
                             found=listed([lower[name.lower()], name]), fix="use another folder")  # fmt: skip
    if existing := [name for name in names if name in there and not overwrite]:
        raise UsageError("samples are already there", where=folder, found=listed(existing),
                         fix="choose another folder, or overwrite=True")  # fmt: skip
