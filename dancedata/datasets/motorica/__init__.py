"""Motorica Dance (Alexanderson et al. 2023): motion capture of eight genres, 6 hours, 120 FPS.

.. code-block:: text

    SOURCE/
        bvh/NAME.bvh      one recording: centimetres, +Y up, degrees, fingers
        label_segment/NAME_<i>.txt, sliced_labels/NAME_chunk<k>_label.json      Motorica++, if wanted (`labels`)
        wav/NAME.wav      its music, under the same name, here or beside the motion; some recordings have none

LDA's features are not read.
"""

from dancedata.datasets.motorica.reader import Motorica

__all__ = ["Motorica"]
