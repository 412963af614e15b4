"""AIST++ (Li et al. 2021): dance to music in ten genres, 1,408 sequences, 60 FPS.

Two layouts are in use, and told apart by what is found. The official one, where the music comes apart, one
file a song, and is put next to the motion by hand:

.. code-block:: text

    SOURCE/motions/gBR_sBM_cAll_d04_mBR2_ch08.pkl   smpl_poses (N, 72), smpl_trans (N, 3), smpl_scaling (1,)
    SOURCE/wavs/mBR2.wav                            or music/, audio/, musics/, SOURCE; wav, flac, mp3, ogg
    SOURCE/cameras/mapping.txt                      optional: all sequence names
    SOURCE/splits/crossmodal_{train,val,test}.txt   optional
    SOURCE/ignore_list.txt                          optional; may lie in splits/ too

and EDGE's (Tseng et al. 2023), where each sequence has a file of its own, cut to its length:

.. code-block:: text

    SOURCE/edge_aistpp/motions/gBR_sBM_cAll_d04_mBR2_ch08.pkl
    SOURCE/edge_aistpp/wavs/gBR_sBM_cAll_d04_mBR2_ch08.wav

SOURCE may be the folder with ``motions/`` or the one above it. Where a sequence has both kinds of music, its
own file is taken. Facts (tempos, split rule, ignore list, copies) are in ``manifests/aistpp.yaml``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal

from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.datasets._source import relative
from dancedata.datasets.aistpp.facts import SequenceName, facts, parse_name, tempo_bpm
from dancedata.datasets.aistpp.layout import (
    Folders,
    MotionFiles,
    MusicFiles,
    find_folders,
    layout_name,
    list_motions,
    list_music,
    music_expected,
    near_music,
    unused_music,
)
from dancedata.datasets.aistpp.load import load_motion
from dancedata.datasets.aistpp.notes import clip_notes, count_notes, ignored_notes, layout_notes
from dancedata.datasets.aistpp.splits import (
    ALL,
    Ignored,
    Splits,
    find_ignored,
    find_splits,
    missing_motion,
)

__all__ = ["AistPP"]


@DATASETS.register("aist++")
@dataclass(frozen=True)
class AistPP(Dataset):
    """AIST++, from the published files.

    Attributes
    ----------
    split : name of the split. ``SOURCE/splits/<split>_train.txt``, ``_val.txt``, ``_test.txt`` are read; if
        one of them is there the files alone decide, and a missing one is an empty split. Without files
        ``crossmodal`` follows the rule over the names. ``all`` puts every clip into one split of that name.
    split_dir : folder with split files of one's own, relative to the source or absolute; only it is searched.
    ignore : ``list`` leaves out the sequences on the ignore list: the source's ``ignore_list.txt`` (even an
        empty one), else the official list, which is shipped. ``none`` keeps them.
    music : ``required`` sets sequences without music aside; ``optional`` keeps them, without audio.
    """

    split: str = field(default="crossmodal", metadata={"scan": True})
    split_dir: str | None = field(default=None, metadata={"path": True})
    ignore: Literal["list", "none"] = field(default="list", metadata={"scan": True})
    music: Literal["required", "optional"] = field(default="required", metadata={"scan": True})

    version: ClassVar[int] = 1
    licence: ClassVar[str] = (
        "Annotations: CC BY 4.0 (Google LLC). The AIST music and video have terms of their own: "
        "research use, no redistribution."
    )
    citation: ClassVar[str] = (
        "Li et al., AI Choreographer: Music Conditioned 3D Dance Generation with AIST++, ICCV 2021. "
        "Tsuchida et al., AIST Dance Video Database: Multi-genre, Multi-dancer, and Multi-camera Database "
        "for Dance Information Processing, ISMIR 2019."
    )

    def __post_init__(self) -> None:
        _one_of("ignore", self.ignore, ("list", "none"))
        _one_of("music", self.music, ("required", "optional"))
        if not self.split or Path(self.split).name != self.split:
            raise UsageError(
                "aist++: split is a name, not a path",
                found=repr(self.split),
                allowed="crossmodal, all, or NAME of files NAME_train.txt",
                fix="name the folder of the files in split_dir",
            )
        if self.split == ALL and self.split_dir is not None:
            raise UsageError(
                "aist++: split 'all' reads no split files",
                found=f"split_dir {self.split_dir!r}",
                fix="leave split_dir out, or name a split",
            )

    @property
    def genre_ids(self) -> Mapping[str, int]:
        """Lodge's number of each genre, by the name that clips carry: ``gBR`` is 0."""
        return facts().genre_ids

    def scan(self, source: Path) -> Scan:
        """List what is there; reads names and lists, no motion and no music.

        Returns
        -------
        Scan
            Clips by name with split, song, tempo (BPM), genre and dancer. Rejects, each by name: ``ignored``,
            ``unassigned`` (in no split), ``missing_music``, ``missing_motion`` (in a split, but no pickle),
            ``unused_music``, ``extra_file``. Notes say what was recognised and by what.

        Raises
        ------
        SourceError
            If this is no AIST++ folder, or its lists are unusable. Says what was looked for and is there.
        """
        folders = find_folders(Path(source))
        motions = list_motions(folders)
        music = list_music(folders)
        splits = find_splits(folders, self.split, self.split_dir)
        ignored = find_ignored(folders, self.ignore == "list", self.split_dir)
        clips, left_out = self._sort_out(folders, motions, music, splits, ignored)
        missing = [
            Reject("missing_motion", clip=name, detail=f"listed, but there is no motions/{name}.pkl")
            for name in missing_motion(splits, ignored, motions.files)
        ]
        notes = (
            *layout_notes(folders, motions, music),
            *count_notes(folders, motions, len(missing)),
            *splits.notes,
            *ignored_notes(motions, ignored),
            *clip_notes(clips, left_out, splits),
        )
        rejects = (
            *left_out,
            *missing,
            *unused_music(folders, motions, music),
            *music.rejects,
            *motions.rejects,
        )
        return Scan(layout=layout_name(motions, music), clips=tuple(clips), rejects=rejects, notes=notes)

    def load(self, ref: ClipRef) -> Motion:
        """Read the motion of one clip: 60 FPS, metres, radians, +Y up, skeleton SMPL24.

        Raises
        ------
        DataError
            If the file is no good; `.reason` says in which way, see `_aistpp_load.load_motion`.
        """
        return load_motion(ref.motion_path, facts().frame_rate)

    def make_example(self, folder: Path) -> None:
        """Write four synthetic clips of six seconds in the official layout."""
        from dancedata.synthetic import write_synthetic

        write_synthetic(folder, seed=0, songs=2, clips_per_song=2, clip_s=6.0)

    def _sort_out(
        self, folders: Folders, motions: MotionFiles, music: MusicFiles, splits: Splits, ignored: Ignored
    ) -> tuple[list[ClipRef], list[Reject]]:
        """Every pickle becomes a clip, or is left out for one reason."""
        clips = []
        rejects = []
        near, expected = near_music(folders, music), music_expected(folders, music)
        for name, path in sorted(motions.files.items()):
            parts = parse_name(name)
            if parts is None:  # list_motions lets no such name through
                continue
            file = relative(path, folders.source)
            split = splits.split(name)
            audio = music.files.get(name) or music.files.get(parts.music)
            fix = ""
            if audio is None:
                fix = near.fix(expected + parts.music, expected + name)
            if name in ignored.names:
                rejects.append(Reject("ignored", clip=name, file=file, detail=f"on {ignored.where}"))
            elif not split:
                rejects.append(Reject("unassigned", clip=name, file=file, detail=f"in no {splits.name} split"))
            elif audio is None and self.music == "required":
                detail = f"neither {name} nor {parts.music} as wav, flac, mp3 or ogg"
                rejects.append(
                    Reject("missing_music", clip=name, file=file, detail=detail, music=parts.music, fix=fix)
                )
            else:
                clips.append(replace(_clip(parts, path, audio, split, splits), music_fix=fix))
        return clips, rejects


def _clip(parts: SequenceName, path: Path, audio: Path | None, split: str, splits: Splits) -> ClipRef:
    tempo = tempo_bpm(parts.music)
    notes = () if tempo is not None else (f"no tempo is known for the music {parts.music}",)
    return ClipRef(
        id=parts.id,
        motion_path=path,
        audio_path=audio,
        split=split,
        music=parts.music,
        tempo_bpm=tempo,
        genre=parts.genre,
        dancer=parts.dancer,
        lists=() if splits.of is None else (f"{splits.name}_{split}",),
        notes=notes,
    )


def _one_of(what: str, value: str, allowed: Sequence[str]) -> None:
    if value not in allowed:
        raise UsageError(
            f"aist++: unknown value for {what}",
            found=repr(value),
            allowed=", ".join(allowed),
            fix=f"set {what}",
        )
