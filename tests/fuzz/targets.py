"""What is fuzzed: every reader of files that others made, with valid files to begin from."""

from __future__ import annotations

import hashlib
import io
import json
import pickle
import wave
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from random import Random
from typing import Any

import mutations
import numpy as np

MANIFEST = """motion,audio,split,genre,dancer,tempo_bpm,fps,up,unit
a/b.bvh,s.wav,train,waltz,anna,120,,,cm
a/c.npz,s.wav,train,waltz,"anna, b",120,,,
d.npy,t.mp3,test,tango,ben,,30000/1001,y,0.01
"""
RECIPE = """recipe: 1
name: mine
dataset: {folder: {unit: cm, fps: 30, up: y, joint_map: {pelvis: Hips}}}
fps: 30
scope: track
windows: {length_s: 5, stride_s: 0.5, filter: {movement: {field: edge151, min_std: 0.07}}}
motion: {edge151: {contacts: {velocity: {max_speed_m_s: 0.3}}}, joints: {}}
audio: {librosa35: {}}
keymotion: {lodge: {}}
augment: {mirror: true}
store: {shard_mb: 256}
"""


@dataclass(frozen=True)
class Target:
    """A reader.

    Attributes
    ----------
    file : name of the file that it is given, in a folder of its own.
    seeds : makes valid files.
    read : reads the file with everything that is read of such files; raises DanceDataError.
    text : whether lines and words are changed rather than bits.
    also : other names of what is wrong that an error may give, besides the file's.
    """

    format: str
    file: str
    seeds: Callable[[], list[bytes]]
    read: Callable[[Path], None]
    text: bool = False
    also: tuple[str, ...] = ()

    def mutated(self, seeds: list[bytes], rng: Random) -> bytes:
        """Return a broken copy of a seed."""
        if self.file.endswith(".npz") and rng.random() < 0.6:
            return mutations.mutated_members(rng.choice(seeds), rng)
        data = mutations.mutated(seeds, rng, text=self.text)
        return mutations.with_ogg_checksums(data) if self.file.endswith(".ogg") and rng.random() < 0.8 else data


