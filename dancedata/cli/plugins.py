"""Recipes and plug-ins, listed by `dancedata info`, and new plug-ins from templates by `dancedata init`.

Recipes are read and not parsed, so that neither pydantic nor the files of datasets are loaded.
"""

import dataclasses
import inspect
import keyword
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path, PurePath
from shlex import quote
from typing import Any

from dancedata.building import plugins as building
from dancedata.building.plugins import ANNOTATORS, FIELDS, RULES, TRANSFORMS
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.registry import (
    AUGMENTATIONS,
    CONTACTS,
    DATASETS,
    FEATURES,
    FILTERS,
    KEYMOTIONS,
    METRICS,
    REGISTRIES,
    REPRESENTATIONS,
    Registry,
)
from dancedata.core.resources import resource, resources
from dancedata.exports.base.job import EXPORTS
from dancedata.files.atomic import write_text
from dancedata.files.yaml import read_yaml

_TEMPLATES = Path(__file__).with_name("templates")
_TEST = '''"""Conformance of the {kind} {name}."""


from fractions import Fraction
from pathlib import Path, PurePath

from {module} import {cls}

from dancedata.testing.conformance import check


def test_conformance(tmp_path: Path) -> None:
    check({cls}, tmp_path)
'''
_NEXT = """wrote {module} and {test}
next:
  1. python -m pytest {test} (pip install pytest): the template passes; change it, and run the test again
  2. in a checkout of dancedata: move {module} to {folder}/;
     elsewhere: name the file in a recipe (plugins: [{module}]) or on the command line (--plugin {module});
     for a package: write the pyproject.toml below next to it, and pip install -e {out}
  3. dancedata info {name} shows it where it is installed; {use}

[project]
name = "{name}"
version = "0.1"

[tool.setuptools]
py-modules = ["{name}"]

[project.entry-points."{group}"]
{name} = "{name}\""""


_NEXT_OF_PACKAGE = """wrote {module} and {test}
next:
  1. python -m pytest {out}: the template passes; change it, and run the test again
  2. more of it: dancedata init NAME --plugin-kind KIND --out {out}
  3. pip install -e {out}; dancedata info {name} shows it, and {use}"""
_NEXT_IN_TREE = """wrote
{files}
next:
  1. python -m pytest tests/conformance tests -k {name}: what is written passes; change it, and run it again
  2. CONTRIBUTING.md has the steps after it, and who checks what"""
_RECIPE = """recipe: 1
name: {name}
description: What it is, of which paper, and in whose columns.
dataset: {{{name}: {{}}}}
fps: 30
windows: {{length_s: 5, stride_s: 0.5}}
motion: {{edge151: {{}}}}
audio: {{librosa35: {{}}}}
"""
_PAGE = """# {name}

What it is, of whom, and where its files are:

```
SOURCE/NAME.npz    poses, trans, fps
SOURCE/NAME.wav    its music
```

```sh
dancedata check SOURCE --recipe {name}
dancedata build {name} SOURCE
```

| | |
|---|---|
| motion | hours, rate, skeleton, the axis that is up |
| music | formats, where second 0 is |
| terms | the licence, and whether motion and music may be passed on |
| splits | who made them, and what they share |
| recipe | `{name}`: columns and windows, as which trainer |
"""
_PROJECT = """[build-system]
requires = ["setuptools"]
build-backend = "setuptools.build_meta"

[project]
name = "{package}"
version = "0.1"
dependencies = ["dancedata"]

[tool.setuptools]
packages = ["{package}"]

[tool.pytest.ini_options]
pythonpath = ["."]
"""


@dataclass(frozen=True)
class Kind:
    """A kind of plug-in that can be written.

    Attributes
    ----------
    template
        File of the template.
    recipe
        The key of a recipe that names a plug-in of this kind, with NAME for its name; "" if there is none.
    command
        The command that uses one in that case.
    """

    registry: Registry[Any]
    template: str
    recipe: str
    command: str = ""

    def use(self, name: str) -> str:
        """Return the use of a plug-in, in words."""
        text = f"a recipe may have: {self.recipe}" if self.recipe else f"it is used by: {self.command}"
        return text.replace("NAME", name)


#: Kinds by what the command line calls them.
KINDS = {
    "dataset": Kind(DATASETS, "dataset.py", "dataset: {NAME: {}}"),
    "representation": Kind(REPRESENTATIONS, "representation.py", "motion: {NAME: {}}"),
    "contact-rule": Kind(CONTACTS, "contact_rule.py", "motion: {edge151: {contacts: {NAME: {}}}}"),
    "feature": Kind(FEATURES, "feature.py", "audio: {NAME: {}}"),
    "key-motion": Kind(KEYMOTIONS, "key_motion.py", "keymotion: {NAME: {}}"),
    "augmentation": Kind(AUGMENTATIONS, "augmentation.py", "augment: {NAME: {}}"),
    "filter": Kind(FILTERS, "filter.py", "rules: {NAME: {}}"),
    "field": Kind(FIELDS, "field.py", "fields: {NAME: {}}"),
    "transform": Kind(TRANSFORMS, "transform.py", "transforms: [{NAME: {}}]"),
    "annotator": Kind(ANNOTATORS, "annotator.py", "annotators: {NAME: {}}"),
    "rule": Kind(RULES, "rule.py", "rules: {NAME: {}}"),
    "metric": Kind(METRICS, "metric.py", "", 'METRICS.get("NAME")().measure(dance), and protocols'),
    "export": Kind(EXPORTS, "export.py", "", "dancedata export DATASET --to NAME --out DIR"),
}


