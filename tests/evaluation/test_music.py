"""Where beats of music are from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.evaluation.clip_music import ClipMusic, beats_after
from dancedata.evaluation.music import read_songs
from dancedata.metrics import MusicBeats
from dancedata.store import Store


def test_beats_of_a_piece_are_counted_from_its_first_frame() -> None:
    beats = MusicBeats.of([0, 10, 25, 30], FrameGrid.of(30))
    same = beats_after(beats, 10, FrameGrid.of(30))
    assert same.frames.tolist() == [0, 15, 20]
    half = beats_after(beats, 21, FrameGrid.of(60))  # at 0.35 s, between frames 10 and 11
    assert (half.frames / float(half.grid.rate)).tolist() == pytest.approx([25 / 30 - 0.35, 1 - 0.35])
    ntsc = beats_after(beats, 7, FrameGrid.of("30000/1001"))
    start = 7 * 1001 / 30000
    assert (ntsc.frames / float(ntsc.grid.rate)).tolist() == pytest.approx([t - start for t in (10 / 30, 25 / 30, 1)])


def test_beats_by_piece() -> None:
    own = MusicBeats.of([3], FrameGrid.of(30))
    music = ClipMusic(MusicBeats.of([], FrameGrid.of(30)), by_piece={15: own})
    assert music.after(15, FrameGrid.of(30)) is own
    assert len(music.after(30, FrameGrid.of(30)).frames) == 0


def test_generated_clips_take_the_song_that_is_named(store: Store, tmp_path: Path) -> None:
    clip = store.clips[0]
    np.save(tmp_path / "sample.npy", clip.read("edge151"))
    (tmp_path / "songs.csv").write_text(f"sample,{clip.music}.wav\n", encoding="utf-8")
    named = dancedata.evaluate(tmp_path, like=store, music_of=tmp_path / "songs.csv", bootstrap=0)
    stored = dancedata.evaluate({clip.id: dancedata.decode(clip.read("edge151"), "edge151")}, like=store, bootstrap=0)
    assert named["bas"] == stored["bas"] is not None
    nameless = dancedata.evaluate(tmp_path, like=store, bootstrap=0)
    assert nameless["bas"] is None
    assert any("no beats of music" in warning for warning in nameless.warnings)


def test_music_that_ends_before_the_motion_is_told(store: Store, tmp_path: Path) -> None:
    clip = store.clips[0]
    joints = dancedata.decode(clip.read("edge151"), "edge151").joints()
    long = {"long": np.concatenate([joints, joints, joints])}
    report = dancedata.evaluate(long, like=store, music_of={"long": clip.music}, bootstrap=0)
    assert any("the music ends before the motion of 1 clip: long" in warning for warning in report.warnings)


@pytest.mark.parametrize(("text", "found"), [("a,b,c\n", 3), ("clip,song\na,b\nc\n", 1)])
def test_broken_lists_of_songs(tmp_path: Path, text: str, found: int) -> None:
    (tmp_path / "songs.csv").write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match=f"does not have two columns; found {found}"):
        read_songs(tmp_path / "songs.csv")
    with pytest.raises(UsageError, match="cannot be read"):
        read_songs(tmp_path / "missing.csv")
