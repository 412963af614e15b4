"""The reader of InfiniteDance; the tree on disk is in the package's docstring."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Literal

from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import SourceError
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import counted, listed
from dancedata.core.typing import override
from dancedata.datasets.files import (
    ALL,
    SPLITS,
    Files,
    clips_note,
    files_by_stem,
    require_choices,
)
from dancedata.datasets.infinitedance.corpus import (
    AIST,
    COLUMNS_FOLDER,
    FITS_FOLDER,
    OWN,
    TEST_FOLDER,
    Styles,
    lists_of,
    origins_note,
    origins_of,
)
from dancedata.datasets.layout import Folders, Layout
from dancedata.files.listing import relative

FITS, COLUMNS = "fits", "columns"
#: Lists of train and test of each split.
LISTS = {"official": ("All_cleandata_train", "test_eval861"), "full": ("All_train", "All_eval")}
#: Published files.
N_FITS, N_COLUMNS = 9748, 10_870


def _name_problem(stem: str) -> str:
    # InfiniteDance's retrieval names pieces NAME@START_END.
    return "a name with @, which separates names from frames" if "@" in stem else ""


def _layout(motions: str, suffix: str, other: str) -> Layout:
    return Layout(
        dataset="infinitedance",
        title="InfiniteDance",
        motions=motions,
        suffix=suffix,
        name_problem=_name_problem,
        is_known=lambda name: name.lower().startswith("infinitedance"),
        looked_for=f"{motions}/NAME{suffix}, in the source folder or in one folder below it",
        named=f"files {motions}/NAME{suffix}",
        mistakes={"dance": f"extract the archives into dance/, or set dataset.infinitedance.motion: {other}"},
    )


LAYOUTS = {FITS: _layout(FITS_FOLDER, ".pkl", COLUMNS), COLUMNS: _layout(COLUMNS_FOLDER, ".npy", FITS)}


@DATASETS.register("infinitedance")
@dataclass(frozen=True)
class InfiniteDance(Dataset):
    """InfiniteDance, from the published files; music only as features (audio feature `file`).

    Attributes
    ----------
    motion
        ``fits``: SMPL-X's body, of the dataset's own clips. ``columns``: joints from the 264 columns, also of clips
        of AIST++, FineDance and Motorica; rotations are fitted to them.
    split
        ``official``: All_cleandata_train.txt and test_eval861.txt. ``full``: All_train.txt and All_eval.txt, which is
        test. ``all``: no split.
    clips
        ``all``, or ``own``: without clips of other datasets, which have terms of their own.
    up
        Axis that is up in fits: ``y``, ``z`` or ``-y``; ``auto``: told from heads and pelvises, clip by clip.
    """

    motion: Literal["fits", "columns"] = "fits"
    split: Literal["official", "full", "all"] = field(default="official", metadata={"scan": True})
    clips: Literal["all", "own"] = field(default="all", metadata={"scan": True})
    up: Literal["auto", "y", "z", "-y"] = "auto"

    version: ClassVar[int] = 1
    has_audio: ClassVar[bool] = False
    licence: ClassVar[str] = (
        "InfiniteDance Non-Commercial Research License: academic research, education and evaluation; redistribution "
        "under the same terms, with citation. Clips of AIST++, FineDance and Motorica keep their own terms, so the "
        "whole must not be passed on."
    )
    citation: ClassVar[str] = (
        "InfiniteDance: Scalable 3D Dance Generation Towards in-the-wild Generalization, ECCV 2026, arXiv:2603.13375."
    )

    def __post_init__(self) -> None:
        require_choices(self)

    @property
    @override
    def official_split(self) -> bool:
        return self.split != ALL

    @override
    def body_of(self, ref: ClipRef) -> Skeleton | None:
        from dancedata.core.bodies import SMPLX22

        return SMPLX22 if self.motion == FITS else None

    @override
    def scan(self, source: Path) -> Scan:
        """List the clips; reads lists and styles, but no motion.

        Returns
        -------
        Scan
            Clips by name with split, lists and style (genre), and the free column ``origin``: the dataset that a clip
            comes from. Rejects, each by name: ``unassigned``, ``missing_motion`` (listed, but no file),
            ``other_dataset``, ``bad_style``, ``extra_file`` (also names with @). Notes state the lists, what they
            share, styles, origins and their terms.
        """
        layout = LAYOUTS[self.motion]
        folders, motions = layout.list_motions(Path(source))
        motions, notes = self._with_test(folders, motions) if self.motion == COLUMNS else (motions, [])
        lists = lists_of(folders.root)
        train, test = self._lists(folders, lists)
        fits = motions.files if self.motion == FITS else _fits(folders)
        origins = origins_of(motions.files, lists, fits)
        styles = Styles.find(folders.root, folders.source, motions.files)
        clips, left_out = [], []
        for name, path in sorted(motions.files.items()):
            file = relative(path, folders.source)
            split = ALL if self.split == ALL else "train" if name in train else "test" if name in test else ""
            if not split:
                detail = (
                    f"on neither {' nor '.join(LISTS[self.split])}; dataset.infinitedance.split: all has no lists"
                )
                left_out.append(Reject("unassigned", clip=name, file=file, detail=detail))
            elif self.clips == "own" and origins[name] != OWN:
                left_out.append(Reject("other_dataset", clip=name, file=file, detail=f"origin: {origins[name]}"))
            else:
                clips.append(_clip(name, path, split, styles.of.get(name, ""), origins[name], lists))
        missing = [
            Reject("missing_motion", clip=name, detail=f"listed, but no {layout.motions}/{name}{layout.suffix}")
            for name in sorted({*train, *test} - set(motions.files))
        ]
        n_files = counted(len(motions.files), "file")
        published = f"{N_FITS:,} fits" if self.motion == FITS else f"{N_COLUMNS:,} files of columns"
        notes = [
            f"Layout: InfiniteDance, by {relative(folders.root / layout.motions, folders.source)}/*{layout.suffix} "
            f"({n_files}; {published} were published); no audio: music is in files of features.",
            *notes,
            self._split_note(train, test),
            *styles.notes,
            *([origins_note([origins[clip.id] for clip in clips])] if clips else []),
            clips_note(clips, left_out, (ALL,) if self.split == ALL else SPLITS),
        ]
        rejects = (*left_out, *missing, *styles.rejects, *motions.rejects)
        return Scan("infinitedance", tuple(clips), rejects, tuple(notes))

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read the motion of one clip: 30 FPS, metres, radians, +Y up."""
        from dancedata.datasets.infinitedance.motion import load_columns, load_fit

        return load_fit(ref.motion_path, self.up) if self.motion == FITS else load_columns(ref.motion_path)

    @override
    def make_example(self, folder: Path) -> None:
        from dancedata.datasets.infinitedance.motion import write_example

        write_example(Path(folder))

    @staticmethod
    def _with_test(folders: Folders, motions: Files) -> tuple[Files, list[str]]:
        """Add the columns of test clips that are in a folder of their own alone."""
        test = files_by_stem(folders.root / TEST_FOLDER, folders.source, ".npy", _name_problem)
        twice = sorted(test.files.keys() & motions.files.keys())
        note = f"Columns: {counted(len(twice), 'clip')} in {TEST_FOLDER}/ as well, not read: {listed(twice, 3)}."
        files = Files({**test.files, **motions.files}, (*motions.rejects, *test.rejects))
        return files, [note] if twice else []

    def _lists(self, folders: Folders, lists: Mapping[str, frozenset[str]]) -> tuple[frozenset[str], frozenset[str]]:
        """Return the names of train and test; SourceError if a list is missing, or both name a clip."""
        if self.split == ALL:
            return frozenset(), frozenset()
        missing = [name for name in LISTS[self.split] if name not in lists]
        if missing:
            raise SourceError("infinitedance: lists are missing", where=str(folders.root / "partition"),
                              found=listed(f"{name}.txt" for name in sorted(lists)) or "no list",
                              allowed=" and ".join(f"partition/{name}.txt" for name in LISTS[self.split]),
                              fix="download partition/, or set dataset.infinitedance.split: all")  # fmt: skip
        train, test = (lists[name] for name in LISTS[self.split])
        if train & test:
            raise SourceError(
                f"infinitedance: {' and '.join(f'{name}.txt' for name in LISTS[self.split])} name the same clips",
                where=str(folders.root / "partition"),
                found=listed(sorted(train & test)),
                fix="download partition/ again, or set dataset.infinitedance.split: all",
            )
        return train, test

    def _split_note(self, train: frozenset[str], test: frozenset[str]) -> str:
        if self.split == ALL:
            return "Splits: none."
        names = LISTS[self.split]
        songs = [{match[2] for match in map(AIST.fullmatch, clips) if match} for clips in (train, test)]
        shared = sorted(songs[0] & songs[1])
        leak = f"; songs of AIST++ in both: {listed(shared, 6)}" if shared else ""
        return (
            f"Splits: {self.split}: {len(train):,} names of {names[0]}.txt are train, {len(test):,} of "
            f"{names[1]}.txt test, no val{leak}. Names are the only trace of songs: what else the lists share is "
            "not known."
        )


def _fits(folders: Folders) -> frozenset[str]:
    """Return the names of the dataset's own fits, if they are there."""
    return frozenset(files_by_stem(folders.root / FITS_FOLDER, folders.source, ".pkl", _name_problem).files)


def _clip(name: str, path: Path, split: str, style: str, origin: str, lists: Mapping[str, frozenset[str]]) -> ClipRef:
    aist = AIST.fullmatch(name)
    return ClipRef(
        id=name,
        motion_path=path,
        audio_path=None,
        split=split,
        music=aist[2] if aist else name,
        genre=style,
        dancer=aist[1] if aist else "",
        lists=tuple(sorted(of for of, names in lists.items() if name in names)),
        columns=(("origin", origin),),
    )
