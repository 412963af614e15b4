"""docs/cli.md names every command and option that there is, and none that there is not."""

import re
from pathlib import Path

import typer

from dancedata.cli.app import app

PAGE = (Path(__file__).parents[2] / "docs" / "cli.md").read_text(encoding="utf-8")


def commands() -> dict[str, set[str]]:
    """Return all commands with their options."""
    found = {}
    for name, command in typer.main.get_command(app).commands.items():  # type: ignore[attr-defined]
        own = (
            {f"{name} {k}": c for k, c in command.commands.items()}
            if hasattr(command, "commands")
            else {name: command}
        )
        for full, one in own.items():
            found[full] = {o for p in one.params for o in p.opts if o.startswith("--")}
    return found


def test_every_command_is_on_the_page():
    table = PAGE.split("## build")[0]
    for name in commands():
        assert f"`{name}" in table, name


def test_every_option_of_build_is_on_the_page():
    section = PAGE.split("## build")[1].split("\n## ")[0]
    assert set(re.findall(r"^\| `(--[a-z-]+)", section, flags=re.MULTILINE)) == {
        "--source", "--out", "--jobs", "--set", "--strict", "--overwrite", "--cache", "--backend", "--scheduler",
        "--part",
        "--plugin", "--quiet",
    }  # fmt: skip
    for option in commands()["build"] - {"--json", "--help"}:
        assert option in section, option


def test_every_option_on_the_page_exists():
    known = set().union(*commands().values()) | {"--help", "--not-normalized"}
    assert set(re.findall(r"--[a-z][a-z-]+", PAGE)) <= known
