"""Checks that every plug-in has to pass, for authors of plug-ins too: call them from a test.

::

    from dancedata.testing.conformance import check

    def test_conformance(tmp_path):
        check(MyDataset, tmp_path)

`check` calls the check of the plug-in's kind. The class has to be registered (`@DATASETS.register("mine")`) and to
work with its default parameters. A failure is an AssertionError with what was expected.
"""

import json
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from dancedata.audio.hf.feature import HuggingFace
from dancedata.audio.jukebox.feature import Jukebox
from dancedata.building.transforms.copy import Copy
from dancedata.core.audio_signal import AudioSignal
from dancedata.core.bodies import SMPLX55
from dancedata.core.codebook import DType
from dancedata.core.columns import Columns
from dancedata.core.errors import DanceDataError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.placement import Placement, moved, moved_rows, require_roles
from dancedata.core.plugins import (
    Augmentation,
    CopyAugmentation,
    FileFeature,
    Plugin,
    SampleAugmentation,
    WindowFilter,
)
from dancedata.core.registry import (
    ANNOTATORS,
    AUGMENTATIONS,
    CONTACTS,
    DATASETS,
    FEATURES,
    FIELDS,
    FILTERS,
    KEYMOTIONS,
    METRICS,
    REPRESENTATIONS,
    RULES,
    TRANSFORMS,
)
from dancedata.core.rejects import BY_CHOICE
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.exports.base.job import EXPORTS
from dancedata.files.regular_file import sha256_file
from dancedata.testing.building_checks import check_annotator, check_field, check_rule, check_transform
from dancedata.testing.dataset_checks import SLICES, check_dataset, recipe_with
from dancedata.testing.examples import (
    FPS,
    contact_rule_of,
    example_fields,
    mirrored_motion,
    random_motion,
    random_signal,
)
from dancedata.testing.export_checks import check_export
from dancedata.testing.plugin_checks import (
    check_drops,
    check_metric,
    check_plugin,
    check_samples,
    check_starts,
    raises,
    registry_of,
    require,
)

#: Radians and metres: what float32 columns may lose.
ANGLE_TOLERANCE = 1e-4
TRANSLATION_TOLERANCE = 1e-6
#: A skeleton that no representation takes.
ODD_SKELETON = Skeleton("odd", ("root", "tail"), (-1, 0), np.zeros((2, 3)), (), (0, 0, 1, 1))


def check_representation(cls: type[Any]) -> None:
    """Check a representation: columns, dtype, decoding, mirroring, one frame, another skeleton."""
    check_plugin(cls)
    representation, rule = cls(), contact_rule_of(cls())
    _check_columns(representation.columns)
    motion = random_motion(representation.skeleton, 40)
    before = motion.translation.copy(), motion.rotations.copy()
    array = representation.encode(motion, rule)
    require(
        array.shape == (40, representation.columns.width),
        f"encode gives (T, {representation.columns.width}), not {array.shape}",
    )
    require(array.dtype == np.float32, f"encode gives float32, not {array.dtype}")
    require(bool(np.isfinite(array).all()), "encode gives finite values")
    untouched = np.array_equal(before[0], motion.translation) and np.array_equal(before[1], motion.rotations)
    require(untouched, "encode does not write into the motion")
    one = representation.encode(motion.part(0, 1), rule)
    require(one.shape == (1, representation.columns.width), "a motion of one frame can be encoded")
    odd = Motion(np.zeros((2, 3)), np.zeros((2, 2, 3)), FPS, ODD_SKELETON)
    raises(UsageError, lambda: representation.encode(odd, rule), "a motion on another skeleton is a UsageError")
    mirror = representation.columns.mirror
    if mirror is not None:
        require(np.array_equal(mirror.apply(mirror.apply(array)), array), "mirroring twice gives back the columns")
    _check_spatial(representation, motion, array)
    if representation.decodes and representation.positions_only:
        decoded = representation.decode(array, FPS)
        require(decoded.n_frames == 40 and decoded.grid == FPS, "decode gives as many frames, at the requested rate")
    elif representation.decodes:
        decoded = representation.decode(array, FPS)
        wanted = motion
        if representation.spatial is not None and representation.spatial.placeless:
            # Place, facing and joints that the columns lack are lost; the columns are not.
            wanted = decoded
            again = representation.encode(decoded, rule)
            require(bool(np.allclose(again, array, rtol=0, atol=1e-4)), "encode gives the decoded columns again")
        elif representation.grounded:
            shift = decoded.translation[0] * (0, 1, 0) - motion.translation[0] * (0, 1, 0)
            wanted = Motion(motion.translation + shift, motion.rotations, motion.grid, motion.skeleton)
        _check_same(decoded, wanted, TRANSLATION_TOLERANCE, "decode gives back the motion")
        if mirror is not None:
            image = representation.decode(mirror.apply(array), FPS)
            _check_same(
                image, mirrored_motion(wanted), TRANSLATION_TOLERANCE, "mirrored columns are the mirrored motion's"
            )


