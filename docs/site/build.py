"""Builds the site and checks what was written: python docs/site/build.py OUT."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import notebooks
import written
from sphinx.cmd.build import build_main

SITE = Path(__file__).resolve().parent
ROOT = SITE.parents[1]


def main(out: Path) -> int:
    """Write the site into a folder; 1 after a warning of Sphinx, a dead link or anything from another host."""
    with tempfile.TemporaryDirectory() as doctrees:
        options = ["-W", "--keep-going", "-q", "-b", "html", "-d", doctrees, "-c", str(SITE)]
        if build_main([*options, str(ROOT), str(out)]):
            return 1
    notebooks.write(ROOT, out / "notebooks")
    findings = written.findings(out)
    for finding in findings:
        print(finding, file=sys.stderr)
    pages = sum(1 for _ in out.rglob("*.html"))
    print(f"{out}: {pages} pages, {len(findings)} dead links or resources of other hosts")
    return 1 if findings else 0


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python docs/site/build.py OUT")
    sys.exit(main(Path(sys.argv[1])))
