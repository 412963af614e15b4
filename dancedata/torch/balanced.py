"""BalancedSampler: as many samples of every genre, dancer or song."""

from collections.abc import Hashable, Sequence, Sized

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.hashing import sha256_bytes
from dancedata.core.text import shown
from dancedata.core.typing import override
from dancedata.torch.sampler import EpochSampler, permutation
from dancedata.torch.split_dataset import SplitDataset

#: Labels by which samples can be balanced.
LABELS = ("genre", "dancer", "music", "clip")
#: Apart from the stream of orders, which shuffles the drawn samples.
_GROUP_STREAM = 6


class BalancedSampler(EpochSampler):
    """Indices of which every group has equally many, one epoch after another; resumable as an `EpochSampler`.

    ``BalancedSampler(train, by="genre", seed=0)`` draws ``len(train)`` indices in each epoch, the same number of each
    genre; if the division leaves a remainder, some have one more, others in each epoch. Within a group the counts of
    the samples differ by one at most: a small group is repeated, of a large one each epoch draws another part. The
    order is a pure function of (labels, seed, epoch, rank, world size).

    Attributes
    ----------
    groups
        The labels, sorted; how many samples each has is ``counts``.
    """

    def __init__(
        self,
        data_source: SplitDataset,
        *,
        by: str | Sequence[Hashable] = "genre",
        seed: int = 0,
        rank: int | None = None,
        world_size: int | None = None,
        drop_last: bool = False,
    ) -> None:
        """Make the sampler at position 0 of epoch 0.

        Parameters
        ----------
        data_source
            A dataset of windows or clips.
        by
            "genre", "dancer", "music" (the song), "clip"; or a label for each sample.
        seed, rank, world_size, drop_last
            As for an `EpochSampler`.

        Raises
        ------
        UsageError
            For an unknown label, another number of labels than of samples, or clips without this label.
        """
        labels = _labels(data_source, by)
        names, group = np.unique(np.array([str(label) for label in labels]), return_inverse=True)
        self.groups = tuple(names.tolist())
        self._members = [np.flatnonzero(group == number) for number in range(len(names))]
        self.counts = tuple(len(members) for members in self._members)
        super().__init__(len(labels), seed=seed, rank=rank, world_size=world_size, drop_last=drop_last)
        self._source, self._groups = data_source, sha256_bytes(group.astype(np.int64).data)

    @override
    def order_of_all(self, epoch: int) -> npt.NDArray[np.int64]:
        share, remainder = divmod(self.n_samples, len(self._members))
        larger = set(permutation(len(self._members), self.seed, _GROUP_STREAM, epoch)[:remainder].tolist())
        by_group = [self._drawn(number, epoch, share + (number in larger)) for number in range(len(self._members))]
        return np.concatenate(by_group)[super().order_of_all(epoch)]

    def _drawn(self, group: int, epoch: int, n: int) -> npt.NDArray[np.int64]:
        """Return n indices of a group: all of them, in new orders, as often as needed."""
        members = self._members[group]
        rounds = range(-(-n // len(members)))
        orders = [permutation(len(members), self.seed, _GROUP_STREAM, epoch, group, turn) for turn in rounds]
        return np.asarray(members[np.concatenate([*orders, np.empty(0, np.int64)])[:n]], dtype=np.int64)


def _labels(source: SplitDataset, by: str | Sequence[Hashable]) -> Sequence[Hashable]:
    if not hasattr(source, "windows"):
        raise UsageError("samples of this source cannot be balanced", found=type(source).__name__,
                         fix="give a dataset; the sources of a Mix have weights")  # fmt: skip
    windows = source.windows
    if not isinstance(by, str):
        if not isinstance(by, Sized) or len(by) != len(windows):
            raise UsageError("there is not one label for each sample", found=shown(by), allowed=len(windows))
        return by
    if by not in LABELS:
        raise UsageError(f"samples cannot be balanced by {by!r}", fix=did_you_mean(by, LABELS))
    used = np.unique(windows.clip)
    of_clip = {k: windows.clip_ids[k] for k in used.tolist()}
    if by != "clip":
        of_clip = {k: getattr(source.store[clip], by) for k, clip in of_clip.items()}
    unknown = [windows.clip_ids[k] for k, label in of_clip.items() if not label]
    if unknown:
        raise UsageError(f"samples cannot be balanced by {by}: clips do not have one", where=f"clip {unknown[0]}",
                         found=f"{len(unknown)} of {len(of_clip)} clips without a {by}",
                         fix="give by= a label for each sample instead")  # fmt: skip
    return [of_clip[k] for k in windows.clip.tolist()]
