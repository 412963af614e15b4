"""Pages on single subjects: their code prints what they show, and their lists are whole."""

import re
from pathlib import Path

import pytest
import yaml

from dancedata.core.registry import FEATURES
from dancedata.core.resources import resource
from dancedata.decoding.files import FORMATS
from dancedata.recipes.parse import parse_recipe
from tests.docs.pages import blocks, text_of, with_output


def test_a_recipe_of_the_page_has_both_rates() -> None:
    block = next(block for block in blocks("docs/reference/recipes.md", "yaml") if "both-rates" in block)
    recipe = parse_recipe(yaml.safe_load(block))
    rates = {field.name: int(field.grid.rate) for field in (*recipe.motion, *recipe.audio)}
    assert rates == {"edge151": 30, "fact219": 60, "librosa35": 30, "librosa35.60": 60, "bailando438": 60}


def test_every_feature_and_format_is_on_its_page() -> None:
    assert all(f"| `{name}` | " in text_of("docs/guides/music.md") for name in FEATURES.names())
    table = text_of("docs/guides/samples.md").split("## Decode")[1].split("\n\n")[1]
    named = {name for line in table.splitlines()[2:] for name in re.findall(r"`(\w+)`", line.split("|")[1])}
    assert named == set(FORMATS)


@pytest.fixture(scope="module")
def encoders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a random model of MERT's layout, depth and width, whose other sizes are tiny."""
    pytest.importorskip("transformers")
    from dancedata.testing.encoders import write_random_model

    made = tmp_path_factory.mktemp("encoders")
    sizes = {"hidden_size": 768, "num_hidden_layers": 12, "num_attention_heads": 2, "intermediate_size": 8}
    sizes |= {"num_conv_pos_embeddings": 4}
    write_random_model("mert", made / "mert-95m", **sizes)
    return made


def test_the_code_of_encoders_prints_the_output_shown(encoders, capsys, monkeypatch):
    monkeypatch.chdir(encoders)
    code, output = next(shown for shown in with_output("docs/guides/music.md") if "mert-95m" in shown[0])
    exec(compile(code, "music.md", "exec"), {})
    assert capsys.readouterr().out == output


def test_the_ways_to_reproduce_are_recipes() -> None:
    """Every mapping of the page's table and YAML is one that a recipe may have."""
    table = text_of("docs/guides/music.md").split("the keys that reproduce it:")[1].split("Tests ran")[0]
    mappings = re.findall(r"`((?:hf\.\w+|bailando438|jukebox): \{.*?\})`", table)
    assert len(mappings) >= 7
    written = [code.removeprefix("audio:\n") for code in blocks("docs/guides/music.md", "yaml")]
    for audio in (*mappings, *written):
        document = yaml.safe_load(resource("pipelines", "finedance-mert.yaml").read_text(encoding="utf-8"))
        # At 60 and 75 rows per second windows have to be whole numbers of rows.
        windows = {"length_s": 4, "stride_s": 2}
        parse_recipe({**document, "audio": yaml.safe_load(audio), "windows": windows})


def test_the_page_of_encoders_names_every_model_type() -> None:
    pytest.importorskip("torch")
    from dancedata.audio.hf.families import FAMILIES

    paragraph = text_of("docs/guides/music.md").split("**Models that can be read**")[1].split("\n\n")[0]
    known = {kind for family in FAMILIES for kind in family.model_types}
    assert set(re.findall(r"`([\w-]+)`", paragraph.split("`config.json`:")[1])) == known
