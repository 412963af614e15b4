"""Free columns of clips: in samples and batches, as a choice of clips, in info, reports, cards and exports."""

import json
import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
import torch
from torch.utils.data import DataLoader

import dancedata
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.licence import Licence
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.skeleton import SMPL24
from dancedata.core.terms import OVERRIDE, may_share_audio, require_shareable
from dancedata.store import open_store, verify_store, write_store
from dancedata.store.schema import Field, StoreHeader
from dancedata.testing.stores import write_random_store
from dancedata.torch import BatchLoader, ClipDataset, EpochSampler, GroupDataset, Select, WindowDataset
from tests.commands import as_json, run
from tests.groups_store import stored
from tests.messages import raises_message

#: Of six clips of train; the last one has none.
COLUMNS: list[dict[str, Any]] = [
    {"level": 1, "teacher": "anna", "share": 0.5, "indoors": True, "tags": ("turn", "jump")},
    {"level": 2, "teacher": "ben", "indoors": False, "tags": ("turn",)},
    {"level": 3, "teacher": "anna", "share": 0.25, "indoors": True},
    {"level": 3, "teacher": "ben", "share": 1.0, "indoors": True, "tags": ("wave",)},
    {"level": 5, "share": 0.5, "indoors": False},
    {},
]
TERMS = (Licence("CC BY 4.0", "Anna, 2026"), Licence("all rights reserved"), None)


def written(folder: Path, *, terms: tuple[Licence | None, ...] = (None,)) -> Path:
    made = write_random_store(folder / "draft", n_frames=(90, 120), meta={"recipe": {}, "dataset": "folder"})
    train = [clip for clip in made.clips if clip.split == "train"]
    clips = [replace(c, columns=columns) for c, columns in zip(train, COLUMNS, strict=True)]
    clips += [clip for clip in made.clips if clip.split != "train"]
    clips = [replace(clip, terms=terms[k % len(terms)]) for k, clip in enumerate(clips)]
    (folder / "store").mkdir()
    write_store(folder / "store", made.header, clips)
    return folder / "store"


USUAL = ("edge151", "librosa35")


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("clip values"))


def ids(dataset: Any) -> set[str]:
    return {dataset.windows.clip_ids[k] for k in dataset.windows.clip}


def test_samples_and_batches_have_the_values(path: Path) -> None:
    names = ["x/level", "x/teacher", "x/share", "x/indoors", "x/tags"]
    dataset = WindowDataset(path, fields=(*USUAL, *names), select=Select({"x/level": (1, 2, 3, 5)}))
    of_clip = {f"train_c{k:02d}": values for k, values in enumerate(COLUMNS)}
    for sample in (dataset[k] for k in range(len(dataset))):
        wanted = of_clip[sample["clip"]]
        assert (sample["x/level"], sample["x/indoors"]) == (wanted["level"], wanted["indoors"])
        assert sample["x/teacher"] == wanted.get("teacher", "")
        assert sample["x/tags"] == list(wanted.get("tags", ()))
        assert sample["x/share"] == wanted["share"] if "share" in wanted else math.isnan(sample["x/share"])
    order = EpochSampler(dataset, seed=0)
    loaded = next(iter(DataLoader(dataset, batch_size=8, sampler=order, collate_fn=dataset.collate)))
    batch = next(iter(BatchLoader(dataset, batch_size=8, sampler=EpochSampler(dataset, seed=0))))
    for one in (loaded, batch):
        assert (one["x/level"].dtype, one["x/indoors"].dtype) == (torch.int64, torch.bool)
        assert one["x/share"].shape == (8,)
        assert [len(tags) for tags in one["x/tags"]] == [len(of_clip[c].get("tags", ())) for c in one["clip"]]
        assert one["x/teacher"] == [of_clip[clip].get("teacher", "") for clip in one["clip"]]
    (sample, *_) = ClipDataset(path, fields=(*USUAL, "x/teacher"), select=Select({"x/teacher": "ben"}))
    assert sample["x/teacher"] == "ben"


