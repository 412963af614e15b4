"""dancedata check --offsets, and audio_start_s auto: planted offsets are found, or unknown, and recorded."""

import csv
import shutil
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

import dancedata
from dancedata import comparison
from dancedata.alignment import align as room
from dancedata.alignment import rhythm
from dancedata.alignment.align import Aligned, Alignment
from dancedata.alignment.onsets import BANDS_HZ, onset_strength
from dancedata.alignment.rhythm import Search
from dancedata.building.part import Part, build_part
from dancedata.building.plan import make_plan
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.clip import ClipRef
from dancedata.core.errors import DataError, SourceError, UsageError
from dancedata.datasets.aistpp import AistPP
from dancedata.execution.cache_admin import entries
from dancedata.metrics.offsets import Offset
from dancedata.recipes.parse import load_recipe
from dancedata.store import verify_store
from dancedata.synthetic import synthesise_motion, synthesise_song
from tests.commands import as_json, run
from tests.messages import raises_message

RATE, SECONDS, FRAME_S = 24_000, 14, 1 / 60
#: Clip, and milliseconds by which the music of its file is late: the second at frame 0.
PLANTED = {
    "gPO_sBM_cAll_d10_mPO4_ch03": 40, "gLO_sBM_cAll_d13_mLO2_ch01": 80, "gHO_sFM_cAll_d19_mHO3_ch01": 0,
    "gKR_sBM_cAll_d28_mKR5_ch03": 200,
}  # fmt: skip
#: A dance to a song whose file is another one, at another tempo.
WRONG = "gWA_sFM_cAll_d26_mWA3_ch01"
RECIPE: dict[str, Any] = {
    "recipe": 1, "name": "late", "dataset": {"folder": {}}, "windows": {"length_s": 5, "stride_s": 1},
    "motion": {"joints": {}}, "audio": {},
}  # fmt: skip


def write_motion(path: Path, clip: str) -> None:
    motion = synthesise_motion(clip, n_frames=60 * SECONDS)[0]
    np.savez(path, poses=motion.rotations.reshape(-1, 72), trans=motion.translation)


