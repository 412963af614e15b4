"""The head of a card: what hubs read from the YAML at the top of a README.md."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from dancedata.core.hashing import dataset_hashes
from dancedata.core.licence import Licence
from dancedata.core.terms import clips_by_terms
from dancedata.core.text import shown

#: Licences of hubs by what they are written as, the strictest last; unknown ones are stricter than all of them.
_LICENCES = (
    ("cc0-1.0", r"cc[ -]?0|creative commons zero|public domain"),
    ("mit", r"mit\b"),
    ("apache-2.0", r"apache"),
    ("cc-by-4.0", r"(?:cc[ -]by|creative commons attribution)[ -]4\.0"),
    ("cc-by-sa-4.0", r"(?:cc[ -]by[ -]sa|creative commons attribution[ -]sharealike)[ -]4\.0"),
    ("cc-by-nc-4.0", r"(?:cc[ -]by[ -]nc|creative commons attribution[ -]noncommercial)[ -]4\.0"),
    (
        "cc-by-nc-sa-4.0",
        r"(?:cc[ -]by[ -]nc[ -]sa|creative commons attribution[ -]noncommercial[ -]sharealike)[ -]4\.0",
    ),
    ("cc-by-nd-4.0", r"(?:cc[ -]by[ -]nd|creative commons attribution[ -]noderivatives)[ -]4\.0"),
    ("cc-by-nc-nd-4.0", r"cc[ -]by[ -]nc[ -]nd[ -]4\.0"),
)
OTHER = "other"
_SPLIT = re.compile(r"\w+(\.\w+)*\Z")
#: Upper ends of the sizes of hubs, in thousands.
_SIZES = ((1, "n<1K"), (10, "1K<n<10K"), (100, "10K<n<100K"), (1000, "100K<n<1M"), (10_000, "1M<n<10M"))


def hub_licence(text: str) -> str:
    """Return the name that hubs have for a licence; "other" for those that they do not know."""
    named = text.strip().lower()
    ids = [name for name, pattern in _LICENCES if re.match(rf"(?:{pattern})(?![\w-]*[ -](?:sa|nc|nd)\b)", named)]
    # Several terms in one text are as strict as those that are not known.
    parts = re.split(r"[;,]\s|\band\b", named)
    known = [part for part in parts if any(re.match(rf"\s*(?:{pattern})", part) for _, pattern in _LICENCES)]
    return ids[-1] if ids and len(known) <= 1 else OTHER


def strictest(store: Any) -> tuple[str, Licence]:
    """Return the strictest licence of the clips of a dataset, as hubs name it and as it is written."""
    of_dataset = Licence(str(store.info.get("licence") or "unknown"), str(store.info.get("citation") or ""))
    terms = clips_by_terms(store) or {None: 1}
    used = [of_dataset if k is None or not k.text else k for k in terms]
    order = [name for name, _ in _LICENCES]
    ranked = [(hub_licence(licence.text), licence) for licence in used]
    return max(ranked, key=lambda entry: (order.index(entry[0]) if entry[0] in order else len(order), entry[1]))


def size_category(n: int) -> str:
    """Return the range that hubs have for a number of samples."""
    return next((name for end, name in _SIZES if n < 1000 * end), "n>10M")


@dataclass(frozen=True)
class HubPlace:
    """Additional content of the card of a published dataset.

    `address`: Where it is read, with tag or commit.
    `rights`: Statement by which the publisher may pass the data on although a licence does not allow it; "" without.
    `overridden`: What these licences say.
    `gated`: Whether users accept the terms first.
    `recipe_only`: Whether only what rebuilds the data is published.
    """

    address: str
    rights: str = ""
    overridden: tuple[str, ...] = ()
    gated: bool = False
    recipe_only: bool = False


def unnamed_splits(splits: Sequence[str]) -> list[str]:
    """Return the splits whose name hubs do not take (``datasets.NamedSplit``): one with a hyphen or a plus."""
    return [split for split in splits if not _SPLIT.match(split)]


def head(
    store: Any,
    splits: Sequence[str],
    files: Mapping[str, str],
    *,
    place: HubPlace | None = None,
    viewer: bool = False,
) -> str:
    """Return the YAML between the lines of dashes; texts are quoted, so that none of them is markup."""
    name, licence = strictest(store)
    required = tuple(name for name in store.fields if not store.field(name).optional)
    n = sum(len(store.windows(split, fields=required)) for split in splits) or len(store)
    kinds = {store.field(field).kind for field in store.fields}
    tags = ["dance", "human-motion", "motion-capture", "dancedata"]
    tags += ["music", "music-to-dance"] if "audio" in kinds else []
    lines = [
        f"pretty_name: {_quoted(str(store.info.get('name', 'dataset')))}",
        f"license: {name}",
        *([f"license_name: {_quoted(licence.text[:120])}"] if name == OTHER else []),
        "size_categories:", f"- {size_category(n)}",
        "task_categories:", "- other",
        "tags:", *(f"- {tag}" for tag in tags),
        *(() if viewer else ("viewer: false",)),
    ]  # fmt: skip
    if files:
        lines += ["configs:", *(line for config, path in files.items() for line in _config(config, splits, path))]
    if place is not None and place.gated:
        lines.append(f"extra_gated_prompt: {_quoted(_terms(licence))}")
    lines.append(yaml.safe_dump({"dancedata": _about(store, place)}, sort_keys=False, width=10_000).rstrip())
    return "\n".join(["---", *lines, "---", ""])


def citations(store: Any) -> tuple[str, ...]:
    """Return the works to cite: that of the dataset, then those of clips."""
    texts = (str(store.info.get("citation") or ""), *(licence.citation for licence in store.licences))
    return tuple(dict.fromkeys(text for text in texts if text))


def _terms(licence: Licence) -> str:
    cite = f" Cite: {licence.citation}" if licence.citation else ""
    return f"By asking for access you accept the terms of the source. {shown(licence.text, 2000)}{shown(cite, 2000)}"


def _about(store: Any, place: HubPlace | None) -> dict[str, object]:
    """Return machine-readable facts of a dataset: sizes, columns, citations, and the hashes of recipe and dataset."""
    meta = store.info
    counts = meta["splits"]
    about: dict[str, object] = {
        **({"address": place.address, "data": not place.recipe_only} if place is not None else {}),
        "format": meta["format"],
        "bytes": sum(shard["size"] for shard in meta["shards"]),
        "splits": {split: {key: n[key] for key in ("clips", "windows") if key in n} for split, n in counts.items()},
        "columns": {name: store.field(name).columns.width for name in store.fields},
        "recipe": shown(meta.get("name", "")),
        **dataset_hashes(meta),
        "citation": [shown(text, 2000) for text in citations(store)],
    }
    return about | ({"rights": shown(place.rights, 2000)} if place is not None and place.rights else {})


def _config(name: str, splits: Sequence[str], path: str) -> list[str]:
    entries = [f"  - split: {_quoted(split)}\n    path: {_quoted(path.format(split))}" for split in splits]
    return [f"- config_name: {name}", "  data_files:", *entries]


def _quoted(text: str) -> str:
    """Return a text as YAML has it between double quotes."""
    return json.dumps("".join(c for c in text if c.isprintable()))
