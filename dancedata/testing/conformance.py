"""Checks that every plug-in has to pass, for authors of plug-ins too: call them from a test.

::

    from dancedata.testing.conformance import check

    def test_conformance(tmp_path):
        check(MyDataset, tmp_path)

`check` calls the check of the plug-in's kind. The class has to be registered (`@DATASETS.register("mine")`) and to
work with its default parameters. A failure is an AssertionError with what was expected.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.audio_signal import AudioSignal
from dancedata.core.bodies import SMPLX55
from dancedata.core.clip import Scan
from dancedata.core.columns import Columns
from dancedata.core.dance import OUTCOMES, Dance, Undefined
from dancedata.core.errors import DanceDataError, SourceError, StoreError, UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import Augmentation, Export, Metric, Plugin, WindowFilter
from dancedata.core.registry import (
    AUGMENTATIONS,
    CONTACTS,
    DATASETS,
    EXPORTS,
    FEATURES,
    FILTERS,
    KEYMOTIONS,
    METRICS,
    REGISTRIES,
    REPRESENTATIONS,
    Registry,
)
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.spatial import Placement, moved
from dancedata.exporting.place import ABOUT, read_about
from dancedata.exporting.run import export_dataset
from dancedata.pipeline.rejects import BY_CHOICE
from dancedata.recipes.copies import CopySpec
from dancedata.testing.examples import (
    FPS,
    contact_rule_of,
    example_dances,
    example_fields,
    mirrored_motion,
    random_motion,
    random_signal,
)
from dancedata.testing.require import require as _require
from dancedata.testing.sample_checks import check_drops, check_samples, check_starts
from dancedata.testing.stores import random_fields, write_random_store

#: Radians and metres: what float32 columns may lose.
ANGLE_TOLERANCE = 1e-4
TRANSLATION_TOLERANCE = 1e-6
#: Nobody's skeleton.
ODD_SKELETON = Skeleton("odd", ("root", "tail"), (-1, 0), np.zeros((2, 3)), (), (0, 0, 1, 1))


def check_dataset(cls: type[Any], folder: Path) -> None:
    """Check a dataset reader: its example scans, loads, and builds in both scopes; bad folders are named.

    Parameters
    ----------
    folder
        An empty folder to work in.
    """
    check_plugin(cls)
    _require(bool(cls.licence and cls.citation), "licence and citation say something")
    reader, sources = cls(), [folder / "an example", folder / "again"]
    for source in sources:
        reader.make_example(source)
    scan, other = (reader.scan(source) for source in sources)
    _check_scan(scan)
    _require(reader.scan(sources[0]) == scan, "two scans of a folder are equal")
    _require([c.id for c in other.clips] == [c.id for c in scan.clips], "two examples hold the same clips")
    for ref, same in zip(scan.clips, other.clips, strict=True):
        motion, again = reader.load(ref), reader.load(same)
        _check_motion(motion, ref.id)
        for name in ("translation", "rotations"):
            equal = np.array_equal(getattr(motion, name), getattr(again, name))
            _require(equal, f"clip {ref.id}: two loads give equal {name}")
    _check_bad_sources(reader, folder)
    for scope in ("track", "window"):
        recipe = recipe_with(dataset=cls.name, scope=scope, skeleton=reader.load(scan.clips[0]).skeleton)
        _check_build(recipe, scan, sources[0], folder / scope)


def check_representation(cls: type[Any]) -> None:
    """Check a representation: columns, dtype, decoding, mirroring, one frame, another skeleton."""
    check_plugin(cls)
    made, rule = cls(), contact_rule_of(cls())
    _check_columns(made.columns)
    motion = random_motion(made.skeleton, 40)
    before = motion.translation.copy(), motion.rotations.copy()
    array = made.encode(motion, rule)
    _require(array.shape == (40, made.columns.width), f"encode gives (T, {made.columns.width}), not {array.shape}")
    _require(array.dtype == np.float32, f"encode gives float32, not {array.dtype}")
    _require(bool(np.isfinite(array).all()), "encode gives finite values")
    untouched = np.array_equal(before[0], motion.translation) and np.array_equal(before[1], motion.rotations)
    _require(untouched, "encode does not write into the motion")
    one = made.encode(motion.part(0, 1), rule)
    _require(one.shape == (1, made.columns.width), "a motion of one frame can be encoded")
    odd = Motion(np.zeros((2, 3)), np.zeros((2, 2, 3)), FPS, ODD_SKELETON)
    _raises(UsageError, lambda: made.encode(odd, rule), "a motion on another skeleton is a UsageError")
    mirror = made.columns.mirror
    if mirror is not None:
        _require(np.array_equal(mirror.apply(mirror.apply(array)), array), "mirroring twice gives back the columns")
    _check_spatial(made, motion, array)
    if made.decodes and made.fits:
        decoded = made.decode(array, FPS)
        _require(decoded.n_frames == 40 and decoded.grid == FPS, "decode gives as many frames, at the rate asked for")
    elif made.decodes:
        decoded = made.decode(array, FPS)
        wanted = motion
        if made.grounded:
            shift = decoded.translation[0] * (0, 1, 0) - motion.translation[0] * (0, 1, 0)
            wanted = Motion(motion.translation + shift, motion.rotations, motion.grid, motion.skeleton)
        _check_same(decoded, wanted, TRANSLATION_TOLERANCE, "decode gives back the motion")
        if mirror is not None:
            image = made.decode(mirror.apply(array), FPS)
            _check_same(
                image, mirrored_motion(wanted), TRANSLATION_TOLERANCE, "mirrored columns are the mirrored motion's"
            )


def _check_spatial(made: Any, motion: Motion, array: npt.NDArray[Any]) -> None:
    """Check that columns that are turned and shifted are those of the motion that is turned and shifted."""
    if made.spatial is None:
        return
    made.spatial.check(made.columns)
    by = Placement(turn_rad=1.2, x_m=0.4, z_m=-0.7)
    wanted = made.encode(moved(motion, by), contact_rule_of(made))
    found = made.spatial.moved(array, made.columns, by)
    _require(bool(np.abs(found - wanted).max() < 1e-5), "`spatial` turns columns as `encode` turns with the motion")


def check_contact_rule(cls: type[Any]) -> None:
    """Check a contact rule: shape, values, one frame, and that it does not matter where in the room one dances."""
    check_plugin(cls)
    rule = cls()
    motion = random_motion(SMPL24, 40, turn_rad=0.05, step_m=0.005)
    joints = motion.joints()
    joints.setflags(write=False)
    labels = rule(joints, FPS, SMPL24)
    _require(labels.shape == (40, 4), f"labels are (T, 4), not {labels.shape}")
    _require(labels.dtype == np.float32 and set(np.unique(labels)) <= {0.0, 1.0}, "labels are 0 or 1, float32")
    _require(np.array_equal(rule(joints, FPS, SMPL24), labels), "equal motion gives equal labels")
    _require(rule(joints[:1], FPS, SMPL24).shape == (1, 4), "a motion of one frame has labels")
    # Sideways only: rules may look at the height.
    _require(
        np.array_equal(rule(np.add(joints, (2.0, 0.0, -3.0)), FPS, SMPL24), labels), "labels do not depend on x and z"
    )


def check_key_motion(cls: type[Any]) -> None:
    """Check a finder of key motions: one row a frame, finite, deterministic, one frame, stillness."""
    check_plugin(cls)
    made = cls()
    _check_columns(made.columns)
    _require(made.columns.mirror is not None, "its columns have a mirror image, so that clips can be mirrored")
    motion = random_motion(SMPL24, 40, turn_rad=0.05, step_m=0.005)
    rows = made.analyse(motion)
    _require(rows.shape == (40, made.columns.width), f"rows are (T, {made.columns.width}), not {rows.shape}")
    _require(rows.dtype == np.float32 and bool(np.isfinite(rows).all()), "rows are finite float32")
    _require(np.array_equal(made.analyse(motion), rows), "equal motion gives equal rows")
    still = Motion(np.zeros((30, 3)), np.zeros((30, SMPL24.n_joints, 3)), FPS, SMPL24)
    for short in (motion.part(0, 1), motion.part(0, 2), still):
        found = made.analyse(short)
        _require(
            found.shape == (short.n_frames, made.columns.width), "a motion of one frame, or a still one, has rows"
        )
        _require(bool(np.isfinite(found).all()), "stillness gives finite rows")


def check_audio_feature(cls: type[Any]) -> None:
    """Check an audio feature: rows as announced, finite, deterministic, windows, silence, and what it refuses.

    One that needs files, such as a network's weights, has a class method ``make_example(folder)`` that writes small
    ones and returns the feature on them.
    """
    check_plugin(cls)
    with tempfile.TemporaryDirectory() as folder:
        _check_audio_feature(cls.make_example(Path(folder)))


def _check_audio_feature(made: Any) -> None:
    _check_columns(made.columns)
    _require(bool(made.packages), "packages names what the numbers depend on")
    _require(made.dtype in ("float32", "float16"), f"dtype on disk is float32 or float16, not {made.dtype}")
    for seconds, rate in ((0.1, 22050), (2.0, 44100), (3.33, 48000)):
        for signal in (random_signal(seconds, rate), AudioSignal(np.zeros(int(seconds * rate), np.float32), rate)):
            _check_rows(made, signal, made.extract(signal, FPS, start_bpm=110.0), FPS)
    signal = random_signal(3.0, 16000)
    first, second = made.extract(signal, FPS), made.extract(signal, FPS)
    _require(np.array_equal(first, second), "equal signals give equal rows")
    windows = made.extract_windows(signal, np.array([0, 7_999]), 32_000, FPS, 60)
    _require(windows.shape == (2, 60, made.columns.width), f"windows are (W, n_rows, D), not {windows.shape}")
    _require(bool(np.isfinite(windows).all()), "windows are finite")
    empty = AudioSignal(np.zeros(0, np.float32), 16000)
    _raises(DanceDataError, lambda: made.extract(empty, FPS), "a signal without samples is an error")
    beyond = np.array([20_000])
    _raises(
        DanceDataError, lambda: made.extract_windows(signal, beyond, 32_000, FPS, 60), "no window beyond the signal"
    )
    for grid in (FrameGrid.of("1/7"), FrameGrid.of("30000/1001"), FrameGrid.of(25)):
        try:
            rows = made.extract(signal, grid, start_bpm=110.0)
        except DanceDataError:
            continue
        _check_rows(made, signal, rows, grid)


def check_augmentation(cls: type[Augmentation], folder: Path) -> None:
    """Check an augmentation: copies that are built, and samples, windows and masks when a dataset is read.

    Shapes and dtypes are kept, inputs are not written to, equal input gives equal results, refusals say why.

    Parameters
    ----------
    folder
        An empty folder to work in.
    """
    check_plugin(cls)
    reads = cls.changes_samples or cls.chooses_windows or cls.drops_fields
    _require(cls.makes_copies or reads, "it defines a method that makes copies or changes samples")
    if cls.makes_copies:
        _check_makes_copies(cls, folder)
    if cls.changes_samples:
        check_samples(cls())
    if cls.chooses_windows:
        check_starts(cls())
    if cls.drops_fields:
        check_drops(cls())


def _check_makes_copies(cls: type[Augmentation], folder: Path) -> None:
    made, spec = cls(), CopySpec(cls.name, cls())
    fields = [field for field in example_fields() if _accepts(made, field.columns)]
    motions = [field.name for field in fields if field.kind == "motion"]
    _require(bool(motions), "`check` accepts the columns of a representation")
    for skeleton in (SMPL24, SMPLX55) if cls.changes_motion else ():
        _check_changed_motion(spec, random_motion(skeleton, 40))
    for field in fields:
        for array in (field.rows, field.rows[None, :20], field.rows[:1]):
            first, second = (spec.rows_of(array, field.columns, field.kind, "clip") for _ in range(2))
            _require(bool(np.isfinite(first).all()), "rows of copies are finite")
            _require(np.array_equal(first, second), "equal rows give equal copies")
    for scope in ("track", "window"):
        _check_copies(spec, motions[0], scope, folder / scope)


def check_window_filter(cls: type[WindowFilter]) -> None:
    """Check a window filter: what it returns, that equal windows get equal answers, and that recipes take it."""
    check_plugin(cls)
    made = cls()
    _require(cls.reason in BY_CHOICE, f"reason is one of {', '.join(sorted(BY_CHOICE))}")
    _require(isinstance(made.field, str) and bool(made.field), "field names a field")
    _require(bool(made.splits) and all(isinstance(s, str) for s in made.splits), "splits names splits")
    fields = [field for field in example_fields() if _accepts(made, field.columns)]
    _require(bool(fields), "`check` accepts the columns of a representation or of key motions")
    for field in fields:
        for rows in (field.rows, field.rows[:1], np.zeros_like(field.rows), 1000 * field.rows):
            rows.setflags(write=False)
            found = made.reject(rows, field.columns, FPS)
            _require(found == made.reject(rows.copy(), field.columns, FPS), "equal windows get equal answers")
            if found is not None:
                _require(found.reason == cls.reason, f"rejects have the reason {cls.reason}, not {found.reason}")
                _require(bool(found.detail), "rejects have a detail")
                _require(json.loads(json.dumps(found.to_json())) == found.to_json(), "rejects are JSON")
    for field in (field for field in fields if field.name == made.field):
        windows = {"length_frames": 30, "stride_frames": 15, "filter": {cls.name: {}}}
        recipe_with(dataset="synthetic", keys={"windows": windows, field.kind: {field.name: {}}})


def check_metric(cls: type[Metric]) -> None:
    """Check a metric: finite numbers or a named outcome, equal dances get equal numbers, scores, order of clips."""
    check_plugin(cls)
    made = cls()
    width = len(made.columns)
    _require(bool(cls.source), "source says where the definition is from")
    _require(width > 0 and len(set(made.columns)) == width, "every number of a clip has a name of its own")
    rows = [row for row in (_measured(made, dance) for dance in example_dances()) if row is not None]
    _require(len(rows) >= 2, "ordinary dances have values")
    table = np.array(rows)
    before = table.copy()
    scores = made.summarise(table, table if cls.needs_pool else None)
    _require(np.array_equal(table, before), "summarise does not write into the rows")
    _require(bool(scores) and all(np.isfinite(value) for value in scores.values()), "scores are finite numbers")
    _require(set(cls.better) <= scores.keys(), f"better names scores: {', '.join(scores)}")
    _require(bool(cls.better), "better says what is better for a score")
    turned = made.summarise(table[::-1], table[::-1] if cls.needs_pool else None)
    close = scores.keys() == turned.keys() and all(np.isclose(turned[k], scores[k], atol=1e-9) for k in scores)
    _require(close, "scores do not depend on the order of clips")
    if cls.needs_pool:
        _raises(UsageError, lambda: made.summarise(table), "a metric that needs a pool asks for it")
    _raises(Undefined, lambda: made.summarise(table[:0], table), "a set without clips is Undefined")


def check_export(cls: type[Export], folder: Path) -> None:
    """Check an export: its own recipe suffices, equal bytes every time, nothing in folders that a loader lists.

    Parameters
    ----------
    folder
        An empty folder to work in.
    """
    check_plugin(cls)
    made, folder = cls(), folder.absolute()
    source, store = build_for_export(made, folder)
    outs = [folder / "one" / "export", folder / "two" / "export"]
    for out in outs:
        done = export_dataset(store, made, out, source=source, link=out is outs[1])
        _require(done.path == out, "the result names the folder")
    _check_exported(made, *outs)
    _raises(StoreError, lambda: export_dataset(store, made, outs[0], source=source), "a second one there is an error")
    _check_refusal(made, folder, source)


def build_for_export(made: Export, folder: Path) -> tuple[Path, Path]:
    """Build a small dataset from an export's own recipe; returns its source and the dataset."""
    from dancedata.pipeline.build import build
    from dancedata.recipes.parse import parse_recipe

    document = {
        "recipe": 1,
        "name": "conformance",
        "dataset": {"aist++": {}},
        "windows": {"length_s": 5, "stride_s": 0.5},
        **made.recipe,
    }
    recipe, source, store = parse_recipe(document), folder / "source", folder / "store"
    recipe.dataset.make_example(source)
    build(recipe, source, store, cache=folder / "cache")
    return source, store


