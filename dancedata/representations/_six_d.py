"""The layout that EDGE, Lodge and FineDance share: contacts 4, root translation 3, J joint rotations in 6D."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.columns import Columns, Role
from dancedata.core.rotations import Float64Array, matrix_from_6d, rotation_6d
from dancedata.core.skeleton import Skeleton
from dancedata.representations import _columns as parts

#: Behaviour of the layout's columns under a turn or a shift.
ROLES: Mapping[str, Role] = MappingProxyType(
    {"contact": "unchanged", "translation": "place", "rotation_6d": "root_rotation"}
)


@dataclass(frozen=True)
class SixD:
    """Contacts 4, root translation 3, J x 6D (two rows, Zhou et al. 2019) of a skeleton; `name`, for messages."""

    name: str
    skeleton: Skeleton

    @property
    def width(self) -> int:
        """Number of columns."""
        return 7 + 6 * self.skeleton.n_joints

    @property
    def columns(self) -> Columns:
        """The columns and their mirror."""
        return parts.columns_of(
            parts.contacts(self.skeleton), parts.translation(), parts.rotations(self.skeleton, n_rows=2)
        )

    def pack(
        self, labels: npt.NDArray[np.float32], translation: Float64Array, matrices: Float64Array
    ) -> npt.NDArray[np.float32]:
        """Lay out contacts (T, 4), translation (T, 3) and matrices (T, J, 3, 3) as (T, D)."""
        out = np.empty((len(matrices), self.width), dtype=np.float32)
        out[:, :4] = labels
        out[:, 4:7] = translation
        out[:, 7:] = rotation_6d(matrices).reshape(len(matrices), -1)
        return out

    def unpack(self, array: npt.NDArray[Any]) -> tuple[Float64Array, Float64Array]:
        """Return translation (T, 3) and matrices (T, J, 3, 3) of columns; DataError "nan" or "bad_rotation"."""
        numbers = parts.checked(array, self.width, self.name, first=4)
        rows = numbers[:, 3:].reshape(len(numbers), self.skeleton.n_joints, 6)
        parts.refuse_rotations(
            np.linalg.norm(np.cross(rows[..., :3], rows[..., 3:]), axis=-1) < 1e-6,
            rows,
            "not a valid 6D rotation: its two rows do not span a plane",
            "decode columns that are not normalised: call the normaliser's unnormalize first",
            self.name,
            self.skeleton,
        )
        return numbers[:, :3], matrix_from_6d(rows)
