"""dancedata build of publications: the same bytes, which clip differs, and nothing that is executed."""

import json
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata import comparison
from dancedata.building.rebuild import Publication
from dancedata.core import plugin_files
from dancedata.core.errors import RecipeError, StoreError, UsageError
from dancedata.core.hashing import json_sha256, sha256_bytes
from dancedata.core.registry import DATASETS, REGISTRIES
from dancedata.remote.pull import pull
from dancedata.remote.push import push
from dancedata.store.schema import LOCAL_FILE
from tests import warm
from tests.commands import run
from tests.messages import raises_message
from tests.remote.upload_hub import UploadHub

pytestmark = pytest.mark.usefixtures("no_local_plugins")
WHERE = "hf://datasets/org/name"
FINE = {
    "recipe": 1, "name": "fine", "dataset": {"finedance": {}}, "windows": {"length_frames": 60, "stride_frames": 30},
    "motion": {"lodge139": {}}, "audio": {"librosa35": {}},
}  # fmt: skip
DEMO = {"dataset.synthetic.songs": 2, "dataset.synthetic.clips_per_song": 2, "dataset.synthetic.clip_s": 6}
TEMPLATES = Path(dancedata.__file__).parent / "cli" / "templates"


@pytest.fixture(scope="session")
def fine_source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fine") / "source"
    DATASETS.get("finedance")().make_example(folder)
    return folder


@pytest.fixture(scope="session")
def fine(fine_source: Path, cache: Path) -> Path:
    """A dataset that may not be passed on."""
    out = fine_source.with_name("out")
    dancedata.build(FINE, fine_source, out, jobs=1, cache=cache, progress=False)
    return out


@pytest.fixture
def published_fine(uploads: UploadHub, fine: Path) -> UploadHub:
    push(fine, WHERE, recipe_only=True, progress=False)
    return uploads


@pytest.fixture
def as_folder(published_fine: UploadHub, tmp_path: Path) -> Path:
    """The publication as a folder, as another program would fetch it."""
    folder = tmp_path / "fetched"
    folder.mkdir()
    for name, data in published_fine.files().items():
        (folder / name).write_bytes(data)
    return folder


def rebuild(recipe: str | Path, source: Path, out: Path, cache: Path, **options: Any) -> Any:
    return dancedata.build(recipe, source, out, jobs=1, cache=cache, progress=False, **options)


def in_new_process(*args: object) -> str:
    done = warm.run([sys.executable, "-m", "dancedata", *map(str, args)])
    assert done.returncode == 0, done.stderr
    return done.stdout


def change(source: Path) -> Path:
    """Change a number of one motion file."""
    motion = sorted((source / "motion").glob("*.npy"))[0]
    rows = np.load(motion)
    rows[5, 0] += 0.01
    np.save(motion, rows)
    return motion


def test_finedance_in_a_clean_process(published_fine, fine, fine_source, tmp_path):
    text = in_new_process("build", WHERE, fine_source, "--out", tmp_path / "again", "--jobs", 1)
    assert f"the same bytes as {WHERE}@" in text
    for file in {*fine.iterdir()} - {fine / LOCAL_FILE}:
        assert (tmp_path / "again" / file.name).read_bytes() == file.read_bytes()


def test_the_demo_in_a_clean_process(uploads: UploadHub, tmp_path: Path, cache: Path) -> None:
    built = dancedata.build("demo", out=tmp_path / "demo", overrides=DEMO, jobs=1, cache=cache, progress=False)
    push(built.path, WHERE, recipe_only=True, progress=False)
    text = in_new_process("build", WHERE, "--out", tmp_path / "again", "--jobs", 1, "--json")
    assert json.loads(text)["result"]["rebuilt"] is True
    assert (tmp_path / "again/dataset.json").read_bytes() == (tmp_path / "demo/dataset.json").read_bytes()


def test_which_clip_differs(published_fine, fine_source, tmp_path, cache, capsys):
    source = shutil.copytree(fine_source, tmp_path / "source")
    change(source)
    result = run(
        "build", WHERE, source, "--out", tmp_path / "again", "--jobs", 1, "--cache", cache, code=1
    )  # fmt: skip
    assert "another source than that of the publication: different motion in 1 clip: motion/001.npy" in result.output
    assert f"other bytes than {WHERE}@" in result.output
    again = json.loads(
        run("build", WHERE, source, "--out", tmp_path / "again", "--json", "--cache", cache, code=1).stdout
    )
    assert again["result"]["rebuilt"] is False