@dataclass(frozen=True)
class NewPlugin:
    """A plug-in that was written: its module, its test, the package that they are in, and all files in a checkout."""

    kind: Kind
    name: str
    module: Path
    test: Path
    package: str = ""
    others: tuple[Path, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        group = self.kind.registry.package
        more = (
            {"package": self.package}
            if self.package
            else {"files": list(map(str, self.others))}
            if self.others
            else {}
        )
        return {"name": self.name, "group": group, "module": str(self.module), "test": str(self.test)} | more

    def __str__(self) -> str:
        group = self.kind.registry.package
        folder = self.module.parent.parent if self.package else self.module.parent
        if self.others:
            return _NEXT_IN_TREE.format(files="\n".join(f"  {path}" for path in self.others), name=self.name)
        return (_NEXT_OF_PACKAGE if self.package else _NEXT).format(
            module=quote(str(self.module)),
            test=quote(str(self.test)),
            out=quote(str(folder)),
            package=self.package,
            folder=group.replace(".", "/"),
            name=self.name,
            group=group,
            use=self.kind.use(self.name),
        )


def write_plugin(kind: str, name: str, out: Path, *, in_tree: bool = False) -> NewPlugin:
    """Write NAME.py and test_NAME.py from the template of a kind.

    In another folder than the working folder they are added to a package of its name, which is begun if it does not
    exist.

    Parameters
    ----------
    kind
        A key of `KINDS`.
    name
        Name of the plug-in, and of its module.
    out
        Folder to write to; it is created if it does not exist.
    in_tree
        Write it where it belongs in the checkout of dancedata at `out`.

    Raises
    ------
    UsageError
        For an unknown kind, a name that is invalid or taken, or a file that exists; nothing is written then.
    """
    if kind not in KINDS:
        raise UsageError(f"unknown kind of plug-in {kind!r}", fix=did_you_mean(kind, KINDS))
    package = "" if in_tree or out.absolute() == Path().absolute() else out.absolute().name
    plugin = NewPlugin(KINDS[kind], name, out / package / f"{name}.py", out / f"test_{name}.py", package)
    if in_tree:
        plugin = _in_tree(plugin, out)
    _check_name(plugin, in_tree=in_tree)
    template = (_TEMPLATES / plugin.kind.template).read_text(encoding="utf-8")
    cls = _class_name(name, template)
    text = template.replace("TemplateName", cls).replace("template_name", name)
    module = f"{package}.{name}" if package else name
    if in_tree:
        module = ".".join(plugin.module.relative_to(out).with_suffix("").parts)
    test = _TEST.format(kind=plugin.kind.registry.kind, name=name, cls=cls, module=module)
    changed = {out / "pyproject.toml": _project(plugin, out)} if package else {}
    files = {plugin.module: text, plugin.test: test}
    if in_tree:
        changed = {out / "CHANGELOG.md": _changes(plugin, out)}
        files |= _of_dataset(name, out) if kind == "dataset" else {}
    try:
        plugin.module.parent.mkdir(parents=True, exist_ok=True)
        for path, content in files.items():
            with path.open("x", encoding="utf-8", newline="\n") as file:
                file.write(content)
        if package:
            (out / package / "__init__.py").touch()
        for path, content in changed.items():
            write_text(path, content)
    except OSError as error:
        raise UsageError("the plug-in cannot be written", where=out, found=error) from error
    return replace(plugin, others=tuple(path for path in [*files, *changed] if in_tree))


def _in_tree(plugin: NewPlugin, root: Path) -> NewPlugin:
    """Return a plug-in with the places of its files in a checkout."""
    folder = root / plugin.kind.registry.package.replace(".", "/")
    if not folder.is_dir() or not (root / "CHANGELOG.md").is_file():
        raise UsageError(
            "this is not a checkout of dancedata", where=root, fix="run it in the top folder of a checkout"
        )
    return replace(
        plugin, module=folder / f"{plugin.name}.py", test=root / "tests" / folder.name / f"test_{plugin.name}.py"
    )


def _of_dataset(name: str, root: Path) -> dict[Path, str]:
    """Return the other files of a dataset in a checkout."""
    pages = next(folder for folder in (root / "docs" / "datasets", root / "docs") if folder.is_dir())
    return {
        root / "pipelines" / f"{name}.yaml": _RECIPE.format(name=name),
        pages / f"{name}.md": _PAGE.format(name=name),
    }


def _changes(plugin: NewPlugin, root: Path) -> str:
    """Return CHANGELOG.md with a line for the plug-in."""
    head = "## [Unreleased]\n"
    text = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    return text.replace(
        head, f"{head}\n### Added: {plugin.name}\n\n- The {plugin.kind.registry.kind} `{plugin.name}`.\n", 1
    )


def _project(plugin: NewPlugin, root: Path) -> str:
    """Return the pyproject.toml of a package with one more entry point."""
    path, group = root / "pyproject.toml", f'[project.entry-points."{plugin.kind.registry.package}"]'
    entry = f'{plugin.name} = "{plugin.package}.{plugin.name}"'
    if not path.exists():
        return f"{_PROJECT.format(package=plugin.package)}\n{group}\n{entry}\n"
    if not (root / plugin.package / "__init__.py").is_file():
        raise UsageError("the folder is another project", where=root, fix="choose another --out")
    text = path.read_text(encoding="utf-8")
    head, heading, tail = text.partition(f"{group}\n")
    return f"{head}{heading}{entry}\n{tail}" if heading else f"{text.rstrip()}\n\n{group}\n{entry}\n"


def _check_name(plugin: NewPlugin, *, in_tree: bool) -> None:
    name, registry = plugin.name, plugin.kind.registry
    for what, value in (("plug-in", name), ("package", plugin.package or "package")):
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", value) or keyword.iskeyword(value):
            raise UsageError(
                f"not a valid name for a {what}",
                found=repr(value),
                allowed="the name of a Python module: ASCII letters, digits and _, beginning with a letter",
            )
    if name in registry.names():
        raise UsageError(f"the {registry.kind} {name!r} exists already",
                         fix=f"choose another name; known: {', '.join(registry.names())}")  # fmt: skip
    for path in (plugin.module, plugin.test):
        if path.exists() or path.is_symlink():
            raise UsageError("the file exists already", where=path, fix="choose another name, or another --out")
    if in_tree:
        return
    top = plugin.package or name
    spec = find_spec(top)
    # A package that is installed from here, by pip install -e, may get more plug-ins.
    if spec is not None and not (plugin.package and plugin.module.with_name("__init__.py").is_file()):
        raise UsageError(
            f"{top} is the name of an installed Python module", found=spec.origin, fix="choose another name"
        )


def _class_name(name: str, template: str) -> str:
    """Return the name in CamelCase; append Plugin if the template already uses that name."""
    cls = "".join(part[:1].upper() + part[1:] for part in name.split("_"))
    taken = keyword.iskeyword(cls) or cls == "Path" or re.search(rf"\b{cls}\b", template)
    return f"{cls}Plugin" if taken else cls


#: What `dancedata info` lists, by the name of the list: kinds of `_registries`, and recipes.
LISTS = {
    "recipes": ("recipes",), "targets": ("exports",), "features": ("audio features",),
    "representations": ("representations",), "plugins": None,
}  # fmt: skip


def catalogue(listed: str) -> dict[str, Any]:
    """Return the entries of a list of `LISTS`, each with a line of description and its keys."""
    registries = {**REGISTRIES, **building.REGISTRIES, "exports": EXPORTS}
    kinds = LISTS[listed] or tuple(registries)
    entries: dict[str, Any] = {}
    for kind in kinds:
        if kind == "recipes":
            files = {name.removesuffix(".yaml"): resource("pipelines", name) for name in resources("pipelines")}
            entries[kind] = {name: {"about": read_yaml(file).get("description", "")} for name, file in files.items()}
        else:
            registry = registries[kind]
            entries[kind] = {name: _plugin_json(registry.get(name)) for name in registry.names()}
    return entries


def _plugin_json(cls: type[Any]) -> dict[str, Any]:
    summary = (inspect.getdoc(cls) or "").split("\n\n")[0].replace("\n", " ")
    defaults = {f.name: f.default for f in dataclasses.fields(cls) if f.default is not dataclasses.MISSING}
    keys = {key: str(value) if isinstance(value, PurePath | Fraction) else value for key, value in defaults.items()}
    if getattr(cls, "default_contacts", None) is not None:
        keys["contacts"] = cls.default_contacts
    return {"about": summary, "keys": keys}


def describe_catalogue(kinds: Mapping[str, Any]) -> list[str]:
    """Return a line for each entry, and its keys."""
    lines = []
    for kind, entries in kinds.items():
        lines.append(f"{kind}:")
        for name, entry in entries.items():
            lines.append(f"  {name}: {entry['about']}")
            if entry.get("keys"):
                lines.append(f"    keys: {', '.join(f'{k}={v!r}' for k, v in entry['keys'].items())}")
    return lines
