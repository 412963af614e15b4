"""Colours of the dancers of a group, the same on pages and in videos."""

from typing import Literal

from dancedata.scene.scene_list import Item

Theme = Literal["dark", "light"]
#: By theme, for each dancer: trunk and head, left limbs, right limbs. One hue each in three tones of OKLCH, left
#: lighter than right; at least 3:1 against the background.
DANCERS: dict[Theme, tuple[tuple[str, str, str], ...]] = {
    "dark": (
        ("#63b9fe", "#b6ddfe", "#168dd9"), ("#f59740", "#ffcca4", "#c26e0d"), ("#61cb7c", "#a9f7b9", "#2e9e52"),
        ("#f786be", "#fec4de", "#c65b93"), ("#c0b529", "#ece888", "#928a07"), ("#1cc9ca", "#9bf4f4", "#169999"),
        ("#ff8a83", "#fec8c3", "#d15c56"), ("#bf9bfd", "#decefd", "#956ed2"),
    ),
    "light": (
        ("#0674b6", "#2193e0", "#054b78"), ("#a25a02", "#cc7200", "#6b3900"), ("#09853d", "#2c9a4e", "#005725"),
        ("#ab437b", "#cd6199", "#7d1453"), ("#797202", "#999008", "#4f4a05"), ("#0b7f7f", "#129c9c", "#075353"),
        ("#b64340", "#d8625c", "#861118"), ("#7d56b8", "#9b74d9", "#562c8b"),
    ),
}  # fmt: skip


def colours_of(item: Item, theme: Theme) -> tuple[str, str, str]:
    """Return the colours of a dancer: by the number in the source, which stays where others are left out."""
    palette = DANCERS[theme]
    return palette[max(0, item.clip.member) % len(palette)]
