"""dancedata view, report, study: pages for the browser."""

from pathlib import Path
from typing import Any

from dancedata.cli.command import Output, command
from dancedata.cli.help import RARE
from dancedata.cli.terminal import say
from dancedata.core.errors import UsageError
from dancedata.core.text import counted, listed

#: Sections of the options of view.
_SHOWN, _WRITTEN = "What to show", "Instead of the browser"


@command(
    "music rights overwrite like field normalized scaler clamp fps up unit body_model betas plugins quiet",
    path="WHAT: A dataset, or a folder, file or pattern of motion: .npy .npz .pkl .bvh.",
    clip="CLIP: Where to begin: the id of a clip, window or group.",
    compare=(_SHOWN, "PATH: A dataset, folder or file to show alongside; repeatable."),
    wall=(_SHOWN, "Show all side by side on one stage, at most 12."),
    overlay=(_SHOWN, "Draw the other motion over the dancer."),
    at=(_SHOWN, "SECONDS: Where to begin in the clip."),
    out=(_WRITTEN, "FILE: Write a page (.html) or a video (.mp4), with music if its terms allow it."),
    silent=(_WRITTEN, "Leave the music out."),
    music=_SHOWN,
    rights=_WRITTEN,
    overwrite=_WRITTEN,
    size=(RARE, "WxH: Pixels of a video."),
    port=(RARE, "N: Port on 127.0.0.1; default a free one."),
    no_browser=(RARE, "Only print the address."),
)
def view(
    path: Path, clip: str = "", *, compare: list[Path] | None = None, wall: bool = False, overlay: bool = False,
    at: float = 0.0, out: Path | None = None, silent: bool = False, size: str = "1280x720", port: int = 0,
    no_browser: bool = False, rights: str | None, overwrite: bool, up: str | None, progress: bool, as_json: bool,
    **read: Any,
) -> Output | None:  # fmt: skip
    """Watch a dataset, or a model's samples, with their music.

    dancedata view data/aistpp
    dancedata view gen                      (samples, beside the truth)
    dancedata view data/aistpp gBR_sBM_cAll_d04_mBR0_ch02
    dancedata view data/aistpp --compare gen --wall -o wall.html
    """
    from dancedata.files.addresses import local_folder
    from dancedata.kernel import Progress
    from dancedata.scene.selection import ViewRequest
    from dancedata.viewer.view import export_page, serve

    if not 0 <= at < float("inf"):
        raise UsageError("--at is not within a clip", found=at, allowed="seconds, 0 and above")
    beside = tuple(map(local_folder, compare or ()))
    request = ViewRequest(
        local_folder(path), clip, compare=beside, up=up or "y", at=at, overlay=overlay, wall=wall, **read
    )
    if out is None:
        if silent or rights is not None or overwrite:
            raise UsageError(
                "--silent, --rights and --overwrite need a file to write", fix="name it: --out FILE.html"
            )
        if as_json:
            raise UsageError(
                "a page that is served in the browser prints no JSON document", fix="write it: --out FILE.html"
            )
        serve(request, port=port, browser=not no_browser, say=say)
        return None
    notes: list[str] = []
    how: dict[str, Any] = {"silent": silent, "rights": rights, "overwrite": overwrite, "say": notes.append}
    with Progress(not progress).stage("writing the page" if out.suffix != ".mp4" else "writing the video", None):
        if out.suffix.lower() == ".mp4":
            from dancedata.plot.video import export_video

            written = export_video(request, out, size=size, **how)
        else:
            written = export_page(request, out, **how)
    return Output(lambda: {"path": str(written), "notes": notes}, lambda: "\n".join([str(written), *notes]))


