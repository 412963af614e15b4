"""Plug-ins by name, and as the type checker sees them; errors that survive a worker process."""

import copy
import os
import pickle
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, get_type_hints

import pytest

from dancedata.building.fields.key_motion import KeyMotionField
from dancedata.building.fields.motion import RepresentationField
from dancedata.building.fields.music import FeatureField
from dancedata.building.transforms.copy import Copy
from dancedata.core.errors import (
    DanceDataError,
    DataError,
    SourceError,
    UsageError,
)
from dancedata.core.plugins import AudioFeature, Dataset, KeyMotionFinder, Plugin, Representation
from dancedata.core.registry import CONTACTS, DATASETS, FEATURES, REPRESENTATIONS, Registry
from dancedata.recipes.recipe import Recipe
from tests.messages import raises_message

ALL = (DATASETS, REPRESENTATIONS, CONTACTS, FEATURES)


def test_threads_that_ask_while_one_loads_wait_for_all_plug_ins(tmp_path, monkeypatch):
    package = tmp_path / "slow_plugins"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "late.py").write_text(
        "import time\ntime.sleep(0.5)\n"
        "from dancedata.core import registry\n"
        "assert registry.SLOW.names() == ()  # a concurrent call gets the registered ones\n"
        "registry.SLOW.register('late')(type('Late', (registry.Plugin,), {'version': 1}))\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    slow = Registry("slow plug-in", "slow_plugins", Plugin)
    monkeypatch.setattr("dancedata.core.registry.SLOW", slow, raising=False)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: slow.names(), range(4)))
    assert found == [("late",)] * 4


def test_a_folder_of_a_room_has_modules_of_other_rooms(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "house").mkdir()
    (tmp_path / "house" / "__init__.py").write_text("")
    make_package(tmp_path / "house", "kitchen", meals="raise RuntimeError")
    make_package(tmp_path / "house" / "kitchen", "tools")
    code = (
        "from tests.core import test_registry as t\nt.TOOLS.register('{}')(type('X', (t.Plugin,), {{'version': 1}}))"
    )
    make_package(tmp_path / "house", "garden", tools=code.format("spade"), meals="raise RuntimeError")
    make_package(tmp_path / "house", "cellar", other="raise RuntimeError")
    monkeypatch.syspath_prepend(str(tmp_path))
    registry: Registry[Plugin] = Registry("tool", "house.kitchen.tools", Plugin)
    monkeypatch.setattr(sys.modules[__name__], "TOOLS", registry, raising=False)
    assert registry.names() == ("spade",)


#: In a separate process, with another distribution whose contact rule has the name of a shipped one.
ASKING = """
from dancedata.core.errors import UsageError
from dancedata.core.registry import CONTACTS
for ask in (lambda: CONTACTS.get("velocity"), lambda: "velocity" in CONTACTS, CONTACTS.names) * 2:
    try:
        print("GOT", ask())
    except UsageError as error:
        print(error)
"""


@pytest.mark.parametrize(
    ("module", "message"),
    [
        (
            "from dancedata.contacts.height import *\n"
            "from dancedata.core.plugins import ContactRule\n"
            "from dancedata.core.registry import CONTACTS\n"
            "from dataclasses import dataclass\n"
            "@CONTACTS.register('velocity')\n@dataclass(frozen=True)\n"
            "class Mine(Height):\n    'Another rule.'\n    version = 1\n",
            "two plug-ins are registered as the contact rule 'velocity'",
        ),
        ("raise RuntimeError('boom')\n", "the contact rule 'velocity' of mine cannot be loaded"),
    ],
    ids=["the name of a shipped one", "cannot be imported"],
)
def test_a_plug_in_of_another_distribution_never_takes_the_place_of_a_shipped_one(tmp_path, module, message):
    info = tmp_path / "mine-1.0.dist-info"
    info.mkdir()
    (tmp_path / "mine.py").write_text(module)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[dancedata.contacts]\nvelocity = mine\n")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run([sys.executable, "-c", ASKING], env=environment, capture_output=True, text=True, check=True)
    assert "GOT" not in done.stdout, done.stdout
    assert done.stdout.count(message) == 6


@pytest.mark.parametrize("registry", ALL, ids=lambda r: r.kind)
def test_every_shipped_plug_in_is_in_the_module_of_its_name(registry: Registry) -> None:
    """So that asking for a name imports it, and one of another distribution with that name is an error."""
    for name in registry.names():
        module = registry.get(name).__module__
        own = f"{registry.package}.{name.replace('+', 'p').replace('-', '_')}"
        assert module == own or module.startswith(f"{own}."), name


def make_package(folder: Path, name: str, **modules: str) -> None:
    (folder / name).mkdir()
    (folder / name / "__init__.py").write_text("")
    for module, text in modules.items():
        (folder / name / f"{module}.py").write_text(text)


def test_one_file_is_one_plug_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (
        "from dancedata.core.plugins import Plugin\nfrom dancedata.core.registry import TEST\n"
        "@TEST.register('new')\nclass New(Plugin):\n    version = 1\n"
    )
    make_package(tmp_path, "plugins_here", mine=text, _helper="raise RuntimeError('helpers are not imported')")
    monkeypatch.syspath_prepend(tmp_path)
    registry = Registry("thing", "plugins_here", Plugin)
    monkeypatch.setattr("dancedata.core.registry.TEST", registry, raising=False)
    assert "plugins_here.mine" not in sys.modules
    assert registry.names() == ("new",)
    assert registry.get("new").name == "new"


def test_registered_classes_are_checked() -> None:
    with raises_message(UsageError, "derived"):

        @FEATURES.register("a")
        class Plain:
            pass

    with raises_message(UsageError, "n_rows"):

        @FEATURES.register("a")
        class Half(AudioFeature):
            pass

    assert "a" not in FEATURES.names()


ERRORS = [
    DataError("has NaN", reason="nan", where=Path("a/b.pkl"), found=3, allowed="numbers", fix="look at it"),
    UsageError("no", found="x"),
    SourceError("empty"),
]


def test_text() -> None:
    assert str(ERRORS[0]) == "a/b.pkl: has NaN; found 3; allowed: numbers. Look at it"
    assert str(ERRORS[2]) == "empty"
    assert str(DataError("x", reason="r", found=0)) == "x; found 0"


@pytest.mark.parametrize("error", ERRORS, ids=lambda e: type(e).__name__)
def test_errors_survive_pickling(error: DanceDataError) -> None:
    for back in (pickle.loads(pickle.dumps(error)), copy.copy(error)):
        assert type(back) is type(error)
        assert str(back) == str(error)
        assert back.__dict__ == error.__dict__
        assert back.args == error.args


@pytest.mark.parametrize(
    ("owner", "name", "kind"),
    [
        (Recipe, "dataset", Dataset),
        (FeatureField, "feature", AudioFeature),
        (RepresentationField, "representation", Representation),
        (KeyMotionField, "finder", KeyMotionFinder),
    ],
)
def test_a_plug_in_is_declared_by_its_kind(owner: type[Any], name: str, kind: type[Any]) -> None:
    """Not as Any, with which every member would pass the type checker."""
    assert get_type_hints(owner, localns={"Copy": Copy})[name] is kind
