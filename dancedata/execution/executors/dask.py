"""joblib's backend for Dask, made to hear of dead workers. Imported only where Dask is used."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from typing import Any

from distributed import KilledWorker
from distributed.comm.core import CommClosedError
from joblib._dask import DaskDistributedBackend

#: What says that a unit's workers died, one after another.
WORKER_DEATHS = (KilledWorker,)
#: What says that the scheduler is gone.
CLUSTER_LOST = (CancelledError, CommClosedError, TimeoutError)


class Backend(DaskDistributedBackend):
    """joblib's backend, which tells joblib of units that Dask gave up.

    Dask gives a unit up after its worker died four times, or when the scheduler is lost. joblib 1.6 hears of
    results only, also of exceptions that units raise, but not of these: it would wait for ever.
    """

    def effective_n_jobs(self, n_jobs: int) -> int:
        """Return the number of workers, 2 at least: with one, joblib would run units in this process instead."""
        return max(2, int(super().effective_n_jobs(n_jobs)))

    def submit(self, func: Any, callback: Callable[[Any], Any] | None = None) -> Any:
        """Submit a batch; `callback` is called with its result, or with the exception that Dask gave it up for."""
        future: Any = super().submit(func, callback)

        def tell(done: Future[Any]) -> None:
            error = done.exception()
            if error is not None and callback is not None:
                callback(error)

        future.add_done_callback(tell)
        return future

    def retrieve_result_callback(self, out: Any) -> Any:
        """Return a batch's results, or raise what it ended with."""
        if isinstance(out, BaseException):
            raise out
        return super().retrieve_result_callback(out)
