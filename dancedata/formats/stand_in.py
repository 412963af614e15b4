"""Stand-ins for classes that a pickle names: they have the class's name and take a state, and do nothing.

No class of a file is looked up, imported or called. What a stand-in means, for example which of its values is the
array, is decided by the reader that has allowed its class.
"""

from __future__ import annotations

import pickle
from typing import Any

from dancedata.formats.checked_unpickler import UnsafePickleError, invalid

__all__ = ["ClassName", "StandIn", "default_dict", "make", "new_object", "set_state"]


class ClassName:
    """The name of a class in a pickle, which may be an argument. Not called.

    Attributes
    ----------
    name : module and name, for messages.
    makes : whether objects of it may be made.
    """

    def __init__(self, name: str, makes: bool = False) -> None:
        self.name = name
        self.makes = makes


class StandIn:
    """Stands for an object: the name of its class, and its attributes as the pickle sets them.

    Attributes
    ----------
    state : attributes by name; None until they are set, which happens once.
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
