"""Fuzzes one reader guided by coverage, with atheris: python benchmarks/fuzz/guided.py bvh -runs=100000

The options behind the target are libFuzzer's. Without atheris (pip install atheris) it only prints a note.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

try:
    import atheris
except ImportError:
    sys.exit("skipped: atheris is not installed (pip install atheris)")

sys.path[:0] = [str(Path(__file__).resolve().parents[k]) for k in (0, 2)]

with atheris.instrument_imports(include=["dancedata"]):
    from targets import TARGETS

    from dancedata.core.errors import DanceDataError


def main() -> None:
    """Begin from the valid files, then go where the readers' branches lead."""
    target = TARGETS[sys.argv[1]]
    folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
    (folder / "seeds").mkdir()
    with atheris.instrument_imports(include=["dancedata"]):
        for number, data in enumerate(target.seeds()):
            (folder / "seeds" / str(number)).write_bytes(data)
            (folder / target.file).write_bytes(data)
            target.read(folder / target.file) if number == 0 else None

    def one(data: bytes) -> None:
        (folder / target.file).write_bytes(data)
        try:
            target.read(folder / target.file)
        except DanceDataError:
            return

    os.chdir(folder)
    atheris.Setup([sys.argv[0], *sys.argv[2:], str(folder / "seeds")], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
