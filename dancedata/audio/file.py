"""Rows of music that were computed elsewhere, from an .npy file of each clip or song."""

import re
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path, PurePosixPath
from string import Formatter
from typing import Any, ClassVar, Literal, Self, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from dancedata.core.clip import ClipRef
from dancedata.core.codebook import Codebook, DType
from dancedata.core.columns import Columns, Group
from dancedata.core.errors import DataError, UsageError
from dancedata.core.grid import FrameGrid, Number, as_fraction, as_rate
from dancedata.core.plugins import FileFeature, FileSpan
from dancedata.core.registry import FEATURES
from dancedata.core.text import quoted
from dancedata.core.typing import override
from dancedata.formats.arrays import npy_header, read_npy

#: What a pattern may name, and must name one of.
_NAMES = ("clip", "music", "group", "split")
#: Jukebox has 4,800 columns.
_MAX_COLUMNS = 1 << 16
#: A name that is a folder, or leaves the source, is not a name.
_NAME = re.compile(r"[^/\\\0]+")


@FEATURES.register("file")
@dataclass(frozen=True)
class FileRows(FileFeature):
    """Rows from files below the source, cut and resampled to the clip; needs no music.

    Row k of a file lasts from k / rate to (k + 1) / rate seconds after row 0. Nothing is padded: a window that
    reaches beyond the rows is left out.

    Attributes
    ----------
    path
        Pattern of the .npy files below the source: "music/muq/{clip}.npy". {clip}, {music}, {group} and {split} are
        the clip's.
    rate
        Rows per second of the files, exactly, such as 25 or "15/2"; a recipe must state it.
    columns_per_row
        Width of the files; a recipe must state it.
    tolerance_s
        Most seconds by which a file may be longer or shorter than its clip's motion. Others set the clip aside. None:
        lengths are not compared, for files of whole songs.
    dtype
        Type on disk: float32 or float16; for codes int16, int32 or uint8. Files have numbers with a point, of any
        size; those of codes whole ones.
    begins
        What `origin_s` counts from: "music", its second 0, which is frame 0 unless a clip states another
        `audio_start`; or "clip", frame 0.
    origin_s
        Second at which row 0 begins.
    resample
        How rows get the field's rate: "none", they have it; "nearest", the row nearest in time, of two the later;
        "linear", between rows.
    codebook
        Name, sizes, sha256 and pad of the codebook of codes, one size per column; None for real values. A flat file
        of codes has the columns of a row one after another.
    first_codes
        What the files have for code 0 of each column. Default: 0. InfiniteDance's third level counts from 5120.
    of
        What rows describe: "music", or "motion", the dancer. Those of motion are among the fields of motion,
        from frame 0 to the last frame, and have no mirror image.
    """

    packages: ClassVar[tuple[str, ...]] = ("numpy",)
    uses_tempo: ClassVar[bool] = False

    path: str = "features/{clip}.npy"
    rate: Number = 0
    columns_per_row: int = 0
    tolerance_s: Number | None = "1/10"
    dtype: DType = "float32"
    begins: Literal["music", "clip"] = "music"
    origin_s: Number = 0
    resample: Literal["none", "nearest", "linear"] = "none"
    codebook: Codebook | None = None
    first_codes: tuple[int, ...] = ()
    of: Literal["music", "motion"] = "music"

    def __post_init__(self) -> None:
        # As text, so that 25, 25.0 and "25" are one recipe.
        object.__setattr__(self, "rate", str(as_rate(self.rate) if self.rate not in (0, "0") else 0))
        object.__setattr__(self, "origin_s", str(as_fraction(self.origin_s, "origin_s")))
        if self.tolerance_s is not None:
            tolerance = as_fraction(self.tolerance_s, "tolerance_s")
            if tolerance < 0:
                raise UsageError("file: tolerance_s is below 0", found=str(self.tolerance_s))
            object.__setattr__(self, "tolerance_s", str(tolerance))
        if not 0 <= self.columns_per_row <= _MAX_COLUMNS:
            allowed = f"1 to {_MAX_COLUMNS:,}"
            raise UsageError("file: columns_per_row is out of range", found=self.columns_per_row, allowed=allowed)
        types = get_type_hints(FileRows)
        for name in ("dtype", "begins", "resample", "of"):
            values = get_args(types[name])
            if getattr(self, name) not in values:
                raise UsageError(
                    f"file: invalid {name}", found=quoted(getattr(self, name)), allowed=" or ".join(values)
                )
        self._check_pattern()
        self._check_codes()
        if self.of == "motion" and (self.begins, self.origin_s) != ("clip", "0"):
            raise UsageError("file: rows of motion begin at frame 0 of their clip",
                             found=f"begins: {self.begins}, origin_s: {self.origin_s}",
                             fix="set begins: clip, and leave origin_s out")  # fmt: skip

    def _check_codes(self) -> None:
        is_code = self.dtype not in ("float32", "float16")
        if (self.codebook is not None) != is_code:
            found = f"dtype {self.dtype} " + ("without a codebook" if is_code else "with a codebook")
            fix = "such as dtype: int16, codebook: {name: vq, sizes: [512]}; real values have neither"
            raise UsageError("file: codes need a type of whole numbers and a codebook", found=found, fix=fix)
        if self.codebook is None:
            if self.first_codes:
                raise UsageError("file: first_codes needs a codebook", fix="name it, or omit first_codes")
            return
        self.codebook.check(self.columns_per_row, self.dtype)
        if self.resample == "linear":
            raise UsageError("file: codes cannot be averaged", found="resample: linear", fix="set resample: nearest")
        if len(self.first_codes) not in (0, self.columns_per_row):
            allowed = f"{self.columns_per_row} numbers, one per column, or none"
            raise UsageError(
                "file: first_codes has the wrong length", found=str(list(self.first_codes)), allowed=allowed
            )

    def _check_pattern(self) -> None:
        try:
            parts = list(Formatter().parse(self.path))
        except ValueError:
            parts = [("", "?", None, None)]
        fields = [field for _, field, *_ in parts if field is not None]
        plain = all(not spec and not conversion for _, _, spec, conversion in parts)
        place = PurePosixPath(self.path)
        if (
            not plain
            or not {"clip", "music", "group"} & set(fields)
            or not set(fields) <= set(_NAMES)
            or place.is_absolute()
            or ".." in place.parts
            or place.suffix.lower() != ".npy"
        ):
            raise UsageError(
                "file: path is not a pattern of files below the source",
                found=quoted(self.path),
                allowed="a path below the source that ends in .npy and names {clip}, {music} or {group}; "
                "{split} beside it",
                fix='such as path: "music/muq/{clip}.npy"',
            )

    @property
    @override
    def columns(self) -> Columns:
        return Columns((Group("features" if self.codebook is None else "code", self.columns_per_row, "1"),))

    @property
    @override
    def of_motion(self) -> bool:
        return self.of == "motion"

    @override
    def n_rows(self, n_samples: int, sample_rate: int, grid: FrameGrid) -> int:
        """Return the rows of a file that is as long as a signal."""
        self.require_grid(grid)
        return FrameGrid.of(sample_rate).rows_down(n_samples, of=grid)

    def require_grid(self, grid: FrameGrid) -> None:
        """Raise UsageError if rate or width are not stated, or not how rows are resampled to a grid."""
        missing = [name for name in ("rate", "columns_per_row") if getattr(self, name) in (0, "0")]
        if missing:
            raise UsageError(
                f"file: {' and '.join(missing)} of the files must be stated",
                where=self.path,
                fix="neither is guessed: numpy.load(FILE).shape has the rows and columns of a file",
            )
        if self.resample == "none" and grid != self.grid:
            raise UsageError(
                "the rate of the files differs from that of the field",
                found=f"rows at {self.rate} per second, the field at {grid}",
                fix=f'set fps: "{self.rate}" for this field, or resample: nearest or linear',
            )

    @property
    @override
    def hashed_keys(self) -> dict[str, Any]:
        codes = None if self.codebook is None else [self.codebook.to_json(), list(self.first_codes)]
        return {"rate": self.rate, "resample": self.resample, "dtype": self.dtype, "codes": codes}

    @property
    @override
    def grid(self) -> FrameGrid:
        return FrameGrid.of(self.rate)

    @classmethod
    @override
    def make_example(cls, folder: Path) -> Self:
        """Return the feature on a file that is written into the folder: clip "example", 50 rows of 3 columns."""
        np.save(folder / "example.npy", np.arange(150, dtype=np.float32).reshape(50, 3))
        return cls("{clip}.npy", 25, 3, None)

    @override
    def file_of(self, ref: ClipRef, source: Path) -> Path | None:
        names = {"clip": ref.id, "music": ref.music, "group": ref.group, "split": ref.split}
        used = {field for _, field, *_ in Formatter().parse(self.path) if field is not None}
        if any(not _NAME.fullmatch(names[name]) or names[name] in (".", "..") for name in used):
            return None
        return source / self.path.format(**names)

    def length(self, path: Path) -> int:
        """Return the number of rows of a file of stated rate and width, from its header.

        Raises DataError: As `open_arrays`; "bad_shape" for another width, "bad_dtype" for whole numbers that are
            not codes, or codes that are not, "empty".
        """
        header = npy_header(path)
        shape, dtype = header.shape, header.dtype
        is_code = self.codebook is not None
        if is_code and len(shape) == 1:
            if shape[0] % self.columns_per_row:
                raise DataError("the codes of the file do not fill its last row", reason="bad_shape", where=str(path),
                                found=f"{shape[0]} codes",
                                allowed=f"a multiple of {self.columns_per_row}, the codes of a row")  # fmt: skip
            shape = shape[0] // self.columns_per_row, self.columns_per_row
        if len(shape) != 2 or shape[1] != self.columns_per_row:
            raise DataError("the file of features has the wrong shape", reason="bad_shape", where=str(path),
                            found=str(shape),
                            allowed=f"(rows, {self.columns_per_row}), as columns_per_row says")  # fmt: skip
        if is_code and dtype.kind not in "iu":
            raise DataError("the file of codes does not hold whole numbers", reason="bad_dtype", where=str(path),
                            found=str(dtype), allowed="a type of whole numbers")  # fmt: skip
        if not is_code and dtype.kind != "f":
            raise DataError("the file of features holds whole numbers", reason="bad_dtype", where=str(path),
                            found=str(dtype),
                            allowed="float16, float32 or float64; codes need a codebook")  # fmt: skip
        if not shape[0]:
            raise DataError("the file of features has no rows", reason="empty", where=str(path))
        return shape[0]

    @override
    def begin_s(self, audio_start: Fraction) -> Fraction:
        origin = as_fraction(self.origin_s, "origin_s")
        return origin - audio_start if self.begins == "music" else origin

    def placed(self, n_rows: int, begin_s: Fraction, grid: FrameGrid) -> FileSpan:
        """Place a file of `n_rows` rows, of which row 0 is at second `begin_s` of the clip, on the clip's grid.

        Raises DataError: "between_rows": with resample: none, frame 0 must be at a row.
        """
        self.require_grid(grid)
        start = begin_s * grid.rate
        first = -((-start.numerator) // start.denominator)
        if self.resample == "none" and start.denominator != 1:
            raise DataError("frame 0 of the clip lies between two rows", reason="between_rows",
                            found=f"row 0 at {float(begin_s):.6g} s of the clip, {self.rate} rows per second",
                            fix="set resample: nearest or linear")  # fmt: skip
        step = as_rate(self.rate) / grid.rate
        phase = (first - start) * step
        inside = (n_rows - phase) / step
        return FileSpan(first, max(0, -((-inside.numerator) // inside.denominator)), phase, step)

    def rows(self, path: Path, placed: FileSpan) -> NDArray[Any]:
        """Return the (placed.n_rows, D) rows of a file on a clip's grid, in `dtype`.

        Raises DataError: As `length`; "nan" for values that are not finite, or do not fit into `dtype`; "bad_code".
        """
        self.length(path)
        values = read_npy(path)
        if self.codebook is not None:
            values = self._codes(path, values.reshape(-1, self.columns_per_row), self.codebook)
        with np.errstate(over="ignore"):
            finite = np.isfinite(values.astype(self.dtype))
        if not finite.all():
            row, column = (int(k) for k in np.argwhere(~finite)[0])
            raise DataError(f"the file of features has values that {self.dtype} cannot hold", reason="nan",
                            where=f"{path}, row {row}, column {column}",
                            found=f"{values[row, column]}; {int((~finite).any(axis=1).sum())} of {len(values)} rows",
                            allowed=f"finite numbers within the range of {self.dtype}")  # fmt: skip
        # Whole numbers: float time would put rows beside their places in long songs.
        scale = placed.phase.denominator * placed.step.denominator
        phase, step = int(placed.phase * scale), int(placed.step * scale)
        places = [divmod(phase + k * step, scale) for k in range(placed.n_rows)]
        last = len(values) - 1
        if self.resample == "linear":
            before = np.array([min(k, last) for k, _ in places], np.int64)
            weight = np.array([rest / scale for _, rest in places])[:, None]
            low, high = values[before].astype(np.float64), values[np.minimum(before + 1, last)].astype(np.float64)
            return (low + weight * (high - low)).astype(self.dtype)
        nearest = np.array([min(k + (2 * rest >= scale), last) for k, rest in places], np.int64)
        return values[nearest].astype(self.dtype)

    def _codes(self, path: Path, values: NDArray[Any], codebook: Codebook) -> NDArray[Any]:
        """Return codes from 0 on; DataError for one that the codebook does not have."""
        first = np.array(self.first_codes or (0,) * self.columns_per_row, np.int64)
        sizes, is_pad = np.array(codebook.sizes, np.int64), values == codebook.pad
        bad = ~is_pad & ((values < first) | (values >= first + sizes))
        if bad.any():
            row, column = (int(k) for k in np.argwhere(bad)[0])
            raise DataError(
                "a code is not in its codebook",
                reason="bad_code",
                where=f"{path}, row {row}, column {column}",
                found=f"{values[row, column]}; {int(bad.any(axis=1).sum())} of {len(values)} rows",
                allowed=f"{first[column]} to {first[column] + sizes[column] - 1}, or {codebook.pad} for none",
                fix="check first_codes and the codebook's sizes",
            )
        return np.where(is_pad, codebook.pad, values.astype(np.int64) - first)
