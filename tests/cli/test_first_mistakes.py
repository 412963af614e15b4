"""Common first mistakes of users, and their error messages."""

import json
import shlex
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

import dancedata
from dancedata.audio.librosa35.feature import Librosa35
from dancedata.core.clip import Reject
from dancedata.core.errors import DataError, nearest
from dancedata.core.grid import FrameGrid
from dancedata.core.left_out import left_out_lines
from dancedata.core.registry import DATASETS
from dancedata.core.rejects import BY_CHOICE
from dancedata.music.signal import load_audio
from dancedata.store import Store
from tests.commands import run
from tests.conftest import Once


@pytest.fixture
def larger(once: Once, tmp_path: Path) -> Path:
    """Eight clips to two songs, all in one split by the recipe of the tests below."""
    from dancedata.synthetic import write_synthetic

    made = once("larger", lambda folder: write_synthetic(folder / "source", songs=2, clips_per_song=4, clip_s=6))
    return shutil.copytree(made / "source", tmp_path / "larger")


ALL = ("--set", "dataset.aist++.split=all")


def test_a_build_without_music_names_the_folders_and_the_fix(larger: Path, out: Path):
    shutil.rmtree(larger / "wavs")
    output = run("build", "aist++", larger, "--out", out, *ALL, code=1).stderr
    lines = output.splitlines()
    (counts,) = [number for number, line in enumerate(lines) if line == "  - missing_music: 8 clips"]
    assert lines[counts + 1 : counts + 3] == [
        "    song mBR0 is missing: 4 clips",
        "    song mHO3 is missing: 4 clips",
    ]
    notes = DATASETS.get("aist++")(split="all").scan(larger).notes
    assert any("Searched wavs/" in note and "AIST Dance Video Database" in note for note in notes)
    assert all(f"  - {note}" in lines for note in notes)
    assert f"dancedata check {larger}" in lines[-1]
    assert not out.exists()


def test_important_problems_come_first_and_missing_motion_last(larger: Path, out: Path, rejects: Any):
    (larger / "wavs" / "mHO3.wav").unlink()
    listed = larger / "splits" / "crossmodal_train.txt"
    names = [f"gBR_sBM_cAll_d04_mBR{n % 6}_ch{n:02d}" for n in range(10, 99)]
    listed.write_text(listed.read_text() + "\n".join(names))
    (larger / "ignore_list.txt").write_text("gHO_sBM_cAll_d19_mHO3_ch03\n")
    (larger / "wavs" / "notes.txt").write_text("mine")
    (larger / "motions" / "gBR_sBM_cAll_d04_mBR0_ch01.pkl").write_bytes(b"")
    lines = run("build", "aist++", larger, "--out", out).stdout.splitlines()
    reasons = [line.split(":")[0].strip() for line in lines if line.startswith("    ") and line[4] != " "]
    assert reasons == ["missing_music", "broken_file", "ignored", "extra_file", "missing_motion"]
    assert "      song mHO3 is missing: 3 clips" in lines
    rows = [row for row in rejects(out) if row["reason"] == "missing_music"]
    assert {row["music"] for row in rows} == {"mHO3"}


def test_many_songs_are_summed_up():
    assert left_out_lines([Reject("short_field", "a")]) == ["short_field: 1 window (a)"]
    rejects = [Reject("missing_music", "a", music="blue"), Reject("missing_music", "b")]
    lines = ["missing_music: 2 clips", "  song blue is missing: 1 clip", "  no song is named: 1 clip (b)"]
    assert left_out_lines(rejects) == lines
    songs = [f"m{genre}{n}" for genre in ("BR", "HO") for n in range(6)]
    rejects = [Reject("missing_music", f"c{k}", music=song) for song in songs for k in range(int(song[-1]) + 1)]
    assert left_out_lines(rejects) == [
        "missing_music: 42 clips", "  song mBR5 is missing: 6 clips", "  song mHO5 is missing: 6 clips",
        "  song mBR4 is missing: 5 clips", "  9 songs more: 25 clips (mHO4, mBR3, mHO3 and 6 more)",
    ]  # fmt: skip


