"""The dataset reader folder: manifests, matching names, what the notes say, and builds from end to end."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dancedata.building.check import scan_folder
from dancedata.core.audio_signal import wav_bytes
from dancedata.core.clip import Scan
from dancedata.core.errors import DanceDataError, DataError, SourceError
from dancedata.core.registry import DATASETS
from dancedata.datasets._split_rule import SplitRule
from dancedata.datasets.folder import Folder
from dancedata.datasets.folder.manifest import COLUMNS, read_manifest
from dancedata.formats.bvh.producers import producers
from tests.datasets.scans import rejects
from tests.messages import raises_message


def put(source: Path, file: str, data: bytes = b"stand-in") -> Path:
    path = source / file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)
    return path


def put_wav(source: Path, file: str) -> None:
    put(source, file, wav_bytes(np.zeros((32_000, 1), np.int16), 8000))


def put_motion(source: Path, file: str, **more: Any) -> None:
    put(source, file)
    arrays = {"poses": np.zeros((90, 72)), "trans": np.zeros((90, 3)), **more}
    np.savez(source / file, **arrays)


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """Two motions and two songs; the path has a blank and letters beyond ASCII."""
    source = tmp_path / "мой dänce 舞"
    for name in ("a", "b"):
        put_motion(source, f"takes/{name}.npz")
        put_wav(source, f"songs/{name}.wav")
    return source


def manifest(source: Path, text: str, name: str = "manifest.csv") -> Path:
    return put(source, name, text.encode())


def by_id(scan: Scan) -> dict[str, Any]:
    return {clip.id: clip for clip in scan.clips}


FULL = """id,motion,audio,split,genre,music,dancer,tempo_bpm,fps,up,unit,layout
two,takes/b.npz,songs/a.wav,test,waltz,,ben,,30000/1001,z,cm,smpl
one,takes/a.npz,songs/b.wav,train,"waltz, slow",Blue,anna,92.5,60,y,m,
"""


def test_a_folder_with_a_manifest_needs_no_name_of_the_dataset(source: Path) -> None:
    with pytest.raises(
        SourceError, match=r"neither a built dataset.*\n  - folder: accepts any layout; select it with"
    ) as refused:
        scan_folder(source)
    assert str(refused.value).count("; found ") == 1  # the same files for all readers
    manifest(source, FULL)
    reader, scan = scan_folder(source)
    assert (reader.name, len(scan.clips)) == ("folder", 2)
    manifest(source, "motion,sonf\ntakes/a.npz,songs/a.wav\n")
    with pytest.raises(SourceError, match=r"known one.*\n  - folder: .*sonf"):  # first, as it was meant
        scan_folder(source)


def test_a_published_dataset_is_read_by_its_reader_despite_a_manifest(tmp_path: Path) -> None:
    DATASETS.get("aist++")().make_example(tmp_path)
    manifest(tmp_path, "motion\nmotions/a.npz\n")
    assert scan_folder(tmp_path)[0].name == "aist++"


def test_a_manifest(source: Path) -> None:
    manifest(source, FULL)
    scan = Folder().scan(source)
    assert [clip.id for clip in scan.clips] == ["one", "two"]
    one, two = scan.clips
    facts = (one.split, one.genre, one.music, one.dancer, one.tempo_bpm)
    assert facts == ("train", "waltz, slow", "Blue", "anna", 92.5)
    assert (two.split, two.music, two.tempo_bpm) == ("test", "a", None)
    assert two.declared == (("fps", "30000/1001"), ("layout", "smpl"), ("unit", "cm"), ("up", "z"))
    assert str(Folder().load(two).grid) == "30000/1001"
    assert Folder().load(one).grid.rate == 60
    notes = "\n".join(scan.notes)
    stated = "60 FPS (declared in the manifest)"
    for words in ("manifest.csv, 2 clips", "1 test, 1 train", stated, "+Z up", "rotated to +Y"):
        assert words in notes
    assert not scan.rejects


def test_the_same_in_jsonl_and_in_other_hands(source: Path) -> None:
    manifest(source, FULL)
    expected = Folder().scan(source)
    same = [FULL.replace("\n", "\r\n"), "\ufeff" + FULL, "# mine\n\n" + FULL]
    same += [FULL.replace('"waltz, slow"', "waltz| slow").replace(",", ";").replace("|", ",")]
    for text in same:
        manifest(source, text)
        assert Folder().scan(source) == expected
    (source / "manifest.csv").unlink()
    two = {"id": "two", "motion": "takes/b.npz", "audio": "songs/a.wav", "split": "test", "genre": "waltz"}
    two |= {"dancer": "ben", "fps": "30000/1001", "up": "z", "unit": "cm", "layout": "smpl", "music": None}
    one = {"id": "one", "motion": "takes/a.npz", "audio": "songs/b.wav", "split": "train", "genre": "waltz, slow"}
    one |= {"music": "Blue", "dancer": "anna", "tempo_bpm": 92.5, "fps": 60, "up": "y", "unit": "m"}
    rows = [two, one]
    manifest(source, "\n".join(json.dumps(row) for row in rows) + "\n\n", "manifest.jsonl")
    assert Folder().scan(source).clips == expected.clips


def test_defaults_of_a_manifest(source: Path) -> None:
    manifest(source, "motion,audio\ntakes/a.npz,songs/a.wav\ntakes/b.npz,songs/a.wav\n")
    scan = Folder(fps=30, up="y", unit="m", split="val").scan(source)
    assert [(c.id, c.split, c.music) for c in scan.clips] == [("a", "val", "a"), ("b", "val", "a")]
    assert any("none is given, so all 2 clips are in 'val'" in note for note in scan.notes)
    assert any("declared in the recipe" in note for note in scan.notes)
    manifest(source, "motion,audio,split\ntakes/a.npz,songs/a.wav,train\n")
    assert "Splits: 1 train." in Folder(fps=30, up="y", unit="m").scan(source).notes


def test_songs_of_one_name_in_two_folders_are_two_songs(source: Path) -> None:
    put_wav(source, "other/a.wav")
    manifest(source, "motion,audio\ntakes/a.npz,songs/a.wav\ntakes/b.npz,other/a.wav\n")
    assert [clip.music for clip in Folder().scan(source).clips] == ["songs/a", "other/a"]


def test_listed_files_that_are_missing(source: Path) -> None:
    manifest(source, "motion,audio\ntakes/a.npz,songs/no.wav\ntakes/no.npz,songs/a.wav\ntakes/b.npz,\n")
    scan = Folder().scan(source)
    assert rejects(scan, "missing_music") == ["a", "b"]
    assert rejects(scan, "missing_motion") == ["no"]
    assert len(scan.rejects) == 3
    assert all("music=optional" in r.detail for r in scan.rejects if r.clip == "b")
    assert not scan.clips
    kept = Folder(music="optional").scan(source)
    assert [(clip.id, clip.audio_path, clip.music) for clip in kept.clips] == [("b", None, "")]


HEAD = "motion,audio,fps\n"
ROW = "takes/a.npz,songs/a.wav,30\n"
BAD_VALUES = [
    ("up", "x"), ("unit", "km"), ("unit", "nan"), ("layout", "smplxx"), ("gender", "x"), ("tempo_bpm", "0"),
    ("tempo_bpm", "nan"), ("tempo_bpm", "1_0"), ("split", "my split"), ("split", "../x"),
]  # fmt: skip


@pytest.mark.parametrize(
    "text",
    [
        "", HEAD, "motoin,audio\n" + ROW, "motion,audio,frames_per_second\n" + ROW, ROW,
        "Motion;Audio\na.npz;a.wav\n", "MOTION\tBPM\na\t100\n", "motion|Audio\na|b\n",
        "motion,audio,split\ntakes/a.npz,songs/a.wav,Train\n",
        "motion,motion,fps\n" + ROW, "audio,fps\nsongs/a.wav,30\n", HEAD + "takes/a.npz,songs/a.wav\n",
        HEAD + ROW + ROW, HEAD + ",songs/a.wav,30\n", HEAD + "takes/a.npz,songs/a.wav,0\n",
        HEAD + "takes/a.npz,songs/a.wav,1e999999999\n", HEAD + "takes/a.npz,songs/a.wav,fast\n",
        "motion\nnotes.txt\n", "motion,audio\ntakes/a.npz,song.mid\n", 'motion,audio\n"takes/a.npz,songs/a.wav\n',
        "motion,audio\ntakes/a.npz,a\x00b.wav\n", "motion\ntakes/.hidden.npz\n", "id,motion\na\x07b,takes/a.npz\n",
        "motion\n" + "x" * 5000 + ".npz\n", "motion\n" + "x" * 500 + ".npz\n",
        *(f"motion,{column}\ntakes/a.npz,{value}\n" for column, value in BAD_VALUES),
        *(f"id,motion\n{name},takes/a.npz\n" for name in ("a/b", "a\\b", "../a", ".hidden", "..", "x" * 201)),
    ],
)  # fmt: skip
def test_mistakes_in_a_manifest(source: Path, text: str) -> None:
    manifest(source, text)
    with raises_message(SourceError, "correct|folder|genre_id|starting"):
        Folder().scan(source)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("nonsense", "line 1.*not valid JSON"), ("[" * 60_000, "line 1.*not valid JSON"),
        ("[" * 100_000, "line 1.*too long"), ('{"motion": NaN}', "NaN"), ("[1]", "list"),
        ('{"motion": "a.npz", "motion": "b.npz"}', "duplicate key"), ('{"motion": ["a.npz"]}', "motion.*list"),
        ('{"motion": true}', "bool"), ('{"motion": "a.npz", "split": {}}', "split"), ("9" * 5000, "line 1"),
        ('{"motion": "takes/a.npz"}\n\n{"motoin": 1}', "line 3.*did you mean 'motion'"),
    ],
)  # fmt: skip
def test_mistakes_in_jsonl(source: Path, text: str, word: str) -> None:
    manifest(source, text, "manifest.jsonl")
    with raises_message(SourceError, rf"manifest\.jsonl.*{word}"):
        Folder().scan(source)


def test_manifests_that_cannot_be_read(source: Path) -> None:
    put(source, "manifest.csv", b"motion\n\xff\xfe.npz")
    with pytest.raises(SourceError, match="UTF-8"):
        Folder().scan(source)
    manifest(source, "{}", "manifest.jsonl")
    with raises_message(SourceError, "manifests", where="мой dänce 舞"):
        Folder().scan(source)


def test_no_path_leads_out_of_the_source(source: Path) -> None:
    outside = source.parent / "outside"
    put_motion(outside, "x.npz")
    (source / "link").symlink_to(outside)
    (source / "file.npz").symlink_to(outside / "x.npz")
    (source / "round.npz").symlink_to(source / "round.npz")
    bad = ["../outside/x.npz", "takes/../../outside/x.npz", "takes/../takes/a.npz", str(outside / "x.npz")]
    bad += ["link/x.npz", "file.npz", str(source / "takes" / "a.npz"), "C:\\takes\\a.npz", "C:/takes/a.npz"]
    bad += ["\\\\server\\takes\\a.npz", "..\\a.npz"]
    for path in bad:
        for row in (f"{path},songs/a.wav", f"takes/a.npz,{path.replace('npz', 'wav')}"):
            manifest(source, f"motion,audio\n{row}\n")
            if path == "file.npz" and "file.wav" in row:
                continue
            with raises_message(SourceError, "outside", where="мой dänce 舞/manifest.csv, line 2"):
                Folder().scan(source)
    manifest(source, "motion,audio\nround.npz,songs/a.wav\n")
    try:
        assert [r.reason for r in Folder().scan(source).rejects] == ["missing_motion"]
    except SourceError as error:  # what Python says of links in a circle differs by version
        assert "not a usable path" in str(error)  # noqa: PT017
    # A link within the source is fine, and so is a source that is a link itself, or has a .. in its own path.
    (source / "again.npz").symlink_to(source / "takes" / "a.npz")
    manifest(source, "motion,audio\nagain.npz,songs/a.wav\n")
    (source.parent / "source").symlink_to(source)
    for way in (source.parent / "source", source / "takes" / ".."):
        assert [clip.id for clip in Folder().scan(way).clips] == ["again"]


def test_matching_names_in_two_folders(tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        put_motion(tmp_path, f"motions/{name}.npz")
    for file in ("a.wav", "a.mp3", "z.ogg", "notes.txt"):
        put(tmp_path, f"music/{file}")
    for file in ("audio/b.FLAC", "README.md", "old/x.npz"):
        put(tmp_path, file)
    scan = Folder(fps=30, up="y", unit="m").scan(tmp_path)
    assert scan.layout == "names"
    assert {c.id: c.audio_path.name for c in scan.clips if c.audio_path} == {"a": "a.wav", "b": "b.FLAC"}
    assert {clip.split for clip in scan.clips} == {"train"}
    assert rejects(scan, "missing_music") == ["c"]
    assert rejects(scan, "unused_music") == ["music/z.ogg"]
    assert rejects(scan, "extra_file") == ["README.md", "music/a.mp3", "music/notes.txt", "old"]
    assert len(scan.rejects) == 6
    notes = "\n".join(scan.notes)
    assert "No manifest: motion and music were matched by file name, motions/ and music/, audio/" in notes
    assert "2 pairs, 1 motion without music" in notes
    assert "none is given, so all 2 clips are in 'train'" in notes


def test_names_that_are_not_ids(tmp_path: Path) -> None:
    for name in ("good", "a\\b", "a\nb", "x" * 201):
        put_motion(tmp_path, f"{name}.npz")
    scan = Folder(music="optional").scan(tmp_path)
    assert [clip.id for clip in scan.clips] == ["good"]
    bad = {reject.clip: reject for reject in scan.rejects}
    assert set(bad) == {"a\\b", "a\\nb", "x" * 201}
    assert all(r.reason == "bad_name" and "rename it" in r.detail for r in bad.values())


def test_matching_names_side_by_side(tmp_path: Path) -> None:
    put_motion(tmp_path, "a.npz")
    put_motion(tmp_path, "b.npz")
    put(tmp_path, "b.bvh")
    for file in ("a.wav", "b.wav"):
        put(tmp_path, file)
    scan = Folder().scan(tmp_path)
    assert [clip.id for clip in scan.clips] == ["a"]
    assert [(r.reason, r.clip) for r in scan.rejects if r.clip] == [("ambiguous_name", "b")]
    assert any("side by side" in note for note in scan.notes)


def test_folders_without_motion(tmp_path: Path) -> None:
    put(tmp_path, "music/a.wav")
    with raises_message(SourceError, "proposes"):
        Folder().scan(tmp_path)


def test_unusable_files_are_reported_once_and_named_by_load(tmp_path: Path) -> None:
    put_motion(tmp_path, "a.npz")
    put(tmp_path, "b.bvh")
    scan = Folder(music="optional").scan(tmp_path)
    notes = "\n".join(scan.notes)
    assert "1 file: not usable (undeclared)" in notes
    assert "1 file: not usable (broken_file), see the rejects (b.bvh)." in notes
    for clip, reason in (("a", "undeclared"), ("b", "broken_file")):
        with raises_message(DataError, "unexpected|well", reason=reason):
            Folder(music="optional").load(by_id(scan)[clip])


@pytest.mark.parametrize(
    "wrong",
    [
        {"fps": 0}, {"fps": "fast"}, {"fps": -30.0}, {"fps": "1e999999999"}, {"up": "x"}, {"unit": "yard"},
        {"unit": 0}, {"layout": "smlp"}, {"gender": "x"}, {"joint_map": {"left_nee": "x"}},
        {"split": "../x"},
    ],
)  # fmt: skip
def test_wrong_parameters(wrong: dict[str, Any]) -> None:
    with raises_message(DanceDataError, "folder|letter"):
        Folder(**wrong)
    assert Folder(fps=29.97).fps == "2997/100", "numbers have one form"
    assert Folder(unit=0.0254, fps=30) == Folder(unit="0.0254", fps="30")


PAGE = Path(__file__).resolve().parents[2] / "docs" / "reference" / "recipes.md"


def test_the_page_lists_every_column_and_producer() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for column in COLUMNS:
        assert f"`{column}`" in text
    for producer in producers().values():
        assert f"`{producer.name}`" in text
        for joint in ("pelvis", "left_hip", "left_knee"):
            assert all(name in text for name in producer.joints[joint]), joint


PIECES = st.sampled_from(
    [",", "\n", '"', ";", "{", "}", ":", "motion", "audio", "../", "takes/a.npz", "fps", "0", "\x00", "é"]
)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    name=st.sampled_from(["manifest.csv", "manifest.jsonl"]),
    head=st.sampled_from(["", "motion,audio\n", "motion\n", '{"motion": ']),
    text=st.one_of(st.lists(PIECES, max_size=20).map("".join), st.text(max_size=60)),
    raw=st.binary(max_size=8),
)
def test_any_manifest_is_read_or_a_source_error(tmp_path: Path, name: str, head: str, text: str, raw: bytes) -> None:
    path = tmp_path / name
    path.write_bytes((head + text).encode("utf-8", "surrogatepass") + raw)
    try:
        rows = read_manifest(path)
    except SourceError as error:
        assert name in str(error)  # noqa: PT017
        return
    assert rows
    for other in ("manifest.csv", "manifest.jsonl"):
        if other != name:
            (tmp_path / other).unlink(missing_ok=True)
    try:
        Folder().scan(tmp_path)
    except SourceError as error:
        assert name in str(error)  # noqa: PT017


def test_a_split_by_music_keeps_equal_samples_together(source: Path) -> None:
    """One song under two names and in two formats: by their names alone they would be in two splits."""
    rule = SplitRule.of({"val": 0.3, "test": 0.3, "by": "music"})
    names = [f"song{k}" for k in range(20)]
    first, *others = names
    other, third, *_ = [name for name in others if rule.split(name) != rule.split(first)]
    samples = np.random.default_rng(0).integers(-9000, 9000, 40_000).astype(np.int16)
    rows = [
        "id,motion,audio,music",
        *(f"d{name},takes/b.npz,,{name}" for name in names),
        "e,takes/b.npz,songs/broken.wav,",
    ]
    for k, (name, last) in enumerate(((f"{first}.wav", 0), (f"{other}.flac", 0), (f"{third}.wav", 1))):
        soundfile.write(source / "songs" / name, np.append(samples, last).astype(np.int16), 22_050)
        rows.append(f"c{k},takes/a.npz,songs/{name},")
    put(source, "songs/broken.wav", b"no music")
    manifest(source, "\n".join(rows))
    scan = Folder(fps=30, up="y", unit="m", music="optional", split=rule.document()).scan(source)
    clips = by_id(scan)
    assert clips["c0"].split == clips["c1"].split == rule.split(first)
    assert clips["c2"].split == rule.split(third)
    assert [clips[name].music for name in ("c0", "c1", "c2")] == [first, other, third]
    assert f"The same song by its samples, grouped as {first}: {other}." in scan.notes


@pytest.mark.parametrize("name", ["manifest.csv", "manifest.jsonl"])
@pytest.mark.parametrize(
    "written",
    [
        "takes\\zo\u00eb.npz", "takes\\zoe\u0308.npz", "takes/zo\u00eb.npz", ".\\takes\\zoe\u0308.npz",
        "takes//zoe\u0308.npz",
    ],
)  # fmt: skip
def test_paths_of_other_systems(source: Path, name: str, written: str) -> None:
    """Backslashes of Windows, and names of macOS in Unicode's form NFD, with or without an id."""
    put_motion(source, "takes/zoe\u0308.npz")
    put_wav(source, "songs/zo\u00eb.wav")
    row = {"motion": written, "audio": "songs\\zoe\u0308.wav"}
    text = ",".join(row) + "\n" + ",".join(row.values()) if name.endswith("csv") else json.dumps(row)
    (clip,) = Folder().scan(manifest(source, text + "\n", name).parent).clips
    assert (clip.id, clip.music) == ("zo\u00eb", "zo\u00eb")
    assert clip.motion_path.is_file()
    assert clip.audio_path is not None
    assert clip.audio_path.is_file()


