"""Files of dataset repositories of the Hugging Face hub, at one commit; reasons are those of huggingface_hub."""

import os
from collections.abc import Mapping
from urllib.parse import quote, urlsplit

from dancedata.core.errors import StoreError, UsageError
from dancedata.core.packages import load
from dancedata.core.text import quoted, shown
from dancedata.core.typing import override
from dancedata.files.strict_json import parse_json
from dancedata.remote.address import Address
from dancedata.remote.client import TIMEOUT_S, Client
from dancedata.remote.source import Interrupted, NotThereError, public_line, read_within, refused

_MAX_ANSWER = 1 << 20
_LOGIN = "log in with: hf auth login, or set HF_TOKEN"


def endpoint_of(address: Address) -> str:
    """Return the URL of the hub; UsageError for one with a password or query, which errors would print."""
    hub = load("huggingface_hub", "remote", "the address of a hub")
    endpoint: str = (os.environ.get("HF_ENDPOINT") or hub.constants.ENDPOINT).rstrip("/")
    parts = urlsplit(endpoint)
    if parts.scheme not in ("http", "https") or "@" in parts.netloc or parts.query or parts.fragment:
        allowed = "https://HOST, without a password or query: the token is HF_TOKEN"
        raise UsageError("HF_ENDPOINT is not the address of a hub", where=str(address), allowed=allowed)
    return endpoint


class HubClient(Client):
    """A repository at a commit, or the hub's answer about a branch; the token goes to the hub alone."""

    @override
    def place(self) -> tuple[str, Mapping[str, str]]:
        from huggingface_hub import get_token

        self.endpoint, token = endpoint_of(self.address), get_token()
        revision, folder = quote(self.address.revision, safe=""), quote(self.address.folder)
        url = f"{self.endpoint}/datasets/{self.address.place}/resolve/{revision}" + (f"/{folder}" if folder else "")
        if not self.address.is_pinned:
            url = f"{self.endpoint}/api/datasets/{self.address.place}/revision/{revision}"
        return url, {} if token is None else {"Authorization": f"Bearer {token}"}

    @override
    def resolve(self) -> Address:
        if self.address.is_pinned:
            return self.address
        text = read_within(
            self.open("", 0).chunks,
            _MAX_ANSWER,
            lambda n: refused("the hub's answer does not end", str(self.address), f"{n:,} bytes"),
        )
        try:
            commit = parse_json(text.decode("utf-8"))["sha"]
            resolved = self.address.at(commit)
            if not resolved.is_pinned:
                raise ValueError(f"sha {quoted(commit, 60)}")
        except (ValueError, KeyError, TypeError) as error:
            found = quoted(str(error), 80)
            raise refused("the hub's answer does not name a commit", str(self.address), found) from error
        return resolved

    @override
    def failure(self, status: int, name: str) -> Exception:
        from huggingface_hub import HfApi
        from huggingface_hub.errors import HfHubHTTPError

        if status not in (401, 403, 404):
            return super().failure(status, name)
        try:  # obstore does not give the hub's reason
            api, revision = HfApi(endpoint=self.endpoint, library_name="dancedata"), self.address.revision
            api.dataset_info(self.address.place, revision=revision, timeout=TIMEOUT_S)
        except HfHubHTTPError as error:  # not its cause: the request has the token
            return self._refused(error.response.status_code, str(error.response.headers.get("X-Error-Code", "")))
        except Exception as error:  # noqa: BLE001 (those of its HTTP library)
            return Interrupted(f"HTTP {status}, then {shown(public_line(str(error)), 120)}")
        if status != 404:
            # The signed address that a hub redirects to has expired; a new one is asked for.
            return Interrupted(f"HTTP {status} of the server that the hub redirects to")
        fix = "an upload that was not finished, or a folder in the repository: hf://datasets/ORG/NAME@REVISION/FOLDER"
        return refused("the repository has no such file", f"{self.address}/{name}", "HTTP 404", fix, NotThereError)

    def _refused(self, status: int, code: str) -> StoreError:
        """Return the error for a status of the hub with its code."""
        page, found = f"{self.endpoint}/datasets/{self.address.place}", f"HTTP {status}"
        if code == "GatedRepo" or (status == 403 and not code):
            problem = "the access to this repository is granted by its authors"
            fix = f"accept its terms at {page}, then {_LOGIN}"
        elif code == "RevisionNotFound":
            problem, fix = "the repository has no such revision", f"branches, tags and commits: {page}/commits/main"
            found = self.address.revision
        elif code == "RepoNotFound" or status == 404:
            problem = "there is no such repository, or it is private"
            fix = f"check its name at {page}; if it is private, {_LOGIN}"
        else:
            problem = "the hub does not accept the token, or there is none"
            fix = f"{_LOGIN}; what was fetched before is kept"
        return refused(problem, str(self.address), found, fix)
