"""FineDance (Li et al. 2023): full-body dance with hands to music in 16 genres, 211 sequences, 30 FPS.

The files: docs/datasets/finedance.md. Splits, ignore lists, trims and genres are in ``manifests/finedance.yaml``.
"""

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from dancedata.core.bodies import SMPLX52, SMPLX55, transfer_to
from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.registry import DATASETS
from dancedata.core.resources import manifest
from dancedata.core.rotations import rotation_6d
from dancedata.core.skeleton import Skeleton
from dancedata.core.text import counted, listed, quoted
from dancedata.core.typing import override
from dancedata.datasets.checks import bad_shape, check_rows, no_frames, require_finite, rotations_of
from dancedata.datasets.files import ALL, extra_file, files_by_stem
from dancedata.datasets.published import Layout, LeftOut, Listing, PublishedDataset, Splits
from dancedata.files.listing import list_folder
from dancedata.files.strict_json import read_json
from dancedata.formats.values import open_arrays

RATE, JOINTS = 30, SMPLX52.n_joints
COLUMNS = 3 + 6 * JOINTS
#: All published ids.
IDS = tuple(f"{n:03d}" for n in range(1, 212))
KEY, MUSIC, LABELS = "style2", "music_wav", "label_json"
#: Labels have about a hundred bytes; larger files are not read.
MAX_BYTES = 1 << 20


def read_genre(path: Path | None, clip: str) -> str:
    """Return the genre, ``style2`` of a label; LeftOut: ``missing_label``, ``broken_label``, ``unknown_genre``."""
    name = f"label_json/{clip}.json"
    if path is None:
        raise LeftOut("missing_label", f"there is no {name}", fix=WITHOUT_LABELS)
    try:
        content = read_json(path, MAX_BYTES)
        if not isinstance(content, dict):
            raise ValueError(f"a {type(content).__name__}, not an object with {KEY}")
    except (OSError, ValueError) as error:
        raise LeftOut("broken_label", f"{name} cannot be read: {error}", fix=WITHOUT_LABELS) from error
    style = content.get(KEY)
    if style is None or style == "":
        keys = listed(content, show=quoted) or "none"
        raise LeftOut("missing_label", f"{name} has no {KEY}; keys found: {keys}", fix=WITHOUT_LABELS)
    genre = genre_of(style) if isinstance(style, str) else ""
    if not genre:
        problem = f"{name}: {KEY} is {quoted(style, 40)}, not one of {', '.join(manifest('finedance')['genres'])}"
        raise LeftOut("unknown_genre", problem, fix=WITHOUT_LABELS)
    return genre


def genre_of(style: str) -> str:
    """Return the canonical name of a genre in the labels, "" if it is not one of the sixteen."""
    folded = style.strip().casefold()
    return next((genre for genre, entry in manifest("finedance")["genres"].items()
                 if folded in {name.casefold() for name in (genre, *entry.get("also", ()))}), "")  # fmt: skip


def ignored_by(protocol: str) -> frozenset[str]:
    """Return the ids on the ignore lists of a protocol."""
    lists = manifest("finedance")["ignore_lists"].values()
    return frozenset(clip for entry in lists if protocol in entry["applies_to"] for clip in entry["ids"])


def listed_in(protocol: str, clip: str) -> str:
    """Return "val" or "test" if the protocol lists the id there, ignored or not; else ""."""
    lists = manifest("finedance")["splits"][protocol]
    return next((split for split in ("val", "test") if clip in lists[split]), "")


def lists_of(clip: str) -> tuple[str, ...]:
    """Return all lists that contain the id: ``cross_genre.val``; train has what is neither listed nor ignored."""
    names = []
    for protocol in manifest("finedance")["splits"]:
        split = listed_in(protocol, clip)
        if split or clip not in ignored_by(protocol):
            names.append(f"{protocol}.{split or 'train'}")
    return (*names, *(name for name, of in manifest("finedance")["ignore_lists"].items() if clip in of["ids"]))


