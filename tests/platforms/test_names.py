"""Names of files on every system: of shards, exports and clips; line ends of what is read."""

import re
from pathlib import Path, PureWindowsPath

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import DanceDataError
from dancedata.store.schema import is_shard_name

#: Names that Windows gives to devices, with any suffix.
RESERVED = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)


def test_placeholder() -> None:
    assert is_shard_name("train-00000-of-00001.h5")
