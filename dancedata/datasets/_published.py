"""The scan of published datasets: a folder of motions, folders of music by the same names, lists of names."""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import ClassVar, Literal

from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import DataError, SourceError
from dancedata.core.plugins import Dataset
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.datasets._split_rule import SplitRule
from dancedata.datasets.files import clips_note, list_audio, read_names, require_choices
from dancedata.datasets.layout import Folders, Layout
from dancedata.files.listing import relative

OFFICIAL, BY_VIDEO = "official", "by-video"
RULE = SplitRule(Fraction(1, 10), Fraction(1, 10), "music", 0)


@dataclass(frozen=True)
class Lists:
    """Names by list: the official splits of one folder, `where`, and lists that are only recorded."""

    splits: Mapping[str, tuple[str, ...]]
    others: Mapping[str, tuple[str, ...]]
    where: Path

    @classmethod
    def find(
        cls, folders: Folders, official: Mapping[str, str], others: Mapping[str, str], below: Sequence[str]
    ) -> Lists:
        """Read lists by the names of their files, in the dataset's folders or in folders below them."""
        places = [place / name for place in folders.places for name in below]
        where = max(places, key=lambda place: sum((place / file).is_file() for file in official.values()))
        found = {name: next((p / file for p in (*folders.places, *places) if (p / file).is_file()), where / file)
                 for name, file in others.items()}  # fmt: skip
        return cls(_read({name: where / file for name, file in official.items()}), _read(found), where)

    def of(self, name: str) -> tuple[str, ...]:
        """Return the lists that hold a name, the split first."""
        return tuple(kind for kind, names in {**self.splits, **self.others}.items() if name in names)

    def leaks(self, video_of: Mapping[str, str]) -> str:
        """Return the videos that splits share, "" without any."""
        leaks = []
        for k, (split, names) in enumerate(self.splits.items()):
            for earlier, before in list(self.splits.items())[:k]:
                shared = {video_of[name] for name in names} & {video_of[name] for name in before}
                n, which = sum(video_of[name] in shared for name in names), listed(sorted(shared), 3)
                leaks += [f"{n:,} of {len(names):,} {split} are of videos of {earlier} ({which})"] if shared else []
        return "; ".join(leaks)


def _read(files: Mapping[str, Path]) -> dict[str, tuple[str, ...]]:
    # Some are tables without a header: further columns may follow.
    return {name: tuple(dict.fromkeys(word.split(",")[0] for word in read_names(path)))
            for name, path in files.items() if path.is_file()}  # fmt: skip


