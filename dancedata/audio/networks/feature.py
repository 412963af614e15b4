"""NetworkFeature: the base class of audio features that run a network."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Hashable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import DataError, SourceError, UsageError
from dancedata.core.packages import require
from dancedata.core.plugins import AudioFeature
from dancedata.core.typing import override
from dancedata.files.regular_file import sha256_file

if TYPE_CHECKING:
    import torch

N = TypeVar("N")
Precision = Literal["auto", "fp32", "fp16", "bf16"]

#: Windows of a call on a card, which are published together.
_WINDOWS = 32
#: By feature, the network of this process, and what it was loaded from and how.
_networks: dict[str, tuple[Hashable, Any]] = {}


class NetworkFeature(AudioFeature):
    """Runs a network on a card or the CPU.

    A subclass has the fields `device`, `batch_size` if it computes in batches, and for the weights the field that
    `weights_key` names, with `<weights_key>_sha256`, the hash that identifies them: a build fills it in; if it is
    given, they must match.
    """

    exact: ClassVar[bool] = False
    uses_tempo: ClassVar[bool] = False
    weights_key: ClassVar[str] = "weights"

    device: str
    batch_size: int

    @abstractmethod
    def weights_path(self) -> Path:
        """Return the file or folder of the weights; UsageError or SourceError without one."""

    @abstractmethod
    def weights_hash(self, hash_file: Callable[[Path], str]) -> str:
        """Return the hash that identifies the weights."""

    @property
    @override
    def windows_per_call(self) -> int | None:
        return self.batch_size or (_WINDOWS if self.cards() else 1)

    @override
    def workers(self, jobs: int) -> int:
        """Return one process per card, or one on a CPU."""
        return max(1, len(self.cards()))

    def cards(self) -> list[str]:
        """Return the cards that `device` names: every one for "auto"; empty on a CPU."""
        if self.device != "auto":
            return [self.device] if self.device.startswith("cuda") else []
        require("torch", what="a network")
        import torch

        return [f"cuda:{k}" for k in range(torch.cuda.device_count())]

    def checked_device(self) -> torch.device:
        """Return the first device to compute on; UsageError if it does not exist."""
        from dancedata.audio.networks.devices import require_device

        return require_device((self.cards() or ["cpu" if self.device == "auto" else self.device])[0])

    def device_of_process(self) -> str:
        """Return the device that this process computes on: for "auto" an unused card, or else the CPU."""
        if self.device != "auto":
            return self.device
        from dancedata.audio.networks.devices import claimed

        return claimed(tuple(self.cards())) or "cpu"

    def all_cores(self) -> AbstractContextManager[Any]:
        """Use all cores on a CPU within the context: a build runs one process of such a feature there."""
        if self.cards():
            return nullcontext()
        from joblib import cpu_count
        from threadpoolctl import threadpool_limits

        # The cores that this process may use: a batch system assigns a part of the machine.
        limits: AbstractContextManager[Any] = threadpool_limits(limits=cpu_count())
        return limits

    def checked_hash(self, hash_file: Callable[[Path], str]) -> str:
        """Return the hash of the weights; UsageError if the recipe has another one."""
        sha256, allowed = self.weights_hash(hash_file), self._recipe_hash
        if allowed not in ("", sha256):
            raise UsageError(
                f"{self.name}: the weights do not match the recipe",
                where=self.weights_path(),
                found=sha256,
                allowed=allowed,
                fix=f"set {self.weights_key} to the weights that the recipe means, or omit {self.weights_key}_sha256",
            )
        return sha256

    def network(self, how: tuple[Hashable, ...], load: Callable[[], N]) -> N:
        """Return the network of this process, loaded once; the previous one is released first."""
        key = (self._recipe_hash, *how)
        if _networks.get(self.name, (None, None))[0] != key:
            _networks.pop(self.name, None)
            if self._recipe_hash and (sha256 := self.weights_hash(sha256_file)) != self._recipe_hash:
                problem = f"{self.name}: the weights have changed"
                raise SourceError(problem, where=self.weights_path(), found=sha256, allowed=self._recipe_hash)
            _networks[self.name] = key, load()
        network: N = _networks[self.name][1]
        return network

    def in_dtype(self, rows: npt.NDArray[np.float32], fix: str) -> npt.NDArray[Any]:
        """Return rows in the type that is stored; DataError "overflow" where it cannot hold them."""
        largest = float(np.abs(rows).max(initial=0))
        if not largest <= float(np.finfo(self.dtype).max):
            problem = f"{self.name}: an activation exceeds the range of {self.dtype}"
            raise DataError(problem, reason="overflow", found=largest, fix=fix)
        return rows.astype(self.dtype, copy=False)

    @property
    def _recipe_hash(self) -> str:
        sha256: str = getattr(self, f"{self.weights_key}_sha256")
        return sha256
