"""What a build knows of a take so far: its windows, its dancers, what was made of it, and what was left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

from dancedata.building.take import Take
from dancedata.core.clip import Reject
from dancedata.core.segments import Segment

if TYPE_CHECKING:  # workers need no store
    from dancedata.store.stored_clip import LazyArray


class Nothing(NamedTuple):
    """No rows, and why."""

    reason: str


class Rows(NamedTuple):
    """Rows in the cache, their key, and the row at frame 0."""

    array: LazyArray
    key: str
    offset: int = 0


@dataclass(frozen=True)
class Result:
    """A take on its way through a build; each stage returns another one.

    There are no `starts` without `stay`, nor the reverse; a copy comes after its parent.

    `starts`: First frames of the windows that are left; () for a take that is left out.
    `stay`: Numbers of the dancers that are left.
    `made`: By the maker's id, for each dancer: Rows, Nothing, a Reject, or JSON data of an annotator.
    `segments`: By annotator, of each dancer.
    """

    take: Take
    starts: tuple[int, ...] = ()
    stay: tuple[int, ...] = ()
    rejects: tuple[Reject, ...] = ()
    made: Mapping[str, Sequence[Any]] = field(default_factory=dict)
    segments: Mapping[str, Sequence[Sequence[Segment]]] = field(default_factory=dict)

    def without(self, lost: Mapping[int, Sequence[Reject]]) -> Result:
        """Return the result without the dancers that have a reject, which replaces the rejects of their windows.

        A take without dancers has no windows.
        """
        gone = {k: of[0] for k, of in lost.items() if of and k in self.stay}
        stay = tuple(k for k in self.stay if k not in gone)
        rejects = {self.take.dancers[k].id: reject for k, reject in gone.items()}
        said = [reject for reject in self.rejects if reject.clip not in rejects]
        said += [replace(reject, clip=clip) for clip, reject in rejects.items()]
        return replace(self, starts=self.starts if stay else (), stay=stay, rejects=tuple(said))

    def left_out(self, rejects: Sequence[Reject]) -> Result:
        """Return the result without windows, for these reasons."""
        return replace(self, starts=(), stay=(), rejects=(*self.rejects, *rejects))
