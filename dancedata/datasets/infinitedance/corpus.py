"""InfiniteDance's folders, and what lies beside the motions: lists of names, styles, the dataset of each clip."""

import re
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from dancedata.core.clip import Reject
from dancedata.core.errors import SourceError
from dancedata.core.text import listed, quoted
from dancedata.datasets.files import MAX_LIST_BYTES, read_names
from dancedata.files.listing import list_folder, relative
from dancedata.files.strict_json import read_json

FITS_FOLDER = "dance/infinitedance_smplx_smooth"
COLUMNS_FOLDER = "dance/alldata_new_joint_vecs264_ft_balanced"
TEST_FOLDER = "dance/test_eval861_joint_vecs264"
TOKENS_FOLDER = "dance/Infinite_MotionTokens_512x1024_3layer_cleandata"
MUQ_FOLDER = "music/muq_features/test_infinitedance"
MUSIC55_FOLDER = "music/musicfeature_55_allmusic_pure"
OWN, UNKNOWN = "infinitedance", "unknown"
#: Dataset of a list's name before "_train.txt" and so on, with the terms of its clips.
ORIGINS: Mapping[str, tuple[str, str]] = {
    "infinitedance": (OWN, "InfiniteDance's licence"),
    "aistpp": ("aist++", "AIST++'s and the AIST Dance Video Database's terms"),
    "finedance": ("finedance", "FineDance's terms"),
    "motorica": ("motorica", "Motorica Dance's licence"),
}
TERMS = dict(ORIGINS.values())
#: Names of clips of other datasets: as those datasets publish them.
AIST = re.compile(r"g[A-Z]{2}_s[A-Z]{2}_c(?:All|[0-9]{2})_(d[0-9]{2})_(m[A-Z]{2}[0-9]+)_ch[0-9]{2}")
_NAMES = (("aist++", AIST), ("motorica", re.compile(r"kth(?:street|jazz|misc)_.+")))
_LIST = re.compile(r"(.+)_(?:train|eval|test)")
_MAX_STYLE_BYTES = 1 << 16
_STYLE_MAP = "all_style_map.json"


def lists_of(root: Path) -> dict[str, frozenset[str]]:
    """Return the names on every list of ``partition/``, by the list's name without suffix."""
    folder = root / "partition"
    files = [path for path in list_folder(folder) if path.suffix.lower() == ".txt"] if folder.is_dir() else []
    return {path.stem: frozenset(read_names(path, spaces=True)) for path in files}


def origins_of(names: Collection[str], lists: Mapping[str, Collection[str]], fits: Collection[str]) -> dict[str, str]:
    """Return the dataset that each clip comes from: by the lists of datasets, then its name, then a fit."""
    stated = {}
    for name, clips in lists.items():
        match = _LIST.fullmatch(name)
        if match and match[1] in ORIGINS:
            stated.update(dict.fromkeys(clips, ORIGINS[match[1]][0]))
    by_name = {name: next((o for o, form in _NAMES if form.fullmatch(name)), "") for name in names}
    return {n: stated.get(n) or by_name[n] or (OWN if n in fits else UNKNOWN) for n in names}


def origins_note(origins: Collection[str]) -> str:
    """Return the note with the number of clips of each dataset, and the terms of those of others."""
    counts = sorted(Counter(origins).items())
    own = ", ".join(f"{n:,} {name}" for name, n in counts)
    others = [f"{TERMS[name]} ({name})" for name, _ in counts if name in TERMS and name != OWN]
    terms = f"; clips of other datasets keep their own terms: {', '.join(others)}" if others else ""
    unknown = f"; {UNKNOWN}: on no list of one dataset" if UNKNOWN in origins else ""
    return f"Origin of the clips: {own}{terms}{unknown}."


@dataclass(frozen=True)
class Styles:
    """Styles by name, what could not be read, and notes."""

    of: Mapping[str, str]
    rejects: tuple[Reject, ...] = ()
    notes: tuple[str, ...] = ()

    @classmethod
    def find(cls, root: Path, source: Path, names: Collection[str]) -> "Styles":
        """Read the styles of some clips; the file of a clip and the map of all have to agree.

        Raises SourceError: for a map that is not one of names to styles.
        """
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
        return cls({name: styles[name] for name in names if name in styles}, tuple(rejects), tuple(notes))


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
