"""Jukebox embeddings: an independent, memory-efficient implementation of inference with OpenAI's 5b model.

Dhariwal et al. 2020, "Jukebox: A Generative Model for Music"; EDGE (Tseng et al. 2023) uses the residual stream
after the 66th block of its top-level prior as music features. The weights are OpenAI's, under a Noncommercial Use
License, and are not part of this package.

The feature is registered here; the other names are loaded on first use, so that importing this package does not need
torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.audio.jukebox.feature import Jukebox as Jukebox
from dancedata.core.lazy import lazy_names

if TYPE_CHECKING:
    from dancedata.audio.jukebox.config import JukeboxConfig as JukeboxConfig
    from dancedata.audio.jukebox.encoder import JukeboxEncoder as JukeboxEncoder
    from dancedata.audio.jukebox.encoder import JukeboxOverflowError as JukeboxOverflowError
    from dancedata.audio.jukebox.weights.download import fetch as fetch
    from dancedata.audio.jukebox.weights.folder import checkpoint_sha256 as checkpoint_sha256
else:  # type checkers take the imports above, and so find misspelt names
    # No name is that of a module: importing the module would replace it.
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "audio.jukebox.config": "JukeboxConfig",
            "audio.jukebox.encoder": "JukeboxEncoder JukeboxOverflowError",
            "audio.jukebox.weights.download": "fetch",
            "audio.jukebox.weights.folder": "checkpoint_sha256",
        },
        extra="jukebox",
    )