def _check_exported(made: Export, one: Path, two: Path) -> None:
    listed = [{p.relative_to(f).as_posix(): p for p in f.rglob("*") if p.is_file()} for f in (one, two)]
    _require(listed[0].keys() == listed[1].keys(), "two exports have the same files")
    for name, path in listed[0].items():
        here, there = (str(folder).encode() for folder in (one, two))
        if name not in (ABOUT, "README.md"):  # these name the links, if there are any
            same = path.read_bytes().replace(here, there) == listed[1][name].read_bytes()
            _require(same, f"two exports of a dataset have equal bytes: {name}")
    about = read_about(one)
    _require(about is not None, "export.json is whole")
    _require(about is not None and set(about["files"]) == listed[0].keys() - {ABOUT}, "export.json lists all files")
    for folder in made.listed_folders:
        _require((one / folder).is_dir(), f"the folder {folder} that a loader lists is there")
    own = {"README.md", ABOUT, "LICENCE.txt"}
    inside = [name for name in listed[0] if Path(name).name in own and len(Path(name).parts) > 1]
    _require(not inside, f"README, licence and export.json are not among the files of a loader: {inside}")
    _require(bool(made.guide.__doc__) and len((one / "README.md").read_text()) > 200, "README.md explains the files")
    leftovers = [p.name for p in one.parent.iterdir() if p != one]
    _require(not leftovers, f"nothing is left beside the export: {leftovers}")


