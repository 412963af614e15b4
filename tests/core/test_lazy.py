"""Names that are imported when they are first used."""

import subprocess
import sys

import pytest

import dancedata
import dancedata.audio.jukebox
import dancedata.kernel
import dancedata.torch
from dancedata.core.lazy import lazy_names
from dancedata.core.packages import install
from dancedata.store.dataset import open_store

load, names = lazy_names(__name__, {"core.text": "show=shown quoted", "no_such_module": "EpochSampler"})


def test_a_name_may_be_another_one_in_its_module() -> None:
    assert load("show")([1]) == "[1]"
    assert load("quoted")("a") == "'a'"
    assert dancedata.open is open_store
    assert {"show", "quoted", "names"} <= set(names())


@pytest.mark.parametrize("package", [dancedata, dancedata.torch, dancedata.audio.jukebox])
def test_an_unknown_name_lists_the_known_ones(package: object) -> None:
    with pytest.raises(AttributeError, match=r"has no attribute 'opne'; it has \w+, \w+"):
        _ = package.opne  # type: ignore[attr-defined]


def test_another_missing_module_is_not_torch() -> None:
    with pytest.raises(ModuleNotFoundError, match="no_such_module"):
        load("EpochSampler")


WITHOUT_TORCH = """
import sys
sys.modules["torch"] = None
import dancedata.torch
try:
    dancedata.torch.WindowDataset
except ImportError as error:
    print(error)
"""


def test_readers_without_torch_name_the_extra() -> None:
    done = subprocess.run([sys.executable, "-c", WITHOUT_TORCH], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == (
        f"dancedata.torch.WindowDataset needs torch, which is not installed. {install('torch')}. "
        "Reading with numpy alone is dancedata.open(path)."
    )


def test_the_kernel_has_few_public_names() -> None:
    assert len(dancedata.kernel.__all__) <= 60
    assert [name for name in dancedata.kernel.__all__ if getattr(dancedata.kernel, name) is None] == []
