"""Lines of Python, words of documentation and circles of imports, commit by commit.

    python benchmarks/lines.py BASE [HEAD]

For each commit from BASE to HEAD, prints how many lines it added to and removed from the package, the tests and the
pages. For BASE and HEAD it then prints the lines of the package and of the tests, the words of docs/ and the largest
circle of imports (those in functions, for TYPE_CHECKING and by name count), and for the working tree how many modules
of the package a build of the demo loads, and how many more a first batch of it.
"""

from __future__ import annotations

import io
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

from rings import circles, imports, module_files

GROUPS = ("dancedata", "tests", "docs")
LOADED = """
import sys, tempfile, dancedata
from pathlib import Path
with tempfile.TemporaryDirectory() as folder:
    out = dancedata.build("demo", out=Path(folder) / "out", jobs=1, cache=Path(folder) / "cache", progress=False).path
    count = lambda: sum(name.split(".")[0] == "dancedata" for name in sys.modules)
    built = count()
    from dancedata.torch import WindowDataset
    WindowDataset(out)[0]
    print(built, count() - built)
"""


def git(*words: str) -> bytes:
    """Return what git prints."""
    return subprocess.run(["git", *words], check=True, stdout=subprocess.PIPE).stdout


def changes(commit: str) -> dict[str, list[int]]:
    """Return lines added and removed by a commit: Python of the package and of the tests, pages of the docs."""
    total = {group: [0, 0] for group in GROUPS}
    for line in git("show", "--numstat", "--format=", "--no-renames", commit).decode().splitlines():
        added, removed, name = line.split("\t")
        group = name.split("/")[0]
        if added != "-" and group in total and name.endswith(".md" if group == "docs" else ".py"):
            total[group][0] += int(added)
            total[group][1] += int(removed)
    return total


def largest_circle(package: Path) -> int:
    """Return how many modules the largest circle of imports has; 0 without a circle."""
    modules = module_files(package)
    return max(circles({name: set(imports(path, modules)) for name, path in modules.items()}), default=0)


def held(commit: str) -> str:
    """Return what the files of a commit hold."""
    with tempfile.TemporaryDirectory() as folder, tarfile.open(fileobj=io.BytesIO(git("archive", commit))) as archive:
        archive.extractall(folder, filter="data")
        root = Path(folder)
        python = {g: sum(len(f.read_bytes().splitlines()) for f in (root / g).rglob("*.py")) for g in GROUPS[:2]}
        words = sum(len(f.read_text(encoding="utf-8").split()) for f in (root / "docs").rglob("*.md"))
        circle = largest_circle(root / "dancedata")
    return f"package {python['dancedata']}, tests {python['tests']}, words of docs {words}, largest circle {circle}"


def main(base: str, head: str = "HEAD") -> None:
    """Print the table."""
    print("| commit | package | tests | docs | subject |\n|---|---|---|---|---|")
    for row in git("log", "--reverse", "--no-merges", "--format=%h\t%s", f"{base}..{head}").decode().splitlines():
        commit, subject = row.split("\t")
        cells = [f"+{added} -{removed}" for added, removed in changes(commit).values()]
        print(f"| {commit} | {' | '.join(cells)} | {subject} |", flush=True)
    for end in (base, head):
        print(f"{end}: {held(end)}")
    loaded = subprocess.run([sys.executable, "-c", LOADED], check=True, stdout=subprocess.PIPE, text=True).stdout
    print(f"modules loaded by a build, and by a first batch after it: {loaded.split()}")


if __name__ == "__main__":
    main(*sys.argv[1:])
