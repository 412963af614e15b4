"""The reader of a folder of your own files."""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar, Literal

from dancedata.core.bodies import SMPLH52, SMPLX55
from dancedata.core.clip import FOUND, ClipRef, Reject, Scan, check_name
from dancedata.core.errors import DataError, SourceError, UsageError, did_you_mean
from dancedata.core.grid import as_rate
from dancedata.core.motion import Motion
from dancedata.core.plugins import Dataset
from dancedata.core.registry import DATASETS
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.text import counted
from dancedata.core.typing import override
from dancedata.datasets._split_rule import SplitRule, same_songs
from dancedata.datasets._words import stated_words
from dancedata.datasets.files import absence, relative, require_folder
from dancedata.datasets.folder.facts import Declared
from dancedata.datasets.folder.layout import LOOKED_FOR, match_names, points_note
from dancedata.datasets.folder.load import NO_LENGTH, Reading, describe, load_motion, motion_of, stated_time
from dancedata.datasets.folder.manifest import (
    Row,
    check_row,
    clip_id,
    genre_ids_of,
    guess_notes,
    id_problem,
    inside,
    offset_notes,
    on_frames,
    part_of,
    read_manifest,
)
from dancedata.datasets.folder.people import split_people
from dancedata.datasets.folder.positions import JOINT_SETS
from dancedata.datasets.folder.up import judge_up
from dancedata.files.listing import MANIFESTS, stem_of
from dancedata.formats.arrays import ArrayFile
from dancedata.formats.bvh.producers import producers

#: Most kinds of files that the notes distinguish.
_MAX_KINDS = 12
_WITHOUT_MUSIC = "build motion alone: --set dataset.folder.music=optional --set 'audio={}'"


