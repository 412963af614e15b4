"""Facts about a folder of weights, read without torch: the sizes of its network, its layers, its hashes."""

from collections.abc import Callable
from pathlib import Path

from dancedata.audio.jukebox.config import JukeboxConfig
from dancedata.core.errors import SourceError, UsageError
from dancedata.core.text import quoted, shown
from dancedata.files.regular_file import sha256_file
from dancedata.files.strict_json import read_json

VQVAE_FILE = "vqvae.pth.tar"
PRIOR_FILE = "prior_level_2.pth.tar"
#: Limit of JSON files in the folder of the weights, which have some ten kilobytes.
MAX_JSON_BYTES = 1 << 20
#: SHA-256 of OpenAI's files, as other projects report them.
SHA256 = {
    VQVAE_FILE: "69745413a48e887f8a3fe91b972a6f7f434021a1ce911a99187b331eb48c059a",
    PRIOR_FILE: "89a1dd14f5b2f9b16b3e73b53fa2138cc89fd96bb13249b4267fea471de92672",
}
LICENCE = (
    "The Jukebox weights are OpenAI's. They are published under OpenAI's Noncommercial Use License "
    "(https://github.com/openai/jukebox/blob/master/LICENSE): noncommercial use only, and anyone who passes "
    "them on must include that license. They are not part of dancedata, whose own licence does not cover them."
)
#: Sizes of a network other than the 5b model, in the folder of its weights.
SIZES_FILE = "sizes.json"


def config_of(folder: Path) -> JukeboxConfig:
    """Return the sizes of a folder's network: from sizes.json, else those of the real model."""
    path = folder / SIZES_FILE
    if not path.exists():
        return JukeboxConfig()
    try:
        return JukeboxConfig.from_json(read_json(path, MAX_JSON_BYTES))
    except (OSError, ValueError, TypeError, UsageError) as error:
        raise SourceError("the sizes of the network cannot be read", where=path, found=shown(error)) from error


def checkpoint_sha256(folder: Path | str, hash_file: Callable[[Path], str] = sha256_file) -> dict[str, str]:
    """Return the SHA-256 of OpenAI's two files, by name.

    `hash_file`: Returns the SHA-256 of a file.
    Raises SourceError: A file is missing, it is a Hugging Face model, or the files are not OpenAI's and no
        sizes.json says so.
    """
    folder = Path(folder)
    refuse_hugging_face(folder)
    missing = [name for name in (VQVAE_FILE, PRIOR_FILE) if not (folder / name).is_file()]
    if missing:
        raise SourceError("a file of Jukebox's weights is missing", where=folder,
                          found=", ".join(missing) + " not there",
                          fix="get both with `dancedata pull jukebox`")  # fmt: skip
    found = {name: hash_file(folder / name) for name in (VQVAE_FILE, PRIOR_FILE)}
    others = [name for name in found if found[name] != SHA256[name]]
    if others and not (folder / SIZES_FILE).exists():
        raise SourceError(
            "these files of Jukebox weights are not those of OpenAI",
            where=folder,
            found=", ".join(f"{name} with SHA-256 {found[name]}" for name in others),
            allowed=", ".join(SHA256[name] for name in others),
            fix=f"get them with `dancedata pull jukebox`, or write the sizes of another network into {SIZES_FILE}",
        )
    return found


def refuse_hugging_face(folder: Path) -> None:
    """Raise SourceError for a folder with one of the models from the Hugging Face hub."""
    try:
        description = read_json(folder / "config.json", MAX_JSON_BYTES)
    except (OSError, ValueError):
        return
    kind = description.get("model_type") if isinstance(description, dict) else None
    if isinstance(kind, str) and kind.startswith("jukebox"):
        raise SourceError(
            "a Jukebox model of the Hugging Face hub is another network: its prior was trained with lyrics and "
            "attends to them in additional blocks (5b: 79 instead of 72), so its activations cannot replace those of "
            "OpenAI's model",
            where=folder,
            found=f"config.json with model_type {quoted(kind)}",
            allowed=f"OpenAI's 5b model without lyrics: {VQVAE_FILE} and {PRIOR_FILE}",
            fix="get it with `dancedata pull jukebox`; it is not on the hub",
        )
