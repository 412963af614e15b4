"""Dataset: the base class of readers of sources."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import ClassVar

from dancedata.core.clip import ClipRef, Scan
from dancedata.core.motion import Motion
from dancedata.core.plugins.plugin import Plugin
from dancedata.core.segments import Segment
from dancedata.core.skeleton import Skeleton


class Dataset(Plugin):
    """Reader of a source folder: its clips, and the motion of each in canonical form.

    Attributes
    ----------
    licence, citation
        Text for the cards of datasets built from it.
    generates
        Whether `scan` writes a source that does not exist.
    explicit_only
        Whether it accepts many layouts, so that `check` takes it only by name, or where the folder has a listing.
    has_audio
        Whether clips have music; False where it was published as features alone.
    may_share_audio
        Whether the licence allows the music to be passed on, in a page or a video. False where that is unknown.
    may_share_motion
        Whether it allows what is made of the motion to be passed on, such as a built dataset. False where that is
        unknown.
    genre_ids
        The dataset's own number for each genre, for trainers that use it.
    """

    licence: ClassVar[str]
    citation: ClassVar[str]
    has_audio: ClassVar[bool] = True
    may_share_audio: ClassVar[bool] = False
    may_share_motion: ClassVar[bool] = False
    generates: ClassVar[bool] = False
    explicit_only: ClassVar[bool] = False

    @classmethod
    def has_listing(cls, source: Path) -> bool:
        """Whether the folder has a list of clips that is written for this reader."""
        return False

    @property
    def official_split(self) -> bool:
        """Whether the splits are published lists: what they share is then a note of `check`, not an error."""
        return False

    @property
    def genre_ids(self) -> Mapping[str, int]:
        """Number of each genre; empty where the dataset has none."""
        return {}

    def body_of(self, ref: ClipRef) -> Skeleton | None:
        """Return the body of the motion that `load` returns, without reading it; None if that is unknown."""
        return None

    @abstractmethod
    def scan(self, source: Path) -> Scan:
        """List the clips, without reading motion.

        SourceError if the folder is not a copy of the dataset, or its lists are missing or contradict each other.
        """

    @abstractmethod
    def load(self, ref: ClipRef) -> Motion:
        """Read one clip: metres, radians, +Y up. DataError, with a reject's code, for anything wrong with it."""

    def time_of(self, ref: ClipRef) -> tuple[int, Fraction, int] | None:
        """Return frames, frames per second and trim_start of what `load` returns, by a header; None: load it."""
        return None

    def load_group(self, refs: Sequence[ClipRef]) -> list[Motion]:
        """Read the dancers of one group into one world; by default each by itself."""
        return [self.load(ref) for ref in refs]

    def segments(self, ref: ClipRef) -> Sequence[Segment]:
        """Return what the source states of a clip in time, without reading motion; by default `ClipRef.segments`."""
        return ref.segments

    @abstractmethod
    def make_example(self, folder: Path) -> None:
        """Write a tiny source in this dataset's layout: 2-4 clips of about 6 s, with music. For tests."""
