"""How far a value travels: python benchmarks/walk.py [MODULE FUNCTION PARAMETER].

The value is followed through the source from a parameter of a function: under its names (assigned, looped over,
unpacked, put into a tuple, a list or an object), into every function of the package that it is handed to, or with,
and out of it again where it is returned. A *stay* is a call that takes it into another file than the caller's, a
*room* a file, a *return* a stay in a room where it has been. The walk ends at what is chosen while the program runs:
methods of plug-ins. Without arguments: the parts of a recipe and the takes through a build, whose attributes are
other values; and the ways of a batch, an evaluation, a report and a source, whose attributes and methods are followed
by annotations.
"""

from __future__ import annotations

import ast
import sys
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
#: Functions that return what they are given, or its items.
PASSING = {
    "list", "tuple", "sorted", "set", "dict", "zip", "enumerate", "reversed", "iter", "next", "replace", "values",
    "items", "setdefault", "get", "pop", "min", "max", "filter", "append", "extend", "chain", "deque",
}  # fmt: skip
#: Rooms that make messages of a value.
_MESSAGES = {"dancedata.core.text", "dancedata.core.errors"}


@dataclass
class Trip:
    """Where a value has been."""

    stays: list[str] = field(default_factory=list)
    names: set[str] = field(default_factory=set)
    calls: set[tuple[str, int, int]] = field(default_factory=set)
    whole: bool = False
    seen: dict[tuple[str, str, frozenset[str]], bool] = field(default_factory=dict)

    @property
    def rooms(self) -> int:
        """Files."""
        return len(set(self.stays))

    @property
    def returns(self) -> int:
        """Stays in a file where it has been."""
        return len(self.stays) - self.rooms

    def __str__(self) -> str:
        return f"{len(self.stays)} stays, {self.rooms} rooms, {self.returns} returns, {len(self.names)} names"


@cache
def _module(name: str) -> tuple[ast.Module, dict[str, tuple[str, str]]] | None:
    """Return the tree of a module, and where its imported names are from."""
    path = ROOT / Path(*name.split("."))
    path = path.with_suffix(".py") if path.with_suffix(".py").exists() else path / "__init__.py"
    if not path.exists():
        return None
    tree = ast.parse(path.read_text(encoding="utf-8"))
    froms = (n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and (n.module or "").startswith("dancedata"))
    return tree, {a.asname or a.name: (n.module or "", a.name) for n in froms for a in n.names}


def _find(module: str, name: str) -> tuple[str, ast.FunctionDef | ast.ClassDef] | None:
    """Return the definition of a function, a method `Class.method` or a class, followed through imports."""
    loaded = _module(module)
    if loaded is None:
        return None
    tree, imported = loaded
    first, _, method = name.partition(".")
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and node.name == first:
            if not method:
                return module, node
            methods = node.body if isinstance(node, ast.ClassDef) else []
            return next(((module, m) for m in methods if isinstance(m, ast.FunctionDef) and m.name == method), None)
    return _find(imported[first][0], name.replace(first, imported[first][1], 1)) if first in imported else None


def _class_at(module: str, annotation: ast.AST | None) -> tuple[str, str, bool] | None:
    """Return module and name of the first class of the package in an annotation, and whether it is of items."""
    if isinstance(annotation, ast.Constant) and isinstance(annotation.value, str):
        annotation = ast.parse(annotation.value, mode="eval").body
    for node in ast.walk(annotation) if annotation is not None else ():
        found = _find(module, node.id) if isinstance(node, ast.Name) else None
        if found is not None and isinstance(found[1], ast.ClassDef):
            return found[0], found[1].name, isinstance(annotation, ast.Subscript)
    return None


