"""Scans of all published datasets: music here and elsewhere, other files, links, wrong folders; wrong parameters."""

import re
import shutil
from dataclasses import fields
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest

from dancedata.core.clip import Scan
from dancedata.core.errors import SourceError, UsageError
from dancedata.core.registry import DATASETS
from dancedata.datasets.published import PublishedDataset
from dancedata.files.documents import document_of
from dancedata.recipes.plugins import make_named
from tests.datasets.scans import notes, rejects
from tests.messages import raises_message

NAMES = [name for name in DATASETS.names() if issubclass(DATASETS.get(name), PublishedDataset)]
WITH_MUSIC = [name for name in NAMES if DATASETS.get(name).has_audio]
#: A name that no example has.
OTHER = {
    "aioz-gdance": "plainid0123_09_0_9", "aist++": "mKR0", "dcm": "a9_9", "dd100": "Jive_1_0", "finedance": "200",
}  # fmt: skip


def reader(name: str, **keys: Any) -> Any:
    return DATASETS.get(name)(**keys)


def below(source: Path, path: Path) -> str:
    return path.relative_to(source).as_posix()


@pytest.mark.parametrize("name", WITH_MUSIC)
def test_music_that_is_missing_and_music_without_motion(name: str, source: Path) -> None:
    before = reader(name).scan(source)
    path = before.clips[0].audio_path
    mine = {clip.id for clip in before.clips if clip.audio_path == path}
    other = path.rename(path.with_name(f"{OTHER.get(name, 'BVzzzzzzzz9z_Clip_1')}.mp3"))
    scan = reader(name).scan(source)
    assert rejects(scan, "unused_music") == [below(source, other)]
    if "music" not in {field.name for field in fields(reader(name))}:
        assert [clip.audio_path for clip in scan.clips if clip.id in mine] == [None] * len(mine)
        return
    assert {clip.id for clip in scan.clips} == {clip.id for clip in before.clips} - mine
    lacking = [reject for reject in scan.rejects if reject.reason == "missing_music"]
    assert lacking
    assert all(reject.music and reject.file and "wav, flac, mp3 or ogg" in reject.detail for reject in lacking)
    keys = {"music": "optional"} | ({"fps": "30"} if name == "i-dancers" else {})
    assert {clip.id for clip in reader(name, **keys).scan(source).clips} == {clip.id for clip in before.clips}


@pytest.mark.parametrize("name", WITH_MUSIC)
def test_the_preferred_one_of_several_files_of_a_song(name: str, source: Path) -> None:
    path = reader(name).scan(source).clips[0].audio_path
    path.with_suffix(".OGG").write_bytes(b"")
    scan = reader(name).scan(source)
    assert scan.clips[0].audio_path == path
    assert rejects(scan, "unused_music") == [below(source, path.with_suffix(".OGG"))]


@pytest.mark.parametrize("name", NAMES)
def test_other_files_links_and_folders_by_name(name: str, source: Path) -> None:
    before = reader(name).scan(source)
    motion = before.clips[0].motion_path
    folders = {motion.parent} | ({before.clips[0].audio_path.parent} if name in WITH_MUSIC else set())
    odd = []
    for folder in folders:
        for file in ("notes ü.txt", "loop"):
            odd.append(folder / file)
        odd[-2].write_bytes(b"x")
        odd[-1].symlink_to(source, target_is_directory=True)
        for file in (".DS_Store", f"._{motion.name}"):
            (folder / file).write_bytes(b"x")
    link = motion.with_name(motion.name.replace(motion.suffix, motion.suffix.upper()))
    link.symlink_to("nowhere")
    scan = reader(name).scan(source)
    wanted = [below(source, path) + "/" * path.is_dir() for path in [*odd, link]]
    shown = [file for file in wanted if not (name == "phantomdance" and file.startswith("music/"))]
    assert rejects(scan, "extra_file") == sorted(shown)
    assert all(reject.detail for reject in scan.rejects)
    assert [clip.id for clip in scan.clips] == [clip.id for clip in before.clips]


@pytest.mark.parametrize("name", NAMES)
def test_a_folder_with_another_dataset_or_without_motion(name: str, source: Path) -> None:
    motion = reader(name).scan(source).clips[0].motion_path
    for path in motion.parent.iterdir():
        path.unlink()
    with raises_message(SourceError, "", where="") as error:
        reader(name).scan(source)
    assert error.value.fix
    (source.parent / "other").mkdir()
    (source.parent / "other" / "holiday.jpg").write_bytes(b"x")
    with raises_message(SourceError, r"holiday\.jpg", where="other"):
        reader(name).scan(source.parent / "other")


