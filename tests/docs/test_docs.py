"""The code of the pages runs as it stands there, and prints what they show; lines, links and lists are right."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dancedata.core.registry import EXPORTS
from dancedata.pipeline.build import build
from dancedata.pipeline.summary import describe_built
from dancedata.readers.presets import PRESETS
from dancedata.recipes.parse import load_recipe
from dancedata.store import open_store

ROOT = Path(__file__).resolve().parents[2]
PAGES = ["README.md", "CHANGELOG.md", *sorted(str(p.relative_to(ROOT)) for p in (ROOT / "docs").rglob("*.md"))]


def _blocks(page: str, language: str) -> list[str]:
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with data/demo in it, as README's first command leaves it."""
    folder = tmp_path_factory.mktemp("demo")
    build(load_recipe("demo"), folder / "data" / "demo-source", folder / "data" / "demo", cache=folder / "cache")
    return folder


def test_readme_snippets_print_what_it_says(demo: Path, capsys: pytest.CaptureFixture[str], monkeypatch) -> None:
    monkeypatch.chdir(demo)
    snippets, outputs = _blocks("README.md", "python"), _blocks("README.md", "text")
    assert len(snippets) >= 2
    names: dict[str, object] = {}
    for snippet in snippets:
        if "torch" in snippet:
            pytest.importorskip("torch")
        exec(compile(snippet, "README.md", "exec"), names)
        assert capsys.readouterr().out in outputs


