"""Run the tests of the feature hf, the conformance suite's too, with the oldest transformers that it supports.

    python tests/hf/with_transformers_4.py FOLDER [pytest's arguments]

transformers 4.57 needs an older huggingface-hub than the other tests run with. FOLDER gets the three distributions
that differ, and they are found before those of this environment, whose torch and numpy are used.
"""

import os
import subprocess
import sys
from pathlib import Path

DIFFERENT = ("transformers==4.57.6", "huggingface-hub==0.36.0", "tokenizers==0.22.1")
ROOT = Path(__file__).parents[2]


def main(folder: Path, arguments: list[str]) -> int:
    """Install the packages that differ, unless they are installed, and run pytest."""
    if not (folder / "transformers").exists():
        install = [
            sys.executable,
            "-m",
            "pip",
            "install",
            "--quiet",
            "--no-deps",
            "--target",
            str(folder),
            *DIFFERENT,
        ]
        subprocess.run(install, check=True)
    paths = [str(folder), str(ROOT), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in paths if path)}
    show = "import transformers, huggingface_hub; print(transformers.__version__, huggingface_hub.__version__)"
    subprocess.run([sys.executable, "-c", show], env=environment, check=True)
    tests = [
        str(ROOT / "tests" / "hf"),
        f"{ROOT / 'tests' / 'conformance' / 'test_conformance.py'}::test_plugin[audio feature-hf]",
    ]
    command = [sys.executable, "-m", "pytest", "-q", *tests, "-p", "no:cacheprovider", *arguments]
    return subprocess.run(command, env=environment, cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    sys.exit(main(Path(sys.argv[1]), sys.argv[2:]))
