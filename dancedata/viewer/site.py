"""What the server of `dancedata view` answers: the page, clips, music and comparisons, by number."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any
from urllib.parse import quote

from dancedata.core.errors import DanceDataError, StoreError
from dancedata.store.dataset import reopen
from dancedata.store.schema import DATASET_FILE
from dancedata.viewer import Item, Scenes
from dancedata.viewer.page import page_data, page_parts, whole_page
from dancedata.viewer.payload import scene_payload
from dancedata.viewer.source import ClipSource, flac
from dancedata.viewer.takes import Take, take_payload

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
    """Answers requests by their paths; numbers are those of the list of clips, and nothing is a file name.

    Parameters
    ----------
    scenes
        The dataset.
    source
        Its source, for music; None without one.
    takes
        What its clips can be compared with.
    """

    def __init__(self, scenes: Scenes, source: ClipSource | None = None, takes: Sequence[Take] = ()) -> None:
        self.scenes, self.source, self.takes = scenes, source, tuple(takes)
        self._seen = self._identity()
        self._sliding: list[float | None] | None = None
        self._measured = 0
        self._lock, self._decoding = threading.Lock(), threading.Lock()
        self._heard: tuple[Item, Answer] | None = None

    @property
    def policy(self) -> str:
        """Content security policy of the page: it may fetch from its own server, and nothing frames it."""
        return f"{page_parts().policy}; connect-src 'self'; frame-ancestors 'none'"

    def answer(self, path: str, name: str | None) -> Answer:
        """Answer a path.

        Parameters
        ----------
        path
            Such as "/", "/clip/12", "/clip/12/music", "/clip/12/with/0", "/sliding".
        name
            Motion field to draw; None: the default.
        """
        parts = path.removeprefix("/").split("/")
        try:
            if self._was_rebuilt():
                return Answer.of(409, "the dataset was rebuilt")
            if parts == [""]:
                return Answer(200, self._page, HTML)
            if parts == ["sliding"]:
                return _json(self._sliding_so_far())
            if parts[0] == "clip" and len(parts) in (2, 3, 4):
                return self._clip(parts[1:], name)
        except StoreError as error:
            return Answer.of(409 if self._was_rebuilt() else 500, str(error))
        except DanceDataError as error:
            return Answer.of(400, str(error))
        return _NOT_FOUND

    def _clip(self, parts: Sequence[str], name: str | None) -> Answer:
        item = _numbered(parts[0], self.scenes.items)
        if item is None:
            return _NOT_FOUND
        if len(parts) == 1:
            return _json(scene_payload(self.scenes.scene(item, name)))
        if parts[1:] == ["music"]:
            return self._music(item)
        take = _numbered(parts[2], self.takes) if len(parts) == 3 and parts[1] == "with" else None
        return _NOT_FOUND if take is None else _json(take_payload(take, self.scenes.scene(item, name)))

    def _music(self, item: Item) -> Answer:
        """Answer with the music of an item; songs are decoded whole, so one after the other, and the last is kept."""
        if self.source is None:
            return _NO_MUSIC
        with self._decoding:
            if self._heard is None or self._heard[0] != item:
                self._heard = None
                sound = self.source.sound(item)
                if sound is None:
                    return _NO_MUSIC
                notes = {NOTE: quote("; ".join(sound.notes))} if sound.notes else {}
                self._heard = item, Answer(200, flac(sound.signal), FLAC, notes)
            return self._heard[1]

    @cached_property
    def _page(self) -> bytes:
        names = [take.name for take in self.takes]
        data = page_data(self.scenes, self.scenes.items, takes=names, server=True, sound=self.source is not None)
        return whole_page(data, data["head"]["name"], meta_policy=False).encode()

    def _identity(self) -> tuple[int, ...]:
        status = os.stat(self.scenes.store.path / DATASET_FILE)
        return status.st_ino, status.st_size, status.st_mtime_ns

    def _was_rebuilt(self) -> bool:
        """Tell whether another dataset is at the path now."""
        try:
            if self._identity() == self._seen:
                return False
            reopen(*self.scenes.store.reference)
        except (OSError, StoreError):
            return True
        self._seen = self._identity()
        return False

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
                figure = self.scenes.scene(item).figure
                values[item.number] = None if figure is None else round(figure.sliding, 4)
            except DanceDataError:
                values[item.number] = None
            self._measured += 1


_NOT_FOUND = Answer.of(404, "no such page")
_NO_MUSIC = Answer.of(404, "the source has no music of this clip")


def _json(document: Any) -> Answer:
    return Answer(200, json.dumps(document, separators=(",", ":"), allow_nan=False).encode(), JSON)


def _numbered(text: str, things: Sequence[Any]) -> Any:
    """Return the thing of a number in a path; None if the text is not such a number."""
    if not (text.isascii() and text.isdigit()) or len(text) > 9 or int(text) >= len(things):
        return None
    return things[int(text)]
