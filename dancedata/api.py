"""Old addresses of public functions. Deprecated since 0.2.0: import them from dancedata."""

import sys
from types import ModuleType

from dancedata.core.lazy import lazy_names

_HOMES = {
    "arrays": {"encode": "dancedata.pipeline.arrays", "extract": "dancedata.pipeline.arrays"},
    "commands": {
        **dict.fromkeys(
            ("BuildResult", "RecipeLike", "build", "build_part", "check", "plan"), "dancedata.pipeline.commands"
        ),
        "Overrides": "dancedata.recipes.parse",
    },
    "decoding": {"decode": "dancedata.pipeline.decoding", "decode_file": "dancedata.pipeline.decode_file"},
    "evaluation": {"evaluate": "dancedata.evaluation.run", "self_test": "dancedata.evaluation.run"},
    "export": {"export": "dancedata.exports.base.run"},
}


def _module(name: str) -> ModuleType:
    module = ModuleType(f"{__name__}.{name}", f"Old address of {', '.join(_HOMES[name])}.")
    sys.modules[module.__name__] = module  # `import dancedata.api.commands` takes it from here
    module.__getattr__, module.__dir__ = lazy_names(module.__name__, _HOMES[name])  # type: ignore[method-assign]
    return module


arrays, commands, decoding, evaluation, export = map(_module, _HOMES)
