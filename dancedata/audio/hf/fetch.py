"""Download of a model at a commit of the Hugging Face hub: a folder that appears whole, without code."""

from __future__ import annotations

import fnmatch
import hashlib
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dancedata.audio.hf.model_folder import FILES, PROVENANCE, licence_of
from dancedata.core.errors import DanceDataError, SourceError, UsageError
from dancedata.core.packages import require
from dancedata.core.system import flush_folder
from dancedata.core.text import listed, shown
from dancedata.files.atomic import PREFIX, write_json
from dancedata.files.locks import file_lock
from dancedata.files.publish import foreign_files
from dancedata.files.regular_file import sha256_file

if TYPE_CHECKING:
    from huggingface_hub.hf_api import RepoSibling

_CARD = "README.md"
_LICENCES = ("LICENSE*", "LICENCE*")
_NAME = re.compile(r"[A-Za-z0-9][\w.-]{0,95}/[A-Za-z0-9][\w.-]{0,95}")
_COMMIT = re.compile(r"[0-9a-f]{40}")
_PLAIN_FILE = re.compile(r"\w[\w.-]{0,200}")
#: Files of the hub's client in the folder that it writes to.
_CLIENT = ".cache"


@dataclass(frozen=True)
class FetchedModel:
    """A model that was fetched.

    Attributes
    ----------
    path
        Its folder.
    id, revision
        Its id on the hub, and the commit.
    licence
        What its card says, or "unknown, see the model's page".
    files
        SHA-256 of each file, by name.
    left_out
        Names of the other files of the repository: code, pickles, other formats.
    """

    path: Path
    id: str
    revision: str
    licence: str
    files: dict[str, str]
    left_out: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {"path": str(self.path), **self.record(), "left_out": list(self.left_out)}

    def record(self) -> dict[str, Any]:
        """Return the JSON document of the provenance file."""
        return {"id": self.id, "revision": self.revision, "licence": self.licence, "files": self.files}


def fetch_model(
    name: str,
    revision: str | None,
    out: Path | str,
    *,
    pickles: bool = False,
    endpoint: str | None = None,
    show_licence: Callable[[str], None] | None = None,
) -> FetchedModel:
    """Get the weights, configs and card of a model; sizes and hashes are compared with the hub's.

    Files are written to a folder next to `out`, which is renamed at the end; the same call resumes after an
    interruption. No code (``*.py``) is ever fetched.

    Parameters
    ----------
    name
        Id on the hub, ``OWNER/NAME``.
    revision
        Commit, 40 hexadecimal digits. For a branch, a tag or None the error names the commit to give.
    out
        Folder to make.
    pickles
        Whether to fetch pickled weights if the repository has no safetensors. They are read as data only.
    endpoint
        Address of another hub; default: $HF_ENDPOINT, else the public one.
    show_licence
        Called with the licence before the weights are fetched.

    Raises
    ------
    UsageError
        `revision` is not a commit, the model does not exist, needs permission or has no weights of this kind, `out`
        exists, or the package huggingface_hub is not installed.
    SourceError
        The hub cannot be reached, or its files are not what it announced.
    """
    out = Path(out).absolute()
    if not _NAME.fullmatch(name):
        raise UsageError("hf: not the id of a model on the hub", found=name, allowed="OWNER/NAME")
    hub = _Hub(name, endpoint)
    if revision is None or not _COMMIT.fullmatch(revision):
        raise UsageError(
            "hf: a revision is a commit, as branches and tags move",
            where=name,
            found=revision or "no revision",
            allowed="40 hexadecimal digits",
            fix=f"{shown(revision or 'main')} is this commit now: --revision {shown(hub.commit_of(revision))}",
        )
    _require_new(out)
    files = hub.files(revision)
    chosen, left_out = _chosen(name, files, pickles)
    part = out.with_name(f"{PREFIX}{out.name}-{revision[:12]}")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with file_lock(part.with_name(f"{part.name}.lock"), wait=False) as locked:
            if not locked:
                raise UsageError("hf: another process is fetching this model", where=part)
            part.mkdir(exist_ok=True)
            _require_only(part, {file.rfilename for file in chosen})
            return _fetched(hub, revision, part, out, chosen, left_out, show_licence or (lambda _: None))
    except OSError as error:
        free = shutil.disk_usage(out.parent).free / 1e9 if out.parent.is_dir() else 0.0
        raise DanceDataError(
            "hf: the files cannot be written", where=part, found=f"{shown(error)}; {free:.1f} GB are free"
        ) from error


