"""The reader of PhantomDance; the tree on disk is in the package's docstring."""

from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path, PurePath
from typing import ClassVar, Literal

from dancedata.core.audio_signal import AUDIO_SUFFIXES
from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import SourceError
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import SMPL24_EDGE, Skeleton
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.datasets._split_rule import SplitRule
from dancedata.datasets.files import (
    ALL,
    SPLITS,
    clips_note,
    files_by_stem,
    list_audio,
    require_choices,
    require_folder,
)
from dancedata.files.listing import describe, list_folder, relative

BY_SONG = "by-song"
RULE = SplitRule(Fraction(1, 10), Fraction(1, 10), "music", 0)
#: Dances of version 1.2.
DANCES = 260
_LOOKED_FOR = "NAME.json, in the source folder or in one folder of it, and NAME.wav"


@DATASETS.register("phantomdance")
@dataclass(frozen=True)
class PhantomDance(Dataset):
    """PhantomDance, from the published JSON and audio files.

    Attributes
    ----------
    split
        ``by-song``: a tenth of the dances each is val and test, by a hash of their names; no split was published.
        ``all``: no split.
    motions
        Folder of the JSON files, below the source, if several folders have some.
    music
        ``required`` leaves out dances without music; ``optional`` keeps them, for recipes without audio features.
    music_dir
        Folder of the music, where it is not in the source: files by the same names, which come before the source's.
    """

    split: Literal["by-song", "all"] = field(default="by-song", metadata={"scan": True})
    motions: str | None = field(default=None, metadata={"scan": True})
    music: Literal["required", "optional"] = field(default="required", metadata={"scan": True})
    music_dir: Path | None = field(default=None, metadata={"path": True})

    version: ClassVar[int] = 1
    licence: ClassVar[str] = (
        "PhantomDance's repository: MIT (it links the data). Terms of the music are not stated: no redistribution."
    )
    citation: ClassVar[str] = (
        "Li et al., DanceFormer: Music Conditioned 3D Dance Generation with Parametric Motion Transformer, AAAI 2022."
    )

    def __post_init__(self) -> None:
        require_choices(self)

    @override
    def body_of(self, ref: ClipRef) -> Skeleton:
        return SMPL24_EDGE

    @override
    def scan(self, source: Path) -> Scan:
        """List the dances; reads neither motion nor music.

        Returns
        -------
        Scan
            Clips by name; each has a separate song. Rejects, each by name: ``missing_music``, ``unused_music``,
            ``extra_file``. Notes state the folders and the split.
        """
        source = Path(source)
        folder = self._folder(source)
        motions = files_by_stem(folder, source, ".json", lambda stem: "")
        places = [folder, source, *(entry for entry in list_folder(source) if entry.is_dir() and entry != folder)]
        places = list(dict.fromkeys(places))
        music = list_audio(places, source, lambda stem: "", places, self.music_dir)
        clips, left_out = [], []
        for name, path in sorted(motions.files.items()):
            audio = music.files.get(name)
            if audio is None and self.music == "required":
                file, detail = relative(path, source), f"no {name} as wav, flac, mp3 or ogg"
                left_out.append(Reject("missing_music", clip=name, file=file, detail=detail, music=name))
                continue
            split = ALL if self.split == ALL else RULE.split(name)
            clips.append(ClipRef(name, path, audio, split, music=name))
        unused = music.without_motion(motions.files, source, "{}.json")
        others = [r for r in motions.rejects if not _is_beside(r.file, source, folder)]
        where = "" if folder == source else f"{relative(folder, source)}/"
        rule = "a tenth of the dances each is val and test, by a hash of their names"
        notes = (
            f"Layout: PhantomDance, by {where}*.json ({counted(len(motions.files), 'file')}; version 1.2 has "
            f"{DANCES}); {counted(len(music.files), 'audio file')}.",
            *music.notes,
            f"Splits: {'none' if self.split == ALL else f'by-song: {rule}'}; none was published.",
            "Axes: Unity's, left-handed: x is negated, and rotations in the world become relative to the parents.",
            clips_note(clips, left_out, (ALL,) if self.split == ALL else SPLITS),
        )
        return Scan("phantomdance", tuple(clips), (*left_out, *unused, *music.rejects, *others), notes)

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read one dance: 30 FPS, metres, radians, +Y up, SMPL24_EDGE."""
        from dancedata.datasets.phantomdance.motion import load_motion

        return load_motion(ref.motion_path)

    @override
    def make_example(self, folder: Path) -> None:
        from dancedata.datasets.phantomdance.motion import write_example

        write_example(Path(folder))

    def _folder(self, source: Path) -> Path:
        require_folder("phantomdance", source, _LOOKED_FOR)
        below = [source, *(entry for entry in list_folder(source) if entry.is_dir())]
        candidates = below if self.motions is None else [source / self.motions]
        folders = [folder for folder in candidates if folder.is_dir() and _has_motions(folder)]
        if len(folders) == 1:
            return folders[0]
        if folders:
            raise SourceError("phantomdance: several folders have JSON files", where=str(source),
                              found=listed(relative(folder, source) for folder in folders),
                              fix="set dataset.phantomdance.motions to the folder of the motions")  # fmt: skip
        raise SourceError("phantomdance: no motion found",
                          where=str(source if self.motions is None else source / self.motions),
                          found=describe(source), allowed=_LOOKED_FOR,
                          fix="set --source to the folder of the unpacked archive")  # fmt: skip


def _has_motions(folder: Path) -> bool:
    return any(path.suffix.lower() == ".json" and path.is_file() for path in list_folder(folder))


def _is_beside(file: str, source: Path, folder: Path) -> bool:
    """Return whether an entry beside the motions is music, or a folder of the source."""
    return PurePath(file).suffix.lower() in AUDIO_SUFFIXES or (folder == source and file.endswith("/"))
