"""FACT (mint): TFRecords of motion and music at 60 frames per second."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.errors import UsageError
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.exports._aist import PARTS, is_ignored, needs_aist_names, note_ignored
from dancedata.exports.base.job import EXPORTS, Export, ExportJob, Missing
from dancedata.exports.base.needs import needs_field, needs_music_from_start, needs_splits

if TYPE_CHECKING:
    from dancedata.files.atomic_folder import AtomicFolder
    from dancedata.kernel import Clip


#: Castagnoli's polynomial, bits reversed.
_POLYNOMIAL = 0x82F63B78
Feature = bytes | npt.NDArray[np.float32] | tuple[int, ...]


def record(payload: bytes) -> bytes:
    """Return the record of a payload."""
    length = struct.pack("<Q", len(payload))
    return b"".join((length, _masked(crc32c(length)), payload, _masked(crc32c(payload))))


def example(features: Mapping[str, Feature]) -> bytes:
    """Return a serialised tf.train.Example: bytes as one value, arrays flat as float32, tuples as int64."""
    entries = b"".join(
        _field(1, _field(1, name.encode()) + _field(2, _feature(value))) for name, value in sorted(features.items())
    )
    return _field(1, entries)


def crc32c(data: bytes) -> int:
    """Return the CRC-32C (Castagnoli) of data."""
    table, remainder = _compiled()
    return int(remainder(np.frombuffer(data, np.uint8), table)) ^ 0xFFFFFFFF


@lru_cache(maxsize=1)
def _compiled() -> tuple[npt.NDArray[np.uint32], Any]:
    """Return the remainders of all bytes, and the loop over the bytes of data."""
    from numba import njit

    table = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        table = np.where(table & 1, (table >> np.uint32(1)) ^ np.uint32(_POLYNOMIAL), table >> np.uint32(1))

    def remainder(data: npt.NDArray[np.uint8], table: npt.NDArray[np.uint32]) -> int:
        state = 0xFFFFFFFF
        for byte in data:
            state = table[(state ^ byte) & 0xFF] ^ (state >> 8)
        return state

    return table, njit(remainder)


def _masked(crc: int) -> bytes:
    rotated = (crc >> 15 | crc << 17) & 0xFFFFFFFF
    return struct.pack("<I", (rotated + 0xA282EAD8) & 0xFFFFFFFF)


def _feature(value: Feature) -> bytes:
    if isinstance(value, bytes):
        return _field(1, _field(1, value))
    if isinstance(value, tuple):
        return _field(3, _field(1, b"".join(map(_varint, value))))
    return _field(2, _field(1, np.ascontiguousarray(value, "<f4").tobytes()))


def _field(number: int, content: bytes) -> bytes:
    """Return a length-delimited field (wire type 2)."""
    return _varint(number << 3 | 2) + _varint(len(content)) + content


def _varint(value: int) -> bytes:
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*encoded, value])


_MOTION, _RATE = "fact219", 60
#: Frames of a training example: the loader cuts this many frames of music from a random place in the motion.
_LEAST = 240
_SHARDS = 20
#: The seed with which mint's script draws the file of each record.
_SEED = 42
_GUIDE = """## Train

The configuration looks for `./data/aist_tfrecord-train-*` below the working folder. In a checkout of mint:

```sh
ln -s {out}/data data
python trainer.py --config_path ./configs/fact_v5_deeper_t10_cm12.config --model_dir CHECKPOINTS
```

- `fk_path` in the configuration names SMPL_MALE.pkl, which is not part of this export.
- Motion has 219 columns at 60 per second; the loader puts six zeros in front. Music has 35 columns at 60 per second,
  of the whole song. Motion ends where its music ends.
- mint's own create_input read such records with tensorflow 2.21. Its `*_pb2.py` are refused by protobuf 4 and later:
  compile the protocols first, `python -m grpc_tools.protoc -I. --python_out=. mint/protos/*.proto`.
