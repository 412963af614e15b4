"""Splits by a rule: a function of the group's name and the seed alone."""

import hashlib
import unicodedata
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile
from hypothesis import given
from hypothesis import strategies as st

from dancedata.core.clip import ClipRef
from dancedata.core.errors import RecipeError, SourceError, UsageError
from dancedata.datasets._split_rule import SplitRule, same_songs
from dancedata.datasets.folder import Folder
from dancedata.recipes.parse import parse_recipe
from tests.messages import raises_message

READER = Folder
RULE = {"val": 0.1, "test": 0.1, "by": "music"}


def clips(songs: int, per_song: int = 3, **more: Any) -> list[ClipRef]:
    return [
        ClipRef(f"song{s}-{k}", Path("x"), None, "", music=f"song{s}", dancer=f"d{s % 7}", **more)
        for s in range(songs)
        for k in range(per_song)
    ]


def splits(rule: dict[str, Any], refs: list[ClipRef]) -> dict[str, str]:
    return {clip.id: clip.split for clip in SplitRule.of(rule).apply(refs)[0]}


def by_hand(name: str, seed: int, val: float, test: float) -> str:
    """The page's own words."""
    digest = hashlib.sha256(f"{seed}\n{unicodedata.normalize('NFC', name)}".encode()).digest()
    place = int.from_bytes(digest[:8], "big") / 2**64
    return "test" if place < test else "val" if place >= 1 - val else "train"


@given(
    name=st.text(st.characters(codec="utf-8"), min_size=1),
    seed=st.integers(0, 2**62),
    by=st.sampled_from(["music", "clip"]),
)
def test_it_matches_the_page(name: str, seed: int, by: str) -> None:
    rule = SplitRule.of({"val": 0.25, "test": 0.125, "by": by, "seed": seed})
    assert rule.split(name) == by_hand(name, seed, 0.25, 0.125)
    assert rule.split(unicodedata.normalize("NFD", name)) == rule.split(unicodedata.normalize("NFC", name))


def test_groups_are_whole_and_fractions_close() -> None:
    refs = clips(1000)
    made = splits(RULE, refs)
    for song in range(1000):
        assert len({made[f"song{song}-{k}"] for k in range(3)}) == 1
    for name, part in {"train": 0.8, "val": 0.1, "test": 0.1}.items():
        # Three standard deviations of 1,000 songs.
        assert abs(list(made.values()).count(name) / 3000 - part) < 3 * np.sqrt(part * (1 - part) / 1000)
    # One fraction does not concern the other's groups.
    other = splits({**RULE, "val": 0.3}, refs)
    assert {c for c, s in other.items() if s == "test"} == {c for c, s in made.items() if s == "test"}
    assert {c for c, s in other.items() if s == "val"} > {c for c, s in made.items() if s == "val"}
    assert splits({**RULE, "seed": 1}, refs) != made


def test_by_dancer_genre_and_clip() -> None:
    refs = clips(60, genre="waltz")
    by_dancer = splits({"test": 0.3, "by": "dancer"}, refs)
    assert {by_dancer[c.id] == "test" for c in refs if c.dancer == "d1"} in ({True}, {False})
    assert len({by_dancer[f"song0-{k}"] for k in range(3)}) == 1
    assert len({splits({"test": 0.5, "by": "clip"}, refs)[f"song{s}-{k}"] for s in range(9) for k in range(3)}) == 2
    with raises_message(SourceError, "fewer"):
        splits({"test": 0.3, "by": "genre"}, refs)
    with raises_message(SourceError, "require"):
        splits({"test": 0.3, "by": "genre"}, clips(2))
    # A clip without music shares none.
    silent = [ClipRef(f"take{k}", Path("x"), None, "") for k in range(40)]
    assert set(splits(RULE, silent).values()) == {"train", "val", "test"}


def test_songs_whose_zeros_differ_in_sign_are_one(tmp_path: Path) -> None:
    samples = np.random.default_rng(0).integers(-9, 9, 4800) / 32768
    minus = np.where(samples == 0, -0.0, samples)
    refs = []
    for name, values, kind in (("a.flac", samples, "PCM_16"), ("b.wav", minus, "FLOAT"), ("c.wav", -minus, "FLOAT")):
        soundfile.write(tmp_path / name, values, 48_000, subtype=kind)
        refs.append(ClipRef(name, Path("x"), tmp_path / name, "", music=name))
    assert np.signbit(soundfile.read(tmp_path / "b.wav")[0][minus == 0]).all()
    assert same_songs(refs) == {"b.wav": "a.flac"}


def test_an_empty_split_is_refused() -> None:
    rule = {"val": 0.2, "test": 0.2, "by": "music"}
    with raises_message(SourceError, "balance.*fractions") as caught:
        splits(rule, clips(6))
    assert "18 clips of 6 songs" in str(caught.value)
    with raises_message(SourceError, "fewer"):
        splits(rule, clips(2))  # two songs fill no three splits


@pytest.mark.parametrize(
    "rule",
    [
        {"val": 0.1}, {"val": 0.1, "by": "song"}, {"val": 0.1, "by": ["music"]},
        {"val": 0.1, "bye": "music", "by": "clip"}, {"val": 1.5, "by": "clip"}, {"val": -0.1, "by": "clip"},
        {"val": "a few", "by": "clip"}, {"val": True, "by": "clip"}, {"val": "nan", "by": "clip"},
        {"val": 0.6, "test": 0.4, "by": "clip"}, {"by": "clip"}, {"val": 0.1, "by": "clip", "seed": -1},
        {"val": 0.1, "by": "clip", "seed": "x"}, {"val": 0.1, "by": "clip", "balance": "yes"},
        {"val": 0.1, "train": 0.8, "by": "clip"}, {},
    ],
)  # fmt: skip
def test_nonsense_is_refused(rule: dict[str, Any]) -> None:
    with raises_message(UsageError, "splits"):
        Folder(split=rule)


