"""A publication on a hub: one commit with all files, then a tag; huggingface_hub uploads.

Files go to the hub's storage first, where no one sees them, and those that are there already are not sent again. The
commit then names them all, so that a branch has all of a publication or none.
"""

from __future__ import annotations

import hashlib
import logging
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from dancedata.core.errors import DanceDataError, StoreError, UsageError
from dancedata.core.packages import load
from dancedata.core.text import counted, listed, shown
from dancedata.kernel import DatasetFiles, Progress
from dancedata.remote.address import Address
from dancedata.remote.card import PICTURE_FILES
from dancedata.remote.card_text import MARK
from dancedata.remote.contents import PICTURES, Upload, changed
from dancedata.remote.fetch import fetch_description, read_small
from dancedata.remote.hub import HubClient, endpoint_of
from dancedata.remote.source import NotThereError, public_line, refused

if TYPE_CHECKING:
    from huggingface_hub import HfApi

#: Seconds without an answer after which a request is given up; the client itself waits for ever.
TIMEOUT_S = 120.0
#: Files that are handed to the client at once.
_BATCH = 16
#: Paths that the hub is asked for at once.
_ASKED = 500
#: Logs with the addresses of requests, which are signed, and with their headers.
_LOGS = ("huggingface_hub", "httpx", "httpx2", "httpcore", "httpcore2")
_AGAIN = "run the same command again: what was uploaded is not uploaded again"
_LOGIN = "log in with a token that may write: hf auth login, or HF_TOKEN"


