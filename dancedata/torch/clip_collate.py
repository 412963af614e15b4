"""The collate function for clips of different lengths, which are padded to the longest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from dancedata.core.arguments import whole
from dancedata.core.errors import UsageError
from dancedata.torch.collate import collate_values
from dancedata.torch.music_beats import LABELS


def pad_clips(
    samples: Sequence[dict[str, Any]],
    *,
    multiple: int = 1,
    length: int | None = None,
    value: float | Mapping[str, float] = 0.0,
) -> dict[str, Any]:
    """Make a batch of clips, each filled up at its end to the length of the longest.

    For a DataLoader: ``collate_fn=pad_clips``, or ``partial(pad_clips, multiple=64)``.

    Parameters
    ----------
    samples
        Of a `ClipDataset`.
    multiple
        Rows are filled up to a multiple of this, so that compiled models see few shapes.
    length
        Rows of every field instead, for one shape; fields of other rates have the same number.
    value
        What they are filled with; by field, where some hold codes, as ``dataset.blanks`` has it.

    Returns
    -------
    dict
        A tensor (B, T, D) per field, (B, T) per label of beats; ``"mask"``, by field (B, T) bool, true where there is
        a row of the clip; ``"lengths"``, by field (B,) int64 rows; the other values as default_collate makes them.

    Raises
    ------
    UsageError
        If a clip has more rows than `length`, `multiple` is not above 0, there is no clip, or a field of codes has no
        value of its own.

    Examples
    --------
    >>> from dancedata.torch import ClipDataset, pad_clips
    >>> clips = ClipDataset("data/aistpp", "train", fields=["edge151"])
    >>> pad_clips([clips[0]], multiple=64)["edge151"].shape
    torch.Size([1, 192, 151])
    """
    whole("pad_clips: multiple", multiple, 1)
    if not samples:
        raise UsageError("a batch without clips has no fields", fix="leave empty batches out")
    named = {name: [sample[name] for sample in samples] for name in samples[0]}
    fields = {n: v for n, v in named.items() if isinstance(v[0], Tensor) and (v[0].dim() == 2 or n in LABELS)}
    batch: dict[str, Any] = {name: collate_values(v) for name, v in named.items() if name not in fields}
    lengths = {name: torch.tensor([len(rows) for rows in clips]) for name, clips in fields.items()}
    batch["mask"] = {}
    for name, clips in fields.items():
        longest = int(lengths[name].max())
        is_label = clips[0].dtype == torch.bool
        stated = value.get(name) if isinstance(value, Mapping) else None
        if stated is None and not is_label and not clips[0].is_floating_point():
            raise UsageError(f"nothing states what codes of {name} are filled up with: 0 is a code",
                             fix="give the pad of each field: pad_clips(samples, value=dataset.blanks)")  # fmt: skip
        if length is not None and longest > length:
            where = f"clip {samples[int(lengths[name].argmax())]['clip']}, field {name}"
            raise UsageError("a clip does not fit into a batch", where=where, found=f"{longest} rows", allowed=length,
                             fix="give a larger length, or read crops: windows=Windows(length=...)")  # fmt: skip
        total = length if length is not None else -(-longest // multiple) * multiple
        default = 0.0 if isinstance(value, Mapping) else value
        filler = False if is_label else default if stated is None else stated
        padded = clips[0].new_full((len(clips), total, *clips[0].shape[1:]), filler)
        for row, clip in zip(padded, clips, strict=True):
            row[: len(clip)] = clip
        batch[name] = padded
        batch["mask"][name] = torch.arange(total) < lengths[name][:, None]
    return {**batch, "lengths": lengths}
