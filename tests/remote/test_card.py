"""The card of a dataset, and commands on addresses of a hub, a bucket and an https server."""

import json
import re
import ssl
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import dancedata
from dancedata.core.errors import StoreError, UsageError
from dancedata.core.hashing import recipe_hash
from dancedata.core.licence import Licence
from dancedata.formats.hub_head import hub_licence, size_category, strictest
from dancedata.plot import card_pictures
from dancedata.recipes.parse import parse_recipe
from dancedata.remote.card import write_card
from dancedata.remote.card_text import without_paths
from dancedata.store import open_store
from tests.commands import as_json, run
from tests.messages import raises_message
from tests.remote.servers import Hub, Server, moto_bucket, serving, status
from tests.report.conftest import HOSTILE, demo, hostile, relabelled  # noqa: F401 (the datasets of reports)

pytest.importorskip("matplotlib")


def head_of(text: str) -> dict[str, Any]:
    assert text.startswith("---\n")
    found = yaml.safe_load(text.split("---\n")[1])
    assert isinstance(found, dict)
    return found


@pytest.fixture(scope="module")
def card(demo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:  # noqa: F811
    return write_card(demo, tmp_path_factory.mktemp("card") / "README.md", pictures=card_pictures)


def test_the_head_is_what_hubs_read(card: Path) -> None:
    head = head_of(card.read_text())
    assert head["license"] == "cc0-1.0"
    assert head["pretty_name"] == "demo"
    assert head["size_categories"] == ["n<1K"]
    assert head["task_categories"] == ["other"]
    assert {"dance", "music-to-dance"} <= set(head["tags"])
    assert "language" not in head
    files = head["configs"][0]["data_files"]
    assert [(entry["split"], entry["path"]) for entry in files] == [
        (split, f"{split}-*.h5") for split in ("train", "val", "test")
    ]


def test_the_text_has_the_numbers_of_the_dataset_and_no_paths(card: Path, demo: Path) -> None:  # noqa: F811
    text = card.read_text()
    with open_store(demo) as store:
        for split, counts in store.info["splits"].items():
            row = f"| {split} | {counts['clips']} | 0 | {counts['windows']} | {counts['songs']} |"
            assert row in text
        assert all(shard["sha256"] in text for shard in store.info["shards"])
        assert store.info["citation"].split(";")[0] in text
    assert str(Path.home()) not in text
    assert str(demo.parent) not in text
    pictures = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", text)
    assert len(pictures) == 3
    for name in pictures:
        assert (card.parent / name).read_bytes().startswith(b"\x89PNG")


def test_the_recipe_is_that_of_the_dataset(card: Path, demo: Path) -> None:  # noqa: F811
    text = re.findall(r"```yaml\n(.*?)```", card.read_text(), re.DOTALL)[0]
    with open_store(demo) as store:
        assert yaml.safe_load(text) == store.info["recipe"]
        assert parse_recipe(yaml.safe_load(text)).sha256 == recipe_hash(store.info["recipe"])


def test_two_runs_are_equal_and_other_files_are_kept(card: Path, demo: Path, tmp_path: Path) -> None:  # noqa: F811
    path = tmp_path / "README.md"
    assert "README_files" in run("export", demo, "--to", "card", "--out", path).stdout
    assert path.read_bytes() == card.read_bytes()
    for name in ("poses.png", "map.png", "beats.png"):
        assert (tmp_path / "README_files" / name).read_bytes() == (card.parent / "README_files" / name).read_bytes()
    with raises_message(UsageError, "already", where="README.md"):
        write_card(demo, path)
    write_card(demo, path, overwrite=True)
    path.write_text("# mine\n")
    with raises_message(UsageError, "refusing", where="README.md"):
        write_card(demo, path, overwrite=True)
    assert path.read_text() == "# mine\n"
    with raises_message(UsageError, "listed", where="demo/README.md"):
        write_card(demo, demo / "README.md", overwrite=True)


def test_names_of_others_stay_text(hostile: Path, tmp_path: Path) -> None:  # noqa: F811
    text = write_card(hostile, tmp_path / "README.md").read_text()
    head = head_of(text)
    assert head["pretty_name"] == HOSTILE[0]
    assert head["license"] == "other"
    body = text.split("---\n", 2)[2]
    assert not re.search(r"(?<!\\)<(?:script|img|/template)", body)
    assert "\u202e" not in text


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("CC0-1.0: generated", "cc0-1.0"), ("CC BY 4.0", "cc-by-4.0"), ("CC-BY-NC 4.0", "cc-by-nc-4.0"),
        ("CC BY-NC-SA 4.0", "cc-by-nc-sa-4.0"), ("CC BY 3.0", "other"), ("MIT", "mit"), ("unknown", "other"),
        ("CC BY 4.0; music: may not be passed on, CC BY-NC 4.0", "other"), ("for research only", "other"),
    ],
)  # fmt: skip
def test_licences_have_the_names_of_hubs(text: str, name: str) -> None:
    assert hub_licence(text) == name


