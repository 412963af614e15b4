"""One's own captures: a folder of motion files and music, with a small manifest or matching file names.

With a manifest, ``manifest.csv`` or ``manifest.jsonl``, whose paths lie below the source folder:

.. code-block:: text

    SOURCE/manifest.csv      motion,audio,split,genre,fps,up,unit
                             takes/anna_01.bvh,songs/blue.flac,train,waltz,,,cm
                             amass/anna_02_poses.npz,songs/blue.flac,test,waltz,,,

or without one, motion and music of one name belonging together:

.. code-block:: text

    SOURCE/motions/NAME.npz  and SOURCE/music/NAME.wav (or wavs/, audio/)
    SOURCE/NAME.bvh          and SOURCE/NAME.wav

Motion: ``.npz``, ``.npy``, ``.pkl`` in the layouts of AMASS, SMPL, SMPL-X and FineDance (`_folder_layouts`), and
``.bvh`` of any skeleton that has a body's joints (`_bvh_names`). Rate, up axis and unit are what the manifest
declares, else what the file or its format says, else what the recipe declares; never guessed unawares. Music:
wav, flac, mp3, ogg. See docs/own-data.md.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

from dancedata.core.clip import ClipRef, Reject, Scan
from dancedata.core.errors import DataError, SourceError, UsageError, did_you_mean
from dancedata.core.grid import as_rate
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import SMPL24
from dancedata.datasets._near_music import NearMusic
from dancedata.datasets._source import counted, relative, require_folder
from dancedata.datasets._split_rule import SplitRule
from dancedata.datasets.folder.facts import Declared
from dancedata.datasets.folder.load import SUFFIXES, Reading, describe, load_motion
from dancedata.datasets.folder.manifest import MANIFESTS, Row, clip_id, id_problem, inside, read_manifest
from dancedata.datasets.folder.match import LOOKED_FOR, MUSIC, match_names

__all__ = ["Folder"]

#: How many kinds of files the notes tell apart.
_SHOWN = 12


@DATASETS.register("folder")
@dataclass(frozen=True)
class Folder(Dataset):
    """A folder of one's own captures. What is declared here is for files that say nothing themselves.

    Attributes
    ----------
    fps : frames a second, of files that hold no rate: 30, 59.94 or "30000/1001".
    up : "y" or "z", the axis that points up in files whose format leaves it open. BVH is +Y unless declared.
    unit : unit of lengths, of files that do not say it (BVH never does): "m", "cm", "mm", "inch", "cmu" (the CMU
        database: inch / 0.45), metres a unit such as 0.0254, or "guess": the unit that makes the skeleton of a
        BVH 1.2 to 2.2 m tall.
    layout : "auto", or what arrays are: "amass", "smpl", "smplh", "smplx", "finedance".
    joint_map : SMPL joint -> name in the BVH files, where the known names do not do; "" leaves a joint out.
    body_model : SMPL-X, SMPL-H or SMPL model (.npz), or a folder of them: bones of arrays come from it, with the
        betas and the gender that the file holds. Without it they are those of the mean body.
    gender : "neutral", "male" or "female", for a body model, of files that hold none.
    split : split of clips to which the manifest gives none: a name, or a rule such as
        ``{val: 0.1, test: 0.1, by: music, seed: 0}`` that keeps clips of one music (dancer, genre) together, see
        `_split_rule`.
    music : "required" sets clips without music aside; "optional" keeps them, without audio.
    """

    fps: float | str | None = None
    up: Literal["y", "z"] | None = None
    unit: float | str | None = None
    layout: Literal["auto", "amass", "smpl", "smplh", "smplx", "finedance"] = "auto"
    joint_map: Mapping[str, str] | None = None
    body_model: Path | None = field(default=None, metadata={"path": True, "content": True})
    gender: Literal["neutral", "male", "female"] | None = None
    split: str | Mapping[str, Any] = field(default="train", metadata={"scan": True})
    music: Literal["required", "optional"] = field(default="required", metadata={"scan": True})

    generic: ClassVar[bool] = True
    version: ClassVar[int] = 1
    licence: ClassVar[str] = "Your own data: their terms are yours to state."
    citation: ClassVar[str] = "Your own data: cite where they come from."

    def __post_init__(self) -> None:
        # One way to write a number, for two recipes that say the same are the same.
        if self.fps is not None:
            object.__setattr__(self, "fps", _rate_text(self.fps))
        if self.unit is not None:
            object.__setattr__(self, "unit", str(self.unit))
        if self.body_model is not None:
            object.__setattr__(self, "body_model", Path(self.body_model).expanduser())
        problem = self._declared.problem()
        if problem is not None:
            name, value, allowed = problem
            raise UsageError(f"folder: {name} cannot be that", found=repr(value), allowed=allowed, fix=f"set {name}")
        for joint in self.joint_map or {}:
            if joint not in SMPL24.joints:
                problem_text = f"folder: joint_map names no joint of SMPL: {joint!r}"
                raise UsageError(problem_text, allowed=did_you_mean(joint, SMPL24.joints))
        if isinstance(self.split, str):
            from dancedata.store.schema import check_name

            check_name(self.split, "split")
        else:
            object.__setattr__(self, "split", SplitRule.of(self.split).document())

    def scan(self, source: Path) -> Scan:
        """List the clips; of motion files the headers are read, for the notes (pickles have none: the whole).

        Returns
        -------
        Scan
            Clips by id. Rejects, each by name: ``missing_motion``, ``missing_music``, ``ambiguous_name``,
            ``unused_music``, ``extra_file``. Notes say what was matched, declared, read and assumed.

        Raises
        ------
        SourceError
            If there is no motion, or anything is wrong in the manifest.
        """
        source = Path(source)
        require_folder("folder", source, LOOKED_FOR)
        self._check_body_model()
        manifests = [source / name for name in MANIFESTS if (source / name).exists()]
        if len(manifests) > 1:
            raise SourceError(
                "folder: two manifests, and nothing says which is meant",
                where=str(source),
                found=" and ".join(MANIFESTS),
                fix="take one of them away",
            )
        rows = read_manifest(manifests[0]) if manifests else []
        found = self._listed(source, manifests[0], rows) if manifests else self._matched(source)
        clips, rejects, notes, layout = found
        given = any(row.get("split") for row in rows)
        clips, splits = self._split(sorted(clips, key=lambda clip: clip.id), given)
        clips, about = self._described(clips)
        notes += [*splits, *about]
        return Scan(layout, tuple(clips), tuple(rejects), tuple(notes))

    def load(self, ref: ClipRef) -> Motion:
        """Read the motion of one clip: metres, +Y up, radians; on SMPL's, SMPL-H's or SMPL-X's joints.

        A BVH is put on SMPL's 24 joints with its own bone lengths, see `_bvh_retarget`.

        Raises
        ------
        DataError
            If the file is no good, or something has to be declared; `.reason` says in which way.
        """
        return load_motion(ref.motion_path, self._reading(ref))

    def make_example(self, folder: Path) -> None:
        """Write three clips of six seconds with a manifest: AMASS and SMPL arrays and a BVH, two songs."""
        from dancedata.datasets.folder.example import write_example

        write_example(Path(folder))

    @property
    def _declared(self) -> Declared:
        fps = None if self.fps is None else str(self.fps)
        unit = None if self.unit is None else str(self.unit)
        return Declared(fps, self.up, unit, self.layout, self.gender)

    def _reading(self, ref: ClipRef) -> Reading:
        return Reading(Declared(**dict(ref.declared)), self._declared, self.joint_map, self.body_model)

    def _check_body_model(self) -> None:
        if self.body_model is not None and not self.body_model.exists():
            raise SourceError(
                "folder: there is no such body model", where=str(self.body_model), fix="correct body_model"
            )

    def _listed(
        self, source: Path, manifest: Path, rows: list[Row]
    ) -> tuple[list[ClipRef], list[Reject], list[str], str]:
        """Clips of a manifest; a file that is not there is a reject."""
        audio = {row.get("audio") for row in rows if row.get("audio")}
        stems = Counter(Path(text).stem for text in audio)
        clips, rejects = [], []
        near = _near_listed(source, audio)
        for row in rows:
            clip = self._clip(source, manifest, row, stems, near)
            if not isinstance(clip, Reject):
                clips.append(clip)
            else:
                rejects.append(clip)
        notes = [f"Manifest: {manifest.name}, {counted(len(rows), 'clip')}."]
        return clips, rejects, notes, f"manifest ({manifest.suffix.removeprefix('.')})"

    def _clip(self, source: Path, manifest: Path, row: Row, stems: Counter[str], near: NearMusic) -> ClipRef | Reject:
        name, split = clip_id(row), row.get("split") or self._default_split
        _check_row(manifest, row, split)
        motion = inside(source, row.get("motion"), manifest, row.line, "motion")
        text = row.get("audio")
        audio = inside(source, text, manifest, row.line, "audio") if text else None
        if not motion.is_file():
            detail = f"listed, but {_absence(motion)}"
            return Reject("missing_motion", clip=name, file=row.get("motion"), detail=detail)
        if audio is not None and not audio.is_file():
            detail = f"{manifest.name} names {text}: {_absence(audio)}"
            fix = near.fix(Path(text).with_suffix("").as_posix())
            return Reject("missing_music", clip=name, file=text, detail=detail, music=text, fix=fix)
        if audio is None and self.music == "required":
            return Reject("missing_music", clip=name, detail=f"{manifest.name} names no audio")
        song = Path(text)
        music = row.get("music") or (song.stem if stems[song.stem] < 2 else song.with_suffix("").as_posix())
        return ClipRef(
            name,
            motion,
            audio,
            split,
            music=music,
            tempo_bpm=row.tempo_bpm,
            genre=row.get("genre"),
            dancer=row.get("dancer"),
            declared=tuple(sorted((k, v) for k, v in vars(row.declared).items() if v is not None)),
        )

    def _matched(self, source: Path) -> tuple[list[ClipRef], list[Reject], list[str], str]:
        matched = match_names(source)
        clips, rejects = [], list(matched.rejects)
        for name, path in matched.motions.items():
            audio = matched.music.get(name)
            fix = matched.near.fix(matched.music_folder + name) if audio is None else ""
            problem = id_problem(name)
            if problem is not None:
                detail = f"its name, the clip's id, {problem}; rename it, or write a manifest with an id"
                rejects.append(Reject("bad_name", clip=name, file=relative(path, source), detail=detail))
            elif audio is None and self.music == "required":
                detail = f"no {name}.wav, .flac, .mp3 or .ogg"
                file = relative(path, source)
                rejects.append(Reject("missing_music", clip=name, file=file, detail=detail, music=name, fix=fix))
            else:
                music = name if audio else ""
                clips.append(ClipRef(name, path, audio, self._default_split, music=music, music_fix=fix))
        return clips, rejects, list(matched.notes), matched.layout

    def _described(self, clips: list[ClipRef]) -> tuple[list[ClipRef], list[str]]:
        """Add to each clip what is known of its file, and sum it up in notes."""
        counts: Counter[str] = Counter()
        described = []
        for clip in clips:
            try:
                about = describe(clip.motion_path, self._reading(clip))
            except DataError as error:
                about = (f"not usable ({error.reason}), see what is left out",)
            counts.update(about)
            described.append(replace(clip, notes=about))
        most = counts.most_common()
        notes = [f"{counted(n, 'file')}: {what}." for what, n in sorted(most[:_SHOWN], key=lambda item: item[0])]
        if len(most) > _SHOWN:
            notes.append(f"{len(most) - _SHOWN} more kinds of files.")
        return described, notes

    @property
    def _default_split(self) -> str:
        """Split of a clip that is given none; empty where a rule decides, once all clips are known."""
        return self.split if isinstance(self.split, str) else ""

    def _split(self, clips: list[ClipRef], given: bool) -> tuple[list[ClipRef], list[str]]:
        """Deal the clips out that have no split, and say how many are in each; `given`: a line names one."""
        if not isinstance(self.split, str):
            return SplitRule.of(self.split).apply(clips)
        splits = Counter(clip.split for clip in clips)
        if set(splits) == {self.split} and not given:
            one = len(clips) == 1
            which = f"the clip is in {self.split!r}" if one else f"all {len(clips):,} clips are in {self.split!r}"
            return clips, [f"Splits: none is given, so {which}."]
        said = ", ".join(f"{n:,} {split}" for split, n in sorted(splits.items()))
        return clips, [f"Splits: {said or 'no clip is left'}."]


def _near_listed(source: Path, audio: set[str]) -> NearMusic:
    """Music in the folders that the manifest names, apart from that which it names."""
    listed = {source / text for text in audio if ".." not in Path(text).parts and not Path(text).is_absolute()}
    folders = sorted({path.parent for path in listed})
    stems = {path.stem for path in listed}
    return NearMusic(source, (*folders, source), listed, stems.__contains__)


def _absence(path: Path) -> str:
    return "not a file" if path.exists() else "not there"


def _check_row(manifest: Path, row: Row, split: str) -> None:
    """Check what only a built dataset and its audio reader ask for."""
    from dancedata.core.errors import StoreError
    from dancedata.store.schema import SPLIT_ORDER, check_name

    where = f"{manifest}, line {row.line}"
    usual = split.casefold()
    if usual in SPLIT_ORDER and split not in SPLIT_ORDER:
        problem = f"folder: the split {split!r} differs from {usual!r} by case only"
        raise SourceError(problem, where=where, fix=f"write it as {usual}, which readers and statistics go by")
    try:
        check_name(split or "train", "split")
    except StoreError as error:
        raise SourceError(
            f"folder: {error.problem}", where=where, found=error.found, allowed=error.allowed
        ) from error
    for column, known in (("motion", SUFFIXES), ("audio", MUSIC)):
        suffix = Path(row.get(column)).suffix.lower()
        if row.get(column) and suffix not in known:
            problem = f"folder: {column} is no kind of file that is read"
            raise SourceError(problem, where=where, found=row.get(column)[:100], allowed=", ".join(known))


def _rate_text(fps: float | str) -> str:
    """Return a rate as the exact fraction's text, where it is one."""
    return str(as_rate(fps)) if Declared(fps=str(fps)).problem() is None else str(fps)
