"""Songs that splits share under other names: equal samples, and copies in other formats."""

import dataclasses
from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import soundfile
import soxr

import dancedata
from dancedata.audio.librosa35 import Librosa35
from dancedata.building.build import BuildResult
from dancedata.building.leaks import LIKENESS, AlikeSongs, alike_between, alike_songs, leaks
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.music.signal import load_audio
from dancedata.pages.numbers import splits
from dancedata.store import AudioBlock, Field, open_store, write_store
from dancedata.store.clip_columns import ClipRecord
from dancedata.store.songs import music_hashes, songs_of
from dancedata.synthetic import synthesise_song
from dancedata.testing.stores import random_columns, slices_of, write_random_store
from tests.messages import raises_message

Samples = npt.NDArray[np.float32]
Split = Mapping[str, Mapping[str, Any]]
RATE = 48_000
#: Songs of the demo with the same tempo, drums, key and chords: the most alike of its 1770 pairs of songs.
CLOSE = ("mBR4", "mJB4")


def song(name: str, length_s: float = 12) -> Samples:
    return synthesise_song(name, length_s=length_s).signal.samples


def rows(samples: Samples, rate: int = RATE) -> npt.NDArray[np.float32]:
    return Librosa35().extract(AudioSignal(samples, rate), FrameGrid.of(30))


@lru_cache(maxsize=6)
def rows_of(name: str, length_s: float = 12, start_s: float = 0) -> npt.NDArray[np.float32]:
    """Return the rows of a song from a time on."""
    return rows(song(name, length_s)[int(start_s * RATE) :])


