"""Segments of samples: windows, texts that are drawn, mirrored words, groups, files laid over a dataset."""

import json
import logging
import pickle
from collections import Counter
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from torch.utils.data import DataLoader

import dancedata
from dancedata.core.clip import Window
from dancedata.core.errors import SourceError, UsageError
from dancedata.core.segments import Layer, Segment
from dancedata.store import Store, open_store, verify_store, write_store
from dancedata.torch import (
    BatchLoader,
    BatchStream,
    ClipDataset,
    Dancers,
    EpochSampler,
    GroupDataset,
    Segments,
    Select,
    Text,
    WindowDataset,
)
from tests.groups_store import HEADER, LENGTH, SIZES, stored
from tests.messages import raises_message

WORDS = Layer("description", language="en", sided="mirrored")
MOVES = Layer("moves", sided="mirrored", mirror=(("left turn", "right turn"),))
FRENCH = Layer("french", language="fr")
FPS = 30


def span(layer: Layer, start: int, end: int, *texts: str, **more: Any) -> Segment:
    return Segment(layer, Fraction(start, FPS), Fraction(end, FPS), texts=texts, **more)


def segments_of(clip: str) -> tuple[Segment, ...]:
    """Each clip: two captions that overlap in [10, 30), a move, and a sentence in French; the group's on p0."""
    member = clip[-1]
    mine = (
        span(WORDS, 0, 30, f"{clip} steps left", f"{clip} goes left", texts_mirrored=(f"{clip} steps right",) * 2),
        span(WORDS, 10, 60, f"{clip} waves", texts_mirrored=(f"{clip} waves",)),
        span(MOVES, 25, 28, label="left turn", joint=4),
        span(FRENCH, 0, 60, "à gauche"),
    )
    whole = (span(WORDS, 0, 60, "all in a line", texts_mirrored=("all in a line",), whole=True),)
    return mine + whole * (member == "0")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("segments")
    clips = [replace(clip, segments=segments_of(clip.id)) for clip in stored(SIZES)]
    write_store(out, HEADER, clips, shard_bytes=300_000)
    return out


@pytest.fixture(scope="module")
def store(folder: Path) -> Store:
    assert verify_store(folder) == []
    return open_store(folder)


def windows(store: Store, words: Text | Segments, **options: Any) -> WindowDataset:
    return WindowDataset(store, fields=("joints", words), **options)


def groups(store: Store, words: Text | Segments, **options: Any) -> GroupDataset:
    return GroupDataset(store, fields=("joints", words), **options)


def test_a_window_has_the_segments_that_it_overlaps(store: Store) -> None:
    placed = store.segments(Window("train0_p1", 20, 20))
    assert [(p.segment.layer.name, p.start, p.end, p.share) for p in placed] == [
        ("description", 0, 10, 0.5), ("french", 0, 20, 1.0), ("description", 0, 20, 1.0),
        ("description", 0, 20, 1.0), ("moves", 5, 8, 0.15),
    ]  # fmt: skip
    assert placed[3].segment.texts == ("all in a line",)
    assert [p.segment.label for p in store.segments(Window("train0_p1", 27, 20), "moves")] == ["left turn"]
    assert store.segments(Window("train0_p1", 28, 20), "moves") == []
    with raises_message(UsageError, "french"):
        store.segments(Window("train0_p1", 0, 20), "move")
    with raises_message(UsageError, "descriptions"):
        windows(store, Text("descriptions"))
    unmarked = WindowDataset(store, fields=("joints",), select=Select(ignore=("moves:left turn",)))
    assert not any(store.segments(window, "moves") for window in unmarked.windows)
    assert {(reject.reason, reject.detail) for reject in unmarked.rejects} == {("ignored", "moves: left turn")}
    assert len(unmarked.windows) + len(unmarked.rejects) == len(windows(store, Segments()))


def test_samples_and_batches_keep_lists(store: Store) -> None:
    dataset = windows(store, Segments())
    sample = dataset[0]
    assert sample["segments"] == store.segments(Window(sample["clip"], sample["start"], LENGTH))
    batch = next(iter(BatchLoader(dataset, 4)))
    assert batch["segments"] == [dataset[k]["segments"] for k in range(4)]
    (loaded,) = DataLoader(dataset, 4, sampler=range(4), collate_fn=WindowDataset.collate)
    assert loaded["segments"] == batch["segments"]
    for sample in windows(store, Segments(), augment=["crop"]).samples(range(20), 0):
        assert sample["segments"] == store.segments(Window(sample["clip"], sample["start"], sample["length"]))


