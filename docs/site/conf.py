"""Sphinx's settings for the site: the Markdown pages as they stand, and the reference from the docstrings.

build.py runs Sphinx with them. The folder that it reads is the root of the checkout, so that links between README,
CHANGELOG and docs/ are the same in the repository and on the site. docs/README.md is the navigation.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import hero
import navigation
import reference
import themed
from pygments.lexers.special import TextLexer

from dancedata.core.version import __version__

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]

project = "dancedata"
author = "the dancedata authors"
version = release = __version__
copyright = author
root_doc = "README"
include_patterns = [
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "SECURITY.md",
    "docs/**",
]
exclude_patterns = [".*", "docs/site", "docs/archive"]

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
copybutton_exclude = ".linenos, .gp, .go"
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
# Anchors as GitHub makes them: a link works in the repository and on the site, or the build fails.
myst_heading_anchors = 6

default_role = "py:obj"
suppress_warnings = ["ref.python"]  # an attribute in a docstring may be one of several classes
autodoc_default_options = {"members": True, "show-inheritance": True}
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 100
python_use_unqualified_type_names = True
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False

html_theme = "furo"
html_title = f"dancedata {__version__}"
html_additional_pages = {"index": "index.html"}
# furo's own sidebar, and the list of versions that build.py names.
html_sidebars = {
    "**": [
        "sidebar/brand.html",
        "sidebar/search.html",
        "versions.html",
        "sidebar/scroll-start.html",
        "sidebar/navigation.html",
        "sidebar/scroll-end.html",
    ]
}
html_copy_source = False
html_show_sphinx = False
templates_path = ["templates"]
html_static_path = ["static"]
html_css_files = ["site.css"]
html_js_files = [("enlarge.js", {"defer": "defer"})]
html_search_scorer = str(Path(__file__).parent / "static" / "scorer.js")


def setup(app: Sphinx) -> None:
    """Connect what the pages do not have in the repository: navigation and reference."""
    app.add_lexer("layers", TextLexer)
    app.connect("builder-inited", lambda _: reference.write_pages(ROOT))
    app.connect("source-read", lambda _, page, text: hero.add(page, text))
    app.connect("source-read", lambda _, page, text: navigation.add(ROOT, page, text))
    app.connect("doctree-read", themed.add, priority=400)  # before Sphinx collects the pictures
    app.connect("build-finished", lambda built, error: error or hero.write_clip(Path(built.outdir)))
