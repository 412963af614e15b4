"""dancedata: the data layer of music-to-dance generation.

Motion capture and music go in; what any trainer needs comes out, in one documented HDF5 dataset.

The names in `__all__` are the public list, modules among them: what needs torch is in `dancedata.torch`. They are
loaded when they are first used.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from dancedata.core.lazy import lazy_names
from dancedata.core.version import __version__

__all__ = [
    "AudioSignal",
    "Clip",
    "DanceDataError",
    "Evaluator",
    "FeatureCache",
    "Motion",
    "SampleId",
    "Scaler",
    "Skeleton",
    "Store",
    "__version__",
    "build",
    "check",
    "decode",
    "encode",
    "evaluate",
    "export",
    "features",
    "load_plugins",
    "metrics",
    "open",
    "plot",
    "report",
    "torch",
    "view",
]

if TYPE_CHECKING:
    from dancedata import metrics, plot, torch
    from dancedata.building.arrays import encode
    from dancedata.building.check import check
    from dancedata.building.commands import build
    from dancedata.cache import FeatureCache
    from dancedata.calls import report, view
    from dancedata.core.audio_signal import AudioSignal
    from dancedata.core.errors import DanceDataError
    from dancedata.core.motion import Motion
    from dancedata.core.plugin_files import load_plugins
    from dancedata.core.sample_id import SampleId
    from dancedata.core.skeleton import Skeleton
    from dancedata.decoding.decode import decode
    from dancedata.evaluation.evaluator import Evaluator
    from dancedata.evaluation.run import evaluate
    from dancedata.exports.base.run import export
    from dancedata.songs import features
    from dancedata.store.clip_view import Clip
    from dancedata.store.dataset import Store
    from dancedata.store.dataset import open_store as open
    from dancedata.store.normalize import Scaler
else:  # type checkers take the imports above, and so find misspelt names
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "building.arrays": "encode",
            "building.check": "check",
            "building.commands": "build",
            "cache": "FeatureCache",
            "calls": "report view",
            "core.audio_signal": "AudioSignal",
            "core.errors": "DanceDataError",
            "core.motion": "Motion",
            "core.plugin_files": "load_plugins",
            "core.sample_id": "SampleId",
            "core.skeleton": "Skeleton",
            "decoding.decode": "decode",
            "evaluation.evaluator": "Evaluator",
            "evaluation.run": "evaluate",
            "exports.base.run": "export",
            "songs": "features",
            "store.clip_view": "Clip",
            "store.dataset": "Store open=open_store",
            "store.normalize": "Scaler",
        },
        modules=("metrics", "plot", "torch"),
    )

#: What IPython shows as the viewer draws it.
_DRAWN = {
    "Motion": "dancedata.core.motion",
    "Store": "dancedata.store.dataset",
    "Clip": "dancedata.store.clip_view",
    "Clips": "dancedata.store.clip_view",
    "Report": "dancedata.evaluation.report",
    "WindowDataset": "dancedata.torch.windows",
}


def load_ipython_extension(shell: Any) -> None:
    """Show datasets, clips, motions and scores on the last line of a cell; `import dancedata` calls this."""

    def draw(value: Any) -> str:
        from dancedata.viewer.notebook import html_of  # when the first is shown

        return html_of(value)

    for name, module in _DRAWN.items():
        shell.display_formatter.formatters["text/html"].for_type_by_name(module, name, draw)


if (_shell := getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()) is not None:
    load_ipython_extension(_shell)
