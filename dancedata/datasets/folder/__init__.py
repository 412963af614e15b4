"""A folder of your own motion files and music, with a manifest or matching file names: docs/guides/own-captures.md.

Without a manifest:

.. code-block:: text

    SOURCE/                      SOURCE/
        motions/NAME.npz             NAME.bvh
        music/NAME.wav               NAME.wav
        (or wavs/, audio/)

Frame rate, up axis and unit come from the manifest, else from the file or its format, else from the recipe; they are
never guessed unless the recipe asks for it.
"""

from dancedata.datasets.folder.reader import Folder

__all__ = ["Folder"]
