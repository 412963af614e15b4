"""Getting OpenAI's two files from their server, a mirror or another folder. Interrupted downloads are resumed."""

import re
import shutil
import ssl
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from http.client import HTTPException, HTTPResponse
from pathlib import Path

from dancedata.audio.jukebox.weights.folder import LICENCE, PRIOR_FILE, SHA256, VQVAE_FILE
from dancedata.core.errors import DanceDataError, SourceError, UsageError
from dancedata.core.text import quoted, shown
from dancedata.files.atomic import PREFIX, atomic_file
from dancedata.files.locks import file_lock
from dancedata.files.regular_file import sha256_file
from dancedata.remote.http import Redirection, opener

OPENAI_URL = "https://openaipublic.azureedge.net/jukebox/models/5b"

_BLOCK = 1 << 20
_TIMEOUT_S = 60
_LENGTH = re.compile(r"[0-9]{1,15}")
#: A strong entity tag (RFC 9110), without which a download cannot be resumed. Some servers send invalid ones.
_ETAG = re.compile(r'"[\x21\x23-\x7e]{1,200}"')
_MAX_TAG = 300
_HANDLERS = (urllib.request.HTTPHandler, urllib.request.HTTPSHandler, Redirection)
# Other OSErrors come from the disk.
_NETWORK_ERRORS = (urllib.error.URLError, HTTPException, ConnectionError, TimeoutError, ssl.SSLError)


@dataclass(frozen=True)
class RemoteFile:
    """One file of the checkpoint.

    Attributes
    ----------
    name : file name, and the last part of its URL.
    size : bytes; None if unknown.
    sha256 : hex; None if unknown.
    max_size : bytes; limit where the size is unknown: a server that sends more has another file.
    """

    name: str
    size: int | None
    sha256: str | None
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

    Parameters
    ----------
    out
        Folder; created if it does not exist.
    source
        URL of a folder with the files (of OpenAI or a mirror), or a local folder.
    accept_licence
        True if the user has accepted the licence of the weights; or a function that shows its text and asks.
    files
        Files to get; sizes and hashes that are None are not checked.
    progress
        Called with file name, bytes so far, total bytes or None.
    attempts
        Limit of consecutive failures without any new data.
    wait_s
        Pause in seconds after the first failure; it doubles with each further one.

    Returns
    -------
    list[Path]
        The files.

    Raises
    ------
    UsageError
        The licence was not accepted, or `source` is neither http(s) nor a folder.
    SourceError
        A file does not exist or has another size or hash, or the server keeps failing or its answer is not valid
        HTTP. A partial download is kept as ".dancedata-NAME.part", and the next call resumes it; one that is too
        large is removed.
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
            raise DanceDataError(
                "jukebox: the file cannot be written",
                where=path,
                found=f"{error}; {shutil.disk_usage(out).free / 1e9:.1f} GB are free",
                fix="free 10.3 GB of disk space for the two files",
            ) from error
    return paths


