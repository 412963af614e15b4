"""Stage 5, extracted clips -> clips to store."""

from __future__ import annotations

from dancedata.pipeline.features import ExtractedClip
from dancedata.recipes.recipe import Recipe
from dancedata.store import StoredClip


def stored_clip(recipe: Recipe, clip: ExtractedClip) -> StoredClip:
    """Return a clip as it is stored."""
    ref, motion = clip.source.ref, clip.motion
    return StoredClip(
        id=ref.id,
        split=ref.split,
        genre=ref.genre,
        music=ref.music,
        dancer=ref.dancer,
        tempo_bpm=ref.tempo_bpm,
        n_flags=len(motion.flags),
        trim_start=motion.trim_start,
        height_m=motion.height_m,
        source_rate=str(motion.source_rate),
        lists=ref.lists,
        n_frames=motion.n_frames,
        starts=clip.starts,
        motion=motion.stored(recipe, clip.starts),
        audio=dict(clip.audio),
    )