def _member(module: str, name: str, attribute: str) -> tuple[str, ast.AST] | None:
    """Return the module and definition of a member of a class or its bases: a method, or what annotates a value."""
    found = _find(module, name)
    if found is None or not isinstance(found[1], ast.ClassDef):
        return None
    home, definition = found
    for node in definition.body:
        if isinstance(node, ast.FunctionDef) and node.name == attribute:
            return home, node
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.target.id == attribute:
            return home, node.annotation
    for node in (n for f in definition.body if isinstance(f, ast.FunctionDef) for n in ast.walk(f)):
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        pairs = [(t, node.value) for t in targets]
        pairs += [
            pair
            for t, v in pairs
            if isinstance(t, ast.Tuple) and isinstance(v, ast.Tuple)
            for pair in zip(t.elts, v.elts, strict=True)
        ]
        for target, value in pairs:
            if isinstance(target, ast.Attribute) and target.attr == attribute and ast.unparse(target.value) == "self":
                if isinstance(node, ast.AnnAssign):
                    return home, node.annotation
                init = next(f for f in definition.body if isinstance(f, ast.FunctionDef) and f.name == "__init__")
                named = {a.arg: a.annotation for a in (*init.args.args, *init.args.kwonlyargs)}
                inner = value.args[0] if isinstance(value, ast.Call) and value.args else value
                annotation = named.get(inner.id) if isinstance(inner, ast.Name) else None
                return None if annotation is None else (home, annotation)
    for base in definition.bases:
        placed = _class_at(home, base)
        if placed is not None and (inherited := _member(*placed[:2], attribute)) is not None:
            return inherited
    return None


def walk(module: str, function: str, *parameters: str, whole: bool = False) -> Trip:
    """Follow parameters of a function; the file of that function is the first stay.

    `whole`: Attributes and methods of it are it as well.
    """
    trip = Trip([module], whole=whole)
    _enter(module, function, frozenset(parameters), trip)
    return trip


def _enter(module: str, function: str, held: frozenset[str], trip: Trip) -> bool:
    """Follow names through a function; return whether it returns the value."""
    place = (module, function, held)
    if place in trip.seen:
        return trip.seen[place]
    trip.seen[place] = False
    found = _find(module, function)
    if found is None or not isinstance(found[1], ast.FunctionDef):
        return False
    reader = _Function(module, function, set(held), trip)
    size = -1
    while len(reader.held) != size:  # a loop may hand a name on that it takes up later
        size = len(reader.held)
        for statement in found[1].body:
            reader.visit(statement)
    trip.names |= reader.held
    trip.seen[place] = reader.is_returned
    return reader.is_returned


