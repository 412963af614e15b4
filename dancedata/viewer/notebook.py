"""Clips in notebooks: the page that plays a clip, inside the output of a cell."""

import html

from dancedata.store import ClipView, Store
from dancedata.viewer.page import clip_page
from dancedata.viewer.scenes import Scenes

#: Height of the output, CSS pixels.
_HEIGHT = 640
#: Most windows of a clip of window scope that one output holds.
_WINDOWS = 24


def clip_html(store: Store, clip: ClipView) -> str:
    """Return an element that plays a clip, in window scope its first windows; it needs no server and no network.

    The page is in a frame without access to the notebook; names in the dataset are text.
    """
    scenes = Scenes(store)
    items = [item for item in scenes.items if item.clip.id == clip.id][:_WINDOWS]
    page = clip_page(scenes, items)
    return (
        f'<iframe srcdoc="{html.escape(page)}" sandbox="allow-scripts" title="{html.escape(repr(clip))}" '
        f'style="width:100%;height:{_HEIGHT}px;border:0"></iframe>'
    )
