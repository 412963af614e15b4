#!/usr/bin/env python3
"""A release: its checks, files and tag. Without --prepare or --tag nothing outside dist/ changes.

    .ci/release.py --prepare 0.3.0   # writes version, changelog, citation and conda recipe; to be committed
    .ci/release.py                   # checks, sdist and wheel twice, SBOM, SHA256SUMS in dist/; no tag
    .ci/release.py --tag             # the same, then the tag v0.3.0

CONTRIBUTING.md has the steps. Needs git, Python 3.11 or later and the network (build, cffconvert, cyclonedx-bom and
py-rattler-build are installed into a temporary environment). Exit code 1 with the reasons if something is refused.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FINAL = re.compile(r"\d+\.\d+\.\d+")
#: The place of the version in each file.
PLACES = {
    "dancedata/core/version.py": re.compile(r'^(__version__ = ")([^"]+)(")$', re.MULTILINE),
    "CITATION.cff": re.compile(r"^(version: )(\S+)()$", re.MULTILINE),
    "conda/recipe.yaml": re.compile(r'^(  version: ")([^"]+)(")$', re.MULTILINE),
}
HEADING = re.compile(r"^## \[([^\]]+)\](?: - (\S+))?$", re.MULTILINE)
RELEASED = re.compile(r"^date-released: (\S+)$", re.MULTILINE)
#: The tools that build and validate, with the versions that this was run with.
TOOLS = ("build==1.6.1", "hatchling==1.33.0", "cyclonedx-bom==7.5.0", "py-rattler-build==0.73.0")
#: Needs another version of jsonschema than cyclonedx-bom does.
CITATION_TOOLS = ("cffconvert==2.0.0",)


def git(*arguments: str, root: Path = ROOT) -> str:
    """Return the output of a git command."""
    return subprocess.run(["git", *arguments], cwd=root, check=True, capture_output=True, text=True).stdout.strip()


def stated(root: Path) -> dict[str, str]:
    """Return the version that each file states; "" where none does."""
    found = {name: place.search((root / name).read_text(encoding="utf-8")) for name, place in PLACES.items()}
    return {name: match[2] if match else "" for name, match in found.items()}


def refusals(root: Path) -> Iterator[str]:
    """Yield the reasons for which this tree is not released."""
    versions, changelog = stated(root), (root / "CHANGELOG.md").read_text(encoding="utf-8")
    version = versions["dancedata/core/version.py"]
    if not FINAL.fullmatch(version):
        yield f"{version} is a version in development; set one with --prepare X.Y.Z"
        return
    for name, other in versions.items():
        if other != version:
            yield f"{name} states {other or 'no version'}, dancedata/core/version.py {version}"
    headings = list(HEADING.finditer(changelog))
    if [match[1] for match in headings[:2]] != ["Unreleased", version]:
        found = ", ".join(match[1] for match in headings[:2])
        yield f"the first headings of CHANGELOG.md are {found}; expected Unreleased, {version}"
    else:
        if changelog[headings[0].end() : headings[1].start()].strip():
            yield "CHANGELOG.md has entries under Unreleased"
        if not is_above(version, [match[1] for match in headings[2:]]):
            yield f"{version} is not above the release before, {headings[2][1]}"
        released = RELEASED.search((root / "CITATION.cff").read_text(encoding="utf-8"))
        if not headings[1][2] or released is None or released[1] != headings[1][2]:
            dates = f"CHANGELOG.md {headings[1][2] or 'none'}, CITATION.cff {released[1] if released else 'none'}"
            yield f"the dates of the release differ: {dates}"
    if changed := git("status", "--porcelain", root=root):
        yield f"the working tree has changes: {', '.join(line.split()[-1] for line in changed.splitlines()[:5])}"
    if git("tag", "--list", f"v{version}", root=root):
        yield f"the tag v{version} exists"


def is_above(version: str, before: list[str]) -> bool:
    """Return whether a version is above all earlier ones."""
    return all(_numbers(version) > _numbers(other) for other in before)


def _numbers(version: str) -> list[int]:
    return [int(number) for number in re.findall(r"\d+", version)]


def prepare(root: Path, version: str, date: str) -> None:
    """Write a version into all files that state it, and give what is unreleased its heading and date."""
    if not FINAL.fullmatch(version):
        raise SystemExit(f"{version} is not a version such as 0.3.0")
    changelog = root / "CHANGELOG.md"
    text = changelog.read_text(encoding="utf-8")
    released = [match[1] for match in HEADING.finditer(text)][1:]
    if not is_above(version, released):
        raise SystemExit(f"{version} is not above the last release, {released[0]}")
    if git("tag", "--list", f"v{version}", root=root):
        raise SystemExit(f"the tag v{version} exists")
    changelog.write_text(
        text.replace("## [Unreleased]\n", f"## [Unreleased]\n\n## [{version}] - {date}\n", 1), encoding="utf-8"
    )
    for name, place in PLACES.items():
        path = root / name
        path.write_text(place.sub(rf"\g<1>{version}\g<3>", path.read_text(encoding="utf-8")), encoding="utf-8")
    citation = root / "CITATION.cff"
    lines = RELEASED.sub("", citation.read_text(encoding="utf-8")).replace("\n\n", "\n")
    citation.write_text(
        lines.replace(f"version: {version}\n", f"version: {version}\ndate-released: {date}\n"), encoding="utf-8"
    )


def environment(folder: Path, packages: tuple[str, ...]) -> Path:
    """Return the bin folder of a new environment with these packages."""
    subprocess.run([sys.executable, "-m", "venv", folder], check=True)
    subprocess.run([folder / "bin" / "pip", "install", "-q", "uv"], check=True)
    uv = [folder / "bin" / "uv", "pip", "install", "-q", "--python", folder / "bin" / "python"]
    subprocess.run([*uv, *packages], check=True)
    return folder / "bin"


def built(tools: Path, work: Path, root: Path, commit: str) -> dict[str, bytes]:
    """Build sdist and wheel from a fresh copy of the commit, and return their content by name."""
    copy, out = work / "copy", work / "dist"
    subprocess.run(["git", "clone", "-q", root, copy], check=True)
    git("checkout", "-q", "--detach", commit, root=copy)
    time = git("log", "-1", "--format=%ct", commit, root=root)
    command = [tools / "python", "-m", "build", "--no-isolation", "--outdir", out, copy]
    subprocess.run(command, check=True, env=os.environ | {"SOURCE_DATE_EPOCH": time}, stdout=subprocess.DEVNULL)
    return {path.name: path.read_bytes() for path in sorted(out.iterdir())}


def step(text: str) -> None:
    """Print a line at once, so that it stands before the output of the commands."""
    print(f"== {text}", flush=True)


def validated(root: Path, work: Path, tools: Path) -> None:
    """Validate citation and conda recipe; CalledProcessError with their validator's output otherwise."""
    step("CITATION.cff: cffconvert --validate")
    citation = environment(work / "citation", CITATION_TOOLS)
    subprocess.run([citation / "cffconvert", "--validate", "-i", root / "CITATION.cff"], check=True)
    step("conda/recipe.yaml: rendered by rattler-build")
    script = (
        "import sys; from rattler_build import Stage0Recipe, VariantConfig; "
        "print(*Stage0Recipe.from_file(sys.argv[1]).render(VariantConfig()))"
    )
    subprocess.run([tools / "python", "-c", script, root / "conda" / "recipe.yaml"], check=True)


