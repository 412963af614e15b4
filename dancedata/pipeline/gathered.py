"""What a build knows so far, from a source folder to clips ready to store."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import StoreError
from dancedata.core.hashing import json_sha256
from dancedata.pipeline.audio import SignalId
from dancedata.recipes.recipe import Recipe


@dataclass
class Gathered:
    """What a build knows so far.

    Attributes
    ----------
    refs
        Clips still in the build, by id.
    rejects
        All that was left out.
    motion_sha, signals
        Identity of every clip's files.
    content
        Hashes of files that the dataset's parameters name, such as a body model.
    audio_problems
        Clips whose music is missing or broken. Their motion is looked at all the same, so that a build names
        all that is wrong; then they are set aside.
    """

    recipe: Recipe
    scan: Scan
    refs: dict[str, ClipRef]
    rejects: list[Reject]
    motion_sha: dict[str, str] = field(default_factory=dict)
    signals: dict[Path, SignalId] = field(default_factory=dict)
    audio_problems: dict[str, Reject] = field(default_factory=dict)
    quality: list[dict[str, Any]] = field(default_factory=list)
    content: dict[str, str] = field(default_factory=dict)

    def drop(self, clip: str, reject: Reject) -> None:
        """Set a clip aside."""
        self.refs.pop(clip, None)
        self.rejects.append(reject if reject.clip else replace(reject, clip=clip))

    def signal(self, ref: ClipRef) -> SignalId | None:
        """Return the identity of a clip's music."""
        return self.signals.get(ref.audio_path) if ref.audio_path is not None else None

    def need_signal(self, ref: ClipRef) -> SignalId:
        """Return the identity of a clip's music; StoreError if it has none."""
        signal = self.signal(ref)
        if signal is None:
            raise StoreError("a clip without music reached the audio features", where=f"clip {ref.id}")
        return signal

    def inputs(self) -> dict[str, tuple[list[Any], str, str | None]]:
        """Return by clip what goes into it: its metadata, and the hashes of its motion and music."""
        found = {}
        for clip, ref in self.refs.items():
            signal = self.signal(ref)
            about = [ref.id, ref.split, ref.music, ref.tempo_bpm, ref.genre, ref.dancer, ref.lists, ref.declared]
            found[clip] = (about, self.motion_sha[clip], signal.sha256 if signal else None)
        return found

    def source_sha256(self) -> str:
        """Return a hash of all that went in: clips with their files' contents, and what was left out."""
        problems = [*self.rejects, *self.audio_problems.values()]
        left_out = sorted([r.reason, r.clip, Path(r.file).name] for r in problems)
        return json_sha256({"clips": list(self.inputs().values()), "left_out": left_out, "content": self.content})


def window_numbers(recipe: Recipe, starts: Sequence[int]) -> tuple[int, ...]:
    """Return the numbers of windows among all those of their clip."""
    return tuple(map(recipe.windows.number, starts))
