"""The reader of AIST++; the tree on disk is in the package's docstring."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Literal

from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.resources import manifest
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.datasets.aistpp.layout import LAYOUT, MUSIC_FOLDERS, Copy, find_copy
from dancedata.datasets.files import ALL, SPLITS, clips_note, require_choices
from dancedata.files.listing import relative
from dancedata.formats.aist_names import SequenceName, tempo_bpm


def layout_notes(copy: Copy) -> list[str]:
    """Return the layout and the files it was recognised by."""
    folders = copy.folders
    at = relative(folders.root / LAYOUT.motions, folders.source)
    names = (relative(folder, folders.source) for folder in copy.music.folders)
    where = listed("the source folder" if name == "." else f"{name}/" for name in names)
    files, of_songs = counted(len(copy.recordings), "file"), counted(len(copy.songs), "song")
    if not copy.recordings and not copy.songs:
        looked = ", ".join(f"{name}/" for name in MUSIC_FOLDERS)
        text = (
            f"Layout: official AIST++, by {at}/*.pkl; but no sequence has music. "
            f"Searched {looked} and the folder itself for files named as a sequence or a song (mBR2.wav). "
            f"The music is a separate download: {manifest('aistpp')['get_it']['music']}."
        )
    elif copy.layout == "edge":
        text = f"Layout: EDGE's, by {at}/*.pkl and one audio file per sequence in {where} ({files})."
    elif copy.layout == "official":
        text = f"Layout: official AIST++, by {at}/*.pkl and one audio file per song in {where} ({of_songs})."
    else:
        text = (
            f"Layout: mixed, by {at}/*.pkl and audio files per sequence and per song in {where}. {files} of a "
            f"sequence, which is preferred; {of_songs} for the other sequences."
        )
    others = listed(f"{folder.name}/" for folder in folders.others)
    return [text, *([f"Not read: {others}, which also contain motions/."] if others else []), *copy.music.notes]


def count_notes(copy: Copy, missing: int) -> list[str]:
    """Return the number of motion files against the sequences of AIST++."""
    n = len(copy.sequences)
    if (copy.folders.root / "synthetic.json").is_file():
        return [f"Motion: {n:,} files of a synthetic corpus."]
    copies, sequences = (manifest("aistpp")[key] for key in ("copies", "sequences"))
    others = [f"{count:,}" for count in copies if count != sequences]
    text = f"Motion: {counted(n, 'file')} found; AIST++ has {sequences:,} sequences"
    if n in copies:
        text += f". A copy with {n:,} files is known: {copies[n]}."
    else:
        text += f", and copies with {', '.join(others)} files are in circulation."
    if missing:
        text += f" {missing:,} of the listed sequences have no file (missing_motion)."
    return [text]


def ignored_notes(copy: Copy) -> list[str]:
    """Return the ignore list in use, and how many files it concerns."""
    names, parts = copy.ignored.names, list(copy.ignored.notes)
    if copy.ignored.where:
        n_present = len(names & set(copy.sequences))
        parts.append(f"{counted(len(names), 'name')}, {n_present:,} of them among the motion files found")
    return [f"Ignore list: {'; '.join(parts)}."]


def clip_notes(clips: Sequence[ClipRef], left_out: Sequence[Reject], split: str) -> list[str]:
    """Return the numbers of clips by split and left out, unknown tempos, and clips without music."""
    notes = [clips_note(clips, left_out, (ALL,) if split == ALL else SPLITS)]
    unknown = sorted({clip.music for clip in clips if clip.tempo_bpm is None})
    if unknown:
        notes.append(f"Tempo: no rule for {listed(unknown)}; it must be estimated from the audio.")
    silent = sum(clip.audio_path is None for clip in clips)
    if silent:
        notes.append(f"Music: {counted(silent, 'clip')} kept without music, as requested.")
    return notes


@DATASETS.register("aist++")
@dataclass(frozen=True)
class AistPP(Dataset):
    """AIST++, from the published files.

    Attributes
    ----------
    split
        Name of the split. ``SOURCE/splits/<split>_train.txt``, ``_val.txt``, ``_test.txt`` are read; if
        any of them exists only the files decide, and a missing one is an empty split. Without files
        ``crossmodal`` follows the rule over the names. ``all`` puts every clip into one split of that name.
    split_dir
        Folder with your own split files, relative to the source or absolute; no other one is searched.
    ignore
        ``list`` leaves out the sequences on the ignore list: the source's ``ignore_list.txt`` (even an
        empty one), else the official list, which is shipped. ``none`` keeps them.
    music
        ``required`` leaves out sequences without music; ``optional`` keeps them, for recipes without audio
        features. With audio features it is an error if there are such sequences.
    music_dir
        Folder of the music, where it is not in the source: files by the same names, which come before the source's.
    """

    split: str = field(default="crossmodal", metadata={"scan": True})
    split_dir: str | None = field(default=None, metadata={"path": True})
    ignore: Literal["list", "none"] = field(default="list", metadata={"scan": True})
    music: Literal["required", "optional"] = field(default="required", metadata={"scan": True})
    music_dir: Path | None = field(default=None, metadata={"path": True})

    version: ClassVar[int] = 1
    may_share_motion: ClassVar[bool] = True
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
        require_choices(self)
        if not self.split or Path(self.split).name != self.split:
            raise UsageError("aist++: split must be a name, not a path", found=repr(self.split),
                             allowed="crossmodal, all, or NAME of files NAME_train.txt",
                             fix="set split_dir to the folder of the files")  # fmt: skip
        if self.split == ALL and self.split_dir is not None:
            raise UsageError("aist++: split 'all' takes no split_dir", found=f"split_dir {self.split_dir!r}",
                             fix="remove split_dir, or set split to a name")  # fmt: skip

    @property
    @override
    def genre_ids(self) -> Mapping[str, int]:
        ids: Mapping[str, int] = manifest("aistpp")["lodge_genre_ids"]
        return ids

    @override
    def body_of(self, ref: ClipRef) -> Skeleton:
        return SMPL24

    @override
    def scan(self, source: Path) -> Scan:
        """List the clips; reads lists of names, but neither motion nor music.

        Returns
        -------
        Scan
            Clips by name with split, song, tempo (BPM), genre and dancer. Rejects, each by name: ``ignored``,
            ``unassigned`` (in no split), ``missing_music``, ``missing_motion`` (in a split, but no pickle),
            ``unused_music``, ``extra_file``. Notes describe the layout and how it was recognised.
        """
        copy = find_copy(Path(source), self.split, self.split_dir, self.ignore == "list", self.music_dir)
        clips, left_out = self._clips(copy)
        missing = [
            Reject("missing_motion", clip=name, detail=f"listed, but there is no motions/{name}.pkl")
            for name in sorted(copy.splits.expected - copy.ignored.names - set(copy.sequences))
        ]
        notes = (
            *layout_notes(copy),
            *count_notes(copy, len(missing)),
            *copy.splits.notes,
            *ignored_notes(copy),
            *clip_notes(clips, left_out, self.split),
        )
        return Scan(copy.layout, tuple(clips), (*left_out, *missing, *copy.rejects), notes)

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read the motion of one clip: 60 FPS, metres, radians, +Y up, skeleton SMPL24."""
        from dancedata.datasets.aistpp.load import load_motion

        return load_motion(ref.motion_path, manifest("aistpp")["frame_rate"])

    @override
    def make_example(self, folder: Path) -> None:
        from dancedata.synthetic import write_synthetic

        write_synthetic(Path(folder), seed=0, songs=2, clips_per_song=2, clip_s=6.0)

    def _clips(self, copy: Copy) -> tuple[list[ClipRef], list[Reject]]:
        """Turn every sequence into a clip or a reject."""
        clips = []
        rejects = []
        music, splits, ignored = copy.music.files, copy.splits, copy.ignored
        for name, parts in sorted(copy.sequences.items()):
            path = copy.motions.files[name]
            file = relative(path, copy.folders.source)
            split = splits.of.get(name, "")
            audio = music.get(name) or music.get(parts.music)
            if name in ignored.names:
                rejects.append(Reject("ignored", clip=name, file=file, detail=f"on {ignored.where}"))
            elif not split:
                rejects.append(Reject("unassigned", clip=name, file=file, detail=f"in no {splits.name} split"))
            elif audio is None and self.music == "required":
                detail = f"neither {name} nor {parts.music} as wav, flac, mp3 or ogg"
                rejects.append(Reject("missing_music", clip=name, file=file, detail=detail, music=parts.music))
            else:
                lists = (f"{splits.name}_{split}",) if splits.from_files else ()
                clips.append(_clip(parts, path, audio, split, lists))
        return clips, rejects


def _clip(parts: SequenceName, path: Path, audio: Path | None, split: str, lists: tuple[str, ...]) -> ClipRef:
    tempo = tempo_bpm(parts.music)
    return ClipRef(
        id=parts.id,
        motion_path=path,
        audio_path=audio,
        split=split,
        music=parts.music,
        tempo_bpm=tempo,
        genre=parts.genre,
        dancer=parts.dancer,
        lists=lists,
        notes=() if tempo is not None else (f"the tempo of music {parts.music} is unknown",),
    )