def sbom(root: Path, work: Path, tools: Path, wheel: Path, out: Path) -> None:
    """Install the wheel alone, run the demo with it in an empty folder, and describe what was installed."""
    step(f"{wheel.name} in an empty environment and folder: dancedata build demo")
    alone, empty = environment(work / "alone", (str(wheel),)), work / "empty"
    empty.mkdir()
    settings = os.environ | {"DANCEDATA_CACHE": str(work / "cache")}
    settings.pop("PYTHONPATH", None)
    for command in (["build", "demo", "--quiet"], ["check", "data/demo"]):
        subprocess.run([alone / "dancedata", *command], cwd=empty, env=settings, check=True)
    subprocess.run(
        [alone / "uv", "pip", "uninstall", "-q", "--python", alone / "python", "uv", "pip", "setuptools"], check=True
    )
    step("the SBOM: CycloneDX 1.6, validated while it is written")
    command = ["environment", "--sv", "1.6", "--of", "JSON", "--output-reproducible", "--validate", "-o", str(out)]
    subprocess.run(
        [tools / "cyclonedx-py", *command, "--pyproject", root / "pyproject.toml", alone / "python"], check=True
    )


def release(root: Path, tag: bool) -> int:
    """Check, build and write dist/; 1 if something is refused."""
    version, commit = stated(root)["dancedata/core/version.py"], git("rev-parse", "HEAD", root=root)
    reasons = list(refusals(root))
    for reason in reasons:
        print(f"refused: {reason}", file=sys.stderr)
    if reasons:
        return 1
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        tools = environment(work / "tools", TOOLS)
        validated(root, work, tools)
        step("sdist and wheel, twice")
        files, again = (built(tools, work / name, root, commit) for name in ("one", "two"))
        for name, data in files.items():
            same = again.get(name) == data
            print(
                f"{hashlib.sha256(data).hexdigest()}  {name}  {'twice the same' if same else 'DIFFERS'}", flush=True
            )
        if files != again:
            return 1
        dist = root / "dist"
        shutil.rmtree(dist, ignore_errors=True)
        dist.mkdir()
        for name, data in files.items():
            (dist / name).write_bytes(data)
        wheel = next(dist / name for name in files if name.endswith(".whl"))
        sbom(root, work, tools, wheel, dist / f"dancedata-{version}.cdx.json")
        sums = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}" for path in sorted(dist.iterdir())]
        (dist / "SHA256SUMS").write_text("\n".join([*sums, ""]))
    if tag:
        # Not HEAD, which may be another commit by now.
        git("tag", "-a", f"v{version}", "-m", f"dancedata {version}", commit, root=root)
        step(f"tagged v{version}; upload: twine upload dist/dancedata-{version}*.whl dist/dancedata-{version}.tar.gz")
    else:
        subject = git("log", "-1", "--format=%h %s", commit, root=root)
        step(f"dry run: all passed; --tag would tag {subject} as v{version}")
    return 0


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--prepare", metavar="X.Y.Z", help="write this version into the files that state it")
    parser.add_argument("--tag", action="store_true", help="tag after all checks; without it a dry run")
    options = parser.parse_args()
    if options.prepare:
        prepare(ROOT, options.prepare, datetime.now(UTC).date().isoformat())
        print(git("diff", "--stat"))
        return 0
    try:
        return release(ROOT, options.tag)
    except subprocess.CalledProcessError as error:
        print(f"refused: this command failed: {' '.join(map(str, error.cmd))}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main())
