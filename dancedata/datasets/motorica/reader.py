"""The reader of Motorica Dance."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path, PurePath
from typing import Any, ClassVar, Literal

from dancedata.core.audio_signal import AUDIO_SUFFIXES
from dancedata.core.bodies import MOTORICA21
from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import SourceError, UsageError
from dancedata.core.grid import as_fraction
from dancedata.core.motion import Motion
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.datasets.files import list_audio
from dancedata.datasets.motorica.labels import FOLDERS, read_labels
from dancedata.datasets.published import Labels, Layout, Listing, PairedDataset, Splits

#: Seconds from the first frame of LDA's first take to that of its second.
_SECOND_TAKE = Fraction(1, 60)
#: Appended to the id of the copy in train of a recording that LDA lists in train and test.
_COPY = "_lda-train"
#: Genre of each code in the names (README of the dataset).
GENRES = {
    "LH": "hiphop", "KR": "krump", "PO": "popping", "LO": "locking", "JZ": "jazz", "CH": "charleston", "TP": "tap",
    "CA": "casual",
}  # fmt: skip
#: Recordings of LDA's `dance_test_files.txt`, without the suffixes of its two interleaved takes; STREAM's as well.
TEST = (
    "kthjazz_gCH_sFM_cAll_d02_mCH_ch01_whitemanpaulandhisorchestraloisiana_006",
    "kthjazz_gJZ_sFM_cAll_d02_mJZ_ch01_bennygoodmansugarfootstomp_003",
    "kthjazz_gTP_sFM_sngl_d02_015",
    "kthmisc_gCA_sFM_cAll_d01_mCA_ch24",
    "kthstreet_gKR_sFM_cAll_d01_mKR_ch01_chargedcableupyour_001",
    "kthstreet_gLH_sFM_cAll_d01_mLH_ch01_thisisit_001",
    "kthstreet_gLH_sFM_cAll_d02_mLH_ch01_lala_001",
    "kthstreet_gLO_sFM_cAll_d02_mLO_ch01_arethafranklinrocksteady_002",
    "kthstreet_gPO_sFM_cAll_d01_mPO_ch01_bombom_002",
    "kthstreet_gPO_sFM_cAll_d02_mPO_ch01_bombom_001",
)
#: Test recordings that LDA's list of train names too.
IN_BOTH = ("kthmisc_gCA_sFM_cAll_d01_mCA_ch24",)
#: Recordings that LDA's list of train names.
TRAIN_COUNT = 112

_GENRE = re.compile(r"g([A-Z]{2})")
_MUSIC = re.compile(r"m([A-Z]{2})([0-9]*)")
_DANCER = re.compile(r"d[0-9]{2}")
_TAKE = re.compile(r"[0-9]{3}")
_OTHER = re.compile(r"s[A-Z]{2}|c[A-Z][a-z]+|sngl|ch[0-9]+")


@dataclass(frozen=True)
class RecordingName:
    """What the name of a recording states; a name in any form is a valid one.

    `song`: The slug, else the music's code with its number ("mLH4"), else the whole name.
    `dancer`: Session and dancer, "kthjazz_d02", as numbers of sessions need not be the same people; or "".
    """

    id: str
    song: str
    genre: str = ""
    dancer: str = ""


def parse_name(stem: str) -> RecordingName:
    """Read the tokens of a name, each by its form and not by its place."""
    session, *tokens = stem.split("_")
    if not session.startswith("kth"):
        tokens, session = [session, *tokens], ""
    genre = dancer = music = ""
    slug = []
    for k, token in enumerate(tokens):
        if match := _GENRE.fullmatch(token):
            genre = genre or GENRES.get(match[1], "")
        elif match := _MUSIC.fullmatch(token):
            music = music or (token if match[2] else "")
        elif _DANCER.fullmatch(token):
            dancer = dancer or token
        elif not _OTHER.fullmatch(token) and not (k == len(tokens) - 1 and _TAKE.fullmatch(token)):
            slug.append(token)
    who = "_".join(part for part in (session, dancer) if part) if dancer else ""
    return RecordingName(stem, "_".join(slug) or music or stem, genre, who)


def shared_songs(names: Iterable[RecordingName]) -> dict[str, list[str]]:
    """Return the songs that official test and train share: song -> recordings of train that test does not list."""
    names = list(names)
    test = {name.song for name in names if name.id in TEST}
    shared: dict[str, list[str]] = {}
    for name in names:
        if name.song in test and name.id not in TEST:
            shared.setdefault(name.song, []).append(name.id)
    return shared


@DATASETS.register("motorica")
@dataclass(frozen=True)
class Motorica(PairedDataset):
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
    takes: Literal["first", "both"] = field(default="first", metadata={"scan": True})
    labels: Path | None = field(default=None, metadata={"path": True})

    licence: ClassVar[str] = (
        "Motorica Dance: no commercial use, training of models included; no redistribution. The music has terms "
        "of its own: no redistribution."
    )
    citation: ClassVar[str] = (
        "Alexanderson et al., Listen, Denoise, Action! Audio-Driven Motion Synthesis with Diffusion Models, SIGGRAPH "
        "2023."
    )

    layout: ClassVar[Layout] = Layout(
        "motorica", "Motorica Dance", "bvh", ".bvh", "NAME.bvh", folder_names=("motorica",)
    )
    unit: ClassVar[str] = "song"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.trim_s, int | float) or isinstance(self.trim_s, bool) or not 0 <= self.trim_s < 3600:
            raise UsageError("motorica: invalid value for trim_s", found=repr(self.trim_s),
                             allowed="seconds, 0 or more; LDA leaves out 10")  # fmt: skip
        for name in self.audio_start or {}:
            self._starts(name)

    @property
    @override
    def genre_ids(self) -> Mapping[str, int]:
        return {GENRES[code]: number for number, code in enumerate(sorted(GENRES))}

    @override
    def body_of(self, ref: ClipRef) -> Skeleton | None:
        return MOTORICA21 if self.fingers == "drop" else None

    @override
    def song_of(self, name: str) -> str:
        return parse_name(name).song

    @override
    def find(self, source: Path) -> Listing:
        folders, motions = self.layout.list_motions(source)
        mixed = [folders.root / "bvh", *folders.places]
        music = list_audio([folders.root / "wav", *mixed], source, lambda stem: "", mixed, self.music_dir)
        extra = tuple(r for r in motions.rejects if PurePath(r.file).suffix.lower() not in AUDIO_SUFFIXES)
        return Listing(folders, replace(motions, rejects=extra), music, labels=self._labels(folders.root))

    @override
    def splits(self, listing: Listing) -> Splits:
        names = [parse_name(stem) for stem in sorted(listing.motions.files)]
        unknown = sorted(set(self.audio_start or {}) - {n.id for n in names} - {n.song for n in names})
        if unknown:
            raise SourceError("motorica: audio_start names neither a recording nor a song of the source",
                              found=listed(unknown),
                              fix="use the name of a file without .bvh, or the song in it")  # fmt: skip
        lists = {"lda_train": {n.id for n in names} - {*TEST} | {*IN_BOTH}, "lda_test": {*TEST}}
        if self.split == "by-song":
            return replace(super().splits(listing), lists=lists)
        of = {name.id: "test" if name.id in TEST else "train" for name in names}
        songs, clean, ignored = shared_songs(names), self.split == "official-clean", {}
        if clean:
            ignored = {clip: f"train has the song {song} of an official test recording"
                       for song, clips in songs.items() for clip in clips}  # fmt: skip
        n_test = sum(split == "test" for split in of.values())
        notes = [
            f"Splits: {self.split}: {n_test} of LDA's {len(TEST)} test recordings, all others train (LDA's list of "
            f"train names {TRAIN_COUNT}); it has no val."
        ]
        both = [name for name in IN_BOTH if name in of]
        if both:
            kept = "train's copy is left out" if clean else f"both are kept, train's as {both[0]}{_COPY}"
            notes.append(f"Leak: {listed(both)} is in LDA's lists of train and test; {kept}.")
        if songs:
            named = ", ".join(f"{song} ({counted(len(clips), 'recording')})" for song, clips in sorted(songs.items()))
            kept = "left out" if clean else "official-clean leaves them out"
            notes.append(f"Leak: songs of test that train has as well: {named}; {kept}.")
        return Splits(of, tuple(notes), lists, frozenset(TEST), ignored=ignored)

    @override
    def clips_of(self, ref: ClipRef, listing: Listing) -> Iterable[ClipRef]:
        name, (begin, start, end) = parse_name(ref.id), self._times(ref)
        clip = replace(
            ref, genre=name.genre, dancer=name.dancer, audio_start=begin + start, source_start=start or None,
            source_end=end,
        )  # fmt: skip
        yield clip
        if ref.id in IN_BOTH and self.split == "official":
            yield replace(clip, id=f"{ref.id}{_COPY}", split="train")

    @override
    def all_clips(self, refs: Sequence[ClipRef], listing: Listing, left_out: list[Reject]) -> list[ClipRef]:
        """Return the clips with the labels of their recordings, counted from the clip's first frame; two takes."""
        clips = super().all_clips(refs, listing, left_out)
        names, labels = {clip.id: clip.id.removesuffix(_COPY) for clip in clips}, listing.labels.of
        clips = [
            replace(clip, segments=tuple(
                replace(s, start=s.start - (clip.source_start or 0), end=s.end - (clip.source_start or 0))
                for s in labels.get(names[clip.id], ())
            ))
            for clip in clips
        ]  # fmt: skip
        detail = "labels of a recording that is left out, or not there"
        unused = sorted(labels.keys() - set(names.values()))
        left_out += [Reject("unused_segments", clip=name, detail=detail) for name in unused]
        return [take for clip in clips for take in _takes(clip)] if self.takes == "both" else clips

    @override
    def notes(self, listing: Listing, clips: Sequence[ClipRef]) -> Iterable[str]:
        yield (
            f"Trims: {self.trim_s:g} s at both ends of each recording are left out, of motion and music."
            if self.trim_s
            else "Trims: off. Recordings begin and end with calibration poses; LDA leaves out 10 s (trim_s: 10)."
        )
        yield "Rates: Frame Time 0.008333 is read as 1/120 s exactly; the rounded one drifts by 10 ms in 4 minutes."
        stated = self.audio_start or {}
        n = len({clip.motion_path for clip in clips if clip.motion_path.stem in stated or clip.music in stated})
        yield (
            f"Music: audio_start states the offset of {counted(n, 'recording')}."
            if stated
            else "Music: frame 0 is taken as second 0 of the audio file; audio_start states other offsets."
        )
        if self.takes == "both":
            yield "Takes: two clips of each recording; NAME_01 begins 1/60 s later than NAME_00."
        yield from listing.labels.notes

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

    def _labels(self, root: Path) -> Labels:
        if self.labels is None and not any((root / name).is_dir() for name in FOLDERS):
            return Labels({})
        return read_labels(root if self.labels is None else Path(self.labels).expanduser())

    def _times(self, ref: ClipRef) -> tuple[Fraction, Fraction, Fraction | None]:
        """Return the second of the audio at the recording's frame 0, and the part of the recording to keep."""
        starts = self.audio_start or {}
        key = next((key for key in (ref.id, ref.music) if key in starts), None)
        begin = self._starts(key) if key is not None else Fraction(0)
        if not self.trim_s:
            return begin, Fraction(0), None
        from dancedata.datasets.motorica.motion import RATE, seconds_of

        # Whole frames, so that motion and music are cut at one instant.
        trim, length = Fraction(round(as_fraction(self.trim_s, "trim_s") * RATE), RATE), seconds_of(ref.motion_path)
        end = None if length is None else max(length - trim, Fraction(0))
        return begin, trim, end

    def _starts(self, name: str) -> Fraction:
        return as_fraction((self.audio_start or {})[name], f"motorica: audio_start of {name}")


def _takes(clip: ClipRef) -> tuple[ClipRef, ClipRef]:
    """Return LDA's two takes of a recording: every other frame of 60 per second, from the first or the second."""
    segments = tuple(replace(s, start=s.start - _SECOND_TAKE, end=s.end - _SECOND_TAKE) for s in clip.segments)
    second = replace(
        clip,
        id=f"{clip.id}_01",
        audio_start=clip.audio_start + _SECOND_TAKE,
        source_start=(clip.source_start or 0) + _SECOND_TAKE,
        segments=segments,
    )
    return replace(clip, id=f"{clip.id}_00"), second
