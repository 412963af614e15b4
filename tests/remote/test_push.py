"""dancedata push to the fake hub, by the client of huggingface_hub."""

import json
import logging
import shutil
from collections.abc import Callable
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
import yaml

import dancedata
from dancedata.core.errors import DanceDataError, StoreError, UsageError
from dancedata.core.hashing import json_sha256, sha256_bytes
from dancedata.core.licence import Licence
from dancedata.core.packages import MissingPackageError
from dancedata.core.registry import DATASETS
from dancedata.remote import contents
from dancedata.remote import push as run
from dancedata.remote import upload as hub
from dancedata.remote.pull import pull
from dancedata.remote.terms import restrictions
from dancedata.store import open_store
from dancedata.store.schema import Field
from dancedata.testing.stores import random_columns
from tests.commands import run as command
from tests.messages import raises_message
from tests.remote.servers import Server, serving, status
from tests.remote.upload_hub import TOKEN, UploadHub

pytest.importorskip("huggingface_hub")
WHERE = "hf://datasets/org/name"
RIGHTS = "they are random numbers"


def push(store: Path, **options: Any) -> run.Pushed:
    options = {"rights": RIGHTS, "progress": False} | options
    return run.push(store, WHERE, **options)


def card_of(files: dict[str, bytes]) -> dict[str, Any]:
    head = yaml.safe_load(files["README.md"].decode().split("---\n")[1])
    assert isinstance(head, dict)
    return head


def test_one_commit_has_all_files_and_reads_as_the_local_dataset(uploads: UploadHub, published: Path) -> None:
    pushed = push(published)
    assert uploads.tags == {pushed.address.rpartition("@")[2]: pushed.commit}
    assert len([line for line in uploads.log if "/commit/" in line]) == 1
    files = uploads.files()
    local = {p.name: p.read_bytes() for p in published.iterdir() if p.name != "README.md"}
    assert {name: data for name, data in files.items() if name in local} == local
    assert set(files) - set(local) == {"README.md", "publication.json"}
    assert pushed.files == len(files)
    folder = pull(pushed.address, progress=False).path
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == local
    assert not [p for p in dancedata.check(pushed.address) if "README" in p.message]


def test_push_without_its_packages_is_an_error_before_anything_is_read(published, monkeypatch):
    monkeypatch.setattr("dancedata.core.packages._is_installed", lambda module: module != "huggingface_hub")
    with pytest.raises(MissingPackageError, match="push needs huggingface_hub"):
        push(published)


def test_the_card_states_terms_sizes_columns_and_hashes(uploads: UploadHub, published: Path) -> None:
    pushed = push(published, gated=True)
    head = card_of(uploads.files())
    with open_store(published) as store:
        about = head["dancedata"]
        assert about["columns"] == {name: store.field(name).columns.width for name in store.fields}
        assert about["self_sha256"] == store.info["self_sha256"]
        assert about["bytes"] == sum(p.stat().st_size for p in published.glob("*-of-*.h5"))
    assert (about["address"], about["rights"], head["license"]) == (pushed.address, RIGHTS, "cc0-1.0")
    assert "accept the terms" in head["extra_gated_prompt"]
    text = uploads.files()["README.md"].decode()
    assert f"ds = dancedata.open('{pushed.address}')" in text
    assert f"The publisher states the right to do so: {RIGHTS}" in text
    assert json.loads(uploads.files()["publication.json"])["rights"] == RIGHTS


def test_pictures(uploads: UploadHub, built: Path) -> None:
    pytest.importorskip("matplotlib")
    push(built, rights="they are of a program", pictures=dancedata.plot.card_pictures)
    files = uploads.files()
    pictures = {name for name in files if name.startswith("README_files/")}
    assert len(pictures) == 3
    assert all(f"]({name})" in files["README.md"].decode() for name in pictures)
    assert push(built, recipe_only=True, rights=None).files == len(uploads.files())
    assert not pictures & uploads.files().keys()
    assert not [name for name in uploads.files() if name.endswith((".h5", ".bin", ".png"))]


def test_settings_come_before_the_files(uploads: UploadHub, published: Path) -> None:
    push(published, private=True, gated=True)
    assert uploads.settings == {"private": True, "gated": "auto"}
    log = uploads.log
    assert log.index("PUT /api/datasets/org/name/settings") < min(
        k for k, line in enumerate(log) if "/storage/" in line or "/commit/" in line or "/preupload/" in line
    )


def test_a_hub_that_does_not_make_it_private_gets_nothing(uploads: UploadHub, published: Path) -> None:
    uploads.lies = lambda method, path, answer: {**answer, "private": False} if "sha" in answer else answer
    with raises_message(StoreError, "private", where="hf://datasets/org/name@main"):
        push(published, private=True)
    assert not uploads.storage
    assert not uploads.files()


