"""Copies against the published files, by names of public lists."""

import hashlib
import shutil
from pathlib import Path
from typing import Any

import pytest

import dancedata
from dancedata.datasets.aistpp.facts import crossmodal_split, facts, parse_name
from dancedata.datasets.finedance.facts import facts as finedance_facts
from dancedata.datasets.originals import original
from dancedata.synthetic import write_synthetic

LISTS = ("crossmodal_train.txt", "crossmodal_val.txt", "crossmodal_test.txt")


def texts(folder: Path, **options: Any) -> list[str]:
    return [p.message for p in dancedata.check(folder, progress=False, **options)]


def absent(folder: Path) -> list[str]:
    problems = dancedata.check(folder, progress=False)
    return [p.where for p in problems if p.message.startswith(("missing_motion", "not_in_source"))]


@pytest.fixture
def copy(empty_copy: Any) -> Any:
    """Stand-ins for all published motions and songs; their contents are not read by `compared`."""
    for name in original("aist++").names["motions"]:
        empty_copy.write(f"motions/{name}.pkl", b"-")
    for song in original("aist++").names["songs"]:
        empty_copy.write(f"wavs/{song}.wav", b"-")
    return empty_copy


def compared(root: Path, **options: Any) -> list[str]:
    from dancedata.datasets.aistpp import AistPP

    return [str(c) for c in AistPP(**options).compared(root) if str(c)]


def test_the_published_numbers() -> None:
    aist, fine, pop = original("aist++"), original("finedance"), original("popdanceset")
    assert {kind: len(names) for kind, names in aist.names.items()} == {"motions": 1408, "songs": 60}
    assert set(aist.names["songs"]) == {f"m{letters}{n}" for letters in facts().genres for n in range(6)}
    splits = [crossmodal_split(parts) for name in aist.names["motions"] if (parts := parse_name(name))]
    assert [splits.count(split) for split in ("train", "val", "test", "")] == [980, 20, 20, 388]
    assert facts().ignored <= aist.names["motions"]
    assert fine.names == dict.fromkeys(("motions", "songs", "labels"), frozenset(finedance_facts().ids))
    assert len(pop.names["motions"]) == 1012 + 24
    assert all(source for entry in (aist, fine, pop) for source in entry.sources.values())


def test_the_published_lists(shared: Path) -> None:
    root, published = shared / "realdata" / "aistpp", original("aist++")
    for name, sha256 in published.lists.items():
        assert hashlib.sha256((root / name).read_bytes()).hexdigest() == sha256
    mapping = (root / "cameras" / "mapping.txt").read_text().splitlines()
    assert {line.split()[0] for line in mapping} == published.names["motions"]


def test_a_complete_copy(copy: Any) -> None:
    motions, songs = compared(copy.root)
    assert motions.startswith("Complete: all 1,408 motions are here (names: cameras/mapping.txt")
    assert songs.startswith("Complete: all 60 songs are here")


def test_a_copy_without_what_no_build_uses(copy: Any) -> None:
    for name in facts().ignored:
        (copy.root / f"motions/{name}.pkl").unlink()
    assert compared(copy.root)[0].startswith(
        "Complete except for ignored files: 45 of 1,408 motions are missing, all on the ignore list"
    )
    assert compared(copy.root, ignore="none")[0].startswith("Incomplete: 45 of 1,408 motions are missing: gBR_")


def test_a_partial_copy_names_what_is_missing(copy: Any) -> None:
    for name in ("motions/gBR_sBM_cAll_d04_mBR0_ch01.pkl", "motions/gWA_sFM_cAll_d27_mWA5_ch20.pkl", "wavs/mJB5.wav"):
        (copy.root / name).unlink()
    motions, songs = compared(copy.root)
    assert motions.startswith(
        "Incomplete: 2 of 1,408 motions are missing: gBR_sBM_cAll_d04_mBR0_ch01, gWA_sFM_cAll_d27_mWA5_ch20 (names:"
    )
    assert songs.startswith("Incomplete: 1 of 60 songs are missing: mJB5 (names:")


def test_empty_files_are_missing(copy: Any) -> None:
    """As of a download that failed."""
    name = "gBR_sBM_cAll_d04_mBR0_ch04"
    copy.write(f"motions/{name}.pkl", b"")
    copy.write("wavs/mJB5.wav", b"")
    motions, songs = compared(copy.root)
    assert motions.startswith(f"Incomplete: 1 of 1,408 motions are missing, 1 of them empty files: {name} (names:")
    assert songs.startswith("Incomplete: 1 of 60 songs are missing, 1 of them empty files: mJB5 (names:")
    copy.write(f"wavs/{name.replace('mBR0', 'mJB5')}.wav", b"-")
    assert compared(copy.root)[1].startswith("Complete: all 60 songs")


def test_sequences_with_music_have_their_song(copy: Any) -> None:
    shutil.rmtree(copy.root / "wavs")
    for name in original("aist++").names["motions"]:
        copy.write(f"wavs/{name}.wav", b"-")
    assert compared(copy.root)[1].startswith("Complete: all 60 songs")


def test_lists_by_their_bytes(shared: Path, empty_copy: Any) -> None:
    empty_copy.motion("gBR_sBM_cAll_d04_mBR0_ch03")
    for name in LISTS:
        (empty_copy.root / "splits").mkdir(exist_ok=True)
        shutil.copy(shared / "realdata/aistpp/splits" / name, empty_copy.root / "splits" / name)
    with (empty_copy.root / "splits" / LISTS[0]).open("a") as file:
        file.write("\n")
    assert compared(empty_copy.root)[-1] == (
        "Lists as published, by SHA-256: splits/crossmodal_val.txt, splits/crossmodal_test.txt; "
        "differ from the published ones: splits/crossmodal_train.txt."
    )


def test_check_names_every_missing_file_once(official: Any) -> None:
    official.names("cameras/mapping.txt", *sorted(original("aist++").names["motions"]))  # most are missing_motion
    present = {path.stem for path in (official.root / "motions").iterdir()}
    missing = sorted(original("aist++").names["motions"] - present)
    assert sorted(name for name in absent(official.root) if name.startswith("g")) == missing


def test_check_with_a_recipe(official: Any) -> None:
    assert any("of 1,408 motions are missing" in text for text in texts(official.root, recipe="aist++"))


def test_check_of_finedance(finedance: Any) -> None:
    (finedance.root / "label_json" / "001.json").unlink()
    found = [text.split(" are missing")[0] for text in texts(finedance.root) if text.startswith("Incomplete")]
    assert found == [
        "Incomplete: 204 of 211 motions",
        "Incomplete: 204 of 211 songs",
        "Incomplete: 205 of 211 labels",
    ]


def test_popdanceset_counts_its_songs(tmp_path: Path) -> None:
    from dancedata.datasets.popdanceset import PopDanceSet
    from dancedata.datasets.popdanceset.motion import write_example

    write_example(tmp_path / "pop")
    motions, songs, lists = (str(c) for c in PopDanceSet().compared(tmp_path / "pop"))
    assert motions.startswith("Incomplete: 1,036 of 1,036 motions are missing: BV")
    assert "and 1,016 more" in songs
    assert lists == "Lists differ from the published ones: train.txt, test.txt."


def test_generated_files_are_no_copy(tmp_path: Path) -> None:
    write_synthetic(tmp_path / "made", seed=0, songs=2, clips_per_song=2, clip_s=6.0)
    assert not [text for text in texts(tmp_path / "made") if "omplete" in text]
