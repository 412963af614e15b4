"""The codebook that codes are numbers in."""

import re
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.text import shown

#: Types on disk: of real values, and of codes.
DType = Literal["float32", "float16", "int16", "int32", "uint8"]
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class Codebook:
    """The codebook of a field of codes."""

    # As a recipe's parameter: an unknown key is an error.
    __pydantic_config__: ClassVar[dict[str, str]] = {"extra": "forbid"}

    name: str
    sizes: tuple[int, ...]  # number of codes of each column, a level
    sha256: str = ""  # of its file; "" if unknown
    pad: int = -1  # code of rows without one

    def to_json(self) -> dict[str, Any]:
        """Return the entry in dataset.json."""
        return {"name": self.name, "sizes": list(self.sizes), "sha256": self.sha256, "pad": self.pad}

    def check(self, width: int, dtype: str) -> None:
        """Raise UsageError unless the codebook is one of `width` levels, whose codes and pad fit `dtype`."""
        limits = np.iinfo(dtype)
        problem = ""
        if not self.name or self.name != shown(self.name, 200):
            problem = "a codebook needs a name"
        elif len(self.sizes) != width or min(self.sizes, default=0) < 1:
            problem = (
                f"{len(self.sizes)} sizes {list(self.sizes)} for {width} columns; allowed: one above 0 per column"
            )
        elif max(self.sizes) - 1 > limits.max:
            problem = f"codes up to {max(self.sizes) - 1}; {dtype} holds {limits.max}"
        elif 0 <= self.pad < max(self.sizes) or not limits.min <= self.pad <= limits.max:
            problem = f"pad {self.pad} is a code, or does not fit {dtype}; allowed: -1, or with uint8 255"
        elif self.sha256 and not _SHA256.fullmatch(self.sha256):
            problem = f"sha256 {shown(self.sha256, 80)} is not 64 hexadecimal digits in lower case"
        if problem:
            raise UsageError(f"codebook: {problem}")
