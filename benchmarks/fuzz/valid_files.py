"""Valid files of all formats, for fuzzing to begin from."""

from __future__ import annotations

import io
import pickle
import struct
import wave
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

TABLES = "tables.h5"
MANIFEST = """motion,audio,split,genre,dancer,tempo_bpm,fps,up,unit
a/b.bvh,s.wav,train,waltz,anna,120,,,cm
a/c.npz,s.wav,train,waltz,"anna, b",120,,,
d.npy,t.mp3,test,tango,ben,,30000/1001,y,0.01
"""
RECIPE = """recipe: 1
name: mine
dataset: {folder: {unit: cm, fps: 30, up: y, joint_map: {pelvis: Hips}}}
fps: 30
windows: {length_s: 5, stride_s: 0.5}
rules: {movement: {field: edge151, min_std: 0.07}}
motion: {edge151: {contacts: {velocity: {max_speed_m_s: 0.3}}}, joints: {}}
audio: {librosa35: {}}
keymotion: {lodge: {}}
augment: {mirror: true}
store: {shard_mb: 256}
"""


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
    arrays = _model()
    return [_zipped(**arrays, kintree_table=parents), _zipped(True, **arrays)]


def _model() -> dict[str, Any]:
    return {
        "v_template": _rng().normal(0, 1, (30, 3)),
        "shapedirs": _rng().normal(0, 1, (30, 3, 10)).astype(np.float32),
        "J_regressor": _rng().random((24, 30)),
    }


def joblibs() -> list[bytes]:
    """Return files of WHAM, plain and packed in each way, by old and new protocols."""
    from tests.video_files import wham, wham_person

    people = {0: wham_person(5, 2, vertices=3), 7: wham_person(4, seed=1, vertices=3)}
    mixed = np.array([None, "x", {"a": 1}], dtype=object)
    one = {3: {**wham_person(4, vertices=2), "mixed": mixed, "after": np.asfortranarray(np.zeros((2, 3)))}}
    packed = [wham(one, (kind, 1)) for kind in ("zlib", "gzip", "bz2", "lzma", "xz")]
    return [wham(people), wham(one), wham(one, 0, 2), *packed]


def phalps() -> list[bytes]:
    """Return files of PHALP with two people, one of whom is not seen in some frames."""
    from tests.video_files import dance, phalp

    people = {1: (*dance(4), np.arange(4)), 2: (*dance(2), np.array([0, 3]))}
    return [phalp(people, 0), phalp(people, 0, 2), phalp(people)]


def torches() -> list[bytes]:
    """Return files of GVHMR."""
    from tests.video_files import gvhmr, torch_file

    return [torch_file(gvhmr(4)), torch_file(gvhmr(3), "big")]


def model_pickles() -> list[bytes]:
    """Return SMPL models with few vertices, as they are published."""
    from tests.video_files import smpl_pickle

    arrays = _model()
    return [smpl_pickle(arrays, ("shapedirs", "v_template"), protocol) for protocol in (0, 2, 4)] + [
        smpl_pickle(arrays, ())
    ]


def bvh() -> list[bytes]:
    """Return a short dance of SMPL's joints with Mixamo's names, and a file in a program's other style."""
    from tempfile import TemporaryDirectory

    from dancedata.core.skeleton import SMPL24
    from dancedata.datasets.folder.example import MIXAMO_NAMES
    from dancedata.formats.bvh.write import write_bvh

    turns = np.tile(np.eye(3), (3, 24, 1, 1))
    offsets = np.array(SMPL24.offsets) * 100
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.bvh"
        write_bvh(path, MIXAMO_NAMES.split(), SMPL24.parents, offsets, turns, np.zeros((3, 3)), "0.0333333")
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
    return [plain.getvalue(), *(encoded(container, subtype) for container, subtype in formats)]


def encoded(container: str, subtype: str, rate: int = 22_050) -> bytes:
    import soundfile

    samples = np.sin(np.arange(3000) / 20).astype(np.float32) / 2
    file = io.BytesIO()
    soundfile.write(file, samples, rate, format=container, subtype=subtype)
    return file.getvalue()


def old_torches() -> list[bytes]:
    """Return a torch file from before the zip format, with two tensors."""
    tensor = (
        b"ctorch._utils\n_rebuild_tensor_v2\n((X\x07\x00\x00\x00storagectorch\nFloatStorage\n"
        b"X\x01\x00\x00\x00%dX\x03\x00\x00\x00cpuK\x06NtQK\x00K\x02K\x03\x86K\x03K\x01\x86\x89ccollections\nOrderedDict\n)RtR"
    )
    content = b"\x80\x02}(X\x01\x00\x00\x00a" + tensor % 1 + b"X\x01\x00\x00\x00b" + tensor % 2
    content += b"u."
    parts = [pickle.dumps(part, 2) for part in (0x1950A86A20F9469CFC6C, 1001, {"little_endian": True})]
    elements = struct.pack("<q6f", 6, *range(6))
    return [b"".join([*parts, content, pickle.dumps(["1", "2"], 2), elements, elements])]


@lru_cache(maxsize=1)
def store() -> dict[str, bytes]:
    """Return the files of a store with a motion and an audio field, by name."""
    from tempfile import TemporaryDirectory

    from dancedata.core.clip import Reject
    from dancedata.store import write_store
    from dancedata.store.schema import Field
    from dancedata.testing.stores import random_columns, write_random_store

    fields = (
        Field("pose", "motion", random_columns(3), Fraction(30)),
        Field("music", "audio", random_columns(2, mirror=False), Fraction(30), "float16"),
    )
    rejects = [Reject("nan", "x", "x.pkl", 3, "why", {"audio_s": 1.5}), Reject("no_audio", file="s.wav")]
    flag = {"kind": "k", "joint": "j", "frame": 3, "value": 1.5, "unit": "deg", "rate": "30"}
    quality = [{"clip": "train_c00", **flag}]
    with TemporaryDirectory() as folder:
        made = write_random_store(
            Path(folder) / "store",
            fields=fields,
            clips={"train": 2},
            n_frames=(40, 60),
            length=20,
            stride=10,
        )
        written = Path(folder) / "written"
        written.mkdir()
        texts = ("é" * 100, "short")
        clips = [replace(c, columns={"says": says}) for c, says in zip(made.clips, texts, strict=True)]
        write_store(written, made.header, clips, rejects=rejects, quality=quality)
        return {path.name: path.read_bytes() for path in written.iterdir()}
