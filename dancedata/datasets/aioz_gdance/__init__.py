"""AIOZ-GDANCE (Le et al. 2023): groups of 2 to 7 dancers from videos, SMPL at 30 FPS; 1,624 sequences of 311 videos.

.. code-block:: text

    SOURCE/
        motions_smpl/NAME.pkl       smpl_poses (P, T, 72), or (P, T, 63) and smpl_orients (P, T, 3); root_trans
        musics/NAME.wav             music of the sequence, or music/; second 0 is frame 0
        train_split_sequence_names.txt, val_..., test_...    names, one per line; further columns are not read
        train_labels.csv, val_..., test_...                  name, music genre and dance style; optional

NAME is VIDEO_SEGMENT_START_END; VIDEO has 11 characters and may contain "_" and begin with "-". SOURCE may be the
folder that contains ``motions_smpl/`` or its parent.
"""

from dancedata.datasets.aioz_gdance.reader import AiozGdance

__all__ = ["AiozGdance"]