def test_groups_have_a_value_of_each_dancer(tmp_path: Path) -> None:
    clips = [replace(c, columns={"height": 160 + c.member}) if c.member else c for c in stored({"train": (2, 3)})]
    clips = [replace(c, audio={}, motion={"joints": c.motion["joints"]}) for c in clips]
    field = Field("joints", "motion", REPRESENTATIONS.make("joints", {}).columns, Fraction(30))
    header = StoreHeader(fps=Fraction(30), length=20, stride=10, fields=(field,), skeleton=SMPL24, meta={})
    write_store(tmp_path, header, clips)
    dataset = GroupDataset(tmp_path, fields=("joints", "x/height"))
    found = {sample["group"]: sample["x/height"] for sample in (dataset[k] for k in range(len(dataset)))}
    assert found == {"train0": [None, 161, None], "train1": [None, 161, 162]}


@pytest.mark.parametrize(
    ("where", "wanted"),
    [
        ({"x/level": 3}, {2, 3}), ({"x/level": [1, 5]}, {0, 4}), ({"x/teacher": "anna", "x/share": 0.5}, {0}),
        ({"x/indoors": False}, {1, 4}), ({"x/tags": {"wave", "jump"}}, {0, 3}), ({"genre": "break"}, {0, 2, 4}),
        ({"lists": "all", "n_flags": 1}, {1, 3, 5}),
        # Columns that are not stored, as all clips have the default.
        ({"x/level": 3, "role": "", "member": -1}, {2, 3}),
    ],
)  # fmt: skip
def test_clips_with_some_values(path: Path, where: dict[str, Any], wanted: set[int]) -> None:
    dataset = WindowDataset(path, select=Select(where))
    assert ids(dataset) == {f"train_c{k:02d}" for k in wanted}
    filtered = [reject for reject in dataset.rejects if reject.reason == "filtered"]
    assert {reject.clip for reject in filtered} == {f"train_c{k:02d}" for k in set(range(6)) - wanted}
    assert next(iter(where)) in filtered[0].detail
    # With lists to ignore the clips are chosen another way.
    assert ids(WindowDataset(path, select=Select(where, ignore=["ignored"]))) == ids(dataset)
    assert ids(ClipDataset(path, select=Select(where))) == ids(dataset)


@pytest.mark.parametrize(
    "where",
    [
        {"x/levle": 1}, {"x/level": "three"}, {"x/level": True}, {"x/level": ()}, {"id": "a"}, "x/level", {"role": 1},
        {"x/level": 4},
    ],
)  # fmt: skip
def test_wrong_choices(path: Path, where: Any) -> None:
    with raises_message(UsageError, r"level|role|store\.to_pandas"):
        WindowDataset(path, select=Select(where))
    for columns in (["x/levle"], ["genre"], ["x/level"]):
        with raises_message(UsageError, "level|genre"):
            WindowDataset(path, fields=(*USUAL, *columns))