def as_mp3(samples: Samples, folder: Path, rate: int = RATE) -> Samples:
    """Encode with about 40 kbit/s of one channel, and decode."""
    file = folder / "copy.mp3"
    with soundfile.SoundFile(
        file, "w", rate, 1, format="MP3", subtype="MPEG_LAYER_III", compression_level=0.9, bitrate_mode="CONSTANT"
    ) as out:
        out.write(samples)
    return load_audio(file).samples


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes a store: by split the songs of its clips, name -> rows of librosa35."""

    def make(
        songs: Split,
        hashes: Mapping[str, str] | None = None,
        slices: bool = False,
        n_frames: int = 240,
        stride: int = 15,
        shortest: int = 0,
        seed: int = 0,
        name: str = "store",
    ) -> Path:
        fields = (
            Field("pose", "motion", random_columns(3), Fraction(30)),
            Field("librosa35", "audio", Librosa35().columns, Fraction(30)),
        )
        counts = {split: len(own) for split, own in songs.items()}
        made = write_random_store(
            tmp_path / f"random {name}", clips=counts, fields=fields, n_frames=(shortest or n_frames, n_frames),
            length=150, stride=stride, seed=seed,
        )  # fmt: skip
        clips = []
        pairs = [(name, audio) for own in songs.values() for name, audio in own.items()]
        for clip, (tune, audio) in zip(made.clips, pairs, strict=True):
            made_of = f"{'a' * 12}{hashes[tune]}{'c' * 12}" if hashes else ""
            clips.append(
                dataclasses.replace(clip, id=f"{name} {clip.id}", music=tune, dancer=f"{name} {clip.dancer}",
                audio={"librosa35": AudioBlock(tune, audio)}, made_of=made_of)
            )  # fmt: skip
        (tmp_path / name).mkdir()
        pieces = [piece for clip in clips for piece in slices_of(made.header, clip)] if slices else clips
        write_store(tmp_path / name, made.header, pieces)
        return tmp_path / name

    return make


def test_one_song_under_two_names_by_its_samples(write: Callable[..., Path]) -> None:
    noise = np.random.default_rng(0).normal(size=(310, 35)).astype("f4")
    songs = {"train": {"blue": noise, "red": noise[::-1]}, "val": {"azul": noise}, "test": {"green": -noise}}
    hashes = {"blue": "b" * 12, "azul": "b" * 12, "red": "0" * 12, "green": "d" * 12}
    path = write(songs, hashes)
    messages = [str(p) for p in leaks(path)]
    assert messages == [f"error: {path}: train and val share songs: azul (also blue)"]
    with open_store(path) as store:
        shared = splits(store).songs
        assert shared.names == {"train and val": ("azul (also blue)",)}
        assert shared.counts["train"] == {"train": 2, "val": 1, "test": 0}
        nameless = [dataclasses.replace(clip.record, made_of="") for clip in store]
        assert songs_of(nameless) == {clip.id: clip.music for clip in store}


def test_copies_have_the_song_of_their_clip_and_clips_without_music_have_none() -> None:
    clip = ClipRecord(id="a", split="train", n_frames=60, music="blue", made_of="a" * 12 + "b" * 12 + "c" * 12)
    copy = dataclasses.replace(clip, id="a__fast", source="a", music="", made_of="a" * 12 + "d" * 12 + "c" * 12)
    silent = [
        dataclasses.replace(clip, id=name, music="", made_of="a" * 12 + "0" * 12 + "c" * 12) for name in ("x", "y")
    ]
    assert songs_of([clip, copy, *silent]) == {"a": "blue", "a__fast": "blue"}
    assert music_hashes([clip, *silent]) == {"a": "b" * 12}


@pytest.mark.parametrize(
    ("splits_of", "is_leak"), [(("train", "val"), True), (("val", "train"), True), (("val", "test"), False)]
)
def test_what_train_shares_leaks(splits_of: tuple[str, str], is_leak: bool) -> None:
    one, two = (frozenset({split}) for split in splits_of)
    assert AlikeSongs(("blue", "azul"), (one, two), 0.9, 0.0).leaks == is_leak


def test_five_seconds_are_enough_and_too_many_pairs_are_not_compared(write, monkeypatch):
    noise, other = (np.random.default_rng(seed).normal(size=(150, 35)).astype("f4") for seed in (0, 1))
    path = write({"train": {"first": noise, "third": other}, "test": {"second": noise}}, n_frames=150)
    with open_store(path) as store:
        (pair,) = alike_songs(store, songs_of(store.clips()))
        assert (pair.songs, pair.shift_s) == (("first", "second"), 0.0)
        monkeypatch.setattr("dancedata.building.leaks.MAX_PAIRS", 2)
        assert alike_songs(store, songs_of(store.clips())) is None


@pytest.mark.parametrize("slices", [False, True])
def test_a_copy_in_another_format_is_found(write: Callable[..., Path], tmp_path: Path, slices: bool) -> None:
    """An mp3, quieter, with its first second cut off and silence at its end; and a song that is only alike."""
    first = song(CLOSE[0])
    copy = as_mp3(np.concatenate([0.3 * first[RATE:], np.zeros(RATE // 2, "f4")]), tmp_path)
    songs = {"train": {"first": rows_of(CLOSE[0])}, "test": {"second": rows_of(CLOSE[1]), "copy": rows(copy)}}
    path = write(songs, slices=slices)
    (problem,) = leaks(path)
    assert problem.severity == "error"
    assert "sound alike: first of train and copy of test" in problem.message
    with open_store(path) as store:
        (pair,) = alike_songs(store, songs_of(store.clips()))
        assert abs(pair.shift_s + 1) < 0.1
        (name,) = splits(store).songs.names["train and test"]
        assert name.startswith("first (sounds as copy, likeness 0.")


@pytest.mark.parametrize("stride", [200, 260])
def test_slices_with_gaps_between_them(write: Callable[..., Path], stride: int) -> None:
    """A copy without the first 3.2 s has its gaps at other places; frames that no slice covers do not count."""
    first, second = CLOSE
    songs = {
        "train": {"first": rows_of(first, 30)},
        "test": {"second": rows_of(second, 30), "copy": rows_of(first, 30, 3.2)},
    }
    path = write(songs, slices=True, n_frames=780, stride=stride)
    with open_store(path) as store:
        (pair,) = alike_songs(store, songs_of(store.clips()))
    assert pair.songs == ("first", "copy")
    assert pair.likeness > LIKENESS + 0.03
    assert abs(pair.shift_s + 3.2) < 0.1


@pytest.mark.parametrize(("long", "seed"), [("train", 2), ("test", 6)])
def test_the_clip_with_the_most_slices_represents_a_song(write: Callable[..., Path], long: str, seed: int) -> None:
    """A song's copy is found by the song's long clip, the first or the last; its short clip has only noise."""
    music, noise = rows_of(CLOSE[0]), np.random.default_rng(0).normal(size=(360, 35)).astype("f4")
    songs = {split: {split: music if split in (long, "val") else noise} for split in ("train", "val", "test")}
    with open_store(write(songs, slices=True, shortest=240, n_frames=360, seed=seed)) as store:
        assert max(("train", "test"), key=lambda split: sum(clip.split == split for clip in store)) == long
        (pair,) = alike_songs(store, {clip.id: "copy" if clip.split == "val" else "song" for clip in store})
    assert pair.likeness > LIKENESS


def test_gaps_alone_are_not_alike(write: Callable[..., Path]) -> None:
    """Different songs with their gaps at the same places."""
    songs = {"train": {"first": rows_of(CLOSE[0], 30)}, "test": {"second": rows_of(CLOSE[1], 30)}}
    assert leaks(write(songs, slices=True, n_frames=780, stride=260)) == []


def test_silence_and_short_songs_are_not_alike(write: Callable[..., Path]) -> None:
    silence, noise = np.zeros((320, 35), "f4"), np.random.default_rng(0).normal(size=(320, 35)).astype("f4")
    songs = {"train": {"a": silence, "b": noise}, "test": {"c": silence, "d": silence + 1}}
    assert leaks(write(songs)) == []


def test_datasets_that_share_a_re_encoded_song(write: Callable[..., Path], tmp_path: Path) -> None:
    """Quieter, as mp3 of 44.1 kHz, begun 2 s later: found, with the shift; songs that are only alike are not."""
    first, second = (song(name) for name in CLOSE)
    copy = as_mp3(0.4 * soxr.resample(first, RATE, 44_100)[2 * 44_100 :], tmp_path, 44_100)
    a = write({"train": {"first": rows(first)}, "val": {"own": rows(song("mWA0"))}}, name="a")
    b = write({"train": {"second": rows(second)}, "test": {"copy": rows(copy, 44_100)}}, name="b")
    problems = dancedata.check(a, b, progress=False)
    [problem] = [p for p in problems if "random" not in p.message]
    assert (problem.severity, problem.where) == ("error", f"{a} and {b}")
    assert "sound alike: first of train and copy of test" in problem.message
    with open_store(a) as one, open_store(b) as other:
        [pair] = alike_between(one, other)
        assert abs(pair.shift_s + 2) < 0.1
        [back] = alike_between(other, one)
        assert (back.songs, round(back.shift_s, 3)) == (("copy", "first"), -round(pair.shift_s, 3))
        assert alike_between(one, other, {("first", "copy")}) == []


def test_songs_of_equal_samples_and_names_alone(write: Callable[..., Path]) -> None:
    noise = np.random.default_rng(0).normal(size=(3, 310, 35)).astype("f4")
    a = write({"train": {"blue": noise[0], "red": noise[1]}}, {"blue": "b" * 12, "red": "d" * 12}, name="a")
    b = write(
        {"train": {"azul": noise[0]}, "test": {"red": noise[2], "rojo": noise[1]}},
        {"azul": "b" * 12, "red": "e" * 12, "rojo": "d" * 12},
        name="b",
    )
    c = write({"train": {"white": -noise[0]}}, {"white": "f" * 12}, name="c")
    assert [str(p) for p in dancedata.check(a, b, c, progress=False)] == [
        f"error: {a} and {b}: train and test share 1 song, by samples: red (there rojo)",
        f"note: {a} and {b}: train and train share 1 song, by samples: blue (there azul)",
        f"note: {a} and {b}: train and test share 1 song, by name alone: red",
    ]


def test_what_cannot_be_compared_is_stated(write: Callable[..., Path], tmp_path: Path) -> None:
    noise = np.random.default_rng(0).normal(size=(310, 35)).astype("f4")
    a = write({"train": {"blue": noise}}, name="a")
    other = (Field("pose", "motion", random_columns(3), Fraction(30)),)
    made = write_random_store(
        tmp_path / "b", clips={"train": 1}, fields=other, n_frames=(60, 60), length=30, stride=30
    )
    messages = [p.message for p in dancedata.check(a, made.path, progress=False)]
    assert any(
        m.startswith("songs were compared by samples and name, not by their sound: they have no") for m in messages
    )
    with raises_message(UsageError, "compared"):
        dancedata.check(a, made.path, dataset="folder", progress=False)
    (tmp_path / "empty").mkdir()
    assert [p.severity for p in dancedata.check(a, tmp_path / "empty", progress=False)] == ["error"]


def test_songs_that_splits_share(random_store: Any, tmp_path: Path) -> None:
    made = random_store(tmp_path / "made")

    def build(name: str, **music: str) -> list[Any]:
        clips = [dataclasses.replace(c, music=music.get(c.split, c.music)) for c in made.clips]
        (tmp_path / name).mkdir()
        write_store(tmp_path / name, made.header, clips)
        return leaks(tmp_path / name)

    for one, other, severity in (("train", "test", "error"), ("train", "val", "error"), ("val", "test", "note")):
        [problem] = build(f"{one} {other}", **{one: "mBR0", other: "mBR0"})
        assert problem.severity == severity
        assert f"{one} and {other} share songs: mBR0" in problem.message
        summary = BuildResult.of(tmp_path / f"{one} {other}", built=True, strict=False).summary
        assert ("warning: train and" in summary, "checked: no song of train" in summary) == (
            severity == "error", severity == "note",
        )  # fmt: skip
    assert build("d", train="", val="", test="") == []


def test_what_official_splits_share_is_a_counted_note(random_store: Any, tmp_path: Path) -> None:
    made, out = random_store(tmp_path / "made"), tmp_path / "out"
    clips = [dataclasses.replace(c, music="mBR0") for c in made.clips]
    header = dataclasses.replace(made.header, meta={**made.header.meta, "source": {"split_rule": "official"}})
    out.mkdir()
    write_store(out, header, clips)
    problems = leaks(out)
    assert {p.severity for p in problems} == {"note"}
    assert any("the official train and test share 1 song: mBR0" in p.message for p in problems)
    again = BuildResult.of(out, built=False, strict=True).summary
    assert "checked: the official train and val share 1 song" in again