def _check_refusal(made: Export, folder: Path, source: Path) -> None:
    """Check the error for a dataset of two odd columns at an odd rate, where that is not enough."""
    fields = random_fields({"odd": 2}, {}, odd=10)
    bare = write_random_store(folder / "bare", fields=fields, fps=Fraction(10), length=20, stride=10).path
    try:
        export_dataset(bare, made, folder / "refused" / "export", source=source)
    except StoreError as error:
        _require("fix: " in str(error), f"an error has the line of a recipe that helps: {error}")
        _require(not (folder / "refused").exists(), "nothing is written where something is lacking")


def check(cls: type[Plugin], folder: Path) -> None:
    """Check a plug-in of any kind; `folder` is an empty folder to work in."""
    _CHECKS[_registry_of(cls).kind](cls, folder)


#: The check of each kind of plug-in.
_CHECKS: dict[str, Callable[[type[Any], Path], None]] = {
    DATASETS.kind: check_dataset,
    REPRESENTATIONS.kind: lambda cls, folder: check_representation(cls),
    CONTACTS.kind: lambda cls, folder: check_contact_rule(cls),
    KEYMOTIONS.kind: lambda cls, folder: check_key_motion(cls),
    FEATURES.kind: lambda cls, folder: check_audio_feature(cls),
    AUGMENTATIONS.kind: check_augmentation,
    FILTERS.kind: lambda cls, folder: check_window_filter(cls),
    METRICS.kind: lambda cls, folder: check_metric(cls),
    EXPORTS.kind: check_export,
}


