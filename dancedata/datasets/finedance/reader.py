"""FineDance (Li et al. 2023): full-body dance with hands to music in 16 genres, 211 sequences, 30 FPS.

The published archive, unpacked:

.. code-block:: text

    SOURCE/motion/001.npy        (T, 315): root translation 3, then 52 joints x 6D (two rows of the matrix)
    SOURCE/music_wav/001.wav     wav, flac, mp3 or ogg; motion and music both start at t = 0
    SOURCE/label_json/001.json   style1 (coarse), style2 (the genre), the song's name
    SOURCE/music_npy/001.npy     not read: music features are computed

SOURCE may be the folder with ``motion/`` or the one above it. Facts (splits, ignore lists, trims, genres) are in
``manifests/finedance.yaml``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Literal

from dancedata.core.bodies import SMPLX55
from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import UsageError, did_you_mean
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import Skeleton
from dancedata.datasets._source import relative
from dancedata.datasets.finedance.facts import facts
from dancedata.datasets.finedance.labels import read_label
from dancedata.datasets.finedance.layout import (
    Files,
    Folders,
    find_folders,
    list_labels,
    list_motions,
    list_music,
    music_fix,
)
from dancedata.datasets.finedance.lengths import length_note
from dancedata.datasets.finedance.load import load_motion
from dancedata.datasets.finedance.notes import (
    clip_notes,
    genre_notes,
    layout_notes,
    length_notes,
    list_notes,
    trim_notes,
)

__all__ = ["FineDance"]

ALL = "all"
WITHOUT_LABELS = "put labels into label_json/, or keep clips without genre: --set dataset.finedance.labels=optional"


@DATASETS.register("finedance")
@dataclass(frozen=True)
class FineDance(Dataset):
    """FineDance, from the published files.

    Attributes
    ----------
    split : ``cross_genre`` (every genre in train and test; it has no val) or ``cross_dancer`` (no dancer in two
        splits). What a split does not list and no ignore list names is train.
    keep : ids that stay in their split though the split's ignore list names them, as text (``["120"]``), or
        ``all``. Without it the ignore list wins, as in Lodge and FineDance.
    trim : take over the beginnings that Lodge cuts as the clips' ``trim_start``. The frames are kept either way.
    labels : ``required`` sets sequences aside whose label is missing or none of the 16 genres; ``optional`` keeps
        them, without genre.
    body_model : SMPL-X model file (.npz) to take the bones from; without it those that
        Lodge and FineDance publish are used. FineDance has no betas: all of it is on the neutral body.
    """

    split: Literal["cross_genre", "cross_dancer"] = field(default="cross_genre", metadata={"scan": True})
    keep: Literal["all"] | tuple[str, ...] = field(default=(), metadata={"scan": True})
    trim: bool = True
    labels: Literal["required", "optional"] = field(default="required", metadata={"scan": True})
    body_model: Path | None = field(default=None, metadata={"path": True, "content": True})

    version: ClassVar[int] = 1
    licence: ClassVar[str] = (
        "Non-commercial scientific research, education and art only (Tsinghua University's licence for the FineDance "
        "data); no redistribution, in whole or in part."
    )
    citation: ClassVar[str] = (
        "Li et al., FineDance: A Fine-grained Choreography Dataset for 3D Full Body Dance Generation, ICCV 2023."
    )

    def __post_init__(self) -> None:
        _one_of("split", self.split, tuple(facts().protocols))
        _one_of("labels", self.labels, ("required", "optional"))
        known = sorted(clip for listed in facts().ignore_lists.values() for clip in listed.ids)
        unknown = [] if self.keep == ALL else [clip for clip in self.keep if clip not in known]
        if unknown:
            raise UsageError(
                "finedance: keep names what no ignore list names",
                found=", ".join(map(repr, unknown)),
                allowed=f"all, or a list of {', '.join(known)}",
                fix="write ids as text, in quotes: ['120']",
            )

    @property
    def genre_ids(self) -> Mapping[str, int]:
        """Lodge's number of each genre, by the name that clips carry."""
        return facts().genre_ids

    def scan(self, source: Path) -> Scan:
        """List what is there; reads names, labels and, for the lengths, headers; no motion and no music.

        Returns
        -------
        Scan
            Clips by id with split, genre and the lists that name them. A clip's music is its id; without a file
            of that name it has no audio. Rejects, each by name: ``ignored``, ``missing_label``,
            ``broken_label``, ``unknown_genre``, ``unassigned`` (an id that FineDance does not have),
            ``missing_motion``, ``unused_music``, ``extra_file``. Notes say what was recognised, which lists
            apply, and which ids stand in two of them.

        Raises
        ------
        SourceError
            If this is no FineDance folder. Says what was looked for and is there.
        """
        folders = find_folders(Path(source))
        motions, music, labels = list_motions(folders), list_music(folders), list_labels(folders)
        kept = self._kept()
        clips, left_out = self._sort_out(folders, motions, music, labels)
        lengths = _lengths(clips)
        notes = (
            *layout_notes(folders, motions, music, labels),
            *list_notes(self.split, motions.files, kept),
            *trim_notes(clips, self.trim),
            *genre_notes(clips),
            *length_notes(lengths),
            *clip_notes(clips, left_out),
            *self._bones_note(),
        )
        rejects = (
            *left_out,
            *_missing_motion(motions, facts().ignored(self.split) - kept),
            *_without_motion(folders, motions, music, "unused_music"),
            *_without_motion(folders, motions, labels, "extra_file"),
            *music.rejects,
            *motions.rejects,
            *labels.rejects,
        )
        return Scan(layout="finedance", clips=tuple(clips), rejects=rejects, notes=notes)

    def load(self, ref: ClipRef) -> Motion:
        """Read the motion of one clip: 30 FPS, metres, radians, +Y up, SMPL-X's 55 joints, jaw and eyes still.

        The beginning that Lodge cuts follows from the clip's id.

        Raises
        ------
        DataError
            If the file is no good; `.reason` says in which way, see `_finedance_load.load_motion`.
        """
        trim = facts().trims.get(ref.id) if self.trim else None
        return load_motion(ref.motion_path, facts().frame_rate, self._skeleton(), trim.frames if trim else 0)

    def make_example(self, folder: Path) -> None:
        """Write four synthetic clips of six seconds: three of train, one of test; one has a beginning to cut."""
        from dancedata.datasets.finedance.example import write_example

        write_example(Path(folder))

    def _kept(self) -> frozenset[str]:
        """Ids of the split's ignore lists that stay all the same."""
        ignored = facts().ignored(self.split)
        return ignored if self.keep == ALL else ignored & set(self.keep)

    def _skeleton(self) -> Skeleton:
        if self.body_model is None:
            return SMPLX55
        from dancedata.formats.body_model import body_model_skeleton

        return body_model_skeleton(self.body_model)

    def _bones_note(self) -> tuple[str, ...]:
        """Name the body model; one that cannot be used is found here, before any clip is loaded."""
        if self.body_model is None:
            return ()
        return (f"Bones: of the body model {self.body_model.name} ({self._skeleton().name}).",)

    def _sort_out(
        self, folders: Folders, motions: Files, music: Files, labels: Files
    ) -> tuple[list[ClipRef], list[Reject]]:
        """Every motion file becomes a clip, or is left out for one reason."""
        clips = []
        rejects = []
        fix_of = music_fix(folders, music)
        for clip, path in sorted(motions.files.items()):
            file = relative(path, folders.source)
            reason, detail = self._not_of_the_split(clip)
            if reason:
                rejects.append(Reject(reason, clip=clip, file=file, detail=detail))
                continue
            label = read_label(labels.files.get(clip), clip)
            if label.problem and self.labels == "required":
                rejects.append(Reject(label.reason, clip=clip, file=file, detail=label.problem, fix=WITHOUT_LABELS))
                continue
            audio = music.files.get(clip)
            clips.append(
                ClipRef(
                    id=clip,
                    motion_path=path,
                    audio_path=audio,
                    split=facts().listed(self.split, clip) or "train",
                    music=clip,
                    genre=label.genre,
                    lists=facts().lists(clip),
                    notes=(label.problem,) if label.problem else (),
                    music_fix=fix_of(clip) if audio is None else "",
                )
            )
        return clips, rejects

    def _not_of_the_split(self, clip: str) -> tuple[str, str]:
        """Return why an id is in no split, as a code and in words; empty if it is in one."""
        if clip not in facts().ids:
            first, last = facts().ids[0], facts().ids[-1]
            detail = f"FineDance has {first} to {last}; the dataset `folder` takes data of one's own"
            return "unassigned", detail
        if clip not in facts().ignored(self.split) - self._kept():
            return "", ""
        lists = [name for name in facts().lists(clip) if name in facts().ignore_lists]
        split = facts().listed(self.split, clip)
        both = f", and in {self.split}.{split}; the ignore list wins" if split else ""
        return "ignored", f"on the list {' and '.join(lists)}{both}; keep: ['{clip}'] keeps it"


def _lengths(clips: list[ClipRef]) -> dict[str, str]:
    """Clips whose motion and music differ in length, and how."""
    rate = facts().frame_rate
    found = {c.id: length_note(c.motion_path, c.audio_path, rate) for c in clips if c.audio_path is not None}
    return {clip: note for clip, note in found.items() if note}


def _missing_motion(motions: Files, ignored: frozenset[str]) -> list[Reject]:
    missing = [clip for clip in facts().ids if clip not in motions.files and clip not in ignored]
    return [Reject("missing_motion", clip=clip, detail=f"there is no motion/{clip}.npy") for clip in missing]


def _without_motion(folders: Folders, motions: Files, files: Files, reason: str) -> list[Reject]:
    """Music or labels of which there is no motion."""
    return [
        Reject(reason, file=relative(path, folders.source), detail=f"there is no motion/{clip}.npy")
        for clip, path in files.files.items()
        if clip not in motions.files
    ]


def _one_of(what: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise UsageError(f"finedance: unknown {what} {value!r}", fix=did_you_mean(value, allowed))
