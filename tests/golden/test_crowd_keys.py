"""Every value of the reference outputs of groups and duets is compared somewhere, or named here with the reason."""

import json
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
#: Values by file and key, and the module under tests/ that compares them.
COMPARED = {
    "gcd/facts.json/lists/*": "golden/test_crowd_gcd.py",
    "gcd/facts.json/samples": "golden/test_crowd_gcd.py",
    "gcd/facts.json/contact*": "golden/test_crowd_gcd.py",
    "gcd/facts.json/normali*": "golden/test_crowd_gcd.py",
    "gcd/facts.json/std_zero_columns": "golden/test_crowd_gcd.py",
    "gcd/facts.json/skeleton_offsets": "golden/test_crowd_gcd.py",
    "gcd/metrics.json/*/gmc": "metrics/test_groups.py",
    "gcd/metrics.json/*/beat_score": "evaluation/test_groups.py",
    "gcd/metrics.json/frechet_given/*": "golden/test_crowd_gcd.py",
    "gcd/metrics.json/alignment_score_sigma_2.12": "golden/test_crowd_gcd.py",
    "gcd/metrics.npz/*": "golden/test_crowd_gcd.py",
    "gcd/normalizer.npz/*": "golden/test_crowd_gcd.py",
    "gcd/samples.npz/*": "golden/test_crowd_gcd.py",
    "gcd/whole_clips.npz/*": "datasets/test_aioz_gdance.py",
    "tcdiff/facts.json/slices/*": "golden/test_crowd_slices.py",
    "tcdiff/facts.json/sliced_wav/*": "golden/test_crowd_slices.py",
    "tcdiff/facts.json/names/*": "golden/test_crowd_slices.py",
    "tcdiff/facts.json/item_shape": "golden/test_crowd_slices.py",
    "tcdiff/facts.json/contact*": "golden/test_crowd_slices.py",
    "tcdiff/facts.json/test_values_outside_the_kept_range": "golden/test_crowd_slices.py",
    "tcdiff/facts.json/feature_shape": "audio/test_crowd_golden.py",
    "tcdiff/facts.json/music438_slice": "audio/test_crowd_golden.py",
    "tcdiff/music438.npz/*": "audio/test_crowd_golden.py",
    "tcdiff/windows.npz/*": "golden/test_crowd_slices.py",
    "popdg/facts.json/copied/*": "golden/test_crowd_slices.py",
    "popdg/facts.json/slices/*": "golden/test_crowd_slices.py",
    "popdg/facts.json/order/*": "golden/test_crowd_slices.py",
    "popdg/facts.json/shape/*": "golden/test_crowd_slices.py",
    "popdg/facts.json/contact*": "golden/test_crowd_slices.py",
    "popdg/facts.json/mean_head_minus_pelvis_*": "golden/test_crowd_slices.py",
    "popdg/facts.json/music35_slice": "audio/test_crowd_golden.py",
    "popdg/music35.npz/*": "audio/test_crowd_golden.py",
    "popdg/pbc*": "golden/test_crowd_slices.py",
    "popdg/windows.npz/*.contacts": "datasets/test_popdanceset.py",
    "popdg/windows.npz/*.raw_*": "datasets/test_popdanceset.py",
    "popdg/windows.npz/*": "golden/test_crowd_slices.py",
    "duolando/facts.json/hold_*": "golden/test_crowd_duolando.py",
    "duolando/facts.json/split/*": "golden/test_crowd_duolando.py",
    "duolando/facts.json/music_rows/*": "golden/test_crowd_duolando.py",
    "duolando/facts.json/windows/*": "golden/test_crowd_duolando.py",
    "duolando/metrics.*": "golden/test_crowd_duolando.py",
    "duolando/dd100.npz/*.pos3d*": "datasets/test_dd100.py",
    "duolando/dd100.npz/*.music54": "audio/test_crowd_golden.py",
    "duolando/dd100.npz/window.*.music_row0": "audio/test_crowd_golden.py",
    "duolando/dd100.npz/*": "golden/test_crowd_duolando.py",
    "motorica/expmap61.npz/*.joint_positions_cm_first_mid_last": "datasets/test_motorica.py",
    "motorica/expmap61.npz/*": "golden/test_crowd_motorica.py",
    "motorica/facts.json/columns": "datasets/test_motorica.py",
    "motorica/facts.json/position_joints": "datasets/test_motorica.py",
    "motorica/facts.json/files/*": "golden/test_crowd_motorica.py",
    "motorica/facts.json/dataset/*": "golden/test_crowd_motorica.py",
    "motorica/facts.json/released_lists/*": "golden/test_crowd_motorica.py",
    "stream/labels.json/*": "datasets/test_motorica_labels.py",
    "stream/labels.npz/*": "golden/test_crowd_motorica.py",
    "infinitedance/columns266.npz/*": "representations/test_humanml263.py",
    "infinitedance/facts.json/clips/*": "representations/test_humanml263.py",
    "infinitedance/facts.json/rule_264": "representations/test_humanml263.py",
}
#: What is compared in part.
PARTLY = {
    "motorica/expmap61.npz/*": "the columns of the hips' rotation and of the root's steps (54 to 56, 58 to 60): no "
    "representation here has them",
    "motorica/facts.json/files/*": "stamps, whose step of 33.332 ms follows from a rounded frame time, which the "
    "reader corrects, and what was observed of the original alone",
    "infinitedance/columns266.npz/*.266": "columns 0 and 2, the root's path, which the 264 columns leave out",
    "infinitedance/facts.json/clips/*": "sizes of turns and distances from thresholds: they describe the input",
}
#: What no test compares.
NOT_COMPARED = {
    "gcd/facts.json/starts_*": "GCD draws starts and never the last one; GroupDataset has every window",
    "gcd/facts.json/least_distance_of_a_foot_speed_from_0.01": "describes the input",
    "tcdiff/facts.json/wav_processing_*": "errors of a script of TCDiff",
    "tcdiff/facts.json/equal_to_bailando_438/*": "compares two originals",
    "*/facts.json/skeleton_is_edge": "describes the original; its windows are compared",
    "popdg/facts.json/music35_full_clip_rows": "POPDG cuts the rows of each song to five seconds; a dataset has all",
    "duolando/facts.json/audio_against_soundfile_max/*": "compares two programs that read sound",
    "motorica/facts.json/released_features": "describes files that are not among the reference outputs",
    "motorica/facts.json/audio29_names": "LDA's repository has no code that computes them",
}