def check_plugin(cls: type[Any]) -> None:
    """Check what all plug-ins share: a frozen dataclass whose fields are documented keys of a recipe."""
    _require(dataclasses.is_dataclass(cls), f"{cls.__name__} is a dataclass")
    _require(bool(cls.__dataclass_params__.frozen), f"{cls.__name__} is frozen")
    _require(type(cls.version) is int and cls.version > 0, "version is a whole number above 0")
    text = inspect.getdoc(cls) or ""
    _require(bool(text) and not text.startswith(f"{cls.__name__}("), f"{cls.__name__} has a docstring")
    for field in dataclasses.fields(cls):
        _require(re.search(rf"^{field.name}\b", text, re.M) is not None, f"the docstring describes {field.name}")
    from dancedata.recipes.documents import document_of
    from dancedata.recipes.plugins import make_plugin, one_of

    problems: list[str] = []
    registry = _registry_of(cls)
    made = make_plugin(registry, "plugin", cls.name, {}, problems)
    _require(not problems, f"the defaults are valid parameters: {problems}")
    document = document_of(made)
    again = one_of(registry, "plugin", json.loads(json.dumps({cls.name: document})), problems)
    _require(not problems, f"what a dataset says of its recipe can be read again: {problems}")
    _require(again == made and document_of(again) == document, "parameters survive the way through JSON")
    make_plugin(registry, "plugin", cls.name, {"no_such_key": 1}, problems)
    _require(any("no_such_key" in p for p in problems), "a key that no field has is an error")


