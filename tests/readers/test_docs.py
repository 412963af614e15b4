"""The code of docs/reading.md runs."""

import re
from pathlib import Path

import pytest

pytest.importorskip("torch")

from dancedata.store.dataset import Store
from tests.groups_store import write_groups

PAGE = Path(__file__).parents[2] / "docs" / "reading.md"


@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
@pytest.mark.filterwarnings("ignore:This DataLoader will create:UserWarning")
def test_code_of_the_page_runs(
    store_path: Path, beats_store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_groups(tmp_path / "data" / "groups")
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(blocks) >= 5
    names: dict[str, object] = {"OUT": store_path, "BEATS": beats_store}
    for block in blocks:
        if "import Accelerator" not in block:  # not a dependency of the tests
            exec(compile(block, str(PAGE), "exec"), names)
    assert names["state"] == {"epoch": 0, "position": 16}