def trims() -> dict[str, int]:
    """Return the number of frames that Lodge trims at the beginning, by id."""
    return {t["id"]: t["frames"] if "frames" in t else RATE * t["seconds"] for t in manifest("finedance")["trims"]}


def _id_problem(stem: str) -> str:
    if re.fullmatch(r"M[0-9]{3}", stem):
        return "a mirrored copy, as made by Lodge; augment.mirror computes it from the original"
    # An explicit range: \\d would accept digits of other scripts.
    return "" if re.fullmatch(r"[0-9]{3}", stem) else "not named by an id of three digits, 001"


@DATASETS.register("finedance")
@dataclass(frozen=True)
class FineDance(PublishedDataset):
    """FineDance, from the published files.

    Attributes
    ----------
    split
        ``cross_genre`` (every genre in train and test; it has no val) or ``cross_dancer`` (no dancer in two
        splits). Ids on no list are train.
    keep
        Ids that stay in their split although the split's ignore list contains them, as text (``["120"]``), or
        ``all``. Without it the ignore list takes precedence, as in Lodge and FineDance.
    labels
        ``required`` leaves out sequences whose label is missing or not one of the 16 genres; ``optional`` keeps
        them, without a genre.
    music_dir
        Folder of the music, where it is not in the source: files by the same names, which come before the source's.
    """

    split: Literal["cross_genre", "cross_dancer"] = field(default="cross_genre", metadata={"scan": True})
    keep: Literal["all"] | tuple[str, ...] = field(default=(), metadata={"scan": True})
    labels: Literal["required", "optional"] = field(default="required", metadata={"scan": True})
    music_dir: Path | None = field(default=None, metadata={"path": True})

    #: Bones that Lodge and FineDance published; they published no betas, so all motion is on the neutral body.
    body: ClassVar[Skeleton] = SMPLX55
    licence: ClassVar[str] = (
        "Non-commercial scientific research, education and art only (Tsinghua University's licence for the FineDance "
        "data); no redistribution, in whole or in part."
    )
    citation: ClassVar[str] = (
        "Li et al., FineDance: A Fine-grained Choreography Dataset for 3D Full Body Dance Generation, ICCV 2023."
    )

    layout: ClassVar[Layout] = Layout(
        "finedance", "FineDance", "motion", ".npy", "001.npy", _id_problem, folder_names=("finedance",)
    )
    music_folders: ClassVar[tuple[str, ...]] = (MUSIC,)

    def __post_init__(self) -> None:
        super().__post_init__()
        on_a_list = sorted(clip for of in manifest("finedance")["ignore_lists"].values() for clip in of["ids"])
        unknown = [] if self.keep == ALL else [clip for clip in self.keep if clip not in on_a_list]
        if unknown:
            raise UsageError("finedance: keep contains ids that are on no ignore list",
                             found=", ".join(map(repr, unknown)),
                             allowed=f"all, or a list of {', '.join(on_a_list)}",
                             fix="write ids as text, in quotes: ['120']")  # fmt: skip

    @property
    @override
    def genre_ids(self) -> Mapping[str, int]:
        return {genre: entry["id"] for genre, entry in manifest("finedance")["genres"].items()}

    @override
    def find(self, source: Path) -> Listing:
        listing = super().find(source)
        labels = files_by_stem(listing.folders.root / LABELS, source, ".json", _id_problem)
        unused = [name for name in labels.files if name not in listing.motions.files]
        extra = [extra_file(labels.files[name], source, f"there is no motion/{name}.npy") for name in unused]
        return replace(listing, beside=replace(labels, rejects=(*extra, *labels.rejects)))

    @override
    def splits(self, listing: Listing) -> Splits:
        kept = ignored_by(self.split) if self.keep == ALL else ignored_by(self.split) & set(self.keep)
        ignored = {}
        for clip in sorted(ignored_by(self.split) - kept):
            names = [name for name in lists_of(clip) if name in manifest("finedance")["ignore_lists"]]
            split = listed_in(self.split, clip)
            both = f", and in {self.split}.{split}; the ignore list takes precedence" if split else ""
            ignored[clip] = f"on the list {' and '.join(names)}{both}; keep: ['{clip}'] keeps it"
        of = {clip: listed_in(self.split, clip) or "train" for clip in IDS}
        without = f"FineDance has {IDS[0]} to {IDS[-1]}; use the dataset `folder` for your own data"
        notes = tuple(_list_notes(self.split, listing.motions.files))
        return Splits(of, notes, expected=frozenset(IDS), without=without, ignored=ignored)

    @override
    def clips_of(self, ref: ClipRef, listing: Listing) -> Iterable[ClipRef]:
        notes: tuple[str, ...] = ()
        try:
            genre = read_genre(listing.beside.files.get(ref.id), ref.id)
        except LeftOut as why:
            if self.labels == "required":
                raise
            genre, notes = "", (str(why),)
        yield replace(ref, genre=genre, lists=lists_of(ref.id), notes=notes)

    @override
    def notes(self, listing: Listing, clips: Sequence[ClipRef]) -> Iterable[str]:
        labels = f"; {LABELS}/ ({counted(len(listing.beside.files), 'file')})"
        root, n_known = listing.folders.root, len(set(IDS) & listing.motions.files.keys())
        yield f"Motion: FineDance has {len(IDS)} sequences, {len(IDS) - n_known} of which have no file here{labels}."
        if len(listing.motions.files) > n_known:
            yield f"Motion: {len(listing.motions.files) - n_known:,} more have unknown ids, in no split (unassigned)."
        beside = [e.name for e in list_folder(root) if e.is_dir() and e.name not in ("motion", MUSIC, LABELS)]
        if beside:
            why = " Music features are computed from the audio." if "music_npy" in beside else ""
            yield f"Not read: {listed(f'{name}/' for name in beside)}.{why}"
        yield from _clip_notes(clips)

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read one clip: 30 FPS, metres, radians, +Y up, SMPL-X's 55 joints; it begins where Lodge trims it."""
        return load_motion(ref.motion_path, trims().get(ref.id, 0))

    @override
    def make_example(self, folder: Path) -> None:
        """Write four clips of six seconds: ``motion/``, ``music_wav/`` and ``label_json/``."""
        from dancedata.datasets._examples import write_array, write_json, write_song

        # Id, frames, style1, style2, and the synthetic clip that provides steps and song. 010 has a beginning to
        # trim (three frames), 063 is a test clip of both releases' cross-genre split.
        for clip, n, coarse, fine, steps in (
            ("001", 181, "Street", "Popping", "gPO_sBM_cAll_d10_mPO4_ch03"),
            ("010", 186, "Street", "Breaking", "gBR_sFM_cAll_d04_mBR4_ch01"),
            ("063", 180, "Modern", "Hiphop", "gMH_sBM_cAll_d22_mMH1_ch04"),
            ("150", 182, "Modern", "jazz", "gJS_sFM_cAll_d01_mJS1_ch02"),
        ):
            motion = _with_hands(steps, n)
            # FineDance's array (T, 315): translation, then 52 joints x 6D.
            rows = rotation_6d(transfer_to(motion, SMPLX52).matrices).reshape(n, -1)
            columns = np.concatenate([motion.translation, rows], axis=1)
            write_array(folder / "motion" / f"{clip}.npy", columns.astype(np.float32))
            write_song(folder / MUSIC / f"{clip}.wav", steps, n / RATE)
            label = {"name": f"synthetic {clip}", "style1": coarse, "style2": fine}
            write_json(folder / LABELS / f"{clip}.json", label)