def values(crowd: Path) -> list[str]:
    """FILE/KEY of every array, and of JSON files FILE/KEY or FILE/KEY/KEY."""
    found = []
    for path in sorted(p for p in crowd.rglob("*") if p.suffix in (".npz", ".json") and "inputs" not in p.parts):
        name = path.relative_to(crowd).as_posix()
        if path.suffix == ".npz":
            with np.load(path) as file:
                found += [f"{name}/{key}" for key in file.files]
        else:
            for key, value in json.loads(path.read_text()).items():
                found += (
                    [f"{name}/{key}/{inner}" for inner in value] if isinstance(value, dict) else [f"{name}/{key}"]
                )
    return found


def test_every_value_is_compared_or_named(shared: Path) -> None:
    found = values(shared / "golden" / "crowd")
    assert len(found) > 250
    for value in found:
        places = [name for pattern, name in COMPARED.items() if fnmatchcase(value, pattern)]
        reasons = [reason for pattern, reason in NOT_COMPARED.items() if fnmatchcase(value, pattern)]
        assert bool(places) != bool(reasons), value
    for pattern in (*COMPARED, *PARTLY, *NOT_COMPARED):
        assert any(fnmatchcase(value, pattern) for value in found), pattern


def test_the_modules_that_compare_them_read_their_files() -> None:
    for pattern, name in COMPARED.items():
        text = (ROOT / "tests" / name).read_text()
        assert pattern.split("/")[0] in text, f"{name} does not name {pattern}"
