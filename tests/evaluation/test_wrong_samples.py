"""What can be wrong with samples and their ids: an error or a warning says what to do, in every command."""

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import DanceDataError, DataError, UsageError
from dancedata.core.sample_id import safe_name
from dancedata.evaluation.report import Report
from dancedata.samples.saved import save_samples
from dancedata.scene.selection import ViewRequest, ViewSelection
from dancedata.store import Store
from dancedata.study.page import StudyRequest, write_study
from tests.messages import raises_message

FIRST = "{clip}@0+150"
#: Files by name: rows of the first clip that a file has, or its entries; what `evaluate` says; and its options.
CASES: Mapping[str, tuple[Mapping[str, Any], type[DanceDataError] | None, str, Mapping[str, Any]]] = {
    "nothing_matched": ({"take1": (0, 150), "take2": (0, 150)}, DataError, "none of 2 files.*save_samples", {}),
    "some_unmatched": ({FIRST: (0, 150), "take1": (0, 150)}, None, "1 file of 2 without a clip.*: take1", {}),
    "no_clip": ({"nobody@0+150": (0, 150)}, DataError, "has no clip", {}),
    "outside": ({"{clip}@100+150": (0, 150)}, DataError, "frames 100 to 250", {}),
    "empty": ({"{clip}@0+0": (0, 150)}, DataError, "not within", {}),
    "wrong_length": ({FIRST: (0, 120)}, DataError, "120 rows.*150 rows", {}),
    "wrong_rate": ({FIRST: (0, 150)}, UsageError, "counts frames", {"fps": 60}),
    "music_twice": ({FIRST: (0, 150)}, UsageError, "other music on purpose", {"music": "other.wav"}),
    "no_start": ({"{clip}@15+60": (15, 75)}, UsageError, r"second 0\.5", {"music": {"{clip}@15+60": "mXX0"}}),
    "field_width": ({FIRST: np.zeros((150, 140))}, DataError, r"\(T, 151\), columns of edge151", {}),
    "not_stated": ({FIRST: (0, 150)}, UsageError, "nothing states", {"normalized": None}),
    "two_ids": ({FIRST: {"samples": (20, 170), "id": "{clip}@20+150"}}, DataError, "rename", {}),
    "two_samples": ({FIRST: (0, 150), "x": {"samples": (1, 151), "id": FIRST}}, DataError, "150~s1", {}),
    "draw_lost": ({"{clip}@0+150~yaw~draw0.1.2": (0, 150)}, None, "yaw of 1 sample cannot be made again", {}),
    "self": ({FIRST: (0, 150)}, None, "1 of 1 sample is a dance of the dataset itself", {}),
    "takes": ({FIRST: (0, 150), FIRST + "~s1": (0, 150)}, None, "2 of 2 samples are the dances of the dataset", {}),
}


def written(store: Store, folder: Path, files: Mapping[str, Any]) -> Path:
    clip = store.clips()[0]
    motion = clip.read("edge151")
    folder.mkdir()

    def rows(what: Any) -> np.ndarray:
        return motion[slice(*what)] if isinstance(what, tuple) else what

    for name, what in files.items():
        path = folder / name.format(clip=clip.id)
        if isinstance(what, dict):
            np.savez(f"{path}.npz", samples=rows(what["samples"]), id=what["id"].format(clip=clip.id))
        else:
            np.save(f"{path}.npy", rows(what))
    return folder


def said(error: type[DanceDataError] | None, words: str, code: str, call: Callable[[], Report]) -> None:
    if error is None:
        report = call()
        assert any(re.search(words, text) for text in report.warnings), report
        assert report.matched
        return
    with raises_message(error, words) as caught:
        call()
    reasons = {"empty": "outside", "wrong_length": "nothing_left", "field_width": "nothing_left"}
    assert caught.value.reason == reasons.get(code, code)


