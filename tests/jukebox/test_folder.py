"""A folder of weights: its hashes and sizes, read without torch."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.messages import raises_message

pytest.importorskip("torch")
pytest.importorskip("accelerate")

from dancedata.audio.jukebox import JukeboxEncoder, checkpoint_sha256
from dancedata.audio.jukebox.weights.folder import PRIOR_FILE, VQVAE_FILE
from dancedata.core.errors import SourceError, UsageError
from dancedata.files.regular_file import sha256_file


def test_the_facts_of_a_folder_need_no_torch(tiny: SimpleNamespace) -> None:
    code = (
        "import sys; from pathlib import Path; from dancedata.audio.jukebox.weights import folder; "
        "path = Path(sys.argv[1]); print(folder.config_of(path).depth, len(folder.checkpoint_sha256(path))); "
        "assert not {'torch', 'accelerate', 'safetensors'} & set(sys.modules)"
    )
    command = [sys.executable, "-c", code, str(tiny.folder)]
    assert subprocess.run(command, check=True, capture_output=True, text=True).stdout == "6 2\n"
    assert checkpoint_sha256(tiny.folder) == {f: sha256_file(tiny.folder / f) for f in (VQVAE_FILE, PRIOR_FILE)}


def test_the_hash_of_missing_weights(tmp_path: Path) -> None:
    with raises_message(SourceError, "Jukebox"):
        checkpoint_sha256(tmp_path)


def test_files_that_are_not_openais_are_not_read(tiny: SimpleNamespace, tmp_path: Path) -> None:
    for name in (VQVAE_FILE, PRIOR_FILE):
        (tmp_path / name).write_bytes(b"a pickle that takes forever")
    with raises_message(SourceError, "OpenAI.*sizes", where=tmp_path.name):
        checkpoint_sha256(tmp_path)
    (tmp_path / "sizes.json").write_bytes((tiny.folder / "sizes.json").read_bytes())
    assert set(checkpoint_sha256(tmp_path)) == {VQVAE_FILE, PRIOR_FILE}


def test_layers_beyond_the_network(tiny: SimpleNamespace) -> None:
    assert JukeboxEncoder(tiny.folder, device="cpu", max_codes=64).layers == (6,)
    with raises_message(UsageError, "layers"):
        JukeboxEncoder(tiny.folder, layers=(7,), device="cpu")
