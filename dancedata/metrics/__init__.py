"""Measures of a dance, and scores of a set of dances.

Pure functions of joint positions, and the plug-ins that name their variants. The names in `__all__` are the public
functions. The right definition is the default; a published program's slip is chosen by name.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from dancedata.core.lazy import lazy_names

__all__ = [
    "Dance",
    "Interval",
    "MusicBeats",
    "Undefined",
    "beat_alignment",
    "beat_echo",
    "chance_level",
    "collisions",
    "constant_columns",
    "contact_spans",
    "diversity",
    "duet_distances",
    "facing_angles",
    "frechet",
    "geometric",
    "group_correlation",
    "group_kinetic",
    "intersection_frequency",
    "jackknife",
    "kinetic",
    "motion_beat_times",
    "motion_beats",
    "pbc",
    "pfc",
    "physics",
    "root_distances",
    "rooted",
    "skating",
]

if TYPE_CHECKING:
    from dancedata.core.dance import Dance, MusicBeats, Undefined
    from dancedata.metrics.beats import beat_alignment, chance_level, motion_beat_times, motion_beats
    from dancedata.metrics.foot_skating import skating
    from dancedata.metrics.geometric_features import geometric
    from dancedata.metrics.groups import (
        beat_echo,
        collisions,
        contact_spans,
        duet_distances,
        facing_angles,
        group_correlation,
        group_kinetic,
        intersection_frequency,
        root_distances,
    )
    from dancedata.metrics.intervals import Interval, jackknife
    from dancedata.metrics.kinetic_features import kinetic
    from dancedata.metrics.motius_physics import physics
    from dancedata.metrics.physical_contact import pbc, pfc
    from dancedata.metrics.root import rooted
    from dancedata.metrics.set_statistics import constant_columns, diversity, frechet
else:  # type checkers take the imports above, and so find misspelt names
    __getattr__, __dir__ = lazy_names(
        __name__,
        {
            "core.dance": "Dance MusicBeats Undefined",
            "metrics.beats": "beat_alignment chance_level motion_beat_times motion_beats",
            "metrics.foot_skating": "skating",
            "metrics.geometric_features": "geometric",
            "metrics.groups": "beat_echo collisions contact_spans duet_distances facing_angles group_correlation "
            "group_kinetic intersection_frequency root_distances",
            "metrics.intervals": "Interval jackknife",
            "metrics.kinetic_features": "kinetic",
            "metrics.motius_physics": "physics",
            "metrics.physical_contact": "pbc pfc",
            "metrics.root": "rooted",
            "metrics.set_statistics": "constant_columns diversity frechet",
        },
    )
