"""Exports of the archive against what others need for the same rows; ratios of one run.

Run ``python -m bench.bench_export``; ``--rows 3153600`` is a year of a row every ten seconds. Levels are rounded to
.01 dB, in 16 columns; days are sealed as the service seals them, and the archive is larger than what it keeps unpacked,
so that every day is read and unpacked each time. Measured: rows from the archive to a file, the same through a server
as a process over HTTP, and beside them the csv module and pyarrow on what lies in memory already. The csv module is
slow: it writes a part of the rows, and its time is scaled to all. pyarrow writes as the export does (zstd, bytes of
floats apart). Memory: all is exported once after one day was, so that what is loaded and compiled once does not count.
"""

import argparse
import csv
import secrets
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import httpx
import numpy as np
import pyarrow as pa
from pyarrow import parquet

from bench import plain_batch
from bench.load.server_process import running
from db.storage import SqlStorage
from service.api.export.export_files import FileOrder, archive_file
from service.records.calibration import Window
from service.records.catalogue import Carrier, Site, Spacecraft
from service.records.epoch import format_epoch
from service.records.storage import sqlite_url

CARRIERS = 16
STEP_US = 10_000_000
DAY_ROWS = 8640
#: 2025-01-01T00:00:00Z
START_US = 1_735_689_600_000_000
#: rows that the csv module writes
PART_ROWS = 40_000
FORMATS = ("csv", "ndjson", "parquet")
GOALS = {"csv": 4.0, "parquet": 1.6, "ndjson": 1e6, "memory": 64.0}


class Rows(NamedTuple):
    """The rows in memory."""

    epochs_us: np.ndarray
    levels: np.ndarray


def main() -> bool:
    """Print the figures and return whether the goals are met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=300_000)
    parser.add_argument("--repeats", type=int, default=5)
    options, _ = parser.parse_known_args()
    rng = np.random.default_rng(1)
    levels = rng.normal(-60.0, 5.0, (options.rows, CARRIERS)).round(2).astype(np.float32)
    rows = Rows(START_US + STEP_US * np.arange(options.rows), levels)
    with tempfile.TemporaryDirectory(dir=Path.cwd(), prefix="bench-") as name:
        path = Path(name) / "archive.db"
        began = time.perf_counter()
        fill(path, rows)
        print(f"{options.rows} rows x {CARRIERS} carriers stored and sealed in {time.perf_counter() - began:.1f} s")
        return report(rows, path, options.repeats)


def fill(path: Path, rows: Rows) -> None:
    """Store the rows and seal their days."""
    storage = SqlStorage(sqlite_url(str(path)))
    storage.prepare()
    inertia = ((2600.0, 0.0, 0.0), (0.0, 1400.0, 0.0), (0.0, 0.0, 2600.0))
    storage.catalogue.add_spacecraft(Spacecraft("bench", "Bench", 90.0, Site(55.0, 38.0), inertia, 0.05))
    carriers = [Carrier(f"c{k:02d}", "Ku", "Ku1", 11.2e9 + k * 2e6, 1e6) for k in range(CARRIERS)]
    plan_id = storage.catalogue.put_plan("bench", carriers, "bench").id
    for first in range(0, len(rows.levels), DAY_ROWS):
        part = rows.levels[first : first + DAY_ROWS]
        epochs_us = rows.epochs_us[first : first + DAY_ROWS]
        batch = plain_batch("bench", int(epochs_us[0]), epochs_us, part, plan_id)
        storage.archive.append_measurements(batch).result()
    last_us = int(rows.epochs_us[-1]) + 1
    for _ in storage.archive.seal("bench", last_us, last_us):
        pass
    storage.close()


class Taken(NamedTuple):
    """Times of the tasks, one value a repeat, and the growth of the server's memory."""

    #: s, by name
    wall_s: dict[str, list[float]]
    busy_s: dict[str, list[float]]
    grown_mb: float

    def ratio(self, one: str, other: str) -> float:
        """Return how many times as long one work takes, median over pairs."""
        return statistics.median(a / b for a, b in zip(self.wall_s[one], self.wall_s[other], strict=True))


def measure(rows: Rows, path: Path, repeats: int) -> Taken:
    """Do each work in turn, several times."""
    taken: dict[str, list[float]] = {}
    busy: dict[str, list[float]] = {}
    with served(path) as (client, process):
        prepared = Works(rows, path, client)
        for file_format in FORMATS:
            prepared.of_one_day(file_format)
        before = resident_mb(process)
        works = prepared.by_name()
        for work in works.values():  # compiled, read once
            work()
        for _ in range(repeats):
            for name, work in works.items():
                began, began_busy = time.perf_counter(), time.process_time()
                scale = work()
                taken.setdefault(name, []).append((time.perf_counter() - began) * scale)
                busy.setdefault(name, []).append((time.process_time() - began_busy) * scale)
        return Taken(taken, busy, resident_mb(process) - before)


