"""Music is inside a page only if requested and allowed by its licence."""

import base64
import io
import json
import re
from pathlib import Path

from dancedata.core.errors import UsageError
from dancedata.pages import write_report
from dancedata.scene.opus import without_serial
from tests.messages import raises_message

AIST = {"source": {"reader": "aist++"}, "licence": "research use, <b>no redistribution</b>"}


def data_of(path: Path) -> dict:
    return json.loads(re.search(r'id="dd-data">(.*?)</script>', path.read_text(), flags=re.DOTALL)[1])


def test_music_of_the_demo_is_cut_to_its_clips(demo: Path, tmp_path: Path) -> None:
    import soundfile

    source = demo.parent / "demo-source"
    pages = [tmp_path / "a.html", tmp_path / "b.html"]
    for path in pages:
        write_report(demo, path, clips=2, audio="embed", source=source)
    assert pages[0].read_bytes() == pages[1].read_bytes()
    document = data_of(pages[0])
    assert sorted(document["audio"]) == ["0", "1"]
    for number, (_, _, frames, _) in enumerate(document["list"]["items"]):
        data = base64.b64decode(document["audio"][str(number)])
        assert len(data) < 60_000
        samples, rate = soundfile.read(io.BytesIO(data))
        assert samples.ndim == 1
        assert abs(len(samples) / rate - frames / 30) < 0.001
    assert "CC0" in document["head"]["notice"]


def test_music_that_may_not_be_shared_is_refused(relabelled, demo: Path, tmp_path: Path) -> None:
    path, source = relabelled(lambda k: {}, AIST), demo.parent / "demo-source"
    with raises_message(UsageError, "allow", where="relabelled"):
        write_report(path, tmp_path / "a.html", audio="embed", source=source)
    assert not (tmp_path / "a.html").exists()
    write_report(path, tmp_path / "a.html", clips=1, audio="embed", source=source, rights="granted to the tests")
    notice = data_of(tmp_path / "a.html")["head"]["notice"]
    assert notice.startswith("Music: included on the statement of the maker of this file")
    assert "<b>no redistribution</b>" in notice
    assert "<b>no redistribution" not in (tmp_path / "a.html").read_text()
    write_report(path, tmp_path / "silent.html")
    assert data_of(tmp_path / "silent.html")["audio"] == {}


def test_music_needs_a_source_that_has_it(demo: Path, tmp_path: Path) -> None:
    with raises_message(UsageError, "needed"):
        write_report(demo, tmp_path / "a.html", audio="embed")
    (tmp_path / "empty").mkdir()
    with raises_message(UsageError, "these", where="empty"):
        write_report(demo, tmp_path / "a.html", audio="embed", source=tmp_path / "empty")


def test_ogg_checksums_are_those_of_the_encoder() -> None:
    import numpy as np
    import soundfile

    data = io.BytesIO()
    soundfile.write(data, np.sin(np.arange(48_000) / 30), 48_000, format="OGG", subtype="VORBIS")
    first = data.getvalue()
    serial = first[14:18]
    # With the encoder's own number the checksums come out as it wrote them.
    changed = without_serial(first)
    assert changed != first
    assert changed[14:18] == b"\1\0\0\0"
    np.testing.assert_array_equal(soundfile.read(io.BytesIO(changed))[0], soundfile.read(io.BytesIO(first))[0])
    assert serial not in changed[:28]
