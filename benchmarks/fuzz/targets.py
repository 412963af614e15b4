"""Targets of fuzzing: every reader of untrusted files, with valid files as seeds."""

from __future__ import annotations

import hashlib
import json
import os
import unicodedata
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

import mutations
import numpy as np
from valid_files import (
    MANIFEST,
    RECIPE,
    TABLES,
    body_models,
    bvh,
    encoded,
    joblibs,
    model_pickles,
    npy,
    npz,
    old_torches,
    phalps,
    pickles,
    store,
    torches,
    wav,
)


@dataclass(frozen=True)
class Target:
    """A reader.

    Attributes
    ----------
    file : name of the file that it is given, in a separate folder.
    seeds : makes valid files.
    read : reads the file with everything that is read of such files; raises DanceDataError.
    text : whether lines and words are changed rather than bits.
    also : other names that an error may give for the place of the defect, in addition to the file's.
    """

    format: str
    file: str
    seeds: Callable[[], list[bytes]]
    read: Callable[[Path], None]
    text: bool = False
    also: tuple[str, ...] = ()

    def mutated(self, seeds: list[bytes], rng: Random) -> bytes:
        """Return a broken copy of a seed."""
        if self.file.endswith((".npz", ".pt")) and rng.random() < 0.6:
            return mutations.mutated_members(rng.choice(seeds), rng)
        data = mutations.mutated(seeds, rng, text=self.text)
        return mutations.with_ogg_checksums(data) if self.file.endswith(".ogg") and rng.random() < 0.8 else data


def _read_aist(path: Path) -> None:
    from dancedata.core.clip import ClipRef
    from dancedata.datasets.aistpp import AistPP

    _both(lambda: AistPP().load(ClipRef("a", path, None, "train")), lambda: _read_folder(path))


def _read_finedance(path: Path) -> None:
    from dancedata.datasets.finedance import load_motion

    _both(lambda: load_motion(path), lambda: _read_folder(path))


def _both(first: Callable[[], Any], second: Callable[[], Any]) -> None:
    """Read a file in two ways; the second runs even if the first fails."""
    try:
        first()
    finally:
        second()


def _read_folder(path: Path) -> None:
    from dancedata.datasets.folder.facts import Declared
    from dancedata.datasets.folder.load import Reading, describe, load_motion

    reading = Reading(Declared(), Declared("30", "y", "guess" if path.suffix == ".bvh" else "m"))
    describe(path, reading)
    motion = load_motion(path, reading)
    for array in (motion.translation, motion.rotations, motion.joints()):
        _require(bool(np.isfinite(array).all()), "a motion that is not finite")


def _read_people(path: Path) -> None:
    """Read every person of a file, as a folder does that splits it, and the arrays that a recipe names."""
    from dancedata.core.clip import ClipRef
    from dancedata.core.errors import DataError
    from dancedata.datasets.folder import Folder
    from dancedata.datasets.folder.people import split_people

    clip = ClipRef("a", path, None, "train")
    clips, rejects = split_people([clip], [])
    _require_plain("".join(reject.detail for reject in rejects))
    keys = {"rotation": "pose", "translation": "trans", "scale": "frame_ids"}
    for ref in (clip, *clips[:20]):
        with suppress(DataError):
            Folder(fps=30, up="-y", unit="m", keys=keys).load(ref)
    for ref in clips[:20]:
        Folder(fps=30, people="split").load(ref)


def _read_body_model(path: Path) -> None:
    from dancedata.core.skeleton import SMPL24
    from dancedata.formats.body_model import body_model_skeleton

    skeleton = body_model_skeleton(path, joints=SMPL24, betas=[0.5, -1.0])
    _require(bool(np.isfinite(skeleton.offsets).all()), "a skeleton that is not finite")


def _no_ffmpeg() -> str:
    from dancedata.core.errors import UsageError

    raise UsageError("this process starts no other")


def _read_audio(path: Path) -> None:
    from dancedata.core.packages import install
    from dancedata.music import ffmpeg
    from dancedata.music.samples import resample
    from dancedata.music.signal import audio_length, load_audio

    install("video")  # loads what an error's text needs, before anything is watched
    ffmpeg.find_ffmpeg = _no_ffmpeg  # ffmpeg reads in a process of its own; this hunts what is read here
    length, rate = audio_length(path)
    signal = load_audio(path)
    _require(bool(np.isfinite(signal.samples).all()), "samples that are not finite")
    # What features do first; a low rate makes many samples of few.
    resample(signal.samples, rate, 15_360)
    _require((signal.n_samples, signal.sample_rate) == (length, rate), "length differs from the header's")


def _read_label(path: Path) -> None:
    from dancedata.datasets.finedance import read_genre
    from dancedata.datasets.published import LeftOut

    try:
        _require(bool(read_genre(path, path.stem)), "neither a genre nor a reason")
    except LeftOut as why:
        _require(path.name in str(why), "a problem that does not name the file")


