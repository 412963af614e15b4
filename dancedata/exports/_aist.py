"""What exports of AIST++ share: the parts of its crossmodal protocol, names, and the ignore list."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.resources import manifest
from dancedata.core.text import listed
from dancedata.exports.base.job import ExportJob, Missing
from dancedata.exports.base.needs import needs_names

if TYPE_CHECKING:
    from dancedata.files.atomic_folder import AtomicFolder
    from dancedata.kernel import Clip

#: Parts of the crossmodal protocol in the order in which the originals read their lists.
PARTS = {"train": ("train",), "test": ("test", "val")}


def needs_aist_names(job: ExportJob, clips: list[Clip]) -> list[Missing]:
    """Check that the second last part of names, between underscores, is the music: loaders read it there."""
    music = {clip.id: clip.music for clip in clips}
    form = "as AIST++ does: gBR_sBM_cAll_d04_mBR2_ch08, with the music second last; copies (augment) end otherwise"
    return needs_names(clips, lambda name: bool(music[name]) and name.split("_")[-2:-1] == [music[name]], form)


def is_ignored(clip: Clip) -> bool:
    """Whether a clip is on the ignore list of AIST++, or of its own dataset."""
    return clip.id in manifest("aistpp")["ignored"] or "ignored" in clip.lists


def note_ignored(folder: AtomicFolder, clips: list[Clip]) -> None:
    """Note the clips of the ignore list that are left out."""
    ignored = [clip.id for clip in clips if is_ignored(clip)]
    if ignored:
        folder.note(
            f"left out, as they are on the ignore list: {listed(ignored)}; --set keep_ignored=true keeps them"
        )
