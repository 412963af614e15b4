"""A publication in a bucket: the file that makes it complete is written last, and removed first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

from dancedata.core.errors import DanceDataError, StoreError, UsageError
from dancedata.core.text import listed, shown
from dancedata.execution.progress import Progress
from dancedata.publish.contents import Upload
from dancedata.remote.address import Address
from dancedata.remote.bucket import BucketSource
from dancedata.remote.cached import check_names
from dancedata.remote.fetch import DATASET_FILE, PUBLICATION_FILE, fetch_description
from dancedata.remote.source import NotThereError, public_line, refused

#: Attribute of objects that dancedata wrote: letters alone, as Azure asks for.
_ATTRIBUTE = "dancedatasha256"
_JOBS = 6
#: Bytes of an object above which it is sent in parts, of this size.
_PART = 5 << 20
_COMPLETE = (DATASET_FILE, PUBLICATION_FILE)
_AGAIN = "run the same command again: what was uploaded is not uploaded again"


@dataclass(frozen=True)
class BucketUpload:
    """A prefix of a bucket to publish to; `overwrite` replaces another dataset, and files of others."""

    address: Address
    overwrite: bool

    def run(self, files: Sequence[Upload], progress: Progress) -> int:
        """Upload; return how many bytes were not there before."""
        source = BucketSource(self.address)
        last = [file for file in files if file.name in _COMPLETE]
        rest = [file for file in files if file not in last]
        with self._client():
            states = self._states(source, files)
            missing = [file for file, state in states if state != file.sha256]
            if not missing:
                return 0
            before, first = self._replaced(source, states)
            self._delete(source, first)
            self._put(source, [file for file in rest if file in missing], progress)
            self._delete(source, self._ours(source, sorted(before - {file.name for file in files} - set(_COMPLETE))))
            self._verify(source, rest)
            for file in last:
                self._put(source, [file], Progress(quiet=True))
            self._verify(source, last)
        return sum(file.size for file in missing)

    def _states(self, source: BucketSource, files: Sequence[Upload]) -> list[tuple[Upload, str | None]]:
        """Return each file with the hash of the object there: "" of an object of others, None without one."""
        with ThreadPoolExecutor(_JOBS, thread_name_prefix="dancedata-push") as pool:
            return list(zip(files, pool.map(lambda file: _hash_there(source, file), files), strict=True))

    def _replaced(
        self, source: BucketSource, states: Sequence[tuple[Upload, str | None]]
    ) -> tuple[set[str], list[str]]:
        """Return the names of an earlier publication, and those that make it complete, which go first.

        UsageError if it, or files of others, would be replaced.
        """
        before: set[str] = set()
        first = [name for name in _COMPLETE if _head(source, name) is not None]
        with suppress(NotThereError):
            _, document = fetch_description(source, self.address, PUBLICATION_FILE)
            check_names(document, f"{self.address}/{PUBLICATION_FILE}")
            before = {*document["files"], *_COMPLETE}
            # That of a dataset stays to the end: a run that resumes here finds the files to remove in it.
            first = first if "dataset" in document else [name for name in first if name == DATASET_FILE]
        foreign = [file.name for file, state in states if state == "" and file.name not in before]
        uploaded = {file.name for file, state in states if state == file.sha256}
        complete = [name for name in first if name not in uploaded]
        if (complete or foreign) and not self.overwrite:
            problem = "there is another dataset" if complete else "there are files that dancedata did not publish"
            fix = "publish to another prefix, or replace what is there with --overwrite"
            raise UsageError(problem, where=str(self.address), found=listed(complete or foreign), fix=fix)
        return before, first

    def _ours(self, source: BucketSource, names: Sequence[str]) -> list[str]:
        """Return the names of objects that dancedata wrote: anyone may have written what publication.json lists."""
        with ThreadPoolExecutor(_JOBS, thread_name_prefix="dancedata-push") as pool:
            heads = pool.map(partial(_head, source), names)
            return [
                name for name, there in zip(names, heads, strict=True) if there and _ATTRIBUTE in there.attributes
            ]

    def _put(self, source: BucketSource, files: Sequence[Upload], progress: Progress) -> None:
        import obstore

        def put(file: Upload) -> int:
            # An object appears at the end of its chunks, and not at all where they raise an error.
            in_parts = file.size > _PART
            obstore.put(
                source.store, file.name, file.chunks(), attributes={_ATTRIBUTE: file.sha256}, use_multipart=in_parts
            )
            return file.size

        with progress.megabytes("uploading", sum(file.size for file in files)) as count:
            pool = ThreadPoolExecutor(_JOBS, thread_name_prefix="dancedata-push")
            try:
                for size in pool.map(put, files):
                    count(size)
            finally:
                pool.shutdown(cancel_futures=True)

    def _verify(self, source: BucketSource, files: Sequence[Upload]) -> None:
        wrong = [file.name for file, state in self._states(source, files) if state != file.sha256]
        if wrong:
            raise refused(
                "the object store has other files than those uploaded", str(self.address), listed(wrong), _AGAIN
            )

    def _delete(self, source: BucketSource, names: Sequence[str]) -> None:
        import obstore

        for name in names:
            with suppress(FileNotFoundError):
                obstore.delete(source.store, name)

    @contextmanager
    def _client(self) -> Iterator[None]:
        """Translate the errors of obstore: the first line of its long texts, which holds no key."""
        from obstore import exceptions

        try:
            yield
        except DanceDataError:
            raise
        except (PermissionError, exceptions.PermissionDeniedError, exceptions.UnauthenticatedError):
            fix = "set the client's own variables (AWS_ACCESS_KEY_ID, ...) to a key that may write there"
            raise refused("the object store does not let you write", str(self.address), fix=fix) from None
        except (exceptions.BaseError, OSError) as error:
            raise self._failure(error) from None

    def _failure(self, error: Exception) -> StoreError:
        text = shown(f"{type(error).__name__}: " + public_line(str(error)), 200)
        return refused("the object store failed; no half of a publication is there", str(self.address), text, _AGAIN)


def _head(source: BucketSource, name: str) -> Any:
    import obstore
    from obstore import exceptions

    options: Any = {"head": True}
    try:
        return obstore.get(source.store, name, options=options)
    except (FileNotFoundError, exceptions.NotFoundError):
        return None


def _hash_there(source: BucketSource, file: Upload) -> str | None:
    there = _head(source, file.name)
    if there is None:
        return None
    stated = str(there.attributes.get(_ATTRIBUTE, ""))
    return stated if there.meta["size"] == file.size or stated != file.sha256 else "0"
