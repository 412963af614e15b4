"""A small demo with its source, the same in slices, and datasets with names that others made."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dancedata
from dancedata.core.clip import Reject
from dancedata.pages import Report, write_report
from dancedata.pages.document import Document
from dancedata.store import Store, StoredClip, open_store
from dancedata.store.schema import StoreHeader
from dancedata.store.stored_clip import AudioBlock
from dancedata.store.writer import write_store
from tests.conftest import Once

SMALL = {"dataset.synthetic": {"songs": 4, "clips_per_song": 2, "clip_s": 6}}
#: Names that would be markup, script, addresses or misleading text.
HOSTILE = [
    "<script>window.PWN=1</script>",
    "\"><img src=x onerror='window.PWN=1'>",
    "a&b=c#d%20%3Cscript%3E",
    "safe\u202egnp.exe",
    "</template></script><script>window.PWN=1</script>",
    "'quotes\" and spaces",
]


def _build(folder: Path, **overrides: Any) -> None:
    options = {"jobs": 1, "cache": folder / "cache", "progress": False}
    dancedata.build("demo", out=folder / "demo", overrides={**SMALL, **overrides}, **options)


@pytest.fixture(scope="session")
def demo(once: Once) -> Path:
    """Eight clips of six seconds; the folder demo-source next to it has the music."""
    return once("report", _build) / "demo"


@pytest.fixture(scope="session")
def report(demo: Path) -> Report:
    """The demo's report, which is not written."""
    return write_report(demo)


@pytest.fixture(scope="session")
def demo_page(demo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of it, with its clips."""
    return write_report(demo, tmp_path_factory.mktemp("page") / "demo.html").path


@pytest.fixture
def numbers(report: Report) -> Document:
    return report.numbers


@pytest.fixture
def document(report: Report) -> Any:
    return report.document


@pytest.fixture(scope="session")
def slices(once: Once) -> Path:
    """The same in slices."""
    return once("report-slices", lambda folder: _build(folder, transforms=["slices"])) / "demo"


Relabel = Callable[..., Path]


@pytest.fixture
def relabelled(demo: Path, tmp_path: Path) -> Relabel:
    """Write the demo's motion and music under other names."""

    def make(names: Callable[[int], Mapping[str, Any]], meta: Mapping[str, Any] | None = None, **writer: Any) -> Path:
        out = tmp_path / "relabelled"
        out.mkdir()
        with open_store(demo) as store:
            clips = [replace(_stored(store, k), **names(k)) for k in range(len(store))]
            kept = ("name", "licence", "citation", "recipe", "versions", "source")
            about = {**{key: store.info[key] for key in kept if key in store.info}, **(meta or {})}
            length, stride = store.info["windows"]["length"], store.info["windows"]["stride"]
            fields = tuple(store.field(name) for name in store.fields)
            header = StoreHeader(store.grid.rate, length, stride, fields, store.skeleton, meta=about)
            write_store(out, header, clips, **writer)
        return out

    return make


def _stored(store: Store, number: int) -> StoredClip:
    clip = store.clips()[number]
    starts = tuple(w.start for w in store.windows(clip.split) if w.clip == clip.id)
    audio = {"librosa35": AudioBlock(clip.music, np.asarray(clip.read_song("librosa35")))}
    return StoredClip(**vars(clip.record), starts=starts, motion={"edge151": clip.read("edge151")}, audio=audio)


@pytest.fixture
def hostile(relabelled: Relabel) -> Path:
    """Ids, songs, genres, dancers, the name, the licence and rejects are hostile."""

    def names(k: int) -> dict[str, Any]:
        name = HOSTILE[k % len(HOSTILE)]
        return {"id": f"{name}{k}", "genre": name, "dancer": name, "music": f"{name}{k}", "n_flags": 1}

    meta = {"name": HOSTILE[0], "licence": HOSTILE[1], "citation": HOSTILE[4]}
    quality = [
        {"clip": f"{HOSTILE[k % 6]}{k}", "kind": HOSTILE[0], "joint": HOSTILE[4], "frame": 3, "rate": "60",
         "value": 1.0, "unit": HOSTILE[1]}
        for k in range(8)
    ]  # fmt: skip
    rejects = [Reject(HOSTILE[0], clip=HOSTILE[4], detail=HOSTILE[1])]
    return relabelled(names, meta, quality=quality, rejects=rejects)
