"""The fourteen commands: exit codes, the head of their JSON, their help."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
import typer

import dancedata
from dancedata.cli.app import app
from dancedata.cli.help import GROUPS
from tests.commands import as_json, run
from tests.conftest import Once

EVERY_WEEK = ["init", "build", "check", "info", "view", "report", "evaluate", "decode", "export", "features"]
NOW_AND_THEN = ["pull", "push", "study", "cache"]
COMMANDS: dict[str, Any] = dict(typer.main.get_command(app).commands)  # type: ignore[attr-defined]
SAMPLES = "--like DEMO --field edge151 --normalized"


@pytest.fixture(scope="module")
def demo(once: Once) -> Path:
    """Two songs with four clips of five seconds; the folder demo-source next to it is its source."""
    small = {"dataset.synthetic": {"songs": 2, "clips_per_song": 2, "clip_s": 5, "split": "all"}}

    def build(folder: Path) -> None:
        overrides = {**small, "windows": {"length_s": 4, "stride_s": 0.5}}
        dancedata.build("demo", out=folder / "demo", overrides=overrides, jobs=1, progress=False)

    return once("commands", build) / "demo"


@pytest.fixture
def places(demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "old.html").write_text("mine")
    return {"DEMO": str(demo), "SOURCE": str(demo.with_name("demo-source"))}


@pytest.mark.parametrize(
    ("line", "code", "word"),
    [
        ("build demo --dry-run --set dataset.synthetic.songs=2", 0, "splits"),
        ("build aist++ empty --dry-run", 1, "source"),
        ("build demo -o DEMO", 1, "source"), ("build aist++", 2, "usage"),
        ("build demo --part 1/2 --overwrite", 2, "usage"), ("build demo --nonsense", 2, "usage"),
        ("build", 2, "usage"),
        ("build demo -j 0", 2, "usage"), ("build nothing", 2, "usage"),
        ("check DEMO", 0, "problems"), ("check SOURCE", 0, "problems"), ("check DEMO --same-as DEMO", 0, "same"),
        ("check DEMO --faults", 0, "scores"), ("check nowhere", 1, "source"), ("check DEMO --atol 1", 2, "usage"),
        ("check DEMO DEMO --faults", 2, "usage"), ("check DEMO --faults --offsets", 2, "usage"),
        ("check SOURCE --set fps=60", 2, "usage"), ("check SOURCE --recipe nothing", 2, "usage"),
        ("info", 0, "checks"), ("info DEMO --clips", 0, "clips"), ("info DEMO --segments", 0, "layers"),
        ("info recipes", 0, "recipes"), ("info targets", 0, "exports"), ("info features", 0, "audio features"),
        ("info plugins", 0, "datasets"), ("info protocols", 0, "dancedata"), ("info aist++", 0, "windows"),
        ("info edge151", 0, "representations"), ("info edge-aistpp", 0, "metrics"), ("info edge15", 2, "usage"),
        ("info nowhere/x", 1, "store"), ("info --clips", 2, "usage"),
        ("view DEMO -o page.html gBR_sBM_cAll_d04_mBR0_ch01", 0, "path"), ("view DEMO", 2, "usage"),
        ("view DEMO nobody -o page.html", 2, "usage"), ("view DEMO --at nan -o page.html", 2, "usage"),
        ("view DEMO -o old.html", 2, "usage"),
        ("view nowhere -o page.html", 1, "nothing_matched"), ("view DEMO --silent", 2, "usage"),
        ("report nowhere", 1, "store"), (f"report DEMO {SAMPLES}", 2, "usage"),
        ("report SOURCE --field edge151", 2, "not_stated"),
        ("evaluate nowhere", 1, "nothing_matched"), ("evaluate DEMO --protocol nothing", 2, "usage"),
        ("evaluate DEMO -o scores.pdf", 2, "usage"), ("evaluate DEMO -o old.html", 2, "usage"),
        ("decode nowhere.npy --to bvh -o out", 1, "nothing_matched"),
        ("decode x.npy --to fbx -o out", 2, "usage"),
        ("decode x.npy", 2, "usage"), ("export DEMO --to npz -o out", 0, "target"),
        ("export DEMO --to segments -o out.csv", 0, "layers"), ("export DEMO --to nothing -o out", 2, "usage"),
        ("export DEMO --to card --link -o out.md", 2, "usage"), ("features nowhere.wav", 1, "nothing_matched"),
        ("features empty", 1, "nothing_matched"),
        ("pull jukebox", 2, "usage"), ("pull s3://b/x -o out", 2, "usage"), ("pull nothing", 2, "usage"),
        ("push DEMO nowhere", 2, "usage"), ("study DEMO DEMO", 2, "usage"), ("study a.csv", 1, "nothing_matched"),
        ("study answers*.csv", 1, "nothing_matched"),
        ("evaluate nothing*.npy", 1, "nothing_matched"),
        ("cache", 0, "stages"), ("cache verify", 0, "damaged"), ("cache prune", 2, "usage"),
        ("cache shrink", 2, "usage"), ("cache verify --dry-run", 2, "usage"), ("cache --remove", 2, "usage"),
        ("init empty", 1, "source"), ("init SOURCE --in-tree", 2, "usage"),
        ("init x --plugin-kind nothing", 2, "usage"), ("init x --plugin-kind metric --in-tree", 2, "usage"),
        ("plan demo", 2, "usage"),
    ],
)  # fmt: skip
def test_exit_codes_and_documents(places: dict[str, str], line: str, code: int, word: str) -> None:
    """With --json one document with one head: a result with this key, or an error with this code."""
    words = [places.get(part, part) for part in line.split()]
    document = json.loads(run(*words, "--json", code=code).stdout)
    assert list(document)[:4] == ["dancedata", "command", "ok", "warnings"]
    assert (document["command"], document["ok"]) == (words[0], code == 0)
    if code == 0:
        assert word in document["result"]
    else:
        error = document["error"]
        assert error["code"] == word
        assert (error["kind"] == "usage") == (code == 2)
        assert set(error) == {"kind", "code", "problem", "where", "found", "allowed", "fix"}


def test_a_report_of_the_command_has_the_differences_of_python(places: dict[str, str]) -> None:
    dancedata.build(
        "demo", out="other", overrides={"dataset.synthetic": {"songs": 2, "clip_s": 5}}, jobs=1, progress=False
    )
    printed = as_json("report", places["DEMO"], "--compare", "other", "--clips", "none")["differences"]
    assert printed
    assert printed == dancedata.report(places["DEMO"], compare="other", clips="none").to_json()["differences"]


def test_errors_of_the_system_are_documents(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise OSError(22, "Invalid argument")

    monkeypatch.setattr("dancedata.datasets.folder.prepare.prepare", refused)
    assert "Invalid argument" in as_json("init", tmp_path, code=1)["found"]


def test_warnings_are_in_the_document_and_on_stderr(places: dict[str, str]) -> None:
    shown = run("evaluate", places["DEMO"], "--metric", "geometric", "-j", 1, "-q")
    document = json.loads(run("evaluate", places["DEMO"], "--metric", "geometric", "-j", 1, "--json").stdout)
    assert document["warnings"]
    for warning in document["warnings"]:
        assert f"warning: {warning}" in shown.stdout + shown.stderr


def test_scores_are_written_by_suffix(places: dict[str, str], tmp_path: Path) -> None:
    files = [tmp_path / f"scores{suffix}" for suffix in (".csv", ".json", ".md", ".tex", ".npz")]
    words = [word for file in files for word in ("-o", file)]
    call = ("evaluate", places["DEMO"], "--metric", "kinetic", "-j", 1, *words)
    assert as_json(*call)["reports"] == json.loads(files[1].read_text())["reports"]
    assert all(file.stat().st_size for file in files)
    assert as_json(*call, code=2)["code"] == "usage"
    as_json(*call, "--overwrite")
    as_json("evaluate", places["DEMO"], "--metric", "kinetic", "-j", 1, "--pool", files[-1], "--strict", code=1)


def test_help_has_the_commands_of_every_week_first() -> None:
    assert run("-h").stdout == run(code=2).stdout
    text = run("-h").stdout
    assert list(COMMANDS) == EVERY_WEEK + NOW_AND_THEN
    assert [len(EVERY_WEEK), len(NOW_AND_THEN)] == list(GROUPS.values())
    assert re.findall(r"^  ([a-z]+) +[A-Z]", text, re.M)[:14] == EVERY_WEEK + NOW_AND_THEN
    assert "130" in run("--help").stdout
    assert "130" not in text


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_two_lengths(name: str) -> None:
    """Within 80 columns, with an example that parses; -h names what is rare, --help describes every option."""
    short, long = run(name, "-h").stdout, run(name, "--help").stdout
    options = [p for p in COMMANDS[name].params if p.param_type_name == "option" and not p.hidden]
    for text in (short, long):
        assert max(map(len, text.splitlines())) <= 80
        assert text.startswith(f"Usage: dancedata {name} ")
        assert [p.opts for p in options if p.opts[-1] not in text] == []
    assert all(option.help for option in options)
    for option in options:
        assert re.search(rf"^  (-\w, )?{option.opts[-1]}\b", long, re.M), option.opts
    examples = re.findall(rf"^  dancedata ({name}.*?)(?:  +\(.*)?$", short, re.M)
    assert examples
    for example in examples:
        context = COMMANDS[name].make_context(name, example.replace("'", "").split()[1:], resilient_parsing=True)
        assert context.params


def test_no_option_has_two_meanings_or_names() -> None:
    """An option that several commands have is written alike in all of them."""
    found: dict[str, set[tuple[Any, ...]]] = {}
    for command in COMMANDS.values():
        for option in command.params:
            if option.param_type_name == "option" and option.opts != ["-h"]:
                found.setdefault(option.opts[-1], set()).add((tuple(option.opts), option.is_flag, option.multiple))
    assert {name for name, forms in found.items() if len(forms) > 1} <= {
        "--out",
        "--compare",
        "--clips",
        "--segments",
    }
    assert len(found) <= 64
