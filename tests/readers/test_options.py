"""Values that say what readers read: as they print, as plain data, those that clash, and readers made of them."""

import io
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

import dancedata
from dancedata.core.errors import UsageError
from dancedata.filters.movement import Movement
from dancedata.store import Store
from dancedata.torch import (
    PRESETS,
    BalancedSampler,
    BatchLoader,
    ClipDataset,
    Dancers,
    EpochSampler,
    GroupDataset,
    Mix,
    Primitives,
    Relative,
    Scale,
    Segments,
    Select,
    Text,
    WindowDataset,
    Windows,
    from_plain,
    to_plain,
)  # fmt: skip
from tests.messages import raises_message

ARGUMENTS: dict[str, Any] = {
    "fields": ("x/level", Relative("lodge139"), Primitives(n=128), Text("style", empty=0.1), Segments("keep")),
    "windows": Windows(length_s=4, stride=10, fps=30, start_at="downbeat", trim=True),
    "select": Select({"genre": ("gBR", "gPO")}, ignore=("a", "b"), protocol="p", filter={"movement": {"min_std": 1}}),
    "scale": Scale(fields=("edge151",), clamp=True, covers=({"mirror": 0.5}, "yaw"), over="all"),
    "dancers": Dancers(persons=3, choose="seed", singles=True),
    "augment": {"mirror": 0.5, "yaw": {"max_degrees": 90}},
    "seed": 3,
}
VALUES = [v for v in (*ARGUMENTS.values(), *ARGUMENTS["fields"], Segments("keep"), Scale()) if hasattr(v, "stated")]


@pytest.mark.parametrize("value", VALUES, ids=repr)
def test_values_print_as_they_are_typed(value: Any) -> None:
    assert eval(repr(value)) == value
    with pytest.raises(AttributeError):
        value.other = 1


@pytest.mark.parametrize("arguments", [ARGUMENTS, *PRESETS.values()], ids=["all", *PRESETS])
def test_arguments_are_data_of_yaml_and_of_checkpoints(arguments: dict[str, Any]) -> None:
    plain = to_plain(arguments)
    assert from_plain(yaml.safe_load(yaml.safe_dump(plain))) == arguments
    file = io.BytesIO()
    torch.save({"reader": plain}, file)
    file.seek(0)
    assert from_plain(torch.load(file, weights_only=True)["reader"]) == arguments
    assert from_plain(to_plain({"scale": {"edge151": Path("a.json")}})) == {"scale": {"edge151": "a.json"}}
    with raises_message(UsageError, "plain data"):
        to_plain({"select": Select(filter=Movement(field="lodge139"))})


@pytest.mark.parametrize(
    "plain",
    [
        {"windows": {"lenght": 3}}, {"select": {"were": {}}}, {"scale": {"kind": "minmaxx"}},
        {"fields": [{"txt": {}}]}, {"fields": [{"text": {}}]}, {"dancers": {"choose": "tallest"}},
        {"scale": {"kind": "zscore", "clamp": True}},
    ],
    ids=str,
)  # fmt: skip
def test_plain_data_that_stand_for_nothing(plain: dict[str, Any]) -> None:
    with raises_message(UsageError, "lenght|were|minmaxx|txt|layer|tallest|clamp"):
        from_plain(plain)


@pytest.mark.parametrize(
    ("make", "both"),
    [
        (lambda: Windows(length=3, length_s=1), ("length=3", "length_s=1")),
        (lambda: Windows(stride=3, stride_s=1), ("stride=3", "stride_s=1")),
        (lambda: Dancers(persons=3, exactly=2), ("persons=3", "exactly=2")),
        (lambda: Scale("zscore", clamp=True), ("kind='zscore'", "clamp=True")),
        (lambda: Scale("zscore", covers=["mirror"]), ("kind='zscore'", "covers=('mirror',)")),
        (lambda: Scale("zscore_grouped", over="all"), ("kind='zscore_grouped'", "over='all'")),
        (lambda: Scale(covers=["mirror"], scaler="a.json"), ("covers=('mirror',)", "scaler='a.json'")),
    ],
)  # fmt: skip
def test_values_that_do_not_go_together_are_both_named(make: Any, both: tuple[str, str]) -> None:
    with pytest.raises(UsageError, match="go together") as caught:
        make()
    assert all(name in str(caught.value) for name in both)


@pytest.mark.parametrize(
    ("cls", "wrong"),
    [
        (Scale, {"fields": True}), (Scale, {"clamp": "no"}), (Windows, {"length": "x"}), (Windows, {"length": 0}),
        (Windows, {"trim": 1}), (Windows, {"start_at": "bar"}), (Select, {"ignore": 5}), (Dancers, {"persons": "3"}),
        (Dancers, {"singles": "yes"}), (Primitives, {"n": 0}), (Primitives, {"variant": "codes"}),
        (Text, {"layer": "a", "empty": 2}), (Text, {"layer": "a", "min_share": -1}),
        (Segments, {"mirror_words": "?"}), (Windows, {"length": True}), (Select, {"ignore": (3,)}),
        (Select, {"protocol": 3}), (Relative, {"field": 3}), (Text, {"layer": ""}), (Scale, {"kind": []}),
        (Scale, {"fields": (3,)}), (Primitives, {"n": None}), (Dancers, {"exactly": 2**40}),
    ],
    ids=str,
)  # fmt: skip
def test_values_are_checked_when_they_are_made(cls: Any, wrong: dict[str, Any]) -> None:
    with raises_message(UsageError, list(wrong)[-1] if "layer" not in wrong else "probability|text"):
        cls(**wrong)


