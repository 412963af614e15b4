"""Publishes datasets, or their recipes, on hubs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.lazy import lazy_names

__all__ = ["Pushed", "push"]

if TYPE_CHECKING:
    from dancedata.publish.run import Pushed, push
else:
    __getattr__, __dir__ = lazy_names(__name__, dict.fromkeys(("Pushed", "push"), "dancedata.publish.run"))
