"""A folder of your own motion files and music, with a manifest or matching file names: docs/guides/own-captures.md.

Frame rate, up axis and unit come from the manifest, else from the file or its format, else from the recipe; they are
never guessed unless the recipe asks for it.
"""

from dancedata.datasets.folder.reader import Folder

__all__ = ["Folder"]
