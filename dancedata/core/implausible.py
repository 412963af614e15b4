"""Flags of whole clips, such as an implausible unit or silent music: what each means and its cure, as text."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from dancedata.core.clip import Reject
from dancedata.core.errors import DataError
from dancedata.core.quality import IMPLAUSIBLE, OF_CLIPS, PLAUSIBLE_BODY_M, PLAUSIBLE_ROOT, SILENT_DBFS
from dancedata.core.text import counted

#: Clips that a summary names for each cure.
_NAMED = 3
_UNIT = ("an implausible unit", "correct the unit that was declared")
_SIDES = ("left and right in question", "correct the names of its joints, joint_map, or what mirrored it")
_UP = ("an implausible up axis", "correct the up axis that was declared")
#: Name of the problem, and what to do, by the kind of flag.
_CURES = {
    "implausible_body": _UNIT,
    "implausible_root": _UNIT,
    "implausible_sides": _SIDES,
    "implausible_legs": _SIDES,
    "implausible_arms": _SIDES,
    "implausible_elbows": _SIDES,
    "implausible_up": _UP,
    "lying": ("bodies that lie", "look at them in the viewer: their up axis may be wrong"),
    "crossed_legs": ("crossed legs", "look at it in the viewer: left and right of the legs may be swapped"),
    "stretched_bone": ("bones that stretch", "export with fixed bone lengths (rotations only) for exact positions"),
    "silent_music": ("silent music", "extract the music again, or leave these clips out: ignore"),
    "steady_music": ("music without an onset", "extract the music again, or leave these clips out: ignore"),
    "decoded_by_ffmpeg": ("music that ffmpeg decoded", "convert it to wav once, so that any machine reads the same"),
    "late_music": ("music that may begin late", "convert its original to wav or flac, or state audio_start_s"),
    "early_music": ("music that begins after its picture", "state audio_start_s for motion of that video"),
    "cut_music": ("music whose file is cut or damaged", "copy it again"),
    "fitted": ("rotations fitted to positions", "take rotations of the capture where twists of bones matter"),
    "repeated_frames": ("frames that come several times", "export the capture at its own rate"),
    "doubtful_rate": ("a rate that gravity contradicts", "correct fps: in the manifest, or in the file"),
}


def implausible_problems(quality: Iterable[Mapping[str, Any]]) -> list[Reject]:
    """Return one problem for each row of quality.jsonl that concerns a whole clip; `reason` is the row's kind."""
    rows = [row for row in quality if row.get("kind") in OF_CLIPS and isinstance(row.get("value"), int | float)]
    return [Reject(str(row["kind"]), clip=str(row.get("clip", "")), detail=_detail(row)) for row in rows]


def _detail(row: Mapping[str, Any]) -> str:
    value, (low, high), (least, most) = float(row["value"]), PLAUSIBLE_BODY_M, PLAUSIBLE_ROOT
    return {
        "implausible_body": f"a skeleton of {value:.3g} m, where {low:g} to {high:g} m is plausible; its unit is "
        "probably wrong",
        "implausible_root": f"the root rises and falls {value:.3g} times as far as the pose requires, where "
        f"{least:g} to {most:g} is plausible; the unit of its translation is probably wrong",
        "implausible_sides": f"toes or knees point against the front of hips and shoulders (cosine {value:.2f}); "
        "left and right are swapped, or the motion is mirrored",
        "implausible_legs": f"toes or knees point against the front of the hips (cosine {value:.2f}), not of the "
        "shoulders; left and right of the legs are swapped",
        "implausible_arms": f"the shoulders' left is the hips' right (cosine {value:.2f}); left and right of the "
        "arms are swapped",
        "implausible_elbows": f"the elbows bend backwards ({value:.2f}, where 0.4 to 0.9 is usual); left and right "
        "of the arms or of the whole motion are swapped, or it is mirrored",
        "implausible_up": f"the body does not stand along +Y (cosine {value:.2f}), and the floor is along another "
        "axis; the up axis is probably wrong",
        "lying": f"the body lies, or is upside down, for the whole clip (cosine {value:.2f} with +Y): floor work, or "
        "an up axis that is wrong",
        "crossed_legs": f"the left ankle is {value:.2f} widths of the hips to the left of the right one, where 0.6 "
        "to 4 is usual",
        "stretched_bone": f"position channels stretch bones by up to {100 * value:.1f} cm; the motion's bones are "
        "rigid, with their median length",
        "silent_music": f"the music has a level of {value:.0f} dBFS here, which is silence: below {SILENT_DBFS:.0f}",
        "steady_music": f"the level of the music changes by {value:.1f} dB here, so it has no onset and no beat",
        "decoded_by_ffmpeg": f"ffmpeg decoded {value:.2f} s of music, which libsndfile does not read to its end",
        "late_music": f"the file has no tag of its encoder's delay: its music may be {1000 * value:.0f} ms late",
        "early_music": f"the sound of the video begins {value:.2f} s after its picture, and second 0 of the music is "
        f"its first sample: motion of that video has audio_start_s {-value:.2f}",
        "cut_music": f"the file of the music is cut or damaged: it lacks about {value:.2f} s",
        "fitted": "twist unknown: rotations are fitted to positions, from which the joints are "
        f"{100 * value:.2g} cm off on average",
        "repeated_frames": f"nearly all frames come {value:g} times, so that the motion moves in jerks",
        "doubtful_rate": f"the body falls and sinks {value * value:.2g} times as fast as gravity (9.81 m/s2) makes a "
        f"body fall; the rate of {row.get('rate', 'the file')} frames per second is probably stated "
        + (f"{value:.2g} times too high" if value > 1 else f"{1 / max(value, 1e-9):.2g} times too low"),
    }[row["kind"]]


def describe_implausible(quality: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return the lines of a summary: the number of clips and the first ones, by what to do."""
    groups: dict[tuple[str, str], list[Reject]] = {}
    for problem in implausible_problems(quality):
        groups.setdefault(_CURES[problem.reason], []).append(problem)
    lines = []
    for (what, cure), problems in groups.items():
        clips, more = counted(len({p.clip for p in problems}), "clip"), len(problems) - _NAMED
        lines.append(f"  {'implausible' if what == _UNIT[0] else what}: {clips}; {cure}:")
        lines += [f"    {p.clip}: {p.reason}: {p.detail}" for p in problems[:_NAMED]]
        lines += [f"    ... {more} more"] if more > 0 else []
    return lines


def require_plausible(quality: Sequence[Mapping[str, Any]]) -> None:
    """Raise DataError for the first clip that is implausible, for a strict build."""
    problems = [p for p in implausible_problems(quality) if p.reason in IMPLAUSIBLE]
    if problems:
        first = problems[0]
        what, cure = _CURES[first.reason]
        clips = counted(len({p.clip for p in problems if _CURES[p.reason][0] == what}), "clip")
        raise DataError(f"{clips} with {what} in a strict build, the first: {first.detail}",
                        reason=first.reason, where=first.clip,
                        fix=f"{cure}, or build without --strict to keep the clip, with a flag")  # fmt: skip
