"""A synthetic dance corpus made from a seed: demo, test data and oracle at once.

On disk it is AIST++ in its official layout, plus what is known about it. Nothing in it was
captured, so it is CC0.

::

    SOURCE/motions/gBR_sBM_cAll_d04_mBR0_ch01.pkl   smpl_poses (N, 72), smpl_trans (N, 3), smpl_scaling (1,)
    SOURCE/wavs/mBR0.wav                            one file a song, PCM 16
    SOURCE/cameras/mapping.txt                      all clip names
    SOURCE/splits/crossmodal_{train,val,test}.txt
    SOURCE/ignore_list.txt
    SOURCE/truth/gBR_sBM_cAll_d04_mBR0_ch01.npz     beats, key poses, planted feet: the fields of MotionTruth
    SOURCE/truth/mBR0.npz                           beats, downbeats, chords, tempo
    SOURCE/synthetic.json                           the parameters; written last, without it nothing is there
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from dancedata.core.clip import ClipRef, Scan
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.datasets.aistpp import AistPP
from dancedata.synthetic.corpus import VERSION, is_example, write_example, write_synthetic

__all__ = ["Synthetic"]

#: They decide which clips are written; a written one is read the same way, whatever they are.
_SCAN = {"scan": True}


@DATASETS.register("synthetic")
@dataclass(frozen=True)
class Synthetic(Dataset):
    """Synthetic dance to synthetic music; written into the source folder on first use.

    Attributes
    ----------
    seed : every file follows from it; same seed, same bytes.
    songs : number of songs, 2..60. The first eleven cover all genres; three of them are test music.
    clips_per_song : number of clips danced to each song, 2..40.
    clip_s : length of the clips in seconds. One clip is a little shorter: 29 (mod 30) frames.
    split : "crossmodal", or "all" for every clip in one split, as for the dataset aist++.
    """

    seed: int = field(default=0, metadata=_SCAN)
    songs: int = field(default=11, metadata=_SCAN)
    clips_per_song: int = field(default=4, metadata=_SCAN)
    clip_s: float = field(default=13.5, metadata=_SCAN)
    split: str = field(default="crossmodal", metadata=_SCAN)

    version: ClassVar[int] = VERSION
    generates: ClassVar[bool] = True
    licence: ClassVar[str] = "CC0-1.0: made by a program, free of rights"
    citation: ClassVar[str] = "Synthetic corpus of dancedata; layout of AIST++ (Li et al., ICCV 2021)."

    def scan(self, source: Path) -> Scan:
        """List the clips of the corpus in `source`, writing it first if it is not there.

        Raises
        ------
        SourceError
            If `source` holds anything but this corpus; nothing is overwritten.
        """
        source = Path(source)
        example = is_example(source, **self._size())
        if not example:
            write_synthetic(source, **self._size())
        scan = self._reader().scan(source)
        note = ("this is the small example, not the whole synthetic corpus",) if example else ()
        return dataclasses.replace(scan, layout="synthetic", notes=scan.notes + note)

    def load(self, ref: ClipRef) -> Motion:
        """Motion of one clip; see the dataset aist++."""
        return self._reader().load(ref)

    def make_example(self, folder: Path) -> None:
        """Write four clips of six seconds to two songs: two of train, one of val, one of test.

        `scan` takes the folder for this dataset's, whatever its own size is, and notes that it is an example.
        """
        write_example(folder, **self._size())

    def _size(self) -> dict[str, Any]:
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        del fields["split"]  # says how the corpus is read, not what is in it
        return fields

    def _reader(self) -> AistPP:
        return AistPP(split=self.split)