def test_names_in_two_unicode_forms_are_one(tmp_path: Path) -> None:
    """Without a manifest: motion, music, captions and segments."""
    nfc, nfd = "zo\u00eb", "zoe\u0308"
    put_motion(tmp_path, f"motions/{nfd}.npz")
    put_wav(tmp_path, f"music/{nfc}.wav")
    put(tmp_path, f"texts/{nfd}.txt", b"a step#a/DET step/NOUN#0.0#0.0\n")
    put(tmp_path, "segments.csv", f"clip,layer,start,end,label\n{nfd},moves,0,1,step\n".encode())
    (clip,) = Folder().scan(tmp_path).clips
    assert (clip.id, clip.music, len(clip.segments)) == (nfc, nfc, 2)
    # Two files whose names look alike are one name, and none of them is read in silence.
    put_motion(tmp_path, f"motions/{nfc}.npz")
    scan = Folder().scan(tmp_path)
    assert [reject.reason for reject in scan.rejects if reject.clip == nfc] == ["ambiguous_name"]


def test_a_name_in_another_case_is_named(source: Path) -> None:
    scan = Folder().scan(manifest(source, "motion,audio\ntakes/A.npz,songs/a.wav\ntakes/b.npz,songs/B.WAV\n").parent)
    assert len(scan.rejects) == 2
    assert all("there is a.npz" in reject.detail or "there is b.wav" in reject.detail for reject in scan.rejects)


@pytest.mark.parametrize("end", ["\r", "\r\n", "\n"])
@pytest.mark.parametrize("first", ["", "# Takes, songs, and more, of Monday\n"])
def test_line_ends_and_remarks_of_a_manifest(source: Path, end: str, first: str) -> None:
    text = f"{first}motion;audio;dancer\ntakes/a.npz;songs/a.wav;Ann, Ben, Cy, Di\ntakes/b.npz;songs/b.wav;x\n"
    text += "\n" * 70_000 if end == "\r" else ""
    scan = Folder().scan(manifest(source, text.replace("\n", end)).parent)
    assert [clip.dancer for clip in scan.clips] == ["Ann, Ben, Cy, Di", "x"]
