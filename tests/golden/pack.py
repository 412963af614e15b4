"""Make tests/golden/data from the whole reference set: python tests/golden/pack.py GOLDEN OUT.

GOLDEN has the folders `peers`, `metrics`, `jukebox`, `bailando438`, `humanml263` and `crowd`, and the file
`jukebox_keys.csv` beside it. What is left out, and why that changes no comparison, stands in data/README.md. The
values that stay are the reference's own bits.
"""

import csv
import io
import json
import lzma
import math
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import soundfile

from dancedata.audio.jukebox.network import tensors
from dancedata.audio.jukebox.weights.folder import PRIOR_FILE, VQVAE_FILE
from dancedata.audio.jukebox.weights.sources import TorchFile
from dancedata.formats.values import load_object
from tests.jukebox.conftest import GOLDEN_CONFIG

Arrays = dict[str, np.ndarray]

#: Music that is kept, and for how many seconds; None: whole. The rest is silence of the same length.
EDGE_MUSIC = {
    "gHO_sBM_cAll_d19_mHO3_ch07": None,  # 44.1 kHz mono, train, and FACT's
    "gJS_sBM_cAll_d25_mJS3_ch02": 5.5,  # 48 kHz stereo, test
    "gHO_sBM_cAll_d17_mHO1_ch01": 0.6,  # of edge_slice_pcm
}
FINEDANCE_MUSIC = {"063": None}
#: The track whose hands move; in the others they keep the pose of the first frame.
HANDS = "001"
BODY = 3 + 22 * 6
#: Dances whose metrics are kept, and sets of features.
METRIC_CLIPS = ("gHO_sBM_cAll_d19_mHO3_ch07", "004")
METRIC_SETS = (
    "tiny", "two", "geo", "gt_constant_column_pred_not", "both_constant_column", "constant_columns_differ",
)  # fmt: skip
CLIPS = ("5s", "odd", "short", "silence", "stereo48k")
#: Codes of the longest of them.
N_CODES = 1722
DUET = "Waltz_5_0"
INFINITE = "my clip 2 (live)"
#: A recording of Motorica, and the rows of each take that are kept.
KRUMP, LDA_ROWS = "kthstreet_gKR_sFM_cAll_d01_mKR_ch01", 14
HUMANML = "gHO_sBM_cAll_d19_mHO3_ch07"
BAILANDO = "gHO_sBM_cAll_d17_mHO1_ch01.7.5fps"


def xz(data: bytes) -> bytes:
    """Return the shortest of some xz streams: text likes literals of their neighbours, arrays of their own place."""
    ways = [{"pb": pb, "lc": lc, "lp": lp} for pb, lc, lp in ((2, 3, 0), (0, 3, 0), (2, 0, 2), (2, 1, 2), (2, 0, 0))]
    return min(
        (
            lzma.compress(data, filters=[{"id": lzma.FILTER_LZMA2, "preset": 9 | lzma.PRESET_EXTREME, **way}])
            for way in ways
        ),
        key=len,
    )


def frames(n: int, every: int) -> np.ndarray:
    """Every `every`-th frame, and the last two."""
    return np.unique([*range(0, n, every), n - 2, n - 1])


def chosen(key: str, array: np.ndarray, index: dict[int, Any]) -> Arrays:
    """Some of an array, with the indices along each axis that was thinned out, and its whole shape."""
    found = {f"{key}@shape": np.array(array.shape)}
    for axis, at in index.items():
        found[f"{key}@{axis}"] = np.asarray(at, dtype=np.int32)
        array = np.take(array, at, axis=axis)
    return {key: array, **found}


def load(path: Path) -> Arrays:
    with np.load(path) as file:
        return dict(file)


def save(path: Path, arrays: Arrays) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    path.with_name(f"{path.name}.xz").write_bytes(xz(buffer.getvalue()))


def copy(source: Path, target: Path) -> None:
    """Copy a file: texts as they are, others packed."""
    target.parent.mkdir(parents=True, exist_ok=True)
    if source.suffix in (".json", ".txt"):
        shutil.copyfile(source, target)
    else:
        packed = xz(source.read_bytes())
        target.with_name(f"{target.name}.xz").write_bytes(packed)


def pack_song(source: Path, target: Path, seconds: float | None) -> None:
    samples, rate = soundfile.read(source, dtype="int16")
    if seconds is not None:
        samples[int(seconds * rate) :] = 0
    target.parent.mkdir(parents=True, exist_ok=True)
    soundfile.write(
        target.with_suffix(".flac"), samples, rate, subtype="PCM_16", format="FLAC", compression_level=1.0
    )