def test_the_same_again_uploads_nothing(uploads: UploadHub, published: Path) -> None:
    first = push(published)
    again = push(published)
    assert (again.commit, again.uploaded_bytes) == (first.commit, 0)
    uploads.tags.clear()  # as if it had been killed before the tag
    assert push(published).commit == first.commit
    assert list(uploads.tags.values()) == [first.commit]


def test_another_dataset_replaces_what_was_published_and_keeps_files_of_others(
    uploads: UploadHub, published: Path, random_store: Callable[..., Any], tmp_path: Path
) -> None:
    push(published)
    (uploads.commits[uploads.branches["main"]] / "LICENSE").write_text("theirs")
    other = random_store(tmp_path / "other", seed=3).path
    second = push(other)
    assert {p.name for p in other.iterdir()} | {"publication.json", "LICENSE"} == uploads.files().keys()
    assert {tag.partition("-")[0] for tag in uploads.tags} == {"dataset"}
    assert len(uploads.tags) == 2
    with open_store(other) as store:
        assert dancedata.open(second.address).info["self_sha256"] == store.info["self_sha256"]


def test_files_of_others_are_not_replaced(uploads: UploadHub, published: Path) -> None:
    uploads.branches["main"] = uploads.new_commit()
    readme = uploads.commits[uploads.branches["main"]] / "README.md"
    readme.write_text("# mine\n")
    with raises_message(UsageError, "publish", where="hf://datasets/org/name@main"):
        push(published)
    assert uploads.files() == {"README.md": b"# mine\n"}
    push(published, overwrite=True)
    assert "dataset.json" in uploads.files()


def test_a_tag_of_another_upload(uploads: UploadHub, published: Path) -> None:
    uploads.branches["main"] = uploads.new_commit()
    with open_store(published) as store:
        uploads.tags[f"dataset-{store.info['self_sha256'][:12]}"] = "f" * 40
    with raises_message(UsageError, "upload", where="hf://datasets/org/name@main"):
        push(published)
    assert not uploads.storage


def test_branches_and_folders(uploads: UploadHub, published: Path) -> None:
    run.push(published, f"{WHERE}@next/a/b", rights=RIGHTS, progress=False)
    assert not uploads.files("main")
    assert all(name.startswith("a/b/") for name in uploads.files("next"))
    tag = next(iter(uploads.tags))
    with dancedata.open(f"{WHERE}@{tag}/a/b") as remote, open_store(published) as local:
        assert remote.info["self_sha256"] == local.info["self_sha256"]


def of_dataset(random_store: Callable[..., Any], out: Path, name: str, *, music: bool = True, **writer: Any) -> Path:
    pose = Field("pose", "motion", random_columns(7), Fraction(30))
    sound = Field("music", "audio", random_columns(5, mirror=False), Fraction(30))
    reader = DATASETS.get(name)
    meta = {"source": {"reader": name}, "licence": reader.licence, "citation": reader.citation}
    random_store(out, fields=(pose, sound) if music else (pose,), meta=meta, **writer)
    return out


@pytest.mark.parametrize("name", ["aist++", "folder"])
def test_sources_that_forbid_it(name, random_store, tmp_path, uploads):
    store = of_dataset(random_store, tmp_path / "store", name)
    with raises_message(UsageError, "terms", where="store") as caught:
        run.push(store, WHERE, progress=False)
    assert DATASETS.get(name).licence in str(caught.value)
    assert ("the manifest's column licence" in str(caught.value)) == (name == "folder")
    assert not uploads.log
    pushed = run.push(store, WHERE, recipe_only=True, progress=False)
    assert pushed.recipe_only
    assert not [file for file in uploads.files() if file.endswith(".h5")]


@pytest.mark.parametrize("name", [name for name in DATASETS.names() if name != "synthetic"])
def test_every_dataset_forbids_it(name: str, random_store: Callable[..., Any], tmp_path: Path) -> None:
    with open_store(of_dataset(random_store, tmp_path / "store", name)) as store:
        assert restrictions(store)


def test_sources_that_allow_it(random_store: Callable[..., Any], tmp_path: Path, uploads: UploadHub) -> None:
    """The demo, and the motion of AIST++ without its music."""
    for name, music in (("synthetic", True), ("aist++", False)):
        with open_store(of_dataset(random_store, tmp_path / name, name, music=music)) as store:
            assert restrictions(store) == []
    assert not run.push(tmp_path / "aist++", WHERE, progress=False).recipe_only


