"""Ids of samples: their text gives them back, and every file system takes it."""

import re
from unicodedata import normalize

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dancedata.core.errors import UsageError
from dancedata.core.sample_id import SampleId, safe_name
from tests.messages import raises_message

NAMES = st.text(st.characters(exclude_categories=("Cs",)), min_size=1, max_size=40).map(lambda s: normalize("NFC", s))
NASTY = ["CON", "nul.txt", "lpt9", "..", " x ", "-rf", "a@5", "a%41", "a~s3", "val=x", "a/b\\c", "tab\there", "aux",
         "e\u0301.", " " * 130]  # fmt: skip
DEVICES = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)


@given(
    name=st.one_of(st.sampled_from(NASTY), NAMES),
    source=st.one_of(st.just(""), NAMES),
    start=st.integers(0, 9999),
    take=st.integers(0, 3),
    mirrored=st.booleans(),
)
def test_a_text_is_the_id_and_a_safe_file_name(name: str, source: str, start: int, take: int, mirrored: bool) -> None:
    changes, draw = (("mirror",), (0, 2, 17)) if mirrored else ((), None)
    for sample in (
        SampleId(name, start, 150, source, changes, draw, 1, take), SampleId(name, source=source, take=take),
    ):  # fmt: skip
        text = str(sample)
        assert not re.search(r"""[<>:"/\\|?*\x00-\x1f]""", text)
        assert not DEVICES.fullmatch(text)
        assert text == text.strip(" .")
        assert text[0] != "-"
        assert len(text.encode()) < 320
        assert str(SampleId.parse(text)) == text
        if max(len(safe_name(n).encode()) for n in (name, source)) < 120 and normalize("NFC", name) == name:
            assert SampleId.parse(text) == sample
            assert sample.mirrored is (mirrored and sample.start is not None)


def test_names_that_are_shortened_or_composed_do_not_meet() -> None:
    long = [f"{'ü' * 200}{k}" for k in range(3)]
    assert len({safe_name(name) for name in long}) == 3
    assert all(len(safe_name(name).encode()) <= 120 for name in long)
    assert safe_name("e\u0301") != safe_name("\u00e9") == "\u00e9"


@pytest.mark.parametrize(("text", "clip", "start"), [
    ("a@5", "a@5", None), ("a@5+3", "a", 5), ("a@1+2@5+3", "a@1+2", 5), ("x y.z", "x y.z", None),
    ("100%", "100%", None),
])  # fmt: skip
def test_what_has_not_the_form_is_the_name_of_a_clip(text: str, clip: str, start: int | None) -> None:
    assert (SampleId.parse(text).clip, SampleId.parse(text).start) == (clip, start)


def test_nothing_is_no_id() -> None:
    with raises_message(UsageError, "id"):
        SampleId.parse("")
