"""A learned sum of the layers of an encoder that a dataset stores side by side."""

import torch
from torch import Tensor, nn

from dancedata.core.columns import Columns
from dancedata.core.errors import UsageError


class LayerMix(nn.Module):
    """Learned weighted sum of stored layers: ``scale * sum_j softmax(w)_j * layer_j``.

    Equation 1 of Peters et al. 2018 (ELMo): softmax weights `w` over the layers and one scale, learned with the task.
    SUPERB (Yang et al. 2021, section 3) uses the same sum without scale. It begins as the mean of the layers. Store
    them with ``audio: {hf: {layers: all}}``.

    Parameters
    ----------
    columns
        Columns of the field, ``ds.field(NAME).columns``: the groups layer0, layer1, ... of equal width.
    scaled
        Whether the scale is learned, as in ELMo; without it, as in SUPERB, it is 1.
    normalize
        Normalise each layer of each row to mean 0 and variance 1 first (layer norm without parameters), for layers
        that differ in their size.

    Raises
    ------
    UsageError
        For columns that are not two or more layers of one width.

    Examples
    --------
    >>> import torch
    >>> from dancedata.core.columns import Columns, Group
    >>> from dancedata.readers import LayerMix
    >>> mix = LayerMix(Columns((Group("layer0", 2, "1"), Group("layer1", 2, "1"))))
    >>> mix(torch.tensor([[1.0, 2.0, 3.0, 6.0]])).tolist()
    [[2.0, 4.0]]
    """

    def __init__(self, columns: Columns, *, scaled: bool = True, normalize: bool = False) -> None:
        super().__init__()
        names, widths = [group.name for group in columns.groups], {group.width for group in columns.groups}
        if len(names) < 2 or len(widths) != 1 or not all(name.startswith("layer") for name in names):
            raise UsageError(
                "these columns are not several layers of an encoder",
                found=", ".join(f"{group.name} ({group.width})" for group in columns.groups),
                fix="build the field with several layers, such as audio: {hf: {layers: all}}",
            )
        self.layers, self.normalize = tuple(names), normalize
        self.weights = nn.Parameter(torch.zeros(len(names)))
        self.scale = nn.Parameter(torch.ones(())) if scaled else None

    def forward(self, rows: Tensor) -> Tensor:
        """Return (..., D) of rows (..., J * D), J layers side by side, as batches have them."""
        layers = rows.reshape(*rows.shape[:-1], len(self.layers), -1)
        if self.normalize:
            layers = nn.functional.layer_norm(layers, layers.shape[-1:])
        mixed = torch.einsum("j,...jd->...d", self.weights.softmax(0).to(layers.dtype), layers)
        return mixed if self.scale is None else mixed * self.scale.to(mixed.dtype)