def test_audio_features_of_clips_without_music(larger: Path, out: Path):
    shutil.rmtree(larger / "wavs")
    without = [*ALL, "--set", "dataset.aist++.music=optional"]
    for args in (["--dry-run"], ["--out", out]):
        output = run("build", "aist++", larger, *args, *without, "--quiet", code=1).stderr
        assert "--set 'audio={}'; or leave these clips out: --set dataset.aist++.music=required" in output
    run("build", "aist++", larger, "--out", out, *without, "--set", "audio={}")


def test_the_command_that_lists_every_file_can_be_copied(larger: Path, tmp_path: Path):
    source = tmp_path / "my dances"
    shutil.move(larger, source)
    shutil.rmtree(source / "wavs")
    last = run("build", "--dry-run", "aist++", source, *ALL, code=1).stderr.splitlines()[-1]
    assert last == f"See every file: dancedata check '{source}' --recipe aist++"
    assert run(*shlex.split(last)[4:], code=1).stdout.count("missing_music") >= 8


def test_plan_names_weights_that_a_build_will_miss(larger: Path, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("torch")
    monkeypatch.delenv("DANCEDATA_JUKEBOX", raising=False)
    output = run("build", "--dry-run", "aist++", larger, *ALL, "--set", "audio=jukebox").stdout
    assert "note: a build here ends with: jukebox: the folder of the weights is unknown" in output
    network = "audio={beats: {source: beat_this, weights: none.ckpt}}"
    output = run("build", "--dry-run", "aist++", larger, *ALL, "--set", network).stdout
    assert "beats: the file of the weights does not exist" in output
    assert "a build here ends" not in run("build", "--dry-run", "aist++", larger, *ALL).stdout


def test_values_that_are_not_recipes(tmp_path: Path, out: Path):
    (tmp_path / "captures").mkdir()
    for name, word in (("folder", "it is a dataset"), (tmp_path / "captures", "the folder after it")):
        assert word in run("build", name, tmp_path, "--out", out, code=2).stderr
    song = tmp_path / "song.wav"
    soundfile.write(song, np.zeros(22_050), 22_050)
    assert "dmeo" in run("features", song, "--like", tmp_path / "dmeo", "--out", out, code=2).stderr


@pytest.mark.parametrize("bpm", ["0", "-5", "nan", "inf"])
def test_an_invalid_tempo_names_the_option(tmp_path: Path, bpm: str):
    song = tmp_path / "song.wav"
    soundfile.write(song, np.zeros(22_050), 22_050)
    assert "--bpm above 0" in run("features", song, "--bpm", bpm, "--out", tmp_path / "out", code=2).stderr


def test_values_that_are_not_what_they_look_like(tmp_path: Path):
    (tmp_path / "empty.yaml").write_text("")
    assert "found an empty file" in run("build", "--dry-run", tmp_path / "empty.yaml", code=2).stderr
    wrong = run(
        "build", "--dry-run", "demo", "--set", "name=my/dances", "--set", "motion=[edge151, lodge139]", code=2
    ).stderr
    assert "'my/dances'" in wrong
    assert "{edge151: {}, lodge139: {}}" in wrong


def test_a_damaged_dataset_is_replaced_as_the_error_says(larger: Path, out: Path):
    build = ("build", "aist++", larger, "--out", out, *ALL)
    run(*build)
    with next(out.glob("*.h5")).open("ab") as file:
        file.write(b"x")
    assert "build the dataset again with --overwrite" in run(*build, code=1).stderr
    run(*build, "--overwrite")
    run("check", out)


def test_strict_names_the_song_too(larger: Path, out: Path):
    (larger / "wavs" / "mHO3.wav").unlink()
    output = run("build", "aist++", larger, "--out", out, *ALL, "--strict", code=1).stderr
    assert (
        "4 broken clips in a strict build\n  - missing_music: 4 clips\n    song mHO3 is missing: 4 clips\n" in output
    )
    assert "Layout: official AIST++" in output


@pytest.mark.parametrize(
    ("dataset", "folder", "song"), [("finedance", "music_wav", "001"), ("folder", "music", "smpl")]
)
def test_other_datasets_name_songs(tmp_path: Path, out: Path, dataset: str, folder: str, song: str):
    source = tmp_path / "source"
    DATASETS.get(dataset)().make_example(source)
    (source / "manifest.csv").unlink(missing_ok=True)
    shutil.rmtree(source / folder)
    output = run("build", _recipe(tmp_path, dataset), source, "--out", out, code=1).stderr
    assert f"song {song} is missing: 1 clip" in output
    assert all(note in output for note in DATASETS.get(dataset)().scan(source).notes)


def _recipe(folder: Path, dataset: str) -> Path:
    path = folder / "recipe.yaml"
    text = f"{{recipe: 1, name: own, dataset: {dataset}, windows: {{length_s: 2, stride_s: 1}}, motion: edge151"
    path.write_text(f"{text}, audio: librosa35}}")
    return path


@pytest.mark.parametrize("broken", ["no music", "every clip broken", "too short", "short music"])
def test_a_plan_of_nothing_ends_with_1_and_a_builds_words(larger: Path, out: Path, broken: str):
    longer: tuple[str, ...] = ()
    if broken == "no music":
        shutil.rmtree(larger / "wavs")
    elif broken == "every clip broken":
        for path in (larger / "motions").iterdir():
            path.write_bytes(path.read_bytes()[:1000])
    elif broken == "too short":
        longer = ("--set", "windows.length_s=60")
    else:
        for path in (larger / "wavs").iterdir():
            samples, rate = soundfile.read(path)
            soundfile.write(path, samples[: 2 * rate], rate)
    args = ("aist++", larger, *ALL, *longer)
    planned = run("build", "--dry-run", *args, "--quiet", code=1)
    built = run("build", *args, "--out", out, "--jobs", 1, "--quiet", code=1)
    assert planned.stderr == built.stderr
    assert "no clip is left to build from" in planned.stderr
    assert planned.stdout == ""


@pytest.mark.parametrize("how", [(), ("--dry-run",)])
def test_finedance_without_labels_mentions_that_they_are_optional(tmp_path: Path, how: tuple[str, ...]):
    source = tmp_path / "source"
    DATASETS.get("finedance")().make_example(source)
    shutil.rmtree(source / "label_json")
    output = run("build", "finedance", source, "--out", tmp_path / "out", *how, code=1).stderr
    assert "--set dataset.finedance.labels=optional" in output
    optional = ("--set", "dataset.finedance.labels=optional")
    assert "would leave out: missing_label" not in run("build", "--dry-run", "finedance", source, *optional).stdout


@pytest.mark.parametrize(
    ("args", "suggested"),
    [
        ("build edge", "aist++-edge-exact"),
        ("build AIST++", "aist++"),
        ("build lodge --dry-run", "aist++-lodge"),
        ("build aist++ --set stride_s=1", "windows.stride_s"),
        ("build aist++ --set mirror=true", "augment.mirror"),
        ("build aist++ --set contacts=height", "motion.edge151.contacts"),
        ("build aist++ --set dataset.split=all", "dataset.aist++.split"),
        ("build aist++ --set motion.contacts=height", "motion.edge151.contacts"),
        ("build aist++ --set audio.tightness=5", "audio.librosa35.tightness"),
        ("check . --recipe AISTPP", "aist++"),
        ("features x.wav --out x --field Librosa", "librosa35"),
    ],
)
def test_suggested_names(args: str, suggested: str, tmp_path: Path, monkeypatch: Any):
    monkeypatch.chdir(tmp_path)
    assert f"id you mean '{suggested}'?" in run(*args.split(), code=2).stderr


def test_the_closing_summary_is_short_and_names_the_next_steps(larger: Path, out: Path):
    args = ("build", "aist++", larger, "--out", out, "--jobs", 1)
    (larger / "ignore_list.txt").write_text("gBR_sBM_cAll_d04_mBR0_ch01\n")
    lines = run(*args).stdout.splitlines()
    assert lines[0].startswith(f"aist++: 7 clips, 21 windows in {out} (")
    assert lines[1:5] == [
        "  split  clips  windows  songs  minutes",
        "  train      4       12      1      0.4",
        "  val        1        3      1      0.1",
        "  test       2        6      1      0.2",
    ]
    assert lines[-2] == "checked: no song of train is in val or test; val and test share songs: mBR0"
    assert lines[-1] == f"next: dancedata view {out}; dancedata check {out}; details: dancedata info {out}"
    assert "ignored: 1 (" in "\n".join(lines)
    assert len(lines) <= 10
    again = run(*args)
    assert again.stdout.splitlines() == [
        f"nothing to do: {out} is this dataset already, from the same recipe and source (7 clips, 21 windows)",
        lines[-1],
    ]
    assert again.stderr == ""


def test_info_shows_all_that_the_summary_leaves_out(larger: Path, out: Path, rejects: Any):
    (larger / "wavs" / "mHO3.wav").rename(larger / "wavs" / "mho3.wav")
    summary = run("build", "aist++", larger, "--out", out, "--jobs", 1).stdout
    shown = run("info", out).stdout
    notes = DATASETS.get("aist++")().scan(larger).notes
    assert all(note in shown for note in notes)
    assert all(note not in summary for note in notes)
    for part in ("licence: ", "columns (contact", "no quality flags", "median of a clip"):
        assert part in shown
        assert part not in summary
    details = [row["detail"] for row in rejects(out) if row["reason"] in BY_CHOICE and row.get("detail")]
    assert details[0] in shown
    assert details[0] not in summary
    left_out = [line for line in summary.splitlines() if line.startswith("    ")]
    assert len(left_out) > 2
    assert all(line in shown for line in left_out)


def test_flags_are_summed_up_by_kind(built_copy: Path, monkeypatch: pytest.MonkeyPatch):
    from dancedata.building.describe import describe_built

    assert "flagged" not in describe_built(built_copy, ())
    flags = [
        {"clip": clip, "kind": kind, "joint": "root", "frame": 1, "value": 1.0, "unit": "m"}
        for clip, kind in (("a", "root_jump"), ("a", "root_jump"), ("b", "root_jump"), ("b", "fast_turn"))
    ]
    monkeypatch.setattr(Store, "quality", flags)
    output = describe_built(built_copy, ())
    assert "  flagged, not repaired: fast_turn in 1 clip, root_jump in 2 clips\n" in output


def about_of(folder: Path) -> dict[str, Any]:
    (path,) = folder.glob("*.json")
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def test_an_estimated_tempo_is_printed_stored_and_gives_the_same_rows(corpus: Path, tmp_path: Path):
    song = corpus / "wavs" / "mHO3.wav"
    output = run("features", song, "--out", tmp_path / "a").stdout
    about = about_of(tmp_path / "a")
    assert about["tempo_estimated"] is True
    assert about["start_bpm"] is None
    assert 60 < about["tempo_bpm"] < 240
    assert f"tempo estimated: {about['tempo_bpm']:.5g} BPM" in output
    plain = Librosa35(method="librosa")
    assert about["tempo_bpm"] == pytest.approx(plain.estimated_bpm(load_audio(song), FrameGrid.of(30)))
    run("features", song, "--out", tmp_path / "b", "--bpm", repr(about["tempo_bpm"]))
    rows = [(tmp_path / name / "mHO3.librosa35.npy").read_bytes() for name in "ab"]
    assert rows[0] == rows[1]
    assert np.array_equal(np.load(tmp_path / "a" / "mHO3.librosa35.npy"), dancedata.features(song, "librosa35"))
    assert about_of(tmp_path / "b")["tempo_estimated"] is False
    assert "tempo estimated" not in run("features", song, "--out", tmp_path / "b", "--bpm", 120).stdout


def test_the_tempo_of_every_window_is_stored(corpus: Path, tmp_path: Path):
    song = corpus / "wavs" / "mHO3.wav"
    output = run("features", song, "--out", tmp_path / "a", "--like", "aist++-edge-exact").stdout
    about = about_of(tmp_path / "a")
    tempos = about["tempo_bpm"]
    assert len(tempos) == about["shape"][0] > 1
    assert f"tempo of each window estimated: {min(tempos):.5g} to {max(tempos):.5g} BPM" in output
    rows = np.load(tmp_path / "a" / "mHO3.librosa35.npy")
    for tempo in set(tempos):
        run("features", song, "--out", tmp_path / "b", "--like", "aist++-edge-exact", "--bpm", repr(tempo))
        own = np.load(tmp_path / "b" / "mHO3.librosa35.npy")
        same = [k for k, t in enumerate(tempos) if t == tempo]
        assert np.array_equal(rows[same], own[same])


def test_features_that_fail_late_leave_nothing_of_their_own(corpus, tmp_path, monkeypatch):
    real, calls = Librosa35.extract, []

    def extract(self: Librosa35, *args: Any, **options: Any) -> Any:
        calls.append(1)
        if len(calls) == 2:
            raise DataError("no more", reason="broken_audio")
        return real(self, *args, **options)

    monkeypatch.setattr(Librosa35, "extract", extract)
    monkeypatch.setenv("DANCEDATA_CACHE", str(tmp_path / "cache"))
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    run("features", corpus / "wavs" / "mHO3.wav", corpus / "wavs" / "mBR0.wav", "--out", out, code=1)
    assert [path.name for path in out.iterdir()] == ["mine.txt"]


@pytest.mark.parametrize("what", ["wavs", "wavs/m*.wav"])
def test_a_folder_is_its_songs(corpus: Path, tmp_path: Path, what: str):
    run("features", corpus / what, "--out", tmp_path / "out")
    assert {p.name.split(".")[0] for p in (tmp_path / "out").iterdir()} == {
        p.stem for p in (corpus / "wavs").iterdir()
    }


@pytest.mark.parametrize("what", ["motions", "wavs/*.mp3", "motions/*.pkl"])
def test_a_folder_without_a_song(corpus: Path, tmp_path: Path, what: str):
    assert ".wav" in run("features", corpus / what, "--out", tmp_path / "out", code=1).stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["mBR0.librosa35.npy", "mBR0.librosa35.json"])
