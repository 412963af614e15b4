"""Columns of a manifest: parts of files, offsets of music, joint maps, free columns, terms of clips."""

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.audio_signal import wav_bytes
from dancedata.core.clip import Scan
from dancedata.core.errors import DataError, SourceError
from dancedata.datasets.folder import Folder
from dancedata.datasets.motorica.motion import write_recording
from dancedata.store import Store, verify_store
from dancedata.synthetic import synthesise_motion, synthesise_song
from tests.commands import as_json, run
from tests.messages import raises_message

N = 240
RATE = "30000/1001"
HEAD = {"recipe": 1, "name": "own", "fps": 30, "windows": {"length_s": 1, "stride_s": 0.5}, "motion": {"edge151": {}}}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A motion of 8 s at 30000/1001 frames per second, a BVH, and a song."""
    folder = tmp_path_factory.mktemp("files")
    motion = synthesise_motion("gBR_sBM_cAll_d04_mBR0_ch01", n_frames=N)[0]
    np.savez(folder / "a.npz", poses=motion.rotations.reshape(N, 72), trans=motion.translation)
    write_recording(folder / "b.bvh", 0, dance_s=2)
    song = synthesise_song("mBR0", length_s=9, sample_rate=16_000, n_channels=1)
    (folder / "a.wav").write_bytes(wav_bytes(song.pcm, 16_000))
    return folder


@pytest.fixture
def source(files: Path, tmp_path: Path) -> Path:
    folder = tmp_path / "source"
    folder.mkdir()
    for file in files.iterdir():
        (folder / file.name).symlink_to(file)
    for name in ("a.npz", "b.bvh", "a.wav"):
        (folder / name).unlink()
        (folder / name).write_bytes((files / name).read_bytes())
    return folder


def scan(source: Path, text: str, name: str = "manifest.csv", **keys: Any) -> Scan:
    (source / name).write_text(text, encoding="utf-8")
    return Folder(**{"unit": "m", "up": "y", "fps": RATE, "music": "optional", **keys}).scan(source)


def built_in(folder: Path, source: Path) -> Store:
    recipe = {**HEAD, "dataset": {"folder": {"unit": "m", "up": "y", "fps": 30, "music": "optional"}}}
    options: dict[str, Any] = {"cache": folder / "cache", "jobs": 1, "progress": False, "overwrite": True}
    return dancedata.build(recipe, source, folder / "out", **options).open()


def test_parts_are_whole_frames_and_the_music_follows(source: Path) -> None:
    text = "id,motion,audio,start_s,end_s,audio_start_s\none,a.npz,a.wav,,2.5,1/3\ntwo,a.npz,a.wav,2.5,,-0.08\n"
    scanned = scan(source, f"{text}all,a.npz,a.wav,,,\n")
    whole, one, two = scanned.clips
    assert (whole.audio_start, whole.source_start, whole.source_end) == (0, None, None)
    # 2.5 s are 74.93 frames: frame 75, at 2.5025 s exactly.
    border = 75 * Fraction(1001, 30000)
    assert (one.source_start, one.source_end, one.audio_start) == (None, border, Fraction(1, 3))
    assert (two.source_start, two.source_end, two.audio_start) == (border, None, border - Fraction(2, 25))
    reader = Folder(unit="m", up="y", fps=RATE)
    motions = [reader.load(clip) for clip in scanned.clips]
    assert [motion.n_frames for motion in motions] == [N, 75, N - 75]
    np.testing.assert_array_equal(motions[1].rotations, motions[0].rotations[:75])
    np.testing.assert_array_equal(motions[2].rotations, motions[0].rotations[75:])


@pytest.mark.parametrize(
    "row",
    [
        "a.wav,late,,", "a.wav,nan,,", "a.wav,1e9,,", f"a.wav,{'1' * 50},,", ",1,,", "a.wav,,-1,", "a.wav,,one,",
        "a.wav,,2,2", "a.wav,,,0", "a.wav,,3,1/2", "a.wav,,1/0,", ",,1,",
    ],
)  # fmt: skip
def test_wrong_seconds_and_two_rows_without_ids(source: Path, row: str) -> None:
    with raises_message(SourceError, "empty|unique", where="source/manifest.csv, line 3"):
        scan(source, f"motion,audio,audio_start_s,start_s,end_s\na.npz,,,,\na.npz,{row}\n")


@pytest.mark.parametrize("part", ["9,", ",9", "2,2.01"])
def test_parts_that_the_file_does_not_have(source: Path, part: str) -> None:
    (clip,) = scan(source, f"motion,start_s,end_s\na.npz,{part}\n").clips
    with raises_message(DataError, "start_s", where="source/a.npz"):
        Folder(unit="m", up="y", fps=RATE).load(clip)


def test_another_part_is_other_motion(source: Path, tmp_path: Path) -> None:
    """With one cache: the cache key of a clip has its part."""
    for end, n in ((4, 120), (5, 150)):
        (source / "manifest.csv").write_text(f"id,motion,start_s,end_s\nc,a.npz,,{end}\n", encoding="utf-8")
        with built_in(tmp_path, source) as store:
            assert [clip.n_frames for clip in store] == [n]


def test_a_joint_map_of_one_row(source: Path) -> None:
    text = (source / "b.bvh").read_text().replace("LeftUpLeg", "Bone7")
    (source / "c.bvh").write_text(text)
    (source / "maps").mkdir()
    (source / "maps" / "mine.json").write_text(
        '\ufeff{"about": "", "joints": {"left_hip": "Bone7"}}'
    )  # as Notepad does
    row = {"motion": "c.bvh", "id": "inline", "joint_map": {"left_hip": "Bone7"}}
    other = {"motion": "c.bvh", "id": "file", "joint_map": "maps/mine.json"}
    plain = {"motion": "b.bvh", "id": "plain"}
    lines = "".join(f"{json.dumps(line)}\n" for line in (row, other, plain))
    scanned = scan(source, lines, "manifest.jsonl")
    reader = Folder(unit="cm", up="y")
    motions = [reader.load(clip) for clip in scanned.clips]
    assert len({clip.declared for clip in scanned.clips[:2]}) == 1, "its content, not its path, is in the key"
    for motion in motions[1:]:
        np.testing.assert_array_equal(motion.rotations, motions[0].rotations)
    csv = 'motion,joint_map\nc.bvh,"{""left_hip"": ""Bone7""}"\n'
    (source / "manifest.jsonl").unlink()
    assert scan(source, csv).clips[0].declared == scanned.clips[0].declared


@pytest.mark.parametrize(
    "row",
    [
        {"motion": "a.npz", "joint_map": {"left_hip": "x"}}, {"motion": "b.bvh", "joint_map": {"left_hipp": "x"}},
        {"motion": "b.bvh", "joint_map": {"left_hip": ["x"]}}, {"motion": "b.bvh", "joint_map": {}},
        {"motion": "b.bvh", "joint_map": "{no json"}, {"motion": "b.bvh", "joint_map": "gone.json"},
        {"motion": "b.bvh", "joint_map": "../outside.json"}, {"motion": "b.bvh", "joint_map": 3},
    ],
)  # fmt: skip
def test_wrong_joint_maps(source: Path, row: dict[str, Any]) -> None:
    with raises_message(SourceError, "joint_map", where="source/manifest.jsonl, line 1"):
        scan(source, f"{json.dumps(row)}\n", "manifest.jsonl")


def test_free_columns_have_the_type_of_all_their_values(source: Path) -> None:
    text = (
        "id;motion;x/level;x/share;x/teacher;x/indoors;x/tags;x/beats;x/code\n"
        'a;a.npz;3;0.5;anna;true;["a","b"];[1,2.5];007\n'
        "b;b.bvh;-4;2;;false;[];;12\n"
        "c;a.npz;;;5;;;;\n"
    )
    columns = {clip.id: dict(clip.columns) for clip in scan(source, text).clips}
    assert columns["a"] == {
        "level": 3, "share": 0.5, "teacher": "anna", "indoors": True, "tags": ("a", "b"), "beats": (1.0, 2.5),
        "code": "007",
    }  # fmt: skip
    assert columns["b"] == {"level": -4, "share": 2.0, "indoors": False, "tags": (), "code": "12"}
    assert columns["c"] == {"teacher": "5"}
    assert isinstance(columns["b"]["share"], float)
    (source / "manifest.csv").unlink()
    rows = [  # of JSON Lines each value has its own
        {"id": "a", "motion": "a.npz", "x/level": 1, "x/name": "7", "x/list": [], "x/both": [1]},
        {"id": "b", "motion": "a.npz", "x/level": 2.5, "x/name": "", "x/list": ["t"], "x/both": [0.5]},
    ]
    scanned = scan(source, "".join(f"{json.dumps(row)}\n" for row in rows), "manifest.jsonl")
    assert [dict(clip.columns) for clip in scanned.clips] == [
        {"both": (1.0,), "level": 1.0, "list": (), "name": "7"}, {"both": (0.5,), "level": 2.5, "list": ("t",)},
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("x/a b", ["1"]), ("x/", ["1"]), ("level", ["1"]), ("x/v", [1, "one"]), ("x/v", [True, 1]),
        ("x/v", [{"a": 1}]), ("x/v", [[1, "a"]]), ("x/v", [[[1]]]), ("x/v", [2**70]), ("x/v", ["a\tb"]),
        ("x/v", [["a"], [1]]), ("x/v", [[1], 1]), ("x/v", [["x"] * 5000]),
    ],
)  # fmt: skip
def test_wrong_free_columns(source: Path, name: str, values: list[Any]) -> None:
    lines = [json.dumps({"id": f"c{k}", "motion": "a.npz", name: value}) for k, value in enumerate(values)]
    with raises_message(SourceError, "correct|level"):
        scan(source, "\n".join(lines), "manifest.jsonl")


def test_wrong_lists_of_csv(source: Path) -> None:
    with raises_message(SourceError, "correct", where="source/manifest.csv, line 3"):
        scan(source, 'id,motion,x/v\na,a.npz,[1]\nb,a.npz,"[1,"\n')
    columns = ",".join(f"x/c{k}" for k in range(101))
    with raises_message(SourceError, "correct", where="source/manifest.csv, line 1"):
        scan(source, f"motion,{columns}\na.npz{',' * 101}\n")


def test_numbers_of_genres(source: Path, tmp_path: Path) -> None:
    head, shas = "id,motion,genre,genre_id\n", []
    assert scan(source, f"{head}a,a.npz,waltz,\n").genre_ids == {}
    for number in (7, 8):
        found = scan(source, f"{head}a,a.npz,waltz,{number}\nb,a.npz,waltz,\nc,a.npz,tango,0\nd,a.npz,,\n")
        assert found.genre_ids == {"waltz": number, "tango": 0}
        with built_in(tmp_path, source) as store:
            assert store.info["genre_ids"] == found.genre_ids
            shas.append(store.info["source"]["sha256"])
    assert shas[0] != shas[1], "another number is another dataset"


@pytest.mark.parametrize(
    "rows",
    [["waltz,one"], ["waltz,-1"], ["waltz,2.0"], [",1"], ["waltz,1", "waltz,2"], ["waltz,1", "tango,1"],
     ["waltz,1", "tango,"]],
)  # fmt: skip
def test_wrong_numbers_of_genres(source: Path, rows: list[str]) -> None:
    with raises_message(SourceError, "genre_id"):
        scan(source, "id,motion,genre,genre_id\n" + "".join(f"c{k},a.npz,{row}\n" for k, row in enumerate(rows)))


@pytest.fixture(scope="module")
def built(files: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two parts of one file, with music, free columns and terms, and mirrored copies."""
    folder = tmp_path_factory.mktemp("built")
    text = (
        "id,motion,audio,split,audio_start_s,start_s,end_s,licence,citation,x/level,x/tags\n"
        'one,a.npz,a.wav,train,0.25,,4,CC BY 4.0,"Anna, 2026",3,"[""turn""]"\n'
        "two,a.npz,a.wav,test,0.25,4,,all rights reserved,,4,[]\n"
    )
    (files / "manifest.csv").write_text(text, encoding="utf-8")
    recipe = {
        **HEAD, "dataset": {"folder": {"unit": "m", "up": "y", "fps": 30}}, "audio": {"librosa35": {}},
        "augment": {"mirror": True},
    }  # fmt: skip
    dancedata.build(recipe, files, folder / "out", cache=folder / "cache", jobs=1, progress=False)
    (files / "manifest.csv").unlink()
    return folder / "out"


