"""Clips of a built dataset in columns that a protocol can measure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from dancedata.core.bodies import has_body
from dancedata.core.errors import DataError, UsageError, did_you_mean
from dancedata.core.skeleton import SMPL24
from dancedata.core.text import listed, shown
from dancedata.evaluation.protocol import MotionRule, Protocol, Role
from dancedata.kernel import Sample, Store
from dancedata.scene.inputs.clip import ClipInput, GroupClip, StoreClip
from dancedata.scene.poses import BODIES, ColumnsReader, motion_reader, motion_readers


@dataclass(frozen=True, eq=False)
class ClipSet:
    """Clips that are measured together."""

    clips: tuple[ClipInput, ...]
    source: str
    role: Role
    store: Store | None = None  # dataset that they are from; None for others
    scaler_sha256: str = ""
    left_out: tuple[tuple[str, str], ...] = ()  # clips of the dataset that are not measured, and why
    # the samples of the dataset that the motion stands for, by the ids of clips
    samples: Mapping[str, Sample] = field(default_factory=dict)
    # `matched`, `warnings`: how many names matched the dataset, and what is doubtful, in words
    matched: str = ""
    warnings: tuple[str, ...] = ()
    # the error for files whose songs are unknown, where metrics take music
    nothing_matched: DataError | None = None

    def __post_init__(self) -> None:
        if not self.clips:
            raise UsageError("there are no clips to evaluate", where=self.source)

    @property
    def folder(self) -> Path:
        """Folder that workers of a cluster have to see."""
        file = next((clip.file for clip in self.clips if clip.file is not None), Path.cwd())
        return file if file.is_dir() else file.parent


def chosen_splits(store: Store, split: str | None) -> tuple[str, ...]:
    """Return the splits that "test" or "val,test" names, all for None; UsageError for an unknown split."""
    if split is None or (split == "all" and "all" not in store.splits):
        return store.splits
    names = tuple(name.strip() for name in split.split(","))
    for name in names:
        if name not in store.splits:
            raise UsageError(f"no split named {name!r}", where=str(store.path), fix=did_you_mean(name, store.splits))
    return names


def store_clips(
    store: Store, protocol: Protocol, *, split: str | None = None, field: str | None = None, role: Role = "truth"
) -> tuple[tuple[ClipInput, ...], tuple[tuple[str, str], ...]]:
    """Return the clips of a store, and those that lack the field, with the reason.

    Copies that augmentations made are neither, nor slices that begin within a piece.

    UsageError if no field has the protocol's joints, or the store has slices of another length than its pieces.
    """
    name, reader = reader_for(store, protocol.motion, field)
    splits = chosen_splits(store, split)
    stride = _stride_of_slices(store, protocol, role) if store.slice_length is not None else 1
    originals = [c for c in store if c.split in splits and not c.source]
    left_out = tuple((c.id, f"kept without {name}") for c in originals if name not in c)
    records = [c for c in originals if name in c and c.slice_start % stride == 0]
    clips = tuple(
        StoreClip(
            id=c.id, music=c.music, tempo_bpm=c.tempo_bpm, audio_start=c.audio_start, recording=c.recording,
            reference=store.reference, field=name, reader=reader,
        )
        for c in records
    )  # fmt: skip
    if not protocol.of_groups:
        return clips, left_out
    lacking = {c.group for c in store if c.group and name not in c}
    groups: dict[str, list[tuple[bool, int, StoreClip]]] = {}
    for record, clip in zip(records, clips, strict=True):
        if record.group and record.group not in lacking:
            groups.setdefault(record.group, []).append((record.role == "leader", record.member, clip))
    if not groups:
        raise UsageError(f"{protocol.name} measures groups, and the dataset has none", where=str(store.path),
                         fix="choose a protocol for single dancers, such as dancedata")  # fmt: skip
    dancers = {group: sorted(groups[group], key=lambda member: member[:2]) for group in sorted(groups)}
    return tuple(_group(name, [clip for *_, clip in of_group]) for name, of_group in dancers.items()), left_out


def _group(name: str, members: Sequence[StoreClip], recording: str = "") -> GroupClip:
    """Return a group of a store; its music is that of its dancers."""
    first = members[0]
    return GroupClip(
        id=name, music=first.music, tempo_bpm=first.tempo_bpm, audio_start=first.audio_start, recording=recording,
        members=tuple(members),
    )  # fmt: skip


def truth_of(samples: Mapping[str, Sample], protocol: Protocol, field: str | None) -> tuple[ClipInput, ...]:
    """Return the dances of the dataset that samples are of, mirrored where these are."""
    clips: dict[str, ClipInput] = {}
    for sample in samples.values():
        name, reader = reader_for(sample.store, protocol.motion, field)
        of = replace(sample.id, take=0)
        members = [
            StoreClip(
                id=str(of), music=clip.music, tempo_bpm=clip.tempo_bpm, audio_start=sample.music_start_s,
                recording=sample.recording, reference=sample.store.reference, field=name, reader=reader,
                window=window, mirrored=of.mirrored,
            )
            for clip, window in zip(sample.clips, sample.windows, strict=True)
            if name in clip
        ]  # fmt: skip
        if members:
            clips[str(of)] = members[0] if len(members) == 1 else _group(str(of), members, sample.recording)
    return tuple(clips.values())


def _stride_of_slices(store: Store, protocol: Protocol, role: Role) -> int:
    """Return the distance of the slices that are the protocol's pieces; UsageError if none are."""
    pieces = protocol.pieces(role)
    length, stride = pieces.frames(store.grid)
    if length != store.slice_length or stride is None or pieces.skip:
        raise UsageError("a dataset of slices cannot be cut into the protocol's pieces", where=str(store.path),
                         found=f"slices of {store.slice_length} frames; {protocol.name} measures {pieces}",
                         fix="build without slices")  # fmt: skip
    return stride


