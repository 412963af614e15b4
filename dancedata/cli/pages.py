"""dancedata view, report, study: pages for the browser."""

from pathlib import Path
from typing import Annotated, Any

import typer

from dancedata.cli.command import AsJson, Output, command
from dancedata.cli.help import RARE
from dancedata.cli.options import (
    MUSIC_HELP,
    RIGHTS_HELP,
    Betas,
    BodyModel,
    Clamp,
    Field,
    Fps,
    Like,
    Music,
    Normalized,
    Overwrite,
    Plugins,
    Protocol,
    Quiet,
    Rights,
    Scaler,
    Split,
    Unit,
    Up,
    betas_of,
    option,
)  # fmt: skip
from dancedata.cli.terminal import say
from dancedata.core.errors import UsageError
from dancedata.core.text import counted, listed

#: Sections of the options of view.
_SHOWN, _WRITTEN = "What to show", "Instead of the browser"
WHAT_HELP = "A dataset, or a folder or file of motion: .npy .npz .pkl .bvh."
WALL_HELP = "All on one stage, at most 12."
OUT_HELP = "Write a page (.html) or a video (.mp4), with music if its terms allow it."


@command
def view(
    path: Annotated[Path, typer.Argument(metavar="WHAT", help=WHAT_HELP)],
    clip: Annotated[str, typer.Argument(metavar="CLIP", help="Where to begin: the id of a clip or group.")] = "",
    compare: Annotated[
        list[Path] | None,
        option(metavar="PATH", help="A dataset, folder or file to show beside; repeatable.", panel=_SHOWN),
    ] = None,
    wall: Annotated[bool, option("--wall", help=WALL_HELP, panel=_SHOWN)] = False,
    overlay: Annotated[
        bool, option("--overlay", help="Draw the other motion over the dancer.", panel=_SHOWN)
    ] = False,
    music: Annotated[Path | None, option(metavar="PATH", help=MUSIC_HELP, panel=_SHOWN)] = None,
    at: Annotated[float, option(metavar="SECONDS", help="Where to begin in the clip.", panel=_SHOWN, min=0.0)] = 0.0,
    out: Annotated[Path | None, option("-o", "--out", metavar="FILE", help=OUT_HELP, panel=_WRITTEN)] = None,
    silent: Annotated[bool, option("--silent", help="Leave the music out.", panel=_WRITTEN)] = False,
    rights: Annotated[str | None, option(metavar="TEXT", help=RIGHTS_HELP, panel=_WRITTEN)] = None,
    overwrite: Annotated[bool, option("--overwrite", help="Replace the file.", panel=_WRITTEN)] = False,
    like: Like = None,
    field: Field = None,
    normalized: Normalized = None,
    scaler: Scaler = None,
    clamp: Clamp = False,
    fps: Fps = None,
    up: Up = None,
    unit: Unit = None,
    body_model: BodyModel = None,
    betas: Betas = None,
    size: Annotated[str, option(metavar="WxH", help="Pixels of a video.", panel=RARE)] = "1280x720",
    port: Annotated[
        int, option(metavar="N", help="Port on 127.0.0.1; default a free one.", panel=RARE, min=0, max=65535)
    ] = 0,
    no_browser: Annotated[bool, option("--no-browser", help="Only print the address.", panel=RARE)] = False,
    plugins: Plugins = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> Output | None:
    """Watch a dataset, or a model's samples, with their music.

    dancedata view data/aistpp
    dancedata view gen                      (samples; the truth stands beside)
    dancedata view data/aistpp gBR_sBM_cAll_d04_mBR0_ch02
    dancedata view data/aistpp --compare gen --wall -o wall.html
    """
    from dancedata.execution.addresses import local_folder
    from dancedata.execution.progress import Progress
    from dancedata.scene.selection import ViewRequest
    from dancedata.viewer.view import export_page, serve

    request = ViewRequest(
        local_folder(path), clip, compare=tuple(map(local_folder, compare or ())), like=like, field=field,
        music=music, normalized=normalized, scaler=scaler, clamp=clamp, fps=fps, up=up or "y", unit=unit, at=at,
        overlay=overlay, wall=wall, body_model=body_model, betas=betas_of(betas),
    )  # fmt: skip
    if out is None:
        if silent or rights is not None or overwrite:
            raise UsageError("--silent, --rights and --overwrite go with a file", fix="name it: --out FILE.html")
        if as_json:
            raise UsageError("a page that is served has no document", fix="write it: --out FILE.html")
        serve(request, port=port, browser=not no_browser, say=say)
        return None
    notes: list[str] = []
    how: dict[str, Any] = {"silent": silent, "rights": rights, "overwrite": overwrite, "say": notes.append}
    with Progress(quiet).stage("writing the page" if out.suffix != ".mp4" else "writing the video", None):
        if out.suffix.lower() == ".mp4":
            from dancedata.plot.video import export_video

            written = export_video(request, out, size=size, **how)
        else:
            written = export_page(request, out, **how)
    return Output(lambda: {"path": str(written), "notes": notes}, lambda: "\n".join([str(written), *notes]))


@command
def report(
    path: Annotated[Path, typer.Argument(metavar="WHAT", help="A dataset, or samples: a folder or a file.")],
    compare: Annotated[Path | None, option(metavar="DATASET", help="Another dataset to compare with.")] = None,
    out: Annotated[
        Path | None, option("-o", "--out", metavar="FILE.html", help="The page; default NAME-report.html.")
    ] = None,
    clips: Annotated[
        str, option(metavar="N", help="Clips that play: the most suspicious and others; or all, none.")
    ] = "12",
    music: Music = None,
    rights: Rights = None,
    overwrite: Overwrite = False,
    protocol: Protocol = "dancedata",
    split: Split = None,
    like: Like = None,
    field: Field = None,
    normalized: Normalized = None,
    scaler: Scaler = None,
    clamp: Clamp = False,
    fps: Fps = None,
    plugins: Plugins = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> Output:
    """Write one page about a dataset, or about samples.

      dancedata report data/aistpp
      dancedata report gen                    (folder of train.save_samples)
      dancedata report gen --like data/aistpp --field edge151 --normalized

    The document of --json has every number; with it a page is written for --out alone.
    """
    from dancedata.samples.saved import saved_samples
    from dancedata.store.schema import DATASET_FILE

    if like is None and (saved := saved_samples(path)) is not None:
        like = saved.dataset
    if like is not None and path.exists() and not (path / DATASET_FILE).exists():
        page = out or (None if as_json else Path(f"{path.stem}-report.html"))
        return _samples_report(
            path, like, page, compare=compare, clips=clips, music=music, protocol=protocol, split=split, field=field,
            normalized=normalized, scaler=scaler, clamp=clamp, fps=fps, overwrite=overwrite,
            progress=not quiet,
        )  # fmt: skip
    of_samples = {
        "--like": like, "--split": split, "--field": field, "--normalized or --not-normalized": normalized,
        "--scaler": scaler, "--clamp": clamp or None, "--fps": fps,
    }  # fmt: skip
    if stray := [name for name, value in of_samples.items() if value is not None]:
        raise UsageError(f"{' and '.join(stray)} goes with samples of a model, and this is a dataset", where=path,
                         fix="leave it out")  # fmt: skip
    from dancedata.pages.findings import findings
    from dancedata.pages.write import default_path, write_report

    chosen: Any = int(clips) if clips.isdecimal() else clips  # write_report checks it
    written = write_report(
        path, out or (None if as_json else default_path(path)), clips=chosen, source=music,
        audio="none" if music is None else "embed", rights=rights, against=compare, overwrite=overwrite,
        progress=not quiet,
    )  # fmt: skip
    return Output(
        written.to_json,
        lambda: "\n".join([_page(written.path), *(_finding(f.kind, f.text) for f in findings(written.numbers))]),
    )


def _samples_report(
    path: Path, like: Path, out: Path | None, *, clips: str, compare: Path | None, music: Path | None,
    overwrite: bool, progress: bool, **how: Any,
) -> Output:  # fmt: skip
    if compare is not None or not clips.isdecimal():
        raise UsageError("--compare goes with a dataset, and --clips of samples is a number", where=path)
    from dancedata.evaluation.run import evaluate
    from dancedata.pages.samples import require_free_page, write_samples_report
    from dancedata.pages.samples_page import describe

    require_free_page(out, like, overwrite=overwrite)
    scores = evaluate(path, like=like, role="generated", music=music, progress=progress, **how)
    samples = write_samples_report(scores, like, out, clips=int(clips), overwrite=overwrite, progress=progress)
    return Output(samples.to_json, lambda: "\n".join(describe(samples)), warnings=samples.scores.warnings)


def _page(path: Path | None) -> str:
    return "" if path is None else f"{path}: {path.stat().st_size / 1e6:.1f} MB"


def _finding(kind: str, text: str) -> str:
    return f"  {kind if kind in ('good', 'note') else 'warning'}: {text}"


@command
def study(
    paths: Annotated[list[Path], typer.Argument(metavar="A B...", help="Datasets or samples; or files of answers.")],
    out: Annotated[Path | None, option("-o", "--out", metavar="FILE.html", help="The page to write.")] = None,
    names: Annotated[
        str | None, option(metavar="NAMES", help="Of the systems: truth,mine; default those of the folders.")
    ] = None,
    songs: Annotated[int, option(metavar="N", help="Clips that each pair is shown on.", min=1)] = 12,
    seconds: Annotated[float, option(metavar="S", help="Longest clip.")] = 15.0,
    seed: Annotated[int, option(metavar="N", help="Of clips, sides and orders.")] = 0,
    music: Music = None,
    rights: Rights = None,
    overwrite: Overwrite = False,
    like: Like = None,
    field: Field = None,
    normalized: Normalized = None,
    scaler: Scaler = None,
    clamp: Clamp = False,
    fps: Fps = None,
    up: Up = None,
    unit: Unit = None,
) -> Output:
    """Ask people which of two dances is better.

      dancedata study data/aistpp gen -o study.html
      dancedata study answers/*.csv

    Raters open the page offline, and send back a CSV file of answers. The first system has the music.
    """
    if all(path.suffix.lower() == ".csv" for path in paths):
        return _answers(paths)
    from dancedata.scene.selection import ViewRequest
    from dancedata.store.schema import DATASET_FILE
    from dancedata.study.page import StudyRequest, write_study

    if out is None:
        raise UsageError("a study is a page", fix="name it: --out study.html")
    called = [path.name for path in paths] if names is None else [name.strip() for name in names.split(",")]
    if len(called) != len(paths) or len(set(called)) < len(called) or "" in called:
        raise UsageError("every system needs a name of its own", found=listed(called),
                         allowed=counted(len(paths), "name"), fix="give them: --names truth,mine")  # fmt: skip
    of_files: dict[str, Any] = {
        "like": like, "normalized": normalized, "scaler": scaler, "clamp": clamp, "fps": fps,
        "up": up or "y", "unit": unit,
    }  # fmt: skip
    systems = {
        name: ViewRequest(
            path,
            field=field,
            music=music if path == paths[0] else None,
            **({} if (path / DATASET_FILE).exists() else of_files),
        )
        for name, path in zip(called, paths, strict=True)
    }
    lines: list[str] = []
    request = StudyRequest(systems, songs=songs, seconds=seconds, seed=seed)
    trials = write_study(request, out, rights=rights, overwrite=overwrite, say=lines.append)
    pairs = sum(not trial.is_check for trial in trials)
    lines.append(
        f"{out}: {counted(pairs, 'pair')} and {counted(len(trials) - pairs, 'check')} of {', '.join(called)}"
    )
    lines.append("next: send the page to raters, then dancedata study THEIR-FILES.csv")
    return Output(lambda: {"path": str(out), "pairs": pairs, "systems": called}, lambda: "\n".join(lines))


def _answers(files: list[Path]) -> Output:
    """Count the answers of raters."""
    from dancedata.study.results import read_results, results_of

    results = results_of(*read_results(files))
    return Output(results.to_json, lambda: str(results), warnings=results.notes)
