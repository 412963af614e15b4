"""dancedata report and dancedata view on the command line."""

import base64
import io
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from dancedata.cli.app import app
from dancedata.core.errors import UsageError
from dancedata.pages import write_report
from dancedata.store import open_store
from tests.commands import run
from tests.messages import raises_message
from tests.scene.helpers import page_data

RUN = CliRunner()


def test_report_writes_a_page_and_prints_findings(demo: Path, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    done = RUN.invoke(app, ["report", str(demo), "--clips", "1"])
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith("demo-report.html: 0.")
    assert "  good: no song or dance of train is in val or test" in done.stdout
    assert "note: " in done.stdout
    assert os.listdir(tmp_path) == ["demo-report.html"]
    again = RUN.invoke(app, ["report", str(demo)])
    assert again.exit_code == 2
    assert "--overwrite" in again.stderr


def test_json_has_every_number_and_writes_nothing_by_itself(demo, report, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = RUN.invoke(app, ["report", str(demo), "--json"])
    assert json.loads(done.stdout)["result"] == json.loads(json.dumps(report.to_json()))
    assert os.listdir(tmp_path) == []


def test_a_number_of_clips_is_one_and_a_video_needs_a_clip(demo: Path, tmp_path: Path) -> None:
    pytest.importorskip("PIL")
    assert "not a number of clips" in run("report", demo, "-o", tmp_path / "x.html", "--clips", "some", code=2).stderr
    assert "name it" in run("view", demo, "--out", tmp_path / "a.mp4", code=2).stderr.lower()
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("out", ["v.html", "v.mp4"])
def test_nothing_to_compare_with(demo, tmp_path, monkeypatch, out):
    monkeypatch.chdir(tmp_path)
    options = ["--compare", "nowhere", "--out", out]
    assert "nothing to compare with" in run("view", demo, open_store(demo).clips()[0].id, *options, code=1).stderr
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(("options", "words"), [
    (["--fps", "17", "--out", "v.html"], "--fps would have no effect without --compare"),
    (["--up", "z", "--unit", "cm", "--no-browser"], "--up and --unit would have no effect without --compare"),
    (["--normalized", "--out", "v.mp4"], "--normalized or --not-normalized would"),
    (["--overlay", "--out", "v.mp4"], "--overlay would have no effect without --compare"),
    (["--out", "v.mp4", "--size", "big"], "WIDTHxHEIGHT"),
    (["--out", "v.html", "--rights", "mine", "--silent"], "--rights is about music"),
    (["--out", "v.gif"], "an HTML file"),
])  # fmt: skip
def test_options_that_a_file_would_drop(demo, tmp_path, monkeypatch, options, words):
    monkeypatch.chdir(tmp_path)
    done = RUN.invoke(app, ["view", str(demo), open_store(demo).clips()[0].id, *options])
    assert (done.exit_code, os.listdir(tmp_path)) == (2, [])
    assert words in done.stderr


def test_names_that_the_locale_cannot_write(relabelled: Any, tmp_path: Path) -> None:
    store = relabelled(lambda k: {"id": f"t\u00e4nzer{k}"})
    out = tmp_path / "out"
    out.mkdir()
    done = subprocess.run(
        [sys.executable, "-m", "dancedata", "export", store, "--to", "bvh", "--out", out / "made" / "bvh", "-q"],
        env={**os.environ, "LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout, os.listdir(out)) == (1, "", [])
    assert done.stderr.startswith("error: a name cannot be written in this locale, whose encoding is ascii; found ")
    assert "LC_ALL=C.UTF-8" in done.stderr
    assert len(done.stderr.splitlines()) == 1


# Music is inside a page only if requested and allowed by its licence.


AIST = {"source": {"reader": "aist++"}, "licence": "research use, <b>no redistribution</b>"}


def test_music_of_the_demo_is_cut_to_its_clips(demo: Path, tmp_path: Path) -> None:
    import soundfile

    source = demo.parent / "demo-source"
    pages = [tmp_path / "a.html", tmp_path / "b.html"]
    for path in pages:
        write_report(demo, path, clips=2, audio="embed", source=source)
    assert pages[0].read_bytes() == pages[1].read_bytes()
    document = page_data(pages[0])
    assert sorted(document["audio"]) == ["0", "1"]
    for number, (_, _, frames, _) in enumerate(document["list"]["items"]):
        data = base64.b64decode(document["audio"][str(number)])
        assert len(data) < 60_000
        samples, rate = soundfile.read(io.BytesIO(data))
        assert samples.ndim == 1
        assert abs(len(samples) / rate - frames / 30) < 0.001
    assert "CC0" in document["head"]["notice"]


def test_music_that_may_not_be_shared_is_refused(relabelled, demo: Path, tmp_path: Path) -> None:
    path, source = relabelled(lambda k: {}, AIST), demo.parent / "demo-source"
    with raises_message(UsageError, "allow", where="relabelled"):
        write_report(path, tmp_path / "a.html", audio="embed", source=source)
    assert not (tmp_path / "a.html").exists()
    write_report(path, tmp_path / "a.html", clips=1, audio="embed", source=source, rights="granted to the tests")
    notice = page_data(tmp_path / "a.html")["head"]["notice"]
    assert notice.startswith("Music: included on the statement of the maker of this file")
    assert "<b>no redistribution</b>" in notice
    assert "<b>no redistribution" not in (tmp_path / "a.html").read_text()
    write_report(path, tmp_path / "silent.html")
    assert page_data(tmp_path / "silent.html")["audio"] == {}


def test_music_needs_a_source_that_has_it(demo: Path, tmp_path: Path) -> None:
    with raises_message(UsageError, "needed"):
        write_report(demo, tmp_path / "a.html", audio="embed")
    (tmp_path / "empty").mkdir()
    with raises_message(UsageError, "these", where="empty"):
        write_report(demo, tmp_path / "a.html", audio="embed", source=tmp_path / "empty")