def test_features_replace_no_foreign_file(corpus: Path, tmp_path: Path, name: str):
    song, out = corpus / "wavs" / "mBR0.wav", tmp_path / "out"
    out.mkdir()
    (out / name).write_text('{"mine": 1}')
    output = run("features", song, "--out", out, code=2).output
    assert "mBR0.librosa35.npy" in output
    assert "move them away" in output
    assert [path.name for path in out.iterdir()] == [name]
    assert (out / name).read_text() == '{"mine": 1}'
    (out / name).unlink()
    run("features", song, "--out", out, "--bpm", 100)
    before = (out / "mBR0.librosa35.npy").read_bytes()
    run("features", song, "--out", out, "--bpm", 160)
    assert (out / "mBR0.librosa35.npy").read_bytes() != before
    (out / "mBR0.librosa35.npy").write_bytes(before)  # foreign numbers next to our description
    assert "move them away" in run("features", song, "--out", out, "--bpm", 120, code=2).output
    assert (out / "mBR0.librosa35.npy").read_bytes() == before


def test_a_name_that_looks_like_an_option_has_a_hint(tmp_path: Path):
    output = run("view", tmp_path, "-Ab_cdEf123_01", code=2).stderr
    assert "no such option: -A. A name that begins with - goes last, after --" in output
    assert "after --" not in run("view", tmp_path, "--fsp", "30", code=2).stderr
    assert "there is nothing to look at" in run("view", tmp_path, "--", "-Ab_cdEf123_01", code=1).stderr


def test_an_unknown_clip_of_many_has_the_nearest_names_and_their_number(tmp_path: Path):
    ids = [f"gBR_sBM_cAll_d{dancer:02d}_mBR{song}_ch01" for dancer in range(10) for song in range(5)]
    assert nearest("gBR_cAll_d07_mBR3_ch01", ids, "clip", tmp_path / "my data") == (
        "the nearest names: gBR_sBM_cAll_d07_mBR3_ch01, gBR_sBM_cAll_d09_mBR3_ch01, gBR_sBM_cAll_d08_mBR3_ch01; "
        f"50 clips in all: dancedata info '{tmp_path}/my data' --clips"
    )
    assert nearest("zzz", ids, "clip", tmp_path).count("gBR_") == 3
    assert nearest("gBR_d07_mBR3", ids[:12], "clip", tmp_path).endswith(f"known: {', '.join(ids[:12])}")
