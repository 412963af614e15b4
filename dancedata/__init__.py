"""dancedata: the data layer of music-to-dance generation.

Motion capture and music go in; what any trainer needs comes out, in one documented HDF5 dataset.

The names in `__all__` are the public list, modules among them. They are loaded when they are first used.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from dancedata.core.lazy import lazy_names
from dancedata.core.version import __version__

__all__ = [
    "AudioSignal",
    "Evaluator",
    "FeatureCache",
    "Motion",
    "Skeleton",
    "__version__",
    "align",
    "build",
    "cache",
    "check",
    "decode",
    "decode_file",
    "decode_group",
    "diff",
    "encode",
    "evaluate",
    "export",
    "extract",
    "keymotion",
    "load_plugins",
    "metrics",
    "open",
    "plan",
    "plot",
    "push",
    "quality",
    "readers",
    "report",
    "store",
    "synthetic",
    "training",
]

if TYPE_CHECKING:
    from dancedata import cache, keymotion, metrics, plot, readers, report, store, synthetic, training
    from dancedata.alignment.align import align
    from dancedata.building.arrays import encode, extract
    from dancedata.building.commands import build, check, plan
    from dancedata.cache import FeatureCache
    from dancedata.comparison import diff
    from dancedata.core.audio_signal import AudioSignal
    from dancedata.core.motion import Motion
    from dancedata.core.plugin_files import load_plugins
    from dancedata.core.skeleton import Skeleton
    from dancedata.curation.quality import quality
    from dancedata.decoding.decode import decode, decode_group
    from dancedata.decoding.files import decode_file
    from dancedata.evaluation.evaluator import Evaluator
    from dancedata.evaluation.run import evaluate
    from dancedata.exports.base.run import export
    from dancedata.remote.push import push
    from dancedata.store.dataset import open_store as open
else:  # type checkers take the imports above, and so find misspelt names
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "AudioSignal": "dancedata.core.audio_signal",
            "Evaluator": "dancedata.evaluation.evaluator",
            "FeatureCache": "dancedata.cache",
            "Motion": "dancedata.core.motion",
            "Skeleton": "dancedata.core.skeleton",
            "align": "dancedata.alignment.align",
            "build": "dancedata.building.commands",
            "check": "dancedata.building.commands",
            "decode": "dancedata.decoding.decode",
            "decode_file": "dancedata.decoding.files",
            "decode_group": "dancedata.decoding.decode",
            "diff": "dancedata.comparison",
            "encode": "dancedata.building.arrays",
            "evaluate": "dancedata.evaluation.run",
            "export": "dancedata.exports.base.run",
            "extract": "dancedata.building.arrays",
            "load_plugins": "dancedata.core.plugin_files",
            "open": "dancedata.store.dataset:open_store",
            "plan": "dancedata.building.commands",
            "push": "dancedata.remote.push",
            "quality": "dancedata.curation.quality",
        },
        modules=("cache", "keymotion", "metrics", "plot", "readers", "report", "store", "synthetic", "training"),
    )

#: What IPython shows as the viewer draws it.
_DRAWN = {
    "Motion": "dancedata.core.motion",
    "Store": "dancedata.store.dataset",
    "Clip": "dancedata.store.clip_view",
    "Clips": "dancedata.store.clip_view",
}


def load_ipython_extension(shell: Any) -> None:
    """Show datasets, clips and motions on the last line of a cell; importing dancedata in IPython calls this."""

    def draw(value: Any) -> str:
        from dancedata.viewer.notebook import html_of  # when the first is shown

        return html_of(value)

    for name, module in _DRAWN.items():
        shell.display_formatter.formatters["text/html"].for_type_by_name(module, name, draw)


if (_shell := getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()) is not None:
    load_ipython_extension(_shell)