def pack_finedance(source: Path, target: Path) -> None:
    columns = np.load(source)
    if source.stem != HANDS:
        columns[:, BODY:] = columns[0, BODY:]
    pack_columns(columns, target)


def pack_columns(columns: np.ndarray, target: Path) -> None:
    """Columns as second differences of their bits, byte by byte: a third smaller than packed as they are."""
    bits = np.ascontiguousarray(columns).view(np.uint32)
    for _ in range(2):
        bits = np.diff(bits, axis=0, prepend=np.zeros((1, bits.shape[1]), np.uint32))
    shuffled = np.ascontiguousarray(bits.T).view(np.uint8).reshape(-1, 4).T
    data = np.array(columns.shape, dtype="<i8").tobytes() + shuffled.tobytes()
    target.parent.mkdir(parents=True, exist_ok=True)
    packed = xz(data)
    target.with_suffix(".columns.xz").write_bytes(packed)


def pack_inputs(peers: Path, out: Path) -> None:
    for path in sorted(peers.rglob("*")):
        target = out / path.relative_to(peers)
        if path.suffix == ".wav":
            kept = FINEDANCE_MUSIC if "finedance" in path.parts else EDGE_MUSIC
            pack_song(path, target, kept.get(path.stem, 0))
        elif path.suffix == ".npy":
            pack_finedance(path, target)
        elif path.is_file():
            copy(path, target)


def pack_edge(peers: Path, out: Path) -> None:
    for split, normal in (("train", "pose_normalized_first16"), ("test", "pose_normalized")):
        names_ = json.loads((peers / f"edge_windows_{split}.json").read_text())
        arrays = load(peers / f"edge_{split}.npz")
        heard = [k for k, name in enumerate(names_) if _is_heard(name)]
        save(
            out / f"edge_{split}.npz",
            {
                **chosen("pose_raw", arrays["pose_raw"], {1: [0, 1, 37, 74, 101, 148, 149]}),
                "contacts": arrays["contacts"],
                **chosen("baseline35", arrays["baseline35"], {0: heard}),
                **chosen(normal, arrays[normal], {1: [0, 37, 101, 149]}),
            },
        )
        shutil.copyfile(peers / f"edge_windows_{split}.json", out / f"edge_windows_{split}.json")
    for name in ("edge_normalizer", "edge_slice_pcm"):
        save(out / f"{name}.npz", load(peers / f"{name}.npz"))


def _is_heard(window: str) -> bool:
    """Tell whether a window of EDGE lies in music that is kept."""
    clip, _, number = window.rpartition("_slice")
    seconds = EDGE_MUSIC.get(clip, 0)
    return seconds is None or int(number) * 0.5 + 5 <= seconds


def pack_motion(peers: Path, out: Path) -> None:
    joints, fact = load(peers / "fk_smpl24.npz"), load(peers / "fact_motion.npz")
    thinned = [chosen(key, array, {0: frames(len(array), 24)}) for key, array in joints.items()]
    save(out / "fk_smpl24.npz", {k: v for part in thinned for k, v in part.items()})
    thinned = [chosen(key, array, {0: frames(len(array), 48)}) for key, array in fact.items()]
    save(out / "fact_motion.npz", {k: v for part in thinned for k, v in part.items()})


def pack_lodge(peers: Path, out: Path) -> None:
    tracks, part = load(peers / "lodge_mofea319.npz"), {}
    for key, array in tracks.items():
        index: dict[int, Any] = {0: frames(len(array), 15)}
        if key != HANDS:
            index[1] = np.arange(4 + BODY)
        part |= chosen(key, array, index)
    save(out / "lodge_mofea319.npz", part)
    joints = [chosen(k, a, {0: np.arange(0, len(a), 15)}) for k, a in load(peers / "lodge_fk55.npz").items()]
    save(out / "lodge_fk55.npz", {k: v for one in joints for k, v in one.items()})
    scaler = load(peers / "lodge_normalizer.npz")
    scaler |= chosen("normalized_first300", scaler["normalized_first300"], {0: frames(300, 30)})
    save(out / "lodge_normalizer.npz", scaler)
    keys = load(peers / "lodge_key_motion.npz")
    for name in [name for name in keys if name.endswith("key_motion")]:
        keys |= chosen(name, keys[name], {2: [*range(13), *range(13, 139, 7)]})
    save(out / "lodge_key_motion.npz", keys)
    music = load(peers / "lodge_music35.npz")
    save(out / "lodge_music35.npz", {track: music[track] for track in FINEDANCE_MUSIC})
    for name in ("lodge_dataset_index", "finedance_contacts"):
        save(out / f"{name}.npz", load(peers / f"{name}.npz"))
    shutil.copyfile(peers / "lodge_get_list_cases.json", out / "lodge_get_list_cases.json")


