"""Augmentations at building: copies of motion that is changed, and of rows that are changed."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pytest

import dancedata
from dancedata.building.part import Part, build_part
from dancedata.building.plan import make_plan
from dancedata.building.spine import expand
from dancedata.core.clip import ClipRef
from dancedata.core.columns import Columns
from dancedata.core.errors import DataError, RecipeError, SourceError, UsageError
from dancedata.core.motion import Motion
from dancedata.core.plugins import CopyAugmentation
from dancedata.core.registry import AUGMENTATIONS
from dancedata.execution.progress import Progress
from dancedata.recipes.parse import load_recipe
from dancedata.store import verify_store
from tests.messages import raises_message
from tests.takes import take_of

SMALL = ("motion={edge151: {}, joints: {}}", "keymotion=lodge", "windows.length_s=3", "audio={}")


@dataclass(frozen=True)
class Shift(CopyAugmentation):
    """Moves the dancer along x.

    metres : how far.
    broken : id of a clip that cannot be moved.
    """

    version: ClassVar[int] = 1

    metres: float = 0.5
    broken: str = ""

    def change_motion(self, motion: Motion, clip: str) -> Motion:
        if clip == self.broken:
            raise DataError("too near to the wall", reason="wall")
        return replace(motion, translation=np.add(motion.translation, (self.metres, 0, 0)))


@dataclass(frozen=True)
class Speckle(CopyAugmentation):
    """Rows with noise, another one for each clip; key motions unchanged."""

    version: ClassVar[int] = 1
    changes: ClassVar[Literal["rows", "motion", "time"]] = "rows"

    def change_rows(self, rows: Any, columns: Columns, *, kind: str, clip: str) -> Any:
        noise = np.random.default_rng([*clip.encode()]).integers(-1, 2, rows.shape)
        return rows + noise.astype(rows.dtype) if kind == "motion" else rows


@dataclass(frozen=True)
class Slower(CopyAugmentation):
    """Cuts the motion short, which is not allowed."""

    version: ClassVar[int] = 1

    def change_motion(self, motion: Motion, clip: str) -> Motion:
        return motion.part(0, motion.n_frames - 1)


@dataclass(frozen=True)
class Wider(CopyAugmentation):
    """Gives rows of another shape, which is not allowed."""

    version: ClassVar[int] = 1

    def change_rows(self, rows: Any, columns: Columns, *, kind: str, clip: str) -> Any:
        return rows[..., :1]

    def check(self, columns: Columns) -> None:
        if "position" in columns.names:
            raise UsageError("positions cannot be made wider")


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch) -> None:
    AUGMENTATIONS.names()
    monkeypatch.setattr(AUGMENTATIONS, "_classes", dict(AUGMENTATIONS._classes))
    for cls in (Shift, Speckle, Slower, Wider):
        AUGMENTATIONS.register(cls.__name__.lower())(cls)


@pytest.mark.parametrize("transforms", ["[]", "[{slices: {length_s: 3}}]"])
def test_copies_of_changed_motion_and_rows(corpus: Path, run_build, transforms: str, tmp_path: Path) -> None:
    plain = (*SMALL, f"transforms={transforms}")
    run_build(corpus, tmp_path / "plain", "aist++", plain, cache=tmp_path / "cache")
    entries = set((tmp_path / "cache").rglob("*.npy"))
    run_build(
        corpus, tmp_path / "out", "aist++",
        (*plain, "augment={mirror: true, speckle: true, shift: {metres: 0.25}, shift.far: {metres: 2}}"),
        cache=tmp_path / "cache",
    )  # fmt: skip
    assert [p for p in verify_store(tmp_path / "out") if p.severity == "error"] == []
    one, all_of_it = dancedata.open(tmp_path / "plain"), dancedata.open(tmp_path / "out")
    train = [c.id for c in one.clips() if c.split == "train"]
    copies = {f"{clip}__{name}": clip for clip in train for name in ("mirror", "speckle", "shift", "shift.far")}
    assert {c.id: c.source for c in all_of_it.clips() if c.source} == copies
    # Clips are those of a build without copies, from the cache; only shift is encoded.
    assert len(set((tmp_path / "cache").rglob("*.npy")) - entries) == 2 * 3 * len(train)
    for window in one.windows("train"):
        for field in one.fields:
            rows = one.read(window, field)
            np.testing.assert_array_equal(all_of_it.read(window, field), rows)
            shifted = all_of_it.read(replace(window, clip=f"{window.clip}__shift"), field)
            noisy = all_of_it.read(replace(window, clip=f"{window.clip}__speckle"), field)
            far = all_of_it.read(replace(window, clip=f"{window.clip}__shift.far"), field)
            if field == "joints":
                for moved, metres in ((shifted, 0.25), (far, 2)):
                    wanted = rows.reshape(-1, 24, 3) + np.float32((metres, 0, 0))
                    np.testing.assert_allclose(moved.reshape(-1, 24, 3), wanted, atol=1e-6)
            if field == "lodge":
                np.testing.assert_array_equal(noisy, rows)
            else:
                assert (noisy != rows).any()
                assert (noisy != all_of_it.read(replace(window, clip=f"{window.clip}__mirror"), field)).any()
        # Contacts do not depend on where one dances: they were labelled on the moved joints.
        contact = one.fields["edge151"].slice("contact")
        moved = all_of_it.read(replace(window, clip=f"{window.clip}__shift"), "edge151")
        np.testing.assert_array_equal(moved[:, contact], one.read(window, "edge151")[:, contact])


def test_plan_and_parts_count_copies(corpus: Path, tmp_path: Path) -> None:
    recipe = load_recipe("aist++", (*SMALL, "augment={mirror: true, shift: {}}"))
    before = make_plan(recipe, corpus, cache=tmp_path).to_json()
    n_train = before["splits"]["train"]["clips"] // 3
    of = before["cached"]["edge151"]["of"]
    assert of == sum(split["clips"] for split in before["splits"].values()) - n_train
    for number in (1, 2):
        build_part(recipe, corpus, Part(number, 2), cache=tmp_path)
    assert make_plan(recipe, corpus, cache=tmp_path).to_json()["cached"]["edge151"]["cached"] == of


def test_a_copy_that_cannot_be_made_is_a_reject(corpus: Path, run_build, built: Path, tmp_path: Path) -> None:
    broken = next(c.id for c in dancedata.open(built).clips() if c.split == "train")
    changes = (*SMALL, f"augment={{shift: {{broken: {broken}}}}}")
    run_build(corpus, tmp_path / "out", "aist++", changes, progress=Progress(quiet=True))
    store = dancedata.open(tmp_path / "out")
    assert [r["reason"] for r in store.rejects if r.get("clip") == f"{broken}__shift"] == ["wall"]
    assert broken in {c.id for c in store}
    assert f"{broken}__shift" not in {c.id for c in store}
    with raises_message(DataError, r"ignore_list\.txt", reason="wall"):
        run_build(corpus, tmp_path / "strict", "aist++", changes, strict=True)


def test_forbidden_changes_of_an_augmentation(corpus: Path, run_build, tmp_path: Path) -> None:
    with raises_message(UsageError, "trim_start", where="clip gHO_sBM_cAll_d19_mHO3_ch03"):
        run_build(corpus, tmp_path / "a", "aist++", (*SMALL, "augment={slower: {}}"))
    with raises_message(UsageError, "wider", where="clip gHO_sBM_cAll_d19_mHO3_ch03"):
        run_build(corpus, tmp_path / "b", "aist++", ("audio={}", "augment={wider: {}}"))


def test_augment_in_recipes() -> None:
    plain = load_recipe("aist++", ("augment={}",))
    assert plain.document["augment"] == {}
    assert load_recipe("aist++", ("augment.mirror=false",)).sha256 == plain.sha256
    assert load_recipe("aist++", ("augment={shift: false}",)).sha256 == plain.sha256
    mirrored = load_recipe("aist++", ("augment.mirror=true",))
    assert mirrored.document["augment"] == {"mirror": {}}
    assert load_recipe("aist++", ("augment={mirror: {}}",)).sha256 == mirrored.sha256
    both = load_recipe("aist++", ("augment.shift=true", "augment.speckle={}"))
    shift = {"metres": 0.5, "broken": ""}
    assert both.document["augment"] == {"speckle": {}, "shift": shift}
    two = load_recipe("aist++", ("augment={shift: true, shift.left: {}}", "augment.shift.left.metres=-1"))
    assert [(spec.name, spec.augmentation) for spec in two.augment] == [("shift", Shift()), ("shift.left", Shift(-1))]
    assert [spec.clip_id("clip") for spec in two.augment] == ["clip__shift", "clip__shift.left"]
    with raises_message(RecipeError, "root_offset", where="aist++"):
        load_recipe("aist++", ("augment={shif: true, speckle: 3, wider: {}}", "motion=joints"))
    with pytest.raises(RecipeError, match=r"augment\.shift\.metres: "):
        load_recipe("aist++", ("augment={shift: {metres: x}}",))
    with raises_message(RecipeError, "mapping", where="aist++"):
        load_recipe("aist++", ("augment=[mirror]",))


def test_a_copy_with_the_id_of_a_clip_is_an_error() -> None:
    recipe = load_recipe("aist++", ("audio={}", "augment=shift"))
    names = ("a", "a__shift")
    takes = [take_of(recipe, [(ClipRef(clip, Path(f"{clip}.pkl"), None, "train"), "0")]) for clip in names]
    with raises_message(SourceError, "copies", where="clip a__shift"):
        expand(takes, recipe.parts.transforms)
