"""The clips of a report: the viewer's page inside the report's, started when a link to a clip is opened."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

from dancedata.core.errors import UsageError
from dancedata.core.terms import require_shareable
from dancedata.kernel import Store
from dancedata.pages.markup import Markup
from dancedata.scene.opus import opus
from dancedata.scene.page import PageSound, data_script, page_data, page_parts, source_hash
from dancedata.scene.payload import link, page_json, scene_payload
from dancedata.scene.scene_list import Item, SceneList
from dancedata.scene.scenes import Scenes
from dancedata.scene.source import ClipSource

#: Clips inside the page; further clips are separate files.
INLINE = 12


@dataclass(frozen=True)
class Player:
    """Clips in a report."""

    # `links`, `group_links`: address of each clip and of each group, for HTML
    links: Mapping[str, Markup] = field(default_factory=dict)
    group_links: Mapping[str, Markup] = field(default_factory=dict)
    # address of the list of clips of each genre, song and dancer, from the first of them
    lists: Mapping[str, Markup] = field(default_factory=dict)
    css: str = ""
    # `body`, `scripts`: HTML after the report, and the scripts that the page's policy allows
    body: str = ""
    scripts: tuple[str, ...] = ()
    # names of the files next to the page and the number of the clip in each; read one at a time
    side: Mapping[str, int] = field(default_factory=dict)
    scenes: SceneList | None = None
    items: Sequence[Item] = ()

    @property
    def script_sources(self) -> str:
        """Script sources that the content security policy allows."""
        hashes = " ".join(f"'{source_hash(script)}'" for script in self.scripts)
        return f"{hashes} 'self'" if self.side else hashes or "'none'"

    def side_files(self) -> dict[str, Callable[[], bytes]]:
        """Return what writes each file next to the page, a script with the data of a clip."""
        return {name: partial(self._side_file, number) for name, number in self.side.items()}

    def _side_file(self, number: int) -> bytes:
        if self.scenes is None:
            return b""
        script = f"dancedataClip({number}, {page_json(_payload(self.scenes, self.items[number], number))});\n"
        return script.encode()


#: A report without clips.
NO_PLAYER = Player()


def clip_player(store: Store, clips: Sequence[str], folder: str, sound: PageSound | None = None) -> Player:
    """Return the player of clips of a dataset, of whole groups for their dancers; see `scene_player`."""
    if not clips:
        return NO_PLAYER
    scenes = Scenes(store)
    return scene_player(scenes, _entries(scenes, clips), folder, sound)


def scene_player(scenes: SceneList, items: Sequence[Item], folder: str, sound: PageSound | None = None) -> Player:
    """Return the player of items: the first INLINE of them are inside the page, the others in a folder next to it."""
    if not items:
        return NO_PLAYER
    inline = {k: _payload(scenes, item, k) for k, item in enumerate(items[:INLINE])}
    side = {f"clip-{k:05d}.js": k for k in range(INLINE, len(items))}
    addresses = {k: f"{quote(folder)}/{name}" for name, k in side.items()}
    document = page_data(scenes, items, clips=inline, side=addresses, sound=sound or False)
    parts = page_parts()
    script = files("dancedata.pages").joinpath("static", "report.js").read_text(encoding="utf-8")
    body = (
        f'<template id="r-clips">{parts.html}{data_script(document)}</template>'
        f'<script type="text/plain" id="r-script">{parts.script}</script><script>{script}</script>'
    )
    dancers = [dancer for item in items for dancer in item.members or (item,)]
    links = {dancer.clip.id: Markup(escape(link(dancer), quote=True)) for dancer in dancers}
    groups = {item.name: Markup(escape(link(item), quote=True)) for item in items if item.members}
    return Player(links, groups, _lists(items), parts.css, body, (script, parts.script), side, scenes, items)


def _lists(items: Sequence[Item]) -> dict[str, Markup]:
    lists: dict[str, Markup] = {}
    for item in items:
        for name in (item.clip.genre, item.clip.music, item.clip.dancer):
            if name and name not in lists:
                lists[name] = Markup(escape(f"{link(item)}&list={quote(name, safe='')}", quote=True))
    return lists


def _entries(scenes: Scenes, clips: Sequence[str]) -> list[Item]:
    """Return the entries of the viewer's list that have these clips: for a dancer the group."""
    return [scenes.items[scenes.find(clip).number] for clip in clips]


def _payload(scenes: SceneList, item: Item, number: int) -> dict[str, Any]:
    return {**scene_payload(scenes.scene(item)), "number": number}


def embedded_sound(store: Store, clips: Sequence[str], source: Path | None, *, rights: str | None) -> PageSound:
    """Return the music of clips as Opus, mono, each exactly as long as its clip."""
    notice = require_shareable(store, rights=rights)
    if source is None:
        raise UsageError("the music is needed", fix="name the folder with it: --music DIR, or source=DIR")
    scenes, music = Scenes(store), ClipSource(store, source.expanduser())
    sounds = {k: music.sound(item) for k, item in enumerate(_entries(scenes, clips[:INLINE]))}
    files_of = {k: opus(sound.signal) for k, sound in sounds.items() if sound is not None}
    if clips and not files_of:
        raise UsageError("the source has no music of these clips", where=source)
    return PageSound(files_of, notice)
