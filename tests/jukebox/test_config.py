import json
import subprocess
import sys
from typing import Any

import pytest

from dancedata.audio.jukebox import JukeboxConfig
from dancedata.core.errors import UsageError
from tests.messages import raises_message


def test_default_is_the_real_model() -> None:
    config = JukeboxConfig()
    assert (config.hop, config.row_length) == (128, 64)
    assert config.total_length == 2_734_080
    assert float(config.code_rate) == 344.53125
    # No tensor's shape shows these.
    assert (config.heads, config.downs, config.dilation_growth) == (8, (3, 2, 2), 3)
    assert (config.min_duration_s, config.max_duration_s, config.sample_rate) == (60, 600, 44_100)


def test_round_trips() -> None:
    config = JukeboxConfig(width=40, attn_width=10, heads=2, depth=6, mlp_width=37)
    assert JukeboxConfig.from_json(json.loads(json.dumps(config.to_json()))) == config
    with raises_message(UsageError, "time_bins"):
        JukeboxConfig.from_json({**config.to_json(), "widht": 1})


@pytest.mark.parametrize(
    "sizes", [{"heads": 7}, {"depth": 0}, {"downs": [3, 0, 2]}, {"n_rows": 100}, {"min_duration_s": 100.0}]
)
def test_impossible_sizes_are_refused(sizes: dict[str, Any]) -> None:
    with raises_message(UsageError, "JukeboxConfig"):
        JukeboxConfig.from_json({**JukeboxConfig().to_json(), **sizes})


def test_import_is_light() -> None:
    code = (
        "import sys, dancedata.audio.jukebox as j; j.JukeboxConfig; "
        "assert not {'torch', 'accelerate', 'librosa'} & set(sys.modules); "
        "assert 'JukeboxEncoder' in dir(j); j.fetch; assert not hasattr(j, 'nothing')"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)
