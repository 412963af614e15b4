"""Rings of the house: which file knows which, and what the main road loads.

    python benchmarks/rings.py            # counts
    python benchmarks/rings.py --pairs    # and each pair of files that breaks the rings

The kernel imports itself, downwards; a shelf imports `core` and `files`, `scene` also the kernel and other shelves;
a satellite imports the kernel and shelves; the rooms at the top import all. A plug-in of `datasets`, `audio` or
`exports` is a satellite by itself, and what such a room has besides is a satellite that its plug-ins may import.
Imports in functions, for TYPE_CHECKING and by `import_module` of a literal name count. The road is what
`build aist++` and a batch of its windows load, in the process that builds.
"""

from __future__ import annotations

import argparse
import ast
import io
import os
import subprocess
import sys
import tempfile
import tokenize
from collections import Counter
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

ROOT = Path(__file__).parents[1]
#: Rooms of the kernel, from the lowest; rooms of one entry may import each other.
KERNEL = (("core",), ("files",), ("execution",), ("music",), ("store",),
          ("building", "recipes", "samples", "torch", "cache"), ("kernel",))  # fmt: skip
#: Rooms of the kernel that know nothing of datasets: shelves stand on them.
GROUND = {"core", "files"}
SHELVES = {"formats", "metrics", "scene", "synthetic"}
#: The shelf that reads datasets and motion files: it stands on the kernel and on the other shelves.
SCENE = "scene"
TOP = {"__init__", "__main__", "calls", "cli", "testing"}
#: Rooms whose files and folders are plug-ins.
PLUGINS = {"datasets", "audio", "exports"}
SOURCE = """
recipe: 1
name: corpus
dataset: {synthetic: {songs: 2, clips_per_song: 2, clip_s: 6, split: all}}
windows: {length_s: 5, stride_s: 0.5}
motion: {edge151: {}}
"""
ROAD = """
import sys, dancedata
from pathlib import Path
folder = Path(sys.argv[1])
options = {"jobs": 1, "cache": folder / "cache", "progress": False}
out = dancedata.build("aist++", folder / "source", folder / "out", **options).path
built = {name for name in sys.modules if name.split(".")[0] == "dancedata"}
from dancedata.torch import WindowDataset
WindowDataset(out).__getitems__([0, 1])
loaded = {name for name in sys.modules if name.split(".")[0] == "dancedata"}
for names in (built, loaded):
    print(*sorted({sys.modules[name].__file__ for name in names}))
"""


def module_files(package: Path) -> dict[str, Path]:
    """Return the files of a package by the names of their modules."""
    names = {path: path.relative_to(package.parent).with_suffix("").parts for path in sorted(package.rglob("*.py"))}
    return {".".join(p[:-1] if p[-1] == "__init__" else p): path for path, p in names.items()}


@cache
def _nodes(path: Path) -> list[ast.AST]:
    """Return the imports and calls of a file."""
    nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    return [node for node in nodes if isinstance(node, ast.ImportFrom | ast.Import | ast.Call)]


def imports(path: Path, modules: dict[str, Path]) -> dict[str, set[str]]:
    """Return the modules of the package that a file imports, with the names it takes from each."""
    taken: dict[str, set[str]] = {}
    for node in _nodes(path):
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                is_module = whole in modules
                taken.setdefault(whole if is_module else node.module or "", set()).add(
                    "" if is_module else alias.name
                )
        elif isinstance(node, ast.Import):
            for alias in node.names:
                taken.setdefault(alias.name, set()).add("")
        elif (
            isinstance(node, ast.Call) and getattr(node.func, "attr", getattr(node.func, "id", "")) == "import_module"
        ):
            for argument in node.args[:1]:
                if isinstance(argument, ast.Constant):
                    taken.setdefault(str(argument.value), set()).add("")
    return {module: names for module, names in taken.items() if module in modules}


