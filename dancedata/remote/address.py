"""Addresses of datasets: hf://datasets/ORG/NAME@REVISION, s3://, gs:// and az://BUCKET/PREFIX, https://HOST/PATH."""

import re
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import unquote, urlsplit

from dancedata.core.errors import UsageError
from dancedata.core.text import shown

ALLOWED = (
    "hf://datasets/ORG/NAME@REVISION, s3://BUCKET/PREFIX, gs://BUCKET/PREFIX, az://CONTAINER/PREFIX, "
    "https://HOST/FOLDER"
)
# A Path has one slash after the colon.
_SCHEME = re.compile(r"(?P<scheme>hf|s3|gs|az|https?|ftp|file|memory):/{1,2}(?=[^/])", re.IGNORECASE)
_HUB = re.compile(
    r"datasets/(?P<name>[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*)(@(?P<revision>[^/@]+))?(?P<folder>(/[^/]+)*)/?"
)
_COMMIT = re.compile(r"[0-9a-f]{40}")
#: Schemes of object stores.
BUCKETS = ("s3", "gs", "az")
#: Hosts of this machine, for which http is allowed.
LOOPBACK = ("localhost", "127.0.0.1", "::1")


@dataclass(frozen=True)
class Address:
    """The place of a dataset."""

    scheme: str  # hf, s3, gs, az, https or, on this machine, http
    place: str  # repository ORG/NAME of a hub; else bucket or host, and the folder in it
    folder: str = ""  # folder in a repository; "" for its top
    revision: str = ""  # branch, tag or commit of a repository; "" elsewhere

    def __str__(self) -> str:
        if self.scheme != "hf":
            return f"{self.scheme}://{self.place}"
        return f"hf://datasets/{self.place}@{self.revision}" + (f"/{self.folder}" if self.folder else "")

    @property
    def is_pinned(self) -> bool:
        """Whether the revision is a commit, which does not change."""
        return _COMMIT.fullmatch(self.revision) is not None

    def at(self, commit: str) -> "Address":
        """Return the address of one commit."""
        return replace(self, revision=commit)


def parse_address(text: str | Path) -> Address:
    """Parse an address; UsageError for an invalid one; a password or signature is not repeated."""
    match = _SCHEME.match(str(text))
    if match is None:
        raise _invalid(str(text))
    scheme, rest = match["scheme"].lower(), str(text)[match.end() :]
    whole = f"{scheme}://{rest}"
    try:
        parts = urlsplit(whole)
    except ValueError:  # [ without ]
        raise _invalid(f"{scheme}://{rest.rpartition('@')[2]}") from None
    if "@" in parts.netloc or parts.query or parts.fragment:
        raise UsageError(
            "an address does not hold a password, signature or query",
            where=f"{scheme}://{parts.netloc.rpartition('@')[2]}",
            fix="put credentials where the client finds them: its environment variables or its login",
        )
    if scheme == "hf":
        hub = _HUB.fullmatch(rest)
        if hub is None or ".." in hub["folder"].split("/"):
            raise _invalid(whole)
        return Address("hf", hub["name"], hub["folder"].strip("/"), unquote(hub["revision"] or "main"))
    if scheme == "http" and parts.hostname not in LOOPBACK:
        raise UsageError("an address on another machine must be encrypted", where=shown(whole), fix="use https://")
    if scheme not in (*BUCKETS, "https", "http") or ".." in rest.split("/"):
        raise _invalid(whole)
    return Address(scheme, rest.rstrip("/"))


def _invalid(text: str) -> UsageError:
    return UsageError("not an address of a dataset", found=shown(text), allowed=ALLOWED)