@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
def test_the_python_page_prints_what_it_says(demo: Path, capsys: pytest.CaptureFixture[str], monkeypatch) -> None:
    pytest.importorskip("torch")
    monkeypatch.chdir(demo)
    monkeypatch.setenv("DANCEDATA_CACHE", str(demo / "cache"))
    text = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```\n)?", text, flags=re.DOTALL | re.MULTILINE)
    assert len(blocks) == len(_blocks("docs/python.md", "python")) >= 9
    names: dict[str, object] = {}
    for code, output in blocks:
        exec(compile(code, "python.md", "exec"), names)
        assert capsys.readouterr().out == output


def test_readme_shows_how_a_build_ends(demo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(demo)
    assert f"{describe_built(Path('data/demo'))}\n" in _blocks("README.md", "console")


def test_ci_runs_the_readmes_commands() -> None:
    commands = _blocks("README.md", "sh")
    # .ci/run takes the first two blocks from the page; each is one line to paste.
    assert [c.count("\n") for c in commands[:2]] == [1, 1]
    assert commands[0].startswith("python3.11 -m venv .venv && ")
    assert commands[0].endswith(".venv/bin/dancedata build demo\n")
    assert commands[1].startswith(".venv/bin/python -m pytest")


@pytest.fixture
def plug_in(tmp_path: Path):
    """Install a page's Python block as a distribution of its own, and run dancedata beside it."""

    def install(page: str, kind: str, name: str):
        code = _blocks(page, "python")[0]
        site = tmp_path / "site"
        info = site / f"{name}_plugin-1.0.dist-info"
        info.mkdir(parents=True)
        (site / f"my_{name}.py").write_text(code, encoding="utf-8")
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}-plugin\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[dancedata.{kind}]\n{name} = my_{name}\n")
        for recipe in _blocks(page, "yaml"):
            (tmp_path / "recipe.yaml").write_text(recipe, encoding="utf-8")
        paths = [str(site), str(ROOT), os.environ.get("PYTHONPATH", "")]
        return {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "DANCEDATA_CACHE": str(tmp_path / "cache")}

    return install


def _python(environment: dict[str, str], folder: Path, code: str) -> None:
    done = subprocess.run([sys.executable, "-c", code], env=environment, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def _dancedata(environment: dict[str, str], folder: Path, *arguments: str) -> str:
    command = [sys.executable, "-W", "error", "-m", "dancedata", *arguments]
    done = subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_added_feature_keeps_the_contract(plug_in, tmp_path: Path) -> None:
    environment = plug_in("docs/add-a-feature.md", "audio", "loudness")
    assert "loudness" in json.loads(_dancedata(environment, tmp_path, "list", "--json"))["audio features"]
    code = "import my_loudness; from dancedata.testing import conformance as c; "
    _python(environment, tmp_path, code + "c.check_audio_feature(my_loudness.Loudness)")


# As on the page, and by itself in the other scope.
@pytest.mark.parametrize(
    "override", ["fps=30", pytest.param("scope=window audio={loudness:{}}", marks=pytest.mark.nightly)]
)
def test_added_feature_builds(plug_in, tmp_path: Path, override: str) -> None:
    environment = plug_in("docs/add-a-feature.md", "audio", "loudness")
    overrides = [word for setting in override.split() for word in ("--set", setting)]
    _dancedata(environment, tmp_path, "build", "recipe.yaml", "--out", "out", "--jobs", "2", *overrides)
    about = json.loads(_dancedata(environment, tmp_path, "info", "out", "--json"))
    assert about["fields"]["loudness"]["columns"] == 1
    assert json.loads(_dancedata(environment, tmp_path, "check", "out", "--json"))["ok"]


def test_added_dataset_builds(plug_in, tmp_path: Path) -> None:
    environment = plug_in("docs/add-a-dataset.md", "datasets", "pairs")
    code = "import my_pairs; from pathlib import Path; from dancedata.testing import conformance as c; "
    code += "c.check_dataset(my_pairs.Pairs, Path('.')); my_pairs.Pairs().make_example(Path('source'))"
    _python(environment, tmp_path, code)
    (tmp_path / "source" / "train" / "silent.npz").write_bytes(b"not a zip")
    (tmp_path / "source" / "train" / "broken.npz").write_bytes(b"not a zip")
    (tmp_path / "source" / "train" / "broken.wav").write_bytes((tmp_path / "source/train/step.wav").read_bytes())
    _dancedata(environment, tmp_path, "build", "recipe.yaml", "--source", "source", "--out", "out", "--jobs", "1")
    about = json.loads(_dancedata(environment, tmp_path, "info", "out", "--json"))
    assert {split: n["clips"] for split, n in about["counts"].items()} == {"train": 1, "test": 1}
    assert about["rejects"] == {"broken_file": 1, "missing_music": 1}
    assert json.loads(_dancedata(environment, tmp_path, "check", "out", "--json"))["ok"]


def test_added_augmentation_keeps_the_contract(plug_in, tmp_path: Path) -> None:
    environment = plug_in("docs/add-an-augmentation.md", "augment", "turn")
    code = "import my_turn; from pathlib import Path; from dancedata.testing import conformance as c; "
    _python(environment, tmp_path, code + "c.check(my_turn.Turn, Path('.'))")


@pytest.mark.nightly
def test_an_augmentation_is_one_file_of_the_tree(tmp_path: Path) -> None:
    page = "docs/add-an-augmentation.md"
    for folder in ("dancedata", "pipelines", "manifests"):
        shutil.copytree(ROOT / folder, tmp_path / "tree" / folder, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "tree/dancedata/augment/turn.py").write_text(_blocks(page, "python")[0], encoding="utf-8")
    (tmp_path / "recipe.yaml").write_text(_blocks(page, "yaml")[0], encoding="utf-8")
    paths = os.pathsep.join([str(tmp_path / "tree"), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": paths, "DANCEDATA_CACHE": str(tmp_path / "cache")}
    assert "turn" in json.loads(_dancedata(environment, tmp_path, "list", "--json"))["augmentations"]
    planned = json.loads(_dancedata(environment, tmp_path, "plan", "recipe.yaml", "--out", "out", "--json"))
    _dancedata(environment, tmp_path, "build", "recipe.yaml", "--out", "out", "--jobs", "2")
    about = json.loads(_dancedata(environment, tmp_path, "info", "out", "--json"))
    assert about["counts"]["train"]["clips"] == planned["splits"]["train"]["clips"]
    assert json.loads(_dancedata(environment, tmp_path, "check", "out", "--json"))["ok"]
    with open_store(tmp_path / "out") as store:
        clip = next(c for c in store.clips if c.split == "train" and not c.source)
        joints = clip.read("joints").reshape(-1, 24, 3)
        turned = store.clip(f"{clip.id}__turn").read("joints").reshape(-1, 24, 3)
        root = joints[0, 0] * (1, 0, 1)
        np.testing.assert_allclose(turned - root, (joints - root) * (-1, 1, -1), atol=1e-5)
        assert store.clip(f"{clip.id}__turn").source == store.clip(f"{clip.id}__mirror").source == clip.id


def test_added_filter_builds(plug_in, tmp_path: Path) -> None:
    environment = plug_in("docs/add-a-filter.md", "filters", "grounded")
    code = "import my_grounded; from pathlib import Path; from dancedata.testing import conformance as c; "
    _python(environment, tmp_path, code + "c.check(my_grounded.Grounded, Path('.'))")
    _dancedata(environment, tmp_path, "build", "recipe.yaml", "--out", "out", "--jobs", "2", "--strict")
    with open_store(tmp_path / "out") as store:
        left_out = {(r["clip"], r["window"]) for r in store.rejects if r["reason"] == "filtered" and "window" in r}
        contact = store.fields["edge151"].slice("contact")
        shares = {
            (c.id, start): float(c.read("edge151")[start : start + 60, contact].any(axis=1).mean())
            for c in store.clips
            if c.split == "train"
            for start in range(0, c.n_frames - 59, 15)
        }
        kept = {(w.clip, w.start) for w in store.windows("train")}
        assert left_out == {window for window, share in shares.items() if share < 0.9}
        assert kept == shares.keys() - left_out
        assert kept
        assert left_out


def test_added_metric_measures(plug_in, tmp_path: Path) -> None:
    page = "docs/add-a-metric.md"
    environment = plug_in(page, "metrics", "jerk")
    assert "jerk" in json.loads(_dancedata(environment, tmp_path, "list", "--json"))["metrics"]
    code = "import my_jerk; from pathlib import Path; from dancedata.testing import conformance as c; "
    _python(environment, tmp_path, code + "c.check(my_jerk.Jerk, Path('.'))")
    _, use = _blocks(page, "python")
    command = [sys.executable, "-W", "error", "-c", use]
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stdout == _blocks(page, "text")[0], done.stderr


def test_the_page_of_exports_prints_what_it_says(
    demo: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(demo)
    (code,), (output,) = _blocks("docs/exports.md", "python"), _blocks("docs/exports.md", "text")
    exec(compile(code, "exports.md", "exec"), {})
    assert capsys.readouterr().out == output


def test_the_page_of_exports_names_every_target_and_option() -> None:
    text = (ROOT / "docs" / "exports.md").read_text(encoding="utf-8")
    table = text.split("## Targets")[1].split("## Options")[0]
    assert [name for name in EXPORTS.names() if f"\n| `{name}` |" not in table] == []
    for name in EXPORTS.names():
        reference = EXPORTS.get(name).reference
        _, _, commit = reference.partition(", commit ")
        assert commit[:7] in table, name


@pytest.mark.nightly
def test_an_export_is_one_file_of_the_tree(plug_in, tmp_path: Path) -> None:
    page = "docs/add-an-export.md"
    environment = plug_in(page, "exports", "poses")
    code = "import my_poses; from pathlib import Path; from dancedata.testing import conformance as c; "
    _python(environment, tmp_path, code + "c.check(my_poses.Poses, Path('conformance'))")
    shutil.rmtree(tmp_path / "site")
    for folder in ("dancedata", "pipelines", "manifests"):
        shutil.copytree(ROOT / folder, tmp_path / "tree" / folder, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "tree/dancedata/exports/poses.py").write_text(_blocks(page, "python")[0], encoding="utf-8")
    environment["PYTHONPATH"] = os.pathsep.join([str(tmp_path / "tree"), os.environ.get("PYTHONPATH", "")])
    assert "poses" in json.loads(_dancedata(environment, tmp_path, "list", "--json"))["exports"]
    _dancedata(environment, tmp_path, "build", "recipe.yaml", "--out", "data", "--jobs", "1")
    arguments = ("export", "data", "--to", "poses", "--out", "poses", "--set", "scale=100", "--json")
    about = json.loads(_dancedata(environment, tmp_path, *arguments))
    assert about["parameters"] == {"scale": 100.0}
    with open_store(tmp_path / "data") as store:
        for clip in store.clips:
            positions = np.load(tmp_path / "poses" / "poses" / f"{clip.id}.npy")
            np.testing.assert_allclose(positions.reshape(clip.n_frames, -1), 100 * clip.read("joints"), rtol=1e-6)
        names = (tmp_path / "poses" / "train.txt").read_text().split()
        assert names == sorted(clip.id for clip in store.clips if clip.split == "train")


@pytest.mark.parametrize("page", PAGES)
def test_lines_are_short(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    assert [line for line in text.splitlines() if len(line) > 120 and not line.startswith("|")] == []


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page: str) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", text):
        if "://" not in target:
            assert (ROOT / page).parent.joinpath(target).exists(), target


def test_the_index_has_every_page() -> None:
    index = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    pages = {path.name for path in (ROOT / "docs").glob("*.md")} - {"README.md"}
    assert pages <= set(re.findall(r"\]\(([^)]+)\)", index))


def test_readme_names_every_preset() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert [name for name in PRESETS if f'"{name}"' not in text] == []


@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
@pytest.mark.parametrize("page", ["evaluation", "metrics"])
def test_the_pages_on_evaluation_print_what_they_say(
    demo: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, page: str
) -> None:
    monkeypatch.chdir(demo)
    monkeypatch.setenv("DANCEDATA_CACHE", str(demo / "cache"))
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```\n)?", text, flags=re.DOTALL | re.MULTILINE)
    assert blocks
    names: dict[str, object] = {}
    for code, output in blocks:
        exec(compile(code, f"{page}.md", "exec"), names)
        assert capsys.readouterr().out == output


def test_added_protocol_evaluates(plug_in, demo: Path, tmp_path: Path) -> None:
    page = "docs/add-a-protocol.md"
    environment = plug_in(page, "evaluation.protocols", "ten_seconds")
    environment["DANCEDATA_CACHE"] = str(demo / "cache")
    (command,) = _blocks(page, "sh")
    printed = _dancedata(environment, demo, *command.split()[1:])
    assert printed.splitlines()[0] == f"ten-seconds, version 1: {demo}/data/demo as truth"
    assert "pieces, 30 frames per second, 10.00 s" in printed
    (line,) = (line for line in printed.splitlines() if line.startswith("  PFC "))
    assert "1.2500" in line
    listed = _dancedata(environment, demo, "evaluate", "--list-protocols")
    assert "ten-seconds, version 1: Pieces of ten seconds at 30 frames per second" in listed
    assert "generated: pieces of 300 frames every 150, the first 900 frames" in listed
