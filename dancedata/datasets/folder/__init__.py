"""A folder of your own motion files and music, with a manifest or matching file names.

With a manifest, ``manifest.csv`` or ``manifest.jsonl``, whose paths lie below the source folder:

.. code-block:: text

    SOURCE/
        manifest.csv             motion,audio,split,genre,fps,up,unit
                                 takes/anna_01.bvh,songs/blue.flac,train,waltz,,,cm
                                 amass/anna_02_poses.npz,songs/blue.flac,test,waltz,,,
        takes/anna_01.bvh
        amass/anna_02_poses.npz
        songs/blue.flac

Without one, motion and music are matched by file name:

.. code-block:: text

    SOURCE/                      SOURCE/
        motions/NAME.npz             NAME.bvh
        music/NAME.wav               NAME.wav
        (or wavs/, audio/)

Words and events of clips: ``segments.csv`` or ``segments.jsonl`` and ``texts/NAME.txt`` in SOURCE, see
docs/guides/training.md#words.

Motion: ``.npz``, ``.npy``, ``.pkl`` in the layouts of AMASS, SMPL, SMPL-X, FineDance, Motion-X, HumanML3D and MDM
(`array_layouts`), joint positions (`positions`), and ``.bvh`` of any skeleton with the joints of a human body
(`formats.bvh.joint_names`). Frame rate, up axis and unit come from the manifest, else from the file or its format,
else from the recipe; they are never guessed unless the recipe asks for it. See docs/guides/own-captures.md.
"""

from dancedata.datasets.folder.reader import Folder

__all__ = ["Folder"]
