"""Learned music features of any native Hugging Face encoder: exact time stamps, checked weights, no remote code.

The feature is registered here; the other names are loaded on first use, so that importing this package needs neither
torch nor transformers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.audio.hf.feature import HuggingFace as HuggingFace
from dancedata.core.lazy import lazy_names

if TYPE_CHECKING:
    from dancedata.audio.hf.encoder import HuggingFaceEncoder as HuggingFaceEncoder
    from dancedata.audio.hf.model_folder import licence_of as licence_of
    from dancedata.audio.hf.model_folder import open_model as open_model
    from dancedata.audio.hf.settings import settings_of as settings_of
else:  # type checkers take the imports above, and so find misspelt names
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "audio.hf.encoder": "HuggingFaceEncoder",
            "audio.hf.model_folder": "licence_of open_model",
            "audio.hf.settings": "settings_of",
        },
        extra="hf",
    )
