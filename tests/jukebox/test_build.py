"""Builds with a tiny checkpoint in the real layout: both scopes, killed and gone on with, and one's own song."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

pytest.importorskip("torch")

import dancedata
from dancedata.audio.jukebox.feature import ENVIRONMENT, Jukebox
from dancedata.building.build import build
from dancedata.cli.app import app
from dancedata.core.grid import FrameGrid
from dancedata.files.regular_file import sha256_file
from dancedata.music.signal import load_audio
from dancedata.recipes.parse import load_recipe
from dancedata.store import Store, verify_store

SET = ("audio={jukebox: {layer: 6, device: cpu}}", "windows.stride_s=1", "motion={edge151: {}}")


@pytest.fixture(autouse=True)
def _weights(tiny: SimpleNamespace, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ENVIRONMENT, str(tiny.folder))


#: Overrides of whole clips, and of slices.
SCOPES = {"track": "transforms=[]", "window": "transforms=[{slices: {stride_s: 1}}]"}


def _build(corpus: Path, folder: Path, scope: str) -> Store:
    build(load_recipe("aist++", (*SET, SCOPES[scope])), corpus, folder / "out", cache=folder / "cache")
    assert [p for p in verify_store(folder / "out") if p.severity == "error"] == []
    return dancedata.open(folder / "out")


@pytest.fixture(scope="module")
def stores(corpus: Path, tiny: SimpleNamespace, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Store]:
    """The corpus built in both scopes. Not to be written into."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(ENVIRONMENT, str(tiny.folder))
        return {scope: _build(corpus, tmp_path_factory.mktemp(scope), scope) for scope in ("track", "window")}


@pytest.mark.parametrize("scope", ["track", "window"])
def test_both_scopes(corpus: Path, stores: dict[str, Store], scope: str) -> None:
    store = stores[scope]
    assert store.field("jukebox").dtype == "float16"
    recipe = store.info["recipe"]["audio"]["jukebox"]
    assert recipe["precision"] == "fp32"
    assert len(recipe["weights_sha256"]) == 64
    feature = Jukebox(layer=6, device="cpu").resolved(sha256_file)
    songs = {path.stem: load_audio(path) for path in (corpus / "wavs").iterdir()}
    tracks = {name: feature.extract(song, FrameGrid.of(30)) for name, song in songs.items() if scope == "track"}
    for split in store.splits:
        for window in store.windows(split):
            clip = store[window.clip]
            name, song = clip.music, songs[clip.music]
            found = store.read(window, "jukebox")
            assert found.shape == (150, 40)
            if scope == "window":
                start = np.array([clip.slice_start * song.sample_rate // 30])
                wanted = feature.extract_windows(song, start, 5 * song.sample_rate, FrameGrid.of(30), 150)[0]
            else:
                wanted = tracks[name][window.start : window.start + 150]
            np.testing.assert_array_equal(found, wanted)


def test_resumes_after_an_interrupt_at_any_window(corpus, tmp_path, monkeypatch):
    computed: list[tuple[str, int]] = []
    plain = Jukebox.extract_windows

    def counted(self: Jukebox, song: object, starts: np.ndarray, *rest: object, **named: object) -> np.ndarray:
        if len(computed) in (2, 3):
            computed.append(("killed", 0))
            raise KeyboardInterrupt
        rows = plain(self, song, starts, *rest, **named)  # type: ignore[arg-type]
        computed.extend((song.sha256, int(start)) for start in starts)  # type: ignore[attr-defined]
        return rows

    monkeypatch.setattr(Jukebox, "extract_windows", counted)
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            _build(corpus, tmp_path, "window")
    store = _build(corpus, tmp_path, "window")
    done = [unit for unit in computed if unit[0] != "killed"]
    # Clips share their songs' windows.
    wanted = {(clip.music, clip.slice_start) for clip in store}
    assert len(done) == len(set(done)) == len(wanted)


@pytest.mark.parametrize("scope", ["track", "window"])
def test_an_own_song_like_a_dataset(corpus, stores, tmp_path, tiny, scope, monkeypatch):
    store = stores[scope]
    song = next((corpus / "wavs").glob("*.wav"))
    command = ["features", str(song), "--field", "jukebox", "--out", str(tmp_path), "--like", str(store.path)]
    monkeypatch.delenv(ENVIRONMENT)
    done = CliRunner().invoke(app, [*command, "--weights", str(tiny.folder), "--json"], catch_exceptions=False)
    (about,) = json.loads(done.stdout)["result"]["songs"]
    rows = np.load(tmp_path / about["file"])
    clip = next(clip for clip in store if clip.music == song.stem)
    mine = rows[:150] if scope == "track" else rows[clip.slice_start // 30]
    np.testing.assert_array_equal(mine, clip.read("jukebox")[:150])
