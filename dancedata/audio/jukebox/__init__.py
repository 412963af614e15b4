"""Jukebox embeddings: an independent, memory-efficient implementation of inference with OpenAI's 5b model.

Dhariwal et al. 2020, "Jukebox: A Generative Model for Music"; EDGE (Tseng et al. 2023) uses the residual stream
after the 66th block of its top-level prior as music features. The weights are OpenAI's, under a Noncommercial Use
License, and no part of this package.

The feature is registered here; the other names are imported on first use, so that importing this package does not
need torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.audio.jukebox.feature import Jukebox as Jukebox
from dancedata.core.lazy import lazy_names

if TYPE_CHECKING:
    from dancedata.audio.jukebox.config import JukeboxConfig as JukeboxConfig
    from dancedata.audio.jukebox.conversion import checkpoint_sha256 as checkpoint_sha256
    from dancedata.audio.jukebox.conversion import convert as convert
    from dancedata.audio.jukebox.encoder import JukeboxEncoder as JukeboxEncoder
    from dancedata.audio.jukebox.network.overflow import JukeboxOverflowError as JukeboxOverflowError
    from dancedata.audio.jukebox.weights.download import fetch as fetch

# None of these names is also the name of a module here: importing that module would replace the attribute.
__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "JukeboxConfig": "dancedata.audio.jukebox.config",
        "JukeboxEncoder": "dancedata.audio.jukebox.encoder",
        "JukeboxOverflowError": "dancedata.audio.jukebox.network.overflow",
        "checkpoint_sha256": "dancedata.audio.jukebox.conversion",
        "convert": "dancedata.audio.jukebox.conversion",
        "fetch": "dancedata.audio.jukebox.weights.download",
    },
)