@command(
    "music rights overwrite protocol split like field normalized scaler clamp fps plugins quiet",
    path="WHAT: A dataset, or samples: a folder, a file or a pattern.",
    compare="DATASET: Another dataset to compare with.",
    out="FILE.html: The page; default NAME-report.html.",
    clips="N: How many clips play, the most suspicious among them; or all, none.",
)
def report(
    path: Path, *, compare: Path | None = None, out: Path | None = None, clips: str = "12", music: Path | None,
    rights: str | None, overwrite: bool, progress: bool, as_json: bool, **of_samples: Any,
) -> Output:  # fmt: skip
    """Write one page about a dataset, or about samples.

      dancedata report data/aistpp
      dancedata report gen                    (folder of train.save_samples)
      dancedata report gen --like data/aistpp --field edge151 --normalized

    --json prints every number, and then a page is written only if --out is given.
    """
    from dancedata import calls
    from dancedata.pages.findings import findings
    from dancedata.pages.samples_page import describe
    from dancedata.pages.write import Report, default_path
    from dancedata.store.schema import DATASET_FILE

    page = out
    if page is None and not as_json:
        page = default_path(path) if (path / DATASET_FILE).exists() else Path(f"{path.stem}-report.html")
    # Flags that are not given are False, except --normalized.
    as_evaluate = {
        name: v for name, v in of_samples.items() if v is not None and (v is not False or name == "normalized")
    }
    chosen: Any = int(clips) if clips.isdecimal() else clips
    written = calls.report(
        path, page, compare=compare, music=music, rights=rights, clips=chosen, overwrite=overwrite, progress=progress,
        **as_evaluate,
    )  # fmt: skip
    if not isinstance(written, Report):
        samples = written
        return Output(samples.to_json, lambda: "\n".join(describe(samples)), warnings=samples.scores.warnings)
    size = "" if written.path is None else f"{written.path}: {written.path.stat().st_size / 1e6:.1f} MB"
    kinds = {"good": "good", "note": "note"}
    lines = [size, *(f"  {kinds.get(f.kind, 'warning')}: {f.text}" for f in findings(written.numbers))]
    return Output(written.to_json, lambda: "\n".join(lines))


@command(
    "music rights overwrite like field normalized scaler clamp fps up unit",
    paths="A B...: Datasets or samples; or files of answers.",
    out="FILE.html: The page to write.",
    names="NAMES: Names of the systems: truth,mine; default: their folders.",
    songs="N: Clips that each pair is shown on.",
    seconds="S: Maximum length of a clip.",
    seed="N: Seed that draws clips, sides and orders.",
)
def study(
    paths: list[Path], *, out: Path | None = None, names: str | None = None, songs: int = 12, seconds: float = 15.0,
    seed: int = 0, music: Path | None, rights: str | None, overwrite: bool, field: str | None, up: str | None,
    **of_files: Any,
) -> Output:  # fmt: skip
    """Ask people which of two dances is better.

      dancedata study data/aistpp gen -o study.html
      dancedata study answers/*.csv

    Raters open the page offline, and send back a CSV file of answers. The music is that of the first system.
    """
    if all(path.suffix.lower() == ".csv" for path in paths):
        from dancedata.files.listing import named_files
        from dancedata.study.results import read_results, results_of

        if out is not None or names is not None:
            raise UsageError("--out and --names need systems, and these are answers to count", fix="leave them out")
        results = results_of(*read_results(named_files(paths, (".csv",))))
        return Output(results.to_json, lambda: str(results), warnings=results.notes)
    from dancedata.scene.selection import ViewRequest
    from dancedata.store.schema import DATASET_FILE
    from dancedata.study.page import StudyRequest, write_study

    if out is None:
        raise UsageError("a study is a page", fix="name it: --out study.html")
    called = [path.name for path in paths] if names is None else [name.strip() for name in names.split(",")]
    if len(called) != len(paths) or len(set(called)) < len(called) or "" in called:
        raise UsageError("every system needs a name of its own", found=listed(called),
                         allowed=counted(len(paths), "name"), fix="give them: --names truth,mine")  # fmt: skip
    of_files["up"] = up or "y"
    systems = {}
    for name, path in zip(called, paths, strict=True):
        read: dict[str, Any] = {} if (path / DATASET_FILE).exists() else of_files
        systems[name] = ViewRequest(path, field=field, music=music if path == paths[0] else None, **read)
    lines: list[str] = []
    request = StudyRequest(systems, songs=songs, seconds=seconds, seed=seed)
    trials = write_study(request, out, rights=rights, overwrite=overwrite, say=lines.append)
    pairs = sum(not trial.is_check for trial in trials)
    checks = counted(len(trials) - pairs, "check")
    lines.append(f"{out}: {counted(pairs, 'pair')} and {checks} of {', '.join(called)}")
    lines.append("next: send the page to raters, then dancedata study THEIR-FILES.csv")
    return Output(lambda: {"path": str(out), "pairs": pairs, "systems": called}, lambda: "\n".join(lines))