def _check_spatial(representation: Any, motion: Motion, array: npt.NDArray[Any]) -> None:
    """Check that columns that are turned and shifted are those of the motion that is turned and shifted."""
    if representation.spatial is None:
        return
    require_roles(representation.spatial, representation.columns)
    by = Placement(turn_rad=1.2, x_m=0.4, z_m=-0.7)
    wanted = representation.encode(moved(motion, by), contact_rule_of(representation))
    rows = moved_rows(representation.spatial, array, representation.columns, by)
    require(bool(np.abs(rows - wanted).max() < 1e-5), "`spatial` turns columns as `encode` turns with the motion")


def check_contact_rule(cls: type[Any]) -> None:
    """Check a contact rule: shape, values, one frame, and that it does not matter where in the room one dances."""
    check_plugin(cls)
    rule = cls()
    motion = random_motion(SMPL24, 40, turn_rad=0.05, step_m=0.005)
    joints = motion.joints()
    joints.setflags(write=False)
    labels = rule(joints, FPS, SMPL24)
    require(labels.shape == (40, 4), f"labels are (T, 4), not {labels.shape}")
    require(labels.dtype == np.float32 and set(np.unique(labels)) <= {0.0, 1.0}, "labels are 0 or 1, float32")
    require(np.array_equal(rule(joints, FPS, SMPL24), labels), "equal motion gives equal labels")
    require(rule(joints[:1], FPS, SMPL24).shape == (1, 4), "a motion of one frame has labels")
    # Sideways only: rules may look at the height.
    require(
        np.array_equal(rule(np.add(joints, (2.0, 0.0, -3.0)), FPS, SMPL24), labels), "labels do not depend on x and z"
    )


def check_key_motion(cls: type[Any]) -> None:
    """Check a finder of key motions: one row a frame, finite, deterministic, one frame, stillness."""
    check_plugin(cls)
    finder = cls()
    _check_columns(finder.columns)
    require(finder.columns.mirror is not None, "its columns have a mirror image, so that clips can be mirrored")
    motion = random_motion(SMPL24, 40, turn_rad=0.05, step_m=0.005)
    rows = finder.analyse(motion)
    require(rows.shape == (40, finder.columns.width), f"rows are (T, {finder.columns.width}), not {rows.shape}")
    require(rows.dtype == np.float32 and bool(np.isfinite(rows).all()), "rows are finite float32")
    require(np.array_equal(finder.analyse(motion), rows), "equal motion gives equal rows")
    still = Motion(np.zeros((30, 3)), np.zeros((30, SMPL24.n_joints, 3)), FPS, SMPL24)
    for short in (motion.part(0, 1), motion.part(0, 2), still):
        short_rows = finder.analyse(short)
        require(
            short_rows.shape == (short.n_frames, finder.columns.width),
            "a motion of one frame, or a still one, has rows",
        )
        require(bool(np.isfinite(short_rows).all()), "stillness gives finite rows")


def check_audio_feature(cls: type[Any]) -> None:
    """Check an audio feature; ``make_example(folder)`` of one that needs files returns it on small ones."""
    check_plugin(cls)
    with tempfile.TemporaryDirectory() as folder:
        make = _RANDOM_WEIGHTS.get(cls, cls.make_example)
        _check_audio_feature(make(Path(folder)))


def _random_encoder(folder: Path) -> HuggingFace:
    from dancedata.testing.encoders import write_random_model

    write_random_model("mert", folder)
    return HuggingFace(model=str(folder), layers=(2,), device="cpu").resolved(sha256_file)


def _random_jukebox(folder: Path) -> Jukebox:
    from dancedata.testing.jukebox import random_checkpoint

    random_checkpoint(folder)
    return Jukebox(weights=folder, layer=6, device="cpu").resolved(sha256_file)


#: Examples of our own features that need weights.
_RANDOM_WEIGHTS: dict[type[Any], Callable[[Path], Any]] = {HuggingFace: _random_encoder, Jukebox: _random_jukebox}


