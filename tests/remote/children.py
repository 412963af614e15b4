"""What tests run in processes that they kill."""

import os
from collections.abc import Mapping
from pathlib import Path

#: What takes most of the time of a short process.
PACKAGES = (
    "dancedata.remote.push", "dancedata.plot.map_axes", "dancedata.datasets.finedance.reader", "matplotlib.pyplot",
    "huggingface_hub.hf_api", "huggingface_hub._commit_api", "httpcore2",
)  # fmt: skip


def start(environment: Mapping[str, str]) -> None:
    from huggingface_hub import constants

    from dancedata.remote import fetch

    os.environ.update(environment)
    constants.HF_HUB_DISABLE_XET = True
    fetch.WAIT_S = 0.0


def push(environment: Mapping[str, str], store: Path, to: str) -> None:
    from dancedata.remote.push import push as run

    start(environment)
    run(store, to, rights="random numbers", progress=False)


def pull(environment: Mapping[str, str], address: str) -> None:
    from dancedata.remote.pull import pull as run

    start(environment)
    run(address, progress=False)
