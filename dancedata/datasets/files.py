"""Files of a source: the folder of a published dataset, lists of its files, the choice of audio files."""

import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args, get_origin, get_type_hints

from dancedata.core.audio_signal import AUDIO_SUFFIXES
from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import SourceError, UsageError, did_you_mean
from dancedata.core.plugins import Dataset
from dancedata.core.text import listed, quoted
from dancedata.files.listing import best_audio, list_folder, stem_of
from dancedata.files.regular_file import read_regular
from dancedata.files.strict_json import parse_json

SPLITS = ("train", "val", "test")
#: The split of all clips where a dataset is not split.
ALL = "all"
#: Bounds of a list of names: size of the file, number of names, length of a name (of a file name, in bytes).
MAX_LIST_BYTES = 1 << 24
_MAX_NAMES = 100_000
MAX_NAME = 255


@dataclass(frozen=True)
class Files:
    """Files of one kind by their stem, rejects and notes about other entries; `folders` have audio files."""

    files: dict[str, Path]
    rejects: tuple[Reject, ...]
    notes: tuple[str, ...] = ()
    folders: tuple[Path, ...] = ()


NO_FILES = Files({}, ())


def relative(path: Path, source: Path) -> str:
    """Return the path below the source with forward slashes; of another file, FOLDER/NAME: no absolute paths."""
    try:
        return path.relative_to(source).as_posix()
    except ValueError:
        return f"{path.parent.name}/{path.name}"


def describe(folder: Path) -> str:
    """Return a short list of a folder's entries: folders with a slash, then files, then how many more."""
    entries = list_folder(folder)
    folders = [f"{entry.name}/" for entry in entries if entry.is_dir()]
    files = [entry.name for entry in entries if not entry.is_dir()]
    return listed([*folders, *files]) if entries else "nothing"


def require_folder(dataset: str, source: Path, looked_for: str) -> list[Path]:
    """Return the entries of a source; SourceError, with the expected and the existing files, if it has none."""
    if source.is_dir():
        if entries := list_folder(source):
            return entries
        problem, found = f"{dataset}: the source folder is empty", "nothing"
    elif source.exists():
        problem, found = f"{dataset}: the source is not a folder", "a file"
    else:
        problem = f"{dataset}: the source folder does not exist"
        parent = source.absolute().parent
        found = f"in {parent}: {describe(parent)}" if parent.is_dir() else f"no folder {parent} either"
    raise SourceError(
        problem, where=str(source), found=found, allowed=looked_for, fix="set SOURCE to the dataset's folder"
    )


def existing(source: Path, text: str) -> Path:
    """Return the path below a folder that a text names, if need be in another Unicode form; it need not exist."""
    found = source
    for part in Path(text).parts:
        if not (found / part).exists() and found.is_dir():
            form = unicodedata.normalize("NFC", part)
            part = next((p.name for p in list_folder(found) if unicodedata.normalize("NFC", p.name) == form), part)
        found = found / part
    return found


def absence(path: Path) -> str:
    """Return why a path is not a file, with the name that was probably meant."""
    if path.exists():
        return "not a file"
    folder = path.parent
    others = [p.name for p in list_folder(folder)] if folder.is_dir() else []
    same = next((name for name in others if name.casefold() == path.name.casefold()), "")
    return f"it does not exist; there is {same}, in other case" if same else "it does not exist"


def file_problem(path: Path, suffixes: Sequence[str], otherwise: str = "") -> str:
    """Return why an entry is not a file with one of these suffixes, in short `otherwise`; "" if it is one."""
    if path.is_dir():
        return "a folder; subfolders are not searched"
    if not path.is_file():
        return "not a file: a broken link, or a device"
    if path.suffix.lower() in suffixes:
        return ""
    return otherwise or f"not a {' or '.join(suffixes)} file"


def extra_file(path: Path, source: Path, problem: str) -> Reject:
    """Return the reject for an entry that is not read."""
    name = relative(path, source) + ("/" if path.is_dir() else "")
    return Reject("extra_file", file=name, detail=problem)


def files_by_stem(folder: Path, source: Path, suffix: str, name_problem: Callable[[str], str]) -> Files:
    """List the files of a folder with one suffix and a valid name; every other entry is an ``extra_file``."""
    files: dict[str, Path] = {}
    rejects = []
    entries = list_folder(folder) if folder.is_dir() else []
    # The published spelling first, in case there is a 001.NPY as well.
    for path in sorted(entries, key=lambda path: path.suffix != suffix):
        problem = file_problem(path, (suffix,)) or name_problem(stem_of(path))
        if not problem and stem_of(path) in files:
            problem = f"the same name as {files[stem_of(path)].name}, which is read"
        if problem:
            rejects.append(extra_file(path, source, problem))
        else:
            files[stem_of(path)] = path
    return Files(files, tuple(rejects))


