"""InfiniteDance (2026): fits of dances in videos, 30 FPS, and columns of these and of three other datasets; no audio.

The files: docs/datasets/infinitedance.md.
"""

import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from dancedata.core.bodies import SMPLX22, transfer_to
from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import SourceError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import DATASETS, REPRESENTATIONS
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import counted, listed, quoted
from dancedata.core.typing import override
from dancedata.datasets import checks
from dancedata.datasets.files import ALL, MAX_LIST_BYTES, NO_FILES, files_by_stem, read_names, relative
from dancedata.datasets.published import Labels, Layout, LeftOut, Listing, PublishedDataset, Splits
from dancedata.files.listing import list_folder
from dancedata.files.strict_json import read_json
from dancedata.formats.values import open_arrays

RATE, COLUMNS = 30, 264
#: Joints of `body_pose`: SMPL-X's body without the root; SMPL's 23 end with the hands.
BODY = 21
_VECTORS: list[tuple[int, ...]] = [(3,), (1, 3)]
_SHAPES: dict[str, list[tuple[int, ...]]] = {
    "body_pose": [(63,), (21, 3), (69,), (23, 3)], "global_orient": _VECTORS, "transl": _VECTORS,
}  # fmt: skip
AXES = ("y", "z", "-y")
#: Lists of train and test of each split.
LISTS = {"official": ("All_cleandata_train", "test_eval861"), "full": ("All_train", "All_eval")}
FITS_FOLDER = "dance/infinitedance_smplx_smooth"
COLUMNS_FOLDER = "dance/alldata_new_joint_vecs264_ft_balanced"
TEST_FOLDER = "dance/test_eval861_joint_vecs264"
TOKENS_FOLDER = "dance/Infinite_MotionTokens_512x1024_3layer_cleandata"
MUQ_FOLDER = "music/muq_features/test_infinitedance"
MUSIC55_FOLDER = "music/musicfeature_55_allmusic_pure"
OWN, UNKNOWN = "infinitedance", "unknown"
#: Dataset of a list's name before "_train.txt" and so on, with the terms of its clips.
_ORIGINS: Mapping[str, tuple[str, str]] = {
    "infinitedance": (OWN, "InfiniteDance's licence"),
    "aistpp": ("aist++", "AIST++'s and the AIST Dance Video Database's terms"),
    "finedance": ("finedance", "FineDance's terms"),
    "motorica": ("motorica", "Motorica Dance's licence"),
}
TERMS = dict(_ORIGINS.values())
#: Names of clips of other datasets: as those datasets publish them.
AIST = re.compile(r"g[A-Z]{2}_s[A-Z]{2}_c(?:All|[0-9]{2})_(d[0-9]{2})_(m[A-Z]{2}[0-9]+)_ch[0-9]{2}")
_NAMES = (("aist++", AIST), ("motorica", re.compile(r"kth(?:street|jazz|misc)_.+")))
_LIST = re.compile(r"(.+)_(?:train|eval|test)")
_MAX_STYLE_BYTES = 1 << 16
_STYLE_MAP = "all_style_map.json"


def read_styles(root: Path, source: Path, names: Collection[str]) -> Labels:
    """Read the styles of clips from a map, which takes precedence, and a file each; SourceError for a bad map."""
    folder, rejects, differ = root / "styles", [], []
    styles = _style_map(folder / _STYLE_MAP)
    for name in sorted(names):
        path = folder / f"{name}.json"
        if not path.is_file():
            continue
        try:
            document = read_json(path, _MAX_STYLE_BYTES)
            style = document.get("style") if isinstance(document, dict) else None
            if not isinstance(style, str) or not style:
                raise ValueError('no text "style"')
        except (OSError, ValueError) as error:
            rejects.append(Reject("bad_style", clip=name, file=relative(path, source), detail=str(error)))
            continue
        if styles.setdefault(name, style) != style:
            differ.append(f"{name} ({quoted(style)}, not {quoted(styles[name])})")
    without = [name for name in sorted(names) if name not in styles]
    notes = []
    if differ:
        notes.append(f"Styles: {len(differ):,} files contradict {_STYLE_MAP}, which counts: {listed(differ, 3)}.")
    if without:
        notes.append(f"Styles: none of {len(without):,} clips, whose genre is empty: {listed(without, 3)}.")
    return Labels(styles, tuple(rejects), tuple(notes))