def recipe_with(
    *, dataset: str, scope: str = "track", skeleton: Skeleton = SMPL24, keys: Mapping[str, Any] | None = None
) -> Any:
    """Return a recipe of one dataset, joint positions of its skeleton, no audio; `keys` replace or add keys."""
    from dancedata.recipes.parse import parse_recipe

    document = {
        "recipe": 1,
        "name": "conformance",
        "dataset": {dataset: {}},
        "scope": scope,
        "windows": {"length_frames": 30, "stride_frames": 15},
        "motion": {"joints": {"body": skeleton.to_json()}},
        **(keys or {}),
    }
    recipe = parse_recipe(document)
    again = parse_recipe(json.loads(json.dumps(recipe.document)))
    _require(again.sha256 == recipe.sha256, "a recipe with its defaults spelled out is the same recipe")
    return recipe


def _raises(kind: type[Exception], call: Callable[[], object], expected: str) -> str:
    try:
        call()
    except kind as error:
        return str(error)
    raise AssertionError(f"expected: {expected}")


def _registry_of(cls: type[Any]) -> Registry[Any]:
    for registry in REGISTRIES.values():
        if cls in (registry.get(name) for name in registry.names()):
            return registry
    raise AssertionError(f"expected: {cls.__name__} is registered")


def _check_columns(columns: Any) -> None:
    labels = columns.labels
    _require(len(labels) == columns.width == len(set(labels)), "every column has a label of its own")
    _require(json.loads(json.dumps(columns.to_json())) == columns.to_json(), "columns are JSON")


