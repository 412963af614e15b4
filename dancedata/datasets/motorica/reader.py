"""The reader of Motorica Dance; the tree on disk is in the package's docstring."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path, PurePath
from typing import Any, ClassVar, Literal

from dancedata.core.audio_signal import AUDIO_SUFFIXES
from dancedata.core.bodies import MOTORICA21
from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import SourceError, UsageError
from dancedata.core.grid import as_fraction
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.datasets._split_rule import SplitRule
from dancedata.datasets.files import Files, clips_note, list_audio, require_choices
from dancedata.datasets.layout import Folders, Layout
from dancedata.datasets.motorica.names import GENRES, IN_BOTH, TEST, TRAIN_COUNT, parse_name, shared_songs
from dancedata.files.listing import relative

#: Seconds from the first frame of LDA's first take to that of its second.
SECOND_TAKE = Fraction(1, 60)
BY_SONG = SplitRule(Fraction(1, 10), Fraction(1, 10), "music", 0)
#: Appended to the id of the copy in train of a recording that LDA lists in train and test.
COPY = "_lda-train"
LAYOUT = Layout(
    dataset="motorica",
    title="Motorica Dance",
    motions="bvh",
    suffix=".bvh",
    name_problem=lambda stem: "",
    is_known=lambda name: "motorica" in name.lower(),
    looked_for="bvh/NAME.bvh, in the source folder or in one folder below it",
    named="files NAME.bvh",
    mistakes={
        "motorica": "this looks like the features of LDA or STREAM: the motion is the folder bvh/ of Motorica Dance",
        "motorica_dance": "features of LDA cannot be a source: use the folder bvh/ of Motorica Dance",
    },
)


@DATASETS.register("motorica")
@dataclass(frozen=True)
class Motorica(Dataset):
    """Motorica Dance, from the published BVH and audio files.

    Attributes
    ----------
    split
        ``official``: LDA's ten test recordings, all others train; a recording that LDA lists in both is in both.
        ``official-clean``: without that copy, and without train recordings of a song of test. ``by-song``: a tenth of
        the songs each is val and test, by a hash of their names.
    trim_s
        Seconds to leave out at both ends, where dancers stand in calibration poses; LDA leaves out 10. 0: none.
    audio_start
        Second of the audio file at frame 0, for a recording or all recordings of a song, by name; negative where the
        music begins later. For music from other sources, such as videos.
    fingers
        ``keep`` stores the joints of the fingers; they are captured in some sessions only.
    music
        ``required`` leaves out recordings without music; ``optional`` keeps them, for recipes without audio features.
    music_dir
        Folder of the music, where it is not in the source: files by the same names, which come before the source's.
    takes
        ``both`` makes two clips of each recording, NAME_00 and NAME_01, which begins 1/60 s later: at 30 frames per
        second, LDA's two takes. ``first``: one clip, whose frames are those of NAME_00.
    labels
        Folder of Motorica++, STREAM's annotations (`labels.read_labels`): the layer ``description`` of the segments.
        Default: ``label_segment``, ``motorica_seg`` or ``sliced_labels`` beside ``bvh``, if there is one.
    """

    split: Literal["official", "official-clean", "by-song"] = field(default="official", metadata={"scan": True})
    trim_s: float = field(default=0, metadata={"scan": True})
    audio_start: Mapping[str, Any] | None = field(default=None, metadata={"scan": True})
    fingers: Literal["drop", "keep"] = "drop"
    music: Literal["required", "optional"] = field(default="required", metadata={"scan": True})
    music_dir: Path | None = field(default=None, metadata={"path": True})
    takes: Literal["first", "both"] = field(default="first", metadata={"scan": True})
    labels: Path | None = field(default=None, metadata={"path": True})

    version: ClassVar[int] = 1
    licence: ClassVar[str] = (
        "Motorica Dance: no commercial use, training of models included; no redistribution. The music has terms "
        "of its own: no redistribution."
    )
    citation: ClassVar[str] = (
        "Alexanderson et al., Listen, Denoise, Action! Audio-Driven Motion Synthesis with Diffusion Models, SIGGRAPH "
        "2023."
    )

    def __post_init__(self) -> None:
        require_choices(self)
        if not isinstance(self.trim_s, int | float) or isinstance(self.trim_s, bool) or not 0 <= self.trim_s < 3600:
            raise UsageError("motorica: invalid value for trim_s", found=repr(self.trim_s),
                             allowed="seconds, 0 or more; LDA leaves out 10")  # fmt: skip
        for name in self.audio_start or {}:
            self._starts(name)

    @property
    @override
    def official_split(self) -> bool:
        return self.split == "official"

    @property
    @override
    def genre_ids(self) -> Mapping[str, int]:
        return {GENRES[code]: number for number, code in enumerate(sorted(GENRES))}

    @override
    def body_of(self, ref: ClipRef) -> Skeleton | None:
        return MOTORICA21 if self.fingers == "drop" else None

    @override
    def scan(self, source: Path) -> Scan:
        """List the recordings; reads names only, and the length of each in its header if `trim_s` is set.

        Returns
        -------
        Scan
            Clips by name with split, song, genre and dancer. Rejects, each by name: ``missing_music``, ``ignored``
            (in train, with a song of test; official-clean), ``missing_motion`` (an official test recording without a
            file), ``unused_music``, ``bad_segment``, ``unused_segments``, ``extra_file``. Notes state the trims, the
            lists, and what they share.

        Raises
        ------
        SourceError
            If the folder is not a copy of Motorica Dance, audio_start names what it does not hold, or there are no
            labels.
        """
        folders, motions = LAYOUT.list_motions(Path(source))
        folder = folders.root / LAYOUT.motions
        music = list_audio(
            [folders.root / "wav", folder, *folders.places],
            folders.source,
            lambda stem: "",
            [folder, *folders.places],
            music_dir=self.music_dir,
        )
        clips, left_out = self._clips(folders, motions, music)
        clips, unlabelled, labels = self._with_labels(clips, folders.root)
        left_out += unlabelled
        starts = self._start_notes(clips)
        if self.takes == "both":
            clips = [take for clip in clips for take in _takes(clip)]
            starts.append("Takes: two clips of each recording; NAME_01 begins 1/60 s later than NAME_00.")
        used = {clip.audio_path for clip in clips}
        others = [r for r in motions.rejects if PurePath(r.file).suffix.lower() not in AUDIO_SUFFIXES]
        unused = [
            Reject("unused_music", file=relative(path, folders.source), detail=f"there is no bvh/{stem}.bvh")
            for stem, path in music.files.items()
            if path not in used and stem not in motions.files
        ]
        missing = [
            Reject("missing_motion", clip=name, detail=f"in the official test list, but there is no bvh/{name}.bvh")
            for name in TEST
            if self.split != "by-song" and name not in motions.files
        ]
        notes = (
            f"Layout: Motorica Dance, by {relative(folder, folders.source)}/*.bvh "
            f"({counted(len(motions.files), 'file')}); {counted(len(music.files), 'audio file')}.",
            *music.notes,
            *self._split_notes(motions),
            self._trim_note(),
            "Rates: Frame Time 0.008333 is read as 1/120 s exactly; the rounded one drifts by 10 ms in 4 minutes.",
            *starts,
            *labels,
            clips_note(clips, left_out),
        )
        return Scan("motorica", tuple(clips), (*left_out, *missing, *unused, *music.rejects, *others), notes)

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read the motion of one clip: 120 FPS, metres, radians, +Y up, the recording's own bones."""
        from dancedata.datasets.motorica.motion import load_motion

        return load_motion(
            ref.motion_path, fingers=self.fingers == "keep", start=ref.source_start, end=ref.source_end
        )

    @override
    def make_example(self, folder: Path) -> None:
        from dancedata.datasets.motorica.labels import write_example as write_labels
        from dancedata.datasets.motorica.motion import EXAMPLE, write_example

        write_example(Path(folder))
        write_labels(Path(folder), EXAMPLE[0][0])

    def _clips(self, folders: Folders, motions: Files, music: Files) -> tuple[list[ClipRef], list[Reject]]:
        """Turn every recording into a clip, or two, or a reject."""
        names = [parse_name(stem) for stem in sorted(motions.files)]
        leaks = {clip: song for song, clips in shared_songs(names).items() for clip in clips}
        clips, rejects = [], []
        for name in names:
            path, audio = motions.files[name.id], music.files.get(name.id)
            file = relative(path, folders.source)
            if audio is None and self.music == "required":
                detail = f"no {name.id} as wav, flac, mp3 or ogg; some recordings are published without music"
                rejects.append(Reject("missing_music", clip=name.id, file=file, detail=detail, music=name.song))
                continue
            if self.split == "official-clean" and name.id in leaks:
                detail = f"train has the song {name.song} of an official test recording"
                rejects.append(Reject("ignored", clip=name.id, file=file, detail=detail))
                continue
            begin, start, end = self._times(name.id, name.song, path)
            official = "test" if name.id in TEST else "train"
            clip = ClipRef(
                id=name.id,
                motion_path=path,
                audio_path=audio,
                split=BY_SONG.split(name.song) if self.split == "by-song" else official,
                music=name.song,
                genre=name.genre,
                dancer=name.dancer,
                lists=("lda_train", "lda_test") if name.id in IN_BOTH else (f"lda_{official}",),
                keys=(("song", name.song),),
                audio_start=begin + start,
                source_start=start or None,
                source_end=end,
            )
            clips.append(clip)
            if name.id in IN_BOTH and self.split == "official":
                clips.append(replace(clip, id=f"{name.id}{COPY}", split="train"))
        self._require_known({name.id for name in names} | {name.song for name in names})
        return sorted(clips, key=lambda clip: clip.id), rejects

    def _with_labels(self, clips: Sequence[ClipRef], root: Path) -> tuple[list[ClipRef], list[Reject], list[str]]:
        """Return the clips with the labels of their recordings, counted from the clip's first frame."""
        from dancedata.datasets.motorica.labels import FOLDERS, read_labels

        beside = any((root / name).is_dir() for name in FOLDERS)
        if self.labels is None and not beside:
            return list(clips), [], []
        labels = read_labels(root if self.labels is None else Path(self.labels).expanduser())
        names = {clip.id: clip.id.removesuffix(COPY) for clip in clips}
        stated = [
            replace(clip, segments=tuple(
                replace(s, start=s.start - (clip.source_start or 0), end=s.end - (clip.source_start or 0))
                for s in labels.segments.get(names[clip.id], ())
            ))
            for clip in clips
        ]  # fmt: skip
        unused = sorted(labels.segments.keys() - set(names.values()))
        rejects = [Reject("unused_segments", clip=name, detail="labels of a recording that is left out, or not there")
                   for name in unused]  # fmt: skip
        return stated, [*labels.rejects, *rejects], [labels.note]

    def _times(self, name: str, song: str, path: Path) -> tuple[Fraction, Fraction, Fraction | None]:
        """Return the second of the audio at the recording's frame 0, and the part of the recording to keep."""
        starts = self.audio_start or {}
        key = next((key for key in (name, song) if key in starts), None)
        begin = self._starts(key) if key is not None else Fraction(0)
        if not self.trim_s:
            return begin, Fraction(0), None
        from dancedata.datasets.motorica.motion import RATE, seconds_of

        # Whole frames, so that motion and music are cut at one instant.
        trim, length = Fraction(round(as_fraction(self.trim_s, "trim_s") * RATE), RATE), seconds_of(path)
        end = None if length is None else max(length - trim, Fraction(0))
        return begin, trim, end

    def _starts(self, name: str) -> Fraction:
        return as_fraction((self.audio_start or {})[name], f"motorica: audio_start of {name}")

    def _require_known(self, known: set[str]) -> None:
        unknown = sorted(set(self.audio_start or {}) - known)
        if unknown:
            raise SourceError("motorica: audio_start names neither a recording nor a song of the source",
                              found=listed(unknown),
                              fix="use the name of a file without .bvh, or the song in it")  # fmt: skip

    def _split_notes(self, motions: Files) -> list[str]:
        """Return the split in use, and what LDA's lists share."""
        if self.split == "by-song":
            return ["Splits: by-song: a tenth of the songs each is val and test, by a hash of their names."]
        present = sum(name in motions.files for name in TEST)
        notes = [
            f"Splits: {self.split}: {present} of LDA's {len(TEST)} test recordings, all others train (LDA's list of "
            f"train names {TRAIN_COUNT}); it has no val."
        ]
        both = [name for name in IN_BOTH if name in motions.files]
        if both:
            kept = (
                f"both are kept, train's as {both[0]}{COPY}"
                if self.split == "official"
                else "train's copy is left out"
            )
            notes.append(f"Leak: {listed(both)} is in LDA's lists of train and test; {kept}.")
        songs = shared_songs(parse_name(stem) for stem in motions.files)
        if songs:
            named = ", ".join(f"{song} ({counted(len(clips), 'recording')})" for song, clips in sorted(songs.items()))
            kept = "official-clean leaves them out" if self.split == "official" else "left out"
            notes.append(f"Leak: songs of test that train has as well: {named}; {kept}.")
        return notes

    def _trim_note(self) -> str:
        if self.trim_s:
            return f"Trims: {self.trim_s:g} s at both ends of each recording are left out, of motion and music."
        return (
            "Trims: off. Recordings begin and end with calibration poses; LDA leaves out 10 s at both ends "
            "(trim_s: 10)."
        )

    def _start_notes(self, clips: Sequence[ClipRef]) -> list[str]:
        if not self.audio_start:
            return ["Music: frame 0 is taken as second 0 of the audio file; audio_start states other offsets."]
        n = sum(clip.id in self.audio_start or clip.music in self.audio_start for clip in clips)
        return [f"Music: audio_start states the offset of {counted(n, 'clip')}."]


def _takes(clip: ClipRef) -> tuple[ClipRef, ClipRef]:
    """Return LDA's two takes of a recording: every other frame of 60 per second, from the first or the second."""
    segments = tuple(replace(s, start=s.start - SECOND_TAKE, end=s.end - SECOND_TAKE) for s in clip.segments)
    second = replace(
        clip,
        id=f"{clip.id}_01",
        audio_start=clip.audio_start + SECOND_TAKE,
        source_start=(clip.source_start or 0) + SECOND_TAKE,
        segments=segments,
    )
    return replace(clip, id=f"{clip.id}_00"), second