def _saved(array: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def _zipped(compressed: bool = False, **arrays: Any) -> bytes:
    file = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(file, **arrays)
    return file.getvalue()


def _rng() -> np.random.Generator:
    return np.random.default_rng(0)


def pickles() -> list[bytes]:
    """Return motions as AIST++ has them, by old and new pickle protocols."""
    content = {
        "smpl_poses": _rng().normal(0, 0.3, (5, 72)).astype(np.float32),
        "smpl_trans": _rng().normal(90, 20, (5, 3)),
        "smpl_scaling": np.array([93.75], np.float32),
        "smpl_loss": 1.5,
    }
    return [pickle.dumps(content, protocol) for protocol in (0, 2, 4, 5)] + [
        pickle.dumps({**content, "names": ["a", b"b", {1}, frozenset({2}), None], "gender": "male"}),
        pickle.dumps(np.zeros((4, 72))),
    ]


def npy() -> list[bytes]:
    """Return motions as FineDance has them."""
    rows = np.tile(np.array([1, 0, 0, 0, 1, 0], np.float32), (6, 52))
    columns = np.concatenate([np.zeros((6, 3), np.float32), rows], axis=1)
    return [_saved(columns), _saved(np.asfortranarray(columns.astype(">f8"))), _saved(np.zeros((3, 72)))]


def npz() -> list[bytes]:
    """Return motions in the layouts of AMASS, SMPL and SMPL-X."""
    small = _rng().normal(0, 0.3, (4, 165)).astype(np.float32)
    trans = np.zeros((4, 3), np.float32)
    parts = {"global_orient": small[:, :3], "body_pose": small[:, :63], "transl": trans, "jaw_pose": small[:, :3]}
    return [
        _zipped(
            poses=small[:, :156],
            trans=trans,
            betas=np.zeros(16),
            gender=np.array("male"),
            mocap_framerate=np.array(120.0),
        ),
        _zipped(True, poses=small[:, :72], trans=trans, fps=np.array(30)),
        _zipped(smpl_poses=small[:, :72].reshape(4, 24, 3), smpl_trans=trans, smpl_scaling=np.array([90.0])),
        _zipped(True, **parts, pose_hand=small[:, :90], mocap_frame_rate=np.array(60.0)),
    ]


def body_models() -> list[bytes]:
    """Return a SMPL model with few vertices."""
    from dancedata.core.skeleton import SMPL24

    parents = np.stack([np.array(SMPL24.parents) % 2**32, np.arange(24)]).astype(np.int64)
    arrays = {
        "v_template": _rng().normal(0, 1, (30, 3)),
        "shapedirs": _rng().normal(0, 1, (30, 3, 10)).astype(np.float32),
        "J_regressor": _rng().random((24, 30)),
    }
    return [_zipped(**arrays, kintree_table=parents), _zipped(True, **arrays)]


def bvh() -> list[bytes]:
    """Return a short dance of SMPL's joints with Mixamo's names, and a file in a program's other style."""
    from tempfile import TemporaryDirectory

    from dancedata.core.skeleton import SMPL24
    from dancedata.datasets._bvh_write import write_bvh
    from dancedata.datasets._folder_example import _NAMES

    turns = np.tile(np.eye(3), (3, 24, 1, 1))
    offsets = np.array(SMPL24.offsets) * 100
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.bvh"
        write_bvh(path, _NAMES.split(), SMPL24.parents, offsets, turns, np.zeros((3, 3)), "0.0333333")
        text = path.read_text()
    return [text.encode(), text.replace("\t", " ").replace("\n", "\r\n").encode()]


def wav() -> list[bytes]:
    """Return wav files of 8, 16, 24 bits and of floats, and other containers of libsndfile."""
    plain = io.BytesIO()
    with wave.open(plain, "wb") as file:
        file.setnchannels(2)
        file.setsampwidth(2)
        file.setframerate(48_000)
        file.writeframes(_rng().bytes(800))
    formats = [("WAV", "PCM_24"), ("WAV", "FLOAT"), ("WAV", "PCM_U8"), ("WAV", "IMA_ADPCM"), ("WAVEX", "PCM_16")]
    formats += [("RF64", "PCM_16"), ("AIFF", "PCM_16"), ("AU", "ULAW"), ("CAF", "ALAC_16"), ("W64", "PCM_16")]
    return [plain.getvalue(), *(_encoded(container, subtype) for container, subtype in formats)]


def _encoded(container: str, subtype: str, rate: int = 22_050) -> bytes:
    import soundfile

    samples = np.sin(np.arange(3000) / 20).astype(np.float32) / 2
    file = io.BytesIO()
    soundfile.write(file, samples, rate, format=container, subtype=subtype)
    return file.getvalue()


@lru_cache(maxsize=1)
def store() -> dict[str, bytes]:
    """Return the files of a store with a motion and an audio field, by name."""
    from tempfile import TemporaryDirectory

    from dancedata.store.schema import Field
    from dancedata.testing.stores import random_columns, write_random_store

    fields = (
        Field("pose", "motion", random_columns(3), Fraction(30)),
        Field("music", "audio", random_columns(2, mirror=False), Fraction(30), "float16"),
    )
    with TemporaryDirectory() as folder:
        made = write_random_store(
            Path(folder) / "store", fields=fields, clips={"train": 2}, n_frames=(40, 60), length=20, stride=10
        )
        return {path.name: path.read_bytes() for path in made.path.iterdir()}


SHARD = "train-00000-of-00001.h5"


def _read_aist(path: Path) -> None:
    from dancedata.datasets._aistpp_load import load_motion

    _both(lambda: load_motion(path, 60), lambda: _read_folder(path))


def _read_finedance(path: Path) -> None:
    from dancedata.core.bodies import SMPLX55
    from dancedata.datasets._finedance_load import load_motion, motion_length

    motion_length(path)
    _both(lambda: load_motion(path, 30, SMPLX55), lambda: _read_folder(path))


def _both(first: Callable[[], Any], second: Callable[[], Any]) -> None:
    """Read a file in two ways, the second whatever becomes of the first."""
    try:
        first()
    finally:
        second()


def _read_folder(path: Path) -> None:
    from dancedata.datasets._folder_facts import Declared
    from dancedata.datasets._folder_load import Reading, describe, load_motion

    reading = Reading(Declared(), Declared("30", "y", "guess" if path.suffix == ".bvh" else "m"))
    describe(path, reading)
    motion = load_motion(path, reading)
    for array in (motion.translation, motion.rotations, motion.joints()):
        _require(bool(np.isfinite(array).all()), "a motion that is not finite")


def _read_body_model(path: Path) -> None:
    from dancedata.core.skeleton import SMPL24
    from dancedata.datasets._body_model import body_model_skeleton

    skeleton = body_model_skeleton(path, joints=SMPL24, betas=[0.5, -1.0])
    _require(bool(np.isfinite(skeleton.offsets).all()), "a skeleton that is not finite")


def _read_audio(path: Path) -> None:
    from dancedata.audio.signal import audio_length, load_audio

    length, rate = audio_length(path)
    signal = load_audio(path)
    _require(bool(np.isfinite(signal.samples).all()), "samples that are not finite")
    _require((signal.n_samples, signal.sample_rate) == (length, rate), "another length than the header's")


def _read_label(path: Path) -> None:
    from dancedata.datasets._finedance_labels import read_label

    label = read_label(path, path.stem)
    _require(bool(label.genre) != bool(label.reason), "neither a genre nor a reason")
    _require(not label.reason or path.name in label.problem, "a problem that does not name the file")


def _read_recipe(path: Path) -> None:
    from dancedata.pipeline.recipe_file import load_recipe

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
    from dancedata.datasets._layout import read_names

    read_names(path)


def _read_description(path: Path) -> None:
    from dancedata.store import open_store

    (path.parent / SHARD).write_bytes(store()[SHARD])
    with open_store(path.parent) as opened:
        _require(bool(opened.fields), "a store without fields")
        for clip in map(lambda record: opened.clip(record.id), opened.clips):
            for field in opened.fields:
                clip.read(field)


def _read_side_file(path: Path) -> None:
    from dancedata.store import open_store

    for name in (SHARD, "dataset.json"):
        (path.parent / name).write_bytes(store()[name])
    with open_store(path.parent) as opened:
        opened.normalizer("pose", mirror=True).normalize(np.zeros((2, 3), np.float32))


def _read_shard(path: Path) -> None:
    """Read a shard as somebody would have published it: dataset.json has its size and hash."""
    from dancedata.store import open_store, verify_store

    data = path.read_bytes()
    document = json.loads(store()["dataset.json"])
    document["shards"][0] |= {"size": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    (path.parent / "dataset.json").write_text(json.dumps(document))
    try:
        verify_store(path.parent)
    finally:
        with open_store(path.parent) as opened:
            for split in opened.splits:
                windows = opened.windows(split)
                for field in opened.fields:
                    for clip in map(lambda record: opened.clip(record.id), opened.clips):
                        clip.read(field)
                    for window in windows:
                        opened.read(window, field)
                    if len(windows):
                        opened.window_rows(windows, field).view(0)


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
    "bvh": Target("bvh", "a.bvh", bvh, _read_folder, text=True),
    "wav": Target("wav", "a.wav", wav, _read_audio),
    "flac": Target("flac", "a.flac", lambda: [_encoded("FLAC", "PCM_16")], _read_audio),
    "mp3": Target("mp3", "a.mp3", lambda: [_encoded("MP3", "MPEG_LAYER_III")], _read_audio),
    "ogg": Target("ogg", "a.ogg", lambda: [_encoded("OGG", "VORBIS"), _encoded("OGG", "OPUS", 24_000)], _read_audio),
    "label": Target("json", "001.json", _text(*_LABELS), _read_label, text=True),
    "dataset_json": Target("json", "dataset.json", lambda: [store()["dataset.json"]], _read_description, text=True),
    "stats": Target("json", "stats.json", lambda: [store()["stats.json"]], _read_side_file, text=True),
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
    "hdf5": Target("hdf5", SHARD, lambda: [store()[SHARD]], _read_shard, also=("clip train_c",)),
}

#: Not a reader, see `_defect`.
DEFECT = Target("none", "a.txt", _text("harmless"), _defect, text=True)
