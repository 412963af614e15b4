"""Blender as a Python module (bpy), in a process of its own: its numpy is another one.

The environment variable DANCEDATA_BLENDER_PYTHON names an interpreter that has it; default: that of the tests.
"""

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

__all__ = ["in_blender"]

_VARIABLE = "DANCEDATA_BLENDER_PYTHON"


def in_blender(script: str, *arguments: object, folder: Path) -> Any:
    """Run a script and return what it leaves as JSON in the file that its last argument names; skip without bpy."""
    interpreter = os.environ.get(_VARIABLE)
    if interpreter is None and find_spec("bpy") is None:
        pytest.skip(f"bpy, Blender as a Python module, is not installed; {_VARIABLE} names a Python with it")
    out = folder / "blender.json"
    command = [interpreter or sys.executable, "-c", script, *map(str, arguments), str(out)]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    ended = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert ended.returncode == 0, ended.stderr[-2000:]
    return json.loads(out.read_text())