def _fetched(
    hub: _Hub,
    revision: str,
    part: Path,
    out: Path,
    chosen: list[RepoSibling],
    left_out: tuple[str, ...],
    show_licence: Callable[[str], None],
) -> FetchedModel:
    """Fetch the files into `part`, the card first, and rename it to `out`."""
    hashes: dict[str, str] = {}
    for file in sorted(chosen, key=lambda one: (one.rfilename != _CARD, one.rfilename)):
        hub.fetch(file.rfilename, revision, part)
        hashes[file.rfilename] = _checked(part / file.rfilename, file)
        if file.rfilename == _CARD:
            show_licence(licence_of(part))
    if _CARD not in hashes:
        show_licence(licence_of(part))
    model = FetchedModel(out, hub.name, revision, licence_of(part), dict(sorted(hashes.items())), left_out)
    write_json(part / PROVENANCE, model.record())
    shutil.rmtree(part / _CLIENT, ignore_errors=True)
    _require_new(out)
    with suppress(FileNotFoundError):
        out.rmdir()  # an empty folder
    part.rename(out)
    flush_folder(out.parent)
    return model


class _Hub:
    """One model on the hub, through the package huggingface_hub; its exceptions become errors that say what to do."""

    def __init__(self, name: str, endpoint: str | None) -> None:
        require("hf", ["huggingface_hub"], what="hf: fetching a model")
        import huggingface_hub
        from huggingface_hub import constants, errors

        self.name, self._endpoint = name, endpoint or constants.ENDPOINT
        self._client, self._client_errors = huggingface_hub, errors

    def commit_of(self, revision: str | None) -> str:
        """Return the commit that a branch or tag names now; None: the main branch."""
        with self._errors(revision or "main"):
            return str(self._client.HfApi(endpoint=self._endpoint).model_info(self.name, revision=revision).sha)

    def files(self, revision: str) -> list[RepoSibling]:
        """Return the files at a commit, with sizes and hashes."""
        with self._errors(revision):
            api = self._client.HfApi(endpoint=self._endpoint)
            info = api.model_info(self.name, revision=revision, files_metadata=True)
        if info.sha != revision:
            raise SourceError("hf: the hub answers with another commit", where=self.name, found=shown(info.sha))
        return list(info.siblings or ())

    def fetch(self, file: str, revision: str, folder: Path) -> None:
        """Download one file into a folder; a partial file is resumed."""
        with self._errors(revision):
            self._client.hf_hub_download(
                self.name, file, revision=revision, local_dir=folder, endpoint=self._endpoint
            )

    @contextmanager
    def _errors(self, revision: str) -> Iterator[None]:
        errors = self._client_errors
        try:
            yield
        except errors.OfflineModeIsEnabled as error:
            raise UsageError(
                "hf: the client of the hub is set to offline",
                fix="unset HF_HUB_OFFLINE, or fetch elsewhere and copy",
            ) from error
        except errors.GatedRepoError as error:
            raise UsageError(
                "hf: the model is available only after accepting its terms",
                where=self.name,
                fix="accept them on the model's page, then log in: hf auth login",
            ) from error
        except (errors.RepositoryNotFoundError, errors.RevisionNotFoundError) as error:
            missing = isinstance(error, errors.RevisionNotFoundError)
            raise UsageError(
                f"hf: the model has no revision {shown(revision)}"
                if missing
                else "hf: the hub does not have this model",
                where=self.name,
                fix="check the id on the model's page; for a private model log in: hf auth login",
            ) from error
        except (errors.HTTPError, OSError, ValueError) as error:
            # The client's own message may be that the file is not in its cache.
            cause = error.__cause__ or error
            raise SourceError(
                "hf: the hub cannot be reached, or does not answer as expected",
                where=f"{self.name} at {self._endpoint}",
                found=f"{type(cause).__name__}: {shown(str(cause).strip().partition(chr(10))[0])}",
                fix="run the same command again to resume; without a network, fetch elsewhere and copy the folder",
            ) from error