def _style_map(path: Path) -> dict[str, str]:
    if not path.is_file():
        return {}
    try:
        document = read_json(path, MAX_LIST_BYTES)
        if not isinstance(document, dict) or not all(isinstance(style, str) for style in document.values()):
            raise ValueError("not an object of texts")
    except (OSError, ValueError) as error:
        raise SourceError("infinitedance: the map of styles cannot be read", where=str(path), found=str(error),
                          allowed='{"NAME": "STYLE", ...}',
                          fix="download the file again, or remove it") from error  # fmt: skip
    return {name: style for name, style in document.items() if style}


def _layout(motions: str, suffix: str, published: str) -> Layout:
    return Layout(
        "infinitedance", "InfiniteDance", motions, suffix, f"NAME{suffix}",
        # InfiniteDance's retrieval names pieces NAME@START_END.
        lambda stem: "a name with @, which separates names from frames" if "@" in stem else "",
        folder_names=("infinitedance",), published=f"{published} were published",
    )  # fmt: skip


LAYOUTS = {
    "fits": _layout(FITS_FOLDER, ".pkl", "9,748 fits"),
    "columns": _layout(COLUMNS_FOLDER, ".npy", "10,870 files of columns"),
}


@DATASETS.register("infinitedance")
@dataclass(frozen=True)
class InfiniteDance(PublishedDataset):
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

    has_audio: ClassVar[bool] = False
    licence: ClassVar[str] = (
        "InfiniteDance Non-Commercial Research License: academic research, education and evaluation; redistribution "
        "under the same terms, with citation. Clips of AIST++, FineDance and Motorica keep their own terms, so the "
        "whole must not be passed on."
    )
    citation: ClassVar[str] = (
        "InfiniteDance: Scalable 3D Dance Generation Towards in-the-wild Generalization, ECCV 2026, arXiv:2603.13375."
    )

    @property
    @override
    def official_split(self) -> bool:
        return self.split != ALL

    @property
    def layout(self) -> Layout:  # type: ignore[override]
        """The folder of fits, or of columns."""
        return LAYOUTS[self.motion]

    @override
    def body_of(self, ref: ClipRef) -> Skeleton | None:
        return SMPLX22 if self.motion == "fits" else None

    @override
    def find(self, source: Path) -> Listing:
        folders, motions = self.layout.list_motions(source)
        beside = NO_FILES
        if self.motion == "columns":  # those of some test clips are in a folder of their own alone
            beside = files_by_stem(folders.root / TEST_FOLDER, source, ".npy", self.layout.name_problem)
            motions = replace(motions, files={**beside.files, **motions.files})
        styles = read_styles(folders.root, folders.source, motions.files)
        return Listing(folders, motions, NO_FILES, beside, labels=styles)

    @override
    def song_of(self, name: str) -> str:
        aist = AIST.fullmatch(name)
        return aist[2] if aist else name

    @override
    def splits(self, listing: Listing) -> Splits:
        folder = listing.folders.root / "partition"
        paths = [path for path in list_folder(folder) if path.suffix.lower() == ".txt"] if folder.is_dir() else []
        lists = {path.stem: frozenset(read_names(path, spaces=True)) for path in paths}
        if self.split == ALL:
            return Splits(dict.fromkeys(listing.motions.files, ALL), ("Splits: none.",), lists)
        names = LISTS[self.split]
        missing = [f"no {name}.txt" for name in names if name not in lists]
        shared = [] if missing else sorted(lists[names[0]] & lists[names[1]])
        if missing or shared:
            what = "lists are missing" if missing else "the lists name the same clips"
            raise SourceError(f"infinitedance: {what}", where=str(folder), found=listed(missing or shared),
                              allowed=" and ".join(f"partition/{name}.txt" for name in names),
                              fix="download partition/ again, or set dataset.infinitedance.split: all")  # fmt: skip
        train, test = (lists[name] for name in names)
        songs = [{match[2] for match in map(AIST.fullmatch, clips) if match} for clips in (train, test)]
        both = sorted(songs[0] & songs[1])
        leak = f"; songs of AIST++ in both: {listed(both, 6)}" if both else ""
        note = (
            f"Splits: {self.split}: {len(train):,} names of {names[0]}.txt are train, {len(test):,} of "
            f"{names[1]}.txt test, no val{leak}. Names are the only trace of songs: what else the lists share is "
            "not known."
        )
        without = f"on neither {' nor '.join(names)}; dataset.infinitedance.split: all has no lists"
        of = dict.fromkeys(train, "train") | dict.fromkeys(test, "test")
        return Splits(of, (note,), dict(sorted(lists.items())), train | test, without)

    @override
    def all_clips(self, refs: Sequence[ClipRef], listing: Listing, left_out: list[Reject]) -> list[ClipRef]:
        """Return the clips with the dataset that each comes from, and its style."""
        fits = files_by_stem(
            listing.folders.root / FITS_FOLDER, listing.folders.source, ".pkl", lambda stem: ""
        ).files
        origins, styles = _origins_of(refs, fits), listing.labels.of
        stated = []
        for ref in refs:
            aist = AIST.fullmatch(ref.id)
            facts = {"genre": styles.get(ref.id, ""), "dancer": aist[1] if aist else ""}
            stated.append(replace(ref, columns=(("origin", origins[ref.id]),), **facts))
        return super().all_clips(stated, listing, left_out)

    @override
    def clips_of(self, ref: ClipRef, listing: Listing) -> Iterable[ClipRef]:
        origin = dict(ref.columns)["origin"]
        if self.clips == "own" and origin != OWN:
            raise LeftOut("other_dataset", f"origin: {origin}")
        yield ref

    @override
    def notes(self, listing: Listing, clips: Sequence[ClipRef]) -> Iterable[str]:
        test = listing.beside.files
        twice = sorted(name for name, path in test.items() if listing.motions.files[name] != path)
        if twice:
            yield f"Columns: {counted(len(twice), 'clip')} in {TEST_FOLDER}/ as well, not read: {listed(twice, 3)}."
        yield "Music: no audio was published, but files of features."
        yield from listing.labels.notes
        if clips:
            yield _origins_note([str(dict(clip.columns)["origin"]) for clip in clips])

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read the motion of one clip: 30 FPS, metres, radians, +Y up."""
        return _load_fit(ref.motion_path, self.up) if self.motion == "fits" else load_columns(ref.motion_path)

    @override
    def make_example(self, folder: Path) -> None:
        """Write four clips of six seconds: fits, columns, tokens, features with random values, lists and styles."""
        from dancedata.datasets._examples import dance, write_array, write_json, write_lines, write_pickle

        rng = np.random.default_rng(0)
        for clip, n, is_own, split, style, steps in _CLIPS:
            motion = transfer_to(dance(steps, n), SMPLX22)
            if is_own:
                pose = motion.rotations[:, 1:].astype(np.float32)
                content = {
                    "body_pose": pose.reshape(n, -1) if clip.startswith("video") else pose,
                    "global_orient": motion.rotations[:, 0].astype(np.float32),
                    "transl": motion.translation.astype(np.float32),
                }
                write_pickle(folder / FITS_FOLDER / f"{clip}.pkl", content)  # joblib.load reads these as well
            columns = REPRESENTATIONS.get("humanml264")().encode(motion)[:-1]  # the published ones have no last row
            for name in (COLUMNS_FOLDER, TEST_FOLDER) if split == "test" else (COLUMNS_FOLDER,):
                write_array(folder / name / f"{clip}.npy", columns)
            triplets = rng.integers(0, CODES, (len(columns) // FRAMES_PER_TOKEN, len(FIRST_CODES))) + FIRST_CODES
            write_array(folder / TOKENS_FOLDER / f"{clip}.npy", triplets.reshape(-1))
            features = rng.normal(size=(n, 55)).astype(np.float32)
            features[:, 53] = np.arange(n) % 15 == 0
            write_array(folder / MUSIC55_FOLDER / f"{clip}.npy", features)
            if split == "test":
                muq = rng.normal(size=(n * MUQ_RATE // RATE, 1024)).astype(np.float32)
                write_array(folder / MUQ_FOLDER / f"{clip}.npy", muq)
            if style:
                write_json(folder / "styles" / f"{clip}.json", {"style": style})
        styles = {clip: style for clip, _, _, _, style, _ in _CLIPS if style}
        write_json(folder / "styles" / "all_style_map.json", styles)
        for k, (name, splits, recorded) in enumerate(_LISTS):
            names = [clip for clip, _, is_own, of, *_ in _CLIPS if of == splits and recorded in (None, is_own)]
            write_lines(folder / "partition" / f"{name}.txt", names, end="\n" * (k % 2))


def _origins_of(refs: Iterable[ClipRef], fits: Collection[str]) -> dict[str, str]:
    """Return the dataset that each clip comes from: by the lists of datasets, then its name, then a fit."""
    origins = {}
    for ref in refs:
        listed_in = [match[1] for name in ref.lists if (match := _LIST.fullmatch(name)) and match[1] in _ORIGINS]
        by_name = next((origin for origin, form in _NAMES if form.fullmatch(ref.id)), "")
        stated = _ORIGINS[listed_in[-1]][0] if listed_in else ""
        origins[ref.id] = stated or by_name or (OWN if ref.id in fits else UNKNOWN)
    return origins


def _origins_note(origins: Collection[str]) -> str:
    counts = sorted(Counter(origins).items())
    numbers = ", ".join(f"{n:,} {name}" for name, n in counts)
    others = [f"{TERMS[name]} ({name})" for name, _ in counts if name in TERMS and name != OWN]
    terms = f"; clips of other datasets keep their own terms: {', '.join(others)}" if others else ""
    unknown = f"; {UNKNOWN}: on no list of one dataset" if UNKNOWN in origins else ""
    return f"Origin of the clips: {numbers}{terms}{unknown}."


def _load_fit(path: Path, up: str = "auto") -> Motion:
    """Read a fit: 30 FPS, metres, turned from its axis `up` to +Y; (T, 22, 3) of SMPLX22, without SMPL's hands."""
    with open_arrays(path) as arrays:
        pose, root, places = checks.read_frames(arrays, _SHAPES)
    rotations = np.concatenate([root, pose[:, : 3 * BODY]], axis=1).reshape(len(pose), -1, 3)
    checks.require_rotations(path, "body_pose", rotations, places, SMPLX22.parents)
    motion = Motion(places, rotations, FrameGrid.of(RATE), SMPLX22)
    return checks.upright(motion, checks.up_axis(path, checks.spine_of(motion), up, "infinitedance", AXES))


