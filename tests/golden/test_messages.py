"""One page of errors, for their tone: every command of tests/golden/messages.txt still says what stands below it."""

import re
from pathlib import Path

import numpy as np
import pytest
import soundfile
from typer.testing import CliRunner

from dancedata.cli.app import app

PAGE = Path(__file__).with_name("messages.txt")


def files(folder: Path) -> None:
    """Write what the commands of the page find."""
    (folder / "dances" / "music").mkdir(parents=True)
    (folder / "dances" / "music" / "slow.wav").write_bytes(b"no music")
    np.savez(folder / "dances" / "a.npz", trans=np.zeros((60, 3)))
    np.save(folder / "joints.npy", np.zeros((60, 23, 3)))
    soundfile.write(folder / "song.wav", np.zeros(22_050), 22_050)
    (folder / "notes.txt").write_text("mine")
    (folder / "empty.yaml").write_text("")
    (folder / "twice.yaml").write_text("recipe: 1\nrecipe: 2\n")
    (folder / "tagged.yaml").write_text("!!python/object:os.system {}\n")
    (folder / "own.yaml").write_text("{recipe: 1, name: a, dataset: folder, windows: {length_s: 0}, motion: edge15}")
    (folder / "broken").mkdir()
    (folder / "broken" / "dataset.json").write_text("{")


def test_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    files(tmp_path)
    page = PAGE.read_text(encoding="utf-8")
    found = [page[: page.index("\n") + 1]]
    for command in re.findall(r"(?<=\n\$ dancedata ).*", page):
        text = CliRunner().invoke(app, command.split()).stderr.replace(str(tmp_path), "FOLDER")
        shortened = re.sub(r"(known: )[^;\n]+", r"\1...", text)  # lists of what is registered grow
        found.append(f"$ dancedata {command}\n{shortened}")
    (tmp_path / "messages.txt").write_text("\n".join(found), encoding="utf-8")
    assert (tmp_path / "messages.txt").read_text(encoding="utf-8") == page, "copy the new page, if it reads well"