def test_a_text_is_drawn_by_seed_epoch_and_index(store: Store) -> None:
    dataset = windows(store, Text("description"), seed=3)
    first, again = (
        [dataset.samples(range(len(dataset)), epoch)[k]["text"] for k in range(len(dataset))] for epoch in (0, 0)
    )
    assert first == again
    assert first != [sample["text"] for sample in dataset.samples(range(len(dataset)), 1)]
    backwards = [sample["text"] for sample in dataset.samples(range(len(dataset))[::-1], 0)]
    assert backwards[::-1] == first
    assert [dataset[sample["id"]]["text"] for sample in dataset.samples(range(len(dataset)), 0)] == first
    loader = BatchLoader(dataset, 8, sampler=EpochSampler(dataset, shuffle=False, seed=0))
    assert [text for batch in loader for text in batch["text"]] == first
    workers = DataLoader(dataset, 8, num_workers=1, sampler=EpochSampler(dataset, shuffle=False, seed=0))
    assert [text for batch in workers for text in batch["text"]] == first
    stream = BatchStream(dataset, 8, sampler=EpochSampler(dataset, shuffle=False, seed=0), steps=1)
    assert next(iter(stream))["text"] == first[:8]
    assert pickle.loads(pickle.dumps(dataset)).samples([0], 0)[0]["text"] == first[0]


def test_texts_come_by_share_and_the_rest_is_empty(store: Store) -> None:
    # Window 0 of this clip is [0, 20): "steps" covers all of it, "waves" half, "all in a line" all.
    dataset = windows(store, Text("description"))
    place = next(k for k, w in enumerate(dataset.windows) if w.clip == "train1_p0" and w.start == 0)
    drawn = Counter(dataset.samples([place], epoch)[0]["text"] for epoch in range(600))
    waves = drawn["train1_p0 waves"]
    assert drawn.keys() == {"train1_p0 steps left", "train1_p0 goes left", "train1_p0 waves", "all in a line"}
    assert 90 < waves < 150  # 0.5 of 2.5 shares of 600
    assert abs(drawn["train1_p0 steps left"] - drawn["train1_p0 goes left"]) < 50
    strict = windows(store, Text("description", min_share=0.6))
    assert "train1_p0 waves" not in {strict.samples([place], epoch)[0]["text"] for epoch in range(50)}
    guided = windows(store, Text("description", empty=0.25))
    texts = [guided.samples([place], epoch)[0]["text"] for epoch in range(400)]
    assert 70 < texts.count("") < 130
    kept = [text for text in texts if text]
    full = [dataset.samples([place], epoch)[0]["text"] for epoch in range(400)]
    assert kept == [text for text, other in zip(full, texts, strict=True) if other]
    assert {sample["text"] for sample in windows(store, Text("moves")).samples(range(9))} == {""}


def test_mirrored_windows_have_mirrored_words(store: Store) -> None:
    dataset = windows(store, Text("description"), augment={"mirror": 1.0})
    texts = {sample["text"] for sample in dataset.samples(range(len(dataset)), 0)}
    assert any("steps right" in text for text in texts)
    assert not any("left" in text for text in texts)
    augmented = windows(store, Text("description"), augment=[{"yaw": 0}, {"mirror": 1.0}])
    assert [s["text"] for s in augmented.samples(range(5), 0)] == [s["text"] for s in dataset.samples(range(5), 0)]
    moves = windows(store, Segments(mirror_words="keep"), augment={"mirror": 1.0}).samples(range(4), 0)
    labels = {(p.segment.label, p.segment.joint) for s in moves for p in s["segments"] if p.segment.label}
    assert labels == {("right turn", store.skeleton.other_side[4])}


def test_words_that_may_name_sides_are_never_given_mirrored_unasked(store: Store) -> None:
    for augment in ({"mirror": 0.5}, ["root_offset", {"mirror": 0.5}]):
        with raises_message(UsageError, "mirror_words"):
            windows(store, Text("french"), augment=augment)
    with raises_message(UsageError, "mirror_words"):
        groups(store, Segments(), augment={"mirror": 1.0})
    kept = windows(store, Text("french", mirror_words="keep"), augment={"mirror": 1.0})
    assert kept.samples([0], 0)[0]["text"] == "à gauche"
    assert windows(store, Text("description"), augment={"mirror": 0.5})
    assert windows(store, Text("french")).samples([0], 0)[0]["text"] == "à gauche"