def uneven(*sizes: int) -> list[ClipRef]:
    return [clip for s, n in enumerate(sizes) for clip in clips(s + 1, n) if clip.music == f"song{s}"]


@given(sizes=st.lists(st.integers(1, 9), min_size=5, max_size=12), seed=st.integers(0, 1000))
def test_balanced_splits_of_a_few_songs(sizes: list[int], seed: int) -> None:
    refs = uneven(*sizes)
    rule = {"val": 0.2, "test": 0.2, "by": "music", "seed": seed, "balance": True}
    found = splits(rule, refs)
    assert {"train", "val", "test"} == set(found.values())
    assert found == splits(rule, refs[::-1])
    songs = {(clip.music, found[clip.id]) for clip in refs}
    assert len(songs) == len(sizes), "songs are whole"
    n = Counter(found.values())
    for name in ("val", "test"):
        # No song of train would bring the split closer.
        left = [size for s, size in enumerate(sizes) if (f"song{s}", "train") in songs]
        off = abs(n[name] - 0.2 * len(refs))
        alone = sum(split == name for _, split in songs) == 1
        assert alone or all(abs(n[name] + size - 0.2 * len(refs)) >= off - 1e-9 for size in left)


def test_balance_meets_the_fractions_that_names_alone_miss() -> None:
    refs = uneven(*[10] * 10)
    plain, balanced = ({**RULE, "seed": 3, **more} for more in ({}, {"balance": True}))
    assert Counter(splits(balanced, refs).values()) == {"train": 80, "val": 10, "test": 10}
    with raises_message(SourceError, "fractions"):
        splits(plain, refs)
    _, notes = SplitRule.of(balanced).apply(refs)
    assert "balanced: a clip that is added may move others" in notes[0]
    # What the manifest states is counted, and stays.
    stated = [replace(clip, split="test") if clip.music in ("song1", "song2") else clip for clip in refs]
    assert Counter(splits(balanced, stated).values()) == {"train": 70, "val": 10, "test": 20}
    with raises_message(SourceError, "balance"):
        splits(balanced, uneven(3, 3))


def document(split: Any) -> dict[str, Any]:
    return {
        "recipe": 1, "name": "own", "dataset": {"folder": {"unit": "cm", "fps": 60, "up": "y", "split": split}},
        "windows": {"length_s": 2, "stride_s": 1}, "motion": {"edge151": {}},
    }  # fmt: skip


def test_one_rule_is_one_recipe_however_it_is_written() -> None:
    one = parse_recipe(document(RULE))
    same = parse_recipe(document({"by": "music", "test": "1/10", "seed": 0, "val": "0.10"}))
    rule = {"val": "1/10", "test": "1/10", "by": "music", "seed": 0, "balance": False}
    assert one.document["dataset"]["folder"]["split"] == rule
    assert one.sha256 == same.sha256 != parse_recipe(document({**RULE, "seed": 1})).sha256
    assert parse_recipe(one.document).sha256 == one.sha256
    with raises_message(RecipeError, r"dataset\.folder", where="recipe"):
        parse_recipe(document({**RULE, "vale": 0.1}))


def write_manifest(source: Path, lines: list[str]) -> None:
    # Equal samples are one song, under any names.
    song = (source / "music/slow.wav").read_bytes()
    for k in range(6):
        (source / f"music/s{k}.wav").write_bytes(song[: -2 * k - 2] + (k + 1).to_bytes(2, "little") * (k + 1))
    rows = [f"take{k},motions/own.bvh,music/s{k // 2}.wav,song{k // 2},{line}" for k, line in enumerate(lines)]
    (source / "manifest.csv").write_text("\n".join(["id,motion,audio,music,split", *rows]))


def test_the_manifest_goes_first(source: Path) -> None:
    rule = {"val": 0.2, "test": 0.2, "by": "music", "seed": 1}
    reader = Folder(unit="cm", split=rule)
    write_manifest(source, [""] * 12)
    free = {clip.id: clip.split for clip in reader.scan(source).clips}
    k = next(k for k in range(12) if free[f"take{k}"] == "train")
    lines = [""] * 12
    write_manifest(source, [*lines[:k], "dev", *lines[k + 1 :]])
    scan = reader.scan(source)
    assert {clip.id: clip.split for clip in scan.clips} == {**free, f"take{k}": "dev", f"take{k + 1}": "dev"}
    assert "dev 16.7% (from the manifest; 2 clips of 1 song)" in "\n".join(scan.notes)
    write_manifest(source, ["train", "test", *lines[2:]])
    with raises_message(SourceError, "song0"):
        reader.scan(source)


def test_without_a_manifest_every_pair_is_a_song(source: Path) -> None:
    (source / "manifest.csv").unlink()
    song = (source / "music/slow.wav").read_bytes()
    for k in range(30):
        (source / f"motions/n{k}.bvh").write_bytes((source / "motions/own.bvh").read_bytes()[:4000])
        (source / f"music/n{k}.wav").write_bytes(song[:2000] + k.to_bytes(4, "little"))
    made = {clip.id: clip.split for clip in Folder(unit="cm", split=RULE).scan(source).clips}
    assert made == {name: by_hand(name, 0, 0.1, 0.1) for name in made}
    assert set(made.values()) == {"train", "val", "test"}
