"""SampleLog: what a validation generated, as numbers for a logger and a page."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from dancedata.core.arguments import as_numpy
from dancedata.core.errors import DanceDataError, UsageError
from dancedata.core.text import counted
from dancedata.files import atomic
from dancedata.files.atomic import require_free
from dancedata.training.sample_page import Generated, sample_page

if TYPE_CHECKING:
    from accelerate import Accelerator
    from torch import Tensor

#: Most samples of a page: it holds all their motion.
_MOST = 24
#: Before the names of the scores.
_PREFIX = "samples/"
#: In every page of the viewer.
_MARK = b'id="dd-data"'


@dataclass(frozen=True)
class Validation:
    """A finished validation.

    Attributes
    ----------
    step
        Step of the training.
    report
        That of `dancedata.Evaluator` of all samples; None where none could be measured.
    numbers
        Scores by name with the prefix, without those that mean nothing; the number of independent clips, and that of
        samples that were left out.
    page
        The page; None without one, and in all processes but the main one.
    """

    step: int
    report: Any
    numbers: Mapping[str, float] = field(default_factory=dict)
    page: Path | None = None


class SampleLog:
    """Collects the samples of a validation; at its end come the numbers of an `Evaluator`, and a page of samples.

    What a model generates does not end a training: samples that cannot be measured and pages that cannot be written
    are warnings. A batch that is not one of the dataset's is an error.

    Parameters
    ----------
    evaluator
        A `dancedata.Evaluator` of the dataset.
    folder
        Where the pages are written, step-00000400.html and so on; made if it is not there. None: no pages.
    wall
        Samples of a page: the first of the main process, so with an order that does not change always the same ones.

    Examples
    --------
    >>> from torch.utils.data import DataLoader
    >>> from dancedata import Evaluator
    >>> from dancedata.torch import WindowDataset
    >>> from dancedata.training import SampleLog
    >>> log = SampleLog(Evaluator("data/aistpp", "edge151", normalized=True), "runs/walls")
    >>> for batch in DataLoader(WindowDataset("data/aistpp", "val"), batch_size=4):
    ...     log.update(batch["edge151"], batch)  # samples of a model that has heard batch["librosa35"]
    >>> log.finish(step=400).page
    PosixPath('runs/walls/step-00000400.html')
    """

    def __init__(self, evaluator: Any, folder: str | Path | None = None, *, wall: int = 6) -> None:
        if not 1 <= wall <= _MOST:
            raise UsageError("invalid number of samples of a page", found=wall, allowed=f"1 to {_MOST}")
        self.evaluator, self.wall = evaluator, wall
        self.folder = None if folder is None else Path(folder).expanduser()
        self._samples: list[Generated] = []

    def reset(self) -> None:
        """Forget all samples."""
        self.evaluator.reset()
        self._samples = []

    def update(self, motion: npt.ArrayLike | Tensor, batch: Mapping[str, Any]) -> None:
        """Measure a batch of samples.

        Parameters
        ----------
        motion
            (B, L, D) columns, torch or numpy, on any device.
        batch
            The batch of a reader that they were generated for: it has the ids, and the lengths where it is padded.

        Raises
        ------
        UsageError
            As `Evaluator.update`; if the batch is not one of a reader.
        """
        if "id" not in batch:
            raise UsageError("this batch does not come from a reader of the dataset", found="no key 'id'",
                             allowed="batches of WindowDataset, or of ClipDataset with pad_clips")  # fmt: skip
        lengths = batch.get("lengths", {}).get(self.evaluator.field)
        columns = as_numpy(motion)
        self.evaluator.update(columns, batch["id"], lengths=lengths)
        for k, name in enumerate(batch["id"]):
            if self.folder is not None and len(self._samples) < self.wall:
                rows = columns[k] if lengths is None else columns[k, : int(lengths[k])]
                self._samples.append(Generated(self.evaluator.sample(name), rows.copy()))

    def finish(
        self,
        step: int,
        *,
        main: bool = True,
        accelerator: Accelerator | None = None,
    ) -> Validation:
        """Compute the scores of the samples of all processes, write the page, and forget the samples.

        Every process has to call it.

        `step`: Step of the training, in the name of the page.
        `main`: Whether this process writes the page.
        `accelerator`: Decides in place of `main`; its trackers get the numbers.
        """
        if accelerator is not None:
            main = accelerator.is_main_process
        self.evaluator.gather(repeated="first")
        done = Validation(step, *self._scores(), self._page(step) if main and self._samples else None)
        if accelerator is not None:
            accelerator.log(dict(done.numbers), step=step)
        self.reset()
        return done

    def _scores(self) -> tuple[Any, dict[str, float]]:
        if not len(self.evaluator):
            raise UsageError("there are no samples", fix="give the batches of the validation to update")
        try:
            report = self.evaluator.compute()
        except UsageError as error:
            warnings.warn(f"{error}", stacklevel=3)
            return None, {f"{_PREFIX}left_out": float(len(self.evaluator))}
        numbers = {_PREFIX + name: value for name, value in report.numbers().items()}
        return report, {**numbers, f"{_PREFIX}left_out": float(len(report.left_out))}

    def _page(self, step: int) -> Path | None:
        """Write the page of a step; one of the same step, of an interrupted training, is replaced."""
        evaluator, folder = self.evaluator, self.folder
        if folder is None:
            return None
        path = folder / f"step-{step:08d}.html"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            is_page = path.is_file() and _MARK in path.read_bytes()
            require_free(path, [evaluator.store.path], "page", overwrite=is_page)
            title = f"{counted(len(self._samples), 'sample')} at step {step}"
            page = sample_page(evaluator.store, evaluator.field, evaluator.reader, self._samples, title)
            atomic.write_bytes(path, page.encode())
        except (OSError, DanceDataError) as error:
            warnings.warn(f"{path}: the page of samples was not written: {error}", stacklevel=3)
            return None
        return path