@pytest.mark.parametrize("code", CASES)
def test_what_evaluate_says(store: Store, tmp_path: Path, code: str) -> None:
    files, error, words, options = CASES[code]
    given = {"normalized": False, "intervals": False} | dict(options)
    if isinstance(options.get("music"), str):
        given["music"] = tmp_path / options["music"]
        given["music"].touch()
    elif "music" in options:
        given["music"] = {name.format(clip=store.clips()[0].id): song for name, song in options["music"].items()}
    folder = written(store, tmp_path / "gen", files)
    said(error, words, code, lambda: dancedata.evaluate(folder, like=store, **given))


def test_the_sources_of_samples_are_named(store: Store, tmp_path: Path) -> None:
    clip = store.clips()[0]
    for source in ("a", "b"):
        np.save(tmp_path / f"{source}={clip.id}.npy", clip.read("edge151"))
    report = dancedata.evaluate(tmp_path, like=store, normalized=False, intervals=False)
    assert re.search("sources a, b", report.matched)


def test_samples_of_another_dataset(store: Store, tmp_path: Path) -> None:
    clip = store.clips()[0]
    save_samples(
        store, tmp_path, [f"{clip.id}@0+150"], clip.read("edge151")[None, :150], field="edge151", scaler=None
    )
    about = json.loads((tmp_path / "samples.json").read_text())
    about["dataset"] |= dict.fromkeys(("self_sha256", "recipe_sha256", "source_sha256"), "0" * 64)
    (tmp_path / "samples.json").write_text(json.dumps(about))
    calls: list[Callable[[], Any]] = [
        lambda: dancedata.evaluate(tmp_path, like=store),
        lambda: dancedata.evaluate(tmp_path),
        lambda: ViewSelection.of(ViewRequest(tmp_path)),
    ]
    for call in calls:
        with raises_message(DataError, "another dataset", reason="other_dataset", where=str(tmp_path)):
            call()


@pytest.mark.parametrize(("files", "protocol", "error", "words"), [
    (["{group}~p0"], "groups", UsageError, "not all dancers"),
    (["{group}~p0", "{group}~p1"], "groups", None, ""),
    (["{group}~p0", "{group}~p1"], "dancedata", None, "1 group measured dancer by dancer"),
])  # fmt: skip
def test_dancers_of_groups(duets, tmp_path, files, protocol, error, words):
    clip = next(clip for clip in duets if clip.group)
    (tmp_path / "gen").mkdir()
    for name in files:
        member = next(c for c in duets.clips() if c.group == clip.group and name.endswith(f"p{c.member}"))
        np.save(tmp_path / "gen" / f"{name.format(group=clip.group)}.npy", member.read("edge151"))
    options: dict[str, Any] = {"like": duets, "normalized": False, "intervals": False, "protocol": protocol}
    if error is None and not words:
        assert len(dancedata.evaluate(tmp_path / "gen", **options).clips) == 1
        return
    said(error, words, "group_dancer", lambda: dancedata.evaluate(tmp_path / "gen", **options))


def test_groups_stand_on_no_wall_and_in_no_study(duets: Store, tmp_path: Path) -> None:
    clip = next(clip for clip in duets if clip.group)
    name, rows = f"{safe_name(clip.group)}@0+60", clip.read("edge151")[None, :60]
    save_samples(duets, tmp_path / "gen", [name], rows, field="edge151", scaler=None)
    with raises_message(DataError, f"groups.*{re.escape(name)}.*each dancer", reason="groups_left_out", where="gen"):
        ViewSelection.of(ViewRequest(tmp_path / "gen"))
    with raises_message(UsageError, r"found \d groups.*one stage without a wall"):
        ViewSelection.of(ViewRequest(duets.path, wall=True))
    views = dict.fromkeys("ab", ViewRequest(duets.path))
    with raises_message(DataError, r"without \d groups", reason="nothing_matched"):
        write_study(StudyRequest(views, songs=1), tmp_path / "study.html")
