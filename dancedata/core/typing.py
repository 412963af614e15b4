"""``override`` for every supported Python: before 3.12 only type checkers act on it."""

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import override
elif sys.version_info >= (3, 12):
    from typing import override
else:

    def override(method):
        """Return the method unchanged."""
        return method


__all__ = ["override"]