class _Function(ast.NodeVisitor):
    """One function, with the names that hold the value."""

    def __init__(self, module: str, function: str, held: set[str], trip: Trip) -> None:
        self.module, self.function, self.held, self.trip, self.is_returned = module, function, held, trip, False
        self.types: dict[str, tuple[str, str, bool]] = {}
        found = _find(module, function)
        if found is not None and isinstance(found[1], ast.FunctionDef):
            for a in (*found[1].args.args, *found[1].args.kwonlyargs):
                if (placed := _class_at(found[0], a.annotation)) is not None:
                    self.types[a.arg] = placed
        if "." in function:
            self.types["self"] = module, function.split(".")[0], False

    def type_of(self, node: ast.AST) -> tuple[str, str, bool] | None:
        """Return the class of an expression by annotations, and whether it is of its items."""
        if isinstance(node, ast.Name):
            return self.types.get(node.id)
        if isinstance(node, ast.Subscript):
            owner = self.type_of(node.value)
            return owner and (*owner[:2], False)
        if isinstance(node, ast.Attribute) and (owner := self.type_of(node.value)) is not None:
            member = _member(*owner[:2], node.attr)
            if member is not None:
                definition = member[1].returns if isinstance(member[1], ast.FunctionDef) else member[1]
                return _class_at(member[0], definition)
        if isinstance(node, ast.Call):
            if isinstance(node.func, ast.Name) and (found := _find(self.module, node.func.id)) is not None:
                is_class = isinstance(found[1], ast.ClassDef)
                return (found[0], found[1].name, False) if is_class else _class_at(found[0], found[1].returns)
            return self.type_of(node.func) if isinstance(node.func, ast.Attribute) else None
        return None

    def holds(self, node: ast.AST | None) -> bool:
        """Whether an expression is the value, an item of it, or an object that was made of it."""
        if isinstance(node, ast.Name):
            return node.id in self.held
        if isinstance(node, ast.Call):
            return self.call(node)
        if isinstance(node, ast.ListComp | ast.SetComp | ast.GeneratorExp | ast.DictComp):
            for part in node.generators:
                self.bind(part.target, self.holds(part.iter))
            return any(map(self.holds, [node.key, node.value] if isinstance(node, ast.DictComp) else [node.elt]))
        if isinstance(node, ast.Attribute) and self.trip.whole:
            return self.holds(node.value)
        if isinstance(node, ast.Lambda):
            self.holds(node.body)
            return False
        if isinstance(node, ast.Attribute | ast.Constant | ast.Compare | ast.JoinedStr | ast.Lambda):
            return False
        if isinstance(node, ast.Subscript):
            return self.holds(node.value)
        return node is not None and any(map(self.holds, ast.iter_child_nodes(node)))

    def bind(self, target: ast.AST, holds: bool) -> None:
        """Take up the names of a target."""
        if isinstance(target, ast.Subscript):
            target = target.value
        self.held |= {n.id for n in ast.walk(target) if isinstance(n, ast.Name)} if holds else set()

    def call(self, node: ast.Call) -> bool:
        """Follow the value into a call; return whether its result is the value again."""
        given = [*node.args, *(k.value for k in node.keywords)]
        handed = [self.holds(a.value if isinstance(a, ast.Starred) else a) for a in given]
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        method = node.func if isinstance(node.func, ast.Attribute) else None
        own = method is not None and isinstance(method.value, ast.Name) and method.value.id == "self"
        last = name if method is None else method.attr
        if method is not None and not own:
            receiver = self.holds(method.value)
            if self.trip.whole and (receiver or any(handed)) and (owner := self.type_of(method.value)) is not None:
                member = _member(*owner[:2], last)
                if member is not None and isinstance(member[1], ast.FunctionDef):
                    return self.follow_method(member, node, handed, receiver)
            if any(handed) and last in ("append", "extend", "setdefault", "update"):
                self.bind(method.value, True)
            return last in PASSING and (receiver or any(handed))
        if not any(handed):
            return False
        if last == "partial" and isinstance(node.args[0], ast.Name):
            return self.follow(node.args[0].id, node, node.args[1:], handed[1:])
        for unit in (a.id for a in node.args if isinstance(a, ast.Name) and a.id not in self.held):
            self.hand_over(unit, node)
        if last in PASSING:
            return True
        called = f"{self.function.split('.')[0]}.{last}" if own else name
        return self.follow(called, node, node.args, handed)

    def follow_method(self, member: tuple[str, ast.AST], node: ast.Call, handed: list[bool], receiver: bool) -> bool:
        """Enter a method of a class, with what it is handed, and its own object if that is the value."""
        home, definition = member
        assert isinstance(definition, ast.FunctionDef)
        loaded = _module(home)
        assert loaded is not None
        owner = next(c.name for c in loaded[0].body if isinstance(c, ast.ClassDef) and definition in c.body)
        names = [a.arg for a in definition.args.args]
        names = names[1:] if names[:1] in (["self"], ["cls"]) else names
        held = {names[min(k, len(names) - 1)] for k in range(len(node.args)) if handed[k] and names}
        held |= {k.arg or "" for k, holds in zip(node.keywords, handed[len(node.args) :], strict=True) if holds}
        return self.enter(
            home, f"{owner}.{definition.name}", frozenset(held | ({"self"} if receiver else set())), node
        )

    def follow(self, called: str, node: ast.Call, args: list[ast.expr], handed: list[bool]) -> bool:
        """Enter a function of the package, or an object of a class of it."""
        found = _find(self.module, called)
        if found is None:
            return False
        module, definition = found
        if isinstance(definition, ast.ClassDef):
            return True
        spec = definition.args
        names = [a.arg for a in (*spec.posonlyargs, *spec.args)]
        names = names[1:] if names[:1] == ["self"] else names
        by_place = {names[min(k, len(names) - 1)] for k in range(len(args)) if handed[k] and names}
        by_name = {k.arg or "" for k, holds in zip(node.keywords, handed[len(args) :], strict=True) if holds}
        return self.enter(module, called, frozenset(by_place | by_name), node)

    def hand_over(self, called: str, node: ast.Call) -> None:
        """Enter a function that a call takes beside the value, as `run_units` does; each parameter may hold it."""
        found = _find(self.module, called)
        if found is not None and isinstance(found[1], ast.FunctionDef):
            held = frozenset(a.arg for a in found[1].args.args if a.arg not in ("cache", "jobs", "progress"))
            self.enter(found[0], called, held, node)

    def enter(self, module: str, called: str, held: frozenset[str], node: ast.Call) -> bool:
        """Enter a function, once for each call that is written down."""
        site = (self.module, node.lineno, node.col_offset)
        if module != self.module and site not in self.trip.calls and module not in _MESSAGES:
            self.trip.stays.append(module)
        self.trip.calls.add(site)
        return _enter(module, called, held, self.trip)

    def visit_Assign(self, node: ast.Assign) -> None:  # noqa: N802 -- ast's name
        """Bind the targets of an assignment."""
        holds = self.holds(node.value)
        if (placed := self.type_of(node.value)) is not None and isinstance(node.targets[0], ast.Name):
            self.types[node.targets[0].id] = placed
        for target in node.targets:
            self.bind(target, holds)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:  # noqa: N802
        """Bind the target of an assignment with a type."""
        self.bind(node.target, self.holds(node.value))

    def visit_AugAssign(self, node: ast.AugAssign) -> None:  # noqa: N802
        """Bind the target of `+=`."""
        self.bind(node.target, self.holds(node.value))

    def visit_For(self, node: ast.For) -> None:  # noqa: N802
        """Bind the target of a loop."""
        if (placed := self.type_of(node.iter)) is not None and isinstance(node.target, ast.Name):
            self.types[node.target.id] = *placed[:2], False
        self.bind(node.target, self.holds(node.iter))
        for statement in (*node.body, *node.orelse):
            self.visit(statement)

    def visit_Return(self, node: ast.Return) -> None:  # noqa: N802
        """Note that it is returned."""
        self.is_returned |= self.holds(node.value)

    def visit_Yield(self, node: ast.Yield) -> None:  # noqa: N802
        """Note that it is yielded."""
        self.is_returned |= self.holds(node.value)

    def generic_visit(self, node: ast.AST) -> None:
        """Read expressions, and visit the statements of others."""
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.expr):
                self.holds(child)
            else:
                self.visit(child)