"""


@EXPORTS.register("fact")
@dataclass(frozen=True)
class Fact(Export):
    """FACT's TFRecords aist_tfrecord-train and -testval, 20 files each (Li et al. 2021); needs no tensorflow.

    Attributes
    ----------
    feature
        Audio feature of 35 columns.
    unpaired
        How often each test motion is written with the music of another clip, drawn with a fixed seed among those to
        other songs. mint's script writes ten, without a seed, and may draw the motion's own song.
    """

    recipe: ClassVar[Mapping[str, Any]] = {"fps": _RATE, "motion": {_MOTION: {}}, "audio": {"librosa35": {}}}
    reference: ClassVar[str] = "google-research/mint, commit b8f8bdf, tools/preprocessing.py and mint/core/inputs.py"
    guide_text: ClassVar[str] = _GUIDE

    feature: str = "librosa35"
    unpaired: int = 0

    def __post_init__(self) -> None:
        if self.unpaired < 0:
            raise UsageError("unpaired is a number of copies", found=self.unpaired, allowed="0 and above")

    @override
    def missing(self, job: ExportJob) -> list[Missing]:
        missing = needs_field(job, _MOTION, kind="motion", width=219, rate=_RATE)
        missing += needs_field(job, self.feature, kind="audio", width=35, rate=_RATE)
        clips = _clips(job, "train") + _clips(job, "test")
        missing += needs_splits(job, "train", "test") + needs_aist_names(job, clips)
        missing += needs_music_from_start(clips, exactly=True)
        if not missing:
            for part in PARTS:
                if all(self._length(clip) < _LEAST for clip in _clips(job, part)):
                    problem = f"no sequence of {part} has {_LEAST} frames with music at {_RATE} per second"
                    missing.append(Missing(problem, "longer clips: FACT trains on four seconds"))
            long = [clip.id for clip in _clips(job, "test") if self._length(clip) >= _LEAST]
            songs = _songs(job)
            if self.unpaired and len({songs.get(clip) for clip in long}) < 2:
                problem = f"all sequences of test have the same song: {listed(songs.get(clip) for clip in long[:1])}"
                missing.append(Missing(problem, "several songs in test for unpaired motion, or unpaired=0"))
        return missing

    @override
    def write(self, job: ExportJob, folder: AtomicFolder) -> None:
        note_ignored(folder, job.clips())
        for part, name in (("train", "train"), ("test", "testval")):
            clips = _clips(job, part)
            short = [clip.id for clip in clips if self._length(clip) < _LEAST]
            if short:
                folder.note(
                    f"{counted(len(short), 'sequence')} of {part} left out, shorter than the {_LEAST} frames that "
                    f"the loader cuts: {listed(short)}"
                )
            kept = [clip for clip in clips if clip.id not in short]
            pairs = [(clip, clip) for clip in kept]
            if part == "test" and self.unpaired:
                pairs += self._unpaired(job, kept)
            self._write_part(job, folder, name, pairs)

    def _unpaired(self, job: ExportJob, clips: list[Clip]) -> list[tuple[Clip, Clip]]:
        """Return each clip with clips to other songs, by name and by samples."""
        songs = _songs(job)
        others = {clip.id: [c for c in clips if songs.get(c.id) != songs.get(clip.id)] for clip in clips}
        drawn = np.random.RandomState(_SEED).random_sample((self.unpaired, len(clips)))
        return [
            (clip, others[clip.id][int(x * len(others[clip.id]))])
            for row in drawn
            for clip, x in zip(clips, row, strict=True)
        ]

    def _length(self, clip: Clip) -> int:
        return min(len(clip.read(_MOTION)), len(clip.read_song(self.feature)))

    def _write_part(
        self, job: ExportJob, folder: AtomicFolder, name: str, pairs: Sequence[tuple[Clip, Clip]]
    ) -> None:
        shards = np.random.RandomState(_SEED).randint(0, _SHARDS, size=len(pairs))
        with ExitStack() as stack:
            files = [
                stack.enter_context(folder.open_file(f"data/aist_tfrecord-{name}-{k:05d}-of-{_SHARDS:05d}"))
                for k in range(_SHARDS)
            ]
            for (dance, song), shard in job.each(name, list(zip(pairs, shards.tolist(), strict=True))):
                files[shard].write(record(_example(dance, song, self.feature)))


def _songs(job: ExportJob) -> dict[str, str]:
    from dancedata.kernel import songs_of

    return songs_of(job.store.clips())


def _clips(job: ExportJob, part: str) -> list[Clip]:
    return [clip for clip in job.clips(*PARTS[part]) if not is_ignored(clip)]


def _example(dance: Clip, song: Clip, feature: str) -> bytes:
    music: npt.NDArray[np.float32] = song.read_song(feature).astype(np.float32)
    motion = dance.read(_MOTION)[: len(music)]
    return example(
        {
            "motion_name": dance.id.encode(),
            "motion_sequence": motion,
            "motion_sequence_shape": motion.shape,
            "audio_name": song.music.encode(),
            "audio_sequence": music,
            "audio_sequence_shape": music.shape,
        }
    )
