"""dancedata evaluate, decode, features: what a model makes, judged and turned into files; and songs for it."""

from pathlib import Path
from typing import Any

from dancedata.cli.command import Output, command
from dancedata.core.text import counted, listed


@command(
    "protocol split music overwrite jobs like field normalized scaler clamp fps up unit body cluster cache plugins "
    "quiet",
    paths="WHAT...: Samples (a folder, a file or a pattern) or datasets; scores for each.",
    pool="PATH|SPLITS: What FID and Div compare with: a dataset, a folder, an .npz of --out, or splits; default "
    "train.",
    metric="NAME: Compute only this metric; repeatable.",
    out="FILE: .csv a line per sample, .json everything, .md or .tex a table, .npz the pool; repeatable.",
    strict="Exit code 1 if a score means nothing.",
)
def evaluate(
    paths: list[Path], *, pool: str | None = None, metric: list[str] | None = None, out: list[Path] | None = None,
    strict: bool = False, protocol: str | None, overwrite: bool, cluster: str | None, **how: Any,
) -> Output:  # fmt: skip
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
    how |= {"pool" if is_place else "pool_split": pool, "protocol": protocol or "dancedata", "metrics": metric or ()}
    reports = [run_evaluate(path, save_pool=files.pool, scheduler=cluster, **how) for path in paths]
    files.write(reports)
    return Output(
        lambda: {"reports": [report.to_json() for report in reports]},
        lambda: "\n\n".join(map(str, reports)),
        ok=not (strict and any(score.verdict == "void" for report in reports for score in report.scores)),
        warnings=[warning for report in reports for warning in report.warnings],
    )


@command(
    "overwrite like field normalized scaler clamp fps body_model betas plugins quiet",
    files="SAMPLES...: Files (.npy .npz .pkl), folders of them, or patterns such as 'gen/*.npy'.",
    to="FORMAT: bvh, smpl (AMASS's arrays), smplx, npz, glb, or obj (a mesh per frame).",
    out="DIR: Folder for the files.",
    frames="A:B:C: Frames to write as obj, counted from 0: N, or A:B:STEP.",
)
def decode(
    files: list[Path], *, to: str, out: Path, frames: str | None = None, field: str | None, progress: bool, **how: Any
) -> Output:
    """Turn samples into BVH, SMPL, glTF, npz or a mesh.

    dancedata decode gen --to bvh -o bvh    (folder of train.save_samples)
    dancedata decode 'gen/*.npy' --to glb -o glb --like data/aistpp
    """
    from dancedata.decoding.decode import decode as run_decode

    written: list[Path] = run_decode(files, field, to=to, out=out, frames=frames, **how)
    text = f"{out}: {counted(len(written), f'{to} file')} of {listed(files, 3)}"
    text += f", such as {written[0].name}" if written else ""
    return Output(lambda: {"files": list(map(str, written))}, lambda: text)


@command(
    "plugins quiet",
    songs="SONGS...: Music files (wav, flac, mp3, ogg), folders of them, or patterns.",
    out="DIR: Folder for SONG.FIELD.npy and .json; default features.",
    field="NAME: The feature; default those of --like, else librosa35.",
    like="DATASET: A dataset or a recipe: its features, rate and slices.",
    bpm="N: Tempo; default what --like states, else estimated.",
    weights="[FIELD=]FOLDER: A network's weights; repeat for each field that needs some.",
)
def features(
    songs: list[Path], *, out: Path = Path("features"), field: str | None = None, like: str | None = None,
    bpm: float | None = None, weights: list[str] | None = None, progress: bool,
) -> Output:  # fmt: skip
    """Compute music features for your own songs.

      dancedata features songs --like data/aistpp
      dancedata features song.mp3 --field librosa35 --bpm 120

    The rows are exactly those of training. Files of an earlier run are replaced.
    """
    from dancedata.songs import describe_features, find_jobs, write_features

    written = write_features(songs, out, find_jobs(field, like), bpm, weights or (), like=like)
    return Output(lambda: {"songs": written}, lambda: "\n".join(describe_features(out, song) for song in written))
