"""dancedata view and dancedata report: pages for the browser."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from dancedata.cli.options import Clip, Normalized, Quiet, ScalerFile, errors_to_exit_codes
from dancedata.cli.terminal import say
from dancedata.core.errors import UsageError
from dancedata.core.text import json_text
from dancedata.execution.progress import Progress

SOURCE_HELP = "Folder that the dataset was built from: its music, and the original motion to compare with."
COMPARE_HELP = "Another dataset, a folder of <clip>.npy, .npz, .pkl or .bvh, or one such file; repeat it for several."
AS_HELP = "What columns of --compare are: edge151, ...; default: joint positions, or the files' own rotations."
VIDEO_HELP = "Write the clip as a video, and serve nothing; needs the extra video."
EXPORT_HELP = "Write the clip as one HTML page, and serve nothing."
SHARE_HELP = "You state that you have the right to pass this music on."


@errors_to_exit_codes
def view(
    store: Annotated[Path, typer.Argument(metavar="OUT", help="A built dataset.")],
    clip: Annotated[str, typer.Argument(help="Id of the clip or group to begin with.")] = "",
    source: Annotated[Path | None, typer.Option(help=SOURCE_HELP)] = None,
    compare: Annotated[list[Path] | None, typer.Option(help=COMPARE_HELP)] = None,
    compare_as: Annotated[str | None, typer.Option(metavar="REPRESENTATION", help=AS_HELP)] = None,
    normalized: Normalized = None,
    scaler: ScalerFile = None,
    clip_to_range: Clip = False,
    fps: Annotated[str | None, typer.Option(help="Frame rate of --compare; default: the dataset's.")] = None,
    up: Annotated[str, typer.Option(help="Up axis of --compare: y or z.")] = "y",
    unit: Annotated[str, typer.Option(help="Unit of --compare: m, cm, mm, inch.")] = "m",
    field: Annotated[str | None, typer.Option(help="Motion field to draw; default: the first that decodes.")] = None,
    at: Annotated[float, typer.Option(min=0.0, metavar="SECONDS", help="Time to begin at.")] = 0.0,
    window: Annotated[int | None, typer.Option(min=0, help="Loop this window of the clip, from 0.")] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port on 127.0.0.1; 0: a free one.")] = 0,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Only print the address.")] = False,
    export: Annotated[Path | None, typer.Option(metavar="FILE.html", help=EXPORT_HELP)] = None,
    video: Annotated[Path | None, typer.Option(metavar="FILE.mp4", help=VIDEO_HELP)] = None,
    audio: Annotated[str, typer.Option(help="With --export or --video: none, or embed the clip's music.")] = "none",
    share: Annotated[bool, typer.Option("--i-may-share-this-music", help=SHARE_HELP)] = False,
    overwrite: Annotated[bool, typer.Option(help="With --export or --video: replace the file.")] = False,
    quiet: Quiet = False,
) -> None:
    """Look at a dataset in the browser.

    dancedata view OUT [CLIP]; Ctrl-C ends it.
    """
    from dancedata.viewer.view import ViewRequest, export_page, serve

    if audio not in ("none", "embed"):
        raise UsageError("invalid value for --audio", found=audio, allowed="none, embed")
    options = {
        "--compare-as": compare_as, "--normalized or --not-normalized": normalized, "--scaler": scaler,
        "--clip-values": clip_to_range or None, "--fps": fps, "--up": None if up == "y" else up,
        "--unit": None if unit == "m" else unit,
    }  # fmt: skip
    if not compare:
        _require_served(options, "", fix="name the files: --compare FOLDER")
    if video is not None:
        _require_served({"--compare": compare, "--window": window, "--export": export}, "--video")
        _write_video(
            store, clip, video, field, source, at, embed=audio == "embed", shared=share, overwrite=overwrite,
            progress=Progress(quiet),
        )  # fmt: skip
        return
    request = ViewRequest(
        store, clip, field, source, tuple(compare or ()), compare_as, normalized, fps, up, unit, at, window, scaler,
        clip_to_range,
    )  # fmt: skip
    if export is not None:
        _require_served({"--compare": compare, "--at": at or None}, "--export")
        with Progress(quiet).stage("writing the page", None):
            page = export_page(request, export, audio=audio == "embed", shared=share, overwrite=overwrite)
        say(str(page))
        return
    if audio != "none":
        raise UsageError(
            "--audio goes with --export or --video", fix="the page that is served plays the music of --source"
        )
    serve(request, port=port, browser=not no_browser, say=say)


def _require_served(options: Mapping[str, object], output: str, fix: str = "") -> None:
    """Raise UsageError for options without effect on the file `output`, or without --compare."""
    named = [name for name, value in options.items() if value not in (None, [])]
    if named:
        raise UsageError(
            f"{' and '.join(named)} would have no effect {f'with {output}' if output else 'without --compare'}",
            fix=fix or f"leave {output} out and look at the page that is served, or leave out the others",
        )


def _write_video(
    store: Path, clip: str, video: Path, field: str | None, source: Path | None, at: float, *, embed: bool,
    shared: bool, overwrite: bool, progress: Progress,
) -> None:  # fmt: skip
    from dancedata.plot.video import write_video

    if not clip:
        raise UsageError("a video shows one clip or group", fix="name it: dancedata view OUT CLIP --video FILE.mp4")
    if embed and source is None:
        raise UsageError("the music is needed", fix="name the folder with it: --source DIR")
    music = source if embed else None
    with progress.stage("writing the video", None):
        written = write_video(
            store, clip, video, source=music, field=field, start_s=at, may_share=shared, overwrite=overwrite
        )
    say(str(written))
    if not embed:
        say("  without sound; with the clip's music: --source DIR --audio embed")


TO_HELP = "HTML file to write; default NAME-report.html in the current folder, none with --json alone."
CLIPS_HELP = "Clips that the page plays: the most suspicious and others; above 12 in a folder next to the page."
REPORT_SHARE_HELP = "State that you may share the music although the dataset's licence forbids it."


@errors_to_exit_codes
def report(
    store: Annotated[Path, typer.Argument(metavar="OUT", help="A built dataset.")],
    to: Annotated[Path | None, typer.Option(metavar="FILE.html", help=TO_HELP)] = None,
    clips: Annotated[str, typer.Option(metavar="N|all|none", help=CLIPS_HELP)] = "12",
    audio: Annotated[str, typer.Option(help="none, or embed: the music of the clips inside the page.")] = "none",
    source: Annotated[Path | None, typer.Option(help="Folder with the music, for --audio embed.")] = None,
    may_share: Annotated[bool, typer.Option("--i-may-share-this-music", help=REPORT_SHARE_HELP)] = False,
    against: Annotated[
        Path | None, typer.Option(metavar="OTHER", help="Another built dataset to compare with.")
    ] = None,
    max_mb: Annotated[float, typer.Option(min=0, help="Largest page, megabytes.")] = 20,
    overwrite: Annotated[bool, typer.Option(help="Overwrite an existing file.")] = False,
    quiet: Quiet = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print every number of the page as JSON.")] = False,
) -> None:
    """Write a page that shows what a dataset holds.

    dancedata report OUT --to FILE.html
    """
    from dancedata.report.document import findings
    from dancedata.report.write import default_path, write_report

    target = to if to is not None or as_json else default_path(store)
    chosen: Any = int(clips) if clips.isdecimal() else clips  # write_report checks both
    how: Any = audio
    written = write_report(
        store, target, clips=chosen, audio=how, source=source, may_share=may_share, against=against, max_mb=max_mb,
        overwrite=overwrite, progress=not (quiet or as_json),
    )  # fmt: skip
    if as_json:
        typer.echo(json_text(written.to_json()))
        return
    if written.path is not None:
        say(f"{written.path}: {written.path.stat().st_size / 1e6:.1f} MB")
    for finding in findings(written.numbers):
        say(f"  {finding.kind}: {finding.text}")
