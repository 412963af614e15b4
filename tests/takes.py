"""Takes of clips without a build: their keys, and units of work on them."""

from collections.abc import Mapping, Sequence
from typing import Any

from dancedata.building.compute import Unit, make, units_of
from dancedata.building.inputs import Music
from dancedata.building.plugins import Maker
from dancedata.building.signals import SignalId
from dancedata.building.spine import expand
from dancedata.building.take import Dancer, Recording, SourceReader, Take, Time
from dancedata.core.clip import ClipRef
from dancedata.execution.cache import Cache
from dancedata.recipes.recipe import Recipe


def take_of(
    recipe: Recipe,
    clips: Sequence[tuple[ClipRef, str]],
    content: Mapping[str, str] | None = None,
    signal: SignalId | None = None,
) -> Take:
    """Return the take of clips, of which each has the hash of its file, after the transforms of a recipe."""
    recording = Recording(SourceReader(recipe.dataset, content or {}), tuple(clips))
    dancers = tuple(Dancer(ref.id, ref, sha, Music(signal, bpm=ref.tempo_bpm)) for ref, sha in clips)
    take = Take(recording, dancers, Time(600, recipe.grid.rate), group=clips[0][0].group)
    return expand([take], recipe.parts.transforms)[0]


def makers_of(recipe: Recipe) -> dict[str, Maker]:
    """Return fields and annotators by name."""
    parts = recipe.parts
    return {maker.name: maker for maker in (*parts.fields, *parts.annotators)}  # type: ignore[attr-defined]


def keys_of(recipe: Recipe, take: Take, dancer: int = 0) -> dict[str, str]:
    """Return the keys of what is made of a dancer, by field and annotator."""
    asks = {name: maker.asks(take) for name, maker in makers_of(recipe).items()}
    return {name: of[dancer].key for name, of in asks.items() if of}


def unit_of(maker: Maker, take: Take) -> Unit:
    """Return the unit of work that makes a result of a take."""
    (unit,) = units_of([maker], [((maker.id, ""), maker.asks(take))])
    return unit


def made(cache: Cache, maker: Maker, take: Take) -> Any:
    """Return what a unit of work makes of the first dancer."""
    return make(cache, unit_of(maker, take))[maker.asks(take)[0].key]
