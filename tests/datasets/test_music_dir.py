"""The key music_dir of every dataset: music in another folder than the source's."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from dancedata.core.clip import Scan
from dancedata.core.errors import SourceError
from dancedata.core.registry import DATASETS
from dancedata.files.documents import document_of
from dancedata.recipes.plugins import make_named
from tests.datasets.scans import notes, rejects
from tests.messages import raises_message

#: All that read files of others; one that generates its source has the music in it.
#: Datasets with music of their own that lies in files.
NAMES = [n for n in DATASETS.names() if not DATASETS.get(n).generates and DATASETS.get(n).has_audio]


def reader(name: str, **keys: Any) -> Any:
    return DATASETS.get(name)(**({"split": "all"} if name == "phantomdance" else {}), **keys)


def audio(scan: Scan) -> dict[str, str]:
    return {clip.id: clip.audio_path.name for clip in scan.clips if clip.audio_path is not None}


@pytest.mark.parametrize("name", NAMES)
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