def _chosen(name: str, files: list[RepoSibling], pickles: bool) -> tuple[list[RepoSibling], tuple[str, ...]]:
    """Return the files to fetch, and the names of the others."""
    usable = [file for file in files if _is_wanted(file.rfilename)]
    names = {file.rfilename for file in usable}
    safe = any(one.endswith(".safetensors") for one in names)
    pickled = sorted(one for one in names if ".bin" in one)
    if "config.json" not in names or not (safe or pickled):
        raise UsageError(
            "hf: the repository is not a model in transformers' layout",
            where=name,
            found=listed(sorted(file.rfilename for file in files)) or "no file",
            allowed="config.json, and weights as model*.safetensors or pytorch_model*.bin",
        )
    if not safe and not pickles:
        raise UsageError(
            "hf: the model has pickled weights only, no safetensors",
            where=name,
            found=listed(pickled),
            fix="fetch them with --pickles; they are read as data, and code in them is not executed",
        )
    chosen = [file for file in usable if not (safe and file.rfilename in pickled)]
    kept = {file.rfilename for file in chosen}
    return chosen, tuple(sorted(file.rfilename for file in files if file.rfilename not in kept))


def _is_wanted(file: str) -> bool:
    # The hub's names are not trusted: no folders, no hidden files.
    return _PLAIN_FILE.fullmatch(file) is not None and any(
        fnmatch.fnmatchcase(file, pattern) for pattern in (*FILES, *_LICENCES)
    )


def _checked(path: Path, file: RepoSibling) -> str:
    """Return the SHA-256 of a file that is what the hub announced; else it is removed, and a SourceError raised."""
    sha256, size = sha256_file(path), path.stat().st_size
    # Of small files the hub has git's own name of their content.
    announced = file.blob_id if file.lfs is None else file.lfs.sha256
    content = sha256
    if file.lfs is None:
        data = path.read_bytes()
        content = hashlib.sha1(b"blob %d\0" % len(data) + data, usedforsecurity=False).hexdigest()
    if announced not in (None, content) or file.size not in (None, size):
        path.unlink()
        raise SourceError(
            "hf: the file is not what the hub announced; it was removed",
            where=path,
            found=f"{size} bytes, SHA-256 {sha256}",
            allowed=f"{file.size} bytes, {shown(announced)}",
            fix="fetch it again",
        )
    return sha256


def _require_new(out: Path) -> None:
    if out.is_symlink() or (out.exists() and not (out.is_dir() and not any(out.iterdir()))):
        raise UsageError(
            "hf: the output folder exists",
            where=out,
            found=f"{PROVENANCE} of an earlier fetch" if (out / PROVENANCE).exists() else None,
            fix="choose a new one, or remove it",
        )


def _require_only(part: Path, names: set[str]) -> None:
    """Raise UsageError for other files in the temporary folder: they would become a part of the model."""
    foreign = sorted({path.name for path in part.iterdir()} - names - {_CLIENT, PROVENANCE})
    if part.is_symlink() or foreign:
        problem = "hf: the folder of an unfinished fetch holds other files"
        raise foreign_files(part, foreign, problem=problem, choose="another --out", error=UsageError)
