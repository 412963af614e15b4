"""Base of the engines that run units of work, and the engine without worker processes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dancedata.core.errors import DanceDataError
from dancedata.core.text import shown
from dancedata.execution.reference_process import ReferenceProcessError, named_if_it_crashes

#: Arguments of a unit of work.
Call = tuple[Any, ...]
#: Takes the number of a call and its result.
OnResult = Callable[[int, Any], None]


class WorkerDiedError(Exception):
    """A worker process died; calls without a result have to be run again.

    Attributes
    ----------
    suspects
        Numbers of the calls that were running and may have caused it.
    deaths
        How often that happened: engines may run a call again by themselves.
    """

    def __init__(self, problem: str, suspects: list[int], deaths: int = 1) -> None:
        super().__init__(problem)
        self.suspects, self.deaths = suspects, deaths


@dataclass(frozen=True)
class Executor(ABC):
    """Engine that runs units of work.

    Attributes
    ----------
    n
        Number of worker processes; a cluster has others.
    """

    n: int = 1

    @abstractmethod
    def run(self, function: Callable[..., Any], calls: Mapping[int, Call], label: str, on_result: OnResult) -> None:
        """Compute function(*call) for every call, and pass each result on as soon as it is complete, in any order.

        Parameters
        ----------
        calls
            Arguments by number.
        label
            Name of the stage, for messages.

        Raises
        ------
        WorkerDiedError
            If a worker process died. `run_units` decides what is run again.
        Exception
            The first exception that a call raises. Other calls are cancelled.
        """

    def for_calls(self, n_calls: int) -> Executor:
        """Return the executor to use for this number of calls."""
        return self


def first_line(error: BaseException) -> str:
    """Return the first line of an error's message."""
    return str(error).strip().split("\n")[0]


def not_sendable(label: str, found: str) -> DanceDataError:
    """Return the error for a unit or a result that another process cannot unpickle."""
    return DanceDataError(
        f"a unit of work or its result cannot be sent between processes during {label}",
        found=shown(found),
        fix="correct the plug-in: its module must import, and its errors must unpickle, in worker processes",
    )


def unit_name(call: Call) -> str:
    """Return the clip and the file that a unit of work reads, found among its arguments, for messages."""
    for argument in call:
        path = getattr(argument, "motion_path", None)
        if path is not None:
            return f"clip {argument.id} ({path})"
        path = argument if isinstance(argument, Path) else getattr(argument, "path", None)
        if isinstance(path, Path):
            return str(path)
    return "unit"


@dataclass(frozen=True)
class InlineExecutor(Executor):
    """No worker processes: for one job, and for a single unit."""

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
