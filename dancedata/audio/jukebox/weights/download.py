"""Getting OpenAI's two files from their server, a mirror or another folder. Interrupted downloads are resumed."""

import re
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dancedata.audio.jukebox.weights.folder import LICENCE, PRIOR_FILE, SHA256, VQVAE_FILE
from dancedata.core.errors import DanceDataError, SourceError, UsageError
from dancedata.core.packages import load
from dancedata.core.text import quoted, shown
from dancedata.files.atomic import PREFIX, atomic_file
from dancedata.files.locks import file_lock
from dancedata.files.regular_file import sha256_file

OPENAI_URL = "https://openaipublic.azureedge.net/jukebox/models/5b"

_BLOCK = 1 << 20
#: Bytes that arrive together: what a broken connection has sent of the last ones is asked for again.
_PIECE = 1 << 14
_TIMEOUT_S = 60
_LENGTH = re.compile(r"[0-9]{1,15}")


@dataclass(frozen=True)
class RemoteFile:
    """One file of the checkpoint; `max_size` limits one whose size is not known."""

    name: str
    size: int | None
    sha256: str
    max_size: int = 1 << 34

    @property
    def limit(self) -> int:
        """The most bytes that are accepted from a server."""
        return self.max_size if self.size is None else self.size


# Sizes as other projects report them. The tensors of the small file take 7.5 MB.
FILES = (
    RemoteFile(VQVAE_FILE, None, SHA256[VQVAE_FILE], 1 << 24),
    RemoteFile(PRIOR_FILE, 10_288_727_721, SHA256[PRIOR_FILE]),
)

Progress = Callable[[str, int, int | None], None]


def fetch(
    out: Path | str,
    source: str | Path = OPENAI_URL,
    *,
    accept_licence: bool | Callable[[str], bool],
    files: Sequence[RemoteFile] = FILES,
    progress: Progress | None = None,
    attempts: int = 8,
    wait_s: float = 2.0,
) -> list[Path]:
    """Get the missing files; size and SHA-256 are checked, files appear complete or not at all.

    `out`: Folder; created if it does not exist.
    `source`: URL of a folder with the files (of OpenAI or a mirror), or a local folder.
    `accept_licence`: True if the user has accepted the licence of the weights; or a function that shows its text and
        asks.
    `progress`: Called with file name, bytes so far, total bytes or None.
    `attempts`: Limit of consecutive failures without any new data.
    `wait_s`: Pause in seconds after the first failure; it doubles with each further one.
    Raises UsageError: The licence was not accepted, or `source` is neither http(s) nor a folder.
    Raises SourceError: A file does not exist or has another size or hash, or the server keeps failing. A partial
        download is kept as ".dancedata-NAME.part", and the next call resumes it; one that is too large is removed.
    """
    agreed = accept_licence(LICENCE) if callable(accept_licence) else accept_licence
    if not agreed:
        raise UsageError("jukebox: the licence of the weights was not accepted", found=LICENCE)
    out, url = Path(out), str(source)
    remote = url.startswith(("http://", "https://"))
    if not remote and not Path(url).is_dir():
        raise UsageError(
            "jukebox: invalid source", found=url, allowed="an http or https URL of a folder, or a local folder"
        )
    out.mkdir(parents=True, exist_ok=True)
    report = progress or (lambda *_: None)
    paths = []
    for file in files:
        path = out / file.name
        paths.append(path)
        try:
            with file_lock(out / f"{PREFIX}{file.name}.lock", wait=False) as locked:
                if not locked:
                    raise UsageError("jukebox: another program is fetching this file", where=path)
                if path.exists():
                    _check(path, file, keep=True)
                elif remote:
                    _Download(f"{url.rstrip('/')}/{file.name}", path, file, report).run(attempts, wait_s)
                else:
                    _copy(Path(url) / file.name, path, file, report)
        except OSError as error:
            raise DanceDataError("jukebox: the file cannot be written", where=path,
                                 found=f"{error}; {shutil.disk_usage(out).free / 1e9:.1f} GB are free",
                                 fix="free 10.3 GB of disk space for the two files") from error  # fmt: skip
    return paths


