"""Counts of what a user meets: commands, options, names of the package, pages and their words.

python benchmarks/face.py
"""

from pathlib import Path

import typer

import dancedata
from dancedata.cli.app import app

ROOT = Path(__file__).resolve().parents[1]


def main() -> None:
    """Print the counts, a line each."""
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    parameters = [p for command in commands.values() for p in command.params]
    options = {p.opts[-1] for p in parameters if p.param_type_name == "option"} - {"-h"}  # -h is --help in short
    arguments = [p for p in parameters if p.param_type_name == "argument"]
    pages = [p for p in (ROOT / "docs").rglob("*.md") if "archive" not in p.parts]
    code = [p for p in (ROOT / "dancedata" / "cli").rglob("*.py")]
    counts = {
        "commands": len(commands), "different options": len(options), "arguments": len(arguments),
        "names in dir(dancedata)": len([name for name in dir(dancedata) if not name.startswith("_")]),
        "pages": len(pages), "words of pages": sum(len(p.read_text(encoding="utf-8").split()) for p in pages),
        "lines of cli": sum(len(p.read_text(encoding="utf-8").splitlines()) for p in code),
    }  # fmt: skip
    for name, count in counts.items():
        print(f"{name:24} {count:>7,}")


if __name__ == "__main__":
    main()
