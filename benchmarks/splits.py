"""What the public lists of datasets' splits share, by names alone: python benchmarks/splits.py EDGE=DIR LDA=DIR ...

Each DIR is a checkout of the repository that publishes the lists. docs/datasets has the results.
"""

import argparse
import subprocess
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from dancedata.core.resources import manifest
from dancedata.datasets.aioz_gdance import AiozGdance, frames_of
from dancedata.datasets.finedance import IDS
from dancedata.datasets.motorica.reader import parse_name as motorica_name
from dancedata.datasets.popdanceset import PopDanceSet
from dancedata.formats.aist_names import parse_name as aist_name

Lists = dict[str, list[str]]
Keys = Mapping[str, Callable[[str], str]]


def _names(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8").split()


def _edge(folder: Path) -> tuple[str, Lists, Keys]:
    lists = {split: _names(folder / "data" / "splits" / f"crossmodal_{split}.txt") for split in ("train", "test")}
    ignored = {*_names(folder / "data" / "splits" / "ignore_list.txt")}
    lists = {split: [name for name in of_split if name not in ignored] for split, of_split in lists.items()}
    keys = {
        "recordings": str,
        "songs": lambda name: aist_name(name).music,
        "dancers": lambda name: aist_name(name).dancer,
        "choreographies": lambda name: "_".join(part for part in name.split("_") if part[0] in "gmc"),
    }
    return "AIST++ cross-modal, as EDGE has it, without its ignore list", lists, keys


def _lda(folder: Path) -> tuple[str, Lists, Keys]:
    def recording(name: str) -> str:
        return name.removesuffix("_mirrored").removesuffix("_00").removesuffix("_01")

    data = folder / "data" / "motorica_dance"
    lists = {
        split: sorted({*map(recording, _names(data / f"dance_{split}_files.txt"))}) for split in ("train", "test")
    }
    keys = {
        "recordings": str,
        "songs": lambda name: motorica_name(name).song,
        "dancers": lambda name: motorica_name(name).dancer,
    }
    return "Motorica, recordings behind LDA's lists of features", lists, keys


def _popdg(folder: Path) -> tuple[str, Lists, Keys]:
    lists = {split: _names(folder / "data" / "splits" / f"{split}.txt") for split in ("train", "test")}
    return "PopDanceSet, as POPDG has it", lists, {"clips": str, "videos": PopDanceSet().unit_of}


def _tcdiff(folder: Path) -> tuple[str, Lists, Keys]:
    data = folder / "data" / "dancernum_split" / "split_files"
    lists = {f"{n} dancers": _names(data / f"split_dancerNum_{n}.txt") for n in range(2, 8)}
    return (
        "AIOZ-GDANCE by number of dancers, as TCDiff has it",
        lists,
        {"sequences": str, "videos": AiozGdance().unit_of},
    )


def _fine() -> list[tuple[str, Lists, Keys]]:
    tables = []
    for protocol, of in manifest("finedance")["splits"].items():
        others = {split: sorted(of[split]) for split in ("val", "test")}
        lists = {"train": sorted({*IDS} - {*of["val"], *of["test"]}), **others}
        tables.append((f"FineDance, {protocol.replace('_', ' ')}", lists, {"recordings, each with its song": str}))
    return tables


def _table(title: str, lists: Lists, keys: Keys) -> Iterable[str]:
    """Yield a table: by key, how many each list has, and how many each two lists share."""
    splits = list(lists)
    pairs = [(a, b) for k, a in enumerate(splits) for b in splits[k + 1 :]]
    heads = ["", *splits, *(f"{a} and {b}" for a, b in pairs)] if len(pairs) < 4 else ["", *splits, "in several"]
    yield f"**{title}**\n"
    yield "| " + " | ".join(heads) + " |"
    yield "|---" * len(heads) + "|"
    for label, key in keys.items():
        of_split = {split: {key(name) for name in of_list} - {""} for split, of_list in lists.items()}
        counts = [str(len(values)) for values in of_split.values()]
        if len(pairs) < 4:
            shared = [_shared(of_split[a] & of_split[b]) for a, b in pairs]
        else:
            times: dict[str, int] = defaultdict(int)
            for value in (value for values in of_split.values() for value in values):
                times[value] += 1
            shared = [_shared({value for value, n in times.items() if n > 1})]
        yield "| " + " | ".join([label, *counts, *shared]) + " |"
    yield ""


def _shared(values: set[str]) -> str:
    return f"{len(values)}" if len(values) > 3 or not values else f"{len(values)}: {', '.join(sorted(values))}"


READERS = {"EDGE": _edge, "LDA": _lda, "POPDG": _popdg, "TCDiff": _tcdiff}


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkouts", nargs="+", metavar="NAME=DIR", help=", ".join(READERS))
    for checkout in parser.parse_args().checkouts:
        name, _, folder = checkout.partition("=")
        title, lists, keys = READERS[name](Path(folder))
        commit = subprocess.run(
            ["git", "-C", folder, "log", "-1", "--format=%h"], capture_output=True, text=True, check=True
        ).stdout.strip()
        print("\n".join(_table(f"{title} ({name} {commit})", lists, keys)))
        if name == "TCDiff":
            sequences = [sequence for of_list in lists.values() for sequence in of_list]
            hours = sum(map(frames_of, sequences)) / 30 / 3600
            videos = {*map(AiozGdance().unit_of, sequences)}
            print(f"{len(sequences):,} sequences of {len(videos)} videos, {hours:.2f} h.\n")
    for title, lists, keys in _fine():
        print("\n".join(_table(title, lists, keys)))


if __name__ == "__main__":
    main()