def circles(arrows: dict[str, set[str]]) -> list[int]:
    """Return the sizes of the circles of imports."""
    number = {name: i for i, name in enumerate(arrows)}
    pairs = [(number[a], number[b]) for a, targets in arrows.items() for b in targets if a != b] or [(0, 0)]
    graph = coo_array(([1] * len(pairs), tuple(zip(*pairs, strict=True))), shape=(len(number), len(number)))
    labels = Counter(connected_components(graph, connection="strong")[1].tolist())
    return sorted(size for size in labels.values() if size > 1)


@dataclass(frozen=True)
class Place:
    """Where a module is: `satellite` is its room, or that of a plug-in by itself; `level` counts up in the kernel."""

    ring: str
    room: str
    satellite: str
    level: int = 0

    @classmethod
    def of(cls, module: str) -> Place:
        """Return the place of a module, "dancedata.core.text"."""
        parts = module.split(".")[1:] or ["__init__"]
        room = parts[0]
        for level, rooms in enumerate(KERNEL):
            if room in rooms:
                return cls("kernel", room, room, level)
        if room in SHELVES | TOP:
            return cls("shelf" if room in SHELVES else "top", room, room)
        return cls("satellite", room, ".".join(parts[:2]) if room in PLUGINS and len(parts) > 1 else room)

    def may_import(self, other: Place) -> bool:
        """Return whether a module here may import one there."""
        if self.room == other.room:
            kit = other.satellite == other.room or other.satellite.split(".")[1] in _kit(other.room)
            return self.satellite == other.satellite or kit or self.satellite.split(".")[-1] in _kit(self.room)
        if self.ring == "top":
            return True
        if self.ring == "kernel":
            return other.ring == "kernel" and other.level <= self.level
        if self.ring == "shelf" and self.room != SCENE:
            return other.room in GROUND
        return other.ring in ("kernel", "shelf")


@cache
def _kit(room: str) -> set[str]:
    """Return the files and folders of a room of plug-ins that register none."""
    package = ROOT / "dancedata" / room
    parts = {path.stem: [path] if path.is_file() else [*path.rglob("*.py")] for path in package.glob("[!.]*")}
    return {
        name
        for name, paths in parts.items()
        if not any(".register(" in path.read_text(encoding="utf-8") for path in paths if path.suffix == ".py")
    }


def breaks(package: Path = ROOT / "dancedata") -> dict[tuple[str, str], set[str]]:
    """Return the pairs of modules that break the rings, with the names that are imported."""
    modules = module_files(package)
    return {
        (name, target): names
        for name, path in modules.items()
        for target, names in imports(path, modules).items()
        if name != target and not Place.of(name).may_import(Place.of(target))
    }


def by_room(pairs: dict[tuple[str, str], set[str]]) -> dict[str, int]:
    """Return how many pairs break the rings, by their rooms: {"store -> remote": 4}."""
    counts = Counter(f"{Place.of(a).room} -> {Place.of(b).room}" for a, b in pairs)
    return dict(sorted(counts.items(), key=lambda pair: (-pair[1], pair[0])))


def upward(pairs: dict[tuple[str, str], set[str]]) -> int:
    """Return how many pairs of the kernel, and of what imports the top, point upwards."""
    places = [(Place.of(a), Place.of(b)) for a, b in pairs]
    return sum(b.ring == "top" or (a.ring == b.ring == "kernel" and b.level > a.level) for a, b in places)


def names_of_kernel() -> Counter[str]:
    """Return what satellites import of the kernel beside its public names, and how many files import each."""
    modules = module_files(ROOT / "dancedata")
    used: Counter[str] = Counter()
    for name, path in modules.items():
        if Place.of(name).ring == "satellite":
            for target, names in imports(path, modules).items():
                there = Place.of(target)
                if there.ring == "kernel" and there.room not in GROUND | {"kernel"}:
                    used.update(f"{target.removeprefix('dancedata.')}.{n}".rstrip(".") for n in names)
    return used