def list_audio(
    folders: Iterable[Path],
    source: Path,
    name_problem: Callable[[str], str],
    mixed: Sequence[Path] = (),
    music_dir: Path | None = None,
) -> Files:
    """List one audio file for each valid name, of `music_dir` first; of `mixed` folders only audio files count."""
    by_stem: dict[str, list[Path]] = {}
    rejects, where = list[Reject](), dict[Path, None]()
    for path in (path for folder in folders if folder.is_dir() for path in list_folder(folder)):
        if path.parent in mixed and path.suffix.lower() not in AUDIO_SUFFIXES:
            continue
        problem = file_problem(path, AUDIO_SUFFIXES) or name_problem(stem_of(path))
        if problem:
            rejects.append(extra_file(path, source, problem))
        else:
            by_stem.setdefault(stem_of(path), []).append(path)
            where[path.parent] = None
    files, preferred = dict[str, Path](), list[str]()
    for stem, paths in sorted(by_stem.items()):
        files[stem], *others = best_audio(paths)
        chosen = relative(files[stem], source)
        detail = f"{chosen} is used instead"
        rejects += [Reject("unused_music", file=relative(path, source), detail=detail) for path in others]
        preferred += [chosen] if others else []
    n, order = f"{len(preferred):,} of the names", "wav is preferred to flac, flac to mp3 and ogg"
    note = f"Music: several audio files for {n}; {order}. Used: {listed(preferred, 3)}."
    music = Files(files, tuple(rejects), (note,) if preferred else (), tuple(where))
    return with_music_dir(music, music_dir, source, name_problem)


def with_music_dir(music: Files, music_dir: Path | None, source: Path, name_problem: Callable[[str], str]) -> Files:
    """Return the audio files of a source, those of `music_dir` first; SourceError if that has none."""
    if music_dir is None:
        return music
    folder = music_dir.expanduser()
    first = list_audio([folder], source, name_problem)
    if not first.files:
        raise SourceError("there is no music in music_dir", where=str(folder),
                          found=describe(folder) if folder.is_dir() else "no such folder",
                          allowed=f"audio files by the names of the dataset, {', '.join(AUDIO_SUFFIXES)}",
                          fix="correct music_dir")  # fmt: skip
    replaced = tuple(
        Reject("unused_music", file=relative(path, source), detail=f"music_dir has {first.files[name].name}")
        for name, path in music.files.items()
        if name in first.files and first.files[name].resolve() != path.resolve()
    )
    note = f"Music: {len(first.files):,} of music_dir ({folder.name}/), before the source's own."
    return Files(
        {**music.files, **first.files},
        (*music.rejects, *first.rejects, *replaced),
        (*music.notes, *first.notes, note),
        (*music.folders, *first.folders),
    )


def require_choices(dataset: Dataset) -> None:
    """Raise UsageError unless each parameter of a dataset that is a Literal has one of its values."""
    for name, annotation in get_type_hints(type(dataset)).items():
        allowed = get_args(annotation) if get_origin(annotation) is Literal else ()
        if allowed and (value := getattr(dataset, name, None)) not in allowed:
            problem = f"{dataset.name}: invalid value for {name}"
            raise UsageError(problem, found=repr(value), fix=did_you_mean(str(value), allowed))


def clips_note(clips: Sequence[ClipRef], left_out: Sequence[Reject], splits: Sequence[str] = SPLITS) -> str:
    """Return the note with the number of clips in each split, and of those left out for each reason."""
    counts = ", ".join(f"{sum(clip.split == name for clip in clips):,} {name}" for name in splits)
    reasons = sorted({reject.reason for reject in left_out})
    why = ", ".join(f"{sum(r.reason == reason for r in left_out):,} {reason}" for reason in reasons)
    return f"Clips: {counts}; left out: {why or 'none'}."


def read_names(path: Path, *, spaces: bool = False) -> list[str]:
    """Return the first word of every line, except comments (``#``), of a text; of JSON the entries of a list."""
    try:
        text = read_regular(path, MAX_LIST_BYTES).decode("utf-8-sig")
        lines = list(map(str, parse_json(text))) if path.suffix == ".json" else text.splitlines()
    except (OSError, ValueError, TypeError) as error:
        raise _bad_list(path, str(error)) from error
    words = ((line.strip() if spaces else line.split(maxsplit=1)[0]) for line in lines if line.strip())
    names = [unicodedata.normalize("NFC", name) for name in words if not name.startswith("#")]
    longest = max(names, key=len, default="")
    if len(names) > _MAX_NAMES or len(longest) > MAX_NAME:
        many = f"{len(names):,} names" if len(names) > _MAX_NAMES else f"a name of {len(longest):,} characters"
        raise _bad_list(path, f"{many}, {quoted(longest, 40)}")
    return names


def _bad_list(path: Path, found: str) -> SourceError:
    return SourceError(
        "the list of names cannot be read",
        where=str(path),
        found=found,
        allowed=f"a UTF-8 text file, one name per line, at most {_MAX_NAMES:,} names of {MAX_NAME} characters",
        fix="replace the file, or remove it",
    )


def read_lists(
    root: Path,
    places: Sequence[Path],
    official: Mapping[str, str],
    recorded: Mapping[str, str],
    below: Sequence[str],
    name_of: Callable[[str], str],
) -> tuple[dict[str, tuple[str, ...]], Path]:
    """Return the names on each list that exists, official ones first, and the folder of those."""
    if not official and not recorded:
        return {}, root
    within = [place / name for place in places for name in below]
    where = max(within, key=lambda place: sum((place / file).is_file() for file in official.values()))
    files = {name: where / file for name, file in official.items()}
    for name, file in recorded.items():
        files[name] = next((p / file for p in (*places, *within) if (p / file).is_file()), where / file)
    lines = {name: read_names(path, spaces=True) for name, path in files.items() if path.is_file()}
    return {name: tuple(dict.fromkeys(name_of(line) for line in of)) for name, of in lines.items()}, where
