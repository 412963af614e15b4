"""Studies: fair and blind trials, a page that asks, and results that say what was planted."""

import json
import re
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize

import dancedata
from dancedata.core.errors import DanceDataError, DataError, UsageError
from dancedata.samples import Samples
from dancedata.scene.selection import ViewRequest
from dancedata.study.page import COLUMNS, StudyRequest, write_study
from dancedata.study.results import Answer, bradley_terry, read_results, results_of
from dancedata.study.trials import STILL, Trial, make_trials
from dancedata.torch import WindowDataset
from tests.commands import as_json, run
from tests.messages import raises_message
from tests.scene.helpers import page_data
from tests.scene.test_scenes import unpacked

CLIPS = {f"clip{k}": f"song{k % 4}" for k in range(10)}


@pytest.fixture(scope="module")
def systems(demo: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two folders of positions for the clips of the demo: shaken a little, and a lot."""
    ds, out = dancedata.open(demo), tmp_path_factory.mktemp("systems")
    rng = np.random.default_rng(0)
    for name, noise in (("calm", 0.002), ("wild", 0.02)):
        (out / name).mkdir()
        for clip in ds.clips()[:6]:
            joints = dancedata.decode(clip.read("edge151"), "edge151", fps=ds.fps).joints()
            np.savez(out / name / f"{clip.id}.npz", joints=joints + rng.normal(0, noise, joints.shape), fps=30)
    return out / "calm", out / "wild"


def request(demo: Path, systems: tuple[Path, Path], **options: Any) -> StudyRequest:
    views = {"truth": ViewRequest(demo, music=demo.parent / "demo-source")}
    views |= {path.name: ViewRequest(path) for path in systems}
    return StudyRequest(views, **{"songs": 2, "checks": 2, "seconds": 3.0, **options})


@pytest.mark.parametrize("seed", range(3))
def test_trials_are_fair(seed: int) -> None:
    systems = ("a", "b", "c")
    trials = make_trials(CLIPS, systems, songs=7, checks=3, seed=seed)
    pairs = [trial for trial in trials if not trial.is_check]
    assert len(pairs) == 3 * 7
    for first, second in (("a", "b"), ("a", "c"), ("b", "c")):
        mine = [trial for trial in pairs if {trial.left, trial.right} == {first, second}]
        assert len({trial.clip for trial in mine}) == 7
        assert abs(2 * sum(trial.left == first for trial in mine) - 7) == 1
    clips = {trial.clip: trial.song for trial in pairs}
    assert set(Counter(clips.values()).values()) <= {1, 2}  # of four songs, seven clips: no song three times
    checks = [trial for trial in trials if trial.is_check]
    assert len(checks) == 3
    assert all({trial.left, trial.right} == {"a", STILL} for trial in checks)
    assert {trial.expected for trial in checks} == {"left", "right"}
    assert make_trials(CLIPS, systems, songs=7, checks=3, seed=seed) == trials
    assert make_trials(CLIPS, systems, songs=7, checks=3, seed=seed + 1) != trials


@pytest.mark.parametrize(
    "options", [{"songs": 11}, {"systems": ("a",)}, {"checks": 101}, {"seed": -1}], ids=lambda o: next(iter(o))
)
def test_impossible_studies(options: dict[str, Any]) -> None:
    with raises_message(UsageError, "checks|common|compares|seed"):
        make_trials(CLIPS, options.get("systems", ("a", "b")), songs=options.get("songs", 2),
                    checks=options.get("checks", 0), seed=options.get("seed", 0))  # fmt: skip


def test_the_page_is_blind(demo: Path, systems: tuple[Path, Path], tmp_path: Path) -> None:
    trials = write_study(request(demo, systems), tmp_path / "study.html")
    text = (tmp_path / "study.html").read_text()
    data = page_data(text)
    assert len(data["clips"]) == len(trials) == 8
    blind = json.dumps({**data, "audio": {}})
    for word in ("truth", "calm", "wild", *(trial.clip for trial in trials), *(trial.song for trial in trials)):
        assert f'"{word}' not in blind
    for trial in trials:
        left, right = data["clips"][str(trial.number)]["members"]
        assert [left["part"], right["part"]] == ["left", "right"]
        assert left["member"] == right["member"]  # one colour
        assert left["figure"]["frames"] == right["figure"]["frames"] == 90
        assert left["figure"]["contacts"] == right["figure"]["contacts"]
        moves = left["figure"]["data"] != right["figure"]["data"]
        assert moves
    assert set(data["audio"]) == {str(k) for k in range(8)}
    assert write_study(request(demo, systems), tmp_path / "again.html") == trials
    assert (tmp_path / "again.html").read_text() == text
    with raises_message(UsageError, "already", where="study.html"):
        write_study(request(demo, systems), tmp_path / "study.html")


def saved(dataset: WindowDataset, folder: Path, numbers: Sequence[int], marks: Sequence[str] = ("",)) -> Path:
    """Save windows of a dataset as samples that stand still; returns their folder."""
    for mark in marks:
        batch = [dataset[k] for k in numbers]
        rows = np.stack([item["edge151"].numpy() for item in batch])
        still = np.repeat(rows[:, :1], rows.shape[1], axis=1)
        dataset.save_samples(folder, [f"{item['id']}{mark}" for item in batch], still)
    return folder


def test_saved_samples_are_shown_and_not_their_truth(demo: Path, tmp_path: Path) -> None:
    """The truth beside a sample is its own window, of the dataset too, mirrored and copied as the sample is."""
    test = WindowDataset(demo, "test", fields=("edge151",))
    views = {
        "truth": ViewRequest(demo),
        "gen": ViewRequest(saved(test, tmp_path / "gen", (0, 2, 4), ("", "~mirror"))),
    }
    lines: list[str] = []
    trials = write_study(StudyRequest(views, songs=6, checks=0), tmp_path / "study.html", say=lines.append)
    assert lines == ["truth: 6 of 6 clips matched", "gen: 6 of 6 clips matched"]
    assert {trial.clip for trial in trials} == {path.stem for path in (tmp_path / "gen").glob("*.npz")}
    data = page_data(tmp_path / "study.html")
    ds = dancedata.open(demo)
    for trial in trials:
        for member in data["clips"][str(trial.number)]["members"]:
            sample, is_truth = Samples(ds).require(trial.clip), getattr(trial, member["part"]) == "truth"
            motion = ds.read(sample.windows[0], "edge151")
            mirror = ds.fields["edge151"].mirror
            assert mirror is not None
            motion = mirror.apply(motion) if is_truth and sample.id.mirrored else motion
            joints = dancedata.decode(motion, "edge151", fps=ds.fps).joints()
            joints = joints if is_truth else np.repeat(joints[:1], len(joints), axis=0)
            shown = unpacked(member["figure"])
            moved = shown - shown[:1, :1] - (joints - joints[:1, :1])
            assert np.abs(moved).max() < 0.005


def test_studies_without_music_or_clips_in_common(demo: Path, systems: tuple[Path, Path], tmp_path: Path) -> None:
    silent = StudyRequest({"a": ViewRequest(systems[1]), "b": ViewRequest(systems[0])}, songs=1)
    with raises_message(UsageError, "study"):
        write_study(silent, tmp_path / "a.html", rights="mine")
    (tmp_path / "other").mkdir()
    np.savez(tmp_path / "other" / "nobody.npz", joints=np.zeros((60, 24, 3)), fps=30)
    apart = StudyRequest({"a": ViewRequest(systems[0]), "b": ViewRequest(tmp_path / "other")}, songs=1)
    with raises_message(DataError, "systems"):
        write_study(apart, tmp_path / "b.html")
    short = request(demo, systems, seconds=1.0)
    with raises_message(UsageError, "trials"):
        write_study(short, tmp_path / "c.html")
    assert not list(tmp_path.glob("*.html"))


def csv_of(trials: tuple[Trial, ...], participant: str, choose: Any) -> str:
    rows = [",".join(COLUMNS)]
    for order, trial in enumerate(trials):
        choice = choose(trial)
        chosen = trial.left if choice == "left" else trial.right
        values = {
            "study": "abc", "participant": participant, "order": order, "trial": trial.number, "song": trial.song,
            "clip": trial.clip, "left": trial.left, "right": trial.right, "choice": choice, "chosen": chosen,
            "expected": trial.expected, "reasons": "natural; on the beat", "plays": 1, "seconds": 3, "time": "",
        }  # fmt: skip
        rows.append(",".join(str(values[name]) for name in COLUMNS))
    return "\n".join(rows) + "\n"


def test_results_are_those_that_were_planted(tmp_path: Path) -> None:
    trials = make_trials(CLIPS, ("a", "b"), songs=8, checks=2, seed=3)
    rng = np.random.default_rng(5)

    def choose(trial: Trial) -> str:
        if trial.is_check:
            return trial.expected
        wants = "a" if rng.random() < 0.8 else "b"
        return "left" if trial.left == wants else "right"

    files = []
    for k in range(12):
        files.append(tmp_path / f"{k}.csv")
        files[-1].write_text(csv_of(trials, f"rater {k}", choose))
    careless = tmp_path / "careless.csv"
    careless.write_text(csv_of(trials, "careless", lambda trial: "left"))
    results = results_of(*read_results([*files, careless]))
    assert results.failed == ("careless",)
    (preference,) = results.preferences
    rows = [row for file in files for row in file.read_text().splitlines()[1:]]
    split = [dict(zip(COLUMNS, row.split(","), strict=True)) for row in rows]
    counting = [row for row in split if not row["expected"]]
    assert preference.wins == sum(row["chosen"] == "a" for row in counting)
    assert preference.answers == len(counting) == 96
    assert preference.interval is not None
    assert preference.interval.low < 0.8 < preference.interval.high
    assert preference.reasons["a"] == {"natural": preference.wins, "on the beat": preference.wins}
    document = as_json("study", *files, careless)
    assert document["preferences"][0]["wins"] == preference.wins
    assert f"a over b: {preference.share:.1%}" in run("study", *files).stdout
    with raises_message(UsageError, "participant"):
        results_of(*read_results([careless]))


def test_strengths_are_the_likeliest() -> None:
    systems, true = ["a", "b", "c", "d"], np.array([0.9, 0.1, -0.2, -0.8])
    rng = np.random.default_rng(1)
    answers = []
    for _ in range(400):
        i, j = rng.choice(4, 2, replace=False)
        first = rng.random() < 1 / (1 + np.exp(true[j] - true[i]))
        answers.append(Answer("r", "s", systems[i], systems[j], "left" if first else "right", "", ()))
    place = {name: k for k, name in enumerate(systems)}
    pairs = np.array([(place[a.winner], place[a.loser]) for a in answers])

    def loss(s: np.ndarray) -> float:
        return float(np.log1p(np.exp(s[pairs[:, 1]] - s[pairs[:, 0]])).sum() + s.sum() ** 2)

    best = minimize(loss, np.zeros(4), tol=1e-12).x
    strengths = bradley_terry(answers, systems)
    np.testing.assert_allclose([strengths[name] for name in systems], best - best.mean(), rtol=0, atol=1e-4)
    assert abs(sum(strengths.values())) < 1e-9
    only = [a for a in answers if a.winner == "a" or "a" not in (a.left, a.right)]
    assert bradley_terry(only, systems) == {}
    results = results_of("x", only)
    assert results.strengths == {}
    assert any("not finite" in note for note in results.notes)


def changed(text: str, column: str, value: str) -> str:
    """Return results with another value in a column of the first row."""
    head, row, *rows = text.splitlines()
    values = dict(zip(COLUMNS, row.split(","), strict=True)) | {column: value}
    return "\n".join([head, ",".join(values.values()), *rows, ""])


@pytest.mark.parametrize("between", [";", "\t"])
def test_results_saved_by_a_spreadsheet(tmp_path: Path, between: str) -> None:
    text = csv_of(
        make_trials(CLIPS, ("a", "b"), songs=2, checks=1, seed=0), "\x1b[2J", lambda t: t.expected or "left"
    )
    for name, written in (("a", text), ("b", text.replace(";", " ").replace(",", between))):
        (tmp_path / name).write_text(written)
    one, other = (read_results([tmp_path / name])[1] for name in "ab")
    assert [(a.left, a.choice) for a in one] == [(a.left, a.choice) for a in other]
    assert "\x1b" not in str(results_of("abc", one))


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda text: text.replace("study,", "studie,", 1), "no column study"),
        (lambda text: re.sub(r",(left|right),[ab],", ",middle,a,", text, count=1), "not an answer"),
        (lambda text: text + text.splitlines()[1] + "\n", "answers a trial twice"),
        (lambda text: text + text.splitlines()[1].replace("abc", "abd").replace("me", "you") + "\n",
         "different studies"),
        (lambda text: text + "abc,me\n", "another number of columns"),
        *(
            (partial(changed, column=column, value=value), f"not an answer; found {column}")
            for column, value in (
                ("chosen", "nobody"), ("right", ""), ("expected", "left"), ("participant", ""), ("trial", "00"),
                ("song", ""),
            )
        ),
        (lambda text: text + changed(text.replace(",me,", ",you,"), "song", "z").splitlines()[1], "earlier row"),
        (lambda text: text.splitlines()[0] + "\n", "no answers"),
        (lambda text: "\udcff", "cannot be read"),
    ],
)  # fmt: skip
def test_broken_results(tmp_path: Path, change: Any, problem: str) -> None:
    trials = make_trials(CLIPS, ("a", "b"), songs=2, checks=0, seed=0)
    path = tmp_path / "r.csv"
    path.write_bytes(change(csv_of(trials, "me", lambda _: "left")).encode("utf-8", "surrogateescape"))
    with pytest.raises(DanceDataError, match=re.escape(problem)) as caught:
        read_results([path])
    assert isinstance(caught.value, DataError)


def test_a_rater_answers_and_the_table_recomputes(browser, demo, systems, tmp_path):
    trials = write_study(request(demo, systems, songs=1, checks=1), tmp_path / "study.html")
    browser.get(f"file://{tmp_path / 'study.html'}")
    browser.wait("return window.dancedataStudy")
    browser.js("document.querySelector('[data-st=who]').value = '=1+1, \"me\"'")
    browser.js("document.querySelector('[data-st=begin]').click()")
    order = browser.js("return dancedataStudy.orderOf('=1+1, \"me\"')")
    assert sorted(order) == list(range(len(trials)))
    for place, number in enumerate(order):
        browser.wait(
            "return document.querySelector('[data-st=place]').textContent.startsWith(arguments[0]) && "
            "dancedataViewer.state.item?.number === arguments[1]",
            f"{place + 1} of", number,
        )  # fmt: skip
        assert browser.js("return document.querySelector('[data-st=next]').disabled")
        trial = trials[number]
        want = trial.expected or ("left" if trial.left == "calm" or trial.right == "wild" else "right")
        browser.js("document.querySelector(`[data-st=reasons] input`).click()")
        browser.key({"left": "1", "right": "2"}[want])
        browser.js("document.activeElement.blur()")
        browser.js("document.querySelector('[data-st=next]').click()")
    browser.wait("return document.querySelector('[data-st=csv]').value")
    (tmp_path / "r.csv").write_text(browser.js("return document.querySelector('[data-st=csv]').value"))
    _, answers = read_results([tmp_path / "r.csv"])
    assert {answer.participant for answer in answers} == {'=1+1, "me"'}
    results = results_of("x", answers)
    assert results.failed == ()
    wins = {(p.first, p.second): p.wins for p in results.preferences}
    assert wins == {("calm", "truth"): 1, ("calm", "wild"): 1, ("truth", "wild"): 1}
    assert all(answer.reasons == ("on the beat",) for answer in answers)
    assert [m for m in browser.log() if "AudioContext" not in m] == []


def test_the_command(demo: Path, systems: tuple[Path, Path], tmp_path: Path) -> None:
    arguments = ["study", demo, *systems, "--songs", 1, "--seconds", 2, "--music", demo.parent / "demo-source"]
    done = run(*arguments, "--out", tmp_path / "s.html", "--names", "truth,mine,theirs")
    assert "3 pairs and 2 checks of truth, mine, theirs" in done.stdout
    assert done.stdout.startswith("truth: ")
    assert "matched" in done.stdout.splitlines()[2]
    assert (
        "every system needs a name"
        in run(*arguments, "--out", tmp_path / "t.html", "--names", "a,a,b", code=2).stderr
    )
