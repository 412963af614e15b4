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
    fields, batch = _rows_and_rest(samples)
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
            raise UsageError(
                f"a clip does not fit into a batch of {length} rows",
                where=f"clip {samples[int(lengths[name].argmax())]['clip']}, field {name}",
                found=f"{longest} rows",
                fix="give a larger length, or read crops: ClipDataset(..., crop_frames=...)",
            )
        total = length if length is not None else -(-longest // multiple) * multiple
        default = 0.0 if isinstance(value, Mapping) else value
        filler = False if is_label else default if stated is None else stated
        padded = clips[0].new_full((len(clips), total, *clips[0].shape[1:]), filler)
        for row, clip in zip(padded, clips, strict=True):
            row[: len(clip)] = clip
        batch[name] = padded
        batch["mask"][name] = torch.arange(total) < lengths[name][:, None]
    return {**batch, "lengths": lengths}


def _rows_and_rest(samples: Sequence[dict[str, Any]]) -> tuple[dict[str, list[Tensor]], dict[str, Any]]:
    if not samples:
        raise UsageError("a batch without clips has no fields", fix="leave empty batches out")
    fields = [name for name, value in samples[0].items() if _is_rows(name, value)]
    rest = {name: collate_values([sample[name] for sample in samples]) for name in samples[0] if name not in fields}
    return {name: [sample[name] for sample in samples] for name in fields}, rest


def _is_rows(name: str, value: Any) -> bool:
    return isinstance(value, Tensor) and (value.dim() == 2 or name in LABELS)