@DATASETS.register("folder")
@dataclass(frozen=True)
class Folder(Dataset):
    """A folder of your own motion files and music. Declarations here apply to files that do not state the fact.

    Attributes
    ----------
    fps
        Frames per second of files without a frame rate: 30, 59.94 or "30000/1001".
    up
        "y" or "z", the up axis of files whose format does not define it; "-y" for a camera's axes (+Y down, +Z
        away from it). BVH is +Y unless declared.
    unit
        Unit of lengths in files that do not define it (BVH never does): "m", "cm", "mm", "inch", "cmu" (the CMU
        database: inch / 0.45), metres per unit such as 0.0254, or "guess": the unit in which the skeleton of a
        BVH is 1.2 to 2.2 m tall.
    layout
        "auto", or the layout of arrays: "amass", "smpl", "smplh", "smplx", "finedance",
        "wham", "phalp", "gvhmr", "mdm", "motionx", "humanml3d", "positions".
    joint_map
        SMPL joint -> name in the BVH files, for unknown names; "" excludes a joint. Or the name of a producer, such
        as "mixamo", whose names all BVH files use. Without it the producer of each file is found by its names.
    body_model
        SMPL-X, SMPL-H or SMPL model (.npz, .pkl), or a folder of them, for the bones of arrays. Betas and gender are
        those in the file. Without it bones are those of the mean body.
    gender
        "neutral", "male" or "female": gender of the body model for files that state none.
    split
        Split of clips without one in the manifest: a name, or a rule such as
        ``{val: 0.1, test: 0.1, by: music, seed: 0}`` that keeps clips of the same music (dancer, genre) together, see
        `_split_rule`.
    keys
        Names of the arrays in files of other layouts, ``{rotation: pred_thetas, translation: transl}``. Rotations
        are axis-angle, 3 columns per joint, or matrices, 9 row by row, of SMPL's 24, SMPL-H's 52 or SMPL-X's 55
        joints. ``scale`` names what divides the translation: one number, one per frame, or a weak-perspective camera
        (T, 3) with the scale first. ``{positions: NAME}`` names joint positions (T, J, 3). Files without the array
        are read as if there were no keys.
    joints
        Names of the joints of positions, in their order, where files do not have them; or a set: "smpl", "smpl22",
        "smplx", "coco17", "body25", "h36m17", "ntu25".
    people
        "split" makes a clip of each person in files that are divided by people, ``NAME-personID``; "one" reads
        files of one person, and sets others aside.
    language
        BCP 47 tag of the words in ``texts/`` and in ``segments.csv`` where a row has none, such as "en", whose
        rules mirror them.
    music
        "required" leaves out clips without music; "optional" keeps them, for recipes without audio features. With
        audio features it is an error if there are such clips.
    music_dir
        Folder of the music, where it is not in the source: files with the same names, which take precedence.
    """

    fps: float | str | None = None
    up: Literal["y", "z", "-y"] | None = None
    unit: float | str | None = None
    layout: Literal[
        "auto", "amass", "smpl", "smplh", "smplx", "finedance", "wham", "phalp", "gvhmr", "mdm", "motionx",
        "humanml3d", "positions",
    ] = "auto"  # fmt: skip
    joint_map: Mapping[str, str] | str | None = None
    body_model: Path | None = field(default=None, metadata={"path": True, "content": True})
    gender: Literal["neutral", "male", "female"] | None = None
    split: str | Mapping[str, Any] = field(default="train", metadata={"scan": True})
    music: Literal["required", "optional"] = field(default="required", metadata={"scan": True})
    music_dir: Path | None = field(default=None, metadata={"path": True})
    keys: Mapping[str, str] | None = None
    joints: str | tuple[str, ...] | None = None
    people: Literal["one", "split"] = field(default="one", metadata={"scan": True})
    language: str = field(default="", metadata={"scan": True})

    explicit_only: ClassVar[bool] = True
    version: ClassVar[int] = 4
    licence: ClassVar[str] = "Your own data: state their terms yourself."
    citation: ClassVar[str] = "Your own data: cite their origin."

    def __post_init__(self) -> None:
        # One spelling per number, so that equal recipes have equal hashes.
        if self.fps is not None:
            valid = Declared(fps=str(self.fps)).problem() is None
            object.__setattr__(self, "fps", str(as_rate(self.fps) if valid else self.fps))
        if self.unit is not None:
            object.__setattr__(self, "unit", str(self.unit))
        if self.body_model is not None:
            object.__setattr__(self, "body_model", Path(self.body_model).expanduser())
        problem = self._declared.problem()
        if problem is not None:
            name, value, allowed = problem
            raise UsageError(
                f"folder: invalid value for {name}", found=repr(value), allowed=allowed, fix=f"set {name}"
            )
        _check_keys(self.keys)
        if isinstance(self.joints, str) and self.joints not in JOINT_SETS:
            raise UsageError(
                f"folder: joints is not a known set of joints: {self.joints!r}",
                allowed=f"{did_you_mean(self.joints, tuple(JOINT_SETS))}; or a list of names",
            )
        if isinstance(self.joint_map, str) and self.joint_map not in producers():
            problem_text = f"folder: joint_map is not a producer: {self.joint_map!r}"
            allowed = f"{did_you_mean(self.joint_map, tuple(producers()))}; or a mapping {{left_hip: NAME, ...}}"
            raise UsageError(problem_text, allowed=allowed)
        for joint in self.joint_map if isinstance(self.joint_map, Mapping) else ():
            if joint not in SMPL24.joints:
                problem_text = f"folder: joint_map has a key that is not a joint of SMPL: {joint!r}"
                raise UsageError(problem_text, allowed=did_you_mean(joint, SMPL24.joints))
        if isinstance(self.split, str):
            check_name(self.split, "split")
        else:
            object.__setattr__(self, "split", SplitRule.of(self.split).document())

    @classmethod
    @override
    def has_listing(cls, source: Path) -> bool:
        return any((source / name).is_file() for name in MANIFESTS)

    @override
    def scan(self, source: Path) -> Scan:
        """List the clips; reads the headers of motion files for the notes (pickles completely: they have no header).

        Clips are sorted by id. Reasons of rejects: ``missing_motion``, ``missing_music``, ``ambiguous_name``,
        ``unused_music``, ``unused_segments``, ``bad_segment``, ``extra_file``. Notes describe what was matched,
        declared, read and assumed.

        Raises SourceError: If there is no motion, or the manifest or the segments have a mistake.
        """
        source = Path(source)
        require_folder("folder", source, LOOKED_FOR)
        if self.body_model is not None and not self.body_model.exists():
            where = str(self.body_model)
            raise SourceError("folder: the body model does not exist", where=where, fix="correct body_model")
        if self.music_dir is not None and not self.music_dir.expanduser().is_dir():
            where, fix = str(self.music_dir), "correct music_dir"
            raise SourceError("folder: music_dir is not a folder", where=where, fix=fix)
        manifests = [source / name for name in MANIFESTS if (source / name).exists()]
        if len(manifests) > 1:
            raise SourceError("folder: there are two manifests", where=str(source), found=" and ".join(MANIFESTS),
                              fix="remove one of them")  # fmt: skip
        rows = read_manifest(manifests[0]) if manifests else []
        scanned = self._listed(source, manifests[0], rows) if manifests else self._matched(source)
        clips, rejects, notes, layout = scanned
        if self.people == "split":
            clips, rejects = split_people(clips, rejects)
        assigned = any(row.get("split") for row in rows)
        clips, splits = self._split(sorted(clips, key=lambda clip: clip.id), assigned)
        clips, files, lying = _file_notes(clips, self._reading)
        rejects += lying
        notes += [*splits, *points_note(clips), *files]
        clips, unused, words = stated_words(source, clips, self.language)
        rejects, notes = [*rejects, *unused], [*notes, *words]
        numbers = genre_ids_of(manifests[0], rows) if manifests else {}
        return Scan(layout, tuple(clips), tuple(rejects), tuple(notes), numbers)

    @override
    def body_of(self, ref: ClipRef) -> Skeleton | None:
        return next((body for body in (SMPL24, SMPLH52, SMPLX55) if body.name == ref.body), None)

    @override
    def load(self, ref: ClipRef) -> Motion:
        """Read one clip: metres, +Y up, radians; on SMPL's, SMPL-H's or SMPL-X's joints, a BVH with its own bones."""
        return part_of(load_motion(ref.motion_path, self._reading(ref)), ref)

    @override
    def time_of(self, ref: ClipRef) -> tuple[int, Fraction, int] | None:
        return stated_time(ref, self._reading(ref))

    def of_arrays(self, arrays: ArrayFile, ref: ClipRef) -> Motion:
        """Return the motion of arrays that are part of a file, as `load` does of a whole one."""
        return motion_of(arrays, self._reading(ref))

    @override
    def make_example(self, folder: Path) -> None:
        from dancedata.datasets.folder.example import write_folder

        write_folder(Path(folder))

    @property
    def _declared(self) -> Declared:
        fps, unit = (None if value is None else str(value) for value in (self.fps, self.unit))
        return Declared(fps, self.up, unit, self.layout, self.gender)

    def _reading(self, ref: ClipRef) -> Reading:
        stated = Declared(**dict(ref.declared))
        names = self.joint_map if stated.joint_map is None else json.loads(stated.joint_map)
        return Reading(stated, self._declared, names, self.body_model, self.keys, self.joints)

    def _listed(
        self, source: Path, manifest: Path, rows: list[Row]
    ) -> tuple[list[ClipRef], list[Reject], list[str], str]:
        audio = {row.get("audio") for row in rows if row.get("audio")}
        stems = Counter(stem_of(Path(text)) for text in audio)
        read = [self._clip(source, manifest, row, stems) for row in rows]
        clips = [clip for clip in read if isinstance(clip, ClipRef)]
        rejects = [clip for clip in read if isinstance(clip, Reject)]
        size = f"Manifest: {manifest.name}, {counted(len(rows), 'clip')}."
        notes = [size, *guess_notes(rows), *offset_notes(clips)]
        return clips, rejects, notes, f"manifest ({manifest.suffix.removeprefix('.')})"

    def _clip(self, source: Path, manifest: Path, row: Row, stems: Counter[str]) -> ClipRef | Reject:
        name, split = clip_id(row), row.get("split") or self._default_split
        check_row(manifest, row, split)
        motion = inside(source, row.get("motion"), manifest, row.line, "motion")
        text = row.get("audio")
        audio = inside(source, text, manifest, row.line, "audio") if text else None
        if self.music_dir is not None and text:
            elsewhere = inside(self.music_dir.expanduser(), text, manifest, row.line, "audio")
            audio = elsewhere if elsewhere.is_file() else audio
        if not motion.is_file():
            detail = f"listed, but {absence(motion)}"
            return Reject("missing_motion", clip=name, file=row.get("motion"), detail=detail)
        if audio is not None and not audio.is_file():
            detail = f"{manifest.name} names {text}: {absence(audio)}"
            return Reject("missing_music", clip=name, file=text, detail=detail, music=text)
        if audio is None and self.music == "required":
            return Reject(
                "missing_music",
                clip=name,
                detail=f"{manifest.name} has no audio for this clip; add it, or {_WITHOUT_MUSIC}",
            )
        song = Path(text)
        music = row.get("music") or (stem_of(song) if stems[stem_of(song)] < 2 else song.with_suffix("").as_posix())
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
            columns=tuple(sorted(row.columns.items())),
            audio_start=row.seconds.get("audio_start_s", Fraction(0)),
            audio_start_by=FOUND if row.get("audio_start_s") == FOUND else "",
            source_start=row.seconds.get("start_s"),
            source_end=row.seconds.get("end_s"),
            licence=row.get("licence"),
            citation=row.get("citation"),
        )

    def _matched(self, source: Path) -> tuple[list[ClipRef], list[Reject], list[str], str]:
        layout, motions, files = match_names(source, self.music_dir)
        clips, rejects = [], list(files.rejects)
        for name, path in motions.items():
            audio = files.files.get(name)
            problem = id_problem(name)
            if problem is not None:
                detail = (
                    f"the file name, which is the clip's id, {problem}; rename it, or write a manifest with an id"
                )
                rejects.append(Reject("bad_name", clip=name, file=relative(path, source), detail=detail))
            elif audio is None and self.music == "required":
                detail = f"no {name}.wav, .flac, .mp3 or .ogg; add it, or {_WITHOUT_MUSIC}"
                file = relative(path, source)
                rejects.append(Reject("missing_music", clip=name, file=file, detail=detail, music=name))
            else:
                music = name if audio else ""
                clips.append(ClipRef(name, path, audio, self._default_split, music=music))
        return clips, rejects, list(files.notes), layout

    @property
    def _default_split(self) -> str:
        """Split of clips without one in the manifest; empty where a rule assigns it once all clips are known."""
        return self.split if isinstance(self.split, str) else ""

    def _split(self, clips: list[ClipRef], stated: bool) -> tuple[list[ClipRef], list[str]]:
        """Assign a split to clips without one; returns the note on the splits. `stated`: the manifest has splits."""
        if not isinstance(self.split, str):
            rule = SplitRule.of(self.split)
            songs = same_songs(clips) if rule.by == "music" else {}
            assigned, notes = rule.apply([replace(clip, music=songs.get(clip.music, clip.music)) for clip in clips])
            notes += [f"The same song by its samples, grouped as {first}: {name}." for name, first in songs.items()]
            return [replace(clip, split=chosen.split) for clip, chosen in zip(clips, assigned, strict=True)], notes
        return clips, [_split_note(clips, self.split, stated)]


