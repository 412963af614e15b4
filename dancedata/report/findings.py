"""What stands out in a report, in sentences that lead to the figure."""

from dataclasses import dataclass

from dancedata.core.text import counted, listed
from dancedata.report.document import Document
from dancedata.report.markup import number

#: Shares of frames in contact of left and right that differ by more are named, and of sliding feet.
_SIDES, _SLIDING = 0.1, 0.1
#: The largest genre is named where it has so many times the windows of the smallest.
_UNEVEN = 5


@dataclass(frozen=True)
class Finding:
    """A sentence.

    Attributes
    ----------
    kind
        "bad": an error of the dataset. "look": worth a look. "note": good to know.
    text
        The sentence.
    figure
        Key of the figure that shows it.
    """

    kind: str
    text: str
    figure: str


def findings(d: Document) -> list[Finding]:
    """Return what stands out, errors first."""
    sentences = [*_splits(d), *_quality(d), *_movement(d), *_music(d), *_contents(d), *_fields(d)]
    return sorted(sentences, key=lambda f: ("bad", "look", "note").index(f.kind))


def _splits(d: Document) -> list[Finding]:
    sentences = []
    for what in ("songs", "clips"):
        for pair, names in d["splits"][what]["names"].items():
            bad = "train" in pair.split(" and ")
            text = f"{pair} share {counted(len(names), what[:-1])}: {listed(names, 4)}"
            sentences.append(Finding("bad" if bad else "note", text, f"shared_{what}"))
    return sentences


def _quality(d: Document) -> list[Finding]:
    sentences = []
    totals = d["totals"]
    if totals["flags"]:
        kinds = ", ".join(f"{kind} {n}" for kind, n in d["flags"]["by_kind"].items())
        text = f"{counted(totals['flagged_clips'], 'clip')} of {totals['clips']:,} have quality flags: {kinds}"
        sentences.append(Finding("look", text, "flags"))
    if totals["left_out"]:
        reasons = listed([f"{reason} {entry['n']:,}" for reason, entry in d["left_out"].items()], 5)
        sentences.append(Finding("look", f"left out: {reasons}", "left_out"))
    return sentences


def _movement(d: Document) -> list[Finding]:
    moves = d["movement"]
    if moves["field"] is None:
        return [Finding("look", "movement was not measured: no field holds joints that can be read here", "about")]
    sentences = []
    contact = {name: share for name, share in moves["contact"].items() if share is not None}
    for name, share in contact.items():
        other = contact.get(name.replace("left", "right", 1))
        if name.startswith("left") and other is not None and abs(share - other) > _SIDES:
            joint = name.removeprefix("left_")
            sides = f"{100 * share:.0f} % of the frames, the right in {100 * other:.0f} %"
            text = f"the left {joint} touches the ground in {sides}"
            sentences.append(Finding("look", text, "contact"))
    above = moves["sliding_m_s"]["share_above"]
    if above is not None and above > _SLIDING:
        limit = moves["sliding_m_s"]["above_m_s"]
        text = f"feet that are labelled as standing move faster than {limit} m/s in {100 * above:.0f} % of the frames"
        sentences.append(Finding("look", text, "sliding_m_s"))
    floor = moves["floor_m"]
    if floor["n"] and max(abs(floor["min"]), abs(floor["max"])) > 0.1:
        low, high = number(floor["min"]), number(floor["max"])
        feet = f"the feet stand at {low} m" + (f" to {high} m" if high != low else "")
        text = f"the floor of {moves['field']} is not at 0: {feet}"
        sentences.append(Finding("note", text, "floor_m"))
    return sentences


def _music(d: Document) -> list[Finding]:
    music = d["music"]
    sentences = []
    bas, chance = music["bas"], music["bas_chance"]
    if bas is not None and bas <= chance * 1.1:
        text = f"the dance does not follow the beats: alignment {number(bas)}, by chance {number(chance)}"
        sentences.append(Finding("look", text, "bas"))
    off = [t for t in music["tempo_bpm"] if abs(t["found"] / t["stated"] - 1) > 0.05]
    if off:
        text = (
            f"{counted(len(off), 'clip')} of {len(music['tempo_bpm']):,}: the beats have another tempo than is stated"
        )
        sentences.append(Finding("look", text, "tempo_pairs"))
    short = d["contents"]["music_minus_motion_s"]["shorter"]
    if short:
        text = f"{counted(len(short), 'clip')} with less music than motion: {listed(short, 3)}"
        sentences.append(Finding("look", text, "music_minus_motion_s"))
    return sentences


def _contents(d: Document) -> list[Finding]:
    contents = d["contents"]
    sentences = [
        Finding("look", f"genres that are probably the same: {' and '.join(names)}", "windows_by_genre")
        for names in contents["alike"]
    ]
    sums = {name: sum(counts.values()) for name, counts in contents["windows_by_genre"].items()}
    filled = {name: n for name, n in sums.items() if n}
    if len(filled) > 1 and max(filled.values()) >= _UNEVEN * min(filled.values()):
        most, least = max(filled, key=filled.__getitem__), min(filled, key=filled.__getitem__)
        text = f"genres are uneven: {most} has {filled[most]:,} windows, {least} {filled[least]:,}"
        sentences.append(Finding("note", text, "windows_by_genre"))
    return sentences


def _fields(d: Document) -> list[Finding]:
    sentences = []
    for name, field in d["fields"].items():
        if field["constant"]:
            count = f"{len(field['constant'])} of {field['width']} columns of {name}"
            text = f"{count} never change: {listed(field['constant'], 4)}"
            sentences.append(Finding("note", text, f"columns_{name}"))
        elif not field["columns"]:
            sentences.append(Finding("note", f"no statistics of {name}: there are no train windows", f"heat_{name}"))
    return sentences