def pack_fact_music(peers: Path, out: Path) -> None:
    sources = json.loads((peers / "fact_audio_source.json").read_text())
    kept = {music: clip for music, clip in sources.items() if EDGE_MUSIC.get(clip, 0) is None}
    arrays = load(peers / "fact_audio35_60fps.npz")
    save(out / "fact_audio35_60fps.npz", {music: arrays[music] for music in kept})
    (out / "fact_audio_source.json").write_text(json.dumps(kept, indent=1) + "\n")


def pack_metrics(golden: Path, out: Path) -> None:
    """Two synthetic dances with all that was computed of them, and sets of random features."""
    arrays = load(golden / "inputs.npz")
    for name in [name for name in arrays if name.split("/")[1] in METRIC_CLIPS]:
        pack_columns(arrays[name].reshape(len(arrays[name]), -1), out / "inputs" / f"{name}.npy")
    features = load(golden / "features.npz")
    windows = {key: _rows_of_clips(features, key) for key in features if key.startswith("windows/")}
    clips = {key: array for key, array in features.items() if key.split("/")[1] in METRIC_CLIPS}
    save(out / "features.npz", clips | windows)
    beats = load(golden / "beats.npz")
    save(out / "beats.npz", {key: array for key, array in beats.items() if key.split(".")[0] in METRIC_CLIPS})
    sets = load(golden / "fid_cases.npz")
    save(out / "fid_cases.npz", {key: array for key, array in sets.items() if key.split(".")[0] in METRIC_SETS})
    for name, kept in (("per_clip", METRIC_CLIPS), ("fid_cases", METRIC_SETS)):
        values = json.loads((golden / f"{name}.json").read_text())
        (out / f"{name}.json").write_text(json.dumps({key: values[key] for key in kept}, indent=1) + "\n")
    packed = xz((golden / "edge_cases.json").read_bytes())
    (out / "edge_cases.json.xz").write_bytes(packed)
    copy(golden / "skating_extra.json", out / "skating_extra.json")


def _rows_of_clips(features: Arrays, key: str) -> np.ndarray:
    lodge = key.endswith("lodge")
    names = features["windows/names_lodge" if lodge else "windows/names60"]
    return features[key][[str(name).partition("@")[0] in METRIC_CLIPS for name in names]]


def pack_old_metrics(peers: Path, out: Path) -> None:
    """Metrics of the peers' own folder."""
    for name in ("bas_bailando", "bas_lodge", "aistpp_features"):
        arrays = load(peers / f"{name}.npz")
        save(out / f"{name}.npz", {key: a for key, a in arrays.items() if key.split(".")[0] in METRIC_CLIPS})
    for name in ("pfc_edge", "foot_skating_lodge"):
        shutil.copyfile(peers / f"{name}.json", out / f"{name}.json")


def pack_checkpoint(path: Path, out: Path, needed: dict[str, int]) -> None:
    """A checkpoint whose tensors, and rows of tables, that no comparison looks at are zero. All else stays."""
    data = bytearray(path.read_bytes())
    file = TorchFile(path)
    for name, tensor in file.tensors.items():
        start, size = file._places[tensor.untyped_storage()._cdata], tensor.untyped_storage().nbytes()
        rows = needed.get(name, 0)
        begin, end = start + rows * math.prod(tensor.shape[1:]) * tensor.itemsize, start + size
        if rows < tensor.shape[0]:
            data[begin:end] = bytes(end - begin)
    out.mkdir(parents=True, exist_ok=True)
    packed = xz(bytes(data))
    (out / f"{path.name}.xz").write_bytes(packed)


