"""OpenAI's two files: their names, and the licence that is shown before anything is downloaded."""

from __future__ import annotations

VQVAE_FILE = "vqvae.pth.tar"
PRIOR_FILE = "prior_level_2.pth.tar"
#: Limit of JSON files beside the weights, which have some ten kilobytes.
MAX_JSON_BYTES = 1 << 20
LICENCE = (
    "The Jukebox weights are OpenAI's. They are published under OpenAI's Noncommercial Use License "
    "(https://github.com/openai/jukebox/blob/master/LICENSE): noncommercial use only, and anyone who passes "
    "them on must include that license. They are not part of dancedata, whose own licence does not cover them."
)
