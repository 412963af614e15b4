"""Download of a model at a commit of the Hugging Face hub: a folder that appears whole, without code."""

from __future__ import annotations

import fnmatch
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from dancedata.audio.hf.model_folder import FILES, PROVENANCE, licence_of
from dancedata.core.errors import DanceDataError, SourceError, UsageError
from dancedata.core.packages import require
from dancedata.core.system import flush_folder
from dancedata.core.text import listed, shown
from dancedata.files.atomic import PREFIX, write_json
from dancedata.files.locks import file_lock
from dancedata.files.publish import foreign_files

_CARD = "README.md"
_LICENCES = ("LICENSE*", "LICENCE*")
_NAME = re.compile(r"[A-Za-z0-9][\w.-]{0,95}/[A-Za-z0-9][\w.-]{0,95}")
_PLAIN_FILE = re.compile(r"\w[\w.-]{0,200}")
#: Files of the hub's client in the folder that it writes to.
_CLIENT = ".cache"


@dataclass(frozen=True)
class FetchedModel:
    """A model that was fetched, its commit, and the licence that its card states.

    `files`, `left_out`: Names of its files, and of the others of the repository: code, pickles, other formats.
    """

    path: Path
    id: str
    revision: str
    licence: str
    files: tuple[str, ...]
    left_out: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON data."""
        return {**asdict(self), "path": str(self.path)}


def fetch_model(
    name: str,
    revision: str | None,
    out: Path | str,
    *,
    endpoint: str | None = None,
    show_licence: Callable[[str], None] = lambda _: None,
) -> FetchedModel:
    """Get the weights, configs and card of a model; hashes are compared with the hub's. No code is fetched."""
    out = Path(out).absolute()
    if not _NAME.fullmatch(name):
        raise UsageError("hf: not the id of a model on the hub", found=name, allowed="OWNER/NAME")
    api = _api(endpoint)
    with _errors(name, api.endpoint):
        info = api.model_info(name, revision=revision)
        if info.sha != revision:
            raise UsageError(
                "hf: a revision is a commit, as branches and tags move",
                where=name,
                found=revision or "no revision",
                allowed="40 hexadecimal digits",
                fix=f"{shown(revision or 'main')} is this commit now: {name}@{shown(info.sha)}",
            )
        files = sorted(file.rfilename for file in info.siblings or ())
        chosen = _chosen(name, files)
        part = out.with_name(f"{PREFIX}{out.name}-{info.sha[:12]}")
        _require_new(out)
        out.parent.mkdir(parents=True, exist_ok=True)
        with file_lock(part.with_name(f"{part.name}.lock"), wait=False) as locked:
            if not locked:
                raise UsageError("hf: another process is fetching this model", where=part)
            _require_only(part, chosen)
            if _CARD in chosen:
                api.snapshot_download(name, revision=revision, local_dir=part, allow_patterns=[_CARD])
            licence = licence_of(part)
            show_licence(licence)
            api.snapshot_download(name, revision=revision, local_dir=part, allow_patterns=chosen)
            _verify(api, name, info.sha, part, chosen)
            model = FetchedModel(
                out, name, info.sha, licence, tuple(chosen), tuple(f for f in files if f not in chosen)
            )
            write_json(part / PROVENANCE, {"id": name, "revision": info.sha, "licence": licence})
            shutil.rmtree(part / _CLIENT, ignore_errors=True)
            _require_new(out)
            with suppress(FileNotFoundError):
                out.rmdir()  # an empty folder
            part.rename(out)
            flush_folder(out.parent)
    return model


def _api(endpoint: str | None) -> Any:
    require("hf", ["huggingface_hub"], what="hf: fetching a model")
    import huggingface_hub

    api = huggingface_hub.HfApi(endpoint=endpoint)
    if not hasattr(api, "verify_repo_checksums"):
        raise UsageError(
            "hf: fetching a model needs a newer huggingface_hub, which compares hashes",
            found=huggingface_hub.__version__,
            allowed="1.1 or later, which comes with transformers 5",
            fix="fetch in another environment: the folder is read by transformers 4 as well",
        )
    return api


