"""dancedata features --like DATASET: the tempo that the dataset states, and the weights that it wants."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import soundfile

import dancedata
from dancedata import songs as own_songs
from dancedata.building.describe import describe_store, store_json
from dancedata.building.fields.music import MusicField
from dancedata.building.song_fields import stated_tempo
from dancedata.core.errors import SourceError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.registry import FEATURES
from dancedata.music.signal import load_audio
from dancedata.recipes.plugins import make_named
from dancedata.store import open_store
from dancedata.testing.stores import write_random_store
from tests.commands import run
from tests.messages import raises_message

SHA = "5" * 64


def features(*args: object) -> str:
    return run("features", *args).stdout


def test_the_line_of_the_readme(built: Path, corpus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without --out: ./features. The tempo is the dataset's, by the song's samples, and so are the rows."""
    shutil.copy(corpus / "wavs" / "mBR0.wav", tmp_path / "song.wav")
    monkeypatch.chdir(tmp_path)
    output = features("song.wav", "--like", built)
    assert "features/song.librosa35.npy: " in output
    assert "tempo 80 BPM, as the dataset states for this song" in output
    about = json.loads((tmp_path / "features" / "song.librosa35.json").read_text())
    assert (about["start_bpm"], about["tempo_bpm"], about["tempo_estimated"]) == (80, 80, False)
    assert about["tempo_from"] == "samples"
    store = dancedata.open(built)
    clip = next(clip for clip in store if clip.music == "mBR0")
    rows = np.load(tmp_path / "features" / "song.librosa35.npy")
    np.testing.assert_array_equal(rows, clip.read_song("librosa35"))


def test_a_song_of_the_same_name_and_one_that_is_unknown(built: Path, corpus: Path, tmp_path: Path) -> None:
    samples, rate = soundfile.read(corpus / "wavs" / "mBR0.wav")
    for name in ("mBR0", "other"):
        soundfile.write(tmp_path / f"{name}.wav", samples[rate:], rate)
    output = features(tmp_path / "mBR0.wav", "--like", built, "--out", tmp_path / "a")
    assert "tempo 80 BPM, as the dataset states for a song of this name, whose samples are others" in output
    assert "tempo estimated" in features(tmp_path / "other.wav", "--like", built, "--out", tmp_path / "b")
    set_by_hand = features(tmp_path / "mBR0.wav", "--like", built, "--out", tmp_path / "c", "--bpm", 93)
    assert "the dataset states" not in set_by_hand
    found = {p.parent.name: json.loads(p.read_text()) for p in tmp_path.glob("*/*.json")}
    assert {name: about["tempo_from"] for name, about in found.items()} == {
        "a": "name", "b": "estimate", "c": "--bpm",
    }  # fmt: skip
    assert found["c"]["tempo_bpm"] == 93


def test_several_tempos_of_one_song_are_an_error(built: Path, corpus: Path, tmp_path: Path) -> None:
    song = corpus / "wavs" / "mBR0.wav"
    with open_store(built) as store:
        clips = [SimpleNamespace(**{**vars(c.record), "tempo_bpm": 80.0 + k}) for k, c in enumerate(store.clips())]
        stand_in: Any = SimpleNamespace(meta=store.info, clips=lambda: clips)
        with raises_message(UsageError, "tempos", where="source/wavs/mBR0.wav"):
            stated_tempo(stand_in, load_audio(song).sha256, song)


def jobs(*names: str) -> list[MusicField]:
    grid = FrameGrid.of(30)
    return [MusicField(name, grid, make_named(FEATURES, "audio", name.split(".")[0], {})) for name in names]


def test_weights_go_to_a_field_by_name(tmp_path: Path) -> None:
    three = jobs("librosa35", "hf.mert", "jukebox")
    given = ["hf.mert=/mert", "jukebox=~/weights"]
    assert own_songs._weights_of(given, three) == {
        "hf.mert": Path("/mert"),
        "jukebox": Path("~/weights").expanduser(),
    }
    assert own_songs._weights_of([tmp_path], three[:2]) == {"hf.mert": tmp_path}
    (tmp_path / "a=b").mkdir()
    assert own_songs._weights_of([tmp_path / "a=b"], three[:2]) == {"hf.mert": tmp_path / "a=b"}
    for fields, texts in (
        (three, ["/mert"]), (three[:1], ["/mert"]), (three, ["hf.mret=/mert"]), (three, ["librosa35=/mert"]),
        (three, ["jukebox=a", "jukebox=b"]),
    ):  # fmt: skip
        with raises_message(UsageError, "weights"):
            own_songs._weights_of(texts, fields)


def test_a_dataset_names_its_weights(tmp_path: Path) -> None:
    about = {"model": "m-a-p/MERT-v1-95M", "revision": "c" * 40, "sha256": SHA, "licence": "cc-by-nc-4.0"}
    meta = {"encoders": {"edge151": about}, "recipe": {"audio": {"librosa35": {"weights_sha256": SHA, "layer": 66}}}}
    path = write_random_store(tmp_path / "store", meta=meta).path
    wanted = f"m-a-p/MERT-v1-95M, revision {'c' * 40}, sha256 {SHA}, licence: cc-by-nc-4.0"
    assert store_json(path)["weights"] == {"edge151": wanted, "librosa35": f"sha256 {SHA}"}
    assert f"  weights of edge151: {wanted}" in describe_store(path).splitlines()

    def unknown(hash_file: object) -> None:
        raise SourceError("hf: the model is unknown", fix="set model")

    job: Any = SimpleNamespace(name="edge151", feature=SimpleNamespace(resolved=unknown))
    with open_store(path) as store, raises_message(SourceError, "set model"):
        own_songs._ready(job, None, store)
