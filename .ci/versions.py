#!/usr/bin/env python3
"""The package in fresh environments: Pythons, lowest and newest dependencies, extras one by one.

    .ci/versions.py                     # all of the matrix that this machine can make
    .ci/versions.py 3.11 lowest remote  # the rows whose name holds one of these words
    .ci/versions.py --torch --to FILE   # rows with torch too; the table goes to FILE as well, after every row

Each row is a new environment, a few commands in it, and a line of the table that is printed at the end: name, Python,
command, result, seconds. It needs Python 3.11 or later, git, uv (else it is installed for the run), and the network
for packages. Interpreters are those of PATH and pyenv, or PYTHON_3_14=/path/to/python. A row without one is "not
run", and so are rows that need torch, unless --torch: its wheels with CUDA are gigabytes. UV_FIND_LINKS=FOLDER
takes wheels of a folder, such as torch's for the CPU. What is tested is the last commit. A row that takes longer than
--limit is ended and has failed. Lines of an earlier FILE stay until their row is run again. The exit code is 1 if a
row that ran has failed.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import IO

ROOT = Path(__file__).resolve().parents[1]
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
TEST_TOOLS = ("pytest", "pytest-xdist", "hypothesis")
PYTEST = "python -m pytest -q -p no:cacheprovider -o filterwarnings=default"
#: The core of the suite: numbers, files, the store and its frozen datasets; no network, browser or torch.
CORE = f"{PYTEST} tests/core tests/contacts tests/frozen"
#: Packages whose versions are in the table: of a row without extras, else those of its extra.
CORE_PACKAGES = ("h5py", "librosa", "numba", "numpy", "pydantic", "scipy", "typer")
BUILD = "dancedata build demo --quiet && dancedata check data/demo && dancedata info"
#: What shows that an extra works, in an environment with nothing else.
HERE = "dancedata build demo --quiet"
EXTRAS = {
    "torch": f"{PYTEST} tests/readers/test_windows.py tests/frozen",
    "jukebox": f"{PYTEST} tests/jukebox/test_feature.py",
    "hf": f"{PYTEST} tests/hf",
    "beats": f"{PYTEST} tests/audio/test_beats.py",
    "smpl": f"{PYTEST} tests/formats/test_body_model.py tests/formats/test_body_mesh.py",
    "dask": f"{PYTEST} tests/fault/test_clusters.py -k the_same_bytes_and",
    "ray": f"{PYTEST} tests/fault/test_clusters.py -k the_same_bytes_and",
    "parquet": f"{HERE} && dancedata export data/demo --to parquet --out parquet && "
    "python -c 'import pyarrow.parquet as p; assert p.read_table(\"parquet/data\").num_rows == 756'",
    "lightning": f"{PYTEST} tests/training",
    "report": f"{HERE} && dancedata report data/demo --out report.html && test -s report.html && "
    f"{PYTEST} tests/plot/test_figures.py",
    "pandas": f"{HERE} && python -c 'import dancedata; assert len(dancedata.open(\"data/demo\").to_pandas()) == 42'",
    "video": f"{HERE} && dancedata view data/demo gBR_sBM_cAll_d04_mBR4_ch03 --out clip.mp4 && test -s clip.mp4",
    "remote": f"{PYTEST} tests/remote/test_push.py tests/remote/test_faults.py",
    "docs": "python docs/site/build.py site",
}

#: What tests of an extra need beside it: moto is the server of buckets.
TOOLS_OF = {"remote": ("moto[s3,server]>=5.2.5",)}


@dataclass(frozen=True)
class Row:
    """One environment: what is installed, with which arguments of ``uv pip install``, and what runs in it."""

    name: str
    python: str
    install: tuple[str, ...]
    command: str
    shows: tuple[str, ...] = CORE_PACKAGES
    torch: bool = False


def package(requirement: str) -> str:
    """Return the name of a requirement, as ``pip freeze`` does."""
    return re.split(r"[^\w.-]", requirement)[0].lower().replace("_", "-")


def rows() -> list[Row]:
    """Return the whole matrix."""
    tools = TEST_TOOLS
    pinned = ("-c", "constraints.txt")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    named = set(extras) - {"all", "dev"}
    if named != set(EXTRAS):
        sys.exit(f"extras of pyproject.toml without a command here, or the reverse: {sorted(named ^ set(EXTRAS))}")
    table = [Row(f"{p} pinned", p, (*pinned, "-e", ".", *tools), f"{CORE} && {BUILD}") for p in PYTHONS]
    table += [Row(f"{p} newest", p, ("-e", ".", *tools), f"{CORE} && {BUILD}") for p in PYTHONS]
    # The lowest versions that have wheels for the Python: those that are older than it cannot be built with it.
    needs = {name: tuple(map(package, extras[name])) for name in EXTRAS}
    names = sorted({*map(package, project["dependencies"]), *(name for of_one in needs.values() for name in of_one)})
    wheels = [word for name in names for word in ("--only-binary", name)]
    lowest = ("--resolution", "lowest-direct", *wheels, "-e")
    table += [
        Row(f"{p} lowest", p, (*lowest, ".", "pytest>=8.3", "hypothesis>=6.112"), f"{CORE} && {BUILD}")
        for p in PYTHONS
    ]
    with_torch = (*pinned, "-e", ".[torch]", *tools)
    table += [Row(f"{p} torch", p, with_torch, EXTRAS["torch"], ("torch",), torch=True) for p in PYTHONS[1:]]
    for name, command in EXTRAS.items():
        torch = bool({"torch", "smplx"} & set(needs[name]))
        more = TOOLS_OF.get(name, ())
        low = (*lowest, f".[{name}]", "pytest>=8.3", "hypothesis>=6.112", *more)
        for title, install in ((name, (*pinned, "-e", f".[{name}]", *tools, *more)), (f"{name} lowest", low)):
            table.append(Row(f"extra {title}", "3.11", install, command, needs[name], torch))
    table.append(Row("wheel alone", "3.11", (), "dancedata build demo && dancedata check data/demo"))
    return table


def interpreter(version: str) -> str | None:
    """Return the path of an interpreter of a version, None without one."""
    name = os.environ.get(f"PYTHON_{version.replace('.', '_')}")
    pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    named = [
        name,
        *map(str, sorted(pyenv.glob(f"{version}.*/bin/python"), reverse=True)),
        shutil.which(f"python{version}"),
    ]
    for path in filter(None, named):
        ask = [path, "-c", "import sys; print('.'.join(map(str, sys.version_info[:2])))"]
        answer = subprocess.run(ask, capture_output=True, text=True, check=False)
        if answer.returncode == 0 and answer.stdout.strip() == version:
            return path
    return None


def finishes(command: list[str] | str, folder: Path, settings: dict[str, str], log: IO[str], seconds: float) -> bool:
    """Return whether a command exits with 0 in so many seconds. Children that it left are ended."""
    with subprocess.Popen(
        command, shell=isinstance(command, str), cwd=folder, env=settings, stdin=subprocess.DEVNULL,
        stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
    ) as process:  # fmt: skip
        try:
            return process.wait(max(0, seconds)) == 0
        except subprocess.TimeoutExpired:
            return False
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def run(row: Row, work: Path, uv: str, say: bool, limit: float) -> tuple[str, float]:
    """Make the environment of a row, run its command, and return the result and the seconds of both.

    After ``limit`` seconds the command that runs is ended, and the row has failed. The result names the versions of
    what the row is for.
    """
    python, start = interpreter(row.python), time.monotonic()
    if python is None:
        return f"not run: no Python {row.python}", 0.0
    copy, env = work / "copy", work / "env"
    subprocess.run(["git", "clone", "-q", ROOT, copy], check=True)
    log = (work / "log").open("w+")

    def succeeds(command: list[str] | str, folder: Path = copy) -> bool:
        settings = os.environ | {
            "PATH": f"{env / 'bin'}{os.pathsep}{os.environ['PATH']}",
            "VIRTUAL_ENV": str(env),
            "DANCEDATA_CACHE": str(work / "cache"),
        }
        settings.pop("PYTHONPATH", None)
        return finishes(command, folder, settings, log, start + limit - time.monotonic())

    install: list[str] = [uv, "pip", "install", "--python", str(env / "bin" / "python"), *row.install]
    if not succeeds([uv, "venv", "-q", "--python", python, str(env)], work):
        result = "failed to make the environment"
    elif not row.install:  # the wheel, in an empty folder
        (work / "empty").mkdir()
        built = succeeds([uv, "build", "--wheel", "-q", "-o", str(work / "wheel")])
        wheels = [str(path) for path in (work / "wheel").glob("*.whl")]
        works = built and succeeds([*install, *wheels], work) and succeeds(row.command, work / "empty")
        result = "passed" if works else "failed"
    elif not succeeds(install):
        result = "failed to install"
    else:
        result = "passed" if succeeds(row.command) else "failed"
    if result.startswith("failed") and time.monotonic() - start > limit:
        result += f": more than {limit:.0f} s"
    frozen = [uv, "pip", "freeze", "--python", str(env / "bin" / "python")]
    installed = subprocess.run(frozen, capture_output=True, text=True, check=False).stdout.splitlines()
    versions = ", ".join(line.replace("==", " ") for line in installed if package(line) in row.shows)
    log.seek(0)
    text = log.read()
    log.close()
    if say or result.startswith("failed"):
        print(text[-4000:], flush=True)
    tests = re.findall(r"^(?:\d+ \w+, )*\d+ passed.*? in ", text, flags=re.MULTILINE)
    return (
        "; ".join([result, *(line.removesuffix(" in ") for line in tests), *filter(None, [versions])]),
        time.monotonic() - start,
    )


def add(path: Path, row: Row, line: str) -> None:
    """Write the line of a row into a table, which is made where there is none; lines of other rows stay."""
    head = "| environment | Python | command | result | seconds |\n|---|---|---|---|---|"
    lines = path.read_text().splitlines() if path.exists() else head.splitlines()
    number = next((n for n, old in enumerate(lines) if old.startswith(f"| {row.name} |")), len(lines))
    path.write_text("\n".join([*lines[:number], line, *lines[number + 1 :], ""]))


def shown(row: Row) -> str:
    """Return the commands of a row as somebody would type them."""
    words = re.sub(r"(--only-binary [\w-]+ )+", "--only-binary ... ", f"{shlex.join(row.install)} ")
    install = f"uv pip install {words.strip()}" if row.install else "uv pip install dancedata-*.whl"
    return f"{install} && {row.command}"


def main() -> int:
    """Run the chosen rows and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("words", nargs="*", help="rows whose name holds one of these; default: all")
    parser.add_argument("--torch", action="store_true", help="run rows that need torch too")
    parser.add_argument("--to", type=Path, metavar="FILE", help="the table as a file, written after every row")
    parser.add_argument("--limit", type=float, default=3600, help="seconds that a row may take; default: 3600")
    parser.add_argument("--list", action="store_true", help="print the rows and their commands")
    parser.add_argument("--verbose", action="store_true", help="print the output of every row")
    options = parser.parse_args()
    chosen = [r for r in rows() if not options.words or any(word in r.name for word in options.words)]
    if options.list:
        print("\n".join(f"{r.name}: {shown(r)}" for r in chosen))
        return 0
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        table = options.to or Path(folder) / "table.md"
        uv = shutil.which("uv")
        if uv is None:
            tools = Path(folder) / "tools"
            subprocess.run([sys.executable, "-m", "venv", tools], check=True)
            subprocess.run([tools / "bin" / "pip", "install", "-q", "uv"], check=True)
            uv = str(tools / "bin" / "uv")
        for number, row in enumerate(chosen):
            work = Path(folder) / str(number)
            work.mkdir()
            if row.torch and not options.torch:
                result, seconds = "not run: needs torch (--torch)", 0.0
            else:
                result, seconds = run(row, work, uv, options.verbose, options.limit)
            failed += result.startswith("failed")
            add(table, row, f"| {row.name} | {row.python} | `{shown(row)}` | {result} | {seconds:.0f} |")
            print(f"{row.name}: {result}, {seconds:.0f} s", flush=True)
            shutil.rmtree(work)
        print(f"\n{table.read_text()}", end="")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
