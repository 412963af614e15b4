"""The code of docs/segments.md runs, and prints what the page promises."""

import re
from pathlib import Path

import pytest

pytest.importorskip("torch")

PAGE = Path(__file__).parents[2] / "docs" / "segments.md"


def test_code_of_the_page_runs(tmp_path, cache, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DANCEDATA_CACHE", str(cache))
    names: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL):
        exec(compile(block, str(PAGE), "exec"), names)
    words, placed, mask, text = capsys.readouterr().out.splitlines()
    assert words == "('steps to the left, then turns',) ('steps to the right, then turns',)"
    assert placed == "[(('steps to the left, then turns',), 0, 60, 1.0)]"
    assert mask == "True"
    assert text in ("steps to the left, then turns", "steps to the right, then turns", "")
