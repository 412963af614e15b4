"""A tiny source in AIST++'s official layout, made of synthetic motion and music; no captured data."""

from __future__ import annotations

from pathlib import Path

__all__ = ["write_example"]


def write_example(folder: Path) -> None:
    """Write four synthetic clips of six seconds to two songs."""
    from dancedata.synthetic import write_synthetic

    write_synthetic(folder, seed=0, songs=2, clips_per_song=2, clip_s=6.0)
