"""Lodge: trimmed tracks, labels, its normaliser and its assets.yaml."""

from __future__ import annotations

import io
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from dancedata.core.packages import MissingPackageError, require
from dancedata.core.resources import manifest
from dancedata.core.text import listed
from dancedata.core.typing import override
from dancedata.exports._finedance import needs_tracks, note_missing
from dancedata.exports.base.job import EXPORTS, Export, ExportJob, Missing
from dancedata.exports.base.needs import needs_train

if TYPE_CHECKING:
    from dancedata.files.atomic_folder import AtomicFolder
    from dancedata.kernel import Clip


_MODULE = "dld.data.utils.preprocess"
_one_at_a_time = threading.Lock()


def normalizer_bytes(pieces: Iterable[npt.NDArray[np.float32]]) -> bytes:
    """Return torch's pickle of Lodge's ``Normalizer``, min-max to [-1, 1] in float32 over rows (T, D) of pieces."""
    import torch

    from dancedata.kernel import Scaler

    extremes = [(rows.min(axis=0), rows.max(axis=0), len(rows)) for rows in pieces if len(rows)]
    lows, highs, lengths = zip(*extremes, strict=True)
    low, high, n_rows = np.min(lows, axis=0), np.max(highs, axis=0), sum(lengths)
    spread = high - low
    scale = np.float32(2) / np.where(spread < np.float32(Scaler.CONSTANT_RANGE), np.float32(1), spread)
    arrays = {
        "scale_": scale,
        "min_": np.float32(-1) - low * scale,
        "data_min_": low,
        "data_max_": high,
        "data_range_": spread,
    }
    tensors = {name: torch.from_numpy(array.astype(np.float32)) for name, array in arrays.items()}
    buffer = io.BytesIO()
    with _lodge_classes() as (normalizer, scaler):
        fitted = scaler()
        fitted.__dict__.update(
            {"feature_range": (-1, 1), "copy": True, "clip": True, "n_samples_seen_": n_rows, **tensors}
        )
        whole = normalizer()
        whole.__dict__["scaler"] = fitted
        torch.save(whole, buffer)
    return buffer.getvalue()


@contextmanager
def _lodge_classes() -> Iterator[tuple[type[Any], type[Any]]]:
    """Yield two empty classes with the names of Lodge's, under the name of its module, which pickle looks up."""
    names = [".".join(_MODULE.split(".")[:n]) for n in range(1, _MODULE.count(".") + 2)]
    with _one_at_a_time:
        loaded = {name: sys.modules.get(name) for name in names}
        try:
            for name in names:
                sys.modules[name] = ModuleType(name)
            classes = [type(name, (), {"__module__": _MODULE}) for name in ("Normalizer", "MinMaxScaler")]
            for cls in classes:
                setattr(sys.modules[_MODULE], cls.__name__, cls)
            yield classes[0], classes[1]
        finally:
            for name, module in loaded.items():
                if module is None:
                    sys.modules.pop(name, None)
                else:
                    sys.modules[name] = module


#: Columns that Lodge trains on: all of lodge139, the first of lodge319.
_WIDTH = 139
_GUIDE = """## Train

In a checkout of Lodge (pytorch_lightning 1.9, numpy below 1.24), first the local stage, then the global one:

```sh
export TORCH_FORCE_NO_WEIGHTS_ONLY_LOAD=1  # torch 2.6 and later refuse a pickled normaliser, the published one too
python train.py --cfg configs/lodge/finedance_fea139.yaml --cfg_assets {out}/assets.yaml
python train.py --cfg configs/lodge/coarse_finedance_fea139.yaml --cfg_assets {out}/assets.yaml
```

- `assets.yaml` has absolute paths below `{out}`: export again, or change it, after moving the folder.
- dld/data/FineDance_Module.py, line 28, opens `/data2/lrh/project/dance/Lodge/lodge_pub/data/smplx_neu_J_1.npy`
  whatever the configuration says. The file lies in `data/` of the repository; link it to that place:

  ```sh
  mkdir -p /data2/lrh/project/dance/Lodge/lodge_pub && ln -s $PWD/data /data2/lrh/project/dance/Lodge/lodge_pub/data
  ```

- `TRAIN.PRETRAINED` of the second configuration names a checkpoint of its authors.
- Batches of 190 and 800 windows, the last one dropped: a small set gives no batch at all, and no error.
- Tracks begin where Lodge cuts them (ten ids), motion and music alike. Windows that stand still are left out by the
  loader itself, so all are here.
- `Normalizer.pth` covers {over}; {lodge}.
- The global stage finds its key motions in each batch, so there is no file of them.
"""


