"""The reference: a page for each public module, from the docstrings, and one that lists them."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path

#: The public modules; others are internal and may change.
MODULES = (
    "dancedata", "dancedata.comparison", "dancedata.cache", "dancedata.store", "dancedata.pages", "dancedata.plot",
    "dancedata.audio.jukebox", "dancedata.torch", "dancedata.torch.kinematics", "dancedata.training",
    "dancedata.core.motion", "dancedata.core.skeleton", "dancedata.core.bodies", "dancedata.core.audio_signal",
    "dancedata.core.grid", "dancedata.core.columns", "dancedata.core.rotations", "dancedata.store.normalize",
    "dancedata.core.errors", "dancedata.keymotion", "dancedata.metrics", "dancedata.metrics.beats",
    "dancedata.metrics.geometric_features", "dancedata.metrics.kinetic_features",
    "dancedata.metrics.physical_contact", "dancedata.synthetic", "dancedata.formats.bvh.write",
    "dancedata.core.plugins", "dancedata.core.registry", "dancedata.core.clip", "dancedata.core.segments",
    "dancedata.core.dance", "dancedata.core.draw", "dancedata.core.placement",
    "dancedata.evaluation.protocol", "dancedata.exports.base.job", "dancedata.exports.base.needs",
    "dancedata.files.atomic_folder", "dancedata.testing.conformance", "dancedata.testing.examples",
    "dancedata.testing.stores",
)  # fmt: skip
#: Output folder of the pages; git ignores it.
PAGES = Path("docs/api")


_INDEX = """Python
======

Each public module has a page made from its docstrings: shapes, units, axes, errors, sources and examples. In a
session, ``help(dancedata.build)`` prints them. A module without a page is internal and may change.

.. toctree::

"""


def elsewhere(name: str, listed: Sequence[str]) -> dict[str, str]:
    """Return the public names of a module that have their entry in another listed one, and its name.

    That is the module that defines a name, else, for `dancedata`, another one that offers it.
    """
    module = importlib.import_module(name)
    others = [other for other in listed if other not in (name, "dancedata")]
    homes = {}
    for public in getattr(module, "__all__", ()):
        value = getattr(module, public)
        home = getattr(value, "__module__", name)
        if home not in listed and name == "dancedata":
            offered = (other for other in others if getattr(importlib.import_module(other), public, None) is value)
            home = next(offered, name)
        homes[public] = home
    return {public: home for public, home in homes.items() if home != name and home in listed}


def _head(name: str) -> str:
    return f"{name}\n{'=' * len(name)}\n\n.. automodule:: {name}"


def page(name: str, listed: Sequence[str]) -> str:
    """Return the page of a module. A name has one entry, in the module that defines it."""
    others = elsewhere(name, listed)
    lines = [_head(name)]
    lines += [f"   :exclude-members: {', '.join(others)}"] if others else []
    lines += ["", *([".. rubric:: Names from other modules", ""] if others else [])]
    lines += [f"- :py:obj:`{public} <{home}.{public}>`" for public, home in others.items()]
    return "\n".join([*lines, ""])


def write_pages(root: Path, listed: Sequence[str] = MODULES) -> None:
    """Write the page of every module, where it changed, and remove those of modules that are no longer listed."""
    (root / PAGES).mkdir(exist_ok=True)
    pages = {root / PAGES / f"{name}.rst": page(name, listed) for name in listed}
    for path in set((root / PAGES).glob("*.rst")) - pages.keys():
        if path.read_text(encoding="utf-8").startswith(_head(path.stem)):  # else others wrote it
            path.unlink()
    pages[root / PAGES / "index.rst"] = _INDEX + "".join(f"   {name}\n" for name in listed)
    for path, text in pages.items():
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