WITHOUT_LABELS = "add labels to label_json/, or keep clips without a genre: --set dataset.finedance.labels=optional"


def _list_notes(protocol: str, present: Collection[str]) -> Iterable[str]:
    lists = manifest("finedance")["splits"][protocol]
    n_val, n_test = (len(lists[split]) for split in ("val", "test"))
    yield f"Splits: {protocol}: {n_val} in val, {n_test} in test, all others in train, except ignored ids."
    if not n_val:
        yield f"Splits: {protocol} has no val; Lodge and FineDance evaluate only after training."
    for name, entry in manifest("finedance")["ignore_lists"].items():
        there = sorted(set(entry["ids"]) & set(present))
        where = ", ".join(f"{clip} ({listed_in(protocol, clip) or 'train'})" for clip in there)
        if protocol in entry["applies_to"]:
            yield f"Ignore list: {name} ({entry['source']}): {len(there)} of {len(entry['ids'])} ids are here."
        elif there:
            yield f"Ignore list: {where} not ignored here; {entry['source']} leaves them out (list {name})."


def _clip_notes(clips: Sequence[ClipRef]) -> Iterable[str]:
    cuts = [f"{clip.id} ({trims()[clip.id]:,} frames)" for clip in clips if clip.id in trims()]
    if cuts:
        kept = "The frames are kept; trim_start is the first of the dance."
        yield f"Trims: Lodge trims the beginning of {listed(cuts, 12)}. {kept}"
    n, of = len({clip.genre for clip in clips if clip.genre}), len(manifest("finedance")["genres"])
    yield f"Genres: {n:,} of {of:,}, from style2 of the labels, with Lodge's names."
    unlabelled = [f"{clip.id} ({'; '.join(clip.notes)})" for clip in clips if not clip.genre]
    if unlabelled:
        n_clips = counted(len(unlabelled), "clip")
        yield f"Genres: {n_clips} kept without a genre, as requested: {listed(unlabelled, 3)}."
    silent = [clip.id for clip in clips if clip.audio_path is None]
    if silent:
        n_clips = counted(len(silent), "clip")
        yield f"Music: {n_clips} without a file in {MUSIC}/ ({listed(silent)}), for recipes without audio features."


