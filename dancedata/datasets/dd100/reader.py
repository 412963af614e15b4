"""The reader of DD100; the tree on disk is in the package's docstring."""

import re
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import ClassVar, Literal

from dancedata.core.bodies import SMPLX55
from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import SourceError
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import counted
from dancedata.core.typing import override
from dancedata.datasets._split_rule import SplitRule
from dancedata.datasets.files import (
    Files,
    clips_note,
    extra_file,
    files_by_stem,
    list_audio,
    require_choices,
    require_folder,
    with_music_dir,
)
from dancedata.files.listing import describe, relative

OFFICIAL, BY_CHOREOGRAPHY = "official", "by-choreography"
RULE = SplitRule(Fraction(1, 10), Fraction(1, 10), "music", 0)
ROLES = ("follower", "leader")
#: Duolando's script copies the files of all/ to train/ and test/.
_PARTS = ("all", "train", "test")
_FPS, _MOTION, _MUSIC = 30, "motion/smplx", "music/mp3"
_LOOKED_FOR = f"{_MOTION}/all/GENRE_CHOREO_TAKE_00.npy and _01.npy, in the source folder"
# Explicit ranges: \d would accept digits of other scripts.
_PAIR = re.compile(r"([A-Za-z]+)_([0-9]+)_([0-9]+)")
_DANCER = re.compile(rf"({_PAIR.pattern})_0([01])")


def _dancer_problem(stem: str) -> str:
    return "" if _DANCER.fullmatch(stem) else "not named GENRE_CHOREO_TAKE_00 (follower) or _01 (leader)"


def _pair_problem(stem: str) -> str:
    return "" if _PAIR.fullmatch(stem) else "not named GENRE_CHOREO_TAKE"


def is_test(pair: str) -> bool:
    """Return whether Duolando's script puts a pair into test."""
    genre, choreography, _ = pair.rsplit("_", 2)
    number = int(choreography)
    return number in (9, 10) if genre == "Ballet" else number % 5 == 0