def _verify(api: Any, name: str, commit: str, part: Path, chosen: Sequence[str]) -> None:
    """Remove the files whose hash is not the hub's; SourceError if there are any, or files are missing."""
    found = api.verify_repo_checksums(name, revision=commit, local_dir=part)
    for file in found.mismatches:
        (part / file["path"]).unlink()
    # Where the hub does not answer, the client returns a folder as it is.
    wrong = [file["path"] for file in found.mismatches] + sorted({*chosen} & {*found.missing_paths})
    if wrong:
        problem = "hf: files are missing, or not what the hub announced: those were removed"
        raise SourceError(problem, where=part, found=listed(wrong), fix="fetch it again")


@contextmanager
def _errors(name: str, endpoint: str) -> Iterator[None]:
    """Turn errors of the hub's client, and of the disk, into those that say what to do."""
    import huggingface_hub.errors

    errors: Any = huggingface_hub.errors  # HTTPError is that of the client's own http package
    try:
        yield
    except DanceDataError:
        raise
    except errors.OfflineModeIsEnabled as error:
        fix = "unset HF_HUB_OFFLINE, or fetch elsewhere and copy the folder"
        raise UsageError("hf: the client of the hub is set to offline", fix=fix) from error
    except (errors.RepositoryNotFoundError, errors.RevisionNotFoundError) as error:  # a gated one is the former
        raise UsageError(
            "hf: the hub does not give this model",
            where=name,
            found=f"{type(error).__name__}: {shown(' '.join(str(error).split()), 300)}",
            fix="check id and commit on the model's page, accept its terms there if it has any, and log in if it is "
            "private or has terms: hf auth login",
        ) from error
    except (errors.HTTPError, OSError, ValueError) as error:
        # The client's own message may be that the file is not in its cache.
        cause = error.__cause__ or error
        raise SourceError(
            "hf: the model cannot be fetched",
            where=f"{name} at {endpoint}",
            found=f"{type(cause).__name__}: {shown(str(cause).strip().partition(chr(10))[0])}",
            fix="run the same command again to resume; without a network, fetch elsewhere and copy the folder",
        ) from error


def _chosen(name: str, files: Sequence[str]) -> list[str]:
    # The hub's names are not trusted: no folders, no hidden files.
    plain = [file for file in files if _PLAIN_FILE.fullmatch(file)]
    usable = [file for file in plain if any(fnmatch.fnmatchcase(file, one) for one in (*FILES, *_LICENCES))]
    safe = any(file.endswith(".safetensors") for file in usable)
    pickled = [file for file in usable if ".bin" in file]
    if "config.json" not in usable or not (safe or pickled):
        raise UsageError("hf: the repository is not a model in transformers' layout", where=name,
                         found=listed(files) or "no file",
                         allowed="config.json, and weights as model*.safetensors or pytorch_model*.bin")  # fmt: skip
    return [file for file in usable if not (safe and file in pickled)]


def _require_new(out: Path) -> None:
    if out.is_symlink() or (out.exists() and not (out.is_dir() and not any(out.iterdir()))):
        raise UsageError("hf: the output folder exists", where=out,
                         found=f"{PROVENANCE} of an earlier fetch" if (out / PROVENANCE).exists() else None,
                         fix="choose a new one, or remove it")  # fmt: skip


def _require_only(part: Path, names: Sequence[str]) -> None:
    """Raise UsageError for other files in the temporary folder: they would become a part of the model."""
    found = {path.name for path in part.iterdir()} if part.exists() else set()
    foreign = sorted(found - {*names, _CLIENT, PROVENANCE})
    if part.is_symlink() or foreign:
        problem = "hf: the folder of an unfinished fetch holds other files"
        raise foreign_files(part, foreign, problem=problem, choose="another --out", error=UsageError)
