"""The page on motion out of a trainer: its code prints what it shows."""

import re
from pathlib import Path

import pytest

import dancedata
from dancedata.pipeline.decode_file import FORMATS

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "decoding.md").read_text(encoding="utf-8")


def test_its_code_prints_the_output_shown(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    small = {"audio": {}, "dataset.synthetic.songs": 3, "dataset.synthetic.clips_per_song": 2}
    dancedata.build("demo", out="data/demo", overrides=small, cache="cache", jobs=1, progress=False)
    ((code, output),) = re.findall(r"^```python\n(.*?)^```\n\n```text\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)
    names: dict[str, object] = {}
    exec(compile(code, "decoding.md", "exec"), names)
    assert capsys.readouterr().out == output
    pytest.importorskip("torch")
    _, scaler = re.findall(r"^```python\n(.*?)^```", TEXT, re.DOTALL | re.MULTILINE)
    exec(compile(scaler, "decoding.md", "exec"), names)
    assert (tmp_path / "scaler.json").is_file()


def test_every_format_is_on_the_page() -> None:
    row = next(line for line in TEXT.splitlines() if line.startswith("| `--to`"))
    assert set(re.findall(r"`([a-z]+)`", row)) == set(FORMATS)
