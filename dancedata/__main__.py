"""The command ``dancedata``, also ``python -m dancedata``."""

import faulthandler
import os
import sys

from dancedata.cli.interrupts import run


def main() -> None:
    """Run the command line."""
    _open_streams()
    faulthandler.enable()  # a crash of a library, such as a decoder, shows where it was
    try:
        run(_command)
    finally:
        _end_workers()


def _open_streams() -> None:
    """Open closed standard streams: otherwise a file opened later gets fd 0 to 2, and our output."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            from dancedata.core.system import open_file

            open_file(os.devnull, os.O_RDWR)  # gets the lowest number that is free
    sys.stdout = sys.stdout or open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = sys.stderr or open(2, "w", encoding="utf-8", closefd=False)  # noqa: SIM115


def _command() -> None:
    # Imported late, so that Ctrl-C is handled before anything takes time.
    from dancedata.cli.app import main as command

    command()


def _end_workers() -> None:
    # Only commands that build load this module.
    executors = sys.modules.get("dancedata.execution.executors")
    if executors is not None:
        executors.end_workers()


if __name__ == "__main__":
    main()
