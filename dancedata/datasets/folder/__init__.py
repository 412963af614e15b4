"""One's own captures: a folder of motion files and music, with a manifest or matching file names."""

from dancedata.datasets.folder.reader import Folder

__all__ = ["Folder"]
