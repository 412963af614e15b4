"""beats: speed, key motions and the beats that they hit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dancedata.core.errors import UsageError
from dancedata.core.text import shown
from dancedata.kernel import Store
from dancedata.plot.dancers import axes_or_new, bare, scene_of
from dancedata.scene.scene_list import HIT_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Colours of beats that are hit, of those whose key motion is early, and late.
_HIT, _EARLY, _LATE = "#00866a", "#2a8ccb", "#a04c00"


def beats(
    store: Store | str | Path,
    clip: str,
    *,
    field: str | None = None,
    member: int | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the speed of a dancer, the key motions, and the beats that they hit or miss.

    Parameters
    ----------
    store
        A built dataset, open or its folder.
    clip
        Id of a clip, or name of a group.
    field
        Motion field of the dataset; default: the best one to draw.
    member
        Of a group, the place of the dancer in it, from 0.
    ax
        matplotlib axes to draw on; default: those of a new figure.

    Returns
    -------
    matplotlib.axes.Axes
        Mean speed of the joints over time, metres per second, with a diamond at each key motion. Beats are vertical
        lines: solid where the nearest key motion is within 60 ms, as the viewer counts them, dashed where it is
        earlier, dotted where it is later.

    Raises
    ------
    UsageError
        For an unknown clip or field, a group without `member`, a clip without beats or joints, and where matplotlib
        is not installed.

    Examples
    --------
    >>> from dancedata import plot
    >>> plot.beats("data/demo", "gBR_sBM_cAll_d04_mBR4_ch03").figure.savefig("beats.pdf")
    """
    whole = scene_of(store, clip, field)
    if whole.members and (member is None or not 0 <= member < len(whole.members)):
        found = "no member" if member is None else f"member={member}"
        raise UsageError("key motions differ for each dancer of a group", where=shown(clip), found=found,
                         allowed=f"member from 0 to {len(whole.members) - 1}")  # fmt: skip
    scene = whole.members[member] if whole.members and member is not None else whole
    movement, offsets = scene.movement, scene.offsets
    if movement is None or not len(offsets):
        raise UsageError("there are no beats, or no key motions", where=f"clip {shown(clip)}")
    axes = axes_or_new(ax, 8.0, 2.6)
    rate = float(movement.grid.rate)
    times = (np.arange(len(movement.speed)) + 0.5) / rate
    hit, early = np.abs(offsets) <= HIT_S + 1e-9, offsets < 0
    groups = (("hit", hit, _HIT, "-"), ("early", ~hit & early, _EARLY, "--"), ("late", ~hit & ~early, _LATE, ":"))
    for name, chosen, colour, line in groups:
        places = scene.rhythm.beats[chosen]
        axes.vlines(
            places, 0, 1, transform=axes.get_xaxis_transform(), colors=colour, linestyle=line, linewidths=1.3,
            label=f"{name} {len(places)}", zorder=1,
        )  # fmt: skip
    axes.plot(times, movement.speed, color="#1c2126", linewidth=1.4, zorder=2)
    at_keys = np.interp(movement.key_times, times, movement.speed)
    keys = f"key motion {len(at_keys)}"
    axes.plot(movement.key_times, at_keys, "D", color="#1c2126", markersize=4.5, label=keys, zorder=3)
    axes.set_xlim(0, max(float(times[-1]), float(scene.rhythm.beats[-1])))
    axes.set_ylim(bottom=0)
    axes.set_xlabel("seconds")
    axes.set_ylabel("speed, m/s")
    mean = round(1000 * float(scene.hits.mean())) if len(scene.hits) else 0
    how = f", {abs(mean)} ms {'late' if mean > 0 else 'early'}" if mean else ""
    axes.set_title(f"{len(scene.hits)} of {len(offsets)} beats hit{how}", loc="right", fontsize="small")
    axes.set_title(shown(scene.item.name, 60), loc="left", fontsize="medium", parse_math=False)
    axes.legend(loc="upper left", bbox_to_anchor=(0, -0.3), ncols=4, fontsize="small", frameon=False)
    bare(axes, "top", "right")
    return axes
