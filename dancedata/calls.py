"""view and report, which call several rooms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dancedata.core.errors import UsageError
from dancedata.core.motion import Motion
from dancedata.core.sample_id import SampleId
from dancedata.samples.saved import saved_samples
from dancedata.scene.motion_page import Page, PlayedMotion, view_motions
from dancedata.scene.page import clip_page
from dancedata.scene.selection import ViewRequest, ViewSelection
from dancedata.store import Clip, Store
from dancedata.store.schema import DATASET_FILE

if TYPE_CHECKING:
    from dancedata.pages import Report
    from dancedata.pages.samples_document import SamplesReport
    from dancedata.pages.write import Clips

__all__ = ["report", "view"]


def view(
    what: str | Path | Store | PlayedMotion,
    clip: str | SampleId = "",
    *,
    compare: Sequence[str | Path] = (),
    like: str | Path | None = None,
    field: str | None = None,
    music: str | Path | None = None,
    normalized: bool | None = None,
    scaler: str | Path | None = None,
    clamp: bool = False,
    wall: bool = False,
    at: float = 0.0,
) -> Page:
    """Return a page that plays dances: the last line of a notebook cell, ``.open()`` a browser, or ``.save(FILE)``.

    Parameters
    ----------
    what
        A dataset, samples or motion files; or a `Motion`, a `Clip`, or several by name or in a sequence.
    clip
        Where to begin: a clip, or a window ``CLIP@START+LENGTH``. Default: the first.
    compare
        Datasets, folders or files of motion that stand beside. Samples of `WindowDataset.save_samples` stand beside
        their truth without being named.
    like, field, normalized, scaler, clamp
        What the columns of files are, as in `dancedata.evaluate`.
    music
        A song, a folder of songs, or a list of them; of a dataset the folder that it was built from. A page has the
        music of motions in memory, and of a dataset only where its licence allows to pass it on.
    wall
        Whether all stand on one stage.
    at
        Seconds to begin at.

    Returns
    -------
    Page
        Its `page` is the HTML; complete in itself.

    Raises
    ------
    UsageError
        If there is nothing to show, or nothing states what it is.

    Examples
    --------
    >>> import dancedata
    >>> dancedata.view("data/aistpp", "gHO_sBM_cAll_d19_mHO3_ch03").title
    'gHO_sBM_cAll_d19_mHO3_ch03'
    """
    if isinstance(what, Motion | Clip | Mapping) or (isinstance(what, Sequence) and not isinstance(what, str)):
        return view_motions(what, music=music, wall=wall)
    path = what.path if isinstance(what, Store) else Path(what).expanduser()
    request = ViewRequest(
        path, str(clip), compare=tuple(map(Path, compare)), like=None if like is None else Path(like), field=field,
        music=None if music is None else Path(music), normalized=normalized,
        scaler=None if scaler is None else Path(scaler), clamp=clamp, wall=wall, at=at,
    )  # fmt: skip
    shown = ViewSelection.of(request)
    page = clip_page(shown.scenes, [shown.item], comparisons=shown.comparisons, address=shown.address)
    return Page(shown.item.name, page)


def report(
    what: str | Path,
    out: str | Path | None = None,
    *,
    like: str | Path | None = None,
    compare: str | Path | None = None,
    music: str | Path | None = None,
    rights: str | None = None,
    clips: Clips = 12,
    overwrite: bool = False,
    progress: bool = False,
    **as_evaluate: Any,
) -> Report | SamplesReport:
    """Describe a dataset, or a model's samples beside the dances of their dataset, and write it as a page.

    Parameters
    ----------
    what
        A dataset, or samples as `dancedata.evaluate` takes them.
    out
        HTML file to write. None: the numbers alone.
    like
        Of samples: the dataset that they are like. Default: what `WindowDataset.save_samples` states.
    compare
        Of a dataset: another one to compare with.
    music
        Of a dataset: the folder with its songs, which the page then plays. Of samples: as in `dancedata.evaluate`.
    rights
        Of a dataset: why you may pass the music on against its terms; it is published.
    clips
        Number of clips that the page plays; of a dataset also "all" or "none".
    overwrite, progress
        Replace the file; show progress.
    as_evaluate
        Of samples: further arguments of `dancedata.evaluate`.

    Returns
    -------
    Report, or SamplesReport
        With ``to_json()``.

    Raises
    ------
    UsageError
        If there is nothing to describe, or the file exists.

    Examples
    --------
    >>> import dancedata
    >>> len(dancedata.report("data/aistpp").numbers.clips)
    4
    """
    place = Path(what).expanduser()
    saved = saved_samples(place)
    if like is None and saved is not None:
        like = saved.dataset
    is_dataset = (place / DATASET_FILE).exists()
    if like is None and as_evaluate and not is_dataset:
        raise UsageError("nothing states of which dataset these are samples", where=place, reason="not_stated",
                         fix="name it: like=", options="name it: --like DATASET")  # fmt: skip
    if like is None or is_dataset:
        from dancedata.comparison import diff
        from dancedata.pages import write_report

        of_samples = [*as_evaluate, *(["like"] if like is not None else [])]
        if of_samples:
            raise UsageError("this is a dataset, and these options are only for samples of a model", where=place,
                             fix=f"leave out {', '.join(f'{name}=' for name in of_samples)}",
                             options=f"leave out {', '.join(f'--{name}' for name in of_samples)}")  # fmt: skip
        return write_report(
            place, out, against=compare, differences=diff, clips=clips, source=music,
            audio="none" if music is None else "embed", rights=rights, overwrite=overwrite, progress=progress,
        )  # fmt: skip
    from dancedata.evaluation.run import evaluate
    from dancedata.pages.samples import require_free_page, write_samples_report

    if compare is not None or rights is not None or not isinstance(clips, int):
        raise UsageError("compare and rights apply only to datasets, and for samples clips must be a number",
                         where=place, fix="leave them out")  # fmt: skip
    require_free_page(out, like, overwrite=overwrite)
    scores = evaluate(place, like=like, music=music, progress=progress, **as_evaluate)
    return write_samples_report(scores, like, out, clips=clips, overwrite=overwrite, progress=progress)
