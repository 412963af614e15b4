"""Fetching models from a test hub on this machine."""

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from tests.messages import raises_message
from tests.remote.servers import Handler, Server, serving

pytest.importorskip("huggingface_hub", minversion="1.1")

from huggingface_hub import constants

from dancedata.audio.hf.fetch import fetch_model
from dancedata.audio.hf.model_folder import PROVENANCE, open_model
from dancedata.cli.app import app
from dancedata.core.errors import SourceError, UsageError

COMMIT, NAME = "a1" * 20, "someone/tiny-model"
CARD = b"---\nlicense: cc-by-nc-4.0\n---\n# Tiny\n"
FILES = {
    "config.json": b'{"model_type": "hubert"}',
    "preprocessor_config.json": b'{"sampling_rate": 16000}',
    "model.safetensors": bytes(range(256)) * 20,
    "pytorch_model.bin": b"a pickle" * 300,
    "README.md": CARD,
    "LICENSE": b"text",
    "modeling_tiny.py": b"raise SystemExit",
    "sub/config.json": b"{}",
    "../config.json": b"{}",
    ".hidden.safetensors": b"",
    "training_args.bin": b"a pickle",
    "a\x1b[2Jb\ud800": b"",
}


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


class HubHandler(Handler):
    do_HEAD = Handler.do_GET

    def reply(self, data: bytes, **headers: str) -> None:
        self.send_response(200)
        for name, value in {**headers, "Content-Length": str(len(data))}.items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(data)


class Hub(Server):
    """The requests of the hub's client: the description of a model, and its files."""

    def __init__(self, files: dict[str, bytes]) -> None:
        super().__init__(Path())
        self.RequestHandlerClass = HubHandler
        self.files, self.announced = dict(files), dict(files)
        self.error: tuple[int, str] | None = None
        self.broken: str | None = None
        self.asked: list[str] = []

    def tree(self) -> bytes:
        files = []
        for path, data in self.announced.items():
            oid = hashlib.sha1(b"blob %d\0" % len(data) + data).hexdigest()
            lfs = {"lfs": {"oid": sha256(data), "size": len(data), "pointerSize": 1}} if len(data) > 999 else {}
            files.append({"type": "file", "path": path, "size": len(data), "oid": oid, **lfs})
        return json.dumps(files).encode()

    def answer(self, handler: Any, path: str) -> bool:
        self.asked.append(path)
        name = path.partition(f"/{NAME}/resolve/{COMMIT}/")[2]
        if self.error is not None:
            handler.status(self.error[0], X_Error_Code=self.error[1])
        elif path == f"/api/models/{NAME}/tree/{COMMIT}":
            handler.reply(self.tree(), Content_Type="application/json")
        elif path.startswith("/api/models/"):
            siblings = [{"rfilename": name} for name in self.announced]
            about = {"id": NAME, "sha": COMMIT, "private": False, "siblings": siblings}
            handler.reply(json.dumps(about).encode(), Content_Type="application/json")
        elif name == self.broken:
            handler.status(500)
        elif name in self.files:
            handler.reply(self.files[name], ETag=f'"{sha256(self.files[name])}"', X_Repo_Commit=COMMIT)
        else:
            handler.status(404, X_Error_Code="EntryNotFound")
        return True


