"""The reader of FineDance; the tree on disk is in the package's docstring."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Literal

from dancedata.core.bodies import SMPLX55
from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.datasets.files import ALL, Files, clips_note, require_choices
from dancedata.datasets.finedance.facts import MAX_DIFFERENCE, facts
from dancedata.datasets.finedance.layout import (
    LABELS,
    LAYOUT,
    MOTION,
    MUSIC,
    list_labels,
    list_music,
    not_read_notes,
    read_label,
)
from dancedata.datasets.layout import Folders
from dancedata.files.listing import relative


def layout_notes(folders: Folders, motions: Files, music: Files, labels: Files) -> list[str]:
    """Return the layout, the files it was recognised by, and their numbers."""
    at = relative(folders.root / MOTION, folders.source)
    parts = []
    for name, files in ((MUSIC, music), (LABELS, labels)):
        number = counted(len(files.files), "file") if (folders.root / name).is_dir() else "missing"
        parts.append(f"{name}/ ({number})")
    text = f"Layout: FineDance, by {at}/001.npy and so on; {' and '.join(parts)}."
    n = len(motions.files)
    n_official = sum(clip in motions.files for clip in facts().ids)
    count = f"Motion: {counted(n, 'file')} found; FineDance has {len(facts().ids):,} sequences"
    count += (
        f", {len(facts().ids) - n_official:,} of which have no file here." if n_official < len(facts().ids) else "."
    )
    if n > n_official:
        count += f" {n - n_official:,} more have unknown ids, and are in no split (unassigned)."
    return [text, *not_read_notes(folders), *music.notes, count]


def list_notes(protocol: str, present: Collection[str], kept: Collection[str]) -> list[str]:
    """Return the split and ignore lists in use, ids on two lists, and which list decides."""
    lists, ignored = facts().protocols[protocol], facts().ignored(protocol)
    sizes = f"{len(lists.val):,} in val, {len(lists.test):,} in test, all others in train"
    notes = [f"Splits: {protocol}: {sizes}, except ignored ids."]
    if not lists.val:
        notes.append(f"Splits: {protocol} has no val; Lodge and FineDance evaluate only after training.")
    applied = [f"{name} ({i.source})" for name, i in facts().ignore_lists.items() if protocol in i.applies_to]
    number = f"{len(ignored):,} ids, {len(ignored & set(present)):,} of them among the motion files found"
    notes.append(f"Ignore list: {', '.join(applied)}: {number}.")
    both = sorted(clip for clip in ignored if facts().listed(protocol, clip))
    if both:
        names = ", ".join(f"{clip} ({facts().listed(protocol, clip)})" for clip in both)
        stay = sorted(set(both) & set(kept))
        outcome = (
            f"{listed(stay)} kept, as requested"
            if stay
            else "the ignore list takes precedence, as in Lodge and FineDance"
        )
        rest = "; for the others the ignore list takes precedence" if stay and len(stay) < len(both) else ""
        notes.append(f"In two lists: {names} and ignored; {outcome}{rest}. `keep` lists ids to keep.")
    if kept:
        notes.append(f"Ignore list: {listed(sorted(kept), 12)} not ignored, as requested.")
    for name, other in facts().ignore_lists.items():
        stay = sorted(clip for clip in other.ids if protocol not in other.applies_to and clip in present)
        if stay:
            where = ", ".join(f"{clip} ({facts().listed(protocol, clip) or 'train'})" for clip in stay)
            notes.append(f"Ignore list: {where} not ignored here; {other.source} leaves them out (list {name}).")
    return notes


def trim_notes(clips: Sequence[ClipRef], trim: bool) -> list[str]:
    """Return the clips with a beginning that should be trimmed."""
    trims = {clip.id: facts().trims[clip.id].frames for clip in clips if clip.id in facts().trims}
    if not trims:
        return []
    cuts = listed((f"{clip} ({frames:,} frames)" for clip, frames in sorted(trims.items())), 12)
    if not trim:
        return [f"Trims: not applied, as requested; Lodge trims the beginning of {cuts}."]
    return [f"Trims: Lodge trims the beginning of {cuts}. The frames are kept; trim_start is the first of the dance."]


def genre_notes(clips: Sequence[ClipRef]) -> list[str]:
    """Return the number of genres, and clips that are kept despite a problem with their label."""
    n = len({clip.genre for clip in clips if clip.genre})
    notes = [f"Genres: {n:,} of {len(facts().genre_ids):,}, from style2 of the labels, with Lodge's names."]
    unlabelled = [f"{clip.id} ({'; '.join(clip.notes)})" for clip in clips if not clip.genre]
    if unlabelled:
        n_clips = counted(len(unlabelled), "clip")
        notes.append(f"Genres: {n_clips} kept without a genre, as requested: {listed(unlabelled, 3)}.")
    return notes


def length_notes(differing: Mapping[str, str]) -> list[str]:
    """Return the clips whose motion and music differ in length."""
    if not differing:
        return []
    which = listed((f"{clip} ({lengths})" for clip, lengths in differing.items()), 12)
    return [
        f"Lengths: motion and music differ by more than {MAX_DIFFERENCE} frames in "
        f"{counted(len(differing), 'clip')}: {which}. The shorter one counts: windows without music are left "
        "out (no_audio)."
    ]


def clip_notes(clips: Sequence[ClipRef], left_out: Sequence[Reject]) -> list[str]:
    """Return the numbers of clips by split, left out, and without music."""
    notes = [clips_note(clips, left_out)]
    silent = [clip.id for clip in clips if clip.audio_path is None]
    if silent:
        notes.append(
            f"Music: {counted(len(silent), 'clip')} without a file in {MUSIC}/ ({listed(silent)}); only a recipe "
            "without audio features keeps them."
        )
    return notes


WITHOUT_LABELS = "add labels to label_json/, or keep clips without a genre: --set dataset.finedance.labels=optional"


@DATASETS.register("finedance")
@dataclass(frozen=True)
class FineDance(Dataset):
    """FineDance, from the published files.

    Attributes
    ----------
    split
        ``cross_genre`` (every genre in train and test; it has no val) or ``cross_dancer`` (no dancer in two
        splits). Ids on no list are train.
    keep
        Ids that stay in their split although the split's ignore list contains them, as text (``["120"]``), or
        ``all``. Without it the ignore list takes precedence, as in Lodge and FineDance.
    trim
        Set the clips' ``trim_start`` to the first frame that Lodge keeps. The frames are stored either way.
    labels
        ``required`` leaves out sequences whose label is missing or not one of the 16 genres; ``optional`` keeps
        them, without a genre.
    body_model
        SMPL-X model file (.npz) with the bones to use; default: those published by Lodge and FineDance.
        FineDance has no betas: all motion is on the neutral body.
    music_dir
        Folder of the music, where it is not in the source: files by the same names, which come before the source's.
    """

    split: Literal["cross_genre", "cross_dancer"] = field(default="cross_genre", metadata={"scan": True})
    keep: Literal["all"] | tuple[str, ...] = field(default=(), metadata={"scan": True})
    trim: bool = True
    labels: Literal["required", "optional"] = field(default="required", metadata={"scan": True})
    body_model: Path | None = field(default=None, metadata={"path": True, "content": True})
    music_dir: Path | None = field(default=None, metadata={"path": True})

    version: ClassVar[int] = 1
    licence: ClassVar[str] = (
        "Non-commercial scientific research, education and art only (Tsinghua University's licence for the FineDance "
        "data); no redistribution, in whole or in part."
    )
    citation: ClassVar[str] = (
        "Li et al., FineDance: A Fine-grained Choreography Dataset for 3D Full Body Dance Generation, ICCV 2023."
    )

    def __post_init__(self) -> None:
        require_choices(self)
        listed_ids = sorted(clip for listed in facts().ignore_lists.values() for clip in listed.ids)
        unknown = [] if self.keep == ALL else [clip for clip in self.keep if clip not in listed_ids]
        if unknown:
            raise UsageError("finedance: keep contains ids that are on no ignore list",
                             found=", ".join(map(repr, unknown)),
                             allowed=f"all, or a list of {', '.join(listed_ids)}",
                             fix="write ids as text, in quotes: ['120']")  # fmt: skip

    @property
    @override
    def genre_ids(self) -> Mapping[str, int]:
        return facts().genre_ids

    @override
    def body_of(self, ref: ClipRef) -> Skeleton | None:
        return SMPLX55 if self.body_model is None else None

    @override
    def scan(self, source: Path) -> Scan:
        """List the clips; reads labels and, for the lengths, headers, but neither motion nor music.

        Returns
        -------
        Scan
            Clips by id with split, genre and the lists that contain them. A clip's music is its id; without an
            audio file of that name it has no audio. Rejects, each by name: ``ignored``, ``missing_label``,
            ``broken_label``, ``unknown_genre``, ``unassigned`` (an id that FineDance does not have),
            ``missing_motion``, ``unused_music``, ``extra_file``. Notes describe the layout, the lists in use, and
            ids on two of them.
        """
        from dancedata.datasets.finedance.load import length_note

        folders, motions = LAYOUT.list_motions(Path(source))
        music, labels = list_music(folders, self.music_dir), list_labels(folders)
        kept, model = self._kept(), self.body_model
        absent = set(facts().ids) - set(motions.files) - (facts().ignored(self.split) - kept)
        clips, left_out = self._clips(folders, motions, music, labels)
        with_music = {clip.id: (clip.motion_path, clip.audio_path) for clip in clips if clip.audio_path is not None}
        lengths = {clip: length_note(*paths, facts().frame_rate) for clip, paths in with_music.items()}
        notes = (
            *layout_notes(folders, motions, music, labels),
            *list_notes(self.split, motions.files, kept),
            *trim_notes(clips, self.trim),
            *genre_notes(clips),
            *length_notes({clip: note for clip, note in lengths.items() if note}),
            *clip_notes(clips, left_out),
            # An unusable body model raises here, before any clip is loaded.
            *([] if model is None else [f"Bones: of the body model {model.name} ({self._skeleton().name})."]),
        )
        rejects = (
            *left_out,
            *(
                Reject("missing_motion", clip=clip, detail=f"there is no motion/{clip}.npy")
                for clip in sorted(absent)
            ),
            *music.without_motion(motions.files, folders.source, "motion/{}.npy"),
            *labels.without_motion(motions.files, folders.source, "motion/{}.npy", "extra_file"),
            *music.rejects,
            *motions.rejects,
            *labels.rejects,
        )
        return Scan(layout="finedance", clips=tuple(clips), rejects=rejects, notes=notes)

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read the motion of one clip: 30 FPS, metres, radians, +Y up, SMPL-X's 55 joints, jaw and eyes still.

        The clip's id decides how many frames Lodge trims at its beginning.
        """
        from dancedata.datasets.finedance.load import load_motion

        trim = facts().trims.get(ref.id) if self.trim else None
        return load_motion(ref.motion_path, facts().frame_rate, self._skeleton(), trim.frames if trim else 0)

    @override
    def make_example(self, folder: Path) -> None:
        from dancedata.datasets.examples import write_finedance

        write_finedance(Path(folder))

    def _kept(self) -> frozenset[str]:
        """Return the ids on the split's ignore lists that are kept."""
        ignored = facts().ignored(self.split)
        return ignored if self.keep == ALL else ignored & set(self.keep)

    def _skeleton(self) -> Skeleton:
        if self.body_model is None:
            return SMPLX55
        from dancedata.formats.body_model import body_model_skeleton

        return body_model_skeleton(self.body_model)

    def _clips(
        self, folders: Folders, motions: Files, music: Files, labels: Files
    ) -> tuple[list[ClipRef], list[Reject]]:
        """Turn every motion file into a clip or a reject."""
        clips = []
        rejects = []
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
                )
            )
        return clips, rejects

    def _not_of_the_split(self, clip: str) -> tuple[str, str]:
        """Return why an id is in no split, as a code and in words; empty if it is in one."""
        if clip not in facts().ids:
            first, last = facts().ids[0], facts().ids[-1]
            detail = f"FineDance has {first} to {last}; use the dataset `folder` for your own data"
            return "unassigned", detail
        if clip not in facts().ignored(self.split) - self._kept():
            return "", ""
        lists = [name for name in facts().lists(clip) if name in facts().ignore_lists]
        split = facts().listed(self.split, clip)
        both = f", and in {self.split}.{split}; the ignore list takes precedence" if split else ""
        return "ignored", f"on the list {' and '.join(lists)}{both}; keep: ['{clip}'] keeps it"
