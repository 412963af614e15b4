"""What the loaders of Bailando and FACT read from a sequence's name, and clips of AIST++'s ignore list."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.text import listed
from dancedata.datasets.aistpp.facts import facts
from dancedata.exports.base.needs import needs_names

if TYPE_CHECKING:
    from dancedata.exports.base.folder import ExportFolder
    from dancedata.exports.base.job import ExportJob, Lack
    from dancedata.store import ClipView

#: Parts of the crossmodal protocol in the order in which the originals read their lists.
PARTS = {"train": ("train",), "test": ("test", "val")}


def name_lacks(job: ExportJob, clips: list[ClipView]) -> list[Lack]:
    """Return clips whose name does not have the id of its music as the second last part between underscores."""
    music = {clip.id: clip.music for clip in clips}
    form = "as AIST++ does: gBR_sBM_cAll_d04_mBR2_ch08, with the music second last; copies (augment) end otherwise"
    return needs_names(clips, lambda name: bool(music[name]) and name.split("_")[-2:-1] == [music[name]], form)


def is_ignored(clip: ClipView) -> bool:
    """Tell whether a clip is on the ignore list of AIST++, or of its own dataset."""
    return clip.id in facts().ignored or "ignored" in clip.lists


def note_ignored(folder: ExportFolder, clips: list[ClipView]) -> None:
    """Note the clips of the ignore list that are left out."""
    ignored = [clip.id for clip in clips if is_ignored(clip)]
    if ignored:
        folder.note(f"left out, as they are on the ignore list: {listed(ignored)}; --keep-ignored keeps them")