def test_a_missing_file_is_another_source(published_fine, fine_source, tmp_path, cache):
    source = shutil.copytree(fine_source, tmp_path / "source")
    sorted((source / "motion").glob("*.npy"))[0].unlink()
    assert rebuild(WHERE, source, tmp_path / "a", cache).rebuilt is False


def test_a_folder_a_server_and_a_whole_dataset(as_folder, fine, server, fine_source, tmp_path, cache):
    server.folder = as_folder.parent
    for k, place in enumerate((as_folder, fine, f"{server.url}/fetched")):
        assert rebuild(place, fine_source, tmp_path / str(k), cache).rebuilt is True


def test_opening_it_says_how_to_build(published_fine: UploadHub) -> None:
    assert "a recipe and no data" in run("check", WHERE, code=1).output
    for use in (dancedata.open, comparison.diff):
        with pytest.raises(StoreError, match=r"a recipe and no data.*dancedata build hf://datasets/org/name@"):
            use(*[WHERE] * (2 if use is comparison.diff else 1))
    files = {p.name for p in pull(WHERE, progress=False).path.iterdir()}
    assert files == {"publication.json", "clips.jsonl", "recipe.yaml", "rejects.jsonl", "stats.json"}


def test_files_beside(uploads: UploadHub, fine: Path, fine_source: Path, tmp_path: Path, cache: Path) -> None:
    """The manifest of a folder goes along by itself."""
    source, recipe = tmp_path / "source", {**FINE, "dataset": {"folder": {}}, "motion": {"joints": {}}, "audio": {}}
    DATASETS.get("folder")().make_example(source)
    built = dancedata.build(recipe, source, tmp_path / "built", jobs=1, cache=cache, progress=False).path
    more = tmp_path / "notes.csv"
    more.write_text("id\n")
    push(built, WHERE, recipe_only=True, beside=[more, source / "manifest.csv"], progress=False)
    assert uploads.files()["manifest.csv"] == (source / "manifest.csv").read_bytes()
    published = Publication.at(WHERE)
    assert published is not None
    assert "notes.csv" in "".join(published.missing_beside(source))
    assert "manifest.csv" in "".join(published.missing_beside(fine_source))
    shutil.copy(more, source)
    assert not list(published.missing_beside(source))
    with raises_message(UsageError, "publication", where="out/dataset.json"):
        push(fine, WHERE, recipe_only=True, beside=[fine / "dataset.json"], progress=False)
    with raises_message(UsageError, "directory", where="nothing.csv"):
        push(fine, WHERE, recipe_only=True, beside=[tmp_path / "nothing.csv"], progress=False)


class edited:  # noqa: N801 (a context)
    """publication.json of a folder, to change; its hashes are made right again."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "publication.json"

    def __enter__(self) -> dict[str, Any]:
        self.document = json.loads(self.path.read_text())
        return self.document

    def __exit__(self, *error: object) -> None:
        for document in (self.document["dataset"], self.document):
            if isinstance(document, dict):
                document["self_sha256"] = json_sha256({k: v for k, v in document.items() if k != "self_sha256"})
        self.path.write_text(json.dumps(self.document))


@pytest.fixture
def bomb(as_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A plug-in beside the recipe that leaves a file if it is executed; the working folder is that of the recipe."""
    trace = as_folder / "executed"
    (as_folder / "x.py").write_text(f"open({str(trace)!r}, 'w').close()\n")
    monkeypatch.chdir(as_folder)
    yield as_folder
    assert not trace.exists()


@pytest.mark.parametrize(
    "recipe",
    [
        {"plugins": ["./x.py"]},
        {"dataset": {"finedance": {}, "aist++": {"music_dir": "/etc"}}},
        {"dataset": {"folder": {"body_model": "~/model.pkl"}}},
        {"audio": {"jukebox": {"weights": "/tmp"}}},
        {"audio": {"hf.mert": {"model": "evil/model"}}},
    ],
)
def test_what_a_published_recipe_may_not_have(bomb, recipe, fine_source, out):
    with edited(bomb) as document:
        document["dataset"]["recipe"] |= recipe
    with raises_message(RecipeError, "executed", where="fetched"):
        dancedata.build(bomb, fine_source, out, progress=False)
    assert not out.exists()


