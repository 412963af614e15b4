"""Plug-ins, listed by `dancedata info` with their keys, and new ones from templates by `dancedata init`.

Recipes are read and not parsed, so that neither pydantic nor the files of datasets are loaded.
"""

import dataclasses
import inspect
import json
import keyword
import re
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path, PurePath
from shlex import quote
from typing import Any, NamedTuple

from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.registry import REGISTRIES, Registry
from dancedata.core.resources import resource, resources
from dancedata.exports.base.job import EXPORTS
from dancedata.files.atomic import write_text
from dancedata.files.yaml import read_yaml

_TEMPLATES = Path(__file__).with_name("templates")
_TEST = '''"""Conformance of the {kind} {name}."""

from pathlib import Path

{imports}


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
_HEAD = "## [Unreleased]\n"


class Kind(NamedTuple):
    """A kind of plug-in that can be written, and how one is used, with NAME for its name."""

    registry: Registry[Any]
    use: str


def _key(kind: str, text: str) -> Kind:
    return Kind(REGISTRIES[kind], f"a recipe may have: {text}")


#: Kinds by what the command line calls them; their templates have these names.
KINDS = {
    "dataset": _key("datasets", "dataset: {NAME: {}}"),
    "representation": _key("representations", "motion: {NAME: {}}"),
    "contact-rule": _key("contacts", "motion: {edge151: {contacts: {NAME: {}}}}"),
    "feature": _key("audio features", "audio: {NAME: {}}"),
    "key-motion": _key("key motions", "keymotion: {NAME: {}}"),
    "augmentation": _key("augmentations", "augment: {NAME: {}}"),
    "filter": _key("window filters", "rules: {NAME: {}}"),
    "field": _key("fields", "fields: {NAME: {}}"),
    "transform": _key("transforms", "transforms: [{NAME: {}}]"),
    "annotator": _key("annotators", "annotators: {NAME: {}}"),
    "rule": _key("window rules", "rules: {NAME: {}}"),
    "metric": Kind(REGISTRIES["metrics"], 'it is used by: METRICS.get("NAME")().measure(dance), and protocols'),
    "export": Kind(EXPORTS, "it is used by: dancedata export DATASET --to NAME --out DIR"),
}


@dataclass(frozen=True)
class NewPlugin:
    """A plug-in that was written: its module, its test, the package that they are in, and all files in a checkout."""

    kind: Kind
    name: str
    module: Path
    test: Path
    package: str = ""
    files: tuple[Path, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        document = {"name": self.name, "group": self.kind.registry.package}
        document |= {"module": str(self.module), "test": str(self.test)}
        in_package = {"package": self.package} if self.package else {}
        return document | in_package | ({"files": list(map(str, self.files))} if self.files else {})

    def __str__(self) -> str:
        group = self.kind.registry.package
        text = _NEXT_IN_TREE if self.files else _NEXT_OF_PACKAGE if self.package else _NEXT
        return text.format(
            files="\n".join(f"  {path}" for path in self.files), module=quote(str(self.module)),
            test=quote(str(self.test)), out=quote(str(self.test.parent)), package=self.package,
            folder=group.replace(".", "/"), name=self.name, group=group, use=self.kind.use.replace("NAME", self.name),
        )  # fmt: skip


def write_plugin(kind: str, name: str, out: Path, *, in_tree: bool = False) -> NewPlugin:
    """Write a plug-in and its test from the template of a kind: here, in a package at `out`, or in a checkout."""
    if kind not in KINDS:
        raise UsageError(f"unknown kind of plug-in {kind!r}", fix=did_you_mean(kind, KINDS))
    registry = KINDS[kind].registry
    package = "" if in_tree or out.absolute() == Path().absolute() else out.absolute().name
    module, test = out / package / f"{name}.py", out / f"test_{name}.py"
    if in_tree:
        folder = out / registry.package.replace(".", "/")
        if not folder.is_dir() or not (out / "CHANGELOG.md").is_file():
            raise UsageError(
                "this is not a checkout of dancedata", where=out, fix="run it in the top folder of a checkout"
            )
        module, test = folder / f"{name}.py", out / "tests" / folder.name / f"test_{name}.py"
    plugin = NewPlugin(KINDS[kind], name, module, test, package)
    _check_name(plugin, in_tree=in_tree)
    template = (_TEMPLATES / f"{kind.replace('-', '_')}.py").read_text(encoding="utf-8")
    cls = _class_name(name, template)
    imported = ".".join(module.relative_to(out).with_suffix("").parts)
    imports = "\n".join(sorted([f"from {imported} import {cls}", "from dancedata.testing.conformance import check"]))
    files = {
        module: template.replace("TemplateName", cls).replace("template_name", name),
        test: _TEST.format(kind=registry.kind, name=name, cls=cls, imports=imports),
    }
    changed = {}
    if package:
        changed = {out / package / "__init__.py": "", out / "pyproject.toml": _project(plugin, out)}
    elif in_tree:
        if kind == "dataset":
            pages = next(folder for folder in (out / "docs" / "datasets", out / "docs") if folder.is_dir())
            files[out / "pipelines" / f"{name}.yaml"] = _RECIPE.format(name=name)
            files[pages / f"{name}.md"] = _PAGE.format(name=name)
        line = f"{_HEAD}\n### Added: {name}\n\n- The {registry.kind} `{name}`.\n"
        changes = out / "CHANGELOG.md"
        changed = {changes: changes.read_text(encoding="utf-8").replace(_HEAD, line, 1)}
    try:
        module.parent.mkdir(parents=True, exist_ok=True)
        for path, content in files.items():
            with path.open("x", encoding="utf-8", newline="\n") as file:
                file.write(content)
        for path, content in changed.items():
            if content:
                write_text(path, content)
            else:
                path.touch()
    except OSError as error:
        raise UsageError("the plug-in cannot be written", where=out, found=error) from error
    return dataclasses.replace(plugin, files=(*files, *changed) if in_tree else ())


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
                f"not a valid name for a {what}", found=repr(value),
                allowed="the name of a Python module: ASCII letters, digits and _, beginning with a letter",
                fix="name its folder apart: --out DIR" if "/" in value else "",
            )  # fmt: skip
    if name in registry.names():
        raise UsageError(f"the {registry.kind} {name!r} exists already",
                         fix=f"choose another name; known: {', '.join(registry.names())}")  # fmt: skip
    for path in (plugin.module, plugin.test):
        if path.exists() or path.is_symlink():
            raise UsageError("the file exists already", where=path, fix="choose another name, or another --out")
    top = plugin.package or name
    spec = None if in_tree else find_spec(top)
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


#: What `dancedata info` lists, by the name of the list: recipes, and kinds of plug-ins, by default all.
LISTS = {
    "recipes": ("recipes",), "targets": ("exports",), "features": ("audio features",),
    "representations": ("representations",), "plugins": (),
}  # fmt: skip
_SECTION = re.compile(r"^(?:Attributes|Parameters)\n-+\n(.*?)(?=\n\n\w+\n-+\n|\Z)", re.DOTALL | re.MULTILINE)


def catalogue(listed: str) -> dict[str, Any]:
    """Return the entries of a list of `LISTS`, each with a line of description and its keys."""
    if listed == "recipes":
        files = {name.removesuffix(".yaml"): resource("pipelines", name) for name in resources("pipelines")}
        return {listed: {name: {"about": read_yaml(file).get("description", "")} for name, file in files.items()}}
    registries = {**REGISTRIES, "exports": EXPORTS}
    return {
        kind: {name: _plugin_json(registries[kind].get(name)) for name in registries[kind].names()}
        for kind in LISTS[listed] or registries
    }


def _plugin_json(cls: type[Any]) -> dict[str, Any]:
    summary = (inspect.getdoc(cls) or "").split("\n\n")[0].replace("\n", " ")
    defaults = {f.name: f.default for f in dataclasses.fields(cls) if f.default is not dataclasses.MISSING}
    keys = {key: str(value) if isinstance(value, PurePath | Fraction) else value for key, value in defaults.items()}
    if getattr(cls, "default_contacts", None) is not None:
        keys["contacts"] = cls.default_contacts
    return {"about": summary, "keys": keys}


def documented(plugin: type) -> dict[str, str]:
    """Return the keys of a plug-in with what docstrings of it and its bases say of them, one line each."""
    texts: dict[str, str] = {}
    for cls in reversed(plugin.__mro__):
        own: dict[str, str] = {}
        names: list[str] = []
        for line in "\n".join(_SECTION.findall(inspect.cleandoc(cls.__doc__ or ""))).splitlines():
            if line.startswith(" "):
                own |= {name: f"{own.get(name, '')} {line.strip()}".strip() for name in names}
            elif line:
                names = line.partition(":")[0].replace(" ", "").split(",")
        texts |= own
    return {name: re.sub(r"``([^`]*)``", r"`\1`", text) for name, text in texts.items()}


def describe_catalogue(kinds: Mapping[str, Any], *, whole: bool = False) -> Iterator[str]:
    """Yield lines for each entry: its description, and if `whole` each key with its default and meaning."""
    registries = {**REGISTRIES, "exports": EXPORTS}
    for kind, entries in kinds.items():
        yield f"{kind}:"
        for name, entry in entries.items():
            yield textwrap.fill(f"{name}: {entry['about']}", 80, initial_indent="  ", subsequent_indent="    ")
            texts = documented(registries[kind].get(name)) if whole else {}
            for key, value in entry.get("keys", {}).items() if whole else ():
                yield f"    {key}" if value in (None, "", ()) else f"    {key}: {json.dumps(value, default=str)}"
                yield from textwrap.wrap(texts.get(key, ""), 80, initial_indent=" " * 6, subsequent_indent=" " * 6)