@EXPORTS.register("lodge")
@dataclass(frozen=True)
class Lodge(Export):
    """Lodge's mofea319, music_npynew, label_json, Normalizer.pth and assets.yaml (Li et al. 2024).

    Attributes
    ----------
    motion
        ``lodge139`` or ``lodge319``; the loader reads 139 columns of either.
    feature
        Audio feature of 35 columns.
    scaler
        ``all``: the normaliser covers all tracks, test included, as Lodge's does. ``train``: those of train.
    """

    recipe: ClassVar[Mapping[str, Any]] = {
        "dataset": {"finedance": {}},
        "motion": {"lodge139": {}},
        "audio": {"librosa35": {}},
    }
    reference: ClassVar[str] = "li-ronghui/LODGE, commit a898e59, dld/data/FineDance_dataset.py"
    guide_text: ClassVar[str] = _GUIDE
    listed_folders: ClassVar[tuple[str, ...]] = ("finedance/label_json", "finedance/mofea319")

    motion: Literal["lodge139", "lodge319"] = "lodge139"
    feature: str = "librosa35"
    scaler: Literal["all", "train"] = "all"

    @override
    def missing(self, job: ExportJob) -> list[Missing]:
        missing = needs_tracks(job, self.motion, self.feature)
        unknown = [clip.id for clip in job.clips() if clip.genre not in manifest("finedance")["genres"]]
        if unknown:
            fix = "dataset: {finedance: {labels: required}}, which leaves them out"
            missing.append(Missing(f"clips without one of the 16 genres: {listed(unknown)}", fix))
        missing += needs_train(job, self.scaler, "the normaliser")
        try:
            require("torch", what="Normalizer.pth")
        except MissingPackageError as error:
            missing.append(Missing(error.problem, str(error.fix)))
        return missing

    @override
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        for clip in job.each("tracks", job.clips()):
            folder.write_npy(f"finedance/mofea319/{clip.id}.npy", self._rows(clip, self.motion))
            folder.write_npy(f"finedance/music_npynew/{clip.id}.npy", self._rows(clip, self.feature))
            folder.write_json(f"finedance/label_json/{clip.id}.json", {"style2": clip.genre})
        folder.write_bytes("Normalizer.pth", normalizer_bytes(self._fitted(job)))
        folder.write_text("assets.yaml", _assets(folder))
        note_missing(job, folder, "Lodge's loader", "ignored")

    @override
    def guide_values(self, job: ExportJob) -> Mapping[str, object]:
        over = "the tracks of all splits, test included" if self.scaler == "all" else "the tracks of train"
        lodge = "as Lodge fits it" if self.scaler == "all" else "Lodge fits it on test as well (`--scaler all`)"
        return {"over": over, "lodge": lodge}

    def _fitted(self, job: ExportJob) -> Iterator[npt.NDArray[np.float32]]:
        for clip in job.clips(*(job.store.splits if self.scaler == "all" else ("train",))):
            yield self._rows(clip, self.motion)[:, :_WIDTH]

    @staticmethod
    def _rows(clip: Clip, field: str) -> npt.NDArray[np.float32]:
        """Return a clip's rows from the frame on at which Lodge cuts it."""
        return np.asarray(clip.read(field)[clip.trim_start :], np.float32)


def _assets(folder: AtomicFolder) -> str:
    """Return Lodge's configuration of paths; the paths of this export, which are absolute, quoted."""
    keys = {
        "ROOT": "finedance",
        "MOTION": "finedance/mofea319",
        "MUSIC": "finedance/music_npynew",
        "normalizer": "Normalizer.pth",
        "LABEL": "finedance/label_json",
    }
    paths = "".join(
        f"    {key}: '{str(folder.final / name).replace(chr(39), 2 * chr(39))}'\n" for key, name in keys.items()
    )
    return f"FOLDER: './experiments'\n\nTEST:\n  FOLDER: './experiments'\n\nDATASET:\n  FINEDANCE_139CUT:\n{paths}"
