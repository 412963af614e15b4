"""The server of `dancedata view`: 127.0.0.1 only, one secret, and no file names from requests."""

from __future__ import annotations

import hmac
import json
import secrets
import sys
import threading
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, TypeVar
from urllib.parse import parse_qs, quote, urlsplit

from dancedata.core.errors import DanceDataError, StoreError, UsageError
from dancedata.formats.body_mesh import BodyMesh
from dancedata.scene.comparisons import Comparison, ItemComparison, comparison_payload
from dancedata.scene.page import page_data, page_parts, whole_page
from dancedata.scene.payload import scene_payload, scene_turns
from dancedata.scene.scene_list import Item, Scene, SceneList
from dancedata.scene.source import Sounds, flac
from dancedata.viewer.model import as_model, model_payload

T = TypeVar("T")

#: Names of this machine: another host name that points to it (DNS rebinding) is refused.
_HOSTS = ("127.0.0.1", "localhost", "[::1]")
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "X-Frame-Options": "DENY",
}
#: Seconds after which a connection without a request is closed.
_IDLE_S = 60
#: Seconds of the dancers in the first answer for a long clip, and how long a clip is to be one.
FIRST_S, LONG_S = 60.0, 120.0
#: Clips that are kept as they were answered, and the most bytes of them.
_KEPT, _KEPT_BYTES = 8, 64_000_000


