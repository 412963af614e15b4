"""dancedata build --part 3/16: a share of a build's units of work, for job arrays; a build afterwards collects."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from heapq import heappop, heappush
from pathlib import Path
from typing import Any

from dancedata.core.clip import ClipRef
from dancedata.core.errors import UsageError
from dancedata.execution.cache import Cache, default_cache, with_lost_entries
from dancedata.execution.progress import Progress
from dancedata.pipeline.build import workers_for
from dancedata.pipeline.clips import ComputedClips, compute_clips
from dancedata.pipeline.rejects import stop_if_implausible, stop_if_strict
from dancedata.pipeline.sources import Sources, identify, scan_source
from dancedata.recipes.recipe import Recipe, resolve


@dataclass(frozen=True)
class Part:
    """The `number`-th (from 1) of `count` parts."""

    number: int
    count: int

    @classmethod
    def parse(cls, text: str) -> Part:
        """Read "3/16"; UsageError for anything else."""
        found = re.fullmatch(r"([0-9]{1,6})/([0-9]{1,6})", text.strip())
        if not found or not 1 <= int(found[1]) <= int(found[2]):
            raise UsageError("a part is NUMBER/COUNT", found=repr(text), allowed="such as 1/16 to 16/16")
        return cls(int(found[1]), int(found[2]))

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def of(self, clips: Sequence[ClipRef]) -> tuple[ClipRef, ...]:
        """Return the clips of this part, in the order given.

        All clips of a song are in one part, so that no song is decoded, and no feature computed, in two. Parts get
        about equal numbers of clips: songs are dealt out by their number of clips, the largest first, each to the
        part that has the fewest clips. The result depends on the clips alone.
        """
        songs: dict[str, list[ClipRef]] = defaultdict(list)
        for ref in clips:
            songs[str(ref.audio_path) if ref.audio_path is not None else f"\0{ref.id}"].append(ref)
        sizes = [(0, number) for number in range(1, self.count + 1)]
        mine: set[str] = set()
        for own in sorted(songs.values(), key=lambda own: (-len(own), own[0].id)):
            size, number = heappop(sizes)
            heappush(sizes, (size + len(own), number))
            if number == self.number:
                mine.update(ref.id for ref in own)
        return tuple(ref for ref in clips if ref.id in mine)


@dataclass(frozen=True)
class PartResult:
    """What a part did: clips and songs in the source, in the part, and clips of it that have to be left out."""

    part: Part
    clips_in_all: int
    clips: int
    songs: int
    left_out: dict[str, int]

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {
            "part": str(self.part),
            "clips": self.clips,
            "clips_in_all": self.clips_in_all,
            "songs": self.songs,
            "left_out": self.left_out,
        }

    def __str__(self) -> str:
        text = f"part {self.part}: {self.clips} of {self.clips_in_all} clips, {self.songs} songs, all in the cache"
        return text + "".join(f"\n  will be left out: {reason}: {n}" for reason, n in self.left_out.items())


def build_part(
    recipe: Recipe,
    source: Path,
    part: Part,
    *,
    jobs: int = 1,
    strict: bool = False,
    cache: Path | None = None,
    progress: Progress | None = None,
) -> PartResult:
    """Compute a part's units of work into the cache; writes no dataset.

    Parts may run at the same time, on any machines that share the cache and the source, in any order and more
    than once. A build of the whole afterwards finds all in the cache, and computes what is not there.

    Parameters
    ----------
    part
        Which of how many.
    strict
        Stop at the part's first broken clip.

    Raises
    ------
    SourceError
        If the source cannot be used.
    DataError
        With `strict`, for the first broken clip.
    """
    progress = progress or Progress(quiet=True)
    source = source.absolute()
    store_cache = Cache((cache or default_cache()).absolute())
    # As in the build that collects: what depends on the machine is in the keys.
    recipe = resolve(recipe, store_cache.file_sha256)
    scan = scan_source(recipe, source)
    mine = part.of(scan.clips)
    share = replace(scan, clips=mine, rejects=())
    with workers_for(recipe, source, store_cache, jobs) as workers:

        def run(cache: Cache) -> tuple[Sources, ComputedClips]:
            sources = identify(cache, recipe, share, jobs=workers, progress=progress)
            stop_if_strict(strict, sources.rejects, scan)
            found = compute_clips(cache, recipe, sources, jobs=workers, progress=progress)
            stop_if_strict(strict, found.rejects, scan)
            stop_if_implausible(strict, found.quality)
            return sources, found

        sources, found = with_lost_entries(store_cache, run, progress)
    left_out = Counter(reject.reason for reject in found.rejects)
    songs = {clip.signal.path for clip in sources.clips if clip.signal is not None}
    return PartResult(part, len(scan.clips), len(mine), len(songs), dict(sorted(left_out.items())))