@pytest.mark.parametrize(
    ("terms", "what"),
    [
        ([Licence("CC BY 4.0"), Licence("CC BY-NC 4.0")], []),
        ([Licence("CC BY 4.0"), Licence("research only")], ["5 clips: research only"]),
        ([Licence("CC BY-ND 4.0"), Licence("CC0")], ["5 clips: CC BY-ND 4.0"]),
        ([Licence("", "Ann 2025"), Licence("CC0")], ["motion and features of music (librosa35): {}"]),
    ],
)  # fmt: skip
def test_terms_of_clips(relabelled_random, terms, what):
    with open_store(relabelled_random(terms)) as store:
        expected = [text.format(DATASETS.get("folder").licence) for text in what]
        assert list(map(str, restrictions(store))) == expected


def test_no_token_and_no_signature_anywhere(uploads, published, caplog, tmp_path, own_cache):
    caplog.set_level(logging.DEBUG)
    seen = [command("push", published, WHERE, "--rights", RIGHTS).output]
    echo = f"your token {TOKEN} may not; see http://h/x?X-Amz-Signature=s1gn4tur3"
    for path, answers in (
        ("POST /api/datasets/org/name/preupload/main", [status(401, X_Error_Message=echo)]),
        ("POST /api/datasets/org/name/commit/main", [status(403, X_Error_Message=echo)]),
        ("GET /api/datasets/org/name/refs", [status(500, X_Error_Message=echo)]),
    ):
        for there in (uploads.storage, uploads.branches, uploads.tags):
            there.clear()
        uploads.faults[path] = answers
        with pytest.raises(StoreError) as caught:
            push(published)
        error: BaseException | None = caught.value
        assert error is not None
        assert error.__cause__ is None
        assert error.__suppress_context__
        seen.append(str(error))
        seen.append(command("push", published, WHERE, "--rights", RIGHTS, "--json").output)
    seen += [record.getMessage() for record in caplog.records]
    seen += [data.decode("latin-1") for data in (*uploads.files().values(), *uploads.storage.values())]
    seen += [p.read_text("latin-1") for p in own_cache.rglob("*") if p.is_file()]
    for text in seen:
        assert TOKEN not in text
        assert "s1gn4tur3" not in text


def test_without_a_token(uploads, published, monkeypatch, tmp_path):
    monkeypatch.delenv("HF_TOKEN")
    monkeypatch.setattr("huggingface_hub.constants.HF_TOKEN_PATH", str(tmp_path / "none"))
    with raises_message(UsageError, "HF_TOKEN", where="hf://datasets/org/name@main"):
        push(published)
    assert not uploads.log


@pytest.mark.parametrize(
    ("path", "code"),
    [("/preupload/main", 401), ("/commit/main", 412), ("/commit/main", 500), ("/refs", 404)],
)
def test_statuses(uploads: UploadHub, published: Path, path: str, code: int) -> None:
    method = "GET" if path == "/refs" else "POST"
    uploads.faults[f"{method} /api/datasets/org/name{path}"] = [status(code)]
    with raises_message(StoreError, "HF_TOKEN|uploaded", where="hf://datasets/org/name@main"):
        push(published)
    assert "dataset.json" not in uploads.files()
    push(published)
    assert "dataset.json" in uploads.files()


def test_a_token_that_expires_in_the_middle(uploads: UploadHub, published: Path) -> None:
    batch = "POST /datasets/org/name.git/info/lfs/objects/batch"
    uploads.faults[batch] = [lambda handler, data: False, status(401)]  # the second batch
    with raises_message(StoreError, "HF_TOKEN", where="hf://datasets/org/name@main"):
        push(published)
    kept = set(uploads.storage)
    assert kept
    del uploads.log[:]
    push(published)
    sent = {line.rpartition("/")[2] for line in uploads.log if line.startswith("PUT /storage/")}
    assert sent
    assert not sent & kept
    assert "dataset.json" in uploads.files()


@pytest.mark.parametrize("part", ["refs", "preupload", "batch", "commit", "paths-info", "tag"])
def test_malformed_answers(uploads: UploadHub, published: Path, part: str) -> None:
    for answer in ({"files": [], "objects": None, "commitOid": "../../x", "commitUrl": 3}, 7):
        uploads.lies = lambda method, path, true, answer=answer: answer if f"/{part}" in path else true
        with suppress(DanceDataError):  # nothing else is raised
            push(published)
    uploads.lies = None
    uploads.tags.clear()
    push(published)
    assert "dataset.json" in uploads.files()


