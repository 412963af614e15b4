"""GCD's 151 columns."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from dancedata.core.bodies import transfer
from dancedata.core.columns import Columns, Spatial
from dancedata.core.errors import UsageError
from dancedata.core.grid import FrameGrid
from dancedata.core.motion import Motion
from dancedata.core.plugins import ContactRule, Representation
from dancedata.core.registry import REPRESENTATIONS
from dancedata.core.rotations import rotvec_from_matrix
from dancedata.core.skeleton import SMPL24, Skeleton
from dancedata.core.typing import override
from dancedata.representations import _columns as parts
from dancedata.representations._six_d import ROLES, SixD

_LAYOUT = SixD("gcd151", SMPL24)
_CONTACTS = 4
#: Bone offsets of GCD's kinematics, of the neutral SMPL body, metres; the pelvis is at the translation itself.
_OFFSETS = np.array(
    (
        (0.0, 0.0, 0.0),
        (0.06951974, -0.09140623, -0.00681534),
        (-0.06767048, -0.09052168, -0.00431982),
        (-0.00253286, 0.10896323, -0.02669631),
        (0.03427655, -0.3751986, -0.0044958),
        (-0.03829005, -0.38256901, -0.00885003),
        (0.00548703, 0.13518043, 0.00109247),
        (-0.0135957, -0.39796036, -0.04369333),
        (0.01577377, -0.39841465, -0.0423118),
        (0.001457, 0.05292223, 0.02542457),
        (0.02635814, -0.05579088, 0.1192884),
        (-0.02537175, -0.04814396, 0.12334795),
        (-0.00277839, 0.21387036, -0.04285703),
        (0.07884474, 0.1217493, -0.03408961),
        (-0.08175919, 0.11883283, -0.03861529),
        (0.00515184, 0.06496961, 0.05134897),
        (0.09097693, 0.0304689, -0.00886815),
        (-0.09601238, 0.03255117, -0.00914307),
        (0.25961225, -0.01277206, -0.02745644),
        (-0.25374196, -0.01332922, -0.02140098),
        (0.24923363, 0.00898603, -0.00117092),
        (-0.25529808, 0.00777229, -0.00555919),
        (0.08404218, -0.00816154, -0.01494537),
        (-0.08462193, -0.00611726, -0.01031508),
    )
)
#: The body behind GCD's contacts.
SMPL24_GCD = Skeleton("smpl24-gcd", SMPL24.joints, SMPL24.parents, _OFFSETS, SMPL24.pairs, SMPL24.feet)


@REPRESENTATIONS.register("gcd151")
@dataclass(frozen=True)
class Gcd151(Representation):
    """Root translation 3, 24 joint rotations in 6D, contacts 4 last; +Y up (GCD, Le et al. 2023).

    The columns of a dancer of AIOZ-GDANCE in GCD, and in ST-GDance. EDGE's 151 columns (`edge151`) have the contacts
    first and +Z up, as TCDiff does. The contacts are those of GCD's neutral bones, with the pelvis at the
    translation. 6D is the first two rows of each matrix. Mirroring reflects across the plane x = 0.
    """

    default_contacts: ClassVar[str | None] = "velocity"
    skeleton: ClassVar[Skeleton] = SMPL24
    columns: ClassVar[Columns] = parts.columns_of(
        parts.translation(), parts.rotations(SMPL24, n_rows=2), parts.contacts(SMPL24)
    )
    axes: ClassVar[str] = "right-handed, +Y up, metres"
    spatial: ClassVar[Spatial | None] = Spatial("y", ROLES)

    @override
    def encode(self, motion: Motion, contacts: ContactRule | None = None) -> npt.NDArray[np.float32]:
        rule = parts.required_rule(contacts, _LAYOUT.name)
        motion = transfer(motion, self.skeleton)
        labels = rule(motion.joints(SMPL24_GCD), motion.grid, SMPL24_GCD)
        return np.roll(_LAYOUT.pack(labels, motion.translation, motion.matrices), -_CONTACTS, axis=1)

    @override
    def decode(self, array: npt.NDArray[Any], grid: FrameGrid) -> Motion:
        if np.ndim(array) != 2:
            raise UsageError(f"{_LAYOUT.name} decodes (T, {_LAYOUT.width})", found=f"shape {np.shape(array)}")
        translation, matrices = _LAYOUT.unpack(np.roll(array, _CONTACTS, axis=1))
        return Motion(translation, rotvec_from_matrix(matrices), grid, self.skeleton)
