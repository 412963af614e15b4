"""Reading datasets over a network: this package, `datasets` streaming, WebDataset, s3fs + h5py, in one run.

    python benchmarks/remote.py                     1,340 windows in 4 shards of 37 MB, 5 rounds
    python benchmarks/remote.py --shards 8          2,680 windows
    python benchmarks/remote.py --quick             335 windows, 2 rounds
    python benchmarks/remote.py --json FILE         write all measurements, too

A window is (150, 151) and (150, 35) float32, 112 kB; windows do not overlap, so that formats that store each window
by itself have no more bytes: with overlapping windows they have as many times more. All clients ask one server on
this machine, a process of its own, which gives files, parts of files and what S3 clients ask for, without a delay; it
counts requests and bytes.

A measurement is a process of its own, from the call that opens the dataset to the last batch of 64; packages are
imported before. "First batch" is the time to the first of them. "Cold": an empty cache. "Warm" and "local": the mean
of ten further epochs of a loader, whose files are in the cache and in memory. "1 Gbit/s": the server sends 125 MB/s,
on all connections together; without that, the cores that compute hashes limit what is compared. One number of each
array of a batch is read. Rounds are interleaved, each in a new order; medians over rounds, and quartiles of ratios
within rounds.

- local: `BatchLoader` on the folder itself, in blocks of 256 windows, as all of this package's.
- bare download: the bytes of the train split's files to a disk by six threads of urllib; nothing is compared.
- whole shards: the address opened, shards fetched whole, compared and kept.
- `datasets`: parquet files, a window a row, streaming=True. WebDataset: tar files of .npy, by curl, its default. Both
  in the order of the files. s3fs + h5py: the shards by file objects of s3fs (its default cache), h5py on them, the
  windows of the same order as this package's.

Peers that are not installed (datasets, webdataset, s3fs) are named and skipped. s3fs pins an older botocore than moto
asks for: use an environment of its own.
"""

from __future__ import annotations

import argparse
import importlib.util
import io
import json
import multiprocessing
import os
import platform
import random
import statistics
import sys
import tempfile
import threading
import time
import urllib.request
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.metadata import version
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from dancedata.remote.pull import pull
from dancedata.testing.stores import random_fields, write_random_store
from dancedata.torch import BatchLoader, EpochSampler, WindowDataset

BATCH, LENGTH, FRAMES, BLOCK = 64, 150, 150 * 67, 256
FIELDS = {"edge151": 151, "librosa35": 35}
#: Measured over the slow line, too.
SLOW = ("bare download", "whole shards, cold", "datasets, streaming", "WebDataset", "s3fs + h5py")
GOALS = {
    "warm / local": 1.02,
    "cold / bare download, 1 Gbit/s": 1.2,
}
Batches = Iterable[Any]


class Files(BaseHTTPRequestHandler):
    """Files and parts of them, with the headers that S3 clients need; /_stats gives and resets the counts."""

    protocol_version = "HTTP/1.1"
    root: Path
    counts: ClassVar[Counter[str]] = Counter()
    #: Bytes per second of all connections together, and the time at which the line is free again. None: unlimited.
    limit: float | None = None
    line, free_at = threading.Lock(), 0.0

    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing."""

    def do_HEAD(self) -> None:
        """Answer for an object."""
        self.do_GET()

    def do_GET(self) -> None:
        """Answer with a file, or a part of one."""
        path = self.root / self.path.split("?")[0].lstrip("/")
        if self.path == "/_stats":
            data = json.dumps(self.counts).encode()
            self.counts.clear()
            self._head(200, len(data))
            self.wfile.write(data)
            return
        self.counts["requests"] += 1
        if not path.is_file():
            self._head(404, 0)
            return
        size = path.stat().st_size
        first, _, last = self.headers.get("Range", "bytes=0-").removeprefix("bytes=").partition("-")
        begin, end = int(first), min(int(last) + 1 if last else size, size)
        ranged = {"Content-Range": f"bytes {begin}-{end - 1}/{size}"} if "Range" in self.headers else {}
        self._head(206 if ranged else 200, end - begin, ranged)
        if self.command == "GET":
            self.counts["bytes"] += end - begin
            with open(path, "rb") as file:
                step = 1 << 16 if self.limit else end - begin
                for first_byte in range(begin, end, step or 1):
                    self._wait(min(step, end - first_byte))
                    self.connection.sendfile(file, first_byte, min(step, end - first_byte))

    def _wait(self, n: int) -> None:
        """Wait until a line of `limit` bytes per second has sent n more."""
        if self.limit:
            with self.line:
                cls = type(self)
                cls.free_at = max(cls.free_at, time.perf_counter()) + n / self.limit
                wait = cls.free_at - time.perf_counter()
            time.sleep(max(0.0, wait))

    def _head(self, status: int, size: int, more: dict[str, str] | None = None) -> None:
        self.send_response(status)
        fixed = {"ETag": '"1"', "Last-Modified": "Wed, 21 Oct 2015 07:28:00 GMT", "Accept-Ranges": "bytes"}
        for name, value in {**fixed, **(more or {}), "Content-Length": str(size)}.items():
            self.send_header(name, value)
        self.end_headers()


class SlowFiles(Files):
    """The same, as over a line of 1 Gbit/s."""

    limit = 125e6


class Server(ThreadingHTTPServer):
    """Takes the connections of many threads at once."""

    request_queue_size = 128
    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore clients that leave early."""