class _Download:
    """The download of one file, over as many connections as needed."""

    def __init__(self, url: str, path: Path, file: RemoteFile, report: Progress) -> None:
        self._url = url
        self._path = path
        self._part = path.with_name(f"{PREFIX}{path.name}.part")
        self._file = file
        self._report = report

    def run(self, attempts: int, wait_s: float) -> None:
        requests: Any = load("requests", "jukebox", "jukebox: a download")
        failures = 0
        while True:
            before, problem = self._have(), "the connection ended early"
            try:
                if self._connect(requests, before):
                    break
            except (requests.RequestException, ValueError) as error:  # other OSErrors come from the disk
                problem, status = str(error), getattr(getattr(error, "response", None), "status_code", None)
                if isinstance(error, ValueError | requests.TooManyRedirects) or status in (401, 403, 404, 410):
                    raise self._failed(problem) from error
            failures = 1 if self._have() > before else failures + 1
            if failures >= attempts:
                raise self._failed(problem)
            time.sleep(wait_s * 2 ** (failures - 1))
        _check(self._part, self._file, keep=False)
        with atomic_file(self._path) as temporary:
            # In the same folder, so this is a rename; atomic_file then flushes it to disk and renames it again.
            self._part.replace(temporary)

    def _have(self) -> int:
        return self._part.stat().st_size if self._part.exists() else 0

    def _connect(self, requests: Any, have: int) -> bool:
        """Append bytes of the server; return whether the file is complete."""
        headers = {"Accept-Encoding": "identity"}
        if have:
            headers["Range"] = f"bytes={have}-"
        with requests.get(self._url, headers=headers, stream=True, timeout=_TIMEOUT_S) as response:
            if response.status_code == 416 and have:
                # The part has all bytes: of this file, or of another one, which the hash shows.
                return True
            response.raise_for_status()
            resumed = response.status_code == 206
            begins = response.headers.get("Content-Range", "")
            if resumed and not begins.startswith(f"bytes {have}-"):
                raise requests.ConnectionError(f"asked for bytes from {have}, got {quoted(begins)}")
            return self._receive(response, have if resumed else 0)

    def _receive(self, response: Any, have: int) -> bool:
        length, size = response.headers.get("Content-Length", ""), self._file.size
        total = have + int(length) if _LENGTH.fullmatch(length) else None
        if total is not None and (total > self._file.limit if size is None else total != size):
            raise self._other_file(f"{total} bytes")
        with self._part.open("ab" if have else "wb") as part:
            for block in response.iter_content(_PIECE):
                have += len(block)
                if have > self._file.limit:
                    # It is not the beginning of the right file.
                    self._part.unlink()
                    raise self._other_file("more than that")
                part.write(block)
                self._report(self._file.name, have, total)
        # A server that does not send the length ends the file by closing the connection: the known size, or else the
        # hash, shows whether the file is complete.
        expected = total if total is not None else size
        return expected is None or have >= expected

    def _failed(self, problem: str) -> SourceError:
        return SourceError(
            "jukebox: the download failed",
            where=self._url,
            found=f"{shown(problem)}; {self._have()} bytes downloaded",
            fix="run the same command again to resume, or choose a mirror or a folder that has the files",
        )

    def _other_file(self, found: str) -> SourceError:
        at_most = "" if self._file.size is not None else "at most "
        return SourceError("the server has another file", where=self._url, found=found,
                           allowed=f"{at_most}{self._file.limit} bytes",
                           fix="choose another mirror or folder")  # fmt: skip


def _copy(source: Path, path: Path, file: RemoteFile, report: Progress) -> None:
    if not source.is_file():
        raise SourceError("the folder does not have the file", where=source,
                          found=shown(sorted(p.name for p in source.parent.iterdir())),
                          allowed=file.name)  # fmt: skip
    _check(source, file, keep=True)
    total = source.stat().st_size
    with atomic_file(path) as temporary, source.open("rb") as read, temporary.open("wb") as write:
        while block := read.read(_BLOCK):
            write.write(block)
            report(file.name, write.tell(), total)


def _check(path: Path, file: RemoteFile, *, keep: bool) -> None:
    """Compare size and hash. A wrong download is removed, or renamed if its size is right.

    Ten gigabytes are not deleted because of a hash: the user can still inspect or rename the file.
    """
    size = path.stat().st_size
    aside = path.with_suffix(".mismatch")
    if file.size is not None and size != file.size:
        what, found, allowed = "size", f"{size} bytes", f"{file.size} bytes"
    elif (digest := sha256_file(path)) != file.sha256:
        what, found, allowed = "SHA-256", digest, file.sha256
    else:
        return
    fix = "remove it and fetch again"
    if not keep and (file.size is None or what == "size"):
        path.unlink()
        fix = "it was removed; fetch again, or from another mirror or folder"
    elif not keep:
        path.replace(aside)
        fix = f"it was renamed to {aside}; fetch again, or from another mirror or folder"
    raise SourceError(f"jukebox: the {what} of the file differs from the checkpoint's", where=path, found=found,
                      allowed=allowed, fix=fix)  # fmt: skip
