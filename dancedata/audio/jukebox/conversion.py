"""A checkpoint with only the tensors that a layer needs, as safetensors: 9.3 of 10.3 GB for layer 66.

The folder::

    jukebox.json            format, config, layer, size and sha256 of every file, sha256 of the files it came from
    vqvae.safetensors       the level-2 encoder and its codebook
    tables.safetensors      embedding tables, the rows that clips look up
    block-000.safetensors   one file per transformer block, 138 MB
    ...

Names and types are those of OpenAI's files, so any safetensors reader can use them. With one file per block, reading
and writing hold one block in memory, and the first files are sufficient for a lower layer.
"""

import os
import re
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path

from dancedata.audio.jukebox.config import JukeboxConfig
from dancedata.audio.jukebox.network.tensors import (
    TensorSpec,
    block_tensors,
    prior_tensors,
    table_tensors,
    vqvae_tensors,
)
from dancedata.audio.jukebox.weights.folder import (
    DESCRIPTION_FILE,
    FORMAT,
    LICENCE,
    MAX_JSON_BYTES,
    Description,
    checkpoint_sha256,
    config_of,
    is_converted,
    read_description,
)
from dancedata.audio.jukebox.weights.loading import Checkpoint, open_openai
from dancedata.audio.jukebox.weights.sources import SafetensorsSource, TensorSource, require_tensors
from dancedata.core.errors import DanceDataError, SourceError, UsageError
from dancedata.core.packages import require
from dancedata.files.atomic import atomic_file, write_json
from dancedata.files.locks import writing_lock
from dancedata.files.publish import Layout, foreign_files, staged, tidy, writable
from dancedata.files.regular_file import sha256_file
from dancedata.files.strict_json import read_json

_VQVAE, _TABLES = "vqvae.safetensors", "tables.safetensors"
_FILES = re.compile(r"(vqvae|tables|block-[0-9]{3})\.safetensors|jukebox\.json")


def _is_complete(path: Path) -> bool:
    try:
        return bool(read_json(path, MAX_JSON_BYTES)["format"] == FORMAT)
    except (OSError, ValueError, KeyError, TypeError):
        return False


_LAYOUT = Layout(DESCRIPTION_FILE, _is_complete, lambda name: _FILES.fullmatch(name) is not None)


def convert(folder: Path | str, out: Path | str, layer: int = 66) -> Description:
    """Write the tensors of OpenAI's files that `layer` needs as a folder of safetensors files.

    Memory: one block. Files appear once all are written, jukebox.json last: without it the folder does not load.

    `folder`: With OpenAI's two files, or those of another network and its sizes.json.
    `out`: Created if it does not exist. If it holds the finished conversion of the same files, to this layer, nothing
        is done.
    `layer`: The highest layer that the conversion can compute, from 1.
    Raises SourceError: As `JukeboxEncoder`.
    Raises UsageError: `layer` is out of range, or `out` holds another conversion, or other files of the same names.
    Raises DanceDataError: `out` cannot be written, or another process is writing there.
    """
    require("jukebox", what="jukebox: a conversion")
    folder, out = Path(folder), Path(out)
    config = config_of(folder)
    if not 1 <= layer <= config.depth:
        raise UsageError("jukebox: invalid value for layer", found=layer, allowed=f"1 to {config.depth}")
    source = checkpoint_sha256(folder)  # before anything in the files is read
    checkpoint = open_openai(folder, config)
    require_tensors(checkpoint.vqvae, vqvae_tensors(config))
    require_tensors(checkpoint.prior, prior_tensors(config, layer))
    with ExitStack() as stack:
        with _writable(out):
            out.mkdir(parents=True, exist_ok=True)
            stack.enter_context(writing_lock(out, "conversion"))
        tidy(out, _LAYOUT)
        if (out / DESCRIPTION_FILE).exists():
            return _finished(out, config, layer, source)
        _refuse_others(out, [name for name, *_ in _parts(checkpoint, config, layer)])
        with staged(out, _LAYOUT) as staging:
            return write_converted(checkpoint, staging, config, layer, source)


def _refuse_others(out: Path, names: Sequence[str]) -> None:
    """Raise UsageError if the folder has files that the conversion would replace."""
    existing = [name for name in names if os.path.lexists(out / name)]
    if existing:
        problem = "jukebox: the output folder has files with the names of a conversion, but no finished conversion"
        raise foreign_files(out, existing, problem=problem, error=UsageError)


