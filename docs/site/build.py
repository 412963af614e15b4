"""Builds the site and checks what was written: python docs/site/build.py OUT.

With --version 0.3.0 --versions 0.3.0,0.2.0 each page has a list of versions, newest first; OUT then is the folder
0.3.0 beside 0.2.0, and pages of a version that is not the newest say so.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import notebooks
import written
from sphinx.cmd.build import build_main

from dancedata.core.version import __version__

SITE = Path(__file__).resolve().parent
ROOT = SITE.parents[1]
START = "README.html"


def version_options(version: str, versions: list[str]) -> list[str]:
    """Return Sphinx's options for a site of several versions; UsageError of argparse's kind as SystemExit."""
    if version != __version__:
        sys.exit(f"this checkout is version {__version__}, not {version}: build the site of a version from its tag")
    if not versions:
        return []
    if version not in versions:
        sys.exit(f"--versions {','.join(versions)} lacks {version}")
    options = ["-A", f"versions={','.join(versions)}"]
    if version != versions[0]:
        text = f"These are the pages of version {version}; the newest is {versions[0]}."
        options += ["-D", f"html_theme_options.announcement={text}"]
    return options


def main(out: Path, version: str = __version__, versions: tuple[str, ...] = ()) -> int:
    """Write the site into a folder; 1 after a warning of Sphinx, a dead link or anything from another host."""
    of_versions = version_options(version, list(versions))
    with tempfile.TemporaryDirectory() as doctrees:
        options = ["-W", "--keep-going", "-q", "-b", "html", "-d", doctrees, "-c", str(SITE)]
        if build_main([*options, *of_versions, str(ROOT), str(out)]):
            return 1
    notebooks.write(ROOT, out / "notebooks")
    # Sites of other versions are built from their own commits, and need not be there yet.
    others = frozenset(out.parent / other / START for other in versions)
    findings = written.findings(out, others)
    for finding in findings:
        print(finding, file=sys.stderr)
    pages = sum(1 for _ in out.rglob("*.html"))
    print(f"{out}: {pages} pages, {len(findings)} dead links or resources of other hosts")
    return 1 if findings else 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", metavar="OUT", type=Path)
    parser.add_argument("--version", default=__version__, help="of this checkout; another one is an error")
    parser.add_argument("--versions", default="", metavar="A,B", help="all versions of the site, newest first")
    options = parser.parse_args()
    sys.exit(main(options.out, options.version, tuple(filter(None, options.versions.split(",")))))
