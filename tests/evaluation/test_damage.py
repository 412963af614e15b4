"""No number is of bytes that a build did not write: not now, and not from the cache later."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

import dancedata
from dancedata import comparison
from dancedata.core.errors import StoreError
from dancedata.evaluation.options import EvaluationOptions
from dancedata.evaluation.protocol import protocol_named
from dancedata.pages import write_report
from dancedata.store import Store, open_store
from tests.messages import raises_message

Flip = Callable[[str], None]


@pytest.fixture
def copy(store: Store, tmp_path: Path) -> Path:
    return Path(shutil.copytree(store.path, tmp_path / "copy"))


@pytest.fixture
def flip(copy: Path) -> Flip:
    """Flip the lowest bit of an exponent in the middle of a field's rows; a second time restores it."""

    def change(field: str) -> None:
        with open_store(copy) as opened:
            span = opened._locate(opened.windows("train")[0], field)
            layout = span.shard.layout(field)
            path, at = span.shard.path, layout.offset + (span.first + 20) * layout.row_bytes + 6  # column 1
        data = bytearray(path.read_bytes())
        data[at] ^= 0x80
        path.write_bytes(data)

    return change


def pfc(path: Path, cache: Path) -> float | None:
    return dancedata.evaluate(path, split="all", metrics=["pfc"], field="joints", intervals=False, cache=cache)[
        "pfc"
    ].value


def test_a_flipped_bit_is_an_error_and_leaves_nothing_in_the_cache(copy: Path, flip: Flip, tmp_path: Path) -> None:
    flip("joints")
    with raises_message(StoreError, "those", where="copy/train-00000-of-00001.h5"):
        pfc(copy, tmp_path / "shared")
    flip("joints")
    assert pfc(copy, tmp_path / "shared") == pfc(copy, tmp_path / "fresh")


def test_keys_of_stored_clips_hold_their_rows(copy, flip, tmp_path, monkeypatch):
    monkeypatch.setattr(Store, "require_intact", lambda *args, **options: None)
    flip("joints")
    damaged = pfc(copy, tmp_path / "shared")
    flip("joints")
    intact = pfc(copy, tmp_path / "shared")
    assert intact == pfc(copy, tmp_path / "fresh") != damaged


@pytest.mark.parametrize("metrics", [["kinetic"], ["bas"]], ids=["pool", "beats"])
def test_pools_and_beats_are_of_intact_shards(copy: Path, flip: Flip, metrics: list[str]) -> None:
    with open_store(copy) as opened:
        clip = next(c for c in opened.clips() if c.split == "train")
        clips = {clip.id: dancedata.decode(clip.read("edge151"), "edge151", fps=30)}
    flip("librosa35")
    with raises_message(StoreError, "those", where="copy/train-00000-of-00001.h5"):
        dancedata.evaluate(clips, like=copy, metrics=metrics, intervals=False)


def test_exports_reports_and_diff_verify_their_input(store: Store, copy: Path, flip: Flip, tmp_path: Path) -> None:
    assert comparison.diff(store.path, copy) == []
    flip("edge151")
    for use in (
        lambda: dancedata.export(copy, "npz", out=tmp_path / "out"),
        lambda: write_report(copy),
        lambda: comparison.diff(store.path, copy),
    ):
        with raises_message(StoreError, "those", where="copy/train-00000-of-00001.h5"):
            use()
    assert not (tmp_path / "out").exists()


def test_a_description_that_was_changed_is_an_error_with_a_cure(copy: Path) -> None:
    path = copy / "dataset.json"
    document = {**json.loads(path.read_text(encoding="utf-8")), "fps": "60"}
    path.write_text(json.dumps(document), encoding="utf-8")
    for use in (open_store, dancedata.evaluate, write_report, lambda p: dancedata.export(p, "npz", out=p / "x")):
        with pytest.raises(StoreError, match=r"dataset\.json was changed after the build") as found:
            use(copy)
    path.write_text(json.dumps({**document, "self_sha256": found.value.allowed}), encoding="utf-8")
    assert open_store(copy).fps == 60


def test_the_pool_is_of_the_field_that_is_named(store: Store) -> None:
    protocol = protocol_named("dancedata")
    for pool in (None, store.path):
        request = EvaluationOptions(what=store, protocol=protocol, field="joints", pool=pool)
        inputs = request.inputs()
        assert {clip.field for clip in (*inputs.clip_set.clips, *inputs.pool.clips)} == {"joints"}