@DATASETS.register("dd100")
@dataclass(frozen=True)
class DD100(Dataset):
    """DD100, from the published files: each clip is one dancer, each pair a group of follower and leader.

    Attributes
    ----------
    split
        ``official``: the rule of Duolando's script, which keeps the takes of a choreography together; no val.
        ``by-choreography``: a tenth of the choreographies each is val and test, by a hash of their names.
    music
        ``required`` leaves out pairs without music; ``optional`` keeps them, for recipes without audio features.
    music_dir
        Folder of the music, where it is not in the source: files by the same names, which come before the source's.
    up
        Axis that is up in the files: ``z`` as published, or ``y``. A file whose heads are elsewhere is set aside.
    """

    split: Literal["official", "by-choreography"] = field(default="official", metadata={"scan": True})
    music: Literal["required", "optional"] = field(default="required", metadata={"scan": True})
    music_dir: Path | None = field(default=None, metadata={"path": True})
    up: Literal["z", "y"] = "z"

    version: ClassVar[int] = 1
    licence: ClassVar[str] = (
        "S-Lab License 1.0 (Duolando's repository): non-commercial use only; ask the authors about redistribution."
    )
    citation: ClassVar[str] = (
        "Siyao et al., Duolando: Follower GPT with Off-Policy Reinforcement Learning for Dance Accompaniment, "
        "ICLR 2024."
    )

    def __post_init__(self) -> None:
        require_choices(self)

    @property
    @override
    def official_split(self) -> bool:
        return self.split == OFFICIAL

    @override
    def body_of(self, ref: ClipRef) -> Skeleton:
        return SMPLX55

    @override
    def scan(self, source: Path) -> Scan:
        """List the dancers by the names of their files; reads neither motion nor music.

        Returns
        -------
        Scan
            Clips ``<pair>_00`` (follower, member 0) and ``<pair>_01`` (leader, member 1); group and music are the
            pair, `keys` has the choreography. Rejects: ``missing_partner``, ``missing_music``, ``unused_music``,
            ``extra_file``.
        """
        source = Path(source)
        require_folder("dd100", source, _LOOKED_FOR)
        motions = _merged(
            [files_by_stem(source / _MOTION / p, source, ".npy", _dancer_problem) for p in _PARTS], source
        )
        if not motions.files:
            raise SourceError("dd100: no motion found", where=str(source), found=describe(source),
                              allowed=_LOOKED_FOR,
                              fix="set --source to the folder that contains motion/ and music/")  # fmt: skip
        own = _merged([list_audio([source / _MUSIC / p], source, _pair_problem) for p in _PARTS], source)
        music = with_music_dir(own, self.music_dir, source, _pair_problem)
        clips: list[ClipRef] = []
        left_out: list[Reject] = []
        pairs = sorted({stem.rsplit("_", 1)[0] for stem in motions.files})
        for pair in pairs:
            paths = [motions.files.get(f"{pair}_0{member}") for member in range(len(ROLES))]
            audio = music.files.get(pair)
            present = [path for path in paths if path is not None]
            file = relative(present[0], source)
            if len(present) < len(ROLES):
                absent = next(m for m, path in enumerate(paths) if path is None)
                detail = f"there is no {pair}_0{absent}.npy, the {ROLES[absent]}"
                left_out.append(Reject("missing_partner", clip=f"{pair}_0{absent}", file=file, detail=detail))
            if audio is None and self.music == "required":
                detail = f"no {_MUSIC}/all/{pair} as wav, flac, mp3 or ogg"
                left_out.append(Reject("missing_music", clip=pair, file=file, detail=detail, music=pair))
            else:
                choreography = pair.rsplit("_", 1)[0]
                clips += [
                    ClipRef(
                        id=path.stem,
                        motion_path=path,
                        audio_path=audio,
                        split=self._split(pair),
                        music=pair,
                        genre=pair.split("_")[0],
                        lists=("test" if is_test(pair) else "train",),
                        group=pair,
                        member=member,
                        group_size=len(ROLES),
                        role=ROLES[member],
                        keys=(("choreography", choreography),),
                    )
                    for member, path in enumerate(paths)
                    if path is not None
                ]
        unused = [
            Reject("unused_music", file=relative(path, source), detail=f"there are no files of {name} in {_MOTION}/")
            for name, path in music.files.items()
            if name not in pairs
        ]
        which = (
            "official: choreographies whose number is a multiple of five, and Ballet 9 and 10, are test; no val."
            if self.split == OFFICIAL
            else "by-choreography: a tenth of the choreographies each is val and test, by a hash of their names."
        )
        notes = (
            f"Layout: DD100, by {_MOTION}/ ({counted(len(motions.files), 'file')}); "
            f"{counted(len(music.files), 'audio file')}.",
            f"Axes: +{self.up.upper()} up, {'turned to +Y; ' if self.up == 'z' else ''}partners share one world; "
            f"metres, {_FPS} FPS. Heads are compared with pelvises as files are read. Betas are not used.",
            *music.notes,
            f"Splits: {which}",
            clips_note(clips, left_out),
        )
        rejects = (*left_out, *unused, *music.rejects, *motions.rejects)
        return Scan("dd100", tuple(sorted(clips, key=lambda clip: clip.id)), rejects, notes)

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read one dancer: 30 FPS, metres, radians, +Y up, SMPL-X's 55 joints, in the world of the pair."""
        from dancedata.datasets.dd100.motion import load_dancer

        return load_dancer(ref.motion_path, self.up)

    @override
    def make_example(self, folder: Path) -> None:
        from dancedata.datasets.dd100.motion import write_example

        write_example(Path(folder))

    def _split(self, pair: str) -> str:
        if self.split == BY_CHOREOGRAPHY:
            return RULE.split(pair.rsplit("_", 1)[0])
        return "test" if is_test(pair) else "train"


def _merged(parts: list[Files], source: Path) -> Files:
    """Join the files of all/, train/ and test/: of several with one name the first is read."""
    files: dict[str, Path] = {}
    rejects = [reject for part in parts for reject in part.rejects]
    for part in parts:
        for name, path in part.files.items():
            if files.setdefault(name, path) != path:
                rejects.append(extra_file(path, source, f"the same name as {relative(files[name], source)}"))
    return Files(files, tuple(rejects), tuple(note for part in parts for note in part.notes))