def write_converted(
    checkpoint: Checkpoint, out: Path, config: JukeboxConfig, layer: int, source: Mapping[str, str]
) -> Description:
    """Fill a folder from open sources; `source` becomes `Description.source`."""
    out.mkdir(parents=True, exist_ok=True)
    files = {}
    for name, tensors, specs in _parts(checkpoint, config, layer):
        _write(out / name, tensors, specs)
        files[name] = ((out / name).stat().st_size, sha256_file(out / name))
    description = Description(config, layer, files, source)
    write_json(
        out / DESCRIPTION_FILE,
        {
            "format": FORMAT,
            "config": config.to_json(),
            "layer": layer,
            "files": {name: {"bytes": size, "sha256": digest} for name, (size, digest) in files.items()},
            "source": dict(source),
            "licence": LICENCE,
        },
    )
    return description


def open_checkpoint(folder: Path, layer: int) -> Checkpoint:
    """Open OpenAI's files, or those of a converted folder that `layer` needs."""
    if is_converted(folder):
        return open_converted(folder, read_description(folder), layer)
    return open_openai(folder, config_of(folder))


def open_converted(folder: Path, description: Description, layer: int, *, verify: bool = False) -> Checkpoint:
    """Open the files that `layer` needs; `verify` compares the SHA-256 of each, not only its size.

    Raises SourceError: A file is missing, or its size or hash differs from jukebox.json.
    """
    files = [_VQVAE, _TABLES, *(_block_file(index) for index in range(layer))]
    for name in files:
        size, digest = description.files.get(name, (None, ""))
        path = folder / name
        stored_size = path.stat().st_size if path.is_file() else None
        if stored_size is None or stored_size != size:
            raise SourceError(
                "a file of the converted checkpoint is missing"
                if stored_size is None
                else "a file of the converted checkpoint has the wrong size",
                where=path,
                found=None if stored_size is None else f"{stored_size} bytes",
                allowed=f"{size} bytes, as in {DESCRIPTION_FILE}" if size is not None else None,
                fix="copy the folder again, or convert again",
            )
        if verify and sha256_file(path) != digest:
            raise SourceError("a file of the converted checkpoint is damaged: its SHA-256 differs from jukebox.json",
                              where=path, fix="copy the folder again, or convert again")  # fmt: skip
    source = SafetensorsSource(folder, files)
    return Checkpoint(source, source, trimmed=True)


def verify_converted(folder: Path | str) -> None:
    """Compare the SHA-256 of every file of a converted folder; SourceError names the first that differs."""
    description = read_description(Path(folder))
    open_converted(Path(folder), description, description.layer, verify=True)


def _parts(
    checkpoint: Checkpoint, config: JukeboxConfig, layer: int
) -> list[tuple[str, TensorSource, tuple[TensorSpec, ...]]]:
    blocks = [(_block_file(i), checkpoint.prior, block_tensors(config, i)) for i in range(layer)]
    return [
        (_VQVAE, checkpoint.vqvae, vqvae_tensors(config)),
        (_TABLES, checkpoint.prior, table_tensors(config, config.n_ctx)),
        *blocks,
    ]


def _block_file(index: int) -> str:
    return f"block-{index:03d}.safetensors"


def _write(path: Path, source: TensorSource, specs: tuple[TensorSpec, ...]) -> None:
    from safetensors.torch import save_file

    tensors = {spec.name: source.read(spec.name, spec.rows) for spec in specs}
    with _writable(path), atomic_file(path) as temporary:
        save_file(tensors, temporary, metadata={"format": "pt"})


def _writable(path: Path) -> AbstractContextManager[None]:
    problem = "jukebox: the converted checkpoint cannot be written"
    fix = "free about 9.4 GB of disk space for layer 66, and convert again"
    return writable(path, problem, fix, DanceDataError)


def _finished(out: Path, config: JukeboxConfig, layer: int, source: Mapping[str, str]) -> Description:
    description = read_description(out)
    if (description.config, description.layer, dict(description.source)) != (config, layer, dict(source)):
        raise UsageError("jukebox: the output folder has another conversion", where=out,
                         found=f"layer {description.layer}, of files {dict(description.source)}",
                         allowed=f"layer {layer}, of files {dict(source)}",
                         fix="choose another folder, or remove this one")  # fmt: skip
    return description
