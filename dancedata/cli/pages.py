"""dancedata view and dancedata report: pages for the browser."""

from pathlib import Path
from typing import Annotated, Any

import typer

from dancedata.cli.options import (
    Betas,
    BodyModel,
    Clip,
    Normalized,
    Plugins,
    Quiet,
    ScalerFile,
    betas_of,
    errors_to_exit_codes,
)
from dancedata.cli.terminal import say
from dancedata.core.errors import UsageError
from dancedata.core.plugin_files import load_plugins
from dancedata.core.text import json_text
from dancedata.execution.progress import Progress

VIEW_HELP = "A built dataset, a folder of motion files, or one: .bvh, .npz, .npy, .pkl."
FIELD_HELP = "Motion field to draw, and what columns of motion files are; default: what they state, or their width."
MUSIC_HELP = "A song, a folder of songs, or a CSV file sample,song,start_s; of a dataset the folder of its source."
WALL_HELP = "All on one stage: a clip and what it is compared with, or the clips of a song; at most 12."
SIZE_HELP = "With --video: WIDTHxHEIGHT in pixels, such as 1080x1920 or 1080x1080."
COMPARE_HELP = "Another dataset, a folder of <clip>.npy, .npz, .pkl or .bvh, or one such file; repeat it for several."
VIDEO_HELP = "Write the clip as a video, and serve nothing; needs the extra video."
EXPORT_HELP = "Write the clip as one HTML page, and serve nothing."
SHARE_HELP = "You state that you have the right to pass this music on."


@errors_to_exit_codes
def view(
    store: Annotated[Path, typer.Argument(metavar="X", help=VIEW_HELP)],
    clip: Annotated[
        str, typer.Argument(metavar="CLIP", help="Clip or group to begin with, or a window CLIP@START+LENGTH.")
    ] = "",
    like: Annotated[Path | None, typer.Option(metavar="STORE", help="Dataset with their scaler and rate.")] = None,
    music: Annotated[Path | None, typer.Option(metavar="PATH", help=MUSIC_HELP)] = None,
    compare: Annotated[list[Path] | None, typer.Option(help=COMPARE_HELP)] = None,
    normalized: Normalized = None,
    scaler: ScalerFile = None,
    clip_to_range: Clip = False,
    fps: Annotated[str | None, typer.Option(help="Frame rate of motion files; default: the dataset's.")] = None,
    up: Annotated[str, typer.Option(help="Up axis of motion files: y or z.")] = "y",
    unit: Annotated[
        str | None, typer.Option(help="Unit of motion files: m, cm, ...; default: m of positions, guessed of BVH.")
    ] = None,
    wall: Annotated[bool, typer.Option("--wall", help=WALL_HELP)] = False,
    overlay: Annotated[bool, typer.Option("--overlay", help="Draw --compare over the dancer.")] = False,
    field: Annotated[str | None, typer.Option(metavar="NAME", help=FIELD_HELP)] = None,
    body_model: BodyModel = None,
    betas: Betas = None,
    at: Annotated[float, typer.Option(min=0.0, metavar="SECONDS", help="Time to begin at.")] = 0.0,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port on 127.0.0.1; 0: a free one.")] = 0,
    no_browser: Annotated[bool, typer.Option("--no-browser", help="Only print the address.")] = False,
    export: Annotated[Path | None, typer.Option(metavar="FILE.html", help=EXPORT_HELP)] = None,
    video: Annotated[Path | None, typer.Option(metavar="FILE.mp4", help=VIDEO_HELP)] = None,
    size: Annotated[str, typer.Option(metavar="WxH", help=SIZE_HELP)] = "1280x720",
    audio: Annotated[str, typer.Option(help="With --export or --video: none, or embed the clip's music.")] = "none",
    share: Annotated[bool, typer.Option("--i-may-share-this-music", help=SHARE_HELP)] = False,
    overwrite: Annotated[bool, typer.Option(help="With --export or --video: replace the file.")] = False,
    plugins: Plugins = None,
    quiet: Quiet = False,
) -> None:
    """Look at a dataset, or any motion, in the browser.

    dancedata view X [CLIP]; Ctrl-C ends it.
    """
    from dancedata.execution.addresses import local_folder
    from dancedata.scene.selection import ViewRequest
    from dancedata.viewer.view import export_page, serve

    load_plugins(*(plugins or ()))

    if audio not in ("none", "embed"):
        raise UsageError("invalid value for --audio", found=audio, allowed="none, embed")
    if export is not None and video is not None:
        raise UsageError("--export and --video are two outputs", fix="call it for each")
    request = ViewRequest(
        path=local_folder(store), clip=clip, field=field, like=like, music=music,
        compare=tuple(map(local_folder, compare or ())), normalized=normalized, fps=fps, up=up, unit=unit, at=at,
        scaler=scaler, clamp=clip_to_range, overlay=overlay, wall=wall,
        body_model=body_model, betas=betas_of(betas),
    )  # fmt: skip
    notes: list[str] = []
    share_options: dict[str, Any] = {"audio": audio == "embed", "shared": share, "overwrite": overwrite}
    if export is not None:
        with Progress(quiet).stage("writing the page", None):
            written = export_page(request, export, say=notes.append, **share_options)
        for line in (str(written), *notes):
            say(line)
    elif video is not None:
        from dancedata.plot.video import export_video

        with Progress(quiet).stage("writing the video", None):
            written = export_video(request, video, size=size, say=notes.append, **share_options)
        for line in (str(written), *notes):
            say(line)
        if audio == "none":
            say("  without sound; with the clip's music: --music PATH and --audio embed")
    elif audio != "none":
        raise UsageError(
            "--audio goes with --export or --video", fix="the page that is served plays the music of --music"
        )
    else:
        serve(request, port=port, browser=not no_browser, say=say)


