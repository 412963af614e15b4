"""FineDance (Li et al. 2023): full-body dance with hands to music in 16 genres, 211 sequences, 30 FPS.

The published archive, unpacked:

.. code-block:: text

    SOURCE/
        motion/001.npy        (T, 315): root translation 3, then 52 joints x 6D (two rows of the matrix)
        music_wav/001.wav     wav, flac, mp3 or ogg; motion and music both start at t = 0
        label_json/001.json   style1 (coarse), style2 (the genre), the song's name
        music_npy/001.npy     not read: features are computed from the audio

SOURCE may be the folder that contains ``motion/`` or its parent. Facts (splits, ignore lists, trims, genres) are in
``manifests/finedance.yaml``.
"""

from dancedata.datasets.finedance.reader import FineDance

__all__ = ["FineDance"]