def test_local_plugins(uploads, corpus, tmp_path, cache, own_cache, out):
    plugin = tmp_path / "loudness.py"
    text = (TEMPLATES / "feature.py").read_text()
    plugin.write_text(text.replace("TemplateName", "Loudness").replace("template_name", "loudness"))
    recipe = {
        "recipe": 1, "name": "local", "dataset": {"aist++": {}}, "windows": {"length_s": 2, "stride_s": 0.5},
        "motion": {"edge151": {}}, "audio": {"loudness": {}}, "plugins": [str(plugin)],
    }  # fmt: skip
    built = dancedata.build(recipe, corpus, tmp_path / "first", jobs=1, cache=cache, progress=False).path
    push(built, WHERE, recipe_only=True, beside=[plugin], progress=False)
    for registry in REGISTRIES.values():
        registry._classes.pop("loudness", None)
    plugin_files._files.clear()
    with pytest.raises(UsageError, match="does not execute by itself") as caught:
        rebuild(WHERE, corpus, out, cache)
    here = next(own_cache.rglob("loudness.py"))
    assert f"audio loudness: published, here as {here}" in str(caught.value)
    assert here.read_bytes() == plugin.read_bytes()
    assert not [name for name in sys.modules if "loudness" in name and name in plugin_files._files]
    dancedata.load_plugins(here)  # the user's own step
    assert rebuild(WHERE, corpus, out, cache).rebuilt


@pytest.mark.parametrize(
    "lie",
    [
        lambda d: d["files"].update({"../x": d["files"]["clips.jsonl"]}),
        lambda d: d["dataset"]["files"].update({"../../x": {"size": 1, "sha256": "0" * 64}}),
        lambda d: d["dataset"].update(recipe=7),
        lambda d: d["dataset"]["source"].update(sha256=None),
        lambda d: d.update(dataset=[]),
        lambda d: d.update(publication=2),
        lambda d: d["files"].update({"clips.jsonl": 3}),
    ],
)  # fmt: skip
def test_publications_that_lie(as_folder: Path, lie: Callable[[Any], Any], fine_source: Path, out: Path) -> None:
    try:
        with edited(as_folder) as document:
            lie(document)
    except TypeError:
        pass
    with pytest.raises(StoreError):
        dancedata.build(as_folder, fine_source, out, progress=False)
    assert not out.exists()


@pytest.mark.parametrize("content", [b"[", b"{}\n", b"\xff", b'{"id": [], "made_of": {}, "lists": 3}\n'])
def test_clips_that_are_damaged(as_folder, fine_source, tmp_path, cache, content):
    (as_folder / "clips.jsonl").write_bytes(content)
    with edited(as_folder) as document:
        document["files"]["clips.jsonl"] = {"size": len(content), "sha256": sha256_bytes(content)}
    source = shutil.copytree(fine_source, tmp_path / "source")
    change(source)
    with raises_message(StoreError, "publication", where="fetched"):
        rebuild(as_folder, source, tmp_path / "again", cache)


def test_gigantic_lengths(as_folder, server, fine_source, tmp_path, cache, own_cache):
    with edited(as_folder) as document:
        document["files"]["clips.jsonl"]["size"] = 1 << 70
    server.folder = as_folder.parent
    source = shutil.copytree(fine_source, tmp_path / "source")
    change(source)
    with pytest.raises(StoreError, match="there is no space for the file"):
        rebuild(f"{server.url}/fetched", source, tmp_path / "out", cache)


def test_a_changed_byte(as_folder: Path, fine_source: Path, tmp_path: Path, cache: Path, out: Path) -> None:
    (as_folder / "clips.jsonl").write_text("")
    source = shutil.copytree(fine_source, tmp_path / "source")
    change(source)
    with raises_message(StoreError, "publication", where="fetched/clips.jsonl"):
        rebuild(as_folder, source, out, cache)
    path = as_folder / "publication.json"
    path.write_text(path.read_text().replace('"name"', '"nane"', 1))
    with pytest.raises(StoreError, match=r"a damaged one; found ValueError: 'self_sha256 \w+\.\.\., content"):
        rebuild(as_folder, source, out, cache)