def write_song(path: Path, music: str, ms: int = 0) -> None:
    samples = synthesise_song(music, length_s=SECONDS + 1, sample_rate=RATE, n_channels=1).pcm[:, 0]
    soundfile.write(path, np.concatenate([np.zeros(ms * RATE // 1000, np.int16), samples]), RATE, subtype="PCM_16")


def write_manifest(folder: Path, start: Callable[[str], object]) -> None:
    rows = [[f"{clip}.npz", f"{clip.split('_')[4]}.wav", start(clip), "60", "y", "m"] for clip in (*PLANTED, WRONG)]
    with (folder / "manifest.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["motion", "audio", "audio_start_s", "fps", "up", "unit"], *rows])


@pytest.fixture(scope="module")
def planted(once: Callable[..., Path]) -> Path:
    def fill(folder: Path) -> None:
        for clip, ms in {**PLANTED, WRONG: 0}.items():
            write_motion(folder / f"{clip}.npz", clip)
            write_song(folder / f"{clip.split('_')[4]}.wav", "BR0" if clip == WRONG else clip.split("_m")[1][:3], ms)
        write_manifest(folder, lambda clip: "")

    return once("planted", fill)


@pytest.fixture
def auto(planted: Path, tmp_path: Path) -> Path:
    source = tmp_path / "source"
    shutil.copytree(planted, source)
    write_manifest(source, lambda clip: "auto")
    return source


def align(source: Path, cache: Path, **options: Any) -> Alignment:
    return room.align(source, **{"dataset": "folder", "cache": cache, "progress": False} | options)


def test_planted_offsets_are_found_and_a_wrong_song_is_unknown(planted: Path, cache: Path) -> None:
    found = align(planted, cache)
    rows = {row.name: row for row in found.rows}
    assert set(rows) == {*PLANTED, WRONG}
    for clip, ms in PLANTED.items():
        assert rows[clip].offset.unknown == ""
        assert rows[clip].offset.offset_s == pytest.approx(ms / 1000, abs=FRAME_S)
    assert rows[WRONG].offset.unknown == "p"
    assert len(found.known) == 4
    assert found.rejects == ()
    assert "4 of 5 offsets known" in str(found)
    assert align(planted, cache, dataset=None, recipe=RECIPE).rows == found.rows
    assert "unknown, p: songs at other tempos fit as well" in str(found)


def test_a_manifest_with_the_seconds_of_the_table_has_no_offset_left(planted, cache, tmp_path):
    table = tmp_path / "offsets.csv"
    run("check", "--offsets", planted, "--recipe", "folder", "--cache", cache, "--out", table, "-q")
    rows = {row["id"]: row for row in csv.DictReader(table.read_text().splitlines())}
    assert rows[WRONG]["audio_start_s"] == ""
    source = tmp_path / "source"
    shutil.copytree(planted, source)
    write_manifest(source, lambda clip: rows[clip]["audio_start_s"])
    for row in align(source, cache).known:
        assert row.offset.offset_s == pytest.approx(0, abs=0.002)
    with raises_message(UsageError, "exists", where="offsets.csv"):
        align(planted, cache, out=table)


def test_negative_offsets_are_numbers_in_the_table() -> None:
    offset = Offset(offset_s=-0.08, width_s=0.004, p=0.01, beat_s=0.5)
    clip = ClipRef("=a", Path("a.npz"), Path("a.wav"), "train", "-song")
    found = Alignment(Path("source"), "folder", "clip", Search(), (Aligned("=a", (clip,), offset),))
    (row,) = csv.DictReader(found.to_csv().splitlines())
    assert float(row["offset_s"]) == -0.08
    assert (row["id"], row["music"], row["audio_start_s"]) == ("'=a", "'-song", "-2/25")


def test_json_has_all_numbers(planted: Path, cache: Path) -> None:
    document = as_json("check", "--offsets", planted, "--recipe", "folder", "--cache", cache)
    assert document["known"] == 4
    unit = next(unit for unit in document["units"] if unit["name"] == "gLO_sBM_cAll_d13_mLO2_ch01")
    assert unit["curves"].keys() == {"body", "hands", "root", "steps"}
    assert unit["clips"] == [
        {"id": unit["name"], "music": "mLO2", "audio_start_s": unit["clips"][0]["audio_start_s"]}
    ]
    assert float(Fraction(unit["clips"][0]["audio_start_s"])) == pytest.approx(0.08, abs=FRAME_S)
    assert document["shared_s"] is None  # of four
    assert {"onsets", "rhythm", "offsets"} <= {entry.stage for entry in entries(cache)}
    other = align(planted, dataset="folder", cache=cache, seed=1, progress=False).to_json()
    assert [u["offset_s"] for u in other["units"]] == [u["offset_s"] for u in document["units"]]
    assert [u["width_s"] for u in other["units"]] != [u["width_s"] for u in document["units"]]


def test_parts_of_a_file_are_one_recording(planted: Path, tmp_path: Path, cache: Path) -> None:
    clip = "gPO_sBM_cAll_d10_mPO4_ch03"
    for name in (f"{clip}.npz", "mPO4.wav", "mLO2.wav"):
        shutil.copy(planted / name, tmp_path)
    lines = ["id,motion,audio,start_s,end_s,fps,up,unit"]
    lines += [f"p{k},{clip}.npz,mPO4.wav,{a},{b},60,y,m" for k, (a, b) in enumerate([(0, 5), (5, 9), (9, 14)])]
    (tmp_path / "manifest.csv").write_text("\n".join(lines))
    together = align(tmp_path, cache)
    (row,) = together.rows
    assert [c.id for c in row.clips] == ["p0", "p1", "p2"]
    assert row.name == f"{clip}.npz"
    assert row.offset.offset_s == pytest.approx(0.04, abs=FRAME_S)
    # As the manifest has it: at frame 0 of the file.
    assert len({row.start_of(c) for c in row.clips}) == 1
    (of_song,) = align(tmp_path, cache, by="song").rows
    assert of_song.name == "mPO4"
    assert of_song.offset.offset_s == row.offset.offset_s
    assert [r.offset.unknown for r in align(tmp_path, cache, by="clip").rows] == ["short"] * 3


def test_auto_is_found_recorded_and_the_rest_rejected(auto: Path, tmp_path: Path, cache: Path) -> None:
    built = dancedata.build(RECIPE, auto, tmp_path / "out", jobs=1, cache=cache, progress=False)
    store = built.open()
    assert verify_store(tmp_path / "out") == []
    offsets = {row.name: row for row in align(auto, cache).rows}
    assert {clip.id for clip in store} == set(PLANTED)
    for clip in store:
        assert clip.audio_start == offsets[clip.id].start_of(offsets[clip.id].clips[0])
        assert float(clip.audio_start) == pytest.approx(PLANTED[clip.id] / 1000, abs=FRAME_S)
        assert clip.audio_start_by.startswith("align 1: ")
        assert ", p 0.0" in clip.audio_start_by
        assert clip.audio_start_by.endswith("of 1 clip")
    assert built.left_out["unknown_offset"] == 1
    (reject,) = [row for row in store.rejects if row["reason"] == "unknown_offset"]
    assert reject["clip"] == WRONG
    assert reject["numbers"]["p"] > 0.02
    assert "write the seconds" in reject["detail"]
    assert "Music: audio_start_s auto was found for 4 of 5 recordings." in store.info["source"]["notes"]
    again = dancedata.build(RECIPE, auto, tmp_path / "out", jobs=1, cache=cache, progress=False)
    assert not again.built


def test_a_strict_build_stops_at_an_unknown_offset(auto: Path, tmp_path: Path, cache: Path) -> None:
    with raises_message(DataError, "unknown_offset", reason="unknown_offset"):
        dancedata.build(RECIPE, auto, tmp_path / "out", jobs=1, cache=cache, strict=True, progress=False)
    assert not (tmp_path / "out").exists()


def test_plan_check_and_parts_know_auto(auto, tmp_path, cache, monkeypatch):
    planned = make_plan(RECIPE, auto, cache=cache, progress=False)
    assert planned.to_json()["left_out"] == {"unknown_offset": 1}
    built = dancedata.build(RECIPE, auto, tmp_path / "out", jobs=1, cache=cache, progress=False)
    assert planned.to_json()["splits"]["train"]["windows"] == built.counts["train"]["windows"]
    notes = [problem.message for problem in dancedata.check(auto, dataset="folder", progress=False)]
    assert "Music: audio_start_s leaves the offset of 5 clips to the build (auto)." in notes
    parts = [build_part(load_recipe(RECIPE), auto, Part(k, 2), cache=tmp_path / "cache") for k in (1, 2)]
    assert sum(part.clips for part in parts) == 5
    monkeypatch.setattr(rhythm, "find_offset", None)  # all offsets are in the cache
    whole = dancedata.build(RECIPE, auto, tmp_path / "of parts", jobs=1, cache=tmp_path / "cache", progress=False)
    assert comparison.diff(whole.path, built.path) == []


def test_auto_needs_music_and_no_other_word_is_allowed(tmp_path: Path) -> None:
    (tmp_path / "a.npz").touch()
    for row in ("a.npz,,auto", "a.npz,a.wav,automatic"):
        (tmp_path / "manifest.csv").write_text(f"motion,audio,audio_start_s\n{row}\n")
        with raises_message(SourceError, "audio_start_s", where="manifest.csv, line 2"):
            dancedata.check(tmp_path, dataset="folder", progress=False)


def test_broken_files_are_named(planted: Path, tmp_path: Path, cache: Path) -> None:
    shutil.copytree(planted, tmp_path / "source")
    (tmp_path / "source" / "mPO4.wav").write_bytes(b"no music")
    (tmp_path / "source" / "gLO_sBM_cAll_d13_mLO2_ch01.npz").write_bytes(b"no motion")
    found = align(tmp_path / "source", cache)
    assert {(r.clip.split("_m")[1][:3], r.reason) for r in found.rejects} == {
        ("PO4", "broken_audio"), ("LO2", "broken_file"),
    }  # fmt: skip
    assert len(found.rows) == 3
    assert "left out: broken_audio: 1 (gPO_sBM_cAll_d10_mPO4_ch03)" in str(found)
    write_manifest(tmp_path / "source", lambda clip: "auto")
    built = dancedata.build(
        {**RECIPE, "audio": {}}, tmp_path / "source", tmp_path / "out", jobs=1, cache=cache, progress=False
    )
    assert built.left_out == {"broken_audio": 1, "broken_file": 1, "unknown_offset": 1}


def test_clips_without_music_and_missing_files_are_counted(planted: Path, tmp_path: Path, cache: Path) -> None:
    clip = "gPO_sBM_cAll_d10_mPO4_ch03"
    shutil.copy(planted / f"{clip}.npz", tmp_path)
    recipe = {**RECIPE, "dataset": {"folder": {"music": "optional", "fps": 60, "up": "y", "unit": "m"}}}
    (tmp_path / "manifest.csv").write_text(f"motion\n{clip}.npz\nlost.npz\n")
    found = align(tmp_path, cache, dataset=None, recipe=recipe)
    assert found.rows == ()
    assert [(reject.reason, reject.clip) for reject in found.rejects] == [
        ("missing_motion", "lost"), ("missing_music", clip),
    ]  # fmt: skip
    assert "0 of 0 offsets known" in str(found)
    assert "left out: missing_music: 1" in str(found)


def summary(*offsets_ms: float, beat_s: float = 0.5, rivals: int = 0) -> Alignment:
    rows = (
        Aligned(f"r{k}", (), Offset(ms / 1000, 0.004, 0.003, rivals, 0.4, beat_s)) for k, ms in enumerate(offsets_ms)
    )
    return Alignment(Path("source"), "folder", "recording", Search(), tuple(rows))


def test_what_all_offsets_share_is_named() -> None:
    found = summary(28, 30, 30, 33, 35, rivals=1)
    assert found.shared_s == (0.030, 0.030, 0.033)
    shared, rivals = found.notes()
    assert shared.startswith("median of 5 offsets +30 ms (quartiles +30 to +33 ms): what all share is a delay")
    assert "fit too for r0, r1, r2, r3, r4" in rivals
    assert summary(28, 30, 30, 33).notes() == []  # too few


def test_offsets_without_a_common_phase_of_the_beat_are_named() -> None:
    """Against the sum of unit vectors."""
    scattered = summary(-200, -100, 0, 100, 200, -150, 50, 210)
    phases = np.exp(2j * np.pi * np.array([-0.4, -0.2, 0, 0.2, 0.4, -0.3, 0.1, 0.42]))
    assert scattered.scatter_p == pytest.approx(np.exp(-(abs(phases.sum()) ** 2) / 8))
    assert any("may be paired wrongly" in note for note in scattered.notes())
    together = summary(-200, -205, 210, 203, 207, -198)  # around half a beat
    assert together.scatter_p is not None
    assert together.scatter_p < 0.05


def test_wrong_arguments(planted: Path, tmp_path: Path, cache: Path) -> None:
    for options in (
        {"by": "recordings"}, {"window_s": 0.0}, {"level": 0.0}, {"out": tmp_path / "a.txt"},
        {"recipe": "aist++"}, {"overrides": ["fps=60"]},
    ):  # fmt: skip
        with raises_message(UsageError, "choose|overrides|range|reader|recording"):
            align(planted, cache, **options)  # type: ignore[arg-type]
    (tmp_path / "dataset.json").touch()
    with raises_message(UsageError, "compare"):
        align(tmp_path, cache)


def test_real_dances_follow_what_is_planted(shared: Path, tmp_path: Path, cache: Path) -> None:
    """AIST++ motion with a song of its tempo, as its own may not be passed on: 0 is where that is found."""
    real = shared / "realdata" / "aistpp" / "motions"
    clips = sorted(path.stem for path in real.glob("gBR*.pkl"))
    for folder in ("motions", "wavs", "other"):
        (tmp_path / folder).mkdir()
    for clip in clips:
        shutil.copy(real / f"{clip}.pkl", tmp_path / "motions")
    for other in ("BR0", "HO3", "WA3"):
        write_song(tmp_path / "other" / f"{other}.wav", other)
    known, places = 0, {}
    for ms in (0, 80):
        for music in {clip.split("_")[4] for clip in clips}:
            write_song(tmp_path / "wavs" / f"{music}.wav", music[1:], 430 + ms)
        found = room.align(tmp_path, dataset=AistPP.name, cache=cache, progress=False)
        places[ms] = {row.name: row.offset for row in found.rows}
        known += len(found.known)
    assert known >= 2
    for ms, offsets in places.items():
        for clip, offset in offsets.items():
            start = places[0][clip]
            if not offset.unknown and not start.unknown:
                assert offset.offset_s - start.offset_s == pytest.approx(ms / 1000, abs=FRAME_S)


# ---- onset strength: rows per second

ROWS = 240


def bursts(rate: int, times: tuple[float, ...], seconds: float = 3.0) -> AudioSignal:
    """Noise that begins suddenly and decays, over a noise floor."""
    rng = np.random.default_rng(0)
    samples = 1e-4 * rng.standard_normal(round(seconds * rate))
    t = np.arange(round(0.3 * rate)) / rate
    for time in times:
        burst = 0.4 * rng.standard_normal(len(t)) * np.exp(-t / 0.05)
        rest = samples[round(time * rate) :][: len(t)]
        rest += burst[: len(rest)]
    return AudioSignal(samples.astype(np.float32), rate)


@pytest.mark.parametrize("rate", [22_050, 44_100, 48_000])
def test_an_onset_is_within_a_row_of_its_peak(rate: int) -> None:
    times = (0.5, 1.2345, 2.0)
    strength = onset_strength(bursts(rate, times))
    for time in times:
        near = slice(round(time * ROWS) - 30, round(time * ROWS) + 30)
        peaks = near.start + strength[near].argmax(axis=0)
        assert np.abs(peaks / ROWS - time).max() < 0.0045


def test_it_agrees_with_a_plain_loop() -> None:
    signal = bursts(8_000, (0.3,), seconds=0.5)
    samples = signal.samples.astype(np.float64)
    half, early = round(0.012 * 8_000), round(0.005 * 8_000)
    power = np.zeros((120, 3))
    frequencies = np.arange(129) * 8_000 / 256
    for row in range(120):
        centre = row * 8_000 // 240 - early
        piece = np.array([samples[i] if 0 <= i < len(samples) else 0 for i in range(centre - half, centre + half)])
        window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(2 * half) / (2 * half))
        energy = np.abs(np.fft.fft(piece * window, 256)[:129]) ** 2
        for band in range(3):
            inside = (frequencies >= BANDS_HZ[band] - 16) & (frequencies < BANDS_HZ[band + 1] - 16)
            power[row, band] = energy[inside].sum()
    level = 10 * np.log10(power + 1e-4 * power.max(axis=0) + 1e-20)
    expected = np.array([
        np.maximum(level[min(row + 2, 119)] - level[max(row - 2, 0)], 0) for row in range(120)
    ])  # fmt: skip
    np.testing.assert_allclose(onset_strength(signal), expected, atol=1e-6)


def test_silence_and_signals_shorter_than_a_row_have_none() -> None:
    assert not onset_strength(AudioSignal(np.zeros(4_000, np.float32), 8_000)).any()
    assert onset_strength(AudioSignal(np.ones(10, np.float32), 8_000)).shape == (0, 3)
