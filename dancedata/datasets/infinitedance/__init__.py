"""InfiniteDance (2026): fits of dances in videos, 30 FPS, and columns of these and of three other datasets; no audio.

.. code-block:: text

    SOURCE/                                                    InfiniteDanceData, or the folder with it
        dance/infinitedance_smplx_smooth/NAME.pkl              joblib: body_pose (T, 63), global_orient, transl
        dance/alldata_new_joint_vecs264_ft_balanced/NAME.npy   (T, 264) columns, also of AIST++, FineDance, Motorica
        dance/test_eval861_joint_vecs264/NAME.npy              (T, 264) columns of test clips
        dance/Infinite_MotionTokens_512x1024_3layer_cleandata/NAME.npy   (3 N,) tokens, three for 4 frames
        music/muq_features/test_infinitedance/NAME.npy         (R, 1024), 25 rows per second
        music/musicfeature_55_allmusic_pure/NAME.npy           (T, 55), 30 rows per second
        partition/*.txt                                        names, one per line
        styles/all_style_map.json, styles/NAME.json            styles of clips
"""

from dancedata.datasets.infinitedance.reader import InfiniteDance

__all__ = ["InfiniteDance"]