def test_a_group_has_a_text_for_each_dancer_and_one_for_all(store: Store) -> None:
    dataset = groups(store, Text("description", min_share=0.1), dancers=Dancers(choose="seed"))
    for sample in dataset.samples(range(len(dataset)), 0):
        if sample["start"] + LENGTH > 60:
            continue
        assert sample["text_group"] == "all in a line"
        assert [text.split(" ")[0] for text in sample["text"]] == sample["clips"]
    draws = dataset.samples([0], 0)[0]["text"]
    texts = {text for epoch in range(9) for text in dataset.samples([0], epoch)[0]["text"]}
    assert len({text.partition(" ")[2] for text in texts}) > 2
    batch = next(iter(BatchLoader(dataset, 3, sampler=EpochSampler(dataset, shuffle=False, seed=0))))
    assert batch["text"][0] == draws
    assert batch["text_group"] == ["all in a line"] * 3
    everything = groups(store, Segments())[0]
    assert [len(placed) for placed in everything["segments"][:2]] == [3, 3]
    assert everything["segments"][2:] == [[], [], []]
    assert [p.segment.texts for p in everything["segments_group"]] == [("all in a line",)]


def test_whole_clips_have_segments_too(store: Store) -> None:
    dataset = ClipDataset(store, fields=("joints", Segments()))
    batch = ClipDataset.pad([dataset[0], dataset[3]])
    assert [len(placed) for placed in batch["segments"]] == [len(dataset[k]["segments"]) for k in (0, 3)]
    assert ClipDataset(store, fields=("joints", Text("description")))[0]["text"]


def write_marks(path: Path, *rows: dict[str, Any]) -> Path:
    path.write_text("".join(json.dumps({"clip": "train0_p1", "layer": "description", **row}) + "\n" for row in rows))
    return path


def test_segments_without_a_value_are_equal() -> None:
    without, again, one = (Segment(MOVES, Fraction(0), Fraction(1), value=float(v)) for v in ("nan", "nan", "1"))
    assert without == again
    assert without != one
    assert without != replace(again, label="turn")
    assert without != "turn"


def test_marks_and_corrections_are_laid_over(folder: Path, tmp_path: Path, store: Store) -> None:
    more = write_marks(
        tmp_path / "more.jsonl",
        {"start": 0, "end": 1, "text": "corrected, to the left", "language": "en"},
        {"layer": "mark", "start": "1/2", "self_sha256": store.info["self_sha256"]},
    )
    opened = dancedata.open(folder, segments=more)
    assert opened.overlay.notes == ()
    corrected, mark, *_ = (opened.segments("train0_p1", name)[0] for name in ("description", "mark"))
    assert corrected.texts == ("corrected, to the left",)
    assert corrected.texts_mirrored == ("corrected, to the right",)
    assert len(opened.segments("train0_p1")) == len(store.segments("train0_p1")) + 1
    assert opened.segments("train0_p0") == store.segments("train0_p0")
    assert [p.start for p in opened.segments(Window("train0_p1", 10, 20), "mark")] == [5]
    assert mark.layer.kind == "instant"
    dataset = windows(opened, Segments())
    place = next(k for k, w in enumerate(dataset.windows) if w.clip == "train0_p1")
    again = pickle.loads(pickle.dumps(dataset))
    assert repr(again[place]["segments"]) == repr(dataset[place]["segments"])  # nan is not equal to itself
    assert any("corrected" in text for p in again[place]["segments"] for text in p.segment.texts)


def test_files_of_another_dataset(folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    more = write_marks(tmp_path / "m.jsonl", {"start": 0, "end": "end", "self_sha256": "ab" * 32})
    with caplog.at_level(logging.WARNING):
        opened = dancedata.open(folder, segments=[more])
    assert "made for another dataset" in opened.overlay.notes[0]
    assert opened.overlay.notes[0] in caplog.text
    clip = opened["train0_p1"]
    assert opened.overlay.segments[clip.id][0].end == Fraction(clip.n_frames, FPS)
    for row in ({"clip": "nobody", "start": 0}, {"start": 0, "other": "nobody"}):
        with raises_message(SourceError, "correct", where="m.jsonl, line 1"):
            dancedata.open(folder, segments=write_marks(tmp_path / "m.jsonl", row))