def test_parts_and_columns_of_a_dataset(built: Path, files: Path) -> None:
    assert [p for p in verify_store(built) if p.severity == "error" and "song" not in str(p)] == []
    with dancedata.open(built) as store:
        one, copy, two = (store[name] for name in ("one", "one__mirror", "two"))
        assert (one.n_frames, two.n_frames) == (120, 120)
        assert (one.audio_start, two.audio_start, two.source_start) == (Fraction(1, 4), Fraction(17, 4), 4)
        assert dict(one.columns) == dict(copy.columns) == {"level": 3, "tags": ("turn",)}
        assert dict(two.columns) == {"level": 4}, "an empty list is none"
        assert [store.licences[clip.licence].text for clip in (one, copy, two)] == [
            "CC BY 4.0", "CC BY 4.0", "all rights reserved",
        ]  # fmt: skip
        # Rows of one song from its first half row on: the parts begin at 7 and 4 s later.
        assert sorted(set(store._tables.spans["librosa35"].offset.tolist())) == [7, 7 + 120]


def test_terms_on_the_card_and_in_a_page(built: Path, files: Path, tmp_path: Path) -> None:
    card = (built / "README.md").read_text(encoding="utf-8")
    assert "- 1 clip: CC BY 4.0; cite: Anna, 2026; may be passed on\n" in card
    assert "- 1 clip: all rights reserved; may not be passed on\n" in card
    found = as_json("report", built, "--out", tmp_path / "report.html", "--clips", "none")["report"]
    assert [column["name"] for column in found["columns"]] == ["x/level", "x/tags"]
    assert "1 clip: all rights reserved; may not be passed on" in found["about"]["licences"]
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "x/level: int, 2 of 2 clips, 3 to 4, median 3.5" in page
    assert "all rights reserved; may not be passed on" in page
    options = ["--out", tmp_path / "music.html", "--music", files]
    refused = run("report", built, *options, code=2).stderr
    assert "1 clip: all rights reserved; may not be passed on" in refused
    assert not (tmp_path / "music.html").exists()