def _read_recipe(path: Path) -> None:
    from dancedata.recipes.parse import load_recipe

    _require(len(load_recipe(path).sha256) == 64, "no hash")


def _read_manifest(path: Path) -> None:
    from dancedata.datasets.folder import Folder

    for name in ("a/b.bvh", "a/c.npz", "d.npy", "s.wav", "t.mp3"):
        (path.parent / name).parent.mkdir(exist_ok=True)
        (path.parent / name).touch()
    scan = Folder().scan(path.parent)
    for clip in scan.clips:
        _require(clip.motion_path.resolve().is_relative_to(path.parent.resolve()), "a path outside the source")


def _read_names(path: Path) -> None:
    from dancedata.datasets.files import read_names

    read_names(path)


def _read_file_names(path: Path) -> None:
    """Scan folders that hold files of these names, and write what is said of them as a build does."""
    from dancedata.core.errors import SourceError
    from dancedata.core.hashing import json_sha256
    from dancedata.datasets.aistpp import AistPP
    from dancedata.datasets.files import require_folder
    from dancedata.datasets.finedance import FineDance
    from dancedata.datasets.folder import Folder

    sources = path.parent / "sources"
    sources.mkdir(exist_ok=True)
    readers = {"motions": Folder(music="optional"), "wavs": AistPP(), "motion": FineDance()}
    for raw in path.read_bytes().split(b"\0"):
        # As a disk has them: no slash, no NUL, 255 bytes at most.
        name = os.fsdecode(raw.replace(b"/", b"")[:250])
        if name not in ("", ".", ".."):
            for folder in readers:
                (sources / name / folder).mkdir(parents=True, exist_ok=True)
                for suffix in ("", ".npz", ".wav"):
                    with suppress(OSError):  # longer than a disk takes
                        (sources / name / folder / f"{name}{suffix}").touch()
    for source in sources.iterdir():
        for reader in readers.values():
            try:
                scan = reader.scan(source)
            except SourceError as error:
                _require_plain(str(error))
                continue
            rows = [json.dumps(reject.to_json(), ensure_ascii=False) for reject in scan.rejects]
            _require_plain("".join((*scan.notes, *rows)))
            json_sha256([str(clip.motion_path) for clip in scan.clips])
    require_folder("folder", sources, "names")  # there is none where no name was usable


def _show(folder: Path) -> None:
    """Print what `info --clips`, `info --json` and `check` print."""
    from dancedata.building.describe import describe_clips, describe_problems, describe_store, store_json
    from dancedata.core.tables import json_text
    from dancedata.store import verify_store

    _require_plain(describe_problems(folder, verify_store(folder)))
    for text in (describe_store(folder), describe_clips(folder), json_text(store_json(folder))):
        _require_plain(text)


def is_plain(text: str) -> bool:
    """Tell whether a text can be printed on a terminal and written to a file: letters, blanks and line breaks."""
    return text.isprintable() or all(c.isprintable() or c == "\n" or unicodedata.category(c) == "Zs" for c in text)


def _require_plain(text: str) -> None:
    _require(is_plain(text), "text that does not print")


def _read_description(path: Path) -> None:
    from dancedata.store import open_store

    _put_side_files(path)
    with open_store(path.parent) as opened:
        _require(bool(opened.fields), "a store without fields")
        for clip in map(lambda record: opened[record.id], opened.clips()):
            for field in opened.fields:
                clip.read(field)
    _show(path.parent)


def _read_stats(path: Path) -> None:
    from dancedata.building.describe import describe_problems
    from dancedata.store import open_store, verify_store

    _put_side_files(path)
    with open_store(path.parent) as opened:
        opened.scaler("pose").normalize(np.zeros((2, 3), np.float32))
    _require_plain(describe_problems(path.parent, verify_store(path.parent)))


def _read_lines(path: Path) -> None:
    from dancedata.building.describe import describe_store

    _put_side_files(path)
    _require_plain(describe_store(path.parent))


def _put_side_files(path: Path) -> None:
    """Add the other files of a store, and make the hashes in dataset.json right, as an adversary does."""
    for name in store():
        if name != path.name:
            (path.parent / name).write_bytes(store()[name])
    with suppress(ValueError, KeyError, TypeError, RecursionError):  # not a document with hashes
        document = json.loads((path.parent / "dataset.json").read_bytes())
        if path.name != "dataset.json":
            data = path.read_bytes()
            document["files"][path.name] = {"size": len(data), "sha256": hashlib.sha256(data).hexdigest()}
        _seal(path.parent, document)


def _seal(folder: Path, document: dict[str, Any]) -> None:
    """Write dataset.json with its own hash."""
    from dancedata.core.hashing import self_hash

    text = json.dumps({**document, "self_sha256": self_hash(document)})
    (folder / "dataset.json").write_text(text)