def _check_audio_feature(feature: Any) -> None:
    _check_columns(feature.columns)
    require(bool(feature.packages), "packages names what the numbers depend on")
    require(feature.dtype in get_args(DType), f"dtype on disk is one of {get_args(DType)}, not {feature.dtype}")
    is_code = feature.dtype not in ("float32", "float16")
    require(is_code == (feature.codebook is not None), "whole numbers have a codebook, real values have none")
    if isinstance(feature, FileFeature):
        refused = "a signal, of which there is no file, is an error"
        raises(DanceDataError, lambda: feature.extract(random_signal(2.0, 44100), feature.grid), refused)
        return
    for seconds, rate in ((0.1, 22050), (2.0, 44100), (3.33, 48000)):
        for signal in (random_signal(seconds, rate), AudioSignal(np.zeros(int(seconds * rate), np.float32), rate)):
            _check_rows(feature, signal, feature.extract(signal, FPS, start_bpm=110.0), FPS)
    signal = random_signal(3.0, 16000)
    first, second = feature.extract(signal, FPS), feature.extract(signal, FPS)
    require(np.array_equal(first, second), "equal signals give equal rows")
    windows = feature.extract_windows(signal, np.array([0, 7_999]), 32_000, FPS, 60)
    require(windows.shape == (2, 60, feature.columns.width), f"windows are (W, n_rows, D), not {windows.shape}")
    require(bool(np.isfinite(windows).all()), "windows are finite")
    empty = AudioSignal(np.zeros(0, np.float32), 16000)
    raises(DanceDataError, lambda: feature.extract(empty, FPS), "a signal without samples is an error")
    beyond = np.array([20_000])
    raises(
        DanceDataError,
        lambda: feature.extract_windows(signal, beyond, 32_000, FPS, 60),
        "no window beyond the signal",
    )
    for grid in (FrameGrid.of("1/7"), FrameGrid.of("30000/1001"), FrameGrid.of(25)):
        try:
            rows = feature.extract(signal, grid, start_bpm=110.0)
        except DanceDataError:
            continue
        _check_rows(feature, signal, rows, grid)


def check_augmentation(cls: type[Augmentation], folder: Path) -> None:
    """Check an augmentation in an empty folder: copies that are built, samples, windows and masks of readers."""
    check_plugin(cls)
    if issubclass(cls, CopyAugmentation):
        _check_makes_copies(cls, folder)
    if issubclass(cls, SampleAugmentation):
        check_samples(cls())
        check_starts(cls())
        check_drops(cls())


def _check_makes_copies(cls: type[CopyAugmentation], folder: Path) -> None:
    augmentation, spec = cls(), Copy(cls.name, cls())
    fields = [field for field in example_fields() if _accepts(augmentation, field.columns)]
    motions = [field.name for field in fields if field.kind == "motion"]
    require(bool(motions), "`check` accepts the columns of a representation")
    require(cls.changes in ("rows", "motion", "time"), "changes is rows, motion or time")
    for skeleton in (SMPL24, SMPLX55):
        _check_changed_motion(spec, random_motion(skeleton, 40))
    for field in fields:
        for array in (field.rows, field.rows[None, :20], field.rows[:1]):
            first, second = (spec.rows_of(array, field.columns, field.kind, "clip") for _ in range(2))
            require(bool(np.isfinite(first).all()), "rows of copies are finite")
            require(np.array_equal(first, second), "equal rows give equal copies")
    whole: tuple[str, list[Any]] = ("whole", [])
    for name, transforms in (whole, ("slices", SLICES)) if cls.changes != "time" else (whole,):
        _check_copies(spec, motions[0], transforms, folder / name)


def check_window_filter(cls: type[WindowFilter]) -> None:
    """Check a window filter: what it returns, that equal windows get equal answers, and that recipes take it."""
    check_plugin(cls)
    window_filter = cls()
    require(cls.reason in BY_CHOICE, f"reason is one of {', '.join(sorted(BY_CHOICE))}")
    require(isinstance(window_filter.field, str) and bool(window_filter.field), "field names a field")
    require(
        bool(window_filter.splits) and all(isinstance(s, str) for s in window_filter.splits), "splits names splits"
    )
    fields = [field for field in example_fields() if _accepts(window_filter, field.columns)]
    require(bool(fields), "`check` accepts the columns of a representation or of key motions")
    for field in fields:
        for rows in (field.rows, field.rows[:1], np.zeros_like(field.rows), 1000 * field.rows):
            rows.setflags(write=False)
            reject = window_filter.reject(rows, field.columns, FPS)
            require(
                reject == window_filter.reject(rows.copy(), field.columns, FPS), "equal windows get equal answers"
            )
            if reject is not None:
                require(reject.reason == cls.reason, f"rejects have the reason {cls.reason}, not {reject.reason}")
                require(bool(reject.detail), "rejects have a detail")
                require(json.loads(json.dumps(reject.to_json())) == reject.to_json(), "rejects are JSON")
    for field in (field for field in fields if field.name == window_filter.field):
        recipe_with(dataset="synthetic", keys={"rules": {cls.name: {}}, field.kind: {field.name: {}}})