def _check_keys(keys: Mapping[str, str] | None) -> None:
    if keys is None:
        return
    roles = ("rotation", "translation", "scale", "positions")
    wrong = next((key for key in keys if key not in roles), None)
    if wrong is not None:
        raise UsageError(f"folder: unknown key in keys: {wrong!r}", allowed=did_you_mean(wrong, roles))
    missing = [key for key in roles[:2] if not keys.get(key) and "positions" not in keys]
    if missing:
        raise UsageError(
            f"folder: keys does not name the array of the {missing[0]}",
            found=", ".join(keys) or "nothing",
            allowed="rotation and translation, and scale where the translation is divided by it",
            fix="set dataset.folder.keys={rotation: NAME, translation: NAME}, or {positions: NAME}",
        )


def _file_notes(
    clips: Sequence[ClipRef], reading: Callable[[ClipRef], Reading]
) -> tuple[list[ClipRef], list[str], list[Reject]]:
    """Return the clips with notes and bodies, a summary of kinds of files, and rejects of wrong up axes."""
    counts: Counter[str] = Counter()
    described, first = [], dict[str, str]()
    axes = []
    for clip in clips:
        try:
            notes, body, facts = describe(clip.motion_path, reading(clip))
            clip = on_frames(clip, facts.rate.value)
            axes.append((clip, reading(clip), facts.up, clip.motion_path.suffix.lower()))
        except DataError as error:
            notes, body = (f"not usable ({error.reason}), see the rejects",), ""
        counts.update(notes)
        for note in notes:
            first.setdefault(note, clip.motion_path.name)
        # Earlier revisions gave such bones no direction.
        revision = int(any(note.startswith(NO_LENGTH) for note in notes))
        described.append(replace(clip, notes=notes, body=body, revision=revision))
    kinds = counts.most_common()
    summary = []
    for kind, n in sorted(kinds[:_MAX_KINDS], key=lambda item: item[0]):
        which = f" ({first[kind]}{', ...' * (n > 1)})" if n < len(clips) else ""
        summary.append(f"{counted(n, 'file')}: {kind}{which}.")
    if len(kinds) > _MAX_KINDS:
        summary.append(f"{len(kinds) - _MAX_KINDS} more kinds of files.")
    rejects = judge_up(axes)
    wrong = {reject.clip for reject in rejects}
    return [clip for clip in described if clip.id not in wrong], summary, rejects


def _split_note(clips: Sequence[ClipRef], default: str, assigned: bool) -> str:
    splits = Counter(clip.split for clip in clips)
    if set(splits) == {default} and not assigned:
        which = "the clip is" if len(clips) == 1 else f"all {len(clips):,} clips are"
        return f"Splits: none is given, so {which} in {default!r}."
    counts = ", ".join(f"{n:,} {split}" for split, n in sorted(splits.items()))
    return f"Splits: {counts or 'no clip is left'}."
