"""Versions: what states them agrees, and the release script refuses what does not."""

import shutil
import subprocess
from pathlib import Path
from types import ModuleType

import pytest

from dancedata.core.version import __version__
from tests.docs.pages import ROOT, load

FILES = ("CHANGELOG.md", "CITATION.cff", "conda/recipe.yaml", "dancedata/core/version.py")


@pytest.fixture
def script() -> ModuleType:
    return load(ROOT / ".ci" / "release.py")


@pytest.fixture
def prepared(script: ModuleType, tmp_path: Path) -> Path:
    """A repository with the files of a release, prepared and committed as 9.1.0."""
    for name in FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "Files")
    script.prepare(tmp_path, "9.1.0", "2027-01-31")
    git(tmp_path, "commit", "-qam", "Release 9.1.0")
    return tmp_path


def git(folder: Path, *arguments: str) -> None:
    author = ("-c", "user.name=a", "-c", "user.email=a@example.org")
    subprocess.run(["git", *author, *arguments], cwd=folder, check=True, capture_output=True)


def refused(script: ModuleType, folder: Path, **changes: tuple[str, str]) -> list[str]:
    """Reasons after a text of a file is replaced; the change is committed."""
    for name, (before, after) in changes.items():
        path = folder / next(file for file in FILES if file.lower().split("/")[-1].startswith(name))
        text = path.read_text()
        assert before in text
        path.write_text(text.replace(before, after, 1))
    if changes:
        git(folder, "commit", "-qam", "Change")
    return list(script.refusals(folder))


def test_all_files_state_the_version(script: ModuleType) -> None:
    assert script.stated(ROOT) == dict.fromkeys(script.PLACES, __version__)


def test_what_is_prepared_is_not_refused(script: ModuleType, prepared: Path) -> None:
    assert refused(script, prepared) == []
    text = (prepared / "CHANGELOG.md").read_text()
    assert "## [Unreleased]\n\n## [9.1.0] - 2027-01-31\n\n" in text
    assert "\nversion: 9.1.0\ndate-released: 2027-01-31\n" in (prepared / "CITATION.cff").read_text()
    script.prepare(prepared, "9.2.0", "2027-02-28")
    assert (prepared / "CITATION.cff").read_text().count("date-released") == 1


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"citation": ("version: 9.1.0", "version: 9.1.1")}, "CITATION.cff states 9.1.1, dancedata/core/version"),
        ({"recipe": ('"9.1.0"', '"9.0.0"')}, "conda/recipe.yaml states 9.0.0, dancedata/core/version.py 9.1.0"),
        ({"changelog": ("[9.1.0]", "[9.2.0]")}, "the first headings of CHANGELOG.md are Unreleased, 9.2.0; expected"),
        ({"changelog": ("[Unreleased]\n", "[Unreleased]\n\n- New.\n")}, "CHANGELOG.md has entries under Unreleased"),
        ({"changelog": ("## [0.2.0]", "## [9.10.0]")}, "9.1.0 is not above the release before, 9.10.0"),
        ({"citation": ("2027-01-31", "2027-02-01")}, "dates of the release differ: CHANGELOG.md 2027-01-31"),
        ({"version": ("9.1.0", "9.1.0.dev0")}, "9.1.0.dev0 is a version in development"),
    ],
)  # fmt: skip
def test_a_mismatch_is_refused(script, prepared, changes, reason):
    assert any(reason in text for text in refused(script, prepared, **changes))


def test_a_dirty_tree_and_an_old_tag_are_refused(script: ModuleType, prepared: Path) -> None:
    git(prepared, "tag", "v9.1.0")
    (prepared / "CITATION.cff").write_text("version: 9.1.0\ndate-released: 2027-01-31\n")
    assert refused(script, prepared) == ["the working tree has changes: CITATION.cff", "the tag v9.1.0 exists"]
    for version in ("9.1.0", "9.0.9", "9.2"):
        with pytest.raises(SystemExit):
            script.prepare(prepared, version, "2027-03-01")


def test_the_site_is_of_the_checkouts_version(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("sphinx")
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "site"))
    build = load(ROOT / "docs" / "site" / "build.py")
    with pytest.raises(SystemExit, match="build the site of a version from its tag"):
        build.version_options("9.9.9", [])
    assert build.version_options(__version__, []) == []
    older = build.version_options(__version__, ["99.0.0", __version__])
    assert older[1] == f"versions=99.0.0,{__version__}"
    assert "the newest is 99.0.0" in older[3]
    assert len(build.version_options(__version__, [__version__, "0.1.0"])) == 2
