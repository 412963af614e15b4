"""The page that plays clips: plain HTML, CSS and JavaScript in one file, without a request to anywhere."""

import base64
import hashlib
import html
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from dancedata.core.text import shown
from dancedata.scene.comparisons import Comparison, comparison_payload
from dancedata.scene.payload import Json, item_rows, page_json, scene_payload
from dancedata.scene.scene_list import Item, SceneList

_STATIC = Path(__file__).resolve().parent / "static"
_IMPORT = re.compile(r"^import \{[^}]*\} from '\./(\w+)\.js';\n", re.MULTILINE)
#: Indentation, empty lines and comments, which the script of a page does not need.
_LAYOUT = re.compile(r"^[ \t]*(?://.*)?\n|^[ \t]+|[ \t]+// .*$", re.MULTILINE)


@dataclass(frozen=True)
class Parts:
    """The viewer's part of a page; the script follows the element with the data."""

    css: str
    html: str
    script: str

    @property
    def policy(self) -> str:
        """Content security policy of a page whose only style and script are these."""
        return (
            f"default-src 'none'; script-src '{source_hash(self.script)}'; style-src '{source_hash(self.css)}'; "
            "img-src data:; base-uri 'none'; form-action 'none'"
        )


@cache
def page_parts() -> Parts:
    """Read the viewer's files. The script is one function, so that it shares no name with others of its page."""
    css, body = ((_STATIC / name).read_text(encoding="utf-8") for name in ("viewer.css", "viewer.html"))
    script = f"'use strict';\n(() => {{\n{''.join(_modules('viewer', {}).values())}}})();\n"
    return Parts(css, body, _LAYOUT.sub("", script))


def _modules(name: str, read: dict[str, str]) -> dict[str, str]:
    """Read a module after those that it imports, without its imports and exports."""
    text = (_STATIC / "js" / f"{name}.js").read_text(encoding="utf-8")
    for imported in _IMPORT.findall(text):
        if imported not in read:
            _modules(imported, read)
    read[name] = re.sub(r"^export ", "", _IMPORT.sub("", text), flags=re.MULTILINE)
    return read


def source_hash(text: str) -> str:
    """Return the hash by which a content security policy allows an inline script or style."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


@dataclass(frozen=True)
class PageSound:
    """Music inside a page: by the number of each item an audio file of its length, and a notice of their licence."""

    files: Mapping[int, bytes] = field(default_factory=dict)
    notice: str = ""


def page_data(
    scenes: SceneList,
    items: Sequence[Item],
    *,
    clips: Mapping[int, Json] | None = None,
    side: Mapping[int, str] | None = None,
    sound: PageSound | bool = False,
    comparisons: Sequence[str] = (),
    server: bool = False,
    single: bool = False,
    address: str = "",
) -> Json:
    """Return the data of a page."""
    counts = tuple(scenes.flag_count(item) for item in items)
    inside = sound if isinstance(sound, PageSound) else PageSound()
    head = {**scenes.about(), "fields": list(scenes.fields) if server else []}
    document: dict[str, Any] = {
        "head": {**head, "takes": list(comparisons), "sound": bool(sound), "notice": inside.notice},
        "list": item_rows(tuple(items), counts), "clips": clips or {}, "side": side or {}, "server": server,
        "single": single, "at": address,
        "audio": {k: base64.b64encode(data).decode() for k, data in inside.files.items()},
    }  # fmt: skip
    return document


def data_script(document: Json) -> str:
    """Return the script element with the data, which precedes the viewer's script."""
    return f'<script type="application/json" id="dd-data">{page_json(document)}</script>'


def clip_page(
    scenes: SceneList,
    items: Sequence[Item],
    *,
    sound: PageSound | None = None,
    comparisons: Sequence[Comparison] = (),
    address: str = "",
) -> str:
    """Return one self-contained HTML page that plays items, with what they are compared with; it works offline."""
    clips = {}
    for number, item in enumerate(items):
        scene = scenes.scene(item)
        compared = {c.name: comparison_payload(c, scene) for c in comparisons}
        clips[number] = {
            **scene_payload(scene, turns=True),
            "number": number,
            **({"with": compared} if compared else {}),
        }
    document = page_data(
        scenes, items, clips=clips, sound=sound or False, single=len(items) == 1, address=address,
        comparisons=[comparison.name for comparison in comparisons],
    )  # fmt: skip
    return whole_page(document, str(document["head"]["name"]), meta_policy=True)


def whole_page(document: Json, title: str, *, meta_policy: bool, more: Parts | None = None) -> str:
    """Return the page of a document; with `meta_policy` its content security policy is inside it."""
    parts = page_parts()
    if more is not None:
        parts = Parts(parts.css + more.css, parts.html + more.html, parts.script + more.script)
    policy = (
        f'<meta http-equiv="Content-Security-Policy" content="{html.escape(parts.policy)}">' if meta_policy else ""
    )
    return (
        f'<!doctype html>\n<html lang="en" class="dd-page"><head><meta charset="utf-8">{policy}'
        '<meta name="viewport" content="width=device-width,initial-scale=1"><link rel="icon" href="data:,">'
        f"<title>{html.escape(shown(title))}</title><style>{parts.css}</style></head><body>\n{parts.html}\n"
        f"{data_script(document)}<script>{parts.script}</script></body></html>\n"
    )