def load_columns(path: Path) -> Motion:
    """Read a file of 264 columns as the joints that humanml264 decodes, 30 FPS; rotations are fitted to them."""
    with open_arrays(path) as arrays:
        shape = arrays.shape("") if arrays.names == ("",) else ()
        if len(shape) != 2 or shape[1] != COLUMNS:
            raise checks.bad_shape(path, "the array", shape, f"(T, {COLUMNS})")
        columns = arrays.read("")
    if not len(columns):
        raise checks.no_frames(path)
    checks.require_finite(path, "the array", columns, columns=True)
    return REPRESENTATIONS.get("humanml264")().decode(columns, FrameGrid.of(RATE))


#: Of the example: clip, frames, whether it is a fit of the dataset's own, split, style, and the synthetic clip.
_CLIPS = (
    ("video_0001", 182, True, "train", "Popular", "gBR_sBM_cAll_d04_mBR0_ch01"),
    ("my clip 2 (live)", 185, True, "train", "Folk", "gPO_sBM_cAll_d10_mPO4_ch03"),
    ("gBR_sBM_cAll_d04_mBR0_ch02", 183, False, "train", "", "gBR_sBM_cAll_d04_mBR0_ch02"),
    ("video_0002", 184, True, "test", "Modern", "gMH_sBM_cAll_d22_mMH1_ch04"),
)
#: Its lists: the name, the split, and whether clips of the dataset's own are on it, others, or both.
_LISTS = (
    ("All_cleandata_train", "train", None), ("test_eval861", "test", None), ("All_train", "train", None),
    ("All_eval", "test", None), ("infinitedance_train", "train", True), ("infinitedance_eval", "test", True),
    ("aistpp_train", "train", False),
)  # fmt: skip
#: Numbers of the first code of each level, and codes of a level; frames of a triplet; rows of MuQ per second.
FIRST_CODES, CODES, FRAMES_PER_TOKEN, MUQ_RATE = (4096, 4608, 5120), 512, 4, 25