def _read_torch(path: Path) -> None:
    from dancedata.formats.torch_file import load_torch

    load_torch(path)


def _read_tables(path: Path) -> None:
    """Read tables as if they had been published: dataset.json has their size and hash."""
    from dancedata.store import open_store, verify_store

    data = path.read_bytes()
    for name in store():
        if name != path.name:
            (path.parent / name).write_bytes(store()[name])
    document = json.loads(store()["dataset.json"])
    document["files"]["tables.h5"] = {"size": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    _seal(path.parent, document)
    try:
        verify_store(path.parent)
    finally:
        with open_store(path.parent) as opened:
            for split in opened.splits:
                windows = opened.windows(split)
                for field in opened.fields:
                    for clip in map(lambda record: opened[record.id], opened.clips()):
                        clip.read(field)
                    for window in windows:
                        opened.read(window, field)
                    if len(windows):
                        rows = opened._window_rows(windows, field)
                        rows.read(0, np.empty(rows.shape, rows.dtype))


def _require(holds: bool, problem: str) -> None:
    if not holds:
        raise AssertionError(problem)


def _text(*texts: str) -> Callable[[], list[bytes]]:
    return lambda: [text.encode() for text in texts]


_LABELS = ('{"name": "song", "style1": "Street", "style2": "Popping"}', '\ufeff{"style2": "jazz"}')
_JSONL = '{"motion": "a/b.bvh", "audio": "s.wav", "unit": "cm"}\n{"motion": "c.npy", "fps": 30, "id": "x"}\n'


def _defect(path: Path) -> None:
    """Do what no reader may, as the file says: for the test that the harness sees it."""
    import os
    import time

    what = path.read_bytes()[:5]
    if what == b"spins":
        while True:
            time.process_time()
    elif what == b"grows":
        bytearray(1 << 28)
    elif what == b"calls":
        os.system("true")
    elif what == b"write":
        open(path.parent.parent / "elsewhere", "w").close()
    elif what == b"dies!":
        os.kill(os.getpid(), 11)
    elif what == b"index":
        [].pop()


TARGETS: dict[str, Target] = {
    "pickle": Target("pickle", "a.pkl", pickles, _read_aist),
    "npy": Target("npy", "a.npy", npy, _read_finedance),
    "npz": Target("npz", "a.npz", npz, _read_folder),
    "body_model": Target("npz", "m.npz", body_models, _read_body_model),
    "joblib": Target("joblib", "a.pkl", joblibs, _read_people),
    "phalp": Target("joblib", "a.pkl", phalps, _read_people),
    "torch_zip": Target("torch", "a.pt", torches, _read_people),
    "model_pickle": Target("pickle", "m.pkl", model_pickles, _read_body_model),
    "bvh": Target("bvh", "a.bvh", bvh, _read_folder, text=True),
    "wav": Target("wav", "a.wav", wav, _read_audio),
    "flac": Target("flac", "a.flac", lambda: [encoded("FLAC", "PCM_16")], _read_audio),
    "mp3": Target("mp3", "a.mp3", lambda: [encoded("MP3", "MPEG_LAYER_III")], _read_audio),
    "ogg": Target("ogg", "a.ogg", lambda: [encoded("OGG", "VORBIS"), encoded("OGG", "OPUS", 24_000)], _read_audio),
    "label": Target("json", "001.json", _text(*_LABELS), _read_label, text=True),
    "dataset_json": Target("json", "dataset.json", lambda: [store()["dataset.json"]], _read_description, text=True),
    "stats": Target("json", "stats.json", lambda: [store()["stats.json"]], _read_stats, text=True),
    "rejects": Target("jsonl", "rejects.jsonl", lambda: [store()["rejects.jsonl"]], _read_lines, text=True),
    "recipe": Target("yaml", "r.yaml", _text(RECIPE), _read_recipe, text=True),
    "csv": Target(
        "csv",
        "manifest.csv",
        _text(MANIFEST, MANIFEST.replace(", b", "").replace(",", ";")),
        _read_manifest,
        text=True,
    ),
    "jsonl": Target("jsonl", "manifest.jsonl", _text(_JSONL), _read_manifest, text=True),
    "names": Target(
        "txt", "x_train.txt", _text("gBR_sBM_cAll_d04_mBR2_ch08\n# no\n\nname 2\n"), _read_names, text=True
    ),
    "file_names": Target("names", "names.bin", lambda: [b"001\0gBR_sBM_cAll_d04_mBR2_ch08"], _read_file_names),
    "torch_old": Target("torch", "a.pth", old_torches, _read_torch),
    "hdf5": Target("hdf5", TABLES, lambda: [store()[TABLES]], _read_tables, also=("clip train_c",)),
}

#: Not a reader, see `_defect`.
DEFECT = Target("none", "a.txt", _text("harmless"), _defect, text=True)
