"""What a model's card says of its licence."""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

from dancedata.audio.hf.model_folder import provenance_of
from dancedata.core.regular_file import read_regular
from dancedata.core.text import shown

UNKNOWN = "unknown, see the model's page"
_MAX_CARD = 1 << 22
_MAX_LICENCE = 200
_KEY = re.compile(r"^(license|license_name|license_link):[ \t]*(.*)$", re.MULTILINE)


def licence_of(folder: Path) -> str:
    """Return the licence that the front matter of a folder's README.md states, or `hf fetch` noted, or UNKNOWN.

    ``license: other`` is replaced by ``license_name`` and ``license_link`` where the card has them.
    """
    text = ""
    with suppress(OSError):
        text = read_regular(folder / "README.md", _MAX_CARD).decode("utf-8", "replace")
    head = re.match(r"\A\ufeff?---[ \t]*\r?\n(.*?)\r?\n---", text, re.DOTALL)
    keys = {} if head is None else {key: value.strip().strip("'\"") for key, value in _KEY.findall(head.group(1))}
    licence = keys.get("license", "")
    if licence in ("", "other") and keys.get("license_name"):
        licence = " ".join(part for part in (keys["license_name"], keys.get("license_link", "")) if part)
    return shown(licence or provenance_of(folder).get("licence") or UNKNOWN, _MAX_LICENCE)
