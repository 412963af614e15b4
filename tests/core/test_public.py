"""The public list: what `import dancedata` offers is loaded on first use, typed and documented."""

from __future__ import annotations

import ast
import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import dancedata
import dancedata.audio.jukebox
import dancedata.kernel
import dancedata.torch
from dancedata.core.lazy import lazy_names
from dancedata.core.packages import install
from dancedata.store.dataset import open_store

PUBLIC = {
    "open", "build", "check", "export", "evaluate", "features", "encode", "decode", "load_plugins", "report", "view",
    "AudioSignal", "Clip", "DanceDataError", "Evaluator", "FeatureCache", "Motion", "SampleId", "Scaler", "Skeleton",
    "Store", "__version__",
}  # fmt: skip
MODULES = {"metrics", "plot", "torch"}


def for_type_checkers(package: ModuleType) -> dict[str, str]:
    """Names that a package imports under TYPE_CHECKING, and where from; and those that it loads by itself."""
    (branch,) = (
        node
        for node in ast.parse(Path(str(package.__file__)).read_text(encoding="utf-8")).body
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    )
    return {
        alias.asname or alias.name: f"{node.module}:{alias.name}"
        for node in branch.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }


def test_the_public_list_is_unchanged() -> None:
    assert set(dancedata.__all__) == PUBLIC | MODULES
    assert len(dancedata.__all__) <= 25
    assert dir(dancedata) == sorted(dancedata.__all__)
    table = (Path(__file__).resolve().parents[2] / "docs" / "site" / "reference.py").read_text(encoding="utf-8")
    assert set(re.findall(r"\"dancedata\.(\w+)\"", table)) >= MODULES


def test_modules_are_available_without_a_separate_import() -> None:
    code = (
        "import sys, dancedata; own = {m for m in sys.modules if m.startswith('dancedata.')}\n"
        "assert not own & {f'dancedata.{m}' for m in sys.argv[1:]}, own\n"
        "for m in sys.argv[1:]: assert getattr(dancedata, m).__name__ == f'dancedata.{m}'\n"
        "dancedata.plot.write_video; dancedata.metrics.pfc\n"
        "assert 'torch' not in sys.modules and 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code, *sorted(MODULES)], check=True)


@pytest.mark.parametrize("package", [dancedata, dancedata.torch, dancedata.audio.jukebox], ids=lambda p: p.__name__)
def test_type_checkers_see_lazy_names(package: ModuleType) -> None:
    if package is not dancedata:
        pytest.importorskip("torch")
    typed = for_type_checkers(package)
    assert typed
    modules = {module.name for module in pkgutil.iter_modules(package.__path__)}
    for name, home in typed.items():
        module, _, attribute = home.partition(":")
        assert getattr(package, name) is getattr(importlib.import_module(module), attribute), name
        assert name in dir(package)
        assert name not in modules - MODULES, "importing the module would put it in the name's place"


@pytest.mark.parametrize("name", sorted(PUBLIC - {"__version__"}))
def test_every_name_is_documented(name: str) -> None:
    public = getattr(dancedata, name)
    text = inspect.getdoc(public) or ""
    assert text
    sections = ("Parameters", "Returns", "Raises", "Examples") if inspect.isfunction(public) else ()
    for section in sections:
        assert f"\n{section}\n{'-' * len(section)}\n" in text, section
    for parameter in inspect.signature(public).parameters if sections else ():
        assert parameter in text, parameter


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
