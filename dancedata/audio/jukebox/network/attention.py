"""Factored attention of the 5b prior: three patterns over a sequence that is arranged in rows.

Sparse Transformer (Child et al. 2019) as Jukebox uses it: with rows of 64 codes, every third block attends within
the row, within the column, or to the previous row. The sequence is padded to full rows at its end; by causality, the
padding has no effect.
"""

from __future__ import annotations

import torch
from torch.nn.functional import scaled_dot_product_attention

ROW, COLUMN, PREVIOUS_ROW = range(3)


def factored_attention(qkv: torch.Tensor, kind: int, *, n_clips: int, heads: int, row_length: int) -> torch.Tensor:
    """Attend within the row, within the column, or to the previous row.

    Parameters
    ----------
    qkv
        (n_clips * L, 3 S): queries, keys and values of sequences of L codes, L a multiple of the row length.
    kind
        `ROW`, `COLUMN` or `PREVIOUS_ROW`.
    heads
        Number of heads; head i has the i-th part of the S columns.
    row_length
        Codes per row.

    Returns
    -------
    torch.Tensor
        (n_clips * L, S), same type.
    """
    n_codes, width = qkv.shape[0], qkv.shape[1] // 3
    n_rows = n_codes // n_clips // row_length
    rows = qkv.view(n_clips * n_rows, row_length, 3, heads, width // heads)
    if kind == COLUMN:
        columns = rows.view(n_clips, n_rows, row_length, 3, heads, -1).permute(3, 0, 2, 4, 1, 5)
        q, k, v = columns.reshape(3, n_clips * row_length, heads, n_rows, -1)
        attended = _attend(q, k, v, causal=True).view(n_clips, row_length, heads, n_rows, -1)
        return attended.permute(0, 3, 1, 2, 4).reshape(n_codes, width)
    q, k, v = rows.permute(2, 0, 3, 1, 4)
    if kind == ROW:
        return _attend(q, k, v, causal=True).transpose(1, 2).reshape(n_codes, width)
    attended = qkv.new_zeros(n_clips * n_rows, row_length, heads, width // heads)
    if n_clips * n_rows > 1:
        attended[1:] = _attend(q[1:], k[:-1], v[:-1], causal=False).transpose(1, 2)
    # The first row of a clip has no previous row; above, it attended to the last row of another clip.
    attended[::n_rows] = 0
    return attended.view(n_codes, width)


def _attend(q: torch.Tensor, k: torch.Tensor, v: torch.Tensor, *, causal: bool) -> torch.Tensor:
    """Softmax(q k / sqrt(width)) v of (N, heads, length, width); the softmax in fp32.

    The kernels scale before or within the product of q and k, in fp32; the reference's order, product first, can
    overflow in fp16.
    """
    if q.device.type == "cpu" and q.dtype != torch.float32:
        return scaled_dot_product_attention(q.float(), k.float(), v.float(), is_causal=causal).to(q.dtype)
    return scaled_dot_product_attention(q, k, v, is_causal=causal)
