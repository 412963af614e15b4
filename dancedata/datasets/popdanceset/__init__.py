"""PopDanceSet (Luo et al. 2024): dances from videos, SMPL by HybrIK, 30 FPS; 1,036 clips of 305 videos.

.. code-block:: text

    SOURCE/
        motions/BVxxxxxxxxxx_Clip_1.pkl    transl (T, 3), pred_thetas (T, 72), pred_camera (T, 1)
        wavs/BVxxxxxxxxxx_Clip_1.wav       music of the clip; second 0 is frame 0
        splits/train.txt, test.txt         names, from POPDG's repository (data/splits); also found beside motions/
        high_quality_dataset               names, from POPDG's repository; optional

SOURCE may be the folder that contains ``motions/`` or its parent.
"""

from dancedata.datasets.popdanceset.reader import PopDanceSet

__all__ = ["PopDanceSet"]
