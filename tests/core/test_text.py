"""Text from files: truncated, printable, fast to make for any value; and the name that was meant."""

import json
import pickle
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from dancedata.core.clip import Reject, Scan
from dancedata.core.errors import DataError, SourceError, did_you_mean
from dancedata.core.tables import json_text
from dancedata.core.text import is_unicode, printable, shown
from dancedata.store import Problem

HOSTILE = "a\x1b[2J\x9b1m\u202e\n\r\x00\udcff\ud800\U000e0001é舞　\u00a0z"
SAFE = r"a\x1b[2J\x9b1m\u202e\n\r\x00\udcff\ud800\U000e0001é舞" + "　\u00a0z"


def doubled(depth: int) -> tuple[Any, ...]:
    """A tuple that holds the same tuple twice, nested `n` deep."""
    value: tuple[Any, ...] = ()
    for _ in range(depth):
        value = (value, value)
    return value


class Loud:
    """An object whose `repr` must not be called."""

    def __repr__(self) -> str:
        raise AssertionError("repr was called")

    __str__ = __repr__


def test_unprintable_characters_are_escaped() -> None:
    assert printable(HOSTILE) == SAFE
    assert printable(HOSTILE, lines=True) == SAFE.replace("\\n", "\n")
    assert printable(printable(HOSTILE)) == SAFE
    assert printable("plain text") == "plain text"
    assert is_unicode(SAFE)
    assert not is_unicode(HOSTILE)


#: Not parameters of a test: pytest would write them out.
SHOWN: list[tuple[object, str]] = [
    ("x" * 201, "x" * 200 + "..."),
    ("x" * 200, "x" * 200),
    (HOSTILE, SAFE),
    (-7, "-7"),
    (10**40000, "an integer of 132,878 bits"),
    (np.float32(0.5), "0.5"),
    (Fraction(30000, 1001), "30000/1001"),
    (b"\xff\x1b", r"b'\xff\x1b'"),
    (Path("a\n/b"), r"a\n/b"),
    (int, "int"),
    ([1, "b", None], "[1, 'b', None]"),
    ((7,), "(7,)"),
    (list(range(1000)), "[0, 1, 2, 3, 4, 5, 6, 7, ... 992 more]"),
    ([[1] * 5, (2,), {"a": 1}], "[list of 5, tuple of 1, dict of 1]"),
    ({"a": Loud()}, "dict of 1"),
    ({3, 4}, "set of 2"),
    (Loud(), "Loud"),
    (np.array([Loud()]), "ndarray"),
    (ValueError("a\nb"), r"ValueError: a\nb"),
    (KeyError("k"), "KeyError: 'k'"),
    (KeyError(Loud()), "KeyError: "),
    (OSError(2, "No such file", "x\x1b"), r"FileNotFoundError: [Errno 2] No such file: 'x\x1b'"),
]


def test_values_are_shown_by_their_type() -> None:
    for value, text in SHOWN:
        assert shown(value) == text


def test_containers_are_not_unfolded() -> None:
    for value in (doubled(10_000), [doubled(200)] * 10**6, {doubled(12): 1}, ValueError(doubled(99))):
        assert len(shown(value)) < 300


def test_json_for_a_terminal_is_still_json() -> None:
    document = {"a": HOSTILE, "b": [1.5, "ü"]}
    text = json_text(document)
    assert text.replace("\n", "").replace("　", "").replace("\u00a0", "").isprintable()
    assert "é舞" in text
    assert json.loads(text) == document


def test_errors_are_printable_for_any_text() -> None:
    """As a whole, and after the way back from a worker process."""
    for error in (
        DataError(
            "bad\x1b", reason="nan", where=f"/x/{HOSTILE}", found="y" * 10_000, allowed=doubled(99), fix="do\x07"
        ),
        SourceError("bad", where=Path(HOSTILE.replace("\0", "")), found=doubled(99), fix="first\nsecond"),
    ):
        text = str(pickle.loads(pickle.dumps(error)))
        assert text == str(error)
        assert text.encode().decode().replace("\n", "").replace("　", "").replace("\u00a0", "").isprintable()
        assert len(text) < 2000
    assert "first\nsecond" in text.lower()


def test_rejects_can_be_stored_and_printed() -> None:
    reject = Reject("bad_name", clip=HOSTILE, file=f"motions/{HOSTILE}", detail=HOSTILE * 1000)
    scan = Scan("x", (), (reject,), (HOSTILE, "z" * 10**6))
    row = json.dumps(reject.to_json(), ensure_ascii=False).encode()
    assert (reject.clip, reject.file) == (SAFE, f"motions/{SAFE}")
    assert len(row) < 30_000
    assert Reject(**json.loads(row)) == reject
    assert scan.notes[0] == SAFE
    assert len(scan.notes[1]) < 5000


def test_findings_of_a_check_can_be_printed() -> None:
    problem = Problem("error", f"/x/{HOSTILE}", HOSTILE)
    assert str(problem) == f"error: /x/{SAFE}: {SAFE}"
    problem.to_json()["message"].encode()


def test_a_long_list_is_cut() -> None:
    message = did_you_mean("zzz", [f"clip{number}" for number in range(100_000)])
    assert message.endswith("clip59 and 99,940 more")
