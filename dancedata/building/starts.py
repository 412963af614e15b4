"""Seconds of music that a source leaves to the build: audio_start_s auto."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

from dancedata.core.clip import FOUND, ClipRef, Scan
from dancedata.core.plugins import Dataset, Plugin
from dancedata.core.registry import Registry
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.execution.units import Jobs


class StartFinder(Plugin):
    """Finds the second of the music at frame 0 of clips."""

    @abstractmethod
    def find(
        self, cache: Cache, dataset: Dataset, scan: Scan, asked: Sequence[ClipRef], *, jobs: Jobs, progress: Progress
    ) -> Scan:
        """Return a scan with the offsets of the clips `asked`; those of unknown ones are rejects."""


STARTS = Registry("finder of offsets", "dancedata.alignment", StartFinder)


def with_found_starts(cache: Cache, dataset: Dataset, scan: Scan, *, jobs: Jobs, progress: Progress) -> Scan:
    """Return a scan with the offsets that its source leaves to the build; clips of unknown ones are rejects."""
    asked = [clip for clip in scan.clips if clip.audio_start_by == FOUND]
    return STARTS.only().find(cache, dataset, scan, asked, jobs=jobs, progress=progress) if asked else scan