def serve(root: Path, ports: Any) -> None:
    """Serve files, and moto with the first shard; in a process of its own."""
    import logging

    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    Files.root = root
    server, slow = Server(("127.0.0.1", 0), Files), Server(("127.0.0.1", 0), SlowFiles)
    threading.Thread(target=slow.serve_forever, daemon=True).start()
    bucket = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    bucket.start()
    ports.put((server.server_address[1], slow.server_address[1], bucket.get_host_and_port()[1]))
    server.serve_forever()


def stats(port: int) -> Counter[str]:
    """Return the server's requests and bytes since the last call."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/_stats") as answer:
        return Counter(json.load(answer))


def main() -> int:
    """Write the data, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="338 windows, 2 rounds")
    parser.add_argument("--rounds", type=int)
    parser.add_argument("--shards", type=int, default=4)
    parser.add_argument("--json", type=Path, help="file to write all measurements to, too")
    arguments = parser.parse_args()
    rounds = arguments.rounds or (2 if arguments.quick else 5)
    spawn = multiprocessing.get_context("spawn")
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary) / "site"
        clips = 5 * (1 if arguments.quick else arguments.shards)
        write_random_store(
            root / "dances/store", clips={"train": clips}, fields=random_fields({"edge151": 151}, {"librosa35": 35}),
            length=LENGTH, stride=LENGTH, n_frames=(FRAMES, FRAMES), clips_per_song=1, shard_bytes=37_500_000,
        )  # fmt: skip
        write_peers(root / "dances")
        ports = spawn.Queue()
        server = spawn.Process(target=serve, args=(root, ports), daemon=True)
        server.start()
        plain, slow, moto = ports.get()
        upload(root / "dances/store", moto)
        os.environ.update(environment(plain))
        print(machine(root, rounds), flush=True)
        found = measure(root, {"": plain, ", 1 Gbit/s": slow, ", moto": moto}, rounds, arguments.json)
        server.kill()
    return 0 if print_all(found) or arguments.quick else 1


def environment(port: int) -> dict[str, str]:
    """Return the credentials of a bucket on this machine."""
    return {
        "AWS_ENDPOINT": f"http://127.0.0.1:{port}", "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
        "AWS_ALLOW_HTTP": "true", "AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "secret",
        "AWS_REGION": "us-east-1", "AWS_DEFAULT_REGION": "us-east-1", "NO_PROXY": "127.0.0.1",
    }  # fmt: skip


def write_peers(folder: Path) -> None:
    """Write the windows as parquet and tar files, as many as the store has shards."""
    ds = WindowDataset(folder / "store", fields=list(FIELDS), scale=None)
    parts = np.array_split(np.arange(len(ds)), len(ds.store._shards("train")))
    for number, part in enumerate(parts):
        rows = [[ds.store.read(ds.windows[int(k)], name) for name in FIELDS] for k in part]
        if importlib.util.find_spec("datasets"):
            import datasets

            shapes = {name: datasets.Array2D((LENGTH, width), "float32") for name, width in FIELDS.items()}
            columns = {name: [row[k] for row in rows] for k, name in enumerate(FIELDS)}
            of_part = datasets.Dataset.from_dict(columns, datasets.Features(shapes))
            of_part.to_parquet(folder / f"parquet/{number}.parquet")
        if importlib.util.find_spec("webdataset"):
            import webdataset

            (folder / "tar").mkdir(exist_ok=True)
            with webdataset.TarWriter(str(folder / f"tar/{number}.tar")) as out:
                for key, row in zip(part, rows, strict=True):
                    members: dict[str, Any] = {"__key__": f"{key:06d}"}
                    for name, values in zip(FIELDS, row, strict=True):
                        buffer = io.BytesIO()
                        np.save(buffer, values)
                        members[f"{name}.npy"] = buffer.getvalue()
                    out.write(members)


