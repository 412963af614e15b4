"""LightningSamples: a callback of lightning that generates samples when it validates, and logs them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from dancedata.core.errors import UsageError
from dancedata.core.packages import require
from dancedata.training.sample_log import SampleLog, Validation

require("lightning", what="LightningSamples")

import numpy as np  # noqa: E402 (an error with the command that installs the packages comes first)
import torch  # noqa: E402
from lightning.pytorch import Callback, LightningModule, Trainer  # noqa: E402

if TYPE_CHECKING:
    from torch import Tensor


class LightningSamples(Callback):
    """Generates motion for the batches of a validation, logs the scores with the module, and writes the page.

    The scores are logged at the end of the validation, for loggers and for ``ModelCheckpoint(monitor=...)``. The
    sanity check before the training generates samples too, so that a mistake ends it then, and logs nothing.

    Parameters
    ----------
    log
        Takes the samples.
    sample
        Generates motion (B, L, D) for a batch. Default: the method `sample` of the module.
    batches
        Batches of each validation and process that are sampled. Default: all.
    seed
        Seed of torch's generators while samples are drawn, with the number of the process and of the batch: each
        validation draws the same noise, and sampling does not change the random numbers of training.

    Attributes
    ----------
    last
        The latest validation with samples; None before.
    """

    def __init__(
        self,
        log: SampleLog,
        sample: Callable[[Any, Any], Tensor] | None = None,
        *,
        batches: int | None = None,
        seed: int = 0,
    ) -> None:
        for name, number, least in (("batches", batches, 1), ("seed", seed, 0)):
            if number is not None and number < least:
                raise UsageError(f"invalid value for {name}", found=number, allowed=f"{least} or more")
        self.sample_log, self.batches, self.seed = log, batches, seed
        self.last: Validation | None = None
        self._sample = sample

    def setup(self, trainer: Trainer, pl_module: LightningModule, stage: str) -> None:
        """Check that there is something that generates samples."""
        if self._sample is None and not callable(getattr(pl_module, "sample", None)):
            raise UsageError(
                f"{type(pl_module).__name__} has no method sample", allowed="sample(self, batch) -> (B, L, D)",
                fix="add it, or give a function: LightningSamples(log, sample=lambda module, batch: ...)",
            )  # fmt: skip

    def on_validation_epoch_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Forget samples of a validation that was interrupted."""
        self.sample_log.reset()

    def on_validation_batch_end(
        self,
        trainer: Trainer,
        pl_module: LightningModule,
        outputs: Any,
        batch: Any,
        batch_idx: int,
        dataloader_idx: int = 0,
    ) -> None:
        """Generate and measure samples; of the first loader, if there are several."""
        is_beyond = self.batches is not None and batch_idx >= self.batches
        if dataloader_idx or is_beyond:
            return
        with _seeded(self.seed, pl_module.device, trainer.global_rank, batch_idx):
            module: Any = pl_module
            motion = module.sample(batch) if self._sample is None else self._sample(module, batch)
        self.sample_log.update(motion, batch)

    def on_validation_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Log the scores, and write the page."""
        if trainer.sanity_checking:
            return
        self.last = self.sample_log.finish(trainer.global_step, main=trainer.is_global_zero)
        # Every process has the numbers of all; a mean of equal ones keeps Lightning from warning.
        pl_module.log_dict(dict(self.last.numbers), sync_dist=trainer.world_size > 1)


@contextmanager
def _seeded(seed: int, device: torch.device, rank: int, batch: int) -> Iterator[None]:
    """Draw from generators with a seed in the context, and leave those of the training as they were."""
    devices = [device] if device.type == "cuda" else []
    with torch.random.fork_rng(devices):
        torch.manual_seed(int(np.random.SeedSequence((seed, rank, batch)).generate_state(1)[0]))
        yield