def load_motion(path: Path, trim_start: int = 0) -> Motion:
    """Read translation and 52 x 6D of a (T, 315) array: 30 FPS, metres, +Y up; axis-angle (T, 55, 3)."""
    with open_arrays(path) as arrays:
        shape = arrays.shape("")
        if len(shape) != 2 or shape[1] != COLUMNS:
            allowed = f"(T, {COLUMNS}) of floats: translation 3, then {JOINTS} joints x 6D"
            raise bad_shape(path, "the motion", shape, allowed, "use the files of motion/ as published")
        if shape[0] == 0:
            raise no_frames(path)
        array = arrays.read("")
    require_finite(path, "the motion", array, columns=True)
    rows = array[:, 3:].reshape(len(array), JOINTS, 6)
    check_rows(path, rows)
    if trim_start >= len(array):
        raise DataError("no frame of the motion is left after the trim", reason="too_short", where=str(path),
                        found=f"{len(array)} frames, the first {trim_start} of them to be trimmed",
                        fix="check that this is the file of that id")  # fmt: skip
    return Motion(array[:, :3], rotations_of(rows), FrameGrid.of(RATE), SMPLX55, trim_start)


def _with_hands(steps: str, n_frames: int) -> Motion:
    """Return a dance on SMPL-X's joints, feet on the floor (y = 0), fingers opening and closing."""
    from dancedata.datasets._examples import dance

    motion = transfer_to(dance(steps, n_frames), SMPLX55, keep="translation")
    rotations = motion.rotations.copy()
    curl = 0.35 - 0.25 * np.cos(2 * np.pi * np.arange(n_frames) / RATE)
    # About z, towards the palms, which face the floor at rest.
    rotations[:, 25:40, 2] = -curl[:, None]
    rotations[:, 40:55, 2] = curl[:, None]
    feet = motion.joints()[:, list(SMPLX55.feet), 1]
    translation = motion.translation - (0.0, feet.min() - 0.02, 0.0)
    return Motion(translation, rotations, motion.grid, SMPLX55)
