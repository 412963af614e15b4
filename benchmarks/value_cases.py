"""What values.py builds: recipes, in the words of the commit to compare with, and sources made from seeds.

Recipes whose keys changed since are translated by `today`.
"""

from __future__ import annotations

import csv
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

ENSEMBLE = Path(__file__).with_name("ensemble.py")  # a local plug-in: groups from .npz files


@dataclass(frozen=True)
class Case:
    """A source (a reader whose example it is, or one of `SOURCES`) and a recipe, with what is set in it.

    `now` are settings in the words of today, where they differ; `differs` says why values differ on purpose.
    """

    source: str
    recipe: str | Mapping[str, Any]
    settings: tuple[str, ...] = ()
    now: tuple[str, ...] | None = None
    differs: str = ""

    def chosen_recipe(self, folder: Path, is_base: bool) -> tuple[str, tuple[str, ...]]:
        """Return the recipe, by name or as a file that is written into `folder`, and the settings."""
        import yaml

        settings = self.settings if is_base or self.now is None else self.now
        if isinstance(self.recipe, str):
            return self.recipe, settings
        folder.mkdir(parents=True, exist_ok=True)
        document = {"recipe": 1, "name": "values", **(self.recipe if is_base else today(self.recipe))}
        path = folder / "recipe.yaml"
        path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
        return str(path), settings


