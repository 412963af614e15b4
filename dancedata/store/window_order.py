"""The order of windows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from dancedata.store.schema import slice_name


def window_order(
    clip_ids: Sequence[str], clip: npt.NDArray[np.int64], index: npt.NDArray[np.int64], order: str
) -> npt.NDArray[np.int64]:
    """Return the positions that sort windows into the store's order.

    Parameters
    ----------
    clip_ids
        Ids by clip number.
    clip, index
        (W,) clip number of each window and its number in its clip; clip by clip, ascending.
    order
        "time" keeps their order. "name" is EDGE's: a plain string sort of ``<clip>_slice<k>``, so slice10 before
        slice2.

    Returns
    -------
    ndarray
        (W,) int64.
    """
    if order == "time":
        return np.arange(len(clip), dtype=np.int64)
    names = [slice_name(clip_ids[c], k) for c, k in zip(clip.tolist(), index.tolist(), strict=True)]
    return np.asarray(sorted(range(len(names)), key=names.__getitem__), dtype=np.int64)
