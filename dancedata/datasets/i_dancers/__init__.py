"""I-Dancers (CoheDancers, Yang et al. 2025): groups of dancers, SMPL by rotation matrices.

.. code-block:: text

    SOURCE/
        motion/NAME_smpl.pkl    smpl_poses (P, T, 24, 3, 3), smpl_trans (P, T, 3)
        music/NAME.wav          music of the sequence; second 0 is frame 0
        train.txt, test.txt     names, as they are or with the ending _smpl.pkl

SOURCE may be the folder that contains ``motion/`` or its parent. Neither the rate nor the axis that is up is
published. CoheDancers' loader takes frames 15 to -15 of each sequence and of its features; `trim_frames` does so.
"""

from dancedata.datasets.i_dancers.reader import IDancers

__all__ = ["IDancers"]