def upload(store: Path, port: int) -> None:
    """Put the dataset into moto."""
    for path in (None, *store.iterdir()):
        url = f"http://127.0.0.1:{port}/dances" + ("" if path is None else f"/store/{path.name}")
        data = b"" if path is None else path.read_bytes()
        request = urllib.request.Request(url, data, {"Content-Type": "binary/octet-stream"}, method="PUT")
        urllib.request.urlopen(request).close()


# What is measured. Each function returns an iterable of batches, or does its work when it is called.


def blocks(where: str | Path) -> Batches:
    """Return this package's batches, in blocks."""
    ds = WindowDataset(where, fields=list(FIELDS), scale=None)
    return BatchLoader(ds, BATCH, sampler=EpochSampler(ds, seed=0, block=BLOCK))


def bare_download(base: str, root: Path) -> Batches:
    """Download the files of the train split."""
    names = [p.name for p in (root / "dances/store").iterdir() if "train" in p.name or p.name == "dataset.json"]
    with tempfile.TemporaryDirectory() as folder:

        def get(name: str) -> None:
            with urllib.request.urlopen(f"{base}/store/{name}") as answer, open(f"{folder}/{name}", "wb") as out:
                while chunk := answer.read(1 << 20):
                    out.write(chunk)
                os.fsync(out.fileno())

        with ThreadPoolExecutor(6) as threads:
            list(threads.map(get, names))
    return [{}]


def hf_datasets(base: str, root: Path) -> Batches:
    """Stream parquet files."""
    import datasets

    files = [f"{base}/parquet/{p.name}" for p in sorted((root / "dances/parquet").iterdir())]
    streamed = datasets.load_dataset("parquet", data_files=files, streaming=True, split="train")
    return streamed.with_format("numpy").iter(BATCH)


def web_dataset(base: str, root: Path) -> Batches:
    """Stream tar files."""
    import webdataset

    files = [f"{base}/tar/{p.name}" for p in sorted((root / "dances/tar").iterdir())]
    return webdataset.WebDataset(files, shardshuffle=False).decode().batched(BATCH)


def s3fs_h5py(base: str, root: Path, port: int | None = None) -> Batches:
    """Read the shards through file objects of s3fs."""
    import h5py
    import s3fs

    ds = WindowDataset(root / "dances/store", fields=list(FIELDS), scale=None)
    system = s3fs.S3FileSystem(endpoint_url=base.removesuffix("/dances"), skip_instance_cache=True)
    shards, numbers = ds.store._shards_of(ds.windows)
    order = list(EpochSampler(ds, seed=0, block=BLOCK))
    opened: dict[int, Any] = {}

    def batch(indices: list[int]) -> dict[str, Any]:
        rows: dict[str, list[Any]] = {name: [] for name in FIELDS}
        for index in indices:
            number = int(numbers[index])
            if number not in opened:
                opened[number] = h5py.File(system.open(f"dances/store/{shards[number].path.name}", "rb"), "r")
            for name in FIELDS:
                span = ds.store._locate(ds.windows[index], name)
                dataset = opened[number][ds.store.field(name).path]
                rows[name].append(dataset[span.first : span.first + span.length])
        return {name: np.stack(values) for name, values in rows.items()}

    return (batch(order[k : k + BATCH]) for k in range(0, len(order), BATCH))


MEASURES: dict[str, tuple[Callable[[str, Path], Batches], tuple[str, ...]]] = {
    "local": (lambda base, root: blocks(root / "dances/store"), ()),
    "bare download": (bare_download, ()),
    "whole shards, cold": (lambda base, root: blocks(f"{base}/store"), ()),
    "whole shards, warm": (lambda base, root: blocks(f"{base}/store"), ()),
    "whole shards of a bucket, cold": (lambda base, root: blocks("s3://dances/store"), ("obstore",)),
    "datasets, streaming": (hf_datasets, ("datasets",)),
    "WebDataset": (web_dataset, ("webdataset",)),
    "s3fs + h5py": (s3fs_h5py, ("s3fs", "h5py")),
}


def one(name: str, base: str, root: Path, cache: Path, results: Any) -> None:
    """Measure once, in a process of its own."""
    os.environ["DANCEDATA_CACHE"] = str(cache)
    make, packages = MEASURES[name]
    for package in (*packages, "torch"):
        __import__(package)
    begin = time.perf_counter()
    first, total, n = 0.0, 0.0, 0
    batches = make(base, root)
    epochs = 1
    if name in ("local", "whole shards, warm"):
        total = sum(summed(batch) for batch in batches)  # the page cache
        batches, epochs = chain.from_iterable([batches] * 10), 10
        begin = time.perf_counter()
    for batch in batches:
        first = first or time.perf_counter() - begin
        total += summed(batch)
        n += len(batch["edge151"]) if "edge151" in batch else len(batch.get("edge151.npy", ()))
    results.put({"first": first, "all": (time.perf_counter() - begin) / epochs, "total": total, "windows": n})


