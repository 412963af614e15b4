"""A dataset as a README.md for a hub: pictures, terms, recipe."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.lazy import lazy_names

__all__ = ["write_card"]

if TYPE_CHECKING:
    from dancedata.card.write import write_card
else:
    __getattr__, __dir__ = lazy_names(__name__, {"write_card": "dancedata.card.write"})
