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
    """A take on its way through a build; each stage returns another one. A copy comes after its parent."""

    take: Take
    starts: tuple[int, ...] = ()  # first frames of windows; () if left out
    stay: tuple[int, ...] = ()  # numbers of the dancers that are left; () without `starts`
    rejects: tuple[Reject, ...] = ()
    made: Mapping[str, Sequence[Any]] = field(default_factory=dict)  # by maker and dancer
    segments: Mapping[str, Sequence[Sequence[Segment]]] = field(default_factory=dict)  # by annotator, of each dancer

    def without(self, lost: Mapping[int, Sequence[Reject]]) -> Result:
        """Return the result without the dancers that have a reject, which replaces the rejects of their windows."""
        gone = {k: of[0] for k, of in lost.items() if of and k in self.stay}
        stay = tuple(k for k in self.stay if k not in gone)
        rejects = {self.take.dancers[k].id: reject for k, reject in gone.items()}
        said = [reject for reject in self.rejects if reject.clip not in rejects]
        said += [replace(reject, clip=clip) for clip, reject in rejects.items()]
        return replace(self, starts=self.starts if stay else (), stay=stay, rejects=tuple(said))

    def left_out(self, rejects: Sequence[Reject]) -> Result:
        """Return the result without windows, for these reasons."""
        return replace(self, starts=(), stay=(), rejects=(*self.rejects, *rejects))
