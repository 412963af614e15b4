"""The code of the pages runs unchanged and prints the output shown; lines, links and lists are right."""

import contextlib
import doctest
import importlib
import inspect
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml

import dancedata
from dancedata.cli.plugins import write_plugin
from dancedata.core.registry import FEATURES
from dancedata.core.resources import resource
from dancedata.decoding.files import FORMATS
from dancedata.exports.base.job import EXPORTS
from dancedata.recipes.parse import parse_recipe
from dancedata.store import open_store, verify_store
from dancedata.torch.plain import PRESETS
from tests import warm
from tests.docs.pages import ROOT, WRITTEN, blocks, load, text_of, with_output
from tests.groups_store import write_groups

PAGES = ["README.md", "CHANGELOG.md", *sorted(str(p.relative_to(ROOT)) for p in (ROOT / "docs").rglob("*.md"))]
#: Pages whose code with output prints that output, in the folder of the demo.
PRINTING = ["guides/music", "guides/batches", "guides/look", "guides/samples",
            "reference/columns", "reference/exports", "reference/protocols"]  # fmt: skip


@pytest.fixture(scope="module")
def demo(run_build: Callable[..., object], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with data/demo in it, as README's first command leaves it."""
    data = tmp_path_factory.mktemp("demo") / "data"
    run_build(data / "demo-source", data / "demo", "demo")
    return data.parent


def test_readme_snippets_print_the_output_shown(demo: Path, capsys: pytest.CaptureFixture[str], monkeypatch) -> None:
    monkeypatch.chdir(demo)
    snippets, outputs = blocks("README.md", "python"), blocks("README.md", "text")
    assert snippets
    names: dict[str, object] = {}
    for snippet in snippets:
        if "torch" in snippet:
            pytest.importorskip("torch")
        exec(compile(snippet, "README.md", "exec"), names)
        assert capsys.readouterr().out in outputs


@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
@pytest.mark.parametrize("page", PRINTING)
def test_a_page_prints_the_output_shown(demo, capsys, monkeypatch, page):
    if page.startswith("guides/"):
        pytest.importorskip("torch")
    monkeypatch.chdir(demo)
    # The code on key motions needs another dataset (tests/keymotion), that on encoders a model.
    shown = [(code, output) for code, output in with_output(f"docs/{page}.md") if output or "columns" not in page]
    shown = [(code, output) for code, output in shown if "mert-95m" not in code]
    assert shown
    names: dict[str, object] = {}
    for code, output in shown:
        exec(compile(code, f"{page}.md", "exec"), names)
        assert capsys.readouterr().out == output


def test_ci_runs_the_readmes_commands() -> None:
    commands = blocks("README.md", "sh")
    # .ci/run takes the first two blocks from the page; each is one line to paste.
    assert [c.count("\n") for c in commands[:2]] == [1, 1]
    assert commands[0].startswith("python3.11 -m venv .venv && ")
    assert commands[0].endswith(".venv/bin/dancedata build demo\n")
    assert commands[1].startswith('.venv/bin/pip install -c constraints.txt -e ".[dev]" && ')  # .ci/run splits it
    assert commands[1].endswith(".venv/bin/python -m pytest -n auto\n")


@pytest.fixture
def distribution(tmp_path: Path) -> Callable[[dict[str, tuple[str, str]]], dict[str, str]]:
    """Install modules as a distribution with entry points; returns the environment in which dancedata sees them."""

    def install(modules: dict[str, tuple[str, str]]) -> dict[str, str]:
        site = tmp_path / "site"
        info = site / "plugins-1.0.dist-info"
        info.mkdir(parents=True)
        for name, (_, code) in modules.items():
            (site / f"{name}.py").write_text(code, encoding="utf-8")
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: plugins\nVersion: 1.0\n")
        groups = (f"[dancedata.{group}]\n{name} = {name}\n" for name, (group, _) in modules.items())
        (info / "entry_points.txt").write_text("".join(groups))
        paths = [str(site), str(ROOT), os.environ.get("PYTHONPATH", "")]
        return {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "DANCEDATA_CACHE": str(tmp_path / "cache")}

    return install


def _dancedata(environment: dict[str, str], folder: Path, *arguments: str) -> str:
    with contextlib.chdir(folder):
        done = warm.run([sys.executable, "-m", "dancedata", *arguments], environment)
    assert done.returncode == 0, done.stderr
    return done.stdout


#: A recipe with a plug-in of every kind that it names in addition to its dataset.
RECIPE = """
recipe: 1
name: plug-ins
dataset: {synthetic: {songs: 2, clips_per_song: 2, clip_s: 6}}
windows: {length_s: 5, stride_s: 0.5}
rules: {small: {limit: 50}}
motion: {edge151: {contacts: {low: {}}}, pelvis: {}}
audio: {librosa35: {}, peaks: {scale: 0.5}}
keymotion: {speeds: {}}
augment: {mirror: true, aside: {step_m: 0.25}}
"""
#: Their kinds and groups of entry points.
KINDS = {
    "small": ("filter", "filters"), "low": ("contact-rule", "contacts"), "speeds": ("key-motion", "keymotion"),
    "peaks": ("feature", "audio"), "aside": ("augmentation", "augment"),
    "pelvis": ("representation", "representations"),
}  # fmt: skip


def test_plug_ins_of_another_distribution_build(distribution, tmp_path: Path) -> None:
    environment = distribution({
        name: (group, write_plugin(kind, name, tmp_path / "new").module.read_text(encoding="utf-8"))
        for name, (kind, group) in KINDS.items()
    })  # fmt: skip
    (tmp_path / "recipe.yaml").write_text(RECIPE, encoding="utf-8")
    build = ("build", "recipe.yaml", "--out", "out")
    planned = json.loads(_dancedata(environment, tmp_path, *build, "--dry-run", "--json"))["result"]
    command = [sys.executable, "-W", "error", "-m", "dancedata", *build, "--jobs", "2"]
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert [problem for problem in verify_store(tmp_path / "out") if problem.severity == "error"] == []
    with open_store(tmp_path / "out") as store:
        widths = {name: store.field(name).columns.width for name in ("pelvis", "peaks", "speeds")}
        assert widths == {"pelvis": 3, "peaks": 1, "speeds": 1}
        assert sum(c.split == "train" for c in store) == planned["splits"]["train"]["clips"]
        clip = next(c for c in store if c.split == "train" and not c.source)
        copy = store[f"{clip.id}__aside"]
        assert copy.source == store[f"{clip.id}__mirror"].source == clip.id
        shift = copy.read("pelvis") - clip.read("pelvis")
        np.testing.assert_allclose(shift, [[0.25, 0, 0]] * clip.n_frames, atol=1e-6)
        assert 0 < clip.read("peaks").max() <= 0.5


def test_the_page_of_exports_names_every_target_and_option() -> None:
    text = text_of("docs/reference/exports.md")
    table = text.split("## Targets")[1].split("## Options")[0]
    assert [name for name in EXPORTS.names() if f"\n| `{name}` |" not in table] == []
    for name in EXPORTS.names():
        reference = EXPORTS.get(name).reference
        _, _, commit = reference.partition(", commit ")
        assert commit[:7] in table, name


@pytest.mark.parametrize("page", PAGES)
def test_lines_are_short_and_links_lead_somewhere(page: str) -> None:
    text = text_of(page)
    assert [line for line in text.splitlines() if len(line) > 120 and not line.startswith("|")] == []
    targets = [target for target in re.findall(r"\]\(([^)#]+)[^)]*\)", text) if "://" not in target]
    assert [target for target in targets if not (ROOT / page).parent.joinpath(target).exists()] == []


def test_tables_that_the_code_knows_are_those_of_the_code() -> None:
    generated = load(ROOT / "docs" / "site" / "generated.py")
    pages = {path: path.read_text(encoding="utf-8") for path in WRITTEN}
    assert [str(path) for path, text in pages.items() if generated.filled(text) != text] == []
    places = [name for text in pages.values() for name in re.findall(r"<!-- generated: ([\w-]+) -->", text)]
    assert set(places) == generated.TABLES.keys()


def test_the_index_has_every_page() -> None:
    index = text_of("docs/README.md")
    pages = {str(path.relative_to(ROOT / "docs")) for path in WRITTEN} - {"README.md"}
    assert pages <= set(re.findall(r"\]\(([^)]+)\)", index))


def test_the_guide_on_batches_names_every_preset() -> None:
    text = text_of("docs/guides/batches.md")
    assert [name for name in PRESETS if f"| `{name}` |" not in text] == []


def test_the_protocol_of_the_page_evaluates(distribution, demo: Path, cache: Path) -> None:
    (code,) = (block for block in blocks("docs/tutorials/add-your-own.md", "python") if "PROTOCOLS" in block)
    environment = distribution({"ten_seconds": ("evaluation.protocols", code)})
    environment["DANCEDATA_CACHE"] = str(cache)
    printed = _dancedata(environment, demo, "evaluate", "data/demo", "--protocol", "ten-seconds", "--jobs", "1")
    assert "pieces, 30 frames per second, 10.00 s" in printed
    listed = _dancedata(environment, demo, "info", "protocols")
    assert "ten-seconds, version 1: Pieces of ten seconds at 30 frames per second" in listed
    assert "generated: pieces of 300 frames every 150, the first 900 frames" in listed


# Examples in docstrings are run, on a tiny dataset, and print what they show.


MODULES = ("torch", "metrics", "core.grid", "core.motion", "core.skeleton", "core.rotations", "store", "keymotion")
MODULES += ("synthetic", "testing.examples", "testing.stores", "testing.conformance")


def public_objects() -> Iterator[tuple[str, object]]:
    """Yield the public functions, classes and their methods, each once, with the address of its definition."""
    seen = set()
    for module in (dancedata, *(importlib.import_module(f"dancedata.{name}") for name in MODULES)):
        names = getattr(module, "__all__", None) or [n for n in vars(module) if not n.startswith("_")]
        for value in (getattr(module, name) for name in names):
            if not (inspect.isfunction(value) or inspect.isclass(value)) or value in seen:
                continue
            seen.add(value)
            if value.__module__.startswith("dancedata."):
                yield f"{value.__module__}.{value.__qualname__}", value
                for name, method in vars(value).items() if inspect.isclass(value) else ():
                    if not name.startswith("_") and inspect.isfunction(method):
                        yield f"{value.__module__}.{method.__qualname__}", method


@pytest.fixture(scope="module")
def doc_files(built: Path, corpus: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder and home with the files that the examples name."""
    folder = tmp_path_factory.mktemp("docstrings")
    for name in ("aistpp", "the-same-again"):
        shutil.copytree(built, folder / "data" / name)
    write_groups(folder / "data" / "groups")
    (folder / "aist_plusplus_final").symlink_to(corpus)
    shutil.copy(sorted((corpus / "wavs").iterdir())[0], folder / "song.wav")
    with dancedata.open(built) as ds:
        rows = np.stack([ds.read(window, "edge151") for window in ds.windows("train")[:2]])
        np.save(folder / "samples.npy", ds.scaler("edge151").normalize(rows))
    return folder


def examples(value: object) -> list[doctest.Example]:
    return doctest.DocTestParser().get_examples(inspect.getdoc(value) or "")


OBJECTS = {name: value for name, value in public_objects() if examples(value)}


def test_headings_of_sections_are_lines_of_their_own() -> None:
    """A tool that fills paragraphs joins "Notes" and its dashes to the text."""
    files = sorted(Path(dancedata.__file__).parent.rglob("*.py"))
    assert [file for file in files if re.search(r"^ *[A-Z]\w+ -{3,}", file.read_text(), re.MULTILINE)] == []


def test_examples_exist_and_show_output() -> None:
    assert len([value for value in OBJECTS.values() if any(example.want for example in examples(value))]) >= 25


@pytest.mark.parametrize("name", OBJECTS)
def test_examples(name: str, doc_files: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(doc_files)
    monkeypatch.setenv("HOME", str(doc_files))
    text = inspect.getdoc(OBJECTS[name]) or ""
    test = doctest.DocTestParser().get_doctest(text, {}, name, None, 0)
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    printed: list[str] = []
    runner.run(test, out=printed.append)
    assert not runner.failures, "".join(printed)


# Pages on single subjects: their code prints what they show, and their lists are whole.


def test_a_recipe_of_the_page_has_both_rates() -> None:
    block = next(block for block in blocks("docs/reference/recipes.md", "yaml") if "both-rates" in block)
    recipe = parse_recipe(yaml.safe_load(block))
    rates = {field.name: int(field.grid.rate) for field in (*recipe.motion, *recipe.audio)}
    assert rates == {"edge151": 30, "fact219": 60, "librosa35": 30, "librosa35.60": 60, "bailando438": 60}


def test_every_feature_and_format_is_on_its_page() -> None:
    assert all(f"| `{name}` | " in text_of("docs/guides/music.md") for name in FEATURES.names())
    table = text_of("docs/guides/samples.md").split("## Decode")[1].split("\n\n")[1]
    named = {name for line in table.splitlines()[2:] for name in re.findall(r"`(\w+)`", line.split("|")[1])}
    assert named == set(FORMATS)


@pytest.fixture(scope="module")
def encoders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a random model of MERT's layout, depth and width, whose other sizes are tiny."""
    pytest.importorskip("transformers")
    from dancedata.testing.encoders import write_random_model

    made = tmp_path_factory.mktemp("encoders")
    sizes = {"hidden_size": 768, "num_hidden_layers": 12, "num_attention_heads": 2, "intermediate_size": 8}
    sizes |= {"num_conv_pos_embeddings": 4}
    write_random_model("mert", made / "mert-95m", **sizes)
    return made


def test_the_code_of_encoders_prints_the_output_shown(encoders, capsys, monkeypatch):
    monkeypatch.chdir(encoders)
    code, output = next(shown for shown in with_output("docs/guides/music.md") if "mert-95m" in shown[0])
    exec(compile(code, "music.md", "exec"), {})
    assert capsys.readouterr().out == output


def test_the_ways_to_reproduce_are_recipes() -> None:
    """Every mapping of the page's table and YAML is one that a recipe may have."""
    table = text_of("docs/guides/music.md").split("the keys that reproduce it:")[1].split("Tests ran")[0]
    mappings = re.findall(r"`((?:hf\.\w+|bailando438|jukebox): \{.*?\})`", table)
    assert len(mappings) >= 7
    written = [code.removeprefix("audio:\n") for code in blocks("docs/guides/music.md", "yaml")]
    for audio in (*mappings, *written):
        document = yaml.safe_load(resource("pipelines", "finedance-mert.yaml").read_text(encoding="utf-8"))
        # At 60 and 75 rows per second windows have to be whole numbers of rows.
        windows = {"length_s": 4, "stride_s": 2}
        parse_recipe({**document, "audio": yaml.safe_load(audio), "windows": windows})


def test_the_page_of_encoders_names_every_model_type() -> None:
    pytest.importorskip("torch")
    from dancedata.audio.hf.families import FAMILIES

    paragraph = text_of("docs/guides/music.md").split("**Models that can be read**")[1].split("\n\n")[0]
    known = {kind for family in FAMILIES for kind in family.model_types}
    assert set(re.findall(r"`([\w-]+)`", paragraph.split("`config.json`:")[1])) == known
