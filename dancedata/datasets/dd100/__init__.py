"""DD100 (Siyao et al. 2024, Duolando): 100 minutes of duets in ten genres with hands, 30 FPS, +Z up.

The published files:

.. code-block:: text

    SOURCE/
        motion/smplx/all/GENRE_CHOREO_TAKE_00.npy    follower: a dict in an array of objects; train/ and test/ as well
        motion/smplx/all/GENRE_CHOREO_TAKE_01.npy    leader
        music/mp3/all/GENRE_CHOREO_TAKE.mp3          or wav, flac, ogg

The dict has ``poses`` (T, 165) or (T, 55, 3), ``global_orient`` (T, 3), ``transl`` (T, 3) in metres.
"""

from dancedata.datasets.dd100.reader import DD100

__all__ = ["DD100"]
