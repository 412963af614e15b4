"""The card: its head is YAML that hubs read, it names no path, and its recipe builds the dataset again."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from dancedata.core.errors import UsageError
from dancedata.core.hashing import recipe_hash
from dancedata.core.licence import Licence
from dancedata.formats.hub_head import hub_licence, size_category, strictest
from dancedata.plot import card_pictures
from dancedata.recipes.parse import parse_recipe
from dancedata.remote.card import write_card
from dancedata.remote.card_text import without_paths
from dancedata.store import open_store
from tests.commands import run
from tests.messages import raises_message
from tests.report.conftest import HOSTILE, demo, hostile, relabelled  # noqa: F401 (the datasets of reports)

pytest.importorskip("matplotlib")


def head_of(text: str) -> dict[str, Any]:
    assert text.startswith("---\n")
    found = yaml.safe_load(text.split("---\n")[1])
    assert isinstance(found, dict)
    return found


@pytest.fixture(scope="module")
def card(demo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:  # noqa: F811
    return write_card(demo, tmp_path_factory.mktemp("card") / "README.md", pictures=card_pictures)


def test_the_head_is_what_hubs_read(card: Path) -> None:
    head = head_of(card.read_text())
    assert head["license"] == "cc0-1.0"
    assert head["pretty_name"] == "demo"
    assert head["size_categories"] == ["n<1K"]
    assert head["task_categories"] == ["other"]
    assert {"dance", "music-to-dance"} <= set(head["tags"])
    assert "language" not in head
    files = head["configs"][0]["data_files"]
    assert [(entry["split"], entry["path"]) for entry in files] == [
        (split, f"{split}-*.h5") for split in ("train", "val", "test")
    ]


def test_the_text_has_the_numbers_of_the_dataset_and_no_paths(card: Path, demo: Path) -> None:  # noqa: F811
    text = card.read_text()
    with open_store(demo) as store:
        for split, counts in store.info["splits"].items():
            row = f"| {split} | {counts['clips']} | 0 | {counts['windows']} | {counts['songs']} |"
            assert row in text
        assert all(shard["sha256"] in text for shard in store.info["shards"])
        assert store.info["citation"].split(";")[0] in text
    assert str(Path.home()) not in text
    assert str(demo.parent) not in text
    pictures = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", text)
    assert len(pictures) == 3
    for name in pictures:
        assert (card.parent / name).read_bytes().startswith(b"\x89PNG")


def test_the_recipe_is_that_of_the_dataset(card: Path, demo: Path) -> None:  # noqa: F811
    text = re.findall(r"```yaml\n(.*?)```", card.read_text(), re.DOTALL)[0]
    with open_store(demo) as store:
        assert yaml.safe_load(text) == store.info["recipe"]
        assert parse_recipe(yaml.safe_load(text)).sha256 == recipe_hash(store.info["recipe"])


def test_two_runs_are_equal_and_other_files_are_kept(card: Path, demo: Path, tmp_path: Path) -> None:  # noqa: F811
    path = tmp_path / "README.md"
    assert "README_files" in run("export", demo, "--to", "card", "--out", path).stdout
    assert path.read_bytes() == card.read_bytes()
    for name in ("poses.png", "map.png", "beats.png"):
        assert (tmp_path / "README_files" / name).read_bytes() == (card.parent / "README_files" / name).read_bytes()
    with raises_message(UsageError, "already", where="README.md"):
        write_card(demo, path)
    write_card(demo, path, overwrite=True)
    path.write_text("# mine\n")
    with raises_message(UsageError, "refusing", where="README.md"):
        write_card(demo, path, overwrite=True)
    assert path.read_text() == "# mine\n"
    with raises_message(UsageError, "listed", where="demo/README.md"):
        write_card(demo, demo / "README.md", overwrite=True)


def test_names_of_others_stay_text(hostile: Path, tmp_path: Path) -> None:  # noqa: F811
    text = write_card(hostile, tmp_path / "README.md").read_text()
    head = head_of(text)
    assert head["pretty_name"] == HOSTILE[0]
    assert head["license"] == "other"
    body = text.split("---\n", 2)[2]
    assert not re.search(r"(?<!\\)<(?:script|img|/template)", body)
    assert "\u202e" not in text


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("CC0-1.0: generated", "cc0-1.0"), ("CC BY 4.0", "cc-by-4.0"), ("CC-BY-NC 4.0", "cc-by-nc-4.0"),
        ("CC BY-NC-SA 4.0", "cc-by-nc-sa-4.0"), ("CC BY 3.0", "other"), ("MIT", "mit"), ("unknown", "other"),
        ("CC BY 4.0; music: may not be passed on, CC BY-NC 4.0", "other"), ("for research only", "other"),
    ],
)  # fmt: skip
def test_licences_have_the_names_of_hubs(text: str, name: str) -> None:
    assert hub_licence(text) == name


def test_the_strictest_licence_of_the_clips_counts(relabelled: Any) -> None:  # noqa: F811
    terms = [Licence("CC BY 4.0", "A"), Licence("CC BY-NC-SA 4.0", "B"), Licence("CC0 1.0", "C")]
    with open_store(relabelled(lambda k: {"terms": terms[k % 3]})) as store:
        assert strictest(store) == ("cc-by-nc-sa-4.0", terms[1])
    numbers = np.array([999, 1000, 9999, 10_000])
    assert [size_category(int(n)) for n in numbers] == ["n<1K", "1K<n<10K", "1K<n<10K", "10K<n<100K"]


def test_paths_of_a_machine_are_left_out() -> None:
    text = r"read /data/u/x.npy, C:\Users\ann\a.pkl and ~/songs/a.wav; motions/*.pkl, https://a.org/b/c, 30 m/s"
    assert without_paths(text) == "read PATH, PATH and PATH; motions/*.pkl, https://a.org/b/c, 30 m/s"
