"""Files of dataset repositories of the Hugging Face hub, at one commit."""

import os
from collections.abc import Mapping
from typing import Any
from urllib.parse import quote, urlsplit

from dancedata.core.errors import StoreError, UsageError
from dancedata.core.packages import require
from dancedata.core.text import quoted
from dancedata.core.typing import override
from dancedata.files.strict_json import parse_json
from dancedata.remote.address import Address
from dancedata.remote.http import HttpSource, body
from dancedata.remote.source import NotThereError, read_within, refused

_MAX_ANSWER = 1 << 20
_LOGIN = "log in with: hf auth login, or set HF_TOKEN"


class HubSource(HttpSource):
    """A repository; the token is that of huggingface_hub, and goes to the hub alone."""

    def __init__(self, address: Address) -> None:
        require("remote", ("huggingface_hub",), what="the address of a hub")
        from huggingface_hub import constants

        super().__init__(address)
        self.endpoint = (os.environ.get("HF_ENDPOINT") or constants.ENDPOINT).rstrip("/")
        parts = urlsplit(self.endpoint)
        # Not repeated: it may hold a password, which errors of the client would print.
        if parts.scheme not in ("http", "https") or "@" in parts.netloc or parts.query or parts.fragment:
            allowed = "https://HOST, without a password or query: the token is HF_TOKEN"
            raise UsageError("HF_ENDPOINT is not the address of a hub", where=str(address), allowed=allowed)
        folder = f"{quote(address.folder)}/" if address.folder else ""
        self.base = f"{self.endpoint}/datasets/{address.place}/resolve/{quote(address.revision, safe='')}/{folder}"

    @override
    def headers(self) -> Mapping[str, str]:
        from huggingface_hub import get_token

        token = get_token()  # asked for each time: it may have been renewed
        return {} if token is None else {"Authorization": f"Bearer {token}"}

    @override
    def resolve(self) -> Address:
        if self.address.is_pinned:
            return self.address
        revision = quote(self.address.revision, safe="")
        url = f"{self.endpoint}/api/datasets/{self.address.place}/revision/{revision}"
        text = read_within(
            body(self.request(url, "")),
            _MAX_ANSWER,
            lambda n: refused("the hub's answer does not end", str(self.address), f"{n:,} bytes"),
        )
        try:
            commit = parse_json(text.decode("utf-8"))["sha"]
            resolved = self.address.at(commit)
            if not resolved.is_pinned:
                raise ValueError(f"sha {quoted(commit, 60)}")
        except (ValueError, KeyError, TypeError) as error:
            raise refused(
                "the hub's answer does not name a commit", str(self.address), quoted(str(error), 80)
            ) from error
        return resolved

    @override
    def failure(self, status: int, headers: Any, name: str) -> StoreError:
        code, page = str(headers.get("X-Error-Code", "")), f"{self.endpoint}/datasets/{self.address.place}"
        found = f"HTTP {status}"
        if code == "GatedRepo" or (status == 403 and not code):
            fix = f"accept its terms at {page}, then {_LOGIN}"
            return refused("the access to this repository is granted by its authors", str(self.address), found, fix)
        if code == "RevisionNotFound":
            fix = f"branches, tags and commits: {page}/commits/main"
            return refused("the repository has no such revision", str(self.address), self.address.revision, fix)
        if code == "EntryNotFound":
            fix = "an upload that was not finished, or a folder in the repository: hf://datasets/ORG/NAME@REVISION/FOLDER"
            return refused("the repository has no such file", f"{self.address}/{name}", found, fix, NotThereError)
        if code == "RepoNotFound" or status == 404:
            fix = f"check its name at {page}; if it is private, {_LOGIN}"
            return refused("there is no such repository, or it is private", str(self.address), found, fix)
        if status in (401, 403):
            fix = f"{_LOGIN}; what was fetched before is kept"
            return refused("the hub does not accept the token, or there is none", str(self.address), found, fix)
        return super().failure(status, headers, name)
