"""The BVH parser: good files of many kinds, every mistake with its line, and no other exception than DataError."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dancedata.core.errors import DataError
from dancedata.formats.bvh import parse as _bvh
from dancedata.formats.bvh.parse import read_bvh, read_bvh_header
from dancedata.formats.stated import exact_rate, rate_of_period, rate_of_text
from tests.messages import raises_message

TEXT = """HIERARCHY
ROOT Hips
{
\tOFFSET 0.0 90.0 0.0
\tCHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
\tJOINT Spine
\t{
\t\tOFFSET 0.0 10.0 0.0
\t\tCHANNELS 1 Xrotation
\t\tEnd Site
\t\t{
\t\t\tOFFSET 0.0 20.0 0.0
\t\t}
\t}
}
MOTION
Frames: 2
Frame Time: 0.0333333
1 2 3 0 0 0 0
4 5 6 0 90 0 90
"""


@pytest.fixture
def write(tmp_path: Path):
    def make(text: str | bytes) -> Path:
        path = tmp_path / "tänze 舞.bvh"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return make


def test_facts_stated_by_a_file(write) -> None:
    bvh = read_bvh(write(TEXT))
    assert bvh.names == ("Hips", "Spine")
    assert [j.parent for j in bvh.joints] == [-1, 0]
    assert [j.order for j in bvh.joints] == ["ZYX", "X"]
    assert bvh.joints[1].offset == (0, 10, 0)
    assert (bvh.n_frames, bvh.frame_time) == (2, "0.0333333")
    assert np.array_equal(bvh.values, [[1, 2, 3, 0, 0, 0, 0], [4, 5, 6, 0, 90, 0, 90]])
    header = read_bvh_header(write(TEXT.partition("1 2 3")[0]))
    assert (header.names, header.n_frames, header.values.shape) == (bvh.names, 2, (0, 7))


@pytest.mark.parametrize(
    "changed",
    [
        TEXT.replace("\n", "\r\n"), TEXT.replace("\n", "\r"), "\ufeff" + TEXT,
        TEXT.replace("\t", "    ").replace("ROOT Hips\n{", "ROOT Hips {"),
        TEXT.replace("Xrotation", "XROTATION").replace("OFFSET", "offset").replace("JOINT", "Joint"),
        TEXT.replace("Frames: 2", "\nFrames:\t2\n"), TEXT.replace("Frame Time:", "Frame  time :"),
        TEXT.replace("1 2 3", "  1.0\t2e0 +3.").rstrip("\n") + "\n\n \n", TEXT.replace("End Site", "End site"),
    ],
)  # fmt: skip
def test_the_same_file_in_other_hands(write, changed: str) -> None:
    original, bvh = read_bvh(write(TEXT)), read_bvh(write(changed))
    assert bvh.names == original.names
    assert np.array_equal(bvh.values, original.values)


def test_names_may_hold_blanks(write) -> None:
    assert read_bvh(write(TEXT.replace("Spine", "Bip01 Spine"))).names == ("Hips", "Bip01 Spine")


#: What is replaced, and by what, by reason.
MISTAKES: dict[str, list[tuple[str, str]]] = {
    "broken_file": [
        ("HIERARCHY", "HIERACHY"), (TEXT, ""), (TEXT, "\x89PNG\r\n\x00\xff"), ("OFFSET 0.0 10", "OFSET 0.0 10"),
        *(("OFFSET 0.0 10.0 0.0", new) for new in (
            "OFFSET 0.0 10.0", "OFFSET 0,0 10,0 0,0", "OFFSET 0 1e300 0", "OFFSET 0 1 0\nOFFSET 0 1 0",
        )),
        ("\t\tOFFSET 0.0 10.0 0.0\n", ""), ("1 Xrotation", "1 Xrotatoin"), ("1 Xrotation", "2 Xrotation Xrotation"),
        ("JOINT Spine", "JOINT"), ("JOINT Spine", "ROOT Spine"), ("ROOT Hips", "JOINT Hips"),
        ("\t\tEnd Site\n\t\t{", "\t\tEnd Site\n"), ("}\nMOTION", "MOTION"), ("}\nMOTION", "}\n}\nMOTION"),
        ("MOTION", ""), ("Frames: 2", "Frames: two"), ("Frames: 2", "Frames: 99999999999999999999"),
        # One short and one long line have the right number of values together.
        ("1 2 3 0 0 0 0", "1 2 3 0 0 0"), ("1 2 3 0 0 0 0\n4", "1 2 3 0 0 0\n0 4"),
        *(("4 5 6", f"4 5 {new}") for new in ("x", "0x10", "1_0", "6\x00")),
    ],
    "missing_channels": [("\t\tCHANNELS 1 Xrotation\n", ""), ("1 Xrotation", "2 Xrotation"), ("1 Xro", "Xro")],
    "bad_rate": [("0.0333333", new) for new in ("0", "-0.03", "nan", "1e999999999", "")],
    "empty": [("Frames: 2", "Frames: 0")],
    "length_mismatch": [("Frames: 2", "Frames: 1")],
    "truncated": [
        ("Frames: 2", "Frames: 3"), ("Frames: 2", "Frames: 999999999999"), ("4 5 6 0 90 0 90", "4 5 6 0 90"),
        ("4 5 6 0 90 0 90\n", ""), ("1 2 3 0 0 0 0\n4 5 6 0 90 0 90\n", ""),
    ],
    "nan": [("OFFSET 0.0 10.0 0.0", "OFFSET 0 nan 0"), ("4 5 6", "4 5 NaN"), ("4 5 6", "4 5 1e999")],
    "out_of_range": [("4 5 6", "4 5 1e9")],
}  # fmt: skip


@pytest.mark.parametrize(
    ("old", "new", "reason"), [(*change, reason) for reason, changes in MISTAKES.items() for change in changes]
)
def test_mistakes_are_named_with_their_line(write, old: str, new: str, reason: str) -> None:
    assert old in TEXT
    path = write(TEXT.replace(old, new, 1))
    with raises_message(DataError, "begins|export|points", reason=reason):
        read_bvh(path)


@pytest.mark.parametrize("keep", range(0, len(TEXT) - 15, 13))
def test_cut_anywhere(write, keep: int) -> None:
    with raises_message(DataError, "export") as error:
        read_bvh(write(TEXT[:keep]))
    assert error.value.reason in ("broken_file", "truncated", "bad_rate", "missing_channels")


def test_folder_or_nothing_in_place_of_a_file(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "gone.bvh"):
        with raises_message(DataError, "directory", reason="broken_file"):
            read_bvh(path)


def test_limits(write, monkeypatch: pytest.MonkeyPatch) -> None:
    deep = "".join(f"JOINT j{k} {{ OFFSET 0 1 0\nCHANNELS 0\n" for k in range(3000)) + "}" * 3000
    with raises_message(DataError, "many", where="tänze 舞.bvh, line 2004", reason="broken_file"):
        read_bvh(write(TEXT.replace("\tJOINT Spine", deep + "\tJOINT Spine")))
    monkeypatch.setattr(_bvh, "MAX_FILE_BYTES", 100)
    with raises_message(DataError, "large", where="tänze 舞.bvh", reason="broken_file"):
        read_bvh(write(TEXT))


ALPHABET = st.sampled_from(
    [*"{}\n\t :.-0919eE", "JOINT a", "End Site", "OFFSET 0 0 0\n", "CHANNELS 3 ", "Xrotation ", "nan "]
)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    cuts=st.lists(
        st.tuples(st.integers(0, len(TEXT)), st.integers(0, 40), st.lists(ALPHABET, max_size=5)), max_size=4
    ),
    raw=st.one_of(st.none(), st.binary(max_size=60)),
)
def test_any_damage_is_a_data_error_or_none(write, cuts: list[tuple[int, int, list[str]]], raw: bytes | None) -> None:
    text = TEXT
    for at, length, new in cuts:
        text = text[:at] + "".join(new) + text[at + length :]
    data = text.encode() if raw is None else text.encode()[: len(raw) * 5] + raw
    path = write(data)
    try:
        bvh = read_bvh(path)
    except DataError:
        return
    assert bvh.values.shape == (bvh.n_frames, bvh.n_channels)
    assert np.isfinite(bvh.values).all()


@pytest.mark.parametrize(
    ("text", "rate"),
    [
        (".0083333", 120), ("0.0333333", 30), ("0.010000", 100), ("0.033", 30), ("0.0416667", 24), ("0.04", 25),
        ("0.016666", 60), ("1e-2", 100), ("0.03333333507180214", 30), ("0.0333667", Fraction(30000, 1001)),
        ("0.0166833", Fraction(60000, 1001)), ("0.03", Fraction(100, 3)), ("0.0125", 80), ("0.00001", None),
        ("5", None),
    ],
)  # fmt: skip
def test_frame_times_are_rounded_rates(text: str, rate: int | Fraction | None) -> None:
    assert rate_of_period(text) == rate


def test_rates_as_numbers_and_as_text() -> None:
    assert exact_rate(120.00000762939453) == 120
    assert exact_rate(59.940059661865234) == Fraction(60000, 1001)
    assert exact_rate(12.5) == Fraction(25, 2)
    for wrong in (0.0, -30.0, float("nan"), float("inf"), 1e30):
        assert exact_rate(wrong) is None
    assert rate_of_text("30000/1001") == Fraction(30000, 1001)
    assert rate_of_text("59.94") == Fraction(2997, 50)
    for text in ("", "0", "1/0", "-30", "1e99", "1e999999999", "30 fps", "/", "٣٠x"):
        assert rate_of_text(text) is None
