"""The figures of a report on groups, drawn from its document and nothing else."""

from dancedata.pages.figures import FigureSpec, bar_figure, histogram_figure
from dancedata.pages.groups import FACING_DEG, GroupRow
from dancedata.pages.markup import Figure, Markup, number, percent, scrolled

#: Rows of the list of groups.
_ROWS = 60


def group_figures(d: FigureSpec) -> list[Figure]:
    """Return the figures of sizes, distances and facing, and the list of groups; nothing without groups."""
    groups = d.numbers.groups
    if not groups.groups:
        return []
    minutes = f"{60 * groups.dancer_hours:.1f} dancer minutes in {60 * groups.group_hours:.1f} minutes of groups"
    figures = [bar_figure(d, "groups_by_size", lambda n: n.groups.by_size, "Groups by size", minutes, "dancers")]
    if groups.distance_m.n:
        least = min(row.distance_min_m for row in groups.groups if row.distance_min_m is not None)
        median = number(groups.distance_m.p50)
        note = f"of the roots, over pairs and frames; median {median} m, least {number(least)} m"
        figures.append(
            histogram_figure(d, "distance_m", lambda n: n.groups.distance_m, "Distance between two dancers", note,
                             "metres", of="pairs and frames")
        )  # fmt: skip
    if groups.facing_deg.n:
        note = "angle between the direction that the hips face and the other dancer: 0 towards that dancer, 180 away"
        figures.append(
            histogram_figure(
                d, "facing_deg", lambda n: n.groups.facing_deg, "Facing", note, "degrees", of="pairs and frames"
            )
        )
    return [*figures, _list(d, groups.groups)]


def _list(d: FigureSpec, groups: tuple[GroupRow, ...]) -> Figure:
    """Return the list of groups, those with most collisions first, then the nearest dancers."""
    ordered = sorted(groups, key=lambda r: (-(r.collision_share or 0), r.distance_min_m or 0, r.group))
    rows = [
        (d.group_link(row.group), row.split, _dancers(d, row), row.frames, row.windows, row.distance_min_m,
         row.distance_p50_m, row.distance_max_m, percent(row.facing_share), row.contacts,
         percent(row.contact_share), percent(row.collision_share))
        for row in ordered[:_ROWS]
    ]  # fmt: skip
    head = ("group", "split", "dancers", "frames", "windows", "least m", "median m", "largest m", "facing",
            "contacts", "in contact", "colliding")  # fmt: skip
    left = len(ordered) - len(rows)
    more = f"; {left:,} more in the numbers (--json)" if left > 0 else ""
    note = (
        f"most collisions first; facing: two dancers look at each other within {FACING_DEG} degrees; contacts: a "
        f"wrist near another dancer; colliding: frames in which bodies, capsules round the bones, intersect{more}"
    )
    return Figure("groups_list", "Groups", note, scrolled(head, rows), kind="wide")


def _dancers(d: FigureSpec, row: GroupRow) -> Markup:
    parts = [f"{member} {role}".strip() for member, role in zip(row.members, row.roles, strict=True)]
    links = ", ".join(d.link(clip, part) for clip, part in zip(row.clips, parts, strict=True))
    missing = row.n_source - len(row.clips)
    return Markup(links + (f" and {missing} left out" if missing > 0 else ""))