def pack_jukebox(golden: Path, out: Path) -> None:
    config = GOLDEN_CONFIG
    needed = {spec.name: spec.rows for spec in tensors.vqvae_tensors(config)}
    pack_checkpoint(golden / VQVAE_FILE, out, needed)
    # Tables of times have few rows, so those of the whole context are kept; positions are most of the file.
    whole = {spec.name: spec.rows for spec in tensors.prior_tensors(config, config.depth)}
    pack_checkpoint(golden / PRIOR_FILE, out, whole | {tensors.POSITIONS: N_CODES})
    manifest = json.loads((golden / "manifest.json").read_text())
    kept = {name: about for name, about in manifest.items() if name in CLIPS}
    for name, about in kept.items():
        song = golden / about["wav"]
        samples, rate = soundfile.read(song, dtype="int16")
        about["wav"] = f"clip_{name}.flac"
        soundfile.write(out / about["wav"], samples, rate, subtype="PCM_16", format="FLAC", compression_level=1.0)
        save(out / f"expect_{name}.npz", _expected(golden / f"expect_{name}.npz"))
    (out / "manifest.json").write_text(json.dumps(kept, indent=1) + "\n")
    save(out / "expect_cond.npz", load(golden / "expect_cond.npz"))


def _expected(path: Path) -> Arrays:
    """Codes and features whole; of activations every 13th row, which meets all places in a block of 128."""
    arrays = load(path)
    kept = {name: arrays[name] for name in ("z", "z_margin", "final", "n_samples")}
    index = arrays["act_index"]
    rows = frames(len(index), 13)
    kept["act_index"] = index[rows]
    return kept | {n: a[rows] for n, a in arrays.items() if n.startswith("act_") and n[4:].isdigit()}


def pack_bailando(golden: Path, out: Path) -> None:
    """A song at 7.5 rows per second, its samples and some of its rows."""
    arrays = load(golden / "modern_librosa0110_soxr.npz")
    rows, samples = arrays[BAILANDO], f"{BAILANDO}.audio"
    kept = {samples: arrays[samples], **chosen(BAILANDO, rows, {0: frames(len(rows), 4)})}
    save(out / "modern_librosa0110_soxr.npz", kept)


def pack_humanml(golden: Path, out: Path) -> None:
    """A clip's columns and the joints that are recovered from them."""
    arrays = load(golden / "golden.npz")
    save(out / "golden.npz", {f"{HUMANML}.{what}": arrays[f"{HUMANML}.{what}"] for what in ("263", "recovered")})


def pack_crowd(crowd: Path, out: Path) -> None:
    """Keep the joints of three groups and a duet, their scores, some frames of the duet's files, and a clip."""
    gcd, duet = load(crowd / "gcd" / "metrics.npz"), load(crowd / "duolando" / "metrics.npz")
    scores = json.loads((crowd / "gcd" / "metrics.json").read_text())
    arrays: Arrays = {}
    for key, array in gcd.items():
        name, _, what = key.rpartition(".")
        if what in ("joints", "group_kinetic72"):
            arrays[key] = array
            arrays[f"{name}.gmc"] = np.array(scores[name]["gmc"])
    positions = load(crowd / "duolando" / "dd100.npz")
    arrays["follower"], arrays["leader"] = (positions[f"{DUET}_0{k}.pos3d"].reshape(-1, 55, 3) for k in (0, 1))
    arrays["duet100"] = duet[f"{DUET}.duet100"]
    arrays["bed"] = np.array(json.loads((crowd / "duolando" / "metrics.json").read_text())[DUET]["BED"])
    save(out / "groups.npz", arrays)
    duet_rows: Arrays = {"index": np.array([0, 1, *range(12, 92, 16), 91, 92])}
    for member in (0, 1):
        content = load_object(crowd / "inputs" / "dd100" / "motion" / "smplx" / "all" / f"{DUET}_0{member}.npy")
        assert isinstance(content, dict)
        duet_rows |= {f"{member}.{key}": content[key][duet_rows["index"]] for key in ("poses", "transl")}
        duet_rows[f"{member}.rotmat_first_last"] = positions[f"{DUET}_0{member}.rotmat_first_last"]
    save(out / "duet.npz", duet_rows)
    pack_scores(crowd, out)
    columns = load(crowd / "infinitedance" / "columns266.npz")
    joints = np.load(crowd / "inputs" / "infinitedance" / "joints" / f"{INFINITE}.npy")
    names = {"columns": f"{INFINITE}.266", "recovered": f"{INFINITE}.recovered264"}
    save(out / "infinitedance.npz", {"joints": joints, **{name: columns[key] for name, key in names.items()}})