class _Download:
    """The download of one file, over as many connections as needed."""

    def __init__(self, url: str, path: Path, file: RemoteFile, report: Progress) -> None:
        self._url = url
        self._path = path
        self._part = path.with_name(f"{PREFIX}{path.name}.part")
        # The version of the file that the part belongs to, by the server's ETag.
        self._tag = path.with_name(f"{PREFIX}{path.name}.part-etag")
        self._file = file
        self._report = report

    def run(self, attempts: int, wait_s: float) -> None:
        failures = 0
        while True:
            before = self._have()
            try:
                complete = self._connect(before)
            except _NETWORK_ERRORS as error:
                if isinstance(error, urllib.error.HTTPError) and error.code in (401, 403, 404, 410):
                    raise self._failed(error) from error
                complete, problem = False, error
            else:
                problem = ConnectionError("the connection ended early")
            if complete:
                break
            failures = 1 if self._have() > before else failures + 1
            if failures >= attempts:
                raise self._failed(problem) from problem
            time.sleep(wait_s * 2 ** (failures - 1))
        _check(self._part, self._file, keep=False, tag=self._tag)
        with atomic_file(self._path) as temporary:
            # In the same folder, so this is a rename; atomic_file then flushes it to disk and renames it again.
            self._part.replace(temporary)
        self._tag.unlink(missing_ok=True)

    def _have(self) -> int:
        return self._part.stat().st_size if self._part.exists() else 0

    def _connect(self, have: int) -> bool:
        """Append bytes of the server; return whether the file is complete."""
        request = urllib.request.Request(self._url)  # noqa: S310  (the scheme was checked)
        if have:
            request.add_header("Range", f"bytes={have}-")
            tag = self._tag.read_bytes()[:_MAX_TAG].decode("latin1") if self._tag.is_file() else ""
            if _ETAG.fullmatch(tag):
                # The server sends another version of the file from its start.
                request.add_header("If-Range", tag)
        try:
            response = opener(*_HANDLERS).open(request, timeout=_TIMEOUT_S)
        except urllib.error.HTTPError as error:
            error.close()
            if error.code != 416 or not have:
                raise
            # The part has all bytes: of this file, or of another one, which the hash shows.
            return True
        except ValueError as error:  # an invalid address, for instance of a redirection
            raise self._no_answer(shown(error)) from error
        with response:
            resumed = response.status == 206
            if resumed and not str(response.headers.get("Content-Range", "")).startswith(f"bytes {have}-"):
                got = quoted(response.headers.get("Content-Range"))
                raise HTTPException(f"asked for bytes from {have}, got {got}")
            return self._receive(response, have if resumed else 0)

    def _receive(self, response: HTTPResponse, have: int) -> bool:
        length = response.headers.get("Content-Length")
        if length is not None and not _LENGTH.fullmatch(length):
            raise self._no_answer(f"Content-Length {quoted(length, 60)}")
        total = have + int(length) if length is not None else None
        if total is not None and (
            total != self._file.size if self._file.size is not None else total > self._file.limit
        ):
            raise self._other_file(f"{total} bytes")
        tag = response.headers.get("ETag", "")
        if _ETAG.fullmatch(tag):
            self._tag.write_text(tag, encoding="ascii", newline="\n")
        elif not have:
            self._tag.unlink(missing_ok=True)
        with self._part.open("ab" if have else "wb") as part:
            while block := response.read1(_BLOCK):
                have += len(block)
                if have > self._file.limit:
                    # It is not the beginning of the right file.
                    self._part.unlink()
                    self._tag.unlink(missing_ok=True)
                    raise self._other_file("more than that")
                part.write(block)
                self._report(self._file.name, have, total)
        # A server that does not send the length ends the file by closing the connection: the known size, or else the
        # hash, shows whether the file is complete.
        expected = total if total is not None else self._file.size
        return expected is None or have >= expected

    def _failed(self, error: Exception) -> SourceError:
        return SourceError(
            "jukebox: the download failed",
            where=self._url,
            found=f"{shown(str(error))}; {self._have()} bytes downloaded",
            fix="run the same command again to resume, or choose a mirror or a folder that has the files",
        )

    def _other_file(self, found: str) -> SourceError:
        at_most = "" if self._file.size is not None else "at most "
        return SourceError(
            "the server has another file",
            where=self._url,
            found=found,
            allowed=f"{at_most}{self._file.limit} bytes",
            fix="choose another mirror or folder",
        )

    def _no_answer(self, found: str) -> SourceError:
        return SourceError(
            "the server's answer is not valid HTTP",
            where=self._url,
            found=found,
            fix="choose another mirror or folder",
        )


def _copy(source: Path, path: Path, file: RemoteFile, report: Progress) -> None:
    """Copy from another folder."""
    if not source.is_file():
        raise SourceError(
            "the folder does not have the file",
            where=source,
            found=shown(sorted(p.name for p in source.parent.iterdir())),
            allowed=file.name,
        )
    _check(source, file, keep=True)
    total = source.stat().st_size
    with atomic_file(path) as temporary, source.open("rb") as read, temporary.open("wb") as write:
        while block := read.read(_BLOCK):
            write.write(block)
            report(file.name, write.tell(), total)


def _check(path: Path, file: RemoteFile, *, keep: bool, tag: Path | None = None) -> None:
    """Compare size and hash. A wrong download is removed, or renamed if its size is right.

    Ten gigabytes are not deleted because of a hash: the user can still inspect or rename the file.
    """
    size = path.stat().st_size
    aside = path.with_suffix(".mismatch")
    if file.size is not None and size != file.size:
        what, found, allowed = "size", f"{size} bytes", f"{file.size} bytes"
    elif file.sha256 is not None and (digest := sha256_file(path)) != file.sha256:
        what, found, allowed = "SHA-256", digest, file.sha256
    else:
        return
    fix = "remove it and fetch again"
    if not keep:
        if file.size is None or what == "size":
            path.unlink()
            fix = "it was removed; fetch again, or from another mirror or folder"
        else:
            path.replace(aside)
            fix = f"it was renamed to {aside}; fetch again, or from another mirror or folder"
        if tag is not None:
            tag.unlink(missing_ok=True)
    raise SourceError(
        f"jukebox: the {what} of the file differs from the checkpoint's",
        where=path,
        found=found,
        allowed=allowed,
        fix=fix,
    )