def test_the_strictest_licence_of_the_clips_counts(relabelled: Any) -> None:  # noqa: F811
    terms = [Licence("CC BY 4.0", "A"), Licence("CC BY-NC-SA 4.0", "B"), Licence("CC0 1.0", "C")]
    with open_store(relabelled(lambda k: {"terms": terms[k % 3]})) as store:
        assert strictest(store) == ("cc-by-nc-sa-4.0", terms[1])
    numbers = np.array([999, 1000, 9999, 10_000])
    assert [size_category(int(n)) for n in numbers] == ["n<1K", "1K<n<10K", "1K<n<10K", "10K<n<100K"]


def test_paths_of_a_machine_are_left_out() -> None:
    text = r"read /data/u/x.npy, C:\Users\ann\a.pkl and ~/songs/a.wav; motions/*.pkl, https://a.org/b/c, 30 m/s"
    assert without_paths(text) == "read PATH, PATH and PATH; motions/*.pkl, https://a.org/b/c, 30 m/s"


cryptography = pytest.importorskip("cryptography")
pytest.importorskip("moto.server")
pytest.importorskip("obstore")
pytest.importorskip("huggingface_hub")


def _certificate(folder: Path) -> Path:
    """Write a key and a certificate of 127.0.0.1, signed by itself."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "localhost")])
    now = datetime.now(UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(now - timedelta(days=1))
        .not_valid_after(now + timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.IPAddress(ip_address("127.0.0.1"))]), critical=False)
        .sign(key, hashes.SHA256())
    )
    plain = serialization.NoEncryption()
    path = folder / "server.pem"
    path.write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, plain)
        + certificate.public_bytes(serialization.Encoding.PEM)
    )
    return path


@pytest.fixture(scope="module")
def secure(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """Return an https server of the built dataset; SSL_CERT_FILE names its certificate."""
    server, context = Server(built.parent), ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    pem = _certificate(tmp_path_factory.mktemp("tls"))
    context.load_cert_chain(pem)
    server.socket = context.wrap_socket(server.socket, server_side=True)
    with pytest.MonkeyPatch.context() as patch, serving(server):
        patch.setenv("SSL_CERT_FILE", str(pem))
        yield server


@pytest.fixture(scope="module")
def addresses(built: Path, secure: Server) -> Iterator[dict[str, str]]:
    """Return the built dataset's address on a hub, in a bucket of moto, and on an https server."""
    with moto_bucket(built, "set") as environment, pytest.MonkeyPatch.context() as patch, serving(Hub(built)) as hub:
        patch.delenv("HF_TOKEN", raising=False)
        for name, value in {**environment, "HF_ENDPOINT": hub.url}.items():
            patch.setenv(name, value)
        yield {
            "hf": "hf://datasets/org/name",
            "s3": "s3://dances/set",
            "https": f"https://127.0.0.1:{secure.server_address[1]}/{built.name}",
        }


@pytest.mark.parametrize("scheme", ["hf", "s3", "https"])
def test_commands(addresses: dict[str, str], built: Path, tmp_path: Path, scheme: str) -> None:
    address = addresses[scheme]
    assert as_json("pull", address, "--quiet")["address"].startswith(address)
    for folder, where in (("remote", address), ("local", built)):
        (tmp_path / folder).mkdir()
        dancedata.export(where, "npz", tmp_path / folder / "npz", progress=False)
        run("view", where, "--out", tmp_path / folder / "page.html", "--quiet")
        report = as_json("report", where, "--clips", "none", "--quiet")
        found = as_json("check", where, "--quiet")
        about = as_json("info", where)
        assert found["paths"] == [about.pop("path")] == [str(where)]
        assert f": {where} (" in run("info", where).output
        checked = [p for p in found["problems"] if p["severity"] == "error"]
        values = dancedata.evaluate(where, metrics=("pfc",), intervals=False, jobs=1, progress=False).to_json()
        (tmp_path / folder / "numbers.json").write_text(json.dumps([about, report, checked, values["scores"]]))
    for path in sorted((tmp_path / "local").rglob("*")):
        if path.is_file() and path.name != "export.json":
            other = tmp_path / "remote" / path.relative_to(tmp_path / "local")
            assert other.read_bytes() == path.read_bytes(), path.name
    about = json.loads((tmp_path / "remote" / "npz" / "export.json").read_text())
    assert about["address"].startswith(address)


def test_a_certificate_that_nobody_signed(addresses: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SSL_CERT_FILE")
    with pytest.raises(StoreError, match="the server's certificate is not valid; found UnknownIssuer"):
        dancedata.open(addresses["https"])


def test_https_is_not_left(addresses: dict[str, str], secure: Server, built: Path) -> None:
    with serving(Server(built.parent)) as plain:
        place = f"{plain.url}/{built.name}/dataset.json"
        secure.fault("dataset.json", status(302, Location=place))
        with pytest.raises(StoreError, match="the server redirects to an address that is not https"):
            dancedata.open(addresses["https"])
        assert not plain.requests
