"""AIST++ (Li et al. 2021): dance to music in ten genres, 1,408 sequences, 60 FPS.

Of the two layouts (docs/datasets/aistpp.md) the official one has a file of music per song, EDGE's one per sequence,
which is preferred; files tell them apart. Tempos, split rule and ignore list are in ``manifests/aistpp.yaml``.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError, SourceError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import DATASETS
from dancedata.core.resources import manifest
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.text import counted, listed, shown
from dancedata.core.typing import override
from dancedata.datasets.files import ALL, SPLITS, describe, list_audio, read_names, relative
from dancedata.datasets.published import Folders, Layout, LeftOut, Listing, PairedDataset, Splits
from dancedata.files.listing import list_folder
from dancedata.formats.aist_names import SONG, SequenceName, parse_name, tempo_bpm

#: The split that a rule over the names defines.
RULE = "crossmodal"
_IGNORE_LIST = "ignore_list.txt"
_SHAPES: dict[str, list[tuple[int, ...]]] = {"smpl_poses": [(72,), (24, 3)], "smpl_trans": [(3,)]}
_AGAIN = "download the file again, convert it, or put the sequence on the ignore list"

Floats = NDArray[np.float64]


def _sequence_problem(stem: str) -> str:
    return "" if parse_name(stem) else "not named as an AIST++ sequence (gBR_sBM_cAll_d04_mBR2_ch08)"


def music_problem(stem: str) -> str:
    """Return why `stem` is not the name of an audio file, "" if it is: that of a sequence or of a song."""
    named = SONG.fullmatch(stem) or parse_name(stem)
    return "" if named else "it is named neither like an AIST++ sequence nor like a song (mBR2)"


def crossmodal_split(name: SequenceName) -> str:
    """Return the split by the crossmodal rule, "" for none; it agrees with the published lists on all 1,408 names."""
    rule = manifest("aistpp")["crossmodal"]
    choreographies = {rule[f"{split}_choreography"]: split for split in ("val", "test")}
    held_out = choreographies.get(name.choreography, "") if name.situation == rule["situation"] else ""
    if name.music in rule["test_music"]:
        return held_out
    return "" if held_out else "train"


@DATASETS.register("aist++")
@dataclass(frozen=True)
class AistPP(PairedDataset):
    """AIST++, from the published files.

    Attributes
    ----------
    split
        Name of the split. ``SOURCE/splits/<split>_train.txt``, ``_val.txt``, ``_test.txt`` are read; if
        any of them exists only the files decide, and a missing one is an empty split. Without files
        ``crossmodal`` follows the rule over the names. ``all`` puts every clip into one split of that name.
    ignore
        ``list`` leaves out the sequences on the ignore list: the source's ``ignore_list.txt`` (even an
        empty one), else the official list, which is shipped. ``none`` keeps them.
    """

    split: str = field(default="crossmodal", metadata={"scan": True})
    ignore: Literal["list", "none"] = field(default="list", metadata={"scan": True})

    body: ClassVar[Skeleton] = SMPL24
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

    layout: ClassVar[Layout] = Layout(
        "aist++", "AIST++", "motions", ".pkl", "gBR_sBM_cAll_d04_mBR2_ch08.pkl", _sequence_problem,
        folder_names=("edge_aistpp", "aist_plusplus_final"),  # the copies of EDGE and of the project page
    )  # fmt: skip
    music_folders: ClassVar[tuple[str, ...]] = ("wavs", "music", "audio", "musics")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.split or Path(self.split).name != self.split:
            raise UsageError("aist++: split must be a name, not a path", found=repr(self.split),
                             allowed="crossmodal, all, or NAME of files splits/NAME_train.txt")  # fmt: skip

    @property
    @override
    def official_split(self) -> bool:
        return False

    @property
    @override
    def genre_ids(self) -> Mapping[str, int]:
        ids: Mapping[str, int] = manifest("aistpp")["lodge_genre_ids"]
        return ids

    @override
    def find(self, source: Path) -> Listing:
        folders, motions = self.layout.list_motions(source)
        places = [place / name for place in folders.places for name in self.music_folders]
        there = [folder for folder in (*places, *folders.places) if folder.is_dir()]
        music = list_audio(there, source, music_problem, mixed=folders.places, music_dir=self.music_dir)
        listing = Listing(folders, motions, music)
        recordings = motions.files.keys() & music.files.keys()
        layout = "mixed" if recordings and self._songs(listing) else "edge" if recordings else "official"
        return replace(listing, layout=layout)

    @override
    def song_of(self, name: str) -> str:
        return name.split("_")[4]

    @override
    def audio_of(self, name: str, listing: Listing) -> Path | None:
        path = listing.music.files.get(name) or listing.music.files.get(self.song_of(name))
        if path is None and self.music == "required":
            detail = f"neither {name} nor {self.song_of(name)} as wav, flac, mp3 or ogg"
            raise LeftOut("missing_music", detail, music=self.song_of(name))
        return path

    @override
    def why_unused(self, name: str, listing: Listing) -> str:
        if parse_name(name):
            return super().why_unused(name, listing)
        if name in self._songs(listing):
            return ""
        danced = name in {self.song_of(sequence) for sequence in listing.motions.files}
        return (
            "every sequence danced to it has its own audio file"
            if danced
            else "no motion in the source is danced to it"
        )

    @override
    def splits(self, listing: Listing) -> Splits:
        """Read the split files if there are any, else use the rule over the names; and the ignore list."""
        names = listing.motions.files
        ignored, last = self._ignored(listing)
        if self.split == ALL:
            listed_names, notes = _mapping(listing.folders)
            text = "Splits: none requested; every clip is in the split 'all'."
            return Splits(dict.fromkeys(names, ALL), (text, *notes, last), {}, listed_names, ignored=ignored)
        places = [folder for place in listing.folders.places if (folder := place / "splits").is_dir()]
        without = f"in no {self.split} split"
        for place in places:
            paths = {split: place / f"{self.split}_{split}.txt" for split in SPLITS}
            existing = {split: path for split, path in paths.items() if path.is_file()}
            if existing:
                of, read = _from_files(listing.folders, self.split, existing)
                lists = {f"{self.split}_{s}": [n for n, split in of.items() if split == s] for s in existing}
                return Splits(of, (*read, last), lists, frozenset(of), without, ignored)
        if self.split != RULE:
            self._no_such_split(places)
        listed_names, notes = _mapping(listing.folders)
        parsed = {name: parts for name in {*listed_names, *names} if (parts := parse_name(name))}
        of = {name: split for name, parts in parsed.items() if (split := crossmodal_split(parts))}
        text = f"Splits: by the crossmodal rule over the names, as splits/ has no {RULE}_train.txt, _val or _test."
        return Splits(of, (text, *notes, last), {}, listed_names & of.keys(), without, ignored)

    @override
    def clips_of(self, ref: ClipRef, listing: Listing) -> Iterable[ClipRef]:
        parts, tempo = parse_name(ref.id), tempo_bpm(ref.music)
        notes = () if tempo is not None else (f"the tempo of music {ref.music} is unknown",)
        if parts is not None:
            yield replace(ref, tempo_bpm=tempo, genre=parts.genre, dancer=parts.dancer, notes=notes)

    @override
    def layout_notes(self, listing: Listing) -> Iterable[str]:
        first, *others = super().layout_notes(listing)
        names = (listing.relative(folder) for folder in listing.music.folders)
        where = listed("the source folder" if name == "." else f"{name}/" for name in names)
        n_songs = len(self._songs(listing))
        files = counted(len(listing.motions.files.keys() & listing.music.files.keys()), "file")
        songs, one = counted(n_songs, "song"), "one audio file per"
        yield first.replace("AIST++", "EDGE's" if listing.layout == "edge" else "official AIST++", 1)
        if listing.layout == "mixed":
            yield f"Music: of sequences and of songs in {where}: {files} of a sequence, which is preferred; {songs}."
        elif n_songs or listing.layout == "edge":
            text = f"sequence in {where} ({files})" if listing.layout == "edge" else f"song in {where} ({songs})"
            yield f"Music: {one} {text}."
        else:
            looked = ", ".join(f"{name}/" for name in self.music_folders)
            yield (
                f"Music: no sequence has any. Searched {looked} and the folder itself for files named as a sequence "
                f"or a song (mBR2.wav). It is a separate download: {manifest('aistpp')['get_it']['music']}."
            )
        yield from others

    @override
    def notes(self, listing: Listing, clips: Sequence[ClipRef]) -> Iterable[str]:
        n, data = len(listing.motions.files), manifest("aistpp")
        if (listing.folders.root / "synthetic.json").is_file():
            yield f"Motion: {n:,} files of a synthetic corpus."
        else:
            copies = listed(f"{count:,} ({origin})" for count, origin in data["copies"].items())
            yield f"Motion: {n:,} files; AIST++ has {data['sequences']:,} sequences, copies of it have {copies}."
        unknown = sorted({clip.music for clip in clips if clip.tempo_bpm is None})
        if unknown:
            yield f"Tempo: no rule for {listed(unknown)}; it must be estimated from the audio."
        silent = sum(clip.audio_path is None for clip in clips)
        if silent:
            yield f"Music: {counted(silent, 'clip')} kept without music, as requested."

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read the motion of one clip: 60 FPS, +Y up, SMPL24, in metres: ``smpl_trans / smpl_scaling`` in float64.

        DataError: ``broken_file``, ``unsafe_pickle``, ``not_rotations``, ``bad_scaling``, or as `read_frames`.
        """
        from dancedata.datasets.checks import bad_shape, read_frames, require_keys, require_rotations
        from dancedata.formats.safe_pickle import load_pickle
        from dancedata.formats.values import ValueArrays

        path, content = ref.motion_path, load_pickle(ref.motion_path)
        keys = (*_SHAPES, "smpl_scaling")
        if not isinstance(content, Mapping):
            raise DataError("the pickle does not hold a dict", reason="broken_file", where=str(path),
                            found=type(content).__name__, allowed=f"a dict with {', '.join(keys)}",
                            fix=_AGAIN)  # fmt: skip
        arrays = ValueArrays(path, content)
        require_keys(arrays, keys)
        poses, trans = read_frames(arrays, _SHAPES, _AGAIN)
        rotations = poses.reshape(-1, SMPL24.n_joints, 3)
        require_rotations(path, "smpl_poses", rotations, trans, SMPL24.parents)
        scaling = arrays.read("smpl_scaling")
        if scaling.size != 1:
            raise bad_shape(path, "smpl_scaling", scaling.shape, "one number, (1,)", _AGAIN)
        places = _in_metres(path, trans, float(scaling.reshape(())))
        return Motion(places, rotations, FrameGrid.of(manifest("aistpp")["frame_rate"]), SMPL24)

    @override
    def make_example(self, folder: Path) -> None:
        from dancedata.synthetic import write_synthetic

        write_synthetic(Path(folder), seed=0, songs=2, clips_per_song=2, clip_s=6.0)

    def _songs(self, listing: Listing) -> set[str]:
        """Return the songs whose file some sequence uses, as it has none of its own."""
        motions, music = listing.motions.files.keys(), listing.music.files.keys()
        return {self.song_of(name) for name in motions - music} & music

    def _no_such_split(self, places: list[Path]) -> None:
        available = {
            path.stem.removesuffix(f"_{split}")
            for place in places
            for path in list_folder(place)
            for split in SPLITS
            if path.suffix == ".txt" and path.stem.endswith(f"_{split}")
        }
        expected = ", ".join(f"{self.split}_{split}.txt" for split in SPLITS)
        where = ", ".join(str(place) for place in places)
        raise SourceError(f"aist++: there is no split {self.split!r}; expected {expected}",
                          where=where or "no folder splits/ in the source",
                          found=", ".join(describe(place) for place in places) or "no split files",
                          allowed=listed([*sorted(available | {RULE}), ALL], 20),
                          fix="correct split in the recipe")  # fmt: skip

    def _ignored(self, listing: Listing) -> tuple[dict[str, str], str]:
        """Return the names on the first ignore list of the source, even an empty one, or of the shipped one."""
        if self.ignore != "list":
            return {}, "Ignore list: not applied, as requested."
        folders = listing.folders
        usual = [folder for place in folders.places for folder in (place, place / "splits")]
        paths = [path for folder in usual if (path := folder / _IGNORE_LIST).is_file()]
        names = [frozenset(read_names(path)) for path in paths] or [frozenset(manifest("aistpp")["ignored"])]
        where = listing.relative(paths[0]) if paths else "the official list (shipped)"
        other = [listing.relative(path) for path, of in zip(paths[1:], names[1:], strict=True) if of != names[0]]
        unused = f"; not used: {listed(other)}, which differ" if other else ""
        n = f"{counted(len(names[0]), 'name')}, {len(names[0] & listing.motions.files.keys()):,} of them"
        note = f"Ignore list: {where}{unused}; {n} among the motion files found."
        return dict.fromkeys(names[0], f"on {where}"), note


