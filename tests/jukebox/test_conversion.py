import json
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.messages import raises_message

pytest.importorskip("torch")
pytest.importorskip("accelerate")
pytest.importorskip("safetensors")

import torch
from safetensors.torch import load_file

from dancedata.audio.jukebox import JukeboxEncoder, checkpoint_sha256, conversion, convert
from dancedata.audio.jukebox.weights.folder import PRIOR_FILE, VQVAE_FILE
from dancedata.core.errors import SourceError, StoreError, UsageError
from dancedata.files.locks import writing_lock
from dancedata.files.regular_file import sha256_file


@pytest.fixture(scope="module")
def converted(tiny: SimpleNamespace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("converted")
    convert(tiny.folder, folder, 4)
    return folder


@pytest.fixture
def copy(converted: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(converted, tmp_path / "copy"))


def test_files_and_description(tiny: SimpleNamespace, converted: Path) -> None:
    blocks = [f"block-00{i}.safetensors" for i in range(4)]
    names = [*blocks, "jukebox.json", "tables.safetensors", "vqvae.safetensors"]
    assert sorted(p.name for p in converted.iterdir()) == names
    description = json.loads((converted / "jukebox.json").read_text())
    assert description["layer"] == 4
    assert "Noncommercial" in description["licence"]
    for name, what in description["files"].items():
        assert what == {"bytes": (converted / name).stat().st_size, "sha256": sha256_file(converted / name)}
    assert description["source"] == {f: sha256_file(tiny.folder / f) for f in (VQVAE_FILE, PRIOR_FILE)}
    assert checkpoint_sha256(converted) == checkpoint_sha256(tiny.folder) == description["source"]


def test_the_facts_of_a_folder_need_no_torch(tiny: SimpleNamespace, converted: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from dancedata.audio.jukebox.weights import folder; "
        "paths = [Path(p) for p in sys.argv[1:]]; print([folder.highest_layer(p) for p in paths]); "
        "assert folder.config_of(paths[0]) == folder.config_of(paths[1]); "
        "assert folder.checkpoint_sha256(paths[0]) == folder.checkpoint_sha256(paths[1]); "
        "assert not {'torch', 'accelerate', 'safetensors'} & set(sys.modules)"
    )
    command = [sys.executable, "-c", code, str(tiny.folder), str(converted)]
    assert subprocess.run(command, check=True, capture_output=True, text=True).stdout == "[6, 4]\n"


def test_files_that_are_not_openais_are_not_read(tiny: SimpleNamespace, tmp_path: Path) -> None:
    for name in (VQVAE_FILE, PRIOR_FILE):
        (tmp_path / name).write_bytes(b"a pickle that takes forever")
    for read in (checkpoint_sha256, lambda folder: convert(folder, tmp_path / "out", 4)):
        with raises_message(SourceError, "OpenAI.*sizes", where=tmp_path.name):
            read(tmp_path)
    (tmp_path / "sizes.json").write_bytes((tiny.folder / "sizes.json").read_bytes())
    assert set(checkpoint_sha256(tmp_path)) == {VQVAE_FILE, PRIOR_FILE}


def test_tensors_are_the_originals_with_the_needed_rows(tiny: SimpleNamespace, converted: Path) -> None:
    originals = {**tiny.tensors[VQVAE_FILE], **tiny.tensors[PRIOR_FILE]}
    tensors = {k: v for path in converted.glob("*.safetensors") for k, v in load_file(path).items()}
    assert len(tensors) == 4 * 12 + 7 + 133
    for name, tensor in tensors.items():
        assert tensor.dtype == originals[name].dtype
        assert torch.equal(tensor, originals[name][: len(tensor)])
    assert tensors["y_emb.artist_emb.emb.weight"].shape == (1, 40)
    assert not [name for name in tensors if "_attn_mods.4" in name or "x_out" in name]


def test_same_features(tiny: SimpleNamespace, converted: Path, noise: np.ndarray) -> None:
    direct = JukeboxEncoder(tiny.folder, layers=(4, 2), device="cpu")(noise, 44100)
    again = JukeboxEncoder(converted, layers=(4, 2), device="cpu")(noise, 44100)
    assert tuple(again) == (4, 2)
    for layer, expected in direct.items():
        np.testing.assert_array_equal(again[layer], expected)
    assert JukeboxEncoder(converted, device="cpu", max_codes=64).layers == (4,)


def test_a_part_of_the_folder_is_enough_for_a_lower_layer(copy: Path) -> None:
    (copy / "block-003.safetensors").unlink()
    JukeboxEncoder(copy, layers=(3,), device="cpu", max_codes=64)
    with raises_message(SourceError, "converted", where="copy/block-003.safetensors"):
        JukeboxEncoder(copy, device="cpu")


def test_second_time_does_nothing(tiny: SimpleNamespace, copy: Path) -> None:
    before = {p.name: p.stat().st_mtime_ns for p in copy.iterdir()}
    convert(tiny.folder, copy, 4)
    assert before == {p.name: p.stat().st_mtime_ns for p in copy.iterdir()}
    with pytest.raises(UsageError, match="has another conversion; found layer 4"):
        convert(tiny.folder, copy, 5)
    with pytest.raises(UsageError, match="1 to 6"):
        convert(tiny.folder, copy, 7)


def test_interrupted_conversion_does_not_load_and_can_be_repeated(tiny, tmp_path, monkeypatch):
    original = conversion._write

    def stops(path: Path, *rest: object) -> None:
        if path.name == "block-002.safetensors":
            raise KeyboardInterrupt
        original(path, *rest)

    monkeypatch.setattr(conversion, "_write", stops)
    with pytest.raises(KeyboardInterrupt):
        convert(tiny.folder, tmp_path / "out", 4)
    with raises_message(SourceError, "conversion", where="out/vqvae.pth.tar"):
        JukeboxEncoder(tmp_path / "out", device="cpu")
    monkeypatch.undo()
    convert(tiny.folder, tmp_path / "out", 4)
    JukeboxEncoder(tmp_path / "out", device="cpu", max_codes=64)


@pytest.mark.parametrize("name", ["vqvae.safetensors", "block-001.safetensors"])
def test_foreign_files_are_not_replaced(tiny: SimpleNamespace, tmp_path: Path, name: str) -> None:
    (tmp_path / "out").mkdir()
    for mine in (name, "notes.txt"):
        (tmp_path / "out" / mine).write_text("somebody's")
    with raises_message(UsageError, "conversion", where="out"):
        convert(tiny.folder, tmp_path / "out", 4)
    assert sorted(p.name for p in tmp_path.rglob("*")) == sorted(["out", name, "notes.txt"])
    assert (tmp_path / "out" / name).read_text() == "somebody's"
    (tmp_path / "out" / name).unlink()
    convert(tiny.folder, tmp_path / "out", 4)
    assert (tmp_path / "out" / "notes.txt").read_text() == "somebody's"
    assert not [p for p in tmp_path.rglob(".dancedata-*")]


def test_a_second_conversion_into_one_folder_fails_at_once(tiny: SimpleNamespace, tmp_path: Path) -> None:
    with (
        writing_lock(tmp_path / "out", "conversion"),
        pytest.raises(StoreError, match="another conversion is writing"),
    ):
        convert(tiny.folder, tmp_path / "out", 4)


def test_damaged_files(copy: Path) -> None:
    """Cut or without a header they do not load; one flipped bit is found by the hash."""
    conversion.verify_converted(copy)
    path = copy / "tables.safetensors"
    whole = path.read_bytes()
    for damaged in (whole[:-100], b"\xff" * 8 + whole[8:]):
        path.write_bytes(damaged)
        with raises_message(SourceError, "converted|cannot be read", where="copy/tables.safetensors"):
            JukeboxEncoder(copy, device="cpu")
    path.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    with raises_message(SourceError, "damaged", where="copy/tables.safetensors"):
        conversion.verify_converted(copy)


@pytest.mark.parametrize(
    ("change", "message"),
    [({"format": 2}, "another format version; found 2; allowed: 1"), ({"config": {}}, "damaged"),
     ({"files": []}, "damaged"), ({"layer": "x"}, "damaged")],
)  # fmt: skip
def test_damaged_description(copy: Path, change: dict[str, object], message: str) -> None:
    description = json.loads((copy / "jukebox.json").read_text())
    (copy / "jukebox.json").write_text(json.dumps({**description, **change}))
    with pytest.raises(SourceError, match=message):
        JukeboxEncoder(copy, device="cpu")


def test_full_disk_leaves_nothing_half(tiny, tmp_path, monkeypatch):
    def full(tensors: object, path: Path, metadata: object) -> None:
        Path(path).write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("safetensors.torch.save_file", full)
    with pytest.raises(Exception, match=r"vqvae\.safetensors: .* cannot be written; found .*No space left"):
        convert(tiny.folder, tmp_path / "out", 1)
    assert list((tmp_path / "out").iterdir()) == []