def columns_problem(reader: ColumnsReader, rule: MotionRule) -> str:
    """Return why the columns cannot give the joints of a protocol; "" if they can."""
    plugin = reader.representation
    joints = plugin.skeleton.joints
    is_smpl = joints == SMPL24.joints
    if not plugin.decodes and "position" not in plugin.columns.names:
        return "they hold neither rotations nor positions"
    if plugin.decodes and not has_body(plugin.skeleton):
        return f"they are rotations of {plugin.skeleton.name}, which is not of the SMPL family"
    of_smplx = BODIES[rule.body][0] if rule.body in ("smplx24", "smplx55") else ()
    if of_smplx and (is_smpl or (not plugin.decodes and joints[: len(of_smplx)] != of_smplx)):
        return "they are not on SMPL-X with jaw and eyes, or rotations of it"
    if rule.body == "smpl24" and not plugin.decodes and not is_smpl:
        return "they are positions of a body other than SMPL's 24 joints"
    if rule.pelvis == "body" and not plugin.decodes and not plugin.skeleton.offsets[0].any():
        return "their pelvis is at the translation, as in EDGE"
    grid = rule.grid
    if grid is not None and reader.grid.step_to(grid) is None:
        return f"they have {reader.grid} rows per second, not {grid} or a whole multiple"
    return ""


def named_reader(store: Store, name: str) -> ColumnsReader:
    """Return the reader of the motion field `name`; UsageError if there is none, or if it cannot be read."""
    names = [field for field in store.fields if store.field(field).kind == "motion"]
    if name not in names:
        raise UsageError(
            f"no motion field named {shown(name)!r}", where=str(store.path), fix=did_you_mean(name, names)
        )
    return motion_reader(store, name)


def reader_for(store: Store, rule: MotionRule, field: str | None) -> tuple[str, ColumnsReader]:
    """Choose the motion field of a store to evaluate: `field`, or the first that fits the protocol."""
    candidates = motion_readers(store) if field is None else {field: named_reader(store, field)}
    # Those that every clip has come first.
    candidates = dict(sorted(candidates.items(), key=lambda item: item[0] in store.optional_fields))
    problems = {name: columns_problem(reader, rule) for name, reader in candidates.items()}
    for name, problem in problems.items():
        if not problem:
            return name, candidates[name]
    any_rate = replace(rule, fps=None)
    only_rate = rule.fps is not None and any(not columns_problem(reader, any_rate) for reader in candidates.values())
    raise UsageError(
        "the protocol cannot be computed from this dataset",
        where=str(store.path),
        found="; ".join(f"{name}: {problem}" for name, problem in problems.items()),
        allowed=f"joints {rule.body}" + (f" at {rule.fps} frames per second" if rule.fps else ""),
        fix=f"build it with fps: {rule.fps}, or take a protocol for its rate"
        if only_rate
        else "build it with a field that has them: " + listed(["edge151", "lodge319", "joints"]),
    )
