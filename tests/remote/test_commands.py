"""Commands on addresses of a hub, a bucket and an https server give what they give for the folder."""

import json
import ssl
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path

import pytest

import dancedata
from dancedata.core.errors import StoreError
from tests.commands import as_json, run
from tests.remote.servers import Hub, Server, moto_bucket, serving, status

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


def outputs(where: Path | str, folder: Path) -> Path:
    """Write into a folder what commands give for a dataset."""
    folder.mkdir()
    dancedata.export(where, "npz", folder / "npz", progress=False)
    run("view", where, "--out", folder / "page.html", "--quiet")
    report = as_json("report", where, "--clips", "none", "--quiet")
    found = as_json("check", where, "--quiet")
    about = as_json("info", where)
    assert found["paths"] == [about.pop("path")] == [str(where)]
    assert f": {where} (" in run("info", where).output
    checked = [p for p in found["problems"] if p["severity"] == "error"]
    values = dancedata.evaluate(where, metrics=("pfc",), intervals=False, jobs=1, progress=False).to_json()
    assert not isinstance(where, str) or where in str(values)
    (folder / "numbers.json").write_text(json.dumps([about, report, checked, values["scores"]]))
    return folder


@pytest.fixture(scope="module")
def local(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return outputs(built, tmp_path_factory.mktemp("outputs") / "local")


@pytest.mark.parametrize("scheme", ["hf", "s3", "https"])
def test_commands(addresses: dict[str, str], local: Path, tmp_path: Path, scheme: str) -> None:
    address, commit = addresses[scheme], f"@{'a' * 40}" if scheme == "hf" else ""
    assert as_json("pull", address, "--quiet")["address"] == f"{address}{commit}"
    remote = outputs(address, tmp_path / "remote")
    for path in sorted(local.rglob("*")):
        if path.is_file() and path.name != "export.json":
            assert (remote / path.relative_to(local)).read_bytes() == path.read_bytes(), path.name
    assert json.loads((remote / "npz" / "export.json").read_text())["address"] == f"{address}{commit}"


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