def _from_files(folders: Folders, name: str, paths: Mapping[str, Path]) -> tuple[dict[str, str], list[str]]:
    """Return the split of each name on the split files, and what was read."""
    of: dict[str, str] = {}
    notes = []
    parts = []
    for split in SPLITS:
        if split not in paths:
            parts.append(f"no {name}_{split}.txt, so {split} is empty")
            continue
        names = read_names(paths[split])
        for sequence in dict.fromkeys(names):
            if sequence in of:
                raise SourceError(f"aist++: sequence {shown(sequence)} is in two splits",
                                  where=f"{paths[of[sequence]]} and {paths[split]}",
                                  fix="remove it from one of the files")  # fmt: skip
            of[sequence] = split
        parts.append(f"{relative(paths[split], folders.source)} ({counted(len(set(names)), 'name')})")
        if len(set(names)) < len(names):
            notes.append(f"{paths[split].name} lists some names more than once; each counts once.")
    return of, [f"Splits: {', '.join(parts)}.", *notes]


def _mapping(folders: Folders) -> tuple[frozenset[str], tuple[str, ...]]:
    """Return all names in ``cameras/mapping.txt``, if there is one, and a note."""
    for place in folders.places:
        path = place / "cameras" / "mapping.txt"
        if path.is_file():
            names = frozenset(read_names(path))
            return names, (f"Names: {relative(path, folders.source)} lists {len(names):,} sequences.",)
    return frozenset(), ()


def _in_metres(path: Path, trans: Floats, scaling: float) -> Floats:
    """Divide by the factor between the file's units and metres: 89 to 99 in AIST++, 1 for data in metres."""
    if np.isfinite(scaling) and scaling > 0:
        with np.errstate(over="ignore"):
            translation: Floats = trans / scaling
        if np.isfinite(translation).all():
            return translation
    raise DataError("smpl_scaling cannot turn smpl_trans into metres", reason="bad_scaling", where=str(path),
                    found=repr(scaling),
                    allowed="a finite number above 0 (about 89 to 99 in AIST++; 1 for data in metres)",
                    fix=_AGAIN)  # fmt: skip