@dataclass(frozen=True)
class Published(Dataset):
    """Base of datasets with official lists or a split by video.

    Attributes
    ----------
    split
        ``official``: the published lists. ``by-video``: a tenth of the videos each is val and test, by a hash of
        their names.
    music
        ``required`` leaves out motions without music; ``optional`` keeps them, for recipes without audio features.
    music_dir
        Folder of the music, where it is not in the source: files by the same names, which come before the source's.
    """

    split: Literal["official", "by-video"] = field(default="official", metadata={"scan": True})
    music: Literal["required", "optional"] = field(default="required", metadata={"scan": True})
    music_dir: Path | None = field(default=None, metadata={"path": True})

    layout: ClassVar[Layout]
    #: Folders of the music, the first where it is missing.
    music_folders: ClassVar[tuple[str, ...]]
    #: File of each official list and of others, folders below the dataset's that may hold them, where to get them.
    official: ClassVar[Mapping[str, str]]
    recorded: ClassVar[Mapping[str, str]]
    below: ClassVar[tuple[str, ...]] = ("",)
    get_lists: ClassVar[str] = "copy the lists of the dataset into the source"
    #: Number of motions that were published.
    published: ClassVar[int]

    def __post_init__(self) -> None:
        require_choices(self)

    @property
    @override
    def official_split(self) -> bool:
        return self.split == OFFICIAL

    @staticmethod
    @abstractmethod
    def video_of(name: str) -> str:
        """Return the video of a motion by its name."""

    def song_of(self, name: str) -> str:
        """Return the song of a motion by its name: by default the name."""
        return name

    def clips_of(self, ref: ClipRef) -> list[ClipRef]:
        """Return the clips of a motion file, from one with its name; DataError for a file that cannot be used."""
        return [ref]

    def notes(self, clips: Sequence[ClipRef]) -> Iterable[str]:
        """Return notes of the dataset."""
        return ()

    @override
    def scan(self, source: Path) -> Scan:
        """List the clips; reads lists of names and sizes, but neither motion nor music.

        Returns
        -------
        Scan
            Clips by id; `keys` has the video. Rejects, each by the motion's name: ``unassigned``, ``missing_music``,
            ``missing_motion`` (listed, but no file), the reasons of a file that cannot be used, ``unused_music``,
            ``extra_file``. Notes state the lists and the videos that they share.
        """
        folders, motions = self.layout.list_motions(Path(source))
        places = [place / name for place in folders.places for name in self.music_folders]
        music = list_audio(places, folders.source, self.layout.name_problem, music_dir=self.music_dir)
        lists = Lists.find(folders, self.official, self.recorded, self.below)
        if self.official_split:
            self._require(lists)
        clips, left_out = self._clips(folders, motions.files, music.files, lists)
        form = f"{self.layout.motions}/{{}}{self.layout.suffix}"
        names = {name for of_split in lists.splits.values() for name in of_split}
        missing = [Reject("missing_motion", clip=name, detail=f"listed, but there is no {form.format(name)}")
                   for name in sorted(names - motions.files.keys())]  # fmt: skip
        at = relative(folders.root / self.layout.motions, folders.source)
        notes = (
            f"Layout: {self.layout.title}, by {at}/*{self.layout.suffix} ({counted(len(motions.files), 'file')}; "
            f"{self.published:,} were published); {counted(len(music.files), 'audio file')}.",
            *music.notes,
            *self._split_notes(lists),
            *self.notes(clips),
            clips_note(clips, left_out),
        )
        unused = music.without_motion(motions.files, folders.source, form)
        rejects = (*left_out, *missing, *unused, *music.rejects, *motions.rejects)
        return Scan(self.name, tuple(sorted(clips, key=lambda clip: clip.id)), rejects, notes)

    def _require(self, lists: Lists) -> None:
        """Raise SourceError if an official list is missing, or two name the same motions."""
        missing = [f"no {file}" for split, file in self.official.items() if split not in lists.splits]
        counts = Counter(name for names in lists.splits.values() for name in names)
        both = [f"{name} ({' and '.join(s for s, names in lists.splits.items() if name in names)})"
                for name in sorted(counts) if counts[name] > 1]  # fmt: skip
        if missing or both:
            what = "official lists are missing" if missing else "the official lists name the same motions"
            raise SourceError(f"{self.name}: {what}", where=str(lists.where), found=listed(missing or both, 5),
                              allowed=listed(self.official.values()),
                              fix=f"{self.get_lists}, or set split: {BY_VIDEO}")  # fmt: skip

    def _clips(
        self, folders: Folders, motions: Mapping[str, Path], music: Mapping[str, Path], lists: Lists
    ) -> tuple[list[ClipRef], list[Reject]]:
        """Turn every motion file into clips or a reject."""
        clips: list[ClipRef] = []
        rejects: list[Reject] = []
        for name, path in sorted(motions.items()):
            file, audio = relative(path, folders.source), music.get(name)
            of, video = lists.of(name), self.video_of(name)
            split = next((s for s in of if s in lists.splits), "") if self.official_split else RULE.split(video)
            ref = ClipRef(name, path, audio, split, self.song_of(name), lists=of, keys=(("video", video),))
            if not split:
                detail = f"on none of the official lists; split: {BY_VIDEO} assigns every motion"
                rejects.append(Reject("unassigned", clip=name, file=file, detail=detail))
            elif audio is None and self.music == "required":
                detail = f"no {self.music_folders[0]}/{name} as wav, flac, mp3 or ogg"
                rejects.append(Reject("missing_music", clip=name, file=file, detail=detail, music=ref.music))
            else:
                try:
                    clips += self.clips_of(ref)
                except DataError as error:
                    rejects.append(Reject(error.reason, clip=name, file=file, detail=str(error)))
        return clips, rejects

    def _split_notes(self, lists: Lists) -> list[str]:
        """Return the split in use, and the videos that the official lists share."""
        leak = lists.leaks({name: self.video_of(name) for names in lists.splits.values() for name in names})
        if self.official_split:
            sizes = ", ".join(f"{len(names):,} {split}" for split, names in {**lists.splits, **lists.others}.items())
            leaks = [f"Leak: {leak}; split: {BY_VIDEO} keeps videos together."] if leak else []
            return [f"Splits: official: {sizes}.", *leaks]
        text = f"Splits: {BY_VIDEO}: a tenth of the videos each is val and test, by a hash of their names."
        return [text, *([f"Leak of the official lists, which are not used: {leak}."] if leak else [])]