def pack_scores(crowd: Path, out: Path) -> None:
    """Keep tables and their Frechet distances, a dance and its PBC, and what Duolando scores of a follower."""
    gcd, duets = load(crowd / "gcd" / "metrics.npz"), load(crowd / "duolando" / "metrics.npz")
    of_gcd, of_duets, of_popdg = (
        json.loads((crowd / name).read_text())
        for name in ("gcd/metrics.json", "duolando/metrics.json", "popdg/pbc.json")
    )
    arrays = {f"gcd.{side}": gcd[f"frechet_{side}"] for side in ("real", "gen")}
    arrays |= {f"duolando.{side}": duets[f"fid_{side}"] for side in ("gt", "pred")}
    arrays |= {name: duets[f"{DUET}.{name}_follower"] for name in ("kinetic72", "manual32")}
    arrays["popdg.joints"] = load(crowd / "popdg" / "pbc_joints.npz")["a"]
    numbers = {
        "gcd.frechet": of_gcd["frechet_given"]["distance"],
        "gcd.diversity": of_gcd["frechet_given"]["avg_pair_distance_gen"],
        "duolando.frechet": of_duets["fid_given"]["fid"],
        "duolando.diversity": [of_duets["fid_given"][f"div_{side}"] for side in ("pred", "gt")],
        "popdg.pbc": of_popdg["a"]["pbc"],
        "popdg.pfc": of_popdg["a"]["pfc"],
        "footskating": of_duets[DUET]["footskating_follower"],
        "music_beats": of_duets[DUET]["music_beats"],
        "bas": of_duets[DUET]["BAS_follower"],
    }
    save(out / "scores.npz", arrays | {name: np.array(value) for name, value in numbers.items()})


def pack_lda(crowd: Path, out: Path) -> None:
    """Keep the first frames of a recording of Motorica, as text, and LDA's columns of them, also mirrored."""
    text = (crowd / "inputs" / "motorica" / "bvh" / f"{KRUMP}.bvh").read_text()
    head, rows = text.split("Frame Time: 0.008333\n")
    rows = rows.splitlines()[: 4 * LDA_ROWS]
    head = re.sub(r"Frames:.*", f"Frames: {len(rows)}", head)
    arrays = load(crowd / "motorica" / "expmap61.npz")
    takes = {f"{take}{mirrored}": arrays[f"{KRUMP}_{take}{mirrored}"][:LDA_ROWS]
             for take in ("00", "01") for mirrored in ("", "_mirrored")}  # fmt: skip
    bvh = f"{head}Frame Time: 0.008333\n" + "".join(f"{row}\n" for row in rows)
    save(out / "lda.npz", {"bvh": np.frombuffer(bvh.encode(), np.uint8), **takes})


def pack_stream(crowd: Path, out: Path) -> None:
    """Keep the label files of Motorica++ that STREAM's code read, as text, and what it made of them."""
    inputs = crowd / "inputs" / "motorica_pp"
    files = {p.relative_to(inputs).as_posix(): p.read_text(encoding="utf-8") for p in sorted(inputs.rglob("*_*.*"))}
    made = json.loads((crowd / "stream" / "labels.json").read_text(encoding="utf-8"))
    (out / "stream.json.xz").write_bytes(xz(json.dumps({"files": files, **made}, ensure_ascii=False).encode()))


def pack_keys(path: Path, out: Path) -> None:
    """Names, shapes and types of the real files' tensors."""
    with path.open() as file:
        rows = list(csv.DictReader(file))
    buffer = io.StringIO()
    columns = ["file", "openai_key", "shape", "dtype_in_file", "needed_for_layer_66"]
    writer = csv.DictWriter(buffer, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    (out / "keys.csv.xz").write_bytes(xz(buffer.getvalue().encode()))


def main(golden: Path, out: Path) -> None:
    peers = out / "peers"
    pack_inputs(golden / "peers" / "inputs", peers / "inputs")
    pack_edge(golden / "peers", peers)
    pack_motion(golden / "peers", peers)
    pack_lodge(golden / "peers", peers)
    pack_fact_music(golden / "peers", peers)
    pack_old_metrics(golden / "peers", peers)
    pack_metrics(golden / "metrics", out / "metrics")
    pack_jukebox(golden / "jukebox", out / "jukebox")
    pack_bailando(golden / "bailando438", out / "bailando438")
    pack_humanml(golden / "humanml263", out / "humanml263")
    pack_crowd(golden / "crowd", out / "crowd")
    pack_lda(golden / "crowd", out / "crowd")
    pack_stream(golden / "crowd", out / "crowd")
    pack_keys(golden.parent / "jukebox_keys.csv", out / "jukebox")
    sizes = {path: path.stat().st_size for path in sorted(out.rglob("*")) if path.is_file()}
    for path, size in sorted(sizes.items(), key=lambda item: item[1]):
        print(f"{size:9,}  {path.relative_to(out)}")
    print(f"{sum(sizes.values()):9,}  in all")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
