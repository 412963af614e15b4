"""Protocols as YAML files."""

from pathlib import Path

import pytest

import dancedata
from dancedata.core.errors import UsageError
from dancedata.evaluation.protocol_file import read_protocol
from dancedata.store import Store
from tests.messages import raises_message

TEXT = """
protocol: 1
name: ours
version: 3
citation: Doe 2031
source: section 4
motion: {body: body22, fps: null}
truth: {seconds: [5, 2.5]}
measures:
  - kinetic: {variant: fixed, joints: 22, statistics: varying}
    steady: true
  - pfc: {variant: rescaled}
    steady: true
  - beat_alignment: {joints: 22}
music: {features: [librosa35, bailando438]}
published:
  - {what: ground truth, values: {pfc: 1.25}, source: table 1}
notes: [of a file]
"""


def write(folder: Path, text: str = TEXT) -> Path:
    path = folder / "ours.yaml"
    path.write_text(text)
    return path


def test_a_file_gives_the_numbers_of_the_same_protocol_in_code(store: Store, tmp_path: Path) -> None:
    file = str(write(tmp_path))
    ours = dancedata.evaluate(
        store, split="all", protocol=file, intervals=False, jobs=2, cache=tmp_path, save_pool=tmp_path / "p.npz"
    )
    theirs = dancedata.evaluate(store, split="all", intervals=False)
    assert {s.name: s.value for s in ours.scores} == {
        name: theirs[name].value for name in (s.name for s in ours.scores)
    }
    assert {"fid_k", "pfc", "bas"} <= {s.name for s in ours.scores}
    assert str(ours).startswith("ours, version 3: ")
    assert ours.notes[-1] == "of a file"
    assert next(s.published for s in ours.scores if s.name == "pfc") == 1.25
    again = dancedata.evaluate(store, split="all", protocol=file, pool=tmp_path / "p.npz", intervals=False)
    assert again["fid_k"].value == ours["fid_k"].value
    changed = write(tmp_path, TEXT.replace("[5, 2.5]", "[4, 2]"))
    with pytest.raises(UsageError, match="the pool was measured by other metrics"):
        dancedata.evaluate(store, split="all", protocol=str(changed), pool=tmp_path / "p.npz", intervals=False)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("name: ours", "name: dancedata"), ("version: 3", "version: three"), ("motion:", "motoin:"),
        ("body22", "body23"), ("pfc:", "pcf:"), ("variant: rescaled", "variant: odd"), ("music:", "musik:"),
        ("steady: true\n  - beat", "steady: 2\n  - beat"), ("notes: [of a file]", "notes: 3"),
        ("protocol: 1", "protocol: 2"), (TEXT, "[]"), (TEXT, ""),
        ("seconds: [5, 2.5]", "length: 150, stride: 0"), ("seconds: [5, 2.5]", "length: 150"),
        ("seconds: [5, 2.5]", "skip: -10"), ("[5, 2.5]", "[5, .nan]"), ("fps: null", "fps: 0"),
        ("  - pfc: {variant: rescaled}", "  - pfc\n  - pfc: {variant: rescaled}"),
    ],
)  # fmt: skip
def test_wrong_files(old: str, new: str, tmp_path: Path) -> None:
    with raises_message(UsageError, "protocol", where="ours.yaml"):
        read_protocol(write(tmp_path, TEXT.replace(old, new)))


def test_a_file_that_does_not_exist(store: Store) -> None:
    with raises_message(UsageError, "protocol", where="nothing.yaml"):
        dancedata.evaluate(store, split="all", protocol="nothing.yaml")
