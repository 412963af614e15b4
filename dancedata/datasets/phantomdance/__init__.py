"""PhantomDance 1.2 (Li et al. 2022): dances made by animators, 260 with their music, 9.5 hours, 30 FPS.

.. code-block:: text

    SOURCE/
        .../NAME.json    bone_name (24), root_positions (T, 3) metres, rotations (T, 24, 4): x y z w, in the world
        .../NAME.wav     its music, 16 kHz, under the same name

The names of the folders are not documented: motions are in SOURCE or in one folder of it, music in any of these.
"""

from dancedata.datasets.phantomdance.reader import PhantomDance

__all__ = ["PhantomDance"]
