"""What users of the weights have to know; shown before anything is downloaded."""

from __future__ import annotations

LICENCE = (
    "The Jukebox weights are OpenAI's. They are published under OpenAI's Noncommercial Use License "
    "(https://github.com/openai/jukebox/blob/master/LICENSE): noncommercial use only, and whoever passes them on "
    "passes on that license with them. They are no part of dancedata, whose own licence does not cover them."
)
