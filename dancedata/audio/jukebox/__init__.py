"""Jukebox embeddings: an independent, memory-efficient implementation of inference with OpenAI's 5b model.

Dhariwal et al. 2020, "Jukebox: A Generative Model for Music"; EDGE (Tseng et al. 2023) uses the residual stream
after the 66th block of its top-level prior as music features. The weights are OpenAI's, under a Noncommercial Use
License, and no part of this package.

The feature is registered here; the other names are loaded when they are first used, so that importing this package
needs no torch.
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
else:  # type checkers take the imports above, and so find misspelt names
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "JukeboxConfig": f"{__name__}.config",
            "JukeboxEncoder": f"{__name__}.encoder",
            "JukeboxOverflowError": f"{__name__}.network.overflow",
            "checkpoint_sha256": f"{__name__}.conversion",
            "convert": f"{__name__}.conversion",
            "fetch": f"{__name__}.weights.download",
        },
    )
