"""Runs units of work in this process, one after another."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from dancedata.execution.children import named_if_it_crashes
from dancedata.execution.executors.base import Call, Executor, OnResult, unit_name
from dancedata.execution.reference_process import ReferenceProcessError


@dataclass(frozen=True)
class InlineExecutor(Executor):
    """No worker processes: for one job, and where there is one unit to compute."""

    def run(self, function: Callable[..., Any], calls: Mapping[int, Call], label: str, on_result: OnResult) -> None:
        """See `Executor.run`. Where this process dies, another one prints which unit it was running."""
        for index, call in calls.items():
            with named_if_it_crashes(f"{label}, {unit_name(call)}"):
                try:
                    result = function(*call)
                except ReferenceProcessError as error:
                    error.where = unit_name(call)
                    raise
            on_result(index, result)