def report(rows: Rows, path: Path, repeats: int) -> bool:
    """Measure, interleaved, and print."""
    taken = measure(rows, path, repeats)
    seconds = {name: statistics.median(each) for name, each in taken.wall_s.items()}
    for name, each in seconds.items():
        rate = rows.levels.size / each / 1e6
        print(
            f"  {name:20} {each:7.2f} s {statistics.median(taken.busy_s[name]):7.2f} s of a core {rate:7.2f} M values/s"
        )

    ratio = taken.ratio
    alike = GOALS["parquet"]
    figures = [
        ("G11 CSV: csv module / archive to CSV", ratio("csv module", "archive to csv"), GOALS["csv"], True),
        ("G12 Parquet: archive / pyarrow, written alike", ratio("archive to parquet", "pyarrow"), alike, False),
        ("NDJSON values/s", rows.levels.size / seconds["archive to ndjson"], GOALS["ndjson"], True),
        ("G13 resident memory of the server, +MB", taken.grown_mb, GOALS["memory"], False),
        ("CSV over HTTP: csv module / server", ratio("csv module", "http csv"), GOALS["csv"], True),
        ("Parquet over HTTP: server / pyarrow alike", ratio("http parquet", "pyarrow"), alike, False),
        ("NDJSON over HTTP, values/s", rows.levels.size / seconds["http ndjson"], GOALS["ndjson"], True),
    ]
    is_met = True
    for name, figure, goal, is_least in figures:
        is_good = figure >= goal if is_least else figure <= goal
        is_met = is_met and is_good
        word = "at least" if is_least else "at most"
        print(f"  {name:44} {figure:12.4g}, {word} {goal:g}: {'PASS' if is_good else 'MISS'}")
    return is_met


class Works:
    """Tasks to be timed, each a callable that returns the amount by which its time is scaled.

    Parameters
    ----------
    rows : Rows
        In memory.
    path : Path
        Archive with the same rows.
    client : httpx.Client
        To a server over it.
    """

    def __init__(self, rows: Rows, path: Path, client: httpx.Client) -> None:
        self._rows = rows
        self._client = client
        self._sink = path.with_name("out")
        self._names = [f"c{k:02d}" for k in range(CARRIERS)]
        # what a file of measurements asks of the service's context
        self._context: Any = SimpleNamespace(storage=SqlStorage(sqlite_url(str(path))))
        self._span = Window(START_US, int(rows.epochs_us[-1]) + 1)
        self._by_column = np.ascontiguousarray(rows.levels.T)

    def by_name(self) -> dict[str, Callable[[], float]]:
        """Return all of them."""
        works: dict[str, Callable[[], float]] = {"csv module": self.by_csv, "pyarrow": self.by_pyarrow}
        for file_format in FORMATS:
            works[f"archive to {file_format}"] = partial(self.from_archive, file_format)
            works[f"http {file_format}"] = partial(self.from_server, file_format)
        return works

    def from_archive(self, file_format: Any) -> float:
        """Write what the archive gives."""
        order = FileOrder("bench", "measurements", file_format, self._span)
        file = archive_file(self._context, lambda *_: self._names, order)
        return self._write(file.write(file.read(self._span), self._span))

    def from_server(self, file_format: str, **span: str) -> float:
        """Write what the server sends."""
        url = "/api/v1/spacecraft/bench/archive/measurements:export"
        headers, params = {"Accept-Encoding": "identity"}, {"format": file_format, **span}
        with self._client.stream("GET", url, params=params, headers=headers) as answer:
            answer.raise_for_status()
            return self._write(answer.iter_raw())

    def of_one_day(self, file_format: str) -> None:
        """Let the server write the first day, which loads whatever a format needs."""
        stop = format_epoch(START_US + DAY_ROWS * STEP_US)
        self.from_server(file_format, start=format_epoch(START_US), stop=stop)

    def by_csv(self) -> float:
        """Write a part of the rows with the standard library."""
        with self._sink.open("w", newline="") as file:
            writer = csv.writer(file)
            for epoch_us, levels in self._part():
                writer.writerow([format_epoch(epoch_us), "sa-1", *levels])
        return self._part_scale

    def by_pyarrow(self) -> float:
        """Write arrays in memory as one table."""
        epochs = pa.array(self._rows.epochs_us).cast(pa.timestamp("us", tz="UTC"))
        levels = {f"{name}_dbm": pa.array(self._by_column[k]) for k, name in enumerate(self._names)}
        source = pa.DictionaryArray.from_arrays(np.zeros(len(epochs), dtype=np.int32), ["sa-1"])
        table = pa.table({"epoch": epochs, "source": source, **levels})
        options = {"use_dictionary": ["source"], "use_byte_stream_split": list(levels)}
        parquet.write_table(table, self._sink, compression="zstd", **options)
        return 1.0

    @property
    def _part_scale(self) -> float:
        return max(1.0, len(self._rows.levels) / PART_ROWS)

    def _part(self) -> Iterator[tuple[int, list[float]]]:
        """Yield the first rows as Python has them."""
        # the shortest decimals: what a program that read .01 dB from somewhere holds
        levels = self._rows.levels[:PART_ROWS].astype(np.float64).round(2).tolist()
        return zip(self._rows.epochs_us[:PART_ROWS].tolist(), levels, strict=True)

    def _write(self, chunks: Iterable[bytes]) -> float:
        with self._sink.open("wb") as file:
            file.writelines(chunks)
        return 1.0


@contextmanager
def served(path: Path) -> Iterator[tuple[httpx.Client, int]]:
    """Run the service over the archive; give a client and its process."""
    key = secrets.token_urlsafe(16)
    command = [sys.executable, "-m", "service", "serve", "--port", "0", "--database", sqlite_url(str(path))]
    with running(command, key) as process:
        headers = {"Authorization": f"Bearer {key}"}
        with httpx.Client(base_url=process.url, headers=headers, timeout=300.0, trust_env=False) as client:
            yield client, process.pid


def resident_mb(process: int) -> float:
    """Return the greatest resident memory of a process so far, MB; 0 where nobody tells."""
    status = Path(f"/proc/{process}/status")
    if not status.exists():
        return 0.0
    return int(next(line.split()[1] for line in status.read_text().splitlines() if line.startswith("VmHWM"))) / 1024


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
