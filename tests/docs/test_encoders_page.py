"""docs/encoders.md: its code prints what it says, its keys exist, its recipe is the one it describes."""

import re
from pathlib import Path

import pytest
import yaml

from dancedata.core.resources import resource
from dancedata.recipes.parse import load_recipe, parse_recipe

PAGE = Path(__file__).parents[2] / "docs" / "encoders.md"
TEXT = PAGE.read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a random model of MERT's layout, depth and width, whose other sizes are tiny."""
    pytest.importorskip("transformers")
    from dancedata.testing.encoders import write_random_model

    made = tmp_path_factory.mktemp("encoders")
    sizes = {"hidden_size": 768, "num_hidden_layers": 12, "num_attention_heads": 2, "intermediate_size": 8}
    sizes |= {"num_conv_pos_embeddings": 4}
    write_random_model("mert", made / "mert-95m", **sizes)
    return made


def test_the_code_prints_the_output_shown(folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    (code,) = re.findall(r"^```python\n(.*?)^```", TEXT, flags=re.DOTALL | re.MULTILINE)
    (output,) = re.findall(r"^```text\n(.*?)^```", TEXT, flags=re.DOTALL | re.MULTILINE)
    exec(compile(code, "encoders.md", "exec"), {})
    assert capsys.readouterr().out == output


def test_the_ways_to_reproduce_are_recipes() -> None:
    """Every mapping of the page's table and YAML is one that a recipe may have."""
    table = TEXT.split("## Reproducing them")[1].split("## Licences")[0]
    mappings = re.findall(r"`((?:hf\.\w+|bailando438): \{.*?\})`", table)
    assert len(mappings) >= 6
    blocks = re.findall(r"^```yaml\naudio:\n(.*?)^```", TEXT, flags=re.DOTALL | re.MULTILINE)
    for audio in (*mappings, *blocks):
        document = yaml.safe_load(resource("pipelines", "finedance-mert.yaml").read_text(encoding="utf-8"))
        # At 60 and 75 rows per second windows have to be whole numbers of rows.
        windows = {"length_s": 4, "stride_s": 2}
        parse_recipe({**document, "audio": yaml.safe_load(audio), "windows": windows})


def test_the_recipe_is_finedance_with_mert() -> None:
    with_mert, plain = (load_recipe(name).document for name in ("finedance-mert", "finedance"))
    assert {key: value for key, value in with_mert["audio"].items() if key != "hf.mert"} == plain["audio"]
    assert with_mert["audio"]["hf.mert"]["layers"] == [7]
    for document in (with_mert, plain):
        del document["audio"], document["name"]
        document.pop("description", None)
    assert with_mert == plain


def test_the_page_names_every_model_type() -> None:
    pytest.importorskip("torch")
    from dancedata.audio.hf.families import FAMILIES

    listed = TEXT.split("**Models that can be read**")[1].split("\n\n")[0].split("`config.json`:")[1]
    known = {kind for family in FAMILIES for kind in family.model_types}
    assert set(re.findall(r"`([\w-]+)`", listed)) == known


def test_the_defaults_that_the_page_names(tmp_path: Path) -> None:
    """Of a random model, whose kinds the page names, too."""
    pytest.importorskip("transformers")
    from dancedata.audio.hf import HuggingFace
    from dancedata.testing.encoders import write_random_model

    for kind in ("mert", "encodec24", "muq"):
        write_random_model(kind, tmp_path / kind)
    feature = HuggingFace(model=str(tmp_path / "mert"))
    assert (feature.layers, feature.store, feature.precision) == ("last", "float16", "auto")
