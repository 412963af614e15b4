"""The reader of I-Dancers; the tree on disk is in the package's docstring."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import ClassVar, Literal

from dancedata.core.clip import ClipRef, Reject, Scan, member_id
from dancedata.core.errors import DataError, SourceError, UsageError
from dancedata.core.grid import as_rate
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.datasets.files import Files, clips_note, list_audio, read_names, require_choices
from dancedata.datasets.i_dancers.motion import SUFFIX
from dancedata.datasets.layout import Folders, Layout
from dancedata.files.listing import relative
from dancedata.music.signal import audio_length

#: Rates that are recognised from the lengths of motion and music, which agree within this share.
_RATES, _NEAR = (20, 24, 25, 30, 50, 60), Fraction(1, 50)
MAX_TRIM = 100_000


def _name_problem(stem: str) -> str:
    return "" if stem.endswith(SUFFIX) and len(stem) > len(SUFFIX) else f"not named NAME{SUFFIX}.pkl"


LAYOUT = Layout(
    dataset="i-dancers",
    title="I-Dancers",
    motions="motion",
    suffix=".pkl",
    name_problem=_name_problem,
    is_known=lambda name: "dancers" in name.lower(),
    looked_for=f"motion/NAME{SUFFIX}.pkl, in the source folder or in one folder below it",
    named=f"files named as seq_001{SUFFIX}.pkl",
    mistakes={},
)


@DATASETS.register("i-dancers")
@dataclass(frozen=True)
class IDancers(Dataset):
    """I-Dancers, from the files of CoheDancers: each clip is one dancer, each sequence a group.

    Attributes
    ----------
    fps
        Frames per second. "auto": the one of 20, 24, 25, 30, 50 and 60 by which motion and music of most sequences
        are equally long, within 2 %; a sequence in which they then are not is left out: its song goes on, or is cut.
    up
        Axis that is up: "y", "z", or "auto", that along which heads are above pelvises.
    music
        ``required`` leaves out sequences without music; ``optional`` keeps them, for recipes without audio features:
        then `fps` has to be a number.
    music_dir
        Folder of the music, where it is not in the source: files by the same names, which come before the source's.
    trim_frames
        Frames to leave out at both ends, of motion and music; CoheDancers' loader leaves out 15.
    """

    fps: str = field(default="auto", metadata={"scan": True})
    up: Literal["auto", "y", "z"] = "auto"
    music: Literal["required", "optional"] = field(default="required", metadata={"scan": True})
    music_dir: Path | None = field(default=None, metadata={"path": True})
    trim_frames: int = field(default=0, metadata={"scan": True})

    version: ClassVar[int] = 1
    licence: ClassVar[str] = (
        "I-Dancers: no licence is published with the files. Motion was estimated from videos of third parties, whose "
        "music is not licensed for redistribution."
    )
    citation: ClassVar[str] = "Yang et al., CoheDancers: Enhancing Interactive Group Dance Generation, ACM MM 2025."

    def __post_init__(self) -> None:
        require_choices(self)
        if type(self.trim_frames) is not int or not 0 <= self.trim_frames <= MAX_TRIM:
            raise UsageError("i-dancers: invalid value for trim_frames", found=repr(self.trim_frames),
                             allowed=f"a number of frames from 0 to {MAX_TRIM}")  # fmt: skip
        if self.fps != "auto":
            as_rate(self.fps)

    @property
    @override
    def official_split(self) -> bool:
        return True

    @override
    def body_of(self, ref: ClipRef) -> Skeleton:
        return SMPL24

    @override
    def scan(self, source: Path) -> Scan:
        """List the dancers; opens every pickle for its number of dancers and frames, and the header of its music.

        Returns
        -------
        Scan
            Clips NAME_p0, NAME_p1, ... with group, split and music (the sequence). Rejects, each by name: those of a
            pickle that cannot be read, ``unknown_rate``, ``unassigned``, ``missing_music``, ``missing_motion``,
            ``unused_music``, ``extra_file``.
        """
        folders, motions = LAYOUT.list_motions(Path(source))
        music = list_audio([folders.root / "music"], folders.source, lambda stem: "", music_dir=self.music_dir)
        lists = _find_lists(folders)
        clips, left_out = self._clips(folders, motions, music, lists)
        names = {stem.removesuffix(SUFFIX) for stem in motions.files}
        missing = [
            Reject("missing_motion", clip=name, detail=f"listed, but there is no motion/{name}{SUFFIX}.pkl")
            for name in sorted({name for of_split in lists.values() for name in of_split} - names)
        ]
        unused = music.without_motion(names, folders.source, f"motion/{{}}{SUFFIX}.pkl")
        rates = sorted({dict(clip.declared)["fps"] for clip in clips}, key=Fraction)
        notes = (
            f"Layout: I-Dancers, by {relative(folders.root / LAYOUT.motions, folders.source)}/*.pkl "
            f"({counted(len(motions.files), 'sequence')}); {counted(len(music.files), 'audio file')}.",
            *music.notes,
            f"Rate: {listed(rates) or 'none'} frames per second, "
            + ("by the lengths of motion and music." if self.fps == "auto" else "as set."),
            f"Trims: {counted(self.trim_frames, 'frame')} at both ends are left out, of motion and music."
            if self.trim_frames
            else "Trims: none; CoheDancers' loader leaves out 15 frames at both ends (trim_frames: 15).",
            f"Up: {self.up}." if self.up != "auto" else "Up: the axis along which heads are above pelvises, by file.",
            f"Splits: {', '.join(f'{len(n):,} {split}' for split, n in lists.items())} sequences, no val.",
            clips_note(clips, left_out),
        )
        return Scan(
            "i-dancers", tuple(clips), (*left_out, *missing, *unused, *music.rejects, *motions.rejects), notes
        )

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read one dancer: metres, radians, +Y up, SMPL24; DataError as of `motion.load_motions`."""
        return self.load_group([ref])[0]

    @override
    def load_group(self, refs: Sequence[ClipRef]) -> list[Motion]:
        """Read the dancers of one sequence, whose pickle is read once."""
        from dancedata.datasets.i_dancers.motion import load_motions

        rate = Fraction(dict(refs[0].declared)["fps"])
        members = [ref.member for ref in refs]
        return load_motions(refs[0].motion_path, members, rate, self.up, self.trim_frames)

    @override
    def make_example(self, folder: Path) -> None:
        from dancedata.datasets.i_dancers.motion import write_example

        write_example(Path(folder))

    def _clips(
        self, folders: Folders, motions: Files, music: Files, lists: Mapping[str, tuple[str, ...]]
    ) -> tuple[list[ClipRef], list[Reject]]:
        """Turn every dancer of every pickle into a clip, or the pickle into a reject."""
        from dancedata.datasets.i_dancers.motion import shape_of, too_short

        split_of = {name: split for split, names in lists.items() for name in names}
        read: list[tuple[str, Path, Path | None, int, int]] = []
        clips, rejects = [], []
        for stem, path in sorted(motions.files.items()):
            name, file = stem.removesuffix(SUFFIX), relative(path, folders.source)
            audio = music.files.get(name)
            if name not in split_of:
                rejects.append(Reject("unassigned", clip=name, file=file, detail="in neither train.txt nor test.txt"))
                continue
            if audio is None and (self.music == "required" or self.fps == "auto"):
                detail = f"no music/{name} as wav, flac, mp3 or ogg"
                detail += "" if self.music == "required" else ", which fps: auto needs"
                rejects.append(Reject("missing_music", clip=name, file=file, detail=detail, music=name))
                continue
            try:
                read.append((name, path, audio, *shape_of(path)))
            except DataError as error:
                rejects.append(Reject(error.reason, clip=name, file=file, detail=str(error)))
        rates = self._rates(read)
        for name, path, audio, dancers, frames in read:
            try:
                rate = rates[name]
                if isinstance(rate, DataError):
                    raise rate
                trim = self.trim_frames / rate
                if frames <= 2 * self.trim_frames:
                    raise too_short(path, frames, self.trim_frames)
            except DataError as error:
                file = relative(path, folders.source)
                rejects.append(Reject(error.reason, clip=name, file=file, detail=str(error)))
                continue
            clips += [
                ClipRef(
                    id=member_id(name, member), motion_path=path, audio_path=audio, split=split_of[name], music=name,
                    lists=(split_of[name],), declared=(("fps", str(rate)),), group=name, member=member,
                    audio_start=trim, source_start=trim or None, source_end=frames / rate - trim if trim else None,
                )
                for member in range(dancers)
            ]  # fmt: skip
        return sorted(clips, key=lambda ref: ref.id), rejects

    def _rates(self, read: Sequence[tuple[str, Path, Path | None, int, int]]) -> dict[str, Fraction | DataError]:
        """Return the rate of each sequence, or why it has none: all have that of most, by the lengths of music."""
        rates: dict[str, Fraction | DataError] = {}
        lengths: dict[str, tuple[Path, int, Fraction]] = {}
        for name, path, audio, _, frames in read:
            try:
                if self.fps != "auto" or audio is None:
                    rates[name] = as_rate(self.fps)
                else:
                    lengths[name] = path, frames, Fraction(*audio_length(audio))
            except DataError as error:
                rates[name] = error
        fitting = {name: _fitting(frames, seconds) for name, (_, frames, seconds) in lengths.items()}
        counts = Counter(rate for of_one in fitting.values() for rate in of_one).most_common(2)
        clear = bool(counts) and (len(counts) == 1 or counts[0][1] > counts[1][1])
        found = ", ".join(f"{n} at {rate}" for rate, n in counts) or "none"
        for name, (path, frames, seconds) in lengths.items():
            if clear and counts[0][0] in fitting[name]:
                rates[name] = Fraction(counts[0][0])
                continue
            rates[name] = DataError(
                "the frame rate cannot be told from the lengths of motion and music",
                reason="unknown_rate",
                where=str(path),
                found=f"{frames} frames, {float(seconds):.2f} s of music; of {len(lengths)} sequences {found}",
                allowed=f"as long as the music, within 2 %, at one of {listed(_RATES)} frames per second, the one of "
                "most sequences",
                fix="set dataset.i-dancers.fps, or cut the song to the dance",
            )
        return rates


def _fitting(frames: int, seconds: Fraction) -> list[int]:
    return [rate for rate in _RATES if seconds and abs(Fraction(frames, rate) / seconds - 1) <= _NEAR]


def _find_lists(folders: Folders) -> dict[str, tuple[str, ...]]:
    """Return the names of train.txt and test.txt; SourceError if one is missing, or they share a name."""
    lists = {}
    for split in ("train", "test"):
        file = next((root / f"{split}.txt" for root in folders.places if (root / f"{split}.txt").is_file()), None)
        if file is None:
            raise SourceError(f"i-dancers: the list {split}.txt is missing", where=str(folders.root),
                              found="no such file beside motion/",
                              allowed="train.txt and test.txt, with a name per line")  # fmt: skip
        names = [name.removesuffix(".pkl").removesuffix(SUFFIX) for name in read_names(file, spaces=True)]
        lists[split] = tuple(dict.fromkeys(names))
    both = sorted({*lists["train"]} & {*lists["test"]})
    if both:
        raise SourceError(
            "i-dancers: train.txt and test.txt name the same sequences", where=str(folders.root), found=listed(both)
        )
    return lists
