"""Samples of a model against their dataset: planted faults, plain numpy, and the page."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import dancedata
from dancedata.core.errors import UsageError
from dancedata.evaluation.scores import number_text
from dancedata.pages.samples import SamplesReport, write_samples_report
from dancedata.scene.pose_space import frontal
from dancedata.store import open_store
from tests.commands import as_json, run
from tests.report.conftest import HOSTILE

NAME = HOSTILE[2]


@pytest.fixture(scope="module")
def samples(demo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A clip that drifts away from its floor, one of train again, an untouched one, and one that is broken."""
    folder = tmp_path_factory.mktemp("model") / "samples"
    folder.mkdir()
    with open_store(demo) as store:
        test = list(store.clips("test"))
        train = next(clip for clip in store if clip.split == "train")
        plain = test[0].read("edge151").astype(np.float32)
        drifting = plain.copy()
        drifting[:, 6] += np.linspace(0, 1, len(plain))  # the height of the root, as edge151 is +Z up
        np.save(folder / f"{test[0].id}.npy", plain)
        np.save(folder / f"{NAME}.npy", drifting)
        np.save(folder / "again.npy", train.read("edge151").astype(np.float32))
        np.save(folder / "broken.npy", np.full_like(plain, np.nan))
    return folder


@pytest.fixture(scope="module")
def report(demo: Path, samples: Path) -> SamplesReport:
    return write_samples_report(dancedata.evaluate(samples, like=demo, normalized=False, intervals=False), demo)


def test_scores_are_those_of_evaluate(demo: Path, samples: Path, report: SamplesReport) -> None:
    beside = dancedata.evaluate(samples, like=demo, normalized=False, intervals=False)
    assert report.scores.to_json() == beside.to_json()
    (clip,) = [Path(name).stem for name in report.scores.clips if name.startswith("g")]
    assert report.scores.truth_source == "the same dances of demo"
    rows = dancedata.evaluate(demo, split="test", intervals=False).per_clip
    pfc = [row["pfc"] for row in rows if row["clip"] == clip]
    assert report.scores["pfc"].truth == pytest.approx(np.mean(pfc), rel=1e-9)


def test_distances_to_train_are_those_of_numpy(demo: Path, report: SamplesReport) -> None:
    with open_store(demo) as store:
        poses = {
            clip.id: frontal(clip.joints(), store.skeleton.joints)[:, :22].astype(np.float32).astype(np.float64)
            for clip in store.clips()
        }
        split = {clip.id: clip.split for clip in store}
    train = np.concatenate([of for clip, of in poses.items() if split[clip] == "train"])
    (row,) = [row for row in report.rows if row.clip in poses]
    squared = [((train - pose) ** 2).sum(axis=2).mean(axis=1).min() for pose in poses[row.clip]]
    away = np.sqrt(squared)
    assert row.to_train_m == pytest.approx(np.median(away), abs=2e-4)  # edge151 is float32
    (near,) = [near for near in report.nearest if near.clip == row.clip]
    assert near.distance_m == pytest.approx(away.max(), abs=2e-4)
    (x, y, z) = np.abs(np.array(near.train_pose) - poses[near.train_clip][round(near.train_seconds * 30)]).max(axis=0)
    assert max(x, y, z) < 1e-3


def test_planted_faults_are_named(report: SamplesReport) -> None:
    rows = {row.clip: row for row in report.rows}
    assert set(rows) == {*rows} - {"broken"}
    assert [clip for clip, _ in report.scores.left_out] == ["broken"]
    (drift,) = [outlier for outlier in report.outliers if outlier.clip == NAME]
    assert "floor_drift_m" in {reason.measure for reason in drift.reasons}
    assert rows[NAME].numbers.floor_drift_m == pytest.approx(1.0, abs=0.4)
    assert not [outlier for outlier in report.outliers if outlier.clip not in (NAME, "broken")]
    assert rows["again"].to_train_m == 0.0
    copies = report.to_json()["copies_of_train"]
    assert copies
    assert {clip for pair in copies for clip in pair["clips"] if clip.startswith("samples/")} == {"samples/again"}


def test_the_page_has_everything_and_no_markup_of_names(demo: Path, samples: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    scores = dancedata.evaluate(samples, like=demo, normalized=False, intervals=False)
    written = write_samples_report(scores, demo, page, clips=2)
    text = page.read_text()
    assert written.path == page
    void = [score for score in written.scores.scores if score.verdict == "void"]
    before, folded = text.split("<details><summary>", 1)
    assert void
    assert "without a meaning" in folded
    for score in void:  # no number of theirs stands on the page before one asks for it
        assert score.value is None or number_text(score.value) not in before
    for title in ("Scores", "How they move", "Map of the poses", "The strangest poses", "Numbers of each sample"):
        assert title in text
    assert text.index('class="verdict') < text.index("<h1>")  # first of all, whether anything here is a result
    assert text.count("dancedataClip") or '"clips":{"0"' in text
    assert "a&amp;b=c#d%20%3Cscript%3E" in text.replace("<wbr>", "")
    again = tmp_path / "again.html"
    write_samples_report(scores, demo, again, clips=2)
    assert again.read_bytes() == page.read_bytes()
    with pytest.raises(UsageError, match="already there"):
        write_samples_report(scores, demo, page)


def test_the_command_prints_the_scores_and_refuses_options_of_samples_for_a_dataset(demo, samples, tmp_path):
    page = tmp_path / "page.html"
    out = run("report", samples, "--like", demo, "--not-normalized", "--out", page, "--quiet").stdout
    assert "BAS" in out
    assert "4 samples: 1 clip of demo (test), 3 without" in out.splitlines()[0]
    (tmp_path / "unknown").mkdir()
    shutil.copy(next(samples.glob("*.np*")), tmp_path / "unknown" / "nobody.npy")
    failed = run(
        "report", tmp_path / "unknown", "--like", demo, "--not-normalized", "--out", page, "--overwrite", code=1
    )
    assert "nobody" in failed.stderr
    assert "left out: 1 sample" in out
    printed = as_json("report", samples, "--like", demo, "--not-normalized")
    assert printed["against"] == "demo"
    failed = run("report", demo, "--fps", "30", code=2)
    assert "Leave out --fps" in failed.stderr
    failed = run("report", samples, "--like", demo, code=2)
    assert "normalised" in failed.stderr
