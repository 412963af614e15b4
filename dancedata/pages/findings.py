"""Findings of a report, as sentences."""

from dataclasses import dataclass

from dancedata.core.rejects import BY_CHOICE
from dancedata.core.text import counted, listed
from dancedata.pages.document import SHIFTED_MS, Document
from dancedata.pages.groups import group_findings
from dancedata.pages.markup import number
from dancedata.pages.scaling import EXPLODES
from dancedata.scene.pose_space import DUPLICATE_M

#: Limits above which a difference between the contact of left and right is named, and a share of sliding frames.
_SIDES, _SLIDING = 0.1, 0.1
#: Ratio from which on the windows of the largest and the smallest genre are named.
_UNEVEN = 5


@dataclass(frozen=True)
class Finding:
    """A sentence on a dataset."""

    # "good": a check that passed. "bad": an error of the dataset. "look": worth a look. "note": good to know
    kind: str
    text: str
    figure: str  # key of the figure that shows it


def findings(d: Document) -> list[Finding]:
    """Return the findings: what is good, then errors, what is worth a look, and what is good to know."""
    parts = (_passed, _splits, _quality, _movement, _outliers, _poses, _groups, _music, _contents, _fields)
    sentences = [finding for part in parts for finding in part(d)]
    return sorted(sentences, key=lambda f: ("good", "bad", "look", "note").index(f.kind))


def _passed(d: Document) -> list[Finding]:
    sentences = []
    songs = d.splits.songs.counts
    leaks = any("train" in pair.split(" and ") for pair in (*d.splits.songs.names, *d.splits.clips.names))
    if songs.get("train", {}).get("train") and len(songs) > 1 and not leaks:
        sentences.append(Finding("good", "no song or dance of train is in val or test", "shared_songs"))
    bas, chance = d.music.bas, d.music.bas_chance
    if bas is not None and chance is not None and bas > chance * 1.1:
        text = f"music and dance fit: alignment {number(bas)}, by chance {number(chance)}"
        sentences.append(Finding("good", text, "bas"))
    return sentences


def _splits(d: Document) -> list[Finding]:
    sentences = []
    for kind, shared in (("song", d.splits.songs), ("clip", d.splits.clips)):
        for pair, names in shared.names.items():
            bad = "train" in pair.split(" and ")
            text = f"{pair} share {counted(len(names), kind)}: {listed(names, 4)}"
            sentences.append(Finding("bad" if bad else "note", text, f"shared_{kind}s"))
    return sentences


def _quality(d: Document) -> list[Finding]:
    sentences = []
    totals = d.totals
    if totals.flags:
        kinds = ", ".join(f"{kind} {n}" for kind, n in d.flags.by_kind.items())
        text = f"{counted(totals.flagged_clips, 'clip')} of {totals.clips:,} have quality flags: {kinds}"
        sentences.append(Finding("look", text, "flags"))
    if totals.left_out:
        for kind, by_choice in (("look", False), ("note", True)):
            entries = {name: entry for name, entry in d.left_out.items() if (name in BY_CHOICE) is by_choice}
            reasons = listed([f"{reason} {entry.n:,}" for reason, entry in entries.items()], 5)
            if entries:
                cause = "; files that were not downloaded are no error" if "missing_motion" in entries else ""
                sentences.append(Finding(kind, f"left out: {reasons}{cause}", "left_out"))
    return sentences


def _movement(d: Document) -> list[Finding]:
    moves = d.movement
    if moves.field is None:
        return [Finding("look", "movement was not measured: no field holds joints that can be read here", "about")]
    sentences = []
    contact = {name: share for name, share in moves.contact.items() if share is not None}
    for name, share in contact.items():
        right = contact.get(name.replace("left", "right", 1))
        if name.startswith("left") and right is not None and abs(share - right) > _SIDES:
            joint = name.removeprefix("left_")
            sides = f"{100 * share:.0f} % of the frames, the right in {100 * right:.0f} %"
            text = f"the left {joint} touches the ground in {sides}"
            sentences.append(Finding("look", text, "contact"))
    above = moves.sliding_m_s.share_above
    if above is not None and above > _SLIDING:
        limit = moves.sliding_m_s.above_m_s
        text = f"feet that are labelled as standing move faster than {limit} m/s in {100 * above:.0f} % of the frames"
        sentences.append(Finding("look", text, "sliding_m_s"))
    return sentences