@pytest.fixture
def hub(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[Hub]:
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hf-home"))
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    # Otherwise the client tries for half a minute.
    monkeypatch.setattr("time.sleep", lambda seconds: None)
    with serving(Hub(FILES)) as server:
        yield server


def names(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*")}


def test_a_model_is_fetched_without_code_and_pickles(hub: Hub, tmp_path: Path) -> None:
    out, licences = tmp_path / "models" / "tiny", []
    found = fetch_model(NAME, COMMIT, out, endpoint=hub.url, show_licence=licences.append)
    kept = {"config.json", "preprocessor_config.json", "model.safetensors", "README.md", "LICENSE"}
    assert names(out) == {*kept, PROVENANCE}
    assert all((out / name).read_bytes() == FILES[name] for name in kept)
    assert licences == [found.licence] == ["cc-by-nc-4.0"]
    # The licence comes before the weights.
    asked = [path.rpartition("/")[2] for path in hub.asked]
    assert asked.index("README.md") < asked.index("model.safetensors")
    assert set(found.left_out) == set(FILES) - kept
    assert json.loads((out / PROVENANCE).read_text()) == {"id": NAME, "revision": COMMIT, "licence": "cc-by-nc-4.0"}
    # No other file is left in the folder.
    assert names(tmp_path / "models") == {"tiny", *(f"tiny/{name}" for name in names(out))}
    made = open_model(str(out))
    assert (made.source, made.revision) == (NAME, COMMIT)


def test_pickles_are_fetched_if_nothing_else_exists(hub: Hub, tmp_path: Path) -> None:
    found = fetch_model(NAME, COMMIT, tmp_path / "one", endpoint=hub.url)
    assert "pytorch_model.bin" not in found.files
    del hub.announced["model.safetensors"]
    found = fetch_model(NAME, COMMIT, tmp_path / "two", endpoint=hub.url)
    assert "pytorch_model.bin" in found.files
    assert not {"training_args.bin", "modeling_tiny.py"} & set(found.files)


@pytest.mark.parametrize("revision", [None, "main", COMMIT[:12]])
def test_a_revision_is_a_commit(hub: Hub, tmp_path: Path, revision: str | None) -> None:
    with raises_message(UsageError, f"{NAME}@{COMMIT}", where="someone/tiny-model"):
        fetch_model(NAME, revision, tmp_path / "tiny", endpoint=hub.url)
    assert not (tmp_path / "tiny").exists()


@pytest.mark.parametrize("name", ["model", "../../model", "a/b/c", "-x/b", "a/b?c"])
def test_an_id_is_owner_and_name(name: str, tmp_path: Path) -> None:
    with raises_message(UsageError, "OWNER"):
        fetch_model(name, COMMIT, tmp_path / "tiny")


def test_an_existing_folder_is_left_alone(hub: Hub, tmp_path: Path) -> None:
    out = tmp_path / "tiny"
    out.mkdir()
    (out / "mine").write_text("mine")
    with raises_message(UsageError, "output", where="tiny"):
        fetch_model(NAME, COMMIT, out, endpoint=hub.url)
    assert names(out) == {"mine"}
    (out / "mine").unlink()
    fetch_model(NAME, COMMIT, out, endpoint=hub.url)
    with raises_message(UsageError, "output", where="tiny"):
        fetch_model(NAME, COMMIT, out, endpoint=hub.url)


def test_an_interrupted_download_is_resumed(hub: Hub, tmp_path: Path) -> None:
    hub.broken = "preprocessor_config.json"
    out = tmp_path / "tiny"
    with pytest.raises(SourceError, match="same command again"):
        fetch_model(NAME, COMMIT, out, endpoint=hub.url)
    assert not out.exists()
    hub.broken, before = None, len(hub.asked)
    fetch_model(NAME, COMMIT, out, endpoint=hub.url)
    assert not any(path.endswith("model.safetensors") for path in hub.asked[before:])
    assert (out / "model.safetensors").read_bytes() == FILES["model.safetensors"]


def test_other_files_in_the_unfinished_folder_do_not_become_the_model(hub: Hub, tmp_path: Path) -> None:
    part = tmp_path / f".dancedata-tiny-{COMMIT[:12]}"
    part.mkdir()
    (part / "modeling.py").write_text("raise SystemExit")
    with raises_message(UsageError, "unfinished", where=".dancedata-tiny-a1a1a1a1a1a1"):
        fetch_model(NAME, COMMIT, tmp_path / "tiny", endpoint=hub.url)
    assert (part / "modeling.py").exists()


@pytest.mark.parametrize("name", ["model.safetensors", "config.json"])
def test_a_file_that_differs_from_its_announced_hash_is_removed(hub: Hub, tmp_path: Path, name: str) -> None:
    hub.announced[name] = hub.announced[name][::-1]
    with raises_message(SourceError, "announced"):
        fetch_model(NAME, COMMIT, tmp_path / "tiny", endpoint=hub.url)
    assert not (tmp_path / "tiny").exists()
    assert not list(tmp_path.rglob(name))


def test_a_repository_without_a_model_or_of_another_commit(hub, tmp_path):
    with raises_message(UsageError, COMMIT, where="someone/tiny-model"):
        fetch_model(NAME, "b" * 40, tmp_path / "tiny", endpoint=hub.url)
    del hub.announced["config.json"]
    with raises_message(UsageError, "pytorch_model", where="someone/tiny-model"):
        fetch_model(NAME, COMMIT, tmp_path / "tiny", endpoint=hub.url)


@pytest.mark.parametrize(
    ("status", "code", "error", "text"),
    [
        (401, "RepoNotFound", UsageError, "RepositoryNotFound.*hf auth login"),
        (404, "RepoNotFound", UsageError, "RepositoryNotFound.*Check id"),
        (404, "RevisionNotFound", UsageError, "RevisionNotFound.*Check id and commit"),
        (403, "GatedRepo", UsageError, "GatedRepo.*accept its terms"),
        (500, "", SourceError, "cannot be fetched"),
    ],
)
def test_refusals_of_the_hub(hub: Hub, tmp_path: Path, status: int, code: str, error: type, text: str) -> None:
    hub.error = status, code
    with pytest.raises(error, match=text):
        fetch_model(NAME, COMMIT, tmp_path / "tiny", endpoint=hub.url)
    assert not list(tmp_path.glob("*tiny*"))


def test_without_a_network(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    monkeypatch.setattr("time.sleep", lambda seconds: None)
    with pytest.raises(SourceError, match=r"cannot be fetched.*fetch elsewhere and copy"):
        fetch_model(NAME, COMMIT, tmp_path / "tiny", endpoint="http://127.0.0.1:1")
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    with pytest.raises(UsageError, match="HF_HUB_OFFLINE"):
        fetch_model(NAME, COMMIT, tmp_path / "tiny", endpoint="http://127.0.0.1:1")


def test_the_command(hub: Hub, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Set from $HF_ENDPOINT when the client is imported.
    monkeypatch.setattr(constants, "ENDPOINT", hub.url)
    address = hub.url + "/{repo_id}/resolve/{revision}/{filename}"
    monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", address)
    out = tmp_path / "tiny"
    result = CliRunner().invoke(app, ["pull", f"hf://{NAME}", "--out", str(out)])
    assert result.exit_code == 2
    assert f"{NAME}@{COMMIT}" in result.output
    result = CliRunner().invoke(app, ["pull", f"hf://{NAME}@{COMMIT}", "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "licence of the weights: cc-by-nc-4.0" in result.output
    assert "modeling_tiny.py, pytorch_model.bin" in result.output
    assert r"a\x1b[2Jb\ud800" in result.output
    assert f"revision: {COMMIT}" in CliRunner().invoke(app, ["info", str(out)]).output
    other = tmp_path / "other"
    result = CliRunner().invoke(app, ["pull", f"hf://{NAME}@{COMMIT}", "--out", str(other), "--json"])
    assert json.loads(result.stdout)["result"]["path"] == str(other)