def summed(batch: Any) -> float:
    """Return a number of each array of a batch, added up."""
    names = [name for name in (*FIELDS, *(f"{n}.npy" for n in FIELDS)) if name in batch]
    return float(sum(float(np.asarray(rows)[0, 0]) for name in names for rows in batch[name]))


def measure(
    root: Path, servers: dict[str, int], rounds: int, json_file: Path | None
) -> dict[str, list[dict[str, float]]]:
    """Measure everything, round by round; write what was found after each."""
    spawn = multiprocessing.get_context("spawn")
    found: dict[str, list[dict[str, float]]] = {}
    names = [n for n, (_, packages) in MEASURES.items() if all(map(importlib.util.find_spec, packages))]
    print("skipped: " + (", ".join(sorted(MEASURES.keys() - set(names))) or "nothing"), flush=True)
    runs = [(name, "") for name in names] + [(name, ", 1 Gbit/s") for name in SLOW if name in names]
    plain = servers[""]
    for _ in range(rounds):
        random.shuffle(runs)
        for name, server in runs:
            port = servers[server]
            with tempfile.TemporaryDirectory(dir=root.parent) as cache:
                base, results = f"http://127.0.0.1:{port}/dances", spawn.SimpleQueue()
                os.environ.update(environment(port))
                if name == "whole shards, warm":
                    pull(f"{base}/store", cache=cache, progress=False)
                stats(plain)
                process = spawn.Process(target=one, args=(name, base, root, Path(cache), results))
                process.start()
                result = results.get() if alive(process, results) else {}
                process.join()
                if not result:
                    raise SystemExit(f"{name} failed")
                counts = stats(plain)
                result |= {"requests": counts["requests"], "MB": counts["bytes"] / 1e6}
                found.setdefault(name + server, []).append(result)
        if json_file:
            json_file.write_text(json.dumps(found, indent=1))
    return found


def alive(process: Any, results: Any) -> bool:
    """Wait for a result, or the end of the process."""
    while results.empty() and process.is_alive():
        time.sleep(0.02)
    return not results.empty()


def machine(root: Path, rounds: int) -> str:
    """Return what was measured, on what."""
    packages = ("h5py", "numpy", "torch", "obstore", "moto", "datasets", "webdataset", "s3fs")
    versions = ", ".join(f"{p} {version(p)}" for p in packages if importlib.util.find_spec(p))
    sizes = sorted(p.stat().st_size for p in (root / "dances/store").glob("train-0*"))
    return (
        f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, "
        f"{versions}\n{len(sizes)} shards of {sizes[0] / 1e6:.0f} to {sizes[-1] / 1e6:.0f} MB, {rounds} rounds"
    )


def print_all(found: dict[str, list[dict[str, float]]]) -> bool:
    """Print the table and the ratios; return whether the goals are met."""
    print(f"\n{'':45}first batch s   all s   requests      MB")
    for name in sorted(found, key=list(found).index):
        values = {key: statistics.median(r[key] for r in found[name]) for key in found[name][0]}
        print(f"{name:45}{values['first']:12.3f}{values['all']:8.3f}{values['requests']:10.0f}{values['MB']:9.1f}")
    print(f"\n{'ratio within a round':60} median   quartiles")
    good = True
    for name, over, under, key in ratios(found):
        values = sorted(a[key] / b[key] for a, b in zip(found[over], found[under], strict=True))
        low, middle, high = np.quantile(values, [0.25, 0.5, 0.75])
        goal = GOALS.get(name)
        good &= goal is None or middle <= goal
        print(f"{name:60}{middle:7.2f}   {low:.2f} .. {high:.2f}" + ("" if goal is None else f"   goal {goal}"))
    return good


def ratios(found: dict[str, Any]) -> Iterator[tuple[str, str, str, str]]:
    """Yield the name of a ratio, two measurements, and what is compared."""
    where = ("", ", 1 Gbit/s")
    rows = [
        ("warm / local", "whole shards, warm", "local", "all"),
        *((f"cold / bare download{w}", f"whole shards, cold{w}", f"bare download{w}", "all") for w in where),
        *(
            (f"first batch, cold / bare download{w}", f"whole shards, cold{w}", f"bare download{w}", "first")
            for w in where
        ),
        *(
            (f"whole shards, cold / {peer}, {text}{w}", f"whole shards, cold{w}", f"{peer}{w}", key)
            for w in where
            for peer in ("datasets, streaming", "WebDataset", "s3fs + h5py")
            for key, text in (("first", "first batch"), ("all", "epoch"))
        ),
    ]
    yield from (row for row in rows if row[1] in found and row[2] in found)


if __name__ == "__main__":
    sys.exit(main())