TO_HELP = "HTML file to write; default NAME-report.html in the current folder, none with --json alone."
CLIPS_HELP = "Clips that the page plays: the most suspicious and others; above 12 in a folder next to the page."
CARD_HELP = "Write a README.md for a hub instead, with three pictures: to --to, default README.md."
REPORT_HELP = "A built dataset; with --against also a folder of a model's samples, or one file."
OF_SAMPLES = "Of samples:"
SPLIT_HELP = f"{OF_SAMPLES} splits of OTHER as ground truth; default test, or all."
REPORT_SHARE_HELP = "State that you may share the music although the dataset's licence forbids it."


@errors_to_exit_codes
def report(
    store: Annotated[Path, typer.Argument(metavar="OUT", help=REPORT_HELP)],
    to: Annotated[Path | None, typer.Option(metavar="FILE.html", help=TO_HELP)] = None,
    clips: Annotated[str, typer.Option(metavar="N|all|none", help=CLIPS_HELP)] = "12",
    audio: Annotated[str, typer.Option(help="none, or embed: the music of the clips inside the page.")] = "none",
    music: Annotated[Path | None, typer.Option(metavar="PATH", help=MUSIC_HELP)] = None,
    may_share: Annotated[bool, typer.Option("--i-may-share-this-music", help=REPORT_SHARE_HELP)] = False,
    against: Annotated[
        Path | None, typer.Option(metavar="OTHER", help="A built dataset to compare with, or that samples are of.")
    ] = None,
    card: Annotated[bool, typer.Option("--card", help=CARD_HELP)] = False,
    protocol: Annotated[str, typer.Option(help=f"{OF_SAMPLES} protocol of the scores.")] = "dancedata",
    split: Annotated[str | None, typer.Option(help=SPLIT_HELP)] = None,
    field: Annotated[str | None, typer.Option(help=f"{OF_SAMPLES} motion field of OTHER that columns are.")] = None,
    normalized: Normalized = None,
    scaler: ScalerFile = None,
    clip_to_range: Clip = False,
    fps: Annotated[str | None, typer.Option(help=f"{OF_SAMPLES} frame rate; default: OTHER's.")] = None,
    max_mb: Annotated[float, typer.Option(min=0, help="Largest page, megabytes.")] = 20,
    overwrite: Annotated[bool, typer.Option(help="Overwrite an existing file.")] = False,
    plugins: Plugins = None,
    quiet: Quiet = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print every number of the page as JSON.")] = False,
) -> None:
    """Write a page about a dataset, or a model's samples.

    dancedata report OUT --to FILE.html
    """
    load_plugins(*(plugins or ()))
    from dancedata.comparison import diff
    from dancedata.pages.findings import findings
    from dancedata.pages.write import default_path, write_report
    from dancedata.samples.saved import saved_samples
    from dancedata.store.schema import DATASET_FILE

    if card:
        from dancedata.plot.card import card_pictures
        from dancedata.remote.card import write_card

        if as_json or against is not None or audio != "none":
            raise UsageError("--card goes with --to, --overwrite and --quiet alone", fix="call it for each")
        path = write_card(store, to or "README.md", pictures=card_pictures, overwrite=overwrite, progress=not quiet)
        say(f"{path}, and its pictures in {path.stem}_files")
        return
    of_samples = {
        "--split": split, "--field": field, "--normalized or --not-normalized": normalized, "--scaler": scaler,
        "--clip-values": clip_to_range or None, "--fps": fps,
    }  # fmt: skip
    if against is None and (saved := saved_samples(store)) is not None:
        against = saved.dataset
    if against is not None and store.exists() and not (store / DATASET_FILE).exists():
        if audio != "none" or not clips.isdecimal():
            raise UsageError("the page of samples has no music, and --clips is a number", fix="leave --audio out")
        from dancedata.evaluation.run import evaluate
        from dancedata.pages.samples import require_free_page, write_samples_report
        from dancedata.pages.samples_page import describe

        page = to if to is not None or as_json else Path(f"{store.stem}-report.html")
        show = not (quiet or as_json)
        require_free_page(page, against, overwrite=overwrite)
        scores = evaluate(
            store, protocol=protocol, like=against, role="generated", split=split, field=field, normalized=normalized,
            scaler=scaler, clamp=clip_to_range, fps=fps, music=music, progress=show,
        )  # fmt: skip
        samples = write_samples_report(
            scores, against, page, clips=int(clips), max_mb=max_mb, overwrite=overwrite, progress=show
        )
        if as_json:
            typer.echo(json_text(samples.to_json()))
            return
        for line in describe(samples):
            say(line)
        return
    if stray := [name for name, value in of_samples.items() if value is not None]:
        raise UsageError(f"{' and '.join(stray)} goes with samples of a model, and this is a dataset", where=store,
                         fix="leave it out")  # fmt: skip
    target = to if to is not None or as_json else default_path(store)
    chosen: Any = int(clips) if clips.isdecimal() else clips  # write_report checks both
    how: Any = audio
    written = write_report(
        store, target, clips=chosen, audio=how, source=music, may_share=may_share, against=against, differences=diff,
        max_mb=max_mb, overwrite=overwrite, progress=not (quiet or as_json),
    )  # fmt: skip
    if as_json:
        typer.echo(json_text(written.to_json()))
        return
    if written.path is not None:
        say(f"{written.path}: {written.path.stat().st_size / 1e6:.1f} MB")
    for finding in findings(written.numbers):
        say(f"  {finding.kind}: {finding.text}")
