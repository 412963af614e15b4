"""Pages of motions in memory: the player of `dancedata view` without its server, for notebooks and as files."""

from __future__ import annotations

import html
import tempfile
import webbrowser
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.files.atomic import require_free
from dancedata.files.page_files import save_page
from dancedata.kernel import Clip
from dancedata.scene.inputs.clip import MemoryClip
from dancedata.scene.motions import MotionScenes, MusicFiles
from dancedata.scene.opus import opus
from dancedata.scene.page import PageSound, clip_page
from dancedata.scene.wall import Wall, WallSounds

#: One motion, or several, by name or numbered from 0.
Motions: TypeAlias = Motion | Sequence[Motion] | Mapping[str, Motion]
#: The same of motions and of clips of a dataset.
PlayedMotion: TypeAlias = Motion | Clip | Sequence[Motion | Clip] | Mapping[str, Motion | Clip]
#: Height of the output of a notebook cell, CSS pixels.
_CELL_HEIGHT = 640


@dataclass(frozen=True)
class Page:
    """A page that plays motions, complete in itself: the output of a notebook cell, or a file."""

    title: str
    page: str

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the page; UsageError if the file is there, StoreError if it cannot be written."""
        return save_page(require_free(Path(path), [], "page", overwrite=overwrite), self.page)

    def open(self) -> Path:
        """Write the page to a new temporary file, open it in the browser, and return the file."""
        path = self.save(Path(tempfile.mkdtemp(prefix="dancedata-view-"), "motion.html"))
        webbrowser.open(path.as_uri())
        return path

    def _repr_html_(self) -> str:
        """Return an element for a notebook cell: the page in a frame without access to the notebook."""
        return (
            f'<iframe srcdoc="{html.escape(self.page)}" sandbox="allow-scripts" title="{html.escape(self.title)}" '
            f'style="width:100%;height:{_CELL_HEIGHT}px;border:0"></iframe>'
        )

    def __repr__(self) -> str:
        return f"Page({self.title}, {len(self.page) / 1000:.0f} kB)"


def motion_scenes_of(motions: PlayedMotion, music: str | Path | None = None) -> MotionScenes:
    """Return the scenes of motions in memory, with a music file or folder as `MusicFiles.beside` takes it."""
    if isinstance(motions, Motion | Clip):
        motions = {"motion": motions}
    elif not isinstance(motions, Mapping):
        motions = {f"motion_{number}": motion for number, motion in enumerate(motions)}
    wrong = [name for name, motion in motions.items() if not isinstance(motion, Motion | Clip)]
    if wrong:
        raise UsageError(f"{wrong[0]!r} is not a Motion", found=type(motions[wrong[0]]).__name__)
    clips = [
        MemoryClip(id=name, motion=motion.motion() if isinstance(motion, Clip) else motion)
        for name, motion in motions.items()
    ]
    beside = None if music is None else MusicFiles.beside(Path(music).expanduser(), clips)
    return MotionScenes(clips, "motions", beside)


def view_motions(motions: PlayedMotion, *, music: str | Path | None = None, wall: bool = False) -> Page:
    """Return a page that plays motions.

    `motions`: One Motion, or clip of a dataset; several, by name or in a sequence.
    `music`: Music file, or folder of files named as the motions; it is put into the page.
    `wall`: Whether all stand on one stage.
    Raises UsageError: for something other than motions, and music that is not there.
    """
    scenes = motion_scenes_of(motions, music)
    shown = Wall(scenes) if wall else scenes
    sounds = WallSounds(shown, scenes) if isinstance(shown, Wall) else scenes
    files = {item.number: sounds.sound(item) for item in shown.items}
    embedded = PageSound({number: opus(sound.signal) for number, sound in files.items() if sound is not None})
    title = ", ".join(item.id for item in scenes.items)
    return Page(title, clip_page(shown, shown.items, sound=embedded if embedded.files else None))


def write_page(
    motions: PlayedMotion,
    path: str | Path,
    *,
    music: str | Path | None = None,
    wall: bool = False,
    overwrite: bool = False,
) -> Path:
    """Write a page that plays motions, complete in one file; see `view_motions`.

    Raises
    ------
    UsageError
        As `view_motions`; if the file is there.
    StoreError
        If it cannot be written.

    Examples
    --------
    >>> import dancedata
    >>> from dancedata import plot
    >>> plot.write_page(dancedata.open("data/aistpp").clips[0].motion(), "motion.html")
    PosixPath('motion.html')
    """
    return view_motions(motions, music=music, wall=wall).save(path, overwrite=overwrite)