def today(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a recipe of the commit to compare with in the words of today."""
    now = dict(document)
    transforms = [{name: now.pop(name)} for name in ("repair", "retarget") if name in now]
    rules = {"curate": now.pop("curate")} if "curate" in now else {}
    if "filter" in now["windows"]:
        rules |= now["windows"]["filter"]
        now["windows"] = {key: value for key, value in now["windows"].items() if key != "filter"}
    if now.pop("scope", "track") == "window":
        transforms.append({"slices": {key: now["windows"][key] for key in ("length_s", "stride_s")}})
    annotators = now.pop("segments", {})
    return {**now, "transforms": transforms, "annotators": annotators, "rules": rules}


def shared() -> Path | None:
    """Return the folder of real clips, if there is one."""
    folder = os.environ.get("DANCEDATA_SHARED")
    return Path(folder).resolve() if folder else None


# ---- recipes

ALL = "dataset.aist++.split=all"
LENGTHS = {2: {"length_s": 2, "stride_s": 0.5}, 1: {"length_s": 1, "stride_s": 0.5}}
FOLDER = {
    "dataset": {"folder": {"unit": "cm"}}, "windows": LENGTHS[2],
    "motion": {"edge151": {}}, "audio": {"librosa35": {}},
}  # fmt: skip
COPIES = {"mirror": True, "yaw": {}, "tempo": {"speeds": [0.9, 1.1]}}
STILL = {"mirror": True, "yaw": {"max_degrees": 90}, "root_offset": {}, "noise": {}}  # copies that keep the time
GROUPS = {**FOLDER, "dataset": {"ensemble": {}}, "plugins": [str(ENSEMBLE)], "fps": 30}
SHORT = {**GROUPS, "windows": LENGTHS[1]}
MOVING = {"length_s": 1, "stride_s": 0.5, "filter": {"movement": {"min_std": 0.0195}}}
SLICES = {**FOLDER, "dataset": {"aist++": {"split": "all"}}, "scope": "window"}
KEEP = {"groups": {"incomplete": "keep"}}
FLOOR = {"curate": {"floor_drift": 0.05}}  # leaves out dancers of groups
ROWS = {"path": "rows/{clip}.npy", "rate": 25, "columns_per_row": 5, "resample": "linear", "tolerance_s": None}
CODES = {
    "path": "codes/{clip}.npy", "rate": "15/2", "columns_per_row": 1, "fps": "15/2", "tolerance_s": "1/2",
    "dtype": "int16", "of": "motion", "begins": "clip", "codebook": {"name": "vq", "sizes": [512]},
}  # fmt: skip
EVERYTHING = {
    **FOLDER, "retarget": {"skeleton": "smpl24"}, "repair": {"spikes": 0.15},
    "curate": {"spikes": 0.05, "frozen": True, "floor_drift": 0.1}, "augment": COPIES,
    "segments": {"facts": True, "genre": True}, "motion": {"edge151": {}, "lodge139": {}}, "keymotion": {"lodge": {}},
}  # fmt: skip
OPTIONAL = {"edge151": {}, "finedance319": {"optional": True}}
#: Of slices, only statistics of music may differ.
SHARED_MUSIC = "rows of music that slices of several clips share count once in statistics, as those of a song do"

CASES = {
    "demo": Case("synthetic", "demo"),
    "aistpp": Case("aist++", "aist++", (ALL,)),
    "edge-exact": Case("aist++", "aist++-edge-exact", (ALL,)),
    "aistpp-60": Case("aist++", "aist++-60", (ALL,)),
    "finedance": Case("finedance", "finedance"),
    "aioz-gdance": Case("aioz-gdance", "aioz-gdance"),
    "motorica": Case("motorica", "motorica"),
    "motorica-lda": Case("motorica", "motorica-lda", (
        "dataset.motorica.trim_s=0", "windows.length_s=1", "windows.stride_s=1")),
    "dd100": Case("dd100", "dd100"),
    "phantomdance": Case("phantomdance", "phantomdance"),
    "i-dancers": Case("i-dancers", "i-dancers"),
    "infinitedance": Case("infinitedance", "infinitedance", ("windows.length_s=4",)),
    "popdanceset": Case("popdanceset", "popdanceset"),
    "folder": Case("captures", EVERYTHING),
    "optional": Case("captures", {
        **FOLDER, "motion": OPTIONAL, "keymotion": {"lodge": {"optional": True}},
        "augment": {"mirror": True, "tempo": {"speeds": [0.8]}}}),
    "rows": Case("captures", {
        **FOLDER, "audio": {"librosa35": {}, "file.rows": ROWS}, "augment": {"mirror": True}}),
    "codes": Case("captures", {
        **FOLDER, "audio": {"librosa35": {}, "file.codes": CODES}, "windows": {"length_s": 2, "stride_s": 2}}),
    "movement": Case("captures", {
        **FOLDER, "motion": {"lodge139": {}}, "augment": {"mirror": True, "tempo": {"speeds": [1.1]}},
        "windows": {**LENGTHS[2], "filter": {"movement": {"min_std": 0.1}}}}),
    "rates": Case("captures", {
        **FOLDER, "fps": 30, "motion": {"edge151": {}, "humanml263": {}}, "curate": {"spikes": 0.05},
        "windows": {"length_s": 2, "stride_s": 1}}),
    "groups": Case("groups", {
        **GROUPS, "motion": {"edge151": {}, "joints": {}}, "augment": COPIES, "segments": {"facts": True}}),
    "groups-keep": Case("groups", {**GROUPS, **KEEP}),
    "groups-windows": Case("groups", {**SHORT, "curate": {"penetration": 0.05, "sliding": 1.02}}),
    "groups-clips": Case("groups", {
        **SHORT, **KEEP, "curate": {"jitter": {"limit": 0.0166}, "floor_drift": 0.6},
        "augment": {"mirror": True, "yaw": {}, "tempo": {"speeds": [0.9]}}}),
    "groups-aside": Case("groups", {**SHORT, **FLOOR, "augment": {"mirror": True, "yaw": {}}}),
    "groups-lost": Case("groups", {**SHORT, **FLOOR, **KEEP}),
    "groups-lost-copies": Case(
        "groups", {**SHORT, **FLOOR, **KEEP, "augment": {"mirror": True, "yaw": {}, "tempo": {"speeds": [0.9]}}},
        differs="copies turn about the middle of all dancers, also of one whom curate leaves out"),
    "groups-movement": Case("groups", {**SHORT, "motion": {"lodge139": {}}, "windows": MOVING}),
    "groups-repair": Case("groups", {
        **SHORT, "repair": {"spikes": 0.2}, "curate": {"jitter": {"limit": 0.0166}, "penetration": 0.05}}),
    "mixed": Case("captures", {
        **FOLDER, "motion": OPTIONAL, "keymotion": {"lodge": {"optional": True}}, "augment": STILL,
        "audio": {"librosa35": {}, "stft193": {}, "file.rows": ROWS}, "repair": {"spikes": 0.15, "gaps": True},
        "curate": {"spikes": 0.05, "penetration": {"leave_out": "clip", "splits": ["test"]}},
        "segments": {"facts": True}}),
    "groups-mixed": Case("groups", {
        **SHORT, **KEEP, "motion": OPTIONAL | {"joints": {}}, "keymotion": {"lodge": {"optional": True}},
        "audio": {"librosa35": {}, "file.rows": ROWS | {"path": "rows/{music}.npy"}}, "augment": STILL,
        "curate": {"sliding": 1.02}}),
    "speeds": Case("captures", {
        **FOLDER, "fps": 30, "motion": {"edge151": {}, "fact219": {}, "humanml263": {}},
        "audio": {"librosa35": {}, "librosa35.60": {"fps": 60}, "bailando438": {}},
        "augment": {"tempo.slow": {"speeds": [0.9]}, "tempo.fast": {"speeds": [1.2, 1.25], "seed": 3}}}),
    "slices-mirror": Case("aist++", "aist++-edge-exact", ("augment={mirror: true}",), differs=SHARED_MUSIC),
    "slices-repair": Case("aist++", {**SLICES, "repair": {"spikes": 0.15}}),
}  # fmt: skip
#: Of real files.
REAL = {
    "real": Case("real_aistpp", "aist++", (ALL,)),
    "real-edge": Case("real_aistpp", "aist++-edge-exact", (ALL,)),
    "real-edge-mirror": Case("real_aistpp", "aist++-edge-exact", ("augment={mirror: true}",), differs=SHARED_MUSIC),
    "real-slices-repair": Case("real_aistpp", {**SLICES, "repair": {"spikes": 0.15}}),
    "real-slices-curate": Case("real_aistpp", {**SLICES, "curate": {"sliding": 0.6, "jitter": True}}),
    "real-slices-movement": Case("real_aistpp", {
        **SLICES, "windows": {**LENGTHS[2], "filter": {"movement": {
            "min_std": 0.06, "splits": ["all"], "field": "edge151"}}}}),
    "real-lodge": Case("real_aistpp", "aist++-lodge", (ALL,)),
    "bvh": Case("real_bvh", {
        "dataset": {"folder": {"music": "optional", "unit": "cm"}}, "fps": 30, "retarget": {"skeleton": "smpl24"},
        "windows": LENGTHS[1], "motion": {"edge151": {}, "joints": {}, "humanml263": {}}}),
}  # fmt: skip


def cases() -> dict[str, Case]:
    """Return all cases that can be built here, by name."""
    return CASES | (REAL if shared() else {})


# ---- sources, made with the code of the commit to compare with

CAPTURES = (  # id, file, split, synthetic dance, song, seconds of the song at frame 0
    ("bvh_1", "a.bvh", "train", "gBR_sBM_cAll_d04_mBR0_ch01", "mBR0", ""),
    ("bvh_2", "b.bvh", "test", "gKR_sBM_cAll_d28_mKR5_ch03", "mKR5", "1/3"),
    ("hands_1", "c_poses.npz", "train", "gHO_sBM_cAll_d19_mHO3_ch02", "mHO3", "-0.4"),
    ("hands_2", "d_poses.npz", "test", "gLO_sBM_cAll_d13_mLO2_ch01", "mLO2", ""),
    ("spiky", "e_poses.npz", "train", "gLO_sBM_cAll_d13_mLO2_ch02", "mLO2", "0.21"),
    ("held", "f_poses.npz", "train", "gHO_sFM_cAll_d19_mHO3_ch01", "mHO3", ""),
    ("sinks", "g_poses.npz", "train", "gHO_sFM_cAll_d19_mHO3_ch02", "mHO3", ""),
    ("short", "h_poses.npz", "train", "gHO_sFM_cAll_d19_mHO3_ch03", "mHO3", ""),
    ("late", "i_poses.npz", "train", "gHO_sFM_cAll_d19_mHO3_ch04", "mHO3", "2.5"),
)
WORDS = (
    ("clip", "start", "end", "layer", "language", "text"),
    ("bvh_1", 0, 2, "description", "en", "steps to the left, then turns"),
    ("held", 1, "end", "description", "en", "waves with both arms"),
    ("spiky", 0.5, 3, "worte", "xx", "dreht nach links"),
)


def captures(source: Path) -> None:
    """Write nine takes in BVH and AMASS files, some with faults, with songs, words, rows and codes."""
    from dancedata.core.audio_signal import wav_bytes
    from dancedata.synthetic import synthesise_motion, synthesise_song
    from examples.make_captures import write_take

    rng, lines = np.random.default_rng(0), [["id", "motion", "audio", "music", "split", "genre", "audio_start_s"]]
    for folder in ("rows", "codes"):
        (source / folder).mkdir()
    for name, file, split, dance, music, start in CAPTURES:
        motion = synthesise_motion(dance, n_frames=40 if name == "short" else 360)[0]
        translation, rotations = np.array(motion.translation), np.array(motion.rotations)
        if name == "spiky":
            translation[200] += (0.2, 0, 0)
            translation[300] += (0.06, 0, 0)
        if name == "held":
            translation[200:212], rotations[200:212] = translation[199], rotations[199]
        if name == "sinks":
            translation[:, 1] -= np.linspace(0, 0.15, len(translation))
        write_take(source / file, replace(motion, translation=translation, rotations=rotations))
        song = synthesise_song(music, length_s=6.5)
        (source / f"{music}.wav").write_bytes(wav_bytes(song.pcm, song.signal.sample_rate))
        lines.append([name, file, f"{music}.wav", music, split, "house" if split == "train" else "break", start])
        if name != "hands_2":
            rows = rng.normal(size=(17 if name == "short" else 150, 5))
            np.save(source / "rows" / f"{name}.npy", rows.astype(np.float32))
        codes = rng.integers(0, 512, size=(5 if name == "short" else 45, 1))
        np.save(source / "codes" / f"{name}.npy", codes)
    for table, content in (("manifest.csv", lines), ("segments.csv", WORDS)):
        with (source / table).open("w", encoding="utf-8", newline="") as out:
            csv.writer(out).writerows(content)


def groups(source: Path) -> None:
    """Write groups of 1 to 3 dancers 1.2 m apart: unequal lengths, a dancer of NaN, one who floats, late songs."""
    import soundfile

    n, rng = 360, np.random.default_rng(3)
    (source / "rows").mkdir()
    for name, lengths in {
        "a": (n, n, n), "b": (n, n), "c": (n,), "d": (n, n, n - 5), "e": (n, n - 60), "g": (n, n, n),
    }.items():  # fmt: skip
        size = len(lengths)
        trans = np.cumsum(rng.normal(scale=0.01, size=(size, n, 3)), axis=1)
        trans += [[[1.2 * k, 0.9 + 0.6 * (k == 1), 0.4 * k]] for k in range(size)]
        if name == "g":
            trans[1, 5] = np.nan
        poses = np.cumsum(rng.normal(scale=0.01, size=(size, n, 24, 3)), axis=1)
        start = {"b": "1/3", "c": "-0.4", "d": "2.5"}.get(name, "0")  # seconds of the song at frame 0
        np.savez(source / f"{name}.npz", trans=trans, poses=poses, lengths=np.array(lengths), start=np.array(start))
        np.save(source / "rows" / f"{name}.npy", rng.normal(size=(220, 5)).astype(np.float32))
        soundfile.write(source / f"{name}.wav", rng.normal(scale=0.1, size=6 * 16_000), 16_000)


def real_aistpp(source: Path) -> None:
    """Lay the four real dances out with 35 s of real songs, whose own music may not be passed on."""
    import soundfile

    real = shared() / "realdata"
    for name in ("motions", "splits", "cameras"):
        shutil.copytree(real / "aistpp" / name, source / name)
    shutil.copy(real / "aistpp/ignore_list.txt", source)
    (source / "wavs").mkdir()
    songs = sorted((real / "music").glob("*.ogg"))
    for i, music in enumerate(("mBR2", "mJS2", "mJS4")):
        samples, rate = soundfile.read(songs[i % len(songs)], frames=35 * 44100)
        soundfile.write(source / "wavs" / f"{music}.wav", samples, rate, subtype="PCM_16")


def real_bvh(source: Path) -> None:
    """Lay the real BVH files out as a folder."""
    for file in sorted((shared() / "realdata/bvh").glob("*.bvh")):
        shutil.copy(file, source)


SOURCES = {f.__name__: f for f in (captures, groups, real_aistpp, real_bvh)}


def make_source(name: str, source: Path) -> None:
    """Write the example of the reader `name`, or one of `SOURCES`."""
    from dancedata.core.registry import DATASETS

    make = SOURCES[name] if name in SOURCES else DATASETS.get(name)().make_example
    make(source)