@dataclass
class Size:
    """Lines of code (without documentation, comments and imports), import lines, and public names at top level."""

    code: int = 0
    imports: int = 0
    names: int = 0

    def add(self, path: Path) -> None:
        """Count a file."""
        text = path.read_text(encoding="utf-8")
        tree, rows = ast.parse(text), text.splitlines()
        comments = (t for t in tokenize.generate_tokens(io.StringIO(text).readline) if t.type == tokenize.COMMENT)
        skipped = {t.start[0] for t in comments if rows[t.start[0] - 1].lstrip().startswith("#")}
        imported: set[int] = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                first = node.body[0] if node.body else None
                if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                    skipped |= set(range(first.lineno, (first.end_lineno or 0) + 1))
            elif isinstance(node, ast.Import | ast.ImportFrom):
                imported |= set(range(node.lineno, (node.end_lineno or 0) + 1))
        self.imports += len(imported)
        self.code += sum(bool(row.strip()) for i, row in enumerate(rows, 1) if i not in skipped | imported)
        for node in tree.body:
            if isinstance(node, ast.ClassDef | ast.FunctionDef):
                self.names += not node.name.startswith("_")
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                self.names += sum(isinstance(t, ast.Name) and not t.id.startswith("_") for t in targets)


def road() -> list[list[Path]]:
    """Return the files that a build of aist++ has loaded, and those after a batch of it too."""
    # Features that are exact run in a child then, as they do when Python is not started by the command line.
    chosen = ("OPENBLAS_", "NPY_", "GLIBC_")
    environment = {k: v for k, v in os.environ.items() if not k.startswith(chosen)} | {"PYTHONPATH": str(ROOT)}
    with tempfile.TemporaryDirectory(prefix="road-") as name:
        folder = Path(name)
        (folder / "corpus.yaml").write_text(SOURCE, encoding="utf-8")
        plan = [
            "-m",
            "dancedata",
            "build",
            "--dry-run",
            str(folder / "corpus.yaml"),
            str(folder / "source"),
            "--quiet",
        ]
        subprocess.run([sys.executable, *plan], check=True, capture_output=True, env=environment)
        done = subprocess.run(
            [sys.executable, "-c", ROAD, str(folder)], check=True, stdout=subprocess.PIPE, text=True, env=environment
        )
    return [[Path(path) for path in line.split()] for line in done.stdout.splitlines()[-2:]]


def lines(paths: list[Path]) -> int:
    """Return how many lines files have."""
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in paths)


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", action="store_true", help="print each pair of files that breaks the rings")
    chosen = parser.parse_args()
    package = ROOT / "dancedata"
    modules, pairs = module_files(package), breaks()
    if chosen.pairs:
        for (name, target), names in sorted(pairs.items()):
            print(f"{name} -> {target}: {', '.join(sorted(names))}")
    for rooms, number in by_room(pairs).items():
        print(f"{number:4} {rooms}")
    rings = Counter(f"{Place.of(a).ring} -> {Place.of(b).ring}" for a, b in pairs)
    print(f"pairs that break the rings: {len(pairs)} ({', '.join(f'{k} {n}' for k, n in rings.most_common())})")
    arrows = {name: set(imports(path, modules)) for name, path in modules.items()}
    print(f"circles: {circles(arrows) or 0}; upward arrows: {upward(pairs)}")
    kernel = [path for name, path in modules.items() if Place.of(name).ring == "kernel"]
    print(f"lines: {lines(list(modules.values())):,}, of the kernel {lines(kernel):,}")
    print(f"names of the kernel that satellites import beside `core`, `files` and `kernel`: {len(names_of_kernel())}")
    size = Size()
    for path in modules.values():
        size.add(path)
    print(f"import lines per 100 of code: {100 * size.imports / size.code:.1f}")
    print(f"public names per 1,000 lines of code: {1000 * size.names / size.code:.1f}, of {size.code:,}")
    for what, paths in zip(("build aist++", "with a batch"), road(), strict=True):
        print(f"road, {what}: {lines(paths):,} lines in {len(paths)} files")


if __name__ == "__main__":
    main()