def test_whole_numbers_of_pandas_are_exact_where_a_clip_has_none(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    made = write_random_store(tmp_path / "draft", clips={"train": 2})
    columns: list[dict[str, Any]] = [{"number": 2**60 + 1, "all": 2**60 + 1}, {"all": 3}]
    clips = [replace(clip, columns=c) for clip, c in zip(made.clips, columns, strict=True)]
    (tmp_path / "store").mkdir()
    write_store(tmp_path / "store", made.header, clips)
    table = open_store(tmp_path / "store").to_pandas()
    assert int(table["x/number"][0]) == 2**60 + 1  # numpy compares as float64
    assert table["x/number"].isna().tolist() == [False, True]
    assert table["x/all"].tolist() == [2**60 + 1, 3]


def test_info_and_report_name_the_columns(path: Path, tmp_path: Path) -> None:
    lines = run("info", path).stdout
    assert "x/level: int, 5 of 10 clips, 1 to 5, median 3\n" in lines
    assert "x/teacher: text, 4 of 10 clips: anna: 2, ben: 2\n" in lines
    assert "x/tags: texts, 3 of 10 clips: turn: 2, jump: 1, wave: 1\n" in lines
    columns = {column["name"]: column for column in as_json("info", path)["columns"]}
    assert columns["x/indoors"]["values"] == {"true": 3, "false": 2}
    with open_store(path) as store:
        assert [column.name for column in store.free_columns()] == sorted(columns)


@pytest.mark.parametrize(
    ("text", "may"),
    [
        ("CC BY 4.0", True), ("CC-BY-NC-SA-4.0", True), ("cc0", True), ("CC0 1.0 Universal", True),
        ("MIT License", True),
        ("Creative Commons Attribution 4.0 International", True), ("public domain", True), ("Apache-2.0", True),
        ("CC BY-ND 4.0", False), ("CC BY-NC-ND", False), ("all rights reserved", False), ("", False),
        ("not CC BY", False), ("CC BY 4.0, but not here", False),
    ],
)  # fmt: skip
def test_known_licences_may_be_shared(text: str, may: bool) -> None:
    assert Licence(text).may_share is may


def test_terms_of_clips(tmp_path: Path) -> None:
    path = written(tmp_path, terms=TERMS)
    assert verify_store(path) == []
    with open_store(path) as store:
        assert store.licences == (Licence("CC BY 4.0", "Anna, 2026"), Licence("all rights reserved"))
        assert [store[f"train_c{k:02d}"].licence for k in range(4)] == [0, 1, -1, 0]
        assert store.info["licences"][0] == {
            "licence": "CC BY 4.0", "citation": "Anna, 2026", "may_share": True,
        }  # fmt: skip
        assert not may_share_audio(store)
        with raises_message(UsageError, "allow", where="store"):
            require_shareable(store)
        assert "all rights reserved" in require_shareable(store, rights="granted")
    lines = run("info", path).stdout
    assert "licence of 4 clips: CC BY 4.0; cite: Anna, 2026; may be passed on" in lines
    assert "licence of 3 clips: the licence of the dataset\n" in lines
    assert [entry["clips"] for entry in as_json("info", path)["licences"]] == [4, 3, 3]
    dancedata.export(path, "npz", tmp_path / "npz")
    licence = (tmp_path / "npz" / "README.md").read_text(encoding="utf-8")
    assert "- 3 clips: all rights reserved; may not be passed on\n" in licence


def test_the_strictest_licence_decides(tmp_path: Path) -> None:
    free = written(tmp_path / "free", terms=(Licence("CC BY 4.0"), Licence("CC0")))
    with open_store(free) as store:
        assert may_share_audio(store)
        assert "5 clips: CC BY 4.0" in require_shareable(store)
    # One clip has the terms of the dataset, which are not known.
    one = written(tmp_path / "one", terms=(*[Licence("CC0")] * 9, None))
    with open_store(one) as store, raises_message(UsageError, "allow", where="one/store"):
        require_shareable(store)
    strict = written(tmp_path / "strict", terms=(*[Licence("CC0")] * 9, Licence("by agreement")))
    with open_store(strict) as store:
        assert not may_share_audio(store)
    assert OVERRIDE.startswith("--")


def test_a_licence_that_does_not_exist(tmp_path: Path) -> None:
    path = written(tmp_path, terms=TERMS)
    document = json.loads((path / "dataset.json").read_text(encoding="utf-8"))
    (path / "dataset.json").write_text(json.dumps({**document, "licences": document["licences"][:1]}))
    assert any("/clips/licence: a number is out of bounds" in str(p) for p in verify_store(path))
    document["licences"] = "CC0"
    (path / "dataset.json").write_text(json.dumps(document), encoding="utf-8")
    with raises_message(StoreError, "incomplete", where="store/dataset.json"):
        open_store(path)
