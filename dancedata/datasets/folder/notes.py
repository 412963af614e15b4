"""The notes of a scan of a folder: what each motion file is, and how clips are split."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError
from dancedata.core.skeleton import SMPL24
from dancedata.core.text import counted
from dancedata.datasets.folder.facts import IN_MANIFEST, IN_RECIPE, drift_note
from dancedata.datasets.folder.load import FileFacts, Reading, array_facts, bvh_facts, recognised
from dancedata.datasets.folder.people import open_person, seen_in
from dancedata.formats.bvh.parse import read_bvh_header

#: Most kinds of files that the notes distinguish.
_MAX_KINDS = 12


def describe(path: Path, reading: Reading) -> tuple[tuple[str, ...], str]:
    """Return notes on a file's format and facts, and the name of its body; "" for that of a body model.

    From the file's header. Raises as `load_motion` does.
    """
    if path.suffix.lower() == ".bvh":
        bvh = read_bvh_header(path)
        facts, rig = bvh_facts(bvh, reading)
        text = f"BVH: {facts}; joint names {rig.joints.style or 'as given in joint_map'}"
        return (text, f"BVH joints: {rig.joints.text(bvh.joints)}", *_drift(facts)), SMPL24.name
    with open_person(path, reading.manifest.person) as arrays:
        layout = recognised(arrays, reading)
        facts = array_facts(arrays, layout, reading)
        seen = seen_in(arrays)
    joints = f" on {layout.body}'s {layout.skeleton.n_joints} joints" if layout.name != layout.body else ""
    text = f"{path.suffix.lower()}, layout {layout.name}{joints}: {facts}"
    video = (f"Video: {seen[0]}",) if seen is not None and str(seen[0]) else ()
    body = layout.skeleton.name if reading.body_model is None else ""
    return (text, *video, *_drift(facts)), body


def _drift(facts: FileFacts) -> tuple[str, ...]:
    """Return the note on a rate that the file states, near a usual one."""
    note = "" if facts.rate.where in (IN_MANIFEST, IN_RECIPE) else drift_note(facts.rate.value)
    return (note,) if note else ()


def file_notes(clips: Sequence[ClipRef], reading: Callable[[ClipRef], Reading]) -> tuple[list[ClipRef], list[str]]:
    """Return the clips with notes on their files and their bodies, and a summary of the kinds of files."""
    counts: Counter[str] = Counter()
    described, first = [], dict[str, str]()
    for clip in clips:
        try:
            notes, body = describe(clip.motion_path, reading(clip))
        except DataError as error:
            notes, body = (f"not usable ({error.reason}), see the rejects",), ""
        counts.update(notes)
        for note in notes:
            first.setdefault(note, clip.motion_path.name)
        described.append(replace(clip, notes=notes, body=body))
    kinds = counts.most_common()
    summary = []
    for kind, n in sorted(kinds[:_MAX_KINDS], key=lambda item: item[0]):
        which = f" ({first[kind]}{', ...' * (n > 1)})" if n < len(clips) else ""
        summary.append(f"{counted(n, 'file')}: {kind}{which}.")
    if len(kinds) > _MAX_KINDS:
        summary.append(f"{len(kinds) - _MAX_KINDS} more kinds of files.")
    return described, summary


def split_note(clips: Sequence[ClipRef], default: str, assigned: bool) -> str:
    """Return the number of clips in each split.

    Parameters
    ----------
    default
        Split of clips without one in the manifest.
    given
        Whether the manifest assigns any split.
    """
    splits = Counter(clip.split for clip in clips)
    if set(splits) == {default} and not assigned:
        which = "the clip is" if len(clips) == 1 else f"all {len(clips):,} clips are"
        return f"Splits: none is given, so {which} in {default!r}."
    counts = ", ".join(f"{n:,} {split}" for split, n in sorted(splits.items()))
    return f"Splits: {counts or 'no clip is left'}."
