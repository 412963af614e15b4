"""dancedata study and dancedata study-results: blind pairs for raters, and what they say."""

from pathlib import Path
from typing import Annotated

import typer

from dancedata.cli.options import AsJson, Clip, Normalized, ScalerFile, errors_to_exit_codes, print_result
from dancedata.cli.pages import FIELD_HELP, MUSIC_HELP, SHARE_HELP
from dancedata.cli.terminal import say
from dancedata.core.errors import UsageError
from dancedata.core.text import counted, listed

SYSTEMS_HELP = "Two or more: built datasets, or folders of motion files. The first has the music."
NAMES_HELP = "Names of the systems in the results, in their order: truth,mine; default: those of the folders."


@errors_to_exit_codes
def study(
    systems: Annotated[list[Path], typer.Argument(metavar="A B [C ...]", help=SYSTEMS_HELP)],
    out: Annotated[Path, typer.Option(metavar="FILE.html", help="Page to write.")],
    names: Annotated[str | None, typer.Option(help=NAMES_HELP)] = None,
    songs: Annotated[int, typer.Option(min=1, help="Clips that each pair of systems is shown on.")] = 12,
    checks: Annotated[int, typer.Option(min=0, help="Pairs in which one dancer stands still.")] = 2,
    seconds: Annotated[float, typer.Option(help="Longest clip.")] = 15.0,
    seed: Annotated[int, typer.Option(help="Of clips, sides and orders.")] = 0,
    question: Annotated[str | None, typer.Option(help="Question to the raters.")] = None,
    field: Annotated[str | None, typer.Option(metavar="NAME", help=FIELD_HELP)] = None,
    like: Annotated[Path | None, typer.Option(metavar="STORE", help="Dataset with their scaler and rate.")] = None,
    normalized: Normalized = None,
    scaler: ScalerFile = None,
    clip_to_range: Clip = False,
    music: Annotated[Path | None, typer.Option(metavar="PATH", help=MUSIC_HELP)] = None,
    fps: Annotated[str | None, typer.Option(help="Frame rate of motion files.")] = None,
    up: Annotated[str, typer.Option(help="Up axis of motion files: y or z.")] = "y",
    unit: Annotated[str | None, typer.Option(help="Unit of motion files: m, cm, ...")] = None,
    share: Annotated[bool, typer.Option("--i-may-share-this-music", help=SHARE_HELP)] = False,
    overwrite: Annotated[bool, typer.Option(help="Replace the file.")] = False,
) -> None:
    """Write a user study as one offline page.

    dancedata study A B --music DIR --out study.html: blind pairs of dancers to one song, the answers as CSV.
    """
    from dancedata.scene.selection import ViewRequest
    from dancedata.store.schema import DATASET_FILE
    from dancedata.study.page import QUESTION, StudyRequest, write_study

    called = [path.name for path in systems] if names is None else [name.strip() for name in names.split(",")]
    if len(called) != len(systems) or len(set(called)) < len(called) or "" in called:
        raise UsageError("every system needs a name of its own", found=listed(called),
                         allowed=counted(len(systems), "name"), fix="give them: --names truth,mine")  # fmt: skip
    views = {}
    for number, (name, path) in enumerate(zip(called, systems, strict=True)):
        if (path / DATASET_FILE).exists():
            views[name] = ViewRequest(path, field=field, music=music if number == 0 else None)
        else:
            views[name] = ViewRequest(
                path, field=field, like=like, normalized=normalized, scaler=scaler, clamp=clip_to_range,
                music=music, fps=fps, up=up, unit=unit,
            )  # fmt: skip
    request = StudyRequest(views, songs, checks, seconds, seed, question or QUESTION)
    trials = write_study(request, out, shared=share, overwrite=overwrite, say=say)
    pairs = sum(not trial.is_check for trial in trials)
    say(f"{out}: {counted(pairs, 'pair')} and {counted(len(trials) - pairs, 'check')} of {', '.join(called)}")
    say("  next: send the page to raters, then dancedata study-results THEIR-FILES.csv")


@errors_to_exit_codes
def study_results(
    files: Annotated[list[Path], typer.Argument(metavar="CSV...", help="Files that the page saved.")],
    keep_failed: Annotated[
        bool, typer.Option("--keep-failed", help="Count participants who failed a check.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Count the answers of a user study.

    dancedata study-results CSV...: preferences with intervals by song, Bradley-Terry for more than two.
    """
    from dancedata.study.results import read_results, results_of

    results = results_of(*read_results(files), keep_failed=keep_failed)
    lines = [f"study {results.study}: {counted(len(results.participants), 'participant')}"]
    for p in results.preferences:
        interval = "" if p.interval is None else f"  ({p.interval.low:.1%} to {p.interval.high:.1%})"
        lines.append(
            f"  {p.first} over {p.second}: {p.share:.1%}{interval}, {p.wins} of {counted(p.answers, 'answer')}"
        )
        for name, reasons in p.reasons.items():
            if reasons:
                lines.append(f"    for {name}: " + ", ".join(f"{reason} {n}" for reason, n in reasons.items()))
    if results.strengths:
        ranked = sorted(results.strengths.items(), key=lambda item: -item[1])
        lines.append("  Bradley-Terry, log strength: " + ", ".join(f"{name} {value:+.2f}" for name, value in ranked))
    lines += [f"  note: {note}" for note in results.notes]
    print_result(as_json, results.to_json, lambda: "\n".join(lines))
