"""A dancer that moves on the site: a clip of the demo, exported while the site is built, inside two of its pages."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

import dancedata
from dancedata.viewer.view import ViewRequest, export_page

CLIP = "gPO_sFM_cAll_d10_mPO4_ch02"
#: Pages with the dancer, and what their picture of the viewer gives way to: the first image with its caption.
PAGES = {"README": "", "docs/guides/look": "../../"}
_IMAGE = re.compile(r"^!\[[^]]*\]\([^)]*viewer(?:-flags)?\.png\)\n(?:\n\*[^\n].*?\*\n)?", re.MULTILINE | re.DOTALL)
_FRAME = """```{{raw}} html
<iframe class="dancer" src="{up}clip.html#play=1&loop=0-270" title="A dancer of the demo, in the viewer"></iframe>
<p class="dancer-caption">A clip of the demo dataset (generated, CC0) in the viewer. Press M to mirror it, B for
another body, ? for all keys; a click turns the music on. <a href="{up}clip.html">In a page of its own</a></p>
```
"""
#: What the first screen of the site has below the dancer.
_START = """
[AIST++ to a table in ten minutes](docs/tutorials/aistpp-to-a-table.md) |
[Your own captures](docs/tutorials/captures.md) | [Run EDGE or Lodge](docs/tutorials/run-edge-or-lodge.md)
"""


def add(page: str, text: list[str]) -> None:
    """Put the dancer in the place of a page's first picture of the viewer; on the first page, with ways to begin."""
    if page not in PAGES:
        return
    frame = _FRAME.format(up=PAGES[page])
    frame += _START if page == "README" else ""
    text[0], replaced = _IMAGE.subn(lambda _: frame, text[0], count=1)
    if not replaced:
        raise ValueError(f"{page} has no picture of the viewer that the dancer takes the place of")


def write_clip(site: Path) -> None:
    """Build the demo and export one of its clips, with its music, to clip.html."""
    with tempfile.TemporaryDirectory() as folder:
        demo, source = Path(folder) / "demo", Path(folder) / "demo-source"
        dancedata.build("demo", out=demo, jobs=1, progress=False)
        export_page(ViewRequest(demo, clip=CLIP, music=source), site / "clip.html", overwrite=True)
