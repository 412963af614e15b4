"""The page on representations names all of them."""

from pathlib import Path

import pytest

from dancedata.core.registry import REPRESENTATIONS

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "representations.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", REPRESENTATIONS.names())
def test_every_representation_has_a_row(name: str) -> None:
    made = REPRESENTATIONS.get(name)()
    row = next(line for line in PAGE.splitlines() if line.startswith(f"| `{name}` |"))
    _, _, width, columns, world, rate, contacts, _, decodes, _ = (cell.strip() for cell in row.split("|"))
    assert width == "3 J" if name == "joints" else width == str(made.columns.width)
    assert ("+Z up" in world) == ("+Z up" in made.axes)
    assert ("grounded" in world) == made.grounded
    assert rate == ("the recipe's" if made.rate is None else str(made.rate))
    assert contacts == (f"`{made.default_contacts}`" if made.default_contacts else "none")
    assert (decodes == "no") == (not made.decodes)
    assert ("6D" in columns) == (made.rotation_6d is not None)