def _check_scan(scan: Scan) -> None:
    from dancedata.audio.signal import load_audio
    from dancedata.store.schema import check_name

    ids = [c.id for c in scan.clips]
    _require(len(ids) >= 2, "the example has two clips or more")
    _require(ids == sorted(set(ids)), "clips have ids of their own and are sorted by them")
    for ref in scan.clips:
        check_name(ref.split, "split")
        _require(ref.motion_path.is_file(), f"clip {ref.id}: the motion file is there")
        _require(ref.audio_path is not None and ref.audio_path.is_file(), f"clip {ref.id}: the music is there")
    for path in {c.audio_path for c in scan.clips if c.audio_path is not None}:
        _require(load_audio(path).n_samples > 0, f"{path}: the music can be decoded")


def _check_motion(motion: Motion, clip: str) -> None:
    for array in (motion.translation, motion.rotations):
        _require(array.dtype == np.float64 and not array.flags.writeable, f"clip {clip}: float64 and read-only")
    _require(motion.n_frames * motion.grid.seconds(1) >= 2, f"clip {clip}: two seconds or more")
    # Metres and +Y up: a dancer's head is above the feet most of the time, and within arm's reach of 1.5 m.
    joints = motion.joints()
    height = np.median(joints[..., 1].max(axis=1) - joints[..., 1].min(axis=1))
    _require(0.5 < height < 3.0, f"clip {clip}: metres, +Y up; the dancer is {height:.3g} m high")


def _check_bad_sources(reader: Any, folder: Path) -> None:
    file, empty, missing = folder / "a file", folder / "empty", folder / "missing"
    file.write_bytes(b"")
    empty.mkdir()
    # A dataset that makes its own source fills what is empty.
    for bad in (file,) if getattr(reader, "generates", False) else (file, empty, missing):
        text = _raises(SourceError, lambda bad=bad: reader.scan(bad), f"{bad.name}: a SourceError")  # type: ignore[misc]
        _require(str(bad) in text, f"the error names the source: {text}")


def _check_build(recipe: Any, scan: Scan, source: Path, out: Path) -> None:
    from dancedata.pipeline.build import build
    from dancedata.store import open_store, verify_store

    build(recipe, source, out, cache=out.parent / "cache")
    errors = [str(p) for p in verify_store(out) if p.severity == "error"]
    _require(not errors, f"the example's dataset is sound: {errors}")
    field = recipe.motion[0]
    with open_store(out) as store:
        _require(
            sorted(c.id for c in store.clips) == [c.id for c in scan.clips], "every clip of the example is built"
        )
        for split in store.splits:
            rows = store.read(store.windows(split)[0], field.name)
            _require(rows.shape == (30, field.representation.columns.width), f"a window of {split} can be read")


