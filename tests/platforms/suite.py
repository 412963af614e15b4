"""Runs the suite without calls of the system: whatever writes, locks, reads, starts processes or serves.

``python -m tests.platforms.suite MODE [pytest's arguments]`` with a mode (macos, windows), or calls with commas
between them. Tests that need a call themselves, such as a fork, are skipped, each with its reason (`NEEDS`).
"""

import os
import subprocess
import sys

from tests.conftest import ROOT

FOLDERS = (
    "files", "execution", "store", "frozen", "fault", "exports", "evaluation", "pipeline", "cli", "readers",
    "augment", "training", "curation", "remote", "report", "viewer",
)  # fmt: skip


def main() -> int:
    """Run pytest in the mode."""
    mode, *arguments = sys.argv[1:]
    chosen = [argument for argument in arguments if argument.startswith("tests")]
    # Browsers use no call of dancedata's.
    folders = [] if chosen else [*(f"tests/{folder}" for folder in FOLDERS), "--ignore-glob=*_browser.py"]
    environment = {
        **os.environ,
        "DANCEDATA_TEST_WITHOUT": mode,
        "PYTHONPATH": os.pathsep.join([str(ROOT / "tests" / "platforms" / "without"), str(ROOT)]),
    }
    command = [sys.executable, "-m", "pytest", "-q", *folders, *arguments]
    return subprocess.run(command, env=environment, check=False, cwd=ROOT).returncode


if __name__ == "__main__":
    raise SystemExit(main())
