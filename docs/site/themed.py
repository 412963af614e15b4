"""Pictures of the site that follow its theme: NAME.png where it is light, NAME-dark.png where it is dark."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from docutils import nodes

if TYPE_CHECKING:
    from sphinx.application import Sphinx


def add(app: Sphinx, doctree: nodes.document) -> None:
    """Put beside each picture that has a dark version that version; Furo's classes show one of them."""
    page = Path(app.srcdir) / app.env.docname
    for light in list(doctree.findall(nodes.image)):
        name = light["uri"].removesuffix(".png") + "-dark.png"
        if not (page.parent / name).is_file():
            continue
        dark = light.deepcopy()
        dark["uri"] = name
        light["classes"].append("only-light")
        dark["classes"].append("only-dark")
        light.parent.insert(light.parent.index(light) + 1, dark)
