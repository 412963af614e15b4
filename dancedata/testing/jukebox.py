"""Random Jukebox checkpoints in the layout of OpenAI's real files, for tests and benchmarks."""

from dancedata.audio.jukebox.weights.random_weights import TINY, RandomSource, random_checkpoint, write_torch_file

__all__ = ["TINY", "RandomSource", "random_checkpoint", "write_torch_file"]
