"""Rows that were computed elsewhere, from a file of each clip or song."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from dancedata.building.fields.music import FeatureField
from dancedata.building.inputs import RowsFile
from dancedata.building.plugins import Ask, Reach
from dancedata.building.result import Rows
from dancedata.building.rows import PlacedRows
from dancedata.building.take import Take, Time
from dancedata.core.clip import ClipRef, Reject
from dancedata.core.errors import DataError
from dancedata.core.grid import FrameGrid
from dancedata.core.plugins import FileFeature, FileSpan
from dancedata.core.rejects import reject_of, reject_on_error
from dancedata.core.typing import override
from dancedata.execution.cache import Cache

if TYPE_CHECKING:
    from dancedata.store.stored_clip import AudioBlock

#: Raised by hand when the stage gives other numbers for the same input.
_STAGE = 1


@dataclass(frozen=True)
class FileField(FeatureField):
    """Rows from a file, cut and resampled to the take."""

    from_files = True
    unit = "files"

    @property
    @override
    def sha256(self) -> str:
        return self._key("", FileSpan(0, 0, Fraction(0), Fraction(1)))

    feature: FileFeature

    @override
    def block(self, rows: Rows, take: Take, dancer: int, grid: FrameGrid) -> PlacedRows | AudioBlock:
        from dancedata.store.stored_clip import AudioBlock  # workers need no h5py

        if self.kind == "audio":
            return AudioBlock(rows.key, rows.array, rows.offset)
        return PlacedRows(rows.array, rows.offset, take.time.frames_on(grid), grid, self)

    @override
    def asks(self, take: Take) -> Sequence[Ask]:
        asks = []
        for k, dancer in enumerate(take.dancers):
            file, placed = dancer.files[self.name], self._placed(take, k)
            first = placed.first - self._first(take)
            asks.append(Ask(file, self._key(file.sha256, placed), placed, -first))
        return asks

    @override
    def with_path(self, ref: ClipRef, source: Path) -> ClipRef:
        path = self.feature.file_of(ref, source)
        return ref if path is None else replace(ref, feature_paths=(*ref.feature_paths, (self.name, path)))

    @override
    def file_of(self, cache: Cache, ref: ClipRef, hash_file: Callable[[Cache, Path], str]) -> RowsFile | Reject:
        path = dict(ref.feature_paths).get(self.name)
        if path is None or not path.is_file():
            what = f"no file {path}" if path is not None else f"the clip has no name for {self.feature.path}"
            fix = f"set audio.{self.name}.path, which is below the source, or leave the field out"
            return Reject("missing_feature", ref.id, str(path or ""), detail=f"field {self.name}: {what}", fix=fix)
        n_rows = reject_on_error(lambda: self.feature.length(path), path, ref.id)
        if isinstance(n_rows, Reject):
            return n_rows
        try:
            return RowsFile(path, hash_file(cache, path), n_rows)
        except OSError as error:
            return Reject("broken_file", ref.id, str(path), detail=f"{path}: {error}")

    @override
    def n_rows(self, take: Take, dancer: int) -> int:
        return self._placed(take, dancer).n_rows

    @override
    def reach(self, take: Take, dancer: int, grid: FrameGrid) -> Reach | Reject:
        file = take.dancers[dancer].files[self.name]
        wrong = self._wrong_length(take, dancer, grid)
        if wrong is not None:
            return wrong
        try:
            placed = self._placed(take, dancer)
        except DataError as error:
            return reject_of(error, file=file.path)
        row = placed.first - self._first(take)
        first, end = max(0, self.grid.rows_up(row, of=grid)), self.grid.rows_down(row + placed.n_rows, of=grid)
        detail = f"the files of {self.name} reach from frame {first} to {end}"
        short = f"{detail}: no window of the clip lies within"
        return Reach(first, end, "no_audio", "short_feature", f"is beyond: {detail}", short)

    @override
    def make(self, loaded: Any, parts: Sequence[Any]) -> Sequence[npt.NDArray[Any]]:
        try:
            return [self.feature.rows(loaded, placed) for placed in parts]
        except OSError as error:
            raise DataError(
                "the file cannot be read", reason="broken_file", where=loaded, found=str(error)
            ) from error

    def _key(self, sha256: str, placed: FileSpan) -> str:
        """Return the key of a file's rows in a place: of its content, not its name."""
        feature = self.feature
        return Cache.key(
            "feature file",
            version=[_STAGE, feature.version],
            file=sha256,
            fps=str(self.grid),
            phase=str(placed.phase),
            **feature.hashed_keys,
        )

    def _placed(self, take: Take, dancer: int) -> FileSpan:
        of = take.dancers[dancer]
        begin_s = self.feature.begin_s(of.music.start - take.time.begin)
        return self.feature.placed(of.files[self.name].n_rows, begin_s, self.grid)

    def _first(self, take: Take) -> int:
        """Return the row at frame 0, counted from that of the whole motion."""
        return take.time.grid.rows(take.time.first, of=self.grid)

    def _wrong_length(self, take: Take, dancer: int, grid: FrameGrid) -> Reject | None:
        """Return why a file is not of this motion, by their lengths."""
        feature, file, time = self.feature, take.dancers[dancer].files[self.name], take.time.whole
        file_s, tolerance = feature.grid.seconds(file.n_rows), feature.tolerance_s
        is_short = self._is_short(take, dancer, time, grid)
        if not is_short and (tolerance is None or abs(file_s - time.seconds) <= Fraction(tolerance)):
            return None
        numbers = {"feature_s": round(float(file_s), 3), "motion_s": round(float(time.seconds), 3)}
        detail = f"field {self.name}: {file.path} has {file.n_rows} rows, {float(file_s):.3f} s; the motion has "
        detail += f"{float(time.seconds):.3f} s; the tolerance is {tolerance} s"
        detail += "; rows of motion last as long as it, or the field is of: music" if is_short else ""
        fix = f"check audio.{self.name}.rate; set tolerance_s if the difference is known, null for whole songs"
        return Reject("feature_length", file=str(file.path), detail=detail, numbers=numbers, fix=fix)

    def _is_short(self, take: Take, dancer: int, time: Time, grid: FrameGrid) -> bool:
        """Whether rows of motion do not reach into the last row of the take; codes end with the pad."""
        if not self.feature.of_motion or self.codebook is not None:
            return False
        try:
            placed = self._placed(take, dancer)
        except DataError:
            return False  # a problem by itself, reported where the place is read
        return grid.rows_down(time.frames_on(grid), of=self.grid) > placed.first + placed.n_rows