@pytest.mark.parametrize("name", [name for name in NAMES if DATASETS.get(name).official])
def test_official_lists_are_needed_and_apart(name: str, source: Path) -> None:
    train, test = (next(source.rglob(DATASETS.get(name).official[split])) for split in ("train", "test"))
    test.write_bytes(train.read_bytes())
    with raises_message(SourceError, f"name the same motions.*{re.escape(train.name)}"):
        reader(name).scan(source)
    test.unlink()
    with raises_message(SourceError, re.escape(f"found no {test.name}")) as error:
        reader(name).scan(source)
    assert error.value.fix
    if by_unit := [s for s in get_args(get_type_hints(DATASETS.get(name)).get("split")) if s.startswith("by-")]:
        assert reader(name, split=by_unit[0]).scan(source).clips


WRONG: dict[str, dict[str, tuple[Any, ...]]] = {
    "aioz-gdance": {"split": ("by-song",), "music": ("none",)},
    "aist++": {"split": ("../mine", ""), "ignore": ("maybe",), "music": ("no",)},
    "dcm": {"split": ("by-song",), "music": ("no",)},
    "dd100": {"up": ("x",)},
    "finedance": {"split": ("crossgenre",), "labels": ("no",), "keep": (("001",), (120,), "120")},
    "i-dancers": {"up": ("x",), "music": ("no",), "fps": ("fast",), "trim_frames": (-1, 1.5)},
    "infinitedance": {"motion": ("tokens",), "split": ("by-video",), "clips": ("others",), "up": ("x",)},
    "motorica": {
        "split": ("official_clean",), "trim_s": (-1,), "fingers": ("no",), "music": ("none",), "takes": ("two",),
    },
    "phantomdance": {"split": ("official",), "music": ("no",)},
    "popdanceset": {"split": ("video",), "scale": ("divide",), "music": ("no",)},
}  # fmt: skip
CASES = [(name, key, value) for name, keys in WRONG.items() for key, values in keys.items() for value in values]


@pytest.mark.parametrize(("name", "key", "value"), CASES)
def test_wrong_parameters(name: str, key: str, value: Any) -> None:
    found = value[0] if isinstance(value, tuple) else value[0] if key == "keep" else value
    said = "rate" if key == "fps" else rf"^{name.replace('+', '[+]')}: .*\b{key}\b"
    with raises_message(UsageError, f"{said}.*; found '?{found}'?.*(allowed|known):"):
        DATASETS.get(name)(**{key: value})


#: All that read files of others; one that generates its source has the music in it.
#: Datasets with music of their own that lies in files.
OF_FILES = [n for n in DATASETS.names() if not DATASETS.get(n).generates and DATASETS.get(n).has_audio]


def audio(scan: Scan) -> dict[str, str]:
    return {clip.id: clip.audio_path.name for clip in scan.clips if clip.audio_path is not None}


@pytest.mark.parametrize("name", OF_FILES)
def test_music_elsewhere(name: str, source: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "songs"
    assert document_of(reader(name, music_dir=Path("x"))) == document_of(reader(name)), "it shapes no hash"
    before = reader(name).scan(source)
    assert audio(before)
    elsewhere.mkdir()
    for path in sorted({clip.audio_path for clip in before.clips if clip.audio_path is not None}):
        # Below the folder as in a manifest, else by its name alone.
        target = elsewhere / (path.relative_to(source) if "manifest" in before.layout else path.name)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)
    both = reader(name, music_dir=elsewhere).scan(source)
    assert all(elsewhere in clip.audio_path.parents for clip in both.clips), "it comes first"
    for clip in before.clips:
        clip.audio_path.unlink(missing_ok=True)
    found = reader(name, music_dir=elsewhere).scan(source)
    assert audio(found) == audio(before)
    assert all(elsewhere in clip.audio_path.parents for clip in found.clips)
    assert str(tmp_path) not in notes(found), "no paths of this machine"
    if "manifest" not in before.layout:
        assert "of music_dir (songs/), before the source's own" in notes(found)
        assert rejects(both, "unused_music")
    with raises_message(SourceError, "music_dir", where="gone"):
        reader(name, music_dir=tmp_path / "gone").scan(source)


def test_names_of_a_folder(tmp_path: Path) -> None:
    for folder, file in (("source", "a.bvh"), ("songs", "a.wav"), ("songs", "b.mp3")):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / file).write_bytes(b"")
    scan = reader("folder", music_dir=tmp_path / "songs", unit="m").scan(tmp_path / "source")
    assert [clip.audio_path for clip in scan.clips] == [tmp_path / "songs" / "a.wav"]
    assert rejects(scan, "unused_music") == ["songs/b.mp3"]


def test_relative_folders_begin_at_the_root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Workers of a cluster run in other folders, where files of the same names are other songs and bodies."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    folder: Any = make_named(DATASETS, "dataset", "folder", {"music_dir": "music", "body_model": "~/body.npz"})
    assert (folder.music_dir, folder.body_model) == (tmp_path / "music", tmp_path / "home" / "body.npz")
    (tmp_path / "a.bvh").write_bytes(b"")
    unknown: Any = make_named(DATASETS, "dataset", "folder", {"music_dir": "~nobody-of-this-name/x"})
    with pytest.raises(SourceError, match="~nobody-of-this-name/x: folder: music_dir is not a folder"):
        unknown.scan(tmp_path)
