"""The server answers only the page that it made."""

import http.client
import json
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import DanceDataError, DataError, UsageError
from dancedata.viewer.server import Site, ViewServer
from dancedata.viewer.view import ViewRequest, export_page
from tests.messages import raises_message
from tests.scene.helpers import serving


class Client:
    """Raw requests to one address."""

    def __init__(self, address: str) -> None:
        url = urlsplit(address)
        self.port, self.token = int(url.port or 0), url.query.partition("=")[2]
        self.cookie = f"dancedata{self.port}={self.token}"

    def get(
        self, path: str, *, cookie: str | None = None, host: str | None = None, method: str = "GET"
    ) -> tuple[int, dict[str, str], bytes]:
        """Return status, headers and body."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30)
        connection.putrequest(method, path, skip_host=True)
        connection.putheader("Host", f"127.0.0.1:{self.port}" if host is None else host)
        connection.putheader("Cookie", self.cookie if cookie is None else cookie)
        connection.endheaders()
        reply = connection.getresponse()
        answer = reply.status, {k.lower(): v for k, v in reply.getheaders()}, reply.read()
        connection.close()
        return answer


@pytest.fixture(scope="module")
def client(served: str) -> Iterator[Client]:
    return Client(served)


def test_the_secret_becomes_a_cookie(client: Client) -> None:
    status, headers, _ = client.get(f"/?token={client.token}", cookie="")
    assert (status, headers["location"]) == (303, "/")
    assert headers["set-cookie"].startswith(client.cookie)
    assert "HttpOnly; SameSite=Strict" in headers["set-cookie"]


@pytest.mark.parametrize("cookie", ["", "dancedata=x", "dancedata1=\xe9", "a=b; c"])
@pytest.mark.parametrize("path", ["/", "/clip/0", "/?token=wrong", "/?token=%C3%A9%00", "/sliding", "/model"])
def test_without_the_secret_nothing_is_answered(client: Client, path: str, cookie: str) -> None:
    status, headers, body = client.get(path, cookie=cookie)
    assert (status, body) == (403, b"open the address that dancedata view printed")
    assert "set-cookie" not in headers


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example:1", "", "10.0.0.1:1"])
def test_other_hosts_are_refused(client: Client, host: str) -> None:
    assert client.get("/", host="localhost:9999")[0] == 200  # a forwarded port is this machine
    assert client.get("/", host=host)[0] == 403
    assert client.get(f"/?token={client.token}", host=host)[0] == 403


@pytest.mark.parametrize(
    "path",
    ["/../../etc/passwd", "/etc/passwd", "/clip/../../../etc/passwd", "/clip/-1", "/clip/99999", "/clip/0/x",
     "/clip/1e3", "/clip/%30", "/clip/%D9%A3", "/clip/0/with/0/1", "/clip/0/with/7", "/clip/0/",
     "/static/viewer.css"],
)  # fmt: skip
def test_nothing_but_numbers_of_clips_is_a_path(client: Client, path: str) -> None:
    status, _, body = client.get(path)
    assert (status, body) == (404, b"no such page")


def test_headers(client: Client) -> None:
    status, headers, body = client.get("/")
    policy = headers["content-security-policy"]
    assert status == 200
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy
    assert "connect-src 'self'" in policy
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "no-referrer"
    assert headers["cache-control"] == "no-store"
    assert "server" in headers
    assert "Python" not in headers["server"]
    assert b"http-equiv" not in body
    status, headers, body = client.get("/", method="HEAD")
    assert (status, body) == (200, b"")
    assert int(headers["content-length"]) > 10_000


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "<script>"])
def test_only_reading_is_answered(client: Client, method: str) -> None:
    status, headers, _ = client.get("/", method=method)
    assert status == 501
    assert headers["content-type"].startswith("text/plain")


def test_clips_and_music(client: Client, odd: Path) -> None:
    status, headers, body = client.get("/clip/0")
    clip = json.loads(body)
    assert status == 200
    assert headers["content-type"] == "application/json"
    assert clip["id"] == dancedata.open(odd).clips()[0].id
    assert client.get("/clip/0?field=nonsense")[0] == 400
    status, headers, body = client.get("/clip/0/music")
    assert status == 200
    assert headers["content-type"] == "audio/flac"
    assert body[:4] == b"fLaC"


def test_sliding_is_measured_on_request(client: Client, odd: Path) -> None:
    for _ in range(600):
        progress = json.loads(client.get("/sliding")[2])
        if progress["done"]:
            break
    assert progress["done"]
    scenes = ViewRequest(odd).scenes()
    figures = [[scenes.scene(dancer).figure for dancer in item.members or (item,)] for item in scenes.items]
    wanted = [max(round(figure.sliding, 4) for figure in dancers if figure is not None) for dancers in figures]
    assert progress["values"] == wanted
    assert len(wanted) == len(dancedata.open(odd).clips())


def test_it_binds_this_machine_only(odd: Path) -> None:
    request = ViewRequest(odd)
    with ViewServer(Site(request.scenes())) as server:
        assert server.socket.getsockname()[0] == "127.0.0.1"
        with pytest.raises(UsageError, match="the port cannot be used"):
            ViewServer(server.site, server.server_port)
        other = socket.socket()
        other.settimeout(1)
        with pytest.raises(OSError):  # noqa: PT011
            other.connect(("127.0.0.2", server.server_port))
        other.close()


def test_a_rebuilt_dataset_is_refused(odd: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(odd, copy)
    with serving(ViewRequest(copy)) as address:
        client = Client(address)
        assert client.get("/clip/0")[0] == 200
        os.utime(copy / "dataset.json")  # touched, not changed
        assert client.get("/clip/0")[0] == 200
        text = (copy / "dataset.json").read_text()
        (copy / "dataset.json").write_text(text.replace('"self_sha256"', '"self_sha257"'))
        assert client.get("/clip/0")[::2] == (409, b"the dataset was rebuilt")


@pytest.mark.parametrize(("request_", "error", "word"), [
    ({"clip": "wva"}, UsageError, "no clip named"), ({"clip": "wav@0+9999"}, UsageError, "window"),
    ({"field": "librosa35"}, UsageError, "drawn"), ({"normalized": True}, UsageError, "compare"),
    ({"compare": (Path("/nothing/here"),)}, DataError, "compare"),
], ids=str)  # fmt: skip
def test_wrong_requests(odd: Path, request_: dict, error: type[DanceDataError], word: str) -> None:
    with raises_message(error, word), serving(ViewRequest(odd, **request_)):
        pass


def test_answers_to_long_names_are_short(client: Client) -> None:
    status, _, body = client.get(f"/clip/0?field={'x' * 30_000}")
    assert status == 400
    assert len(body) < 1100


def test_ctrl_c_ends_it_with_0(odd: Path) -> None:
    command = [sys.executable, "-m", "dancedata", "view", str(odd), "--no-browser"]
    about = {**os.environ, "SSH_CONNECTION": "10.0.0.1 1 10.0.0.2 22"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=about) as process:
        lines = [process.stdout.readline() for _ in range(4)]
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    port = urlsplit(lines[0]).port
    assert (process.returncode, errors) == (0, "")
    assert lines[2].split()[:3] == ["ssh", "-N", "-L"]
    assert f"{port}:127.0.0.1:{port}" in lines[2]
    assert "Ctrl-C" in lines[3]  # and no line on music: it is that of the source, which the dataset remembers


def test_a_clip_as_a_page(odd: Path, source: Path, tmp_path: Path) -> None:
    page = export_page(ViewRequest(odd, "wav"), tmp_path / "wav.html")
    assert 10_000 < page.stat().st_size < 400_000
    with raises_message(UsageError, "already", where="wav.html"):
        export_page(ViewRequest(odd, "wav"), page)
    said: list[str] = []
    export_page(ViewRequest(odd, "wav", music=source), tmp_path / "b.html", say=said.append)
    assert "does not allow its music to be passed on; --rights TEXT" in said[0]
    assert "audio/ogg" not in (tmp_path / "b.html").read_text()
    export_page(ViewRequest(odd, "wav", music=source), page, rights="granted to the tests", overwrite=True)
    assert "that it may be shared: granted to the tests" in page.read_text()


def test_a_connection_that_is_reset_prints_nothing(odd: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with serving(ViewRequest(odd)) as address:
        port = urlsplit(address).port
        for _ in range(3):
            with socket.create_connection(("127.0.0.1", port)) as connection:
                # Closed with an answer that was not read, as a tab that is closed while it loads.
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                connection.sendall(b"GET / HTTP/1.1\r\nHost: localhost:1\r\n\r\n")
                connection.recv(10)
        time.sleep(0.2)
    assert capfd.readouterr().err == ""


def test_a_page_or_video_is_not_written_into_the_dataset(odd: Path, tmp_path: Path) -> None:
    before = sorted(odd.iterdir())
    link = tmp_path / "link"
    link.symlink_to(odd)
    for to in (odd / "clip.html", odd / "dataset.json", link / "clip.html"):
        with raises_message(UsageError, "listed"):
            export_page(ViewRequest(odd), to, overwrite=True)
    assert sorted(odd.iterdir()) == before


def test_a_comparison_of_any_numbers_is_answered(odd: Path, tmp_path: Path) -> None:
    scenes = ViewRequest(odd).scenes()
    for number, value in enumerate((1e308, -1e9, 1e6)):
        np.save(tmp_path / f"{scenes.items[number].clip.id}.npy", np.full((60, 24, 3), value))
    site = Site(scenes, None, ViewRequest(odd, compare=(tmp_path,)).comparisons(scenes, None))
    notes = [json.loads(site.answer(f"/clip/{n}/with/0", None).body).get("note", "drawn") for n in range(3)]
    assert ["too far away" in note for note in notes] == [True, True, False]


def test_two_files_of_one_clip_are_not_compared(odd: Path, tmp_path: Path) -> None:
    clip = dancedata.open(odd).clips()[0].id
    np.save(tmp_path / f"{clip}.npy", np.zeros((60, 24, 3)))
    np.savez(tmp_path / f"{clip}.npz", poses=np.zeros((60, 72)), trans=np.zeros((60, 3)))
    with raises_message(UsageError, "same name"):
        ViewRequest(odd, compare=(tmp_path,)).comparisons(dancedata.open(odd), None)
