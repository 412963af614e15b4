import copy
import json
import subprocess
import sys

import pytest

from dancedata.audio.jukebox import JukeboxConfig
from dancedata.core.errors import UsageError
from tests.messages import raises_message

# The 5b model in OpenAI's names.
HPARAMS = {
    "vqvae": {
        "downs_t": [3, 2, 2], "strides_t": [2, 2, 2], "emb_width": 64, "l_bins": 2048, "width": 32, "depth": 4,
        "hvqvae_multipliers": [2, 1, 1], "m_conv": 1.0, "dilation_growth_rate": 3, "dilation_cycle": None,
    },
    "prior": {
        "level": 2, "n_ctx": 8192, "prior_width": 4800, "prior_depth": 72, "heads": 8, "attn_order": 2, "blocks": 128,
        "m_attn": 0.25, "m_mlp": 1.0, "y_bins": [120, 4111], "t_bins": 128, "min_duration": 60.0,
        "max_duration": 600.0, "sr": 44100, "use_tokens": False,
    },
}  # fmt: skip


def test_default_is_the_real_model() -> None:
    config = JukeboxConfig.from_hparams(HPARAMS)
    assert config == JukeboxConfig()
    assert (config.hop, config.row_length) == (128, 64)
    assert config.total_length == 2_734_080
    assert float(config.code_rate) == 344.53125


def test_round_trips() -> None:
    config = JukeboxConfig(width=40, attn_width=10, heads=2, depth=6, mlp_width=37)
    for one in (config, JukeboxConfig()):
        assert JukeboxConfig.from_hparams(json.loads(json.dumps(one.to_hparams()))) == one
    assert JukeboxConfig.from_json(json.loads(json.dumps(config.to_json()))) == config
    with raises_message(UsageError, "time_bins"):
        JukeboxConfig.from_json({**config.to_json(), "widht": 1})


@pytest.mark.parametrize(
    ("part", "key", "value"),
    [("prior", "attn_order", 12), ("prior", "use_tokens", True), ("prior", "n_tokens", 384),
     ("vqvae", "strides_t", [2, 2, 4]), ("vqvae", "dilation_cycle", 2), ("prior", "heads", 7),
     ("prior", "prior_depth", 0), ("prior", "min_duration", 100.0)],
)  # fmt: skip
def test_other_networks_are_refused(part: str, key: str, value: object) -> None:
    hparams = copy.deepcopy(HPARAMS)
    hparams[part][key] = value
    with raises_message(UsageError, "JukeboxConfig|belongs"):
        JukeboxConfig.from_hparams(hparams)


def test_missing_hyperparameters_are_named() -> None:
    hparams = copy.deepcopy(HPARAMS)
    del hparams["prior"]["t_bins"], hparams["prior"]["heads"]
    with raises_message(UsageError, "t_bins"):
        JukeboxConfig.from_hparams(hparams)
    with raises_message(UsageError, "vqvae"):
        JukeboxConfig.from_hparams({"prior": HPARAMS["prior"]})


def test_import_is_light() -> None:
    code = (
        "import sys, dancedata.audio.jukebox as j; j.JukeboxConfig; "
        "assert not {'torch', 'accelerate', 'librosa'} & set(sys.modules); "
        "assert 'JukeboxEncoder' in dir(j); j.fetch; assert not hasattr(j, 'nothing')"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)
