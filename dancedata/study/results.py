"""What the results of a study say: preferences with intervals by song, and strengths of more than two systems."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dancedata.core.dance import Undefined
from dancedata.core.errors import DataError, UsageError
from dancedata.core.text import counted, listed, printable, quoted
from dancedata.metrics.intervals import Interval, jackknife
from dancedata.study.page import COLUMNS
from dancedata.study.trials import STILL

_MAX_BYTES = 1 << 26
#: Steps of the fixed point of Bradley-Terry at most, and the change at which it has converged.
_STEPS, _CONVERGED = 10_000, 1e-12


@dataclass(frozen=True)
class Answer:
    """One row of the results."""

    participant: str
    song: str
    left: str
    right: str
    choice: str
    expected: str
    reasons: tuple[str, ...]

    @property
    def winner(self) -> str:
        """The system that was chosen."""
        return self.left if self.choice == "left" else self.right

    @property
    def loser(self) -> str:
        """The other system."""
        return self.right if self.choice == "left" else self.left


@dataclass(frozen=True)
class Preference:
    """How often the first of two systems was preferred.

    `wins`, `answers`: Answers for the first, and all.
    `interval`: By the jackknife over songs, see `metrics.jackknife`; None for fewer than three songs, and without
        variation.
    """

    first: str
    second: str
    wins: int
    answers: int
    interval: Interval | None
    reasons: Mapping[str, Mapping[str, int]]  # how often each reason was given, by the system that was chosen

    @property
    def share(self) -> float:
        """Share of the answers for the first."""
        return self.wins / self.answers


@dataclass(frozen=True)
class Results:
    """The results of one study.

    `strengths`: Bradley-Terry's log strengths by system, of mean 0; empty for two systems, and where they are not
        finite.
    """

    study: str
    participants: tuple[str, ...]  # raters who count, and those whose answers do not, as they failed a check
    failed: tuple[str, ...]
    preferences: tuple[Preference, ...]  # of each two systems
    strengths: Mapping[str, float]
    notes: tuple[str, ...]  # sentences on what does not count or cannot be computed

    def to_json(self) -> dict[str, Any]:
        """Return the results as JSON data."""
        return {
            "study": self.study, "participants": list(self.participants), "failed": list(self.failed),
            "preferences": [
                {
                    "first": p.first, "second": p.second, "wins": p.wins, "answers": p.answers, "share": p.share,
                    "low": None if p.interval is None else p.interval.low,
                    "high": None if p.interval is None else p.interval.high, "reasons": p.reasons,
                }
                for p in self.preferences
            ],
            "strengths": dict(self.strengths), "notes": list(self.notes),
        }  # fmt: skip

    def __str__(self) -> str:
        lines = [f"study {self.study}: {counted(len(self.participants), 'participant')}"]
        for p in self.preferences:
            interval = "" if p.interval is None else f"  ({p.interval.low:.1%} to {p.interval.high:.1%})"
            of = f"{p.wins} of {counted(p.answers, 'answer')}"
            lines.append(f"  {p.first} over {p.second}: {p.share:.1%}{interval}, {of}")
            for name, reasons in p.reasons.items():
                if reasons:
                    lines.append(f"    for {name}: " + ", ".join(f"{reason} {n}" for reason, n in reasons.items()))
        if self.strengths:
            ranked = sorted(self.strengths.items(), key=lambda item: -item[1])
            strengths = ", ".join(f"{name} {value:+.2f}" for name, value in ranked)
            lines.append(f"  Bradley-Terry, log strength: {strengths}")
        return printable("\n".join([*lines, *(f"  note: {note}" for note in self.notes)]), lines=True)


def read_results(paths: Iterable[Path]) -> tuple[str, list[Answer]]:
    """Read files of results, as the page saves them; returns the study's id and the answers."""
    answers: dict[tuple[str, str], Answer] = {}
    studies: dict[str, Path] = {}
    trials: dict[str, tuple[str, ...]] = {}
    for path in paths:
        for number, row in enumerate(_rows(path), start=2):
            where = f"{path}, line {number}"
            studies.setdefault(row["study"], path)
            if len(studies) > 1:
                raise DataError("the results are of different studies", reason="other_study", where=where,
                                found=listed(list(studies)),
                                fix="give the results of one study at a time")  # fmt: skip
            if wrong := _wrong(row):
                raise DataError("a row is not an answer", reason="bad_row", where=where,
                                found=f"{wrong} {quoted(row[wrong], 60)}",
                                allowed="a trial's number, and left or right of two systems, one of which stands "
                                "still in a check",
                                fix="ask the rater for the file again")  # fmt: skip
            trial = (row["song"], row["left"], row["right"], row["expected"])
            if trials.setdefault(row["trial"], trial) != trial:
                raise DataError("a trial has other dancers than in an earlier row", reason="other_study", where=where,
                                found=listed(trial), allowed=listed(trials[row["trial"]]))  # fmt: skip
            key = (row["participant"], row["trial"])
            if key in answers:
                raise DataError("a participant answers a trial twice", reason="twice", where=where,
                                found=f"participant {quoted(key[0])}, trial {key[1]}",
                                fix="give each file once, or rename one of two participants of one name")  # fmt: skip
            reasons = tuple(filter(None, row["reasons"].split("; ")))
            sides = (row["left"], row["right"])
            answers[key] = Answer(key[0], row["song"], *sides, row["choice"], row["expected"], reasons)
    if not answers:
        raise DataError("there are no answers", reason="empty", fix="give the CSV files that the page saves")
    return next(iter(studies)), list(answers.values())


