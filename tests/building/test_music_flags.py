"""Flags of a clip's music, from the decoder to `check`; one unreadable song leaves out one clip."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

import dancedata
from dancedata.building.signals import SignalId, identify_audio
from dancedata.execution.cache import Cache
from dancedata.music.ffmpeg import ffmpeg_version
from dancedata.synthetic import synthesise_motion, synthesise_song

RECIPE: dict[str, Any] = {
    "recipe": 1, "name": "flags", "dataset": {"folder": {"up": "y", "unit": "m"}},
    "windows": {"length_s": 1, "stride_s": 1}, "motion": {"joints": {}}, "audio": {"librosa35": {}},
}  # fmt: skip


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("source")
    motion = synthesise_motion("gBR_sFM_cAll_d04_mBR4_ch02", n_frames=180)[0]
    song = synthesise_song("mBR4", length_s=4, sample_rate=22_050, n_channels=1).signal.samples
    for name, samples in {"good": song, "muted": 0 * song, "constant": 0 * song + 0.5, "broken": song}.items():
        soundfile.write(folder / f"{name}.wav", samples, 22_050)
        poses = np.asarray(motion.rotations).reshape(-1, 72)
        np.savez(folder / f"{name}.npz", poses=poses, trans=np.asarray(motion.translation), fps=60.0)
    wav = (folder / "broken.wav").read_bytes()
    (folder / "broken.wav").write_bytes(wav + wav)
    return folder


def test_songs_without_sound_are_flagged_and_counted(source: Path, tmp_path: Path) -> None:
    built = dancedata.build(RECIPE, source, tmp_path / "out", cache=tmp_path / "cache", jobs=1, progress=False)
    with built.open() as store:
        assert {clip.id: clip.n_flags for clip in store} == {"good": 0, "muted": 1, "constant": 1}
        assert {(row["clip"], row["kind"]) for row in store.quality} == {
            ("muted", "silent_music"), ("constant", "silent_music"),
        }  # fmt: skip
        (reject,) = store.rejects
    assert (reject["clip"], reject["reason"], reject["file"]) == ("broken", "broken_audio", "broken.wav")
    assert "silent music: 2 clips" in built.summary
    for problems in (dancedata.check(tmp_path / "out"), dancedata.check(source, recipe=RECIPE, progress=False)):
        found = {(p.severity, p.where) for p in problems if p.message.startswith("silent_music")}
        assert found == {("note", "muted"), ("note", "constant")}


@pytest.mark.skipif(not ffmpeg_version(), reason="without ffmpeg")
def test_a_song_is_decoded_again_by_another_ffmpeg(source, tmp_path, monkeypatch):
    wav, cache = (source / "good.wav").read_bytes(), Cache(tmp_path / "cache")
    (tmp_path / "a.wav").write_bytes(wav[:40] + bytes(4) + wav[44:])  # of length 0: ffmpeg reads it
    (tmp_path / "b.wav").write_bytes(wav)
    for name, ffmpeg in (("a.wav", ffmpeg_version()), ("b.wav", "")):
        signal = identify_audio(cache, tmp_path / name)
        assert isinstance(signal, SignalId)
        assert signal.ffmpeg == ffmpeg
        assert SignalId.cached(cache, tmp_path / name) == signal
    monkeypatch.setattr("dancedata.music.ffmpeg.ffmpeg_version", lambda: "another")
    assert SignalId.cached(cache, tmp_path / "a.wav") is None
    assert SignalId.cached(cache, tmp_path / "b.wav") is not None