def parts() -> dict[str, Trip]:
    """Return the trips of the parts of a recipe and of takes through a build."""
    found = _find("dancedata.building.spine", "build_clips")
    assert found is not None
    unpacked = next(
        n for n in ast.walk(found[1]) if isinstance(n, ast.Assign) and isinstance(n.targets[0], ast.Tuple)
    )
    names = [n.id for n in unpacked.targets[0].elts if isinstance(n, ast.Name)]
    together = {"fields": ("fields", "made")}  # those that are computed are some of the recipe's
    return {
        name: walk("dancedata.building.spine", "build_clips", *together.get(name, (name,)))
        for name in ("takes", *names)
    }


#: Long ways: what travels, from where.
WAYS = {
    "a batch": ("dancedata.torch.batch_reader", "BatchReader.__call__", "plan"),
    "the input of an evaluation": ("dancedata.evaluation.evaluate", "evaluate_inputs", "inputs"),
    "the music of an evaluation": ("dancedata.evaluation.evaluate", "evaluate_inputs", "music"),
    "a store into the report": ("dancedata.pages.write", "write_report", "store"),
    "a source into a scan": ("dancedata.datasets.published", "PublishedDataset.scan", "source"),
}


def ways() -> dict[str, Trip]:
    """Return the trips of `WAYS`."""
    return {name: walk(*way, whole=True) for name, way in WAYS.items()}


if __name__ == "__main__":
    trips = {" ".join(sys.argv[1:]): walk(*sys.argv[1:])} if sys.argv[1:] else {**parts(), **ways()}
    for name, trip in trips.items():
        print(f"{name}: {trip}: {', '.join(stay.removeprefix('dancedata.') for stay in trip.stays)}")