def _wrong(row: Mapping[str, str]) -> str:
    """Return the first column of a row whose value the page cannot have written; "" for an answer."""
    still = [side for side in ("left", "right") if row[side] == STILL]
    expected = "" if not still else "right" if still == ["left"] else "left"
    is_right = {
        **{name: row[name] != "" for name in ("study", "participant", "song", "left")},
        "trial": re.fullmatch("0|[1-9][0-9]*", row["trial"]) is not None,
        "choice": row["choice"] in ("left", "right"), "right": row["right"] not in ("", row["left"]),
        "expected": row["expected"] == expected, "chosen": row["chosen"] == row.get(row["choice"]),
    }  # fmt: skip
    return next((name for name in is_right if not is_right[name]), "")


def _rows(path: Path) -> list[dict[str, str]]:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise DataError("the file is too large", reason="too_large", where=path, allowed=f"{_MAX_BYTES:,} bytes")
        text = path.read_bytes().decode("utf-8-sig")
        delimiter = max(",;\t", key=text.partition("\n")[0].count)  # spreadsheets write others
        reader = csv.DictReader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
        rows = list(reader)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError("the results cannot be read", reason="broken_file", where=path, found=str(error)) from error
    missing = [name for name in COLUMNS if name not in (reader.fieldnames or ())]
    short = [k for k, row in enumerate(rows) if None in row.values() or None in row]
    if missing or short:
        found = f"no column {listed(missing)}" if missing else f"line {short[0] + 2} has another number of columns"
        raise DataError("this is not a file of a study's answers", reason="bad_row", where=path, found=found,
                        allowed=", ".join(COLUMNS))  # fmt: skip
    return [{name: row[name].removeprefix("'") for name in COLUMNS} for row in rows]


def results_of(study: str, answers: Sequence[Answer]) -> Results:
    """Count the answers of a study; a participant who chose the dancer who stands still in a check does not count."""
    raters = list(dict.fromkeys(answer.participant for answer in answers))
    wrong = {a.participant for a in answers if a.expected and a.choice != a.expected}
    failed = tuple(rater for rater in raters if rater in wrong)
    counting = tuple(rater for rater in raters if rater not in failed)
    if not counting:
        raise UsageError("every participant failed a check", found=listed(failed), fix="add answers of others")
    pairs = [a for a in answers if a.participant in counting and not a.expected]
    notes = [] if pairs else ["there are only answers to checks, and none to a pair of systems"]
    if failed:
        notes.append(f"{counted(len(failed), 'participant')} failed a check and does not count: {listed(failed)}")
    systems = list(dict.fromkeys(name for a in pairs for name in sorted((a.left, a.right))))
    preferences = tuple(
        preference
        for first, second in combinations(sorted(systems), 2)
        if (preference := _preference(pairs, first, second)) is not None
    )
    notes += [
        f"{p.first} and {p.second}: no interval, for fewer than 3 songs or without variation between songs"
        for p in preferences
        if p.interval is None
    ]
    strengths: dict[str, float] = {}
    if len(systems) > 2:
        strengths = bradley_terry(pairs, sorted(systems))
        if not strengths:
            notes.append("Bradley-Terry is not finite: a system, or several, won every answer against all others")
    return Results(study, counting, failed, preferences, strengths, tuple(notes))


def _preference(pairs: Sequence[Answer], first: str, second: str) -> Preference | None:
    mine = [a for a in pairs if {a.left, a.right} == {first, second}]
    if not mine:
        return None
    songs = list(dict.fromkeys(a.song for a in mine))
    rows: npt.NDArray[np.float64] = np.zeros((len(songs), 2))
    for answer in mine:
        rows[songs.index(answer.song)] += (answer.winner == first, 1)
    intervals: dict[str, Interval] = {}
    with suppress(Undefined):  # fewer than three songs
        intervals = jackknife(rows, lambda r: {"share": float(r[:, 0].sum() / r[:, 1].sum())}, bounds=(0, 1))
    reasons = {
        name: dict(Counter(reason for a in mine if a.winner == name for reason in a.reasons).most_common())
        for name in (first, second)
    }
    return Preference(first, second, int(rows[:, 0].sum()), len(mine), intervals.get("share"), reasons)


def bradley_terry(answers: Sequence[Answer], systems: Sequence[str]) -> dict[str, float]:
    """Return the log strengths of systems, of mean 0, by maximum likelihood (Bradley and Terry 1952).

    The probability that i is preferred to j is 1 / (1 + exp(s_j - s_i)). Found by Hunter's (2004) fixed point. Empty
    where systems won every answer against the others: then no finite strengths are the likeliest.
    """
    place = {name: k for k, name in enumerate(systems)}
    wins = np.zeros((len(systems), len(systems)))
    for answer in answers:
        wins[place[answer.winner], place[answer.loser]] += 1
    reach = np.linalg.matrix_power((wins > 0).astype(np.float64) + np.eye(len(systems)), len(systems)) > 0
    if not reach.all():  # Ford 1957: each must have won, along a chain, against each
        return {}
    strength, met, total = np.ones(len(systems)), wins + wins.T, wins.sum(axis=1)
    for _ in range(_STEPS):
        new = total / (met / (strength[:, None] + strength[None])).sum(axis=1)
        new /= np.exp(np.log(new).mean())
        change = float(np.abs(np.log(new / strength)).max())
        strength = new
        if change < _CONVERGED:
            break
    return dict(zip(systems, np.log(strength).tolist(), strict=True))