def test_a_hub_that_says_it_has_files_that_it_does_not_have(uploads: UploadHub, published: Path) -> None:
    """It calls large files present, and commits a branch without them."""

    def lie(method: str, path: str, true: Any) -> Any:
        if path.endswith("/objects/batch"):
            return {"objects": [{key: o[key] for key in ("oid", "size")} for o in true["objects"]]}
        return true

    uploads.lies = lie
    with pytest.raises(StoreError, match="the hub failed; no part of the upload is visible there"):
        push(published)
    assert "dataset.json" not in uploads.files()


def test_a_hub_that_has_other_bytes(uploads: UploadHub, published: Path) -> None:
    def lie(method: str, path: str, true: Any) -> Any:
        return [{**e, "size": e["size"] + 1} for e in true] if "/paths-info/" in path else true

    uploads.lies = lie
    with raises_message(StoreError, "gitignore"):
        push(published)
    assert not uploads.tags


def test_a_redirection_takes_no_token_along(uploads: UploadHub, published: Path, tmp_path: Path) -> None:
    with serving(Server(tmp_path)) as other:
        moved = [status(307, Location=f"{other.url}/x")]
        uploads.faults["GET /api/datasets/org/name/refs"] = moved
        with pytest.raises(StoreError):
            push(published)
        assert other.headers
        assert not any(TOKEN in str(headers) for _, headers in other.headers)


def test_a_hub_that_does_not_answer(uploads: UploadHub, published: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import threading

    monkeypatch.setattr(hub, "TIMEOUT_S", 0.2)
    gone = threading.Event()
    silent = [lambda handler, data: (gone.wait(5), False)[1]] * 9
    uploads.faults["POST /api/datasets/org/name/commit/main"] = list(silent)
    with pytest.raises(StoreError, match="Timeout"):
        push(published)
    gone.set()


@pytest.mark.parametrize(
    ("to", "options"),
    [
        ("https://h/x", {}), ("data/out", {}), ("s3://bucket/x", {}),
        (f"{WHERE}@{'a' * 40}", {}), (WHERE, {"rights": " "}),
        (WHERE, {"beside": ["manifest.csv"]}),
    ],
)  # fmt: skip
def test_arguments(published: Path, to: str, options: dict[str, Any]) -> None:
    with raises_message(UsageError, "branch|published|rights|settings|valid"):
        run.push(published, to, progress=False, **options)


def test_offline(published: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    with raises_message(UsageError, "HF_HUB_OFFLINE", where="hf://datasets/org/name@main"):
        push(published)


def test_a_damaged_dataset_is_not_published(uploads, random_store, tmp_path):
    out = random_store(tmp_path / "store").path
    shard = next(out.glob("train-0*.h5"))
    data = bytearray(shard.read_bytes())
    data[-1] ^= 1
    shard.write_bytes(data)
    with pytest.raises(StoreError, match=shard.name):
        push(out)
    assert not uploads.log


def test_names_that_lead_out_of_the_folder(uploads, random_store, tmp_path):
    """dataset.json of others that names a file of this machine: it is not uploaded."""
    secret = tmp_path / "id_rsa"
    secret.write_text("private key")
    out = random_store(tmp_path / "store").path
    document = json.loads((out / "dataset.json").read_text())
    document["files"]["../id_rsa"] = {"size": 11, "sha256": sha256_bytes(b"private key")}
    document["self_sha256"] = json_sha256({k: v for k, v in document.items() if k != "self_sha256"})
    (out / "dataset.json").write_text(json.dumps(document))
    with pytest.raises(StoreError, match="a file is listed that no dataset has"):
        push(out)
    assert not uploads.storage


def test_a_dataset_that_is_replaced_during_the_upload(uploads, published, tmp_path, monkeypatch):
    store = tmp_path / "store"
    shutil.copytree(published, store)
    real = hub.HubUpload._commit

    def commit(self: hub.HubUpload, *arguments: Any) -> str:
        for path in store.glob("train-*.h5"):
            path.write_bytes(path.read_bytes()[::-1])
        return real(self, *arguments)

    with monkeypatch.context() as patched:
        patched.setattr(hub.HubUpload, "_commit", commit)
        with pytest.raises(StoreError, match="the dataset was changed while it was published"):
            push(store)
    assert "dataset.json" not in uploads.files()


def test_a_dataset_that_is_replaced_before_the_upload(uploads, published, random_store, tmp_path, monkeypatch):
    other, store = random_store(tmp_path / "other", seed=3).path, tmp_path / "store"
    shutil.copytree(published, store)
    real = contents._card

    def card(*arguments: Any) -> Any:
        files = real(*arguments)
        store.rename(tmp_path / "before")
        other.rename(store)
        return files

    monkeypatch.setattr(contents, "_card", card)
    with pytest.raises(StoreError, match=r"dataset\.json: the dataset was changed while it was published"):
        push(store)
    assert not [line for line in uploads.log if "/commit/" in line]
