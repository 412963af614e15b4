"""Small datasets to export, built once: EDGE's in both scopes, two at 60 frames per second, one of FineDance."""

import io
import shutil
import wave
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import dancedata
from dancedata.audio.bailando438 import Bailando438
from dancedata.core.registry import DATASETS
from dancedata.exports.base.run import ExportResult
from dancedata.synthetic import write_synthetic
from tests.features import bailando438_rows

AIST = {"recipe": 1, "dataset": {"aist++": {}}, "windows": {"length_s": 5, "stride_s": 0.5}}
RECIPES: dict[str, dict[str, Any]] = {
    "edge": {**AIST, "motion": {"edge151": {}}, "audio": {"librosa35": {}}},
    "edge-exact": {
        **AIST, "transforms": ["slices"],
        "motion": {"edge151": {}}, "audio": {"librosa35": {}},
    },
    "sixty": {**AIST, "fps": 60, "motion": {"fact219": {}, "bailando72": {}}, "audio": {"librosa35": {}}},
    "bailando": {**AIST, "fps": 60, "motion": {"fact219": {}, "bailando72": {}}, "audio": {"bailando438": {}}},
    "finedance": {
        **AIST, "dataset": {"finedance": {}}, "motion": {"lodge139": {}, "lodge319": {}, "finedance319": {}},
        "audio": {"librosa35": {}},
    },
}  # fmt: skip


@dataclass(frozen=True)
class Built:
    """A dataset and its source."""

    path: Path
    source: Path

    @property
    def store(self) -> Any:
        return dancedata.open(self.path)


@pytest.fixture(scope="session")
def sources(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Sources that nothing writes into: six seconds of four clips to two songs, and FineDance's example."""
    folder = tmp_path_factory.mktemp("sources")
    DATASETS.get("finedance")().make_example(folder / "finedance")
    return {
        "aist++": write_synthetic(folder / "aist", songs=2, clips_per_song=2, clip_s=6),
        "finedance": folder / "finedance",
    }


@pytest.fixture(scope="session")
def built(sources: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Built]:
    """Return a function that builds one of `RECIPES`, once."""
    cache, stores = tmp_path_factory.mktemp("cache"), {}

    def of(name: str, source: Path | None = None, **keys: Any) -> Built:
        label = f"{name} {source} {keys}"
        if label not in stores:
            recipe = {**RECIPES[name], **keys, "name": name}
            folder_of = source or sources[next(iter(recipe["dataset"]))]
            out = tmp_path_factory.mktemp("exports") / name  # the same in messages, whatever was built before
            dancedata.build(recipe, folder_of, out, jobs=1, cache=cache, progress=False)
            stores[label] = Built(out, folder_of)
        return stores[label]

    return of


@pytest.fixture
def aist(sources: dict[str, Path], tmp_path: Path) -> Callable[..., Path]:
    """Return a function that copies the source of AIST++, with other splits, other music or other motion files.

    `songs` makes the sound of one song of another: its name and bytes to those of the copy. `splits` has the ids
    of each split. `named` has a sequence of the source for each further id.
    """

    def copy(*, songs=None, splits=None, named=None):
        source, out = sources["aist++"], tmp_path / "aist"
        shutil.copytree(source, out)
        for path in sorted((out / "wavs").iterdir()) if songs else ():
            sounds = songs(path.stem, path.read_bytes())
            path.unlink()
            for name, sound in sounds.items():
                (out / "wavs" / f"{name}.wav").write_bytes(sound)
        for split, ids in (splits or {}).items():
            (out / "splits" / f"crossmodal_{split}.txt").write_text("".join(f"{one}\n" for one in ids))
        for name, of in (named or {}).items():
            shutil.copyfile(out / "motions" / f"{of}.pkl", out / "motions" / f"{name}.pkl")
        return out

    return copy


def cut(wav: bytes, seconds: float, first: float = 0) -> bytes:
    """Return some seconds of a wav."""
    out = io.BytesIO()
    with wave.open(io.BytesIO(wav)) as file, wave.open(out, "wb") as part:
        part.setparams(file.getparams())
        file.setpos(int(first * file.getframerate()))
        part.writeframes(file.readframes(int(seconds * file.getframerate())))
    return out.getvalue()


@pytest.fixture
def export(tmp_path: Path, built: Callable[[str], Built]) -> Callable[..., ExportResult]:
    """Return a function that exports one of `RECIPES` to a folder of the test."""

    def run(name: str, to: str, out: str = "out", **options: Any) -> ExportResult:
        dataset = built(name)
        return dancedata.export(dataset.path, to, tmp_path / out, progress=False, **options)

    return run


@pytest.fixture(scope="module")
def quick_bailando438() -> Iterator[None]:
    """Rows that take no time; tests/audio has the columns."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Bailando438, "extract", bailando438_rows)
        yield
