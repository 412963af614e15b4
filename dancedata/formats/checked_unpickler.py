"""Python's unpickler with a check of every opcode that creates, fills or calls anything.

Subclasses decide by `find_class` which names a pickle may use. Keys and members of sets are texts and small integers:
other values can have equal hashes, or hashes that take arbitrarily long to compute. No class of a file is looked up,
imported or called: stand-ins have the class's name and take a state.
"""

import pickle
from collections import OrderedDict
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar

from dancedata.core.text import shown

#: Bound of integer keys and of memo indices: only a handful of integers below it share a hash.
MAX_KEY = 1 << 63


class UnsafePickleError(pickle.UnpicklingError):
    """A pickle names something that is not on the allow-list."""


def invalid(problem: str) -> pickle.UnpicklingError:
    """Return the error for a malformed pickle, or for content that no motion file needs."""
    return pickle.UnpicklingError(problem)


def mutable_set(members: object = ()) -> set[Any]:
    """Make a set of the members."""
    values: set[Any] = set()
    _add(values, _items(members))
    return values


def frozen_set(members: object = ()) -> frozenset[Any]:
    """Make a frozenset of the members."""
    return frozenset(mutable_set(members))


def ordered_dict(pairs: object = ()) -> OrderedDict[Any, Any]:
    """Make an OrderedDict of pairs; pickles of Python 2 hold them as a list of lists of two."""
    mapping: OrderedDict[Any, Any] = OrderedDict()
    for pair in _items(pairs):
        if type(pair) not in (list, tuple) or len(pair) != 2:
            raise invalid("an OrderedDict of something other than pairs")
        _put_items(mapping, pair)
    return mapping


def _items(value: object) -> Sequence[Any]:
    if not isinstance(value, list | tuple):
        raise invalid(f"a container built from a {type(value).__name__}")
    return value


def _require_keys(keys: Iterable[object], what: str) -> None:
    for key in keys:
        if type(key) is not str and not (type(key) is int and abs(key) < MAX_KEY):
            raise invalid(f"a {what} that is neither text nor a small integer: {shown(key)}")


# The handlers of opcodes; each takes the unpickler.


def _put_items(target: dict[Any, Any], items: Sequence[Any]) -> None:
    """Fill a dict with key, value, key, value, ..."""
    if len(items) % 2:
        raise invalid("a dict with a key without a value")
    _require_keys(items[::2], "key")
    target.update(zip(items[::2], items[1::2], strict=True))


def _set_items(unpickler: Any) -> None:
    items = unpickler.pop_mark()
    _put_items(_top(unpickler, dict), items)


def _set_item(unpickler: Any) -> None:
    value, key = unpickler.stack.pop(), unpickler.stack.pop()
    _put_items(_top(unpickler, dict), [key, value])


def _dict(unpickler: Any) -> None:
    items = unpickler.pop_mark()
    mapping: dict[Any, Any] = {}
    _put_items(mapping, items)
    unpickler.append(mapping)


def _append(unpickler: Any) -> None:
    value = unpickler.stack.pop()
    _top(unpickler, list).append(value)


def _appends(unpickler: Any) -> None:
    items = unpickler.pop_mark()
    _top(unpickler, list).extend(items)


def _add(target: set[Any], members: Iterable[Any]) -> None:
    _require_keys(members, "member of a set")
    target.update(members)


def _add_items(unpickler: Any) -> None:
    items = unpickler.pop_mark()
    _add(_top(unpickler, set), items)


def _frozen(unpickler: Any) -> None:
    items = unpickler.pop_mark()
    unpickler.append(frozen_set(items))


def _top(unpickler: Any, kind: type) -> Any:
    """Return the top of the stack, which must be a container of this kind."""
    target = unpickler.stack[-1]
    if not isinstance(target, kind):
        raise UnsafePickleError(f"a {type(target).__name__}, filled")
    return target


def _put(unpickler: Any) -> None:
    number = int(unpickler.readline()[:-1])
    if not 0 <= number < MAX_KEY:
        raise invalid("a memo index out of range")
    unpickler.memo[number] = unpickler.stack[-1]


def _refuse(unpickler: Any) -> None:
    raise UnsafePickleError("an object of a class, or an extension code")


class CheckedUnpickler(pickle._Unpickler):
    """The pure-Python unpickler, in which each opcode can be replaced by one that checks its operands."""

    dispatch: ClassVar[dict[int, Any]] = {
        **pickle._Unpickler.dispatch,
        pickle.SETITEM[0]: _set_item,
        pickle.SETITEMS[0]: _set_items,
        pickle.DICT[0]: _dict,
        pickle.APPEND[0]: _append,
        pickle.APPENDS[0]: _appends,
        pickle.ADDITEMS[0]: _add_items,
        pickle.FROZENSET[0]: _frozen,
        pickle.PUT[0]: _put,
        **{code[0]: _refuse for code in (pickle.EXT1, pickle.EXT2, pickle.EXT4)},
        **{code[0]: _refuse for code in (pickle.NEWOBJ, pickle.NEWOBJ_EX, pickle.OBJ)},
    }

    def _instantiate(self, klass: Any, args: Any) -> None:
        # Called by the opcode INST after its lookup of the class.
        _refuse(self)


class ClassName:
    """The name of a class in a pickle, which may be an argument. Not called.

    Attributes
    ----------
    name
        Module and name, for messages.
    makes
        Whether objects of it may be made.
    """

    def __init__(self, name: str, makes: bool = False) -> None:
        self.name = name
        self.makes = makes


class StandIn:
    """Stands for an object: the name of its class, and its attributes as the pickle sets them.

    Attributes
    ----------
    state
        Attributes by name; None until they are set, which happens once.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.state: dict[str, Any] | None = None


def make(kind: object, base: object = None, state: object = None) -> StandIn:
    """Make the stand-in of an object; as copyreg._reconstructor does, which old protocols use."""
    if not isinstance(kind, ClassName) or not kind.makes:
        raise UnsafePickleError(f"an object of {kind.name if isinstance(kind, ClassName) else type(kind).__name__}")
    if state is not None:
        raise invalid("an object that is made from another one")
    return StandIn(kind.name)


def default_dict(factory: object = None) -> dict[Any, Any]:
    """Make a plain dict for a collections.defaultdict; what it would make of missing keys is not used."""
    return {}


def new_object(unpickler: Any) -> None:
    """Handle the opcode NEWOBJ: make the stand-in of an object without arguments."""
    arguments = unpickler.stack.pop()
    kind = unpickler.stack.pop()
    if arguments != () or type(arguments) is not tuple:
        raise UnsafePickleError("an object that is made with arguments")
    unpickler.append(make(kind))


def set_state(target: StandIn, state: object) -> None:
    """Set the attributes of a stand-in."""
    if target.state is not None or not isinstance(state, dict):
        raise invalid(f"the state of a {target.name}")
    if any(type(name) is not str for name in state):
        raise pickle.UnpicklingError(f"the state of a {target.name}, whose keys are not names")
    target.state = state