def _measured(made: Metric, dance: Dance) -> npt.NDArray[np.float64] | None:
    """Return the numbers of a dance, or None where they are undefined."""
    try:
        row = made.measure(dance)
    except Undefined as outcome:
        _require(outcome.reason in OUTCOMES, f"outcomes are one of {', '.join(OUTCOMES)}")
        return None
    _require(row.shape == (len(made.columns),), f"measure gives ({len(made.columns)},), not {row.shape}")
    _require(row.dtype == np.float64, f"measure gives float64, not {row.dtype}")
    _require(bool(np.isfinite(row).all()), "numbers are finite; where there is no value, measure raises Undefined")
    _require(np.array_equal(made.measure(dance), row), "equal dances give equal numbers")
    return row


def _accepts(made: Augmentation | WindowFilter, columns: Columns) -> bool:
    try:
        made.check(columns)
    except UsageError:
        return False
    return True


def _check_changed_motion(spec: CopySpec, motion: Motion) -> None:
    before = motion.translation.copy(), motion.rotations.copy()
    one, two = spec.motion_of(motion, "clip"), spec.motion_of(motion, "clip")
    equal = np.array_equal(one.translation, two.translation) and np.array_equal(one.rotations, two.rotations)
    _require(equal, "equal motions give equal copies")
    untouched = np.array_equal(before[0], motion.translation) and np.array_equal(before[1], motion.rotations)
    _require(untouched, "change_motion does not write into the motion")
    _require(one.skeleton.joints == motion.skeleton.joints, "the copy has the joints of the motion")
    _require(spec.motion_of(motion.part(0, 1), "clip").n_frames == 1, "a motion of one frame can be copied")


def _check_copies(spec: CopySpec, motion: str, scope: str, folder: Path) -> None:
    from dancedata.pipeline.build import build
    from dancedata.store import open_store, verify_store

    source, out = folder / "source", folder / "out"
    DATASETS.get("synthetic")().make_example(source)
    recipe = recipe_with(dataset="synthetic", scope=scope, keys={"motion": {motion: {}}, "augment": {spec.name: {}}})
    build(recipe, source, out, cache=folder / "cache")
    errors = [str(p) for p in verify_store(out) if p.severity == "error"]
    _require(not errors, f"a dataset with copies is sound: {errors}")
    with open_store(out) as store:
        train = [c.id for c in store.clips if c.split == "train" and not c.source]
        copies = {c.source: c.id for c in store.clips if c.source}
        _require(bool(train), "the example has clips to train on")
        _require(copies == {c: spec.clip_id(c) for c in train}, "every train clip, and no other, has a copy")
        counts = Counter(window.clip for window in store.windows("train"))
        if spec.augmentation.changes_time:
            return
        _require(all(counts[c] == counts[spec.clip_id(c)] for c in train), "copies have the windows of their clips")


def _check_rows(made: Any, signal: AudioSignal, rows: npt.NDArray[Any], grid: FrameGrid) -> None:
    announced = made.n_rows(signal.n_samples, signal.sample_rate, grid), made.columns.width
    _require(rows.shape == announced, f"rows are {announced} as n_rows says, not {rows.shape}")
    _require(rows.dtype.name == made.dtype, f"rows are {made.dtype}, not {rows.dtype}")
    _require(bool(np.isfinite(rows).all()), "rows are finite, for silence too")


def _check_same(motion: Motion, wanted: Motion, translation_m: float, expected: str) -> None:
    from dancedata.core.rotations import rotation

    angle = (rotation(motion.rotations).inv() * rotation(wanted.rotations)).magnitude().max()
    shift = np.abs(motion.translation - wanted.translation).max()
    found = f"off by {angle:.2g} rad and {shift:.2g} m"
    _require(bool(angle < ANGLE_TOLERANCE and shift < translation_m), f"{expected}; {found}")
    _require(motion.grid == wanted.grid and motion.skeleton == wanted.skeleton, f"{expected}, rate and skeleton too")
