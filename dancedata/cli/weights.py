"""Weights of networks for `dancedata pull`: OpenAI's Jukebox, and models of the Hugging Face hub."""

import re
import sys
import time
from pathlib import Path

import typer

from dancedata.cli.command import Output
from dancedata.cli.terminal import say
from dancedata.core.errors import UsageError
from dancedata.core.text import listed

#: Seconds between two lines of progress.
_INTERVAL_S = 5.0
_MODEL = re.compile(r"hf:/{1,2}(?!/?datasets/)([^@]+)(?:@(.*))?")


def are_weights(what: str, out: Path | None) -> bool:
    """Return whether weights are asked for; the address of a dataset goes without a folder."""
    from dancedata.files.addresses import is_address

    is_place = out is not None and (what.startswith(("http:", "https:")) or not is_address(what))
    return what == "jukebox" or _MODEL.fullmatch(what) is not None or is_place


def pull_weights(what: str, out: Path, *, accept_licence: bool, progress: bool) -> Output:
    """Fetch weights into a folder."""
    model = _MODEL.fullmatch(what)
    if model:
        return _model(model[1], model[2], out)
    return _jukebox(what, out, accept_licence=accept_licence, progress=progress)


def _model(name: str, revision: str | None, out: Path) -> Output:
    from dancedata.audio.hf.fetch import fetch_model

    def show(licence: str) -> None:
        say(f"note: {name}: licence of the weights: {licence}", err=True)

    model = fetch_model(name, revision, out, show_licence=show)
    text = f"{model.path}: {model.id} at {model.revision}, {len(model.files)} files; licence: {model.licence}"
    pickled = [name for name in model.files if name.endswith(".bin")]
    notes = [f"note: pickles, which are read as data and not run: {listed(pickled)}"] if pickled else []
    left_out = [f"left out: {listed(model.left_out, 100)}"] if model.left_out else []
    return Output(model.to_json, lambda: "\n".join([text, *notes, *left_out]))


def _jukebox(what: str, out: Path, *, accept_licence: bool, progress: bool) -> Output:
    from dancedata.audio.jukebox import fetch
    from dancedata.audio.jukebox.weights.download import OPENAI_URL

    def agreed(licence: str) -> bool:
        typer.echo(licence, err=True)
        asked = sys.stdin.isatty() and not accept_licence
        return typer.confirm("Do you agree? (--accept-licence answers yes)", err=True) if asked else accept_licence

    if not (Path(what).is_dir() or what == "jukebox" or what.startswith(("http:", "https:"))):
        raise UsageError(
            "no such weights", found=what, allowed="jukebox, a folder or address of its files, hf://MODEL@SHA"
        )
    address = OPENAI_URL if what == "jukebox" else what
    files = fetch(out, address, accept_licence=agreed, progress=_Lines() if progress else None)
    n_bytes = sum(path.stat().st_size for path in files)
    about = {"path": str(out), "files": [path.name for path in files], "bytes": n_bytes}
    return Output(lambda: about, lambda: f"{out}: {len(files)} files, {n_bytes / 1e9:.2f} GB")


class _Lines:
    """Prints the progress of a download, a line every few seconds."""

    def __init__(self) -> None:
        self.last = 0.0

    def __call__(self, name: str, done: int, total: int | None) -> None:
        now = time.monotonic()
        if now - self.last >= _INTERVAL_S or done == total:
            self.last = now
            of = "" if total is None else f" of {total / 1e6:.0f}"
            say(f"{name}: {done / 1e6:.0f}{of} MB", err=True)
