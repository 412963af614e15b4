"""dancedata evaluate, decode, features: what a model makes, judged and turned into files; and songs for it."""

from pathlib import Path
from typing import Annotated, Any

import typer

from dancedata.cli.command import Output, command
from dancedata.cli.options import (
    Betas,
    Body,
    BodyModel,
    CacheFolder,
    Clamp,
    Cluster,
    Field,
    Fps,
    Jobs,
    Like,
    Music,
    Normalized,
    Overwrite,
    Plugins,
    Protocol,
    Quiet,
    Scaler,
    Split,
    Unit,
    Up,
    betas_of,
    option,
)  # fmt: skip
from dancedata.core.text import counted, listed

WHAT_HELP = "Samples (a folder or a file) or datasets; scores for each."
POOL_HELP = "What FID and Div compare with: a dataset, a folder, an .npz of --out, or splits; default train."
TABLES_HELP = ".csv a line per sample, .json everything, .md or .tex a table, .npz the pool; repeatable."
FORMATS_HELP = "bvh, smpl (AMASS's arrays), smplx, npz, glb, or obj (a mesh per frame)."
FRAMES_HELP = "Frames of obj, from 0: N, or A:B:STEP."
SAMPLES_HELP = "Files (.npy .npz .pkl), folders of them, or patterns such as 'gen/*.npy'."
SONGS_HELP = "Music files (wav, flac, mp3, ogg), folders of them, or patterns."
WEIGHTS_HELP = "A network's weights; once per field where several need some."


@command
def evaluate(
    paths: Annotated[list[Path], typer.Argument(metavar="WHAT...", help=WHAT_HELP)],
    protocol: Protocol = "dancedata",
    split: Split = None,
    pool: Annotated[str | None, option(metavar="PATH|SPLITS", help=POOL_HELP)] = None,
    metric: Annotated[list[str] | None, option(metavar="NAME", help="Only this one; repeatable.")] = None,
    music: Music = None,
    out: Annotated[list[Path] | None, option("-o", "--out", metavar="FILE", help=TABLES_HELP)] = None,
    strict: Annotated[bool, option("--strict", help="Exit code 1 if a score means nothing.")] = False,
    overwrite: Overwrite = False,
    jobs: Jobs = None,
    like: Like = None,
    field: Field = None,
    normalized: Normalized = None,
    scaler: Scaler = None,
    clamp: Clamp = False,
    fps: Fps = None,
    up: Up = None,
    unit: Unit = None,
    body: Body = None,
    cluster: Cluster = None,
    cache: CacheFolder = None,
    plugins: Plugins = None,
    quiet: Quiet = False,
) -> Output:
    """Score samples by a paper's protocol.

      dancedata evaluate gen                  (folder of train.save_samples)
      dancedata evaluate gen data/aistpp --split test
      dancedata evaluate gen --like data/aistpp --field edge151 --normalized

    A score in (brackets) means nothing; the row says why.
    """
    from dancedata.evaluation.outputs import Outputs
    from dancedata.evaluation.run import evaluate as run_evaluate

    files = Outputs.of(out or (), overwrite=overwrite)
    is_place = pool is not None and (Path(pool).exists() or "/" in pool or "." in pool)
    how: dict[str, Any] = {
        "pool" if is_place else "pool_split": pool, "music": music, "field": field, "protocol": protocol,
        "split": split, "like": like, "normalized": normalized, "scaler": scaler, "clamp": clamp, "fps": fps,
        "up": up,
        "unit": unit,
        "body": body, "metrics": metric or (), "save_pool": files.pool, "jobs": jobs, "cache": cache,
        "scheduler": cluster, "progress": not quiet,
    }  # fmt: skip
    reports = run_evaluate([*paths], **how)
    files.write(reports)
    return Output(
        lambda: {"reports": [report.to_json() for report in reports]},
        lambda: "\n\n".join(map(str, reports)),
        ok=not (strict and any(score.verdict == "void" for report in reports for score in report.scores)),
        warnings=[warning for report in reports for warning in report.warnings],
    )


@command
def decode(
    files: Annotated[list[Path], typer.Argument(metavar="SAMPLES...", help=SAMPLES_HELP)],
    to: Annotated[str, option(metavar="FORMAT", help=FORMATS_HELP)],
    out: Annotated[Path, option("-o", "--out", metavar="DIR", help="Folder for the files.")],
    frames: Annotated[str | None, option(metavar="A:B:C", help=FRAMES_HELP)] = None,
    overwrite: Overwrite = False,
    like: Like = None,
    field: Field = None,
    normalized: Normalized = None,
    scaler: Scaler = None,
    clamp: Clamp = False,
    fps: Fps = None,
    body_model: BodyModel = None,
    betas: Betas = None,
    plugins: Plugins = None,
    quiet: Quiet = False,
) -> Output:
    """Turn samples into BVH, SMPL, glTF, npz or a mesh.

    dancedata decode gen --to bvh -o bvh    (folder of train.save_samples)
    dancedata decode 'gen/*.npy' --to glb -o glb --like data/aistpp
    """
    from dancedata.decoding.decode import decode as run_decode

    kind: Any = to  # checked there
    written: Any = run_decode(
        list(files), field, to=kind, out=out, like=like, fps=fps, overwrite=overwrite, normalized=normalized,
        scaler=scaler, clamp=clamp, body_model=body_model, betas=betas_of(betas), frames=frames,
    )  # fmt: skip
    paths = [str(path) for path in written]
    text = f"{out}: {counted(len(paths), f'{to} file')} of {listed(files, 3)}"
    text += f", such as {written[0].name}" if written else ""
    return Output(lambda: {"files": paths}, lambda: text)


@command
def features(
    songs: Annotated[list[Path], typer.Argument(metavar="SONGS...", help=SONGS_HELP)],
    out: Annotated[
        Path, option("-o", "--out", metavar="DIR", help="Folder for SONG.FIELD.npy and .json; default features.")
    ] = Path("features"),
    field: Annotated[
        str | None, option(metavar="NAME", help="The feature; default those of --like, else librosa35.")
    ] = None,
    like: Annotated[
        str | None, option(metavar="DATASET", help="A dataset or a recipe: its features, rate and slices.")
    ] = None,
    bpm: Annotated[
        float | None, option(metavar="N", help="Tempo; default what --like states, else estimated.")
    ] = None,
    weights: Annotated[list[str] | None, option(metavar="[FIELD=]FOLDER", help=WEIGHTS_HELP)] = None,
    plugins: Plugins = None,
    quiet: Quiet = False,
) -> Output:
    """Compute music features for your own songs.

      dancedata features songs --like data/aistpp
      dancedata features song.mp3 --field librosa35 --bpm 120

    The rows are exactly those of training. Files of an earlier run are replaced.
    """
    from dancedata.songs import describe_features, find_jobs, write_features

    written = write_features(songs, out, find_jobs(field, like), bpm, weights or (), like=like)
    return Output(lambda: {"songs": written}, lambda: "\n".join(describe_features(out, song) for song in written))
