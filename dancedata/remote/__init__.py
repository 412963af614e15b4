"""Addresses of datasets on hubs, in buckets and on servers.

One function, `local_folder`, turns an address into a folder of the cache, which everything else reads.
"""

from dancedata.remote.address import is_address, path_text
from dancedata.remote.cached import Origin, fetch_soon, local_folder, origin_of, require_file
from dancedata.remote.fetch import PUBLICATION_FILE
from dancedata.remote.pull import Pulled, pull, require_whole

__all__ = [
    "PUBLICATION_FILE",
    "Origin",
    "Pulled",
    "fetch_soon",
    "is_address",
    "local_folder",
    "origin_of",
    "path_text",
    "pull",
    "require_file",
    "require_whole",
]