@dataclass(frozen=True)
class HubUpload:
    """A repository to publish to; `private` and `gated` are set before anything is uploaded."""

    address: Address  # repository, branch and folder
    tag: str  # name of the tag of the commit
    private: bool
    gated: bool
    overwrite: bool  # whether files of others with the same names are replaced

    def run(self, files: Sequence[Upload], message: str, progress: Progress) -> tuple[Address, int]:
        """Upload; return the address with the commit, and how many bytes were not there before."""
        from huggingface_hub import HfApi, get_token

        if get_token() is None:
            raise UsageError("there is no token for the hub", where=str(self.address), fix=_LOGIN)
        api = HfApi(endpoint=endpoint_of(self.address), library_name="dancedata")
        with self._client():
            head = self._prepared(api)
        before = self._published_before(head)
        there = self._files(api, head, [*(self._path(file.name) for file in files), *before])
        missing = [file for file in files if not _is_there(file, there.get(self._path(file.name)))]
        stale = self._replaced(before, there, files)
        commit = head
        if missing or stale:
            commit = self._commit(api, head, missing, stale, message, progress)
        self._verify(self._files(api, commit, [self._path(file.name) for file in files]), files, commit)
        with self._client():
            self._tag(api, commit)
        return self.address.at(commit), sum(file.size for file in missing)

    def _path(self, name: str) -> str:
        return f"{self.address.folder}/{name}" if self.address.folder else name

    def _prepared(self, api: HfApi) -> str:
        """Create the repository and the branch where they are missing; return the branch's commit."""
        repo, kind = self.address.place, "dataset"
        api.create_repo(repo, repo_type=kind, private=self.private or None, exist_ok=True)
        if self.private or self.gated:
            api.update_repo_settings(
                repo, repo_type=kind, gated="auto" if self.gated else None, private=self.private or None
            )
            info = api.dataset_info(repo)
            unset = [name for name in ("private", "gated") if getattr(self, name) and not getattr(info, name)]
            if unset:
                raise refused(
                    f"the hub did not make the repository {unset[0]}; nothing was uploaded", str(self.address)
                )
        refs = api.list_repo_refs(repo, repo_type=kind)
        branches = {ref.name: ref.target_commit for ref in refs.branches}
        if self.address.revision not in branches:
            api.create_branch(repo, repo_type=kind, branch=self.address.revision)
            refs = api.list_repo_refs(repo, repo_type=kind)
            branches = {ref.name: ref.target_commit for ref in refs.branches}
        head = branches[self.address.revision]
        tagged = next((ref.target_commit for ref in refs.tags if ref.name == self.tag), head)
        if tagged != head:
            raise UsageError(f"the repository has the tag {self.tag} for another upload", where=str(self.address),
                             fix="remove the tag, or publish to another repository")  # fmt: skip
        return head

    def _files(self, api: HfApi, commit: str, paths: Sequence[str]) -> dict[str, Any]:
        """Return the hub's entries at these paths."""
        at_path: dict[str, Any] = {}
        names = list(dict.fromkeys(paths))
        for begin in range(0, len(names), _ASKED):
            with self._client():
                entries = api.get_paths_info(
                    self.address.place, names[begin : begin + _ASKED], revision=commit, repo_type="dataset"
                )
                at_path |= {entry.path: entry for entry in entries if hasattr(entry, "size")}
        return at_path

    def _replaced(self, before: set[str], there: Mapping[str, Any], files: Sequence[Upload]) -> list[str]:
        """Return files of an earlier publication that this one does not have; UsageError for files of others."""
        names = {self._path(file.name): file for file in files}
        taken = [p for p, f in names.items() if p in there and p not in before and not _is_there(f, there[p])]
        if taken and not self.overwrite:
            raise UsageError(
                "the repository has files of these names that dancedata did not publish there",
                where=str(self.address), found=listed(taken),
                fix="publish to another repository or folder, or replace them with --overwrite",
            )  # fmt: skip
        return sorted(before & there.keys() - names.keys())

    def _published_before(self, head: str) -> set[str]:
        """Return the paths of an earlier publication and its card; empty if there are none."""
        source, before = HubClient(self.address.at(head)), set()
        with suppress(NotThereError):
            _, document = fetch_description(source, source.address, DatasetFiles.PUBLICATION)
            DatasetFiles.of(document, f"{source.address}/{DatasetFiles.PUBLICATION}")
            before = {*document["files"], DatasetFiles.PUBLICATION, DatasetFiles.DATASET}
        with suppress(NotThereError):
            if MARK.encode() in read_small(source, DatasetFiles.CARD, f"{source.address}/{DatasetFiles.CARD}"):
                before |= {DatasetFiles.CARD, *(f"{PICTURES}/{name}" for name in PICTURE_FILES)}
        return {self._path(name) for name in before}

    def _commit(
        self, api: HfApi, head: str, files: Sequence[Upload], stale: Sequence[str], message: str, progress: Progress
    ) -> str:
        from huggingface_hub import CommitOperationAdd, CommitOperationDelete

        additions = [CommitOperationAdd(self._path(file.name), _content(file)) for file in files]
        for file, addition in zip(files, additions, strict=True):
            if addition.upload_info.sha256.hex() != file.sha256:
                raise changed(file.name)
        with progress.megabytes("uploading", sum(file.size for file in files)) as count:
            for begin in range(0, len(additions), _BATCH):
                with self._client():
                    batch = additions[begin : begin + _BATCH]
                    api.preupload_lfs_files(self.address.place, batch, repo_type="dataset",
                                            revision=self.address.revision, free_memory=False)  # fmt: skip
                count(sum(file.size for file in files[begin : begin + _BATCH]))
        deletions = [CommitOperationDelete(path, is_folder=False) for path in stale]
        with self._client():
            info = api.create_commit(
                self.address.place, [*additions, *deletions], commit_message=message, repo_type="dataset",
                revision=self.address.revision, parent_commit=head,
            )  # fmt: skip
        commit = str(info.oid)
        if not self.address.at(commit).is_pinned:
            raise refused("the hub's answer does not name a commit", str(self.address), shown(commit, 60))
        return commit

    def _verify(self, there: Mapping[str, Any], files: Sequence[Upload], commit: str) -> None:
        """Compare size and hash of every file at the commit, as the hub states them."""
        wrong = [file.name for file in files if not _is_there(file, there.get(self._path(file.name)))]
        if wrong:
            raise refused(
                "the hub has other files than those that were uploaded", str(self.address.at(commit)),
                f"{counted(len(wrong), 'file')}: {listed(wrong)}",
                "check that .gitignore of the repository names none of them, and run the same command again",
            )  # fmt: skip

    def _tag(self, api: HfApi, commit: str) -> None:
        repo = self.address.place
        tags = {ref.name: ref.target_commit for ref in api.list_repo_refs(repo, repo_type="dataset").tags}
        if self.tag not in tags:
            api.create_tag(repo, tag=self.tag, revision=commit, repo_type="dataset")
        elif tags[self.tag] != commit:
            raise refused(f"the files are published, but the tag {self.tag} was given to another commit meanwhile",
                          str(self.address.at(commit)), tags[self.tag], "remove the tag, and try again")  # fmt: skip

    @contextmanager
    def _client(self) -> Iterator[None]:
        """Give the client a timeout, silence its bars and logs, and translate its errors."""
        from huggingface_hub import get_session

        utils = load("huggingface_hub.utils", "remote")
        session, has_bars = get_session(), not utils.are_progress_bars_disabled()
        levels, timeout = {log: log.level for log in map(logging.getLogger, _LOGS)}, session.timeout
        for log in levels:
            log.setLevel(logging.CRITICAL)
        session.timeout = TIMEOUT_S
        if has_bars:
            utils.disable_progress_bars()
        try:
            with warnings.catch_warnings():
                # Warnings about the client's own calls to its HTTP library.
                warnings.simplefilter("ignore", DeprecationWarning)
                yield
        except DanceDataError:
            raise
        except Exception as error:  # noqa: BLE001 (those of its HTTP library, and of malformed answers)
            raise self._failure(error) from None  # the request has the token
        finally:
            for log, level in levels.items():
                log.setLevel(level)
            session.timeout = timeout
            if has_bars:
                utils.enable_progress_bars()

    def _failure(self, error: BaseException) -> StoreError:
        while error.__cause__ is not None and getattr(error, "response", None) is None:
            error = error.__cause__
        status = getattr(getattr(error, "response", None), "status_code", None)
        text = str(getattr(error, "server_message", "") or "") if status else f"{type(error).__name__}: {error}"
        found = ": ".join(filter(None, (f"HTTP {status}" if status else "", without_secrets(text))))
        if status == 401:
            return refused("the hub does not accept the token", str(self.address), found, f"{_LOGIN}; {_AGAIN}")
        if status == 403:
            return refused("the token may not do this in the repository", str(self.address), found, _LOGIN)
        if status in (409, 412):
            return refused("the repository was changed during the upload", str(self.address), found, _AGAIN)
        return refused("the hub failed; no part of the upload is visible there", str(self.address), found, _AGAIN)


def without_secrets(text: str) -> str:
    """Return a server's text without the token and without signatures in addresses."""
    from huggingface_hub import get_token

    token = get_token()
    return shown(public_line(text if not token else text.replace(token, "...")), 300)


def _content(file: Upload) -> str | bytes:
    return file.content if isinstance(file.content, bytes) else str(file.content)


def _is_there(file: Upload, entry: Any) -> bool:
    """Return whether an entry of the hub's tree has the bytes of a file."""
    if entry is None or entry.size != file.size:
        return False
    if entry.lfs is not None:
        return bool(entry.lfs.sha256 == file.sha256)
    # A file in git itself, which is small: its name is the hash of its bytes.
    data = file.content if isinstance(file.content, bytes) else file.content.read_bytes()
    return bool(entry.blob_id == hashlib.sha1(b"blob %d\0" % len(data) + data, usedforsecurity=False).hexdigest())
