"""dancedata build --part 3/16: a share of a build's units of work, for job arrays; a build afterwards collects."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from heapq import heappop, heappush
from pathlib import Path
from typing import Any

from dancedata.building.arguments import BuildArguments, RecipeLike, jobs_of
from dancedata.building.build import workers_for
from dancedata.building.clips import compute_clips, sources_of, with_found_starts
from dancedata.building.left_out import require_no_rejects
from dancedata.building.sources import Sources, scan_source
from dancedata.building.stored import BuiltClips
from dancedata.core.arguments import Overrides
from dancedata.core.clip import ClipRef
from dancedata.core.errors import UsageError
from dancedata.execution.cache import Cache
from dancedata.execution.progress import Progress
from dancedata.recipes.recipe import resolve


@dataclass(frozen=True)
class Part:
    """The `number`-th (from 1) of `count` parts."""

    number: int
    count: int

    @classmethod
    def parse(cls, text: str) -> Part:
        """Read "3/16"; UsageError for anything else."""
        match = re.fullmatch(r"([0-9]{1,6})/([0-9]{1,6})", text.strip())
        if not match or not 1 <= int(match[1]) <= int(match[2]):
            raise UsageError("a part is NUMBER/COUNT", found=repr(text), allowed="such as 1/16 to 16/16")
        return cls(int(match[1]), int(match[2]))

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def of(self, clips: Sequence[ClipRef]) -> tuple[ClipRef, ...]:
        """Return the clips of this part, in their order: songs and groups whole, the largest to the emptiest part."""
        songs: dict[str, list[ClipRef]] = defaultdict(list)
        for ref in clips:
            songs[str(ref.audio_path) if ref.audio_path is not None else f"\0{ref.group or ref.id}"].append(ref)
        sizes = [(0, number) for number in range(1, self.count + 1)]
        chosen: set[str] = set()
        for of_song in sorted(songs.values(), key=lambda of_song: (-len(of_song), of_song[0].id)):
            size, number = heappop(sizes)
            heappush(sizes, (size + len(of_song), number))
            if number == self.number:
                chosen.update(ref.id for ref in of_song)
        return tuple(ref for ref in clips if ref.id in chosen)


@dataclass(frozen=True)
class PartResult:
    """The result of a part: its clips, those of the source, its songs, and counts of clips left out."""

    part: Part
    clips: int
    clips_in_all: int
    songs: int
    left_out: dict[str, int]

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {**self.__dict__, "part": str(self.part)}

    def __str__(self) -> str:
        text = f"part {self.part}: {self.clips} of {self.clips_in_all} clips, {self.songs} songs, all in the cache"
        return text + "".join(f"\n  will be left out: {reason}: {n}" for reason, n in self.left_out.items())


def build_part(
    recipe: RecipeLike,
    source: str | Path | None,
    part: Part,
    *,
    out: str | Path | None = None,
    overrides: Overrides = (),
    jobs: int | None = 1,
    strict: bool = False,
    cache: str | Path | None = None,
    progress: bool = True,
) -> PartResult:
    """Compute a part's units into the cache, for a build of the whole; parts may run at the same time."""
    arguments = BuildArguments.of(recipe, source, out, overrides)
    reporter, source, jobs = Progress(quiet=not progress), arguments.source.absolute(), jobs_of(jobs)
    reporter.announce(f"computing part {part} of {arguments.recipe.name} from {arguments.source}")
    build_cache = Cache.at(cache)
    # As in the build that collects: what depends on the machine is in the keys.
    recipe = resolve(arguments.recipe, build_cache.file_sha256)
    scanned = scan_source(recipe.dataset, recipe.parts.fields, source)
    clips = part.of(scanned.clips)
    with workers_for(recipe, source, build_cache, jobs) as workers:

        def run(cache: Cache) -> tuple[Sources, BuiltClips]:
            # Of all clips: offsets are compared with those of other songs.
            scan = with_found_starts(cache, recipe.dataset, scanned, jobs=workers, progress=reporter)
            ids = {clip.id for clip in clips}
            share = replace(scan, clips=tuple(clip for clip in scan.clips if clip.id in ids), rejects=())
            sources = sources_of(cache, recipe, share, jobs=workers, progress=reporter)
            require_no_rejects(strict, sources.rejects, scan)
            computed = compute_clips(cache, recipe, sources, jobs=workers, progress=reporter)
            require_no_rejects(strict, computed.rejects, scan, computed.quality)
            return sources, computed

        sources, computed_part = build_cache.retry_lost(run, reporter)
    left_out = Counter(reject.reason for reject in computed_part.rejects)
    songs = {clip.signal.path for clip in sources.clips if clip.signal is not None}
    return PartResult(part, len(clips), len(scanned.clips), len(songs), dict(sorted(left_out.items())))