def test_readers_name_both_values(built: Path) -> None:
    ds = dancedata.open(built)
    own = ds.windows("train")
    for arguments, both in (
        ({"windows": own, "select": Select({"genre": "break"})}, ("Select(", "WindowList(")),
        ({"windows": own, "split": "val"}, ("split='val'", "WindowList(")),
        ({"windows": Windows(start_at="beat"), "augment": ["crop"]}, ("start_at='beat'", "crop")),
        ({"fields": ("edge151", Text("a"), Segments())}, ("Text('a')", "Segments()")),
        ({"fields": (Relative("edge151"),)}, ("Relative('edge151')", "scaled edge151")),
        ({"fields": ("edge151", Primitives(n=77))}, ("windows of 150 frames", "Primitives(n=77)")),
    ):
        with pytest.raises(UsageError, match="go together") as caught:
            WindowDataset(ds, **arguments)  # type: ignore[arg-type]
        assert all(name in str(caught.value) for name in both), both


#: Of a dataset: what nobody can read, and a word of the error.
NOTHING: tuple[tuple[str, Any], ...] = (
    ("windows", lambda ds: WindowDataset(ds, windows=5)), ("Scale", lambda ds: WindowDataset(ds, scale=5)),
    ("empty", lambda ds: WindowDataset(ds, windows=ds.windows("train")[:0])),
    ("Select", lambda ds: WindowDataset(ds, select={"genre": "break"})),
    ("True", lambda ds: WindowDataset(ds, scale=True)), ("not fitted", lambda ds: WindowDataset(ds, scale={})),
    ("split", lambda ds: WindowDataset(ds, 3)), ("split", lambda ds: WindowDataset(ds, (3,))),
    ("entry of fields", lambda ds: WindowDataset(ds, fields=3)), ("augment", lambda ds: WindowDataset(ds, augment=3)),
    ("path", lambda ds: WindowDataset(3)), ("seed", lambda ds: WindowDataset(ds, seed=True)),
    ("too large", lambda ds: ds.windows("train", length=2**80)),
    ("whole number", lambda ds: ds.windows("train", length=True)),
    ("seconds", lambda ds: ds.windows("train", stride_s=True)), ("names", lambda ds: ds.windows("train", fields=3)),
    ("readers", lambda ds: Mix(None)), ("readers", lambda ds: Mix([3])), ("readers", lambda ds: Mix({"a": ds})),
    ("reads windows", lambda ds: BatchLoader(ds)), ("samples", lambda ds: EpochSampler(2.5)),
    ("weights", lambda ds: Mix({"a": WindowDataset(ds)}, weights=3)),
    ("label", lambda ds: BalancedSampler(WindowDataset(ds), by=3)),
    ("clip", lambda ds: ds[3]), ("clips", lambda ds: ds.clips()[None]), ("field", lambda ds: ds.clips()[0][[]]),
    ("clip", lambda ds: ds.segments(3)), ("field", lambda ds: ds.scaler({})), ("table", lambda ds: ds.to_pandas([3])),
    ("path", lambda ds: dancedata.open(ds.path, segments=3)),
)  # fmt: skip


@pytest.mark.parametrize(("word", "ask"), NOTHING)
def test_arguments_that_are_nothing_are_refused(built: Path, word: str, ask: Any) -> None:
    with raises_message(UsageError, word):
        ask(dancedata.open(built))


def test_windows_of_ones_own_are_those_that_are_read(built: Path) -> None:
    ds = dancedata.open(built)
    windows, clips = ds.windows("train"), ds.to_pandas()
    genre = clips[clips.split == "train"].genre.iloc[0]
    chosen = set(clips[clips.genre == genre].id)
    places = [k for k, w in enumerate(windows) if w.clip in chosen and w.start >= 30]
    data = WindowDataset(ds, fields=("edge151",), windows=windows.take(places), augment={"mirror": 0.5})
    every = WindowDataset(built, fields=("edge151",))
    assert [(s["clip"], s["start"]) for s in data.samples(range(len(data)))] == [
        (windows[k].clip, windows[k].start) for k in places
    ]
    data.set_epoch(0)
    plain = next(k for k in range(len(data)) if not data[k]["mirrored"])
    assert torch.equal(data[plain]["edge151"], every[places[plain]]["edge151"])
    genres = WindowDataset(ds, fields=("edge151",), select=Select({"genre": (genre,)}))
    assert {s["clip"] for s in genres.samples(range(len(genres)))} == chosen & {w.clip for w in windows}


def test_readers_print_what_a_sample_is(built: Path) -> None:
    scaler = dancedata.open(built).scaler("edge151")
    text = str(WindowDataset(built, **PRESETS["edge"] | {"augment": {"mirror": 0.5}}))
    assert f"edge151: (150, 151) float32, minmax scaler {scaler.sha256[:12]}, cut to [-1, 1]" in text
    assert "librosa35: (150, 35) float32, as stored" in text
    assert "mirror p=0.5" in text
    assert "edge151: (180, 151) float32" in str(ClipDataset(built))  # whole clips of one length
    assert "edge151: (90, 151) float32" in str(ClipDataset(built, windows=Windows(length=90)))


def test_groups_cover_what_changes_them(groups_store: Store) -> None:
    covers = {"mirror": 0.5, "yaw": True}
    wide = GroupDataset(groups_store, fields=("edge151",), augment=covers, scale=Scale(covers=covers))
    assert float(torch.stack([wide[k]["edge151"] for k in range(len(wide))]).abs().max()) <= 1 + 1e-4
    for arguments in ({"select": Select(ignore=("ignored",))}, {"windows": Windows(start_at="beat")}):
        with raises_message(UsageError, "GroupDataset"):
            GroupDataset(groups_store, fields=("edge151",), **arguments)  # type: ignore[arg-type]
