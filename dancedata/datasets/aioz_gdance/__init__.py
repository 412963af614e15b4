"""AIOZ-GDANCE (Le et al. 2023): groups of 2 to 7 dancers from videos, 1,624 sequences, 30 FPS, +Y up.

The published files:

.. code-block:: text

    SOURCE/
        motions_smpl/VIDEO_SEGMENT_START_END.pkl    all dancers of a sequence: smpl_poses (P, T, 72), or (P, T, 63)
                                                    with smpl_orients (P, T, 3); root_trans (P, T, 3), metres
        musics/NAME.wav                             frame 0 is second 0; music/ and musics438/ are read as well
        {train,val,test}_split_sequence_names.txt   the official lists
        {train,val,test}_labels.csv                 genre of the music and style of the dance, optional

VIDEO is the id of a YouTube video, which may contain ``_``: names are split from the right.
"""

from dancedata.datasets.aioz_gdance.reader import AiozGdance

__all__ = ["AiozGdance"]
