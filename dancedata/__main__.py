"""The command ``dancedata``, also ``python -m dancedata``."""

from __future__ import annotations

from dancedata.cli.interrupts import run


def main() -> None:
    """Run the command line."""
    run(_command)


def _command() -> None:
    # Imported here, so that Ctrl-C is dealt with before anything takes time.
    from dancedata.cli.app import main as command

    command()


if __name__ == "__main__":
    main()
