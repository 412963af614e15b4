"""A built dataset as one page: numbers, figures, findings. All numbers are in its JSON as well."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.lazy import lazy_names

__all__ = ["Report", "write_report"]

if TYPE_CHECKING:
    from dancedata.pages.write import Report, write_report
else:
    __getattr__, __dir__ = lazy_names(__name__, {"pages.write": "Report write_report"})
