"""Engines of clusters: which one an address is of."""

from __future__ import annotations

import re
from abc import abstractmethod
from contextlib import AbstractContextManager
from typing import ClassVar

from dancedata.core.errors import UsageError
from dancedata.core.plugins import Plugin
from dancedata.core.registry import ENGINES
from dancedata.execution import arithmetic
from dancedata.execution.executors import Executor
from dancedata.execution.requirements import Requirements


class Engine(Plugin):
    """Runs units of work on the machines of a cluster.

    Attributes
    ----------
    example
        Address of a scheduler, for messages.
    address
        The form of its addresses.
    """

    #: A host in an address.
    HOST: ClassVar[str] = r"(\[[^\]\s]+\]|[^\s:/\[\]]+)"
    example: ClassVar[str]
    address: ClassVar[re.Pattern[str]]

    #: Environment variables of workers that compute as builds do; the instructions of builds, and of a process.
    variables = staticmethod(arithmetic.variables)
    expected = staticmethod(arithmetic.expected)
    here = staticmethod(arithmetic.here)

    @abstractmethod
    def connect(self, address: str, required: Requirements) -> AbstractContextManager[Executor]:
        """Yield the executor of a cluster; UsageError without its package, DanceDataError if none answers."""


def engine_at(backend: str | None, scheduler: str | None) -> Engine | None:
    """Return the engine of a scheduler's address; None for processes of this machine."""
    engines: dict[str, Engine] = {name: ENGINES.make(name, {}) for name in ENGINES.names()}
    if backend not in (None, "loky", *engines):
        raise UsageError("unknown backend", found=repr(backend), allowed=", ".join(("loky", *engines)))
    if scheduler is None:
        if backend in engines:
            raise UsageError(f"the backend {backend} needs a scheduler",
                             fix=f"give its address: --cluster {engines[backend].example}")  # fmt: skip
        return None
    engine = next((e for e in engines.values() if e.address.fullmatch(scheduler)), None)
    if engine is None:
        named = [e.example for name, e in engines.items() if scheduler.startswith(f"{name}:")]
        raise UsageError("not the address of a scheduler, or not a complete one", found=scheduler,
                         allowed="; ".join(named or [e.example for e in engines.values()]))  # fmt: skip
    if backend not in (None, engine.name):
        raise UsageError(
            f"the address is that of a {engine.name} scheduler", found=f"backend={backend!r}", fix="leave backend out"
        )
    return engine
