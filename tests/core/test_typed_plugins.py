"""The type checker finds misspelt members where plug-ins are called, and wrong signatures in third-party plug-ins."""

import subprocess
import sys
from pathlib import Path
from typing import Any, get_type_hints

import pytest

import dancedata.cli.templates
from dancedata.building.fields.key_motion import KeyMotionField
from dancedata.building.fields.motion import RepresentationField
from dancedata.building.fields.music import FeatureField
from dancedata.building.transforms.copy import Copy
from dancedata.core.plugins import AudioFeature, Dataset, KeyMotionFinder, Representation
from dancedata.recipes.recipe import Recipe

# One misspelt member for each of five kinds, as the pipeline and exports would call them.
CODE = """
from pathlib import Path

import numpy as np

from dancedata.core.audio_signal import AudioSignal
from dancedata.building.fields.key_motion import KeyMotionField
from dancedata.core.motion import Motion
from dancedata.files.atomic_folder import AtomicFolder
from dancedata.exports.base.job import Export, ExportJob
from dancedata.recipes.recipe import Recipe


def use(
    recipe: Recipe, keys: KeyMotionField, signal: AudioSignal, motion: Motion, target: Export, job: ExportJob
) -> None:
    recipe.dataset.scann(Path("source"))
    recipe.audio[0].feature.extrakt(signal, recipe.grid)
    recipe.motion[0].representation.encod(motion)
    keys.finder.analyze(motion)
    target.lackz(job)
    recipe.dataset.scan(Path("source"))
    recipe.audio[0].feature.extract(signal, recipe.grid)
    target.write(job, AtomicFolder(job.out, job.out))
"""

# A feature of another package: the template unchanged, and with a signature and a class variable that do not fit.
TEMPLATE = (Path(dancedata.cli.templates.__file__).parent / "feature.py").read_text(encoding="utf-8")
WRONG = TEMPLATE.replace("sample_rate: int, grid: FrameGrid) -> int:", "sample_rate: int) -> int:").replace(
    "version: ClassVar[int] = 1", 'version: ClassVar[str] = "1"'
)


@pytest.mark.parametrize(
    ("owner", "name", "kind"),
    [
        (Recipe, "dataset", Dataset),
        (FeatureField, "feature", AudioFeature),
        (RepresentationField, "representation", Representation),
        (KeyMotionField, "finder", KeyMotionFinder),
    ],
)
def test_a_plug_in_is_declared_by_its_kind(owner: type[Any], name: str, kind: type[Any]) -> None:
    """Not as Any, with which every member would pass the type checker."""
    assert get_type_hints(owner, localns={"Copy": Copy})[name] is kind


# Up to a minute where mypy was not run before. By default: the declared types, above. .ci/run calls it after mypy.
@pytest.mark.nightly
def test_misspelt_calls_and_wrong_signatures_are_errors(tmp_path: Path) -> None:
    files = {"uses.py": CODE, "right_feature.py": TEMPLATE, "wrong_feature.py": WRONG}
    for name, code in files.items():
        (tmp_path / name).write_text(code, encoding="utf-8")
    root = Path(__file__).resolve().parents[2]
    # With what mypy knows of the package if it was run there before: that is most of the time.
    cache = root / ".mypy_cache"
    known = ["--cache-dir", str(cache if cache.is_dir() else tmp_path / "cache")]
    # In a separate process: mypy leaves millions of objects behind, which slow every later test down.
    command = [sys.executable, "-m", "mypy", "--config-file", str(root / "pyproject.toml"), *known, *files]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    out = run.stdout
    lines = [line for line in out.splitlines() if ": error:" in line]
    errors = {name: [line for line in lines if line.startswith(name)] for name in files}
    assert run.returncode == 1
    misspelt = [line.split('"')[3] for line in errors["uses.py"]]
    assert misspelt == ["scann", "extrakt", "encod", "analyze", "lackz"], out
    assert errors["right_feature.py"] == [], out
    wrong = " ".join(errors["wrong_feature.py"])
    assert 'base class "Plugin" defined the type as "int"' in wrong
    assert 'Signature of "n_rows" incompatible' in wrong