def check(cls: type[Plugin], folder: Path) -> None:
    """Check a plug-in of any kind; `folder` is an empty folder to work in."""
    _CHECKS[registry_of(cls).kind](cls, folder)


#: The check of each kind of plug-in.
_CHECKS: dict[str, Callable[[type[Any], Path], None]] = {
    DATASETS.kind: check_dataset,
    REPRESENTATIONS.kind: lambda cls, folder: check_representation(cls),
    CONTACTS.kind: lambda cls, folder: check_contact_rule(cls),
    KEYMOTIONS.kind: lambda cls, folder: check_key_motion(cls),
    FEATURES.kind: lambda cls, folder: check_audio_feature(cls),
    AUGMENTATIONS.kind: check_augmentation,
    FILTERS.kind: lambda cls, folder: check_window_filter(cls),
    FIELDS.kind: lambda cls, folder: check_field(cls),
    TRANSFORMS.kind: lambda cls, folder: check_transform(cls),
    ANNOTATORS.kind: lambda cls, folder: check_annotator(cls),
    RULES.kind: lambda cls, folder: check_rule(cls),
    METRICS.kind: lambda cls, folder: check_metric(cls),
    EXPORTS.kind: check_export,
}


def _check_columns(columns: Any) -> None:
    labels = columns.labels
    require(len(labels) == columns.width == len(set(labels)), "every column has a unique label")
    require(json.loads(json.dumps(columns.to_json())) == columns.to_json(), "columns are JSON")


def _accepts(plugin: CopyAugmentation | WindowFilter, columns: Columns) -> bool:
    try:
        plugin.check(columns)
    except UsageError:
        return False
    return True


def _check_changed_motion(spec: Copy, motion: Motion) -> None:
    before = motion.translation.copy(), motion.rotations.copy()
    one, two = spec.motion_of(motion, "clip"), spec.motion_of(motion, "clip")
    equal = np.array_equal(one.translation, two.translation) and np.array_equal(one.rotations, two.rotations)
    require(equal, "equal motions give equal copies")
    untouched = np.array_equal(before[0], motion.translation) and np.array_equal(before[1], motion.rotations)
    require(untouched, "change_motion does not write into the motion")
    require(one.skeleton.joints == motion.skeleton.joints, "the copy has the joints of the motion")
    require(one is motion or spec.augmentation.changes != "rows", "copies by change_motion are declared: changes")
    require(spec.motion_of(motion.part(0, 1), "clip").n_frames == 1, "a motion of one frame can be copied")


def _check_copies(spec: Copy, motion: str, transforms: Sequence[Any], folder: Path) -> None:
    from dancedata.building.build import build
    from dancedata.store import open_store, verify_store

    source, out = folder / "source", folder / "out"
    DATASETS.get("synthetic")().make_example(source)
    keys = {"motion": {motion: {}}, "augment": {spec.name: {}}, "transforms": transforms}
    recipe = recipe_with(dataset="synthetic", keys=keys)
    build(recipe, source, out, cache=folder / "cache")
    errors = [str(p) for p in verify_store(out) if p.severity == "error"]
    require(not errors, f"a dataset with copies is sound: {errors}")
    with open_store(out) as store:
        train = [c.id for c in store if c.split == "train" and not c.source]
        copies = {c.source: c.id for c in store if c.source}
        require(bool(train), "the example has clips to train on")
        require(copies == {c: spec.clip_id(c) for c in train}, "every train clip, and no other, has a copy")
        counts = {c: len(store[c].windows()) for pair in copies.items() for c in pair}
        if spec.augmentation.changes == "time":
            return
        require(all(counts[c] == counts[spec.clip_id(c)] for c in train), "copies have the windows of their clips")


def _check_rows(feature: Any, signal: AudioSignal, rows: npt.NDArray[Any], grid: FrameGrid) -> None:
    announced = feature.n_rows(signal.n_samples, signal.sample_rate, grid), feature.columns.width
    require(rows.shape == announced, f"rows are {announced} as n_rows says, not {rows.shape}")
    require(rows.dtype.name == feature.dtype, f"rows are {feature.dtype}, not {rows.dtype}")
    require(bool(np.isfinite(rows).all()), "rows are finite, for silence too")


def _check_same(motion: Motion, wanted: Motion, translation_m: float, expected: str) -> None:
    from dancedata.core.rotations import rotation

    angle = (rotation(motion.rotations).inv() * rotation(wanted.rotations)).magnitude().max()
    shift = np.abs(motion.translation - wanted.translation).max()
    found = f"off by {angle:.2g} rad and {shift:.2g} m"
    require(bool(angle < ANGLE_TOLERANCE and shift < translation_m), f"{expected}; {found}")
    require(motion.grid == wanted.grid and motion.skeleton == wanted.skeleton, f"{expected}, rate and skeleton too")