class ViewServer(ThreadingHTTPServer):
    """Serves a site on a port of 127.0.0.1, 0 for a free one; UsageError if it is taken."""

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, site: Site, port: int = 0) -> None:
        self.site = site
        self.token = secrets.token_urlsafe(24)
        try:
            super().__init__(("127.0.0.1", port), _Handler)
        except (OSError, OverflowError) as error:
            raise UsageError("the port cannot be used", where=f"127.0.0.1:{port}", found=str(error),
                             fix="choose another --port, or leave it out for a free one") from error  # fmt: skip

    @property
    def address(self) -> str:
        """The address to open, with the secret."""
        return f"http://127.0.0.1:{self.server_port}/?token={self.token}"

    @property
    def cookie(self) -> str:
        """Name of the cookie: cookies of one host are shared by all of its ports."""
        return f"dancedata{self.server_port}"

    def handle_error(self, request: object, client_address: object) -> None:
        """Print nothing where a browser has closed its connection."""
        if not isinstance(sys.exc_info()[1], ConnectionError | TimeoutError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]  # as the server itself calls it


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "dancedata", ""
    timeout = _IDLE_S
    server: ViewServer
    error_content_type = "text/plain; charset=utf-8"
    error_message_format = "%(code)d %(message)s\n"

    def do_GET(self) -> None:
        """Answer a request."""
        if (self.headers.get("Host") or "").rpartition(":")[0] not in _HOSTS:
            self._send(Answer.of(403, "unknown host"))
            return
        try:
            url = urlsplit(self.path)
            query = parse_qs(url.query, keep_blank_values=True)
        except ValueError:
            self._send(Answer.of(400, "not an address"))
            return
        if url.path == "/" and self._is_secret(query.get("token", [""])[0]):
            cookie = f"{self.server.cookie}={self.server.token}; HttpOnly; SameSite=Strict; Path=/"
            self._send(Answer.of(303, ""), {"Location": "/", "Set-Cookie": cookie})
        elif not self._is_secret(self._cookie()):
            self._send(Answer.of(403, "open the address that dancedata view printed"))
        else:
            part = query.get("part", [""])[0]
            self._send(self.server.site.answer(url.path, query.get("field", [None])[0], part=part))

    def do_HEAD(self) -> None:
        """Answer a request for the headers."""
        self.do_GET()

    def _cookie(self) -> str:
        pairs = (pair.strip().partition("=") for pair in (self.headers.get("Cookie") or "").split(";"))
        return next((value for name, _, value in pairs if name == self.server.cookie), "")

    def _is_secret(self, text: str) -> bool:
        return hmac.compare_digest(text.encode("utf-8", "backslashreplace"), self.server.token.encode())

    def _send(self, answer: Answer, more: dict[str, str] | None = None) -> None:
        policy = {"Content-Security-Policy": self.server.site.policy} if answer.kind == HTML else {}
        with suppress(ConnectionError):  # the page was closed
            self.send_response(answer.status)
            headers = {"Content-Type": answer.kind, "Content-Length": str(len(answer.body))}
            for name, value in {**headers, **_HEADERS, **policy, **answer.headers, **(more or {})}.items():
                self.send_header(name, value)
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(answer.body)

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing."""


HTML, JSON, FLAC, TEXT = "text/html; charset=utf-8", "application/json", "audio/flac", "text/plain; charset=utf-8"
#: Header with a sentence about the music, percent-encoded.
NOTE = "Dancedata-Note"
#: Most characters of an answer in words: names in it are from files, and from the address.
MAX_TEXT = 1_000


@dataclass(frozen=True)
class Answer:
    """One answer: status, body, the type of the body, and further headers."""

    status: int
    body: bytes
    kind: str = TEXT
    headers: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, status: int, text: str) -> Answer:
        """Make an answer of one sentence; a text of more than `MAX_TEXT` characters is cut."""
        cut = text if len(text) <= MAX_TEXT else f"{text[:MAX_TEXT]}..."
        return cls(status, cut.encode("utf-8", "backslashreplace"))


class Site:
    """Pages, clips, music and comparisons by number in the list of clips; no part of a path is a file name."""

    def __init__(
        self,
        scenes: SceneList,
        source: Sounds | None = None,
        comparisons: Sequence[Comparison] = (),
        mesh: BodyMesh | None = None,
    ) -> None:
        self.scenes, self.source, self.comparisons, self.mesh = scenes, source, tuple(comparisons), mesh
        self._sliding: list[float | None] | None = None
        self._measured = 0
        self._lock, self._decoding = threading.Lock(), threading.Lock()
        self._last_music: tuple[Item, Answer] | None = None
        self._answers: OrderedDict[tuple[int, str | None, str], Future[Answer]] = OrderedDict()

    @property
    def policy(self) -> str:
        """Content security policy of the page: it may fetch from its server, and no other page frames it."""
        return f"{page_parts().policy}; connect-src 'self'; frame-ancestors 'none'"

    def answer(self, path: str, name: str | None, *, part: str = "") -> Answer:
        """Answer a path."""
        parts = path.removeprefix("/").split("/")
        try:
            if self.scenes.changed():
                return Answer.of(409, "the dataset was rebuilt")
            if parts == ["model"]:
                return self._model
            if parts == [""]:
                return Answer(200, self._page, HTML)
            if parts == ["sliding"]:
                return _json(self._sliding_so_far())
            if parts[0] == "clip" and len(parts) in (2, 3, 4):
                return self._clip(parts[1:], name, part)
        except StoreError as error:
            return Answer.of(409 if self.scenes.changed() else 500, str(error))
        except DanceDataError as error:
            return Answer.of(400, str(error))
        return _NOT_FOUND

    def _clip(self, parts: Sequence[str], name: str | None, part: str) -> Answer:
        item = _numbered(parts[0], self.scenes.items)
        if item is None:
            return _NOT_FOUND
        if len(parts) == 1:
            long = float(self.scenes.grid.seconds(item.n_frames)) > LONG_S
            return self._scene(item, name, part if part == "turns" or (part == "first" and long) else "all")
        if parts[1:] == ["music"]:
            return self._music(item)
        comparison: Comparison | None = None
        if len(parts) == 3 and parts[1] == "with":
            comparison = _numbered(parts[2], self.comparisons)
        elif (
            len(parts) == 3 and parts[1] == "beside" and (other := _numbered(parts[2], self.scenes.items)) is not None
        ):
            comparison = ItemComparison(name=other.name, scenes=self.scenes, item=other)
        if comparison is None:
            return _NOT_FOUND
        return _json(comparison_payload(comparison, self._drawn(item, name)))

    def _drawn(self, item: Item, name: str | None, first_s: float | None = None) -> Scene:
        return as_model(self.scenes.scene(item, name, first_s=first_s), self.mesh)

    def _scene(self, item: Item, name: str | None, part: str) -> Answer:
        """Answer with a clip; requests for the same one at the same time wait for one answer, which is kept."""
        key = (item.number, name, part)
        with self._lock:
            answer = self._answers.get(key)
            is_first = answer is None
            if answer is None:
                answer = self._answers[key] = Future()
            self._answers.move_to_end(key)
        if is_first:
            try:
                scene = self._drawn(item, name, FIRST_S if part == "first" else None)
                document: Any = scene_turns(scene) if part == "turns" else scene_payload(scene)
                answer.set_result(_json({**document, "partial": True} if part == "first" else document))
            except BaseException as error:
                self._answers.pop(key, None)
                answer.set_exception(error)
                raise
            self._forget()
        return answer.result()

    def _forget(self) -> None:
        """Drop the answers that were asked for longest ago, until few enough are kept."""
        with self._lock:
            done = [key for key, answer in self._answers.items() if answer.done()]
            sizes = {key: len(self._answers[key].result().body) for key in done}
            for key in done[:-1]:
                if len(sizes) <= _KEPT and sum(sizes.values()) <= _KEPT_BYTES:
                    break
                del sizes[key], self._answers[key]

    def _music(self, item: Item) -> Answer:
        """Answer with the music of an item; songs are decoded whole, so one after the other, and the last is kept."""
        if self.source is None:
            return _NO_MUSIC
        with self._decoding:
            if self._last_music is None or self._last_music[0] != item:
                self._last_music = None
                sound = self.source.sound(item)
                if sound is None:
                    return _NO_MUSIC
                notes = {NOTE: quote("; ".join(sound.notes))} if sound.notes else {}
                self._last_music = item, Answer(200, flac(sound.signal), FLAC, notes)
            return self._last_music[1]

    @cached_property
    def _model(self) -> Answer:
        return _NOT_FOUND if self.mesh is None else _json(model_payload(self.mesh))

    @cached_property
    def _page(self) -> bytes:
        names = [comparison.name for comparison in self.comparisons]
        data = page_data(
            self.scenes, self.scenes.items, comparisons=names, server=True, sound=self.source is not None
        )
        data["head"] |= {} if self.mesh is None else {"model": True}
        return whole_page(data, data["head"]["name"], meta_policy=False).encode()

    def _sliding_so_far(self) -> dict[str, Any]:
        with self._lock:
            if self._sliding is None:
                self._sliding = [None] * len(self.scenes.items)
                threading.Thread(target=self._measure, daemon=True, name="sliding").start()
        done = self._measured == len(self.scenes.items)
        return {"done": done, "count": self._measured, "values": self._sliding}

    def _measure(self) -> None:
        values = self._sliding or []
        for item in self.scenes.items:
            try:
                sliding = [self.scenes.sliding(dancer) for dancer in item.members or (item,)]
                values[item.number] = max((round(value, 4) for value in sliding if value is not None), default=None)
            except DanceDataError:
                values[item.number] = None
            self._measured += 1


_NOT_FOUND = Answer.of(404, "no such page")
_NO_MUSIC = Answer.of(404, "the source has no music of this clip")


def _json(document: Any) -> Answer:
    return Answer(200, json.dumps(document, separators=(",", ":"), allow_nan=False).encode(), JSON)


def _numbered(text: str, entries: Sequence[T]) -> T | None:
    """Return the entry of a number in a path; None if the text is not such a number."""
    if not (text.isascii() and text.isdigit()) or len(text) > 9 or int(text) >= len(entries):
        return None
    return entries[int(text)]
