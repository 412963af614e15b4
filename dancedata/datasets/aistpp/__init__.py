"""AIST++ (Li et al. 2021): dance to music in ten genres, 1,408 sequences, 60 FPS.

There are two layouts; the reader tells them apart by the files it finds. In the official one the music is a
separate download, one file per song, which the user puts next to the motion:

.. code-block:: text

    SOURCE/
        motions/gBR_sBM_cAll_d04_mBR2_ch08.pkl   smpl_poses (N, 72), smpl_trans (N, 3), smpl_scaling (1,)
        wavs/mBR2.wav                            or music/, audio/, musics/, SOURCE; wav, flac, mp3 or ogg
        cameras/mapping.txt                      optional: all sequence names
        splits/crossmodal_{train,val,test}.txt   optional
        ignore_list.txt                          optional; may also lie in splits/

In EDGE's (Tseng et al. 2023) each sequence has its own audio file, cut to its length:

.. code-block:: text

    SOURCE/
        edge_aistpp/
            motions/gBR_sBM_cAll_d04_mBR2_ch08.pkl
            wavs/gBR_sBM_cAll_d04_mBR2_ch08.wav

SOURCE may be the folder that contains ``motions/`` or its parent. A sequence with both kinds of music uses its own
file. Facts (tempos, split rule, ignore list, copies) are in ``manifests/aistpp.yaml``.
"""

from dancedata.datasets.aistpp.reader import AistPP

__all__ = ["AistPP"]
