"""The fake hub of `servers`, with what an upload asks for: repositories, storage of large files, commits, tags."""

import base64
import hashlib
import json
import os
import re
import shutil
import signal
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

from tests.remote.servers import Handler, Hub

TOKEN = "hf_AbCdEfGhIjKlMnOpQrStUvWxYz"
#: Regular files that are larger go to the storage of large files, as shards do by .gitattributes.
_LARGE = 10_000
_KIB = 1024


class UploadHub(Hub):
    """A hub without a repository at first; only `token` may read and write it.

    Attributes
    ----------
    storage
        Large files by hash, of which commits may or may not have some.
    kill
        Process and number of bytes of requests after which it is killed.
    lies
        Called with method, path and the answer before it is sent; returns another one.
    """

    def __init__(self, folder: Path, token: str = TOKEN) -> None:
        super().__init__(folder, token)
        self.RequestHandlerClass = UploadHandler
        self.commits, self.branches, self.tags = {}, {}, dict[str, str]()
        self.settings: dict[str, Any] = {"private": False, "gated": False}
        self.log: list[str] = []
        self.storage: dict[str, bytes] = {}
        self.received = 0
        self.kill: tuple[int, int] | None = None
        self.lies: Callable[[str, str, Any], Any] | None = None
        self._numbers = count(1)

    def commit_of(self, revision: str) -> str:
        return self.tags.get(revision, self.branches.get(revision, revision))

    def new_commit(self, parent: str | None = None) -> str:
        name = f"{next(self._numbers):040x}"
        folder = self.folder / name
        if parent is None:
            folder.mkdir(parents=True)
            (folder / ".gitattributes").write_text("*.h5 filter=lfs\n")
        else:
            shutil.copytree(self.commits[parent], folder, copy_function=os.link)
        self.commits[name] = folder
        return name

    def files(self, revision: str = "main") -> dict[str, bytes]:
        """Return the files of a revision, without .gitattributes."""
        folder = self.commits[self.commit_of(revision)]
        found = {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
        return {name: data for name, data in found.items() if name != ".gitattributes"}

    def arrived(self, n: int) -> None:
        self.received += n
        if self.kill is not None and self.received >= self.kill[1]:
            process, self.kill = self.kill[0], None
            os.kill(process, signal.SIGKILL)


class UploadHandler(Handler):
    server: UploadHub

    def do_GET(self) -> None:
        if self._asks():
            super().do_GET()

    def do_POST(self) -> None:
        body = self._body()
        if self._asks():
            self._route("POST", body)

    def do_PUT(self) -> None:
        path = urlsplit(self.path).path
        body = self._body()
        if path.startswith("/storage/"):
            self.server.log.append(f"PUT {path}")
            if hashlib.sha256(body).hexdigest() != path.rsplit("/", 1)[-1]:
                self.status(400)
                return
            self.server.storage[path.rsplit("/", 1)[-1]] = body
            self.status(200)
        elif self._asks():
            self._route("PUT", body)

    def _body(self) -> bytes:
        size, body = int(self.headers.get("Content-Length", 0)), bytearray()
        while len(body) < size:
            chunk = self.rfile.read(min(_KIB, size - len(body)))
            if not chunk:
                raise ConnectionError
            body += chunk
            self.server.arrived(len(chunk))
        return bytes(body)

    def _asks(self) -> bool:
        """Return whether the request has the token; answer it if not, or if there is nothing for it."""
        path = unquote(urlsplit(self.path).path)
        self.server.log.append(f"{self.command} {path}")
        self.server.headers.append((path, dict(self.headers)))
        self.server.arrived(1)
        faults = self.server.faults.get(f"{self.command} {path}")
        if faults and faults.pop(0)(self, b""):
            return False
        if self.headers.get("Authorization") != f"Bearer {self.server.token}":
            self.status(401)
            return False
        if self.command == "GET" and path.startswith("/api/") and "/revision/" not in path:
            self._route("GET", b"")
            return False
        return True

    def _route(self, method: str, body: bytes) -> None:
        path = unquote(urlsplit(self.path).path)
        for pattern, answer in _ROUTES.items():
            match = re.fullmatch(pattern, f"{method} {path}")
            if match is not None:
                status, document = answer(self.server, match, body)
                if self.server.lies is not None:
                    document = self.server.lies(method, path, document)
                self._answer(status, json.dumps(document).encode())
                return
        self.status(404, X_Error_Code="RepoNotFound")

    def _answer(self, status: int, data: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)


def _create(hub: UploadHub, match: Any, body: bytes) -> tuple[int, Any]:
    asked = json.loads(body)
    if hub.branches:
        return 409, {"error": "You already created this dataset repo", "url": f"{hub.url}/datasets/org/name"}
    assert (asked["organization"], asked["name"], asked["type"]) == ("org", "name", "dataset")
    hub.settings["private"] = asked.get("visibility") == "private"
    hub.branches["main"] = hub.new_commit()
    return 200, {"url": f"{hub.url}/datasets/org/name"}


def _settings(hub: UploadHub, match: Any, body: bytes) -> tuple[int, Any]:
    asked = json.loads(body)
    if "gated" in asked:
        hub.settings["gated"] = asked["gated"]
    if "visibility" in asked:
        hub.settings["private"] = asked["visibility"] == "private"
    return 200, {}


def _info(hub: UploadHub, match: Any, body: bytes) -> tuple[int, Any]:
    return 200, {"id": "org/name", "sha": hub.branches["main"], **hub.settings, "tags": [], "siblings": []}


def _refs(hub: UploadHub, match: Any, body: bytes) -> tuple[int, Any]:
    kinds = {"branches": ("heads", hub.branches), "tags": ("tags", hub.tags), "converts": ("convert", {})}
    return 200, {
        kind: [{"name": n, "ref": f"refs/{ref}/{n}", "targetCommit": c} for n, c in names.items()]
        for kind, (ref, names) in kinds.items()
    }


def _branch(hub: UploadHub, match: Any, body: bytes) -> tuple[int, Any]:
    hub.branches[match[1]] = hub.branches["main"]
    return 200, {}


def _tag(hub: UploadHub, match: Any, body: bytes) -> tuple[int, Any]:
    tag = json.loads(body)["tag"]
    if tag in hub.tags:
        return 409, {"error": "Tag already exists"}
    hub.tags[tag] = hub.commit_of(match[1])
    return 200, {}


def _oid(data: bytes) -> str:
    return hashlib.sha1(b"blob %d\0" % len(data) + data).hexdigest()


def _is_large(path: str, size: int) -> bool:
    return path.endswith(".h5") or size > _LARGE


def _paths(hub: UploadHub, match: Any, body: bytes) -> tuple[int, Any]:
    folder, answer = hub.commits[hub.commit_of(match[1])], []
    for path in parse_qs(body.decode())["paths"]:
        if (folder / path).is_file():
            data = (folder / path).read_bytes()
            entry: dict[str, Any] = {"type": "file", "path": path, "size": len(data), "oid": _oid(data)}
            if _is_large(path, len(data)):
                sha256 = hashlib.sha256(data).hexdigest()
                entry |= {"oid": _oid(sha256.encode()), "lfs": {"size": len(data), "oid": sha256, "pointerSize": 130}}
            answer.append(entry)
    return 200, answer


def _preupload(hub: UploadHub, match: Any, body: bytes) -> tuple[int, Any]:
    files = json.loads(body)["files"]
    modes = [
        {"path": f["path"], "uploadMode": "lfs" if _is_large(f["path"], f["size"]) else "regular"} for f in files
    ]
    return 200, {"files": [{**mode, "shouldIgnore": False, "oid": None} for mode in modes]}


def _batch(hub: UploadHub, match: Any, body: bytes) -> tuple[int, Any]:
    objects = []
    for asked in json.loads(body)["objects"]:
        entry = dict(asked)
        if asked["oid"] not in hub.storage:
            # As of a hub, whose storage is another host with signed addresses.
            upload = {"href": f"{hub.url}/storage/{asked['oid']}?X-Amz-Signature=s1gn4tur3", "header": {}}
            entry["actions"] = {"upload": upload}
        objects.append(entry)
    return 200, {"objects": objects, "transfer": "basic"}


def _commit(hub: UploadHub, match: Any, body: bytes) -> tuple[int, Any]:
    lines = [json.loads(line) for line in body.splitlines()]
    head = hub.branches[match[1]]
    if lines[0]["value"].get("parentCommit", head) != head:
        return 412, {"error": "the branch has moved on"}
    name = hub.new_commit(head)
    folder = hub.commits[name]
    for line in lines[1:]:
        value = line["value"]
        path = folder / value["path"]
        if line["key"] == "lfsFile" and value["oid"] not in hub.storage:
            return 400, {"error": "the storage has no such file"}
        path.unlink(missing_ok=True)  # a hard link
        if line["key"] != "deletedFile":
            path.parent.mkdir(parents=True, exist_ok=True)
            is_large = line["key"] == "lfsFile"
            path.write_bytes(hub.storage[value["oid"]] if is_large else base64.b64decode(value["content"]))
    hub.branches[match[1]] = name
    return 200, {"commitUrl": f"{hub.url}/datasets/org/name/commit/{name}", "commitOid": name}


_REPO = "/api/datasets/org/name"
_ROUTES: dict[str, Callable[[UploadHub, Any, bytes], tuple[int, Any]]] = {
    "POST /api/repos/create": _create, f"PUT {_REPO}/settings": _settings, f"GET {_REPO}": _info,
    f"GET {_REPO}/refs": _refs, f"POST {_REPO}/branch/(.+)": _branch, f"POST {_REPO}/tag/(.+)": _tag,
    f"POST {_REPO}/paths-info/(.+)": _paths,
    "POST /api/validate-yaml": lambda hub, match, body: (200, {"errors": [], "warnings": []}),
    f"POST {_REPO}/preupload/(.+)": _preupload, r"POST /datasets/org/name\.git/info/lfs/objects/batch": _batch,
    f"POST {_REPO}/commit/(.+)": _commit,
}  # fmt: skip