def _poses(d: Document) -> list[Finding]:
    n, pairs = d.poses.n_duplicates, d.poses.duplicates
    if not n:
        return []
    text = f"{counted(n, 'pair')} of windows in two splits nearer than {100 * DUPLICATE_M:g} cm"
    with_train = any("train" in pair.splits for pair in pairs)
    return [Finding("look" if with_train else "note", f"{text}: {' and '.join(pairs[0].clips)}", "duplicates")]


def _outliers(d: Document) -> list[Finding]:
    if not d.outliers:
        return []
    names = listed([outlier.clip for outlier in d.outliers], 3)
    return [Finding("look", f"{counted(len(d.outliers), 'clip')} unlike the others in movement: {names}", "outliers")]


def _groups(d: Document) -> list[Finding]:
    return [Finding(kind, text, "groups_list") for kind, text in group_findings(d.groups)]


def _music(d: Document) -> list[Finding]:
    sentences = []
    bas, chance = d.music.bas, d.music.bas_chance
    if bas is not None and chance is not None and bas <= chance * 1.1:
        text = f"the dance does not follow the beats: alignment {number(bas)}, by chance {number(chance)}"
        sentences.append(Finding("look", text, "bas"))
    shifted = [song for song in d.music.songs if song.is_shifted]
    if shifted:
        named = listed([f"{song.song} {song.shift_ms:+.0f} ms" for song in shifted], 4)
        text = f"{counted(len(shifted), 'song')} with dance late or early by more than {SHIFTED_MS:g} ms: {named}"
        sentences.append(Finding("look", text, "song_offsets"))
    tempos = d.music.tempo_bpm
    off = [t for t in tempos if abs(t.found / t.stated - 1) > 0.05]
    if off:
        text = f"{counted(len(off), 'clip')} of {len(tempos):,}: the tempo of the beats differs from the stated one"
        sentences.append(Finding("look", text, "tempo_pairs"))
    short = d.contents.music_minus_motion_s.shorter
    if short:
        text = f"{counted(len(short), 'clip')} with less music than motion: {listed(short, 3)}"
        sentences.append(Finding("look", text, "music_minus_motion_s"))
    return sentences


def _contents(d: Document) -> list[Finding]:
    sentences = [
        Finding("look", f"genres that are probably the same: {' and '.join(names)}", "windows_by_genre")
        for names in d.contents.alike
    ]
    sums = {name: sum(counts.values()) for name, counts in d.contents.windows_by_genre.items()}
    filled = {name: n for name, n in sums.items() if n}
    if len(filled) > 1 and max(filled.values()) >= _UNEVEN * min(filled.values()):
        most, least = max(filled, key=filled.__getitem__), min(filled, key=filled.__getitem__)
        text = f"genres are uneven: {most} has {filled[most]:,} windows, {least} {filled[least]:,}"
        sentences.append(Finding("note", text, "windows_by_genre"))
    return sentences


def _fields(d: Document) -> list[Finding]:
    sentences = []
    for name, of_field in d.fields.items():
        if not (of_field.constant or of_field.columns or of_field.rows):
            sentences.append(Finding("note", f"no statistics of {name}: there are no train windows", f"heat_{name}"))
        exploding = [label for group in of_field.scaling for label, _ in group.exploding]
        if exploding:
            count = f"{counted(len(exploding), 'column')} of {name}"
            text = f"{count} beyond ±{EXPLODES:g} when normalised: {listed(exploding, 4)}"
            sentences.append(Finding("look", text, f"scaling_{name}"))
    return sentences
