"""From the start of ``soo serve`` to its first ``ready``, and the memory that it holds when nothing happens.

Run ``python -m bench.bench_start``. Starts: without a database, with an empty one, with one of 8 million values that
were consumed. Memory: as started, and with the compiled filter loaded. Each start is done several times and the best
counts, for a start is work of one core and whatever else runs only adds to it. ``python -m bench.bench_start serve
...`` is ``soo serve`` after some rows of the filter.
"""

import os
import secrets
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench import options_of, plain_batch
from bench.load.server_process import ServedProcess, running
from db.storage import SqlStorage
from service.__main__ import main as serve
from service.pipeline.first_rows import compile_rows
from service.ports.archive import LIVE
from service.records.storage import sqlite_url
from tests.fakes.worlds.synthetic_payload import SC, START_US, S, SyntheticPayload

CARRIERS = 16
GOAL_EMPTY_S, GOAL_FULL_S = 1.5, 3.0
GOAL_FILTER_MB, GOAL_STARTED_MB = 280, 150
_BATCH_ROWS = 10_000
_MB = 1 << 20


class Start(NamedTuple):
    """Time, processor time and memory of one start."""

    ready_s: float
    #: processor time until then, which other programs stretch far less than the time
    cpu_s: float
    rss_mb: float


def main() -> bool:
    """Print the figures and return whether the goals are met."""
    options = options_of(__doc__, rows=500_000, repeats=3)
    print(f"start and memory, load of the machine before {os.getloadavg()[0]:.1f} of {os.cpu_count()}")
    with tempfile.TemporaryDirectory(dir=Path.cwd(), prefix="bench-") as name:
        empty, full = Path(name) / "empty.db", Path(name) / "full.db"
        first = started(Path(name) / "new.db")
        started(empty)
        none = min(started(empty) for _ in range(options.repeats))
        fill(full, options.rows)
        filled = min(started(full) for _ in range(options.repeats))
        warm = started(full, module="bench.bench_start")
    is_met = [
        _show_start("first start, database made", first, GOAL_EMPTY_S),
        _show_start("start, empty database", none, GOAL_EMPTY_S),
        _show_start(f"start, {options.rows * CARRIERS / 1e6:g} M values", filled, GOAL_FULL_S),
        _show("memory, as started", filled.rss_mb, "MB", GOAL_STARTED_MB),
        _show("memory, filter loaded", warm.rss_mb, "MB", GOAL_FILTER_MB),
    ]
    return all(is_met)


def _show_start(what: str, start: Start, goal_s: float) -> bool:
    """Print one start and return whether its goal is met."""
    return _show(f"{what} ({start.cpu_s:.2f} s of processor time)", start.ready_s, "s", goal_s)


def _show(what: str, value: float, unit: str, goal: float) -> bool:
    """Print one figure and return whether its goal is met."""
    print(f"  {what}: {value:.2f} {unit}, goal {goal:g}: {'PASS' if value <= goal else 'MISS'}")
    return value <= goal


def started(database: Path, *, module: str = "service") -> Start:
    """Start a service over a database, wait until it is ready and idle, and end it."""
    command = [sys.executable, "-m", module, "serve", "--database", sqlite_url(str(database)), "--port", "0"]
    began_s = time.perf_counter()
    with running([*command, "--clock", "data"], secrets.token_urlsafe(16)) as process:
        _await_ready(process)
        ready_s, cpu_s = time.perf_counter() - began_s, process.cpu_s()
        # what a start leaves behind in other threads has come to rest
        time.sleep(0.5)
        return Start(ready_s, cpu_s, process.rss_bytes() / _MB)


def _await_ready(process: ServedProcess) -> None:
    """Ask until the service says that it is ready."""
    while True:
        try:
            with urllib.request.urlopen(process.url + "/readyz", timeout=10) as answer:  # noqa: S310 - our own address
                if answer.status == 200:
                    return
        except urllib.error.URLError:
            time.sleep(0.005)


def fill(database: Path, rows: int) -> None:
    """Make an archive of consumed rows."""
    payload = SyntheticPayload.make(CARRIERS, 5)
    with _storage(database) as storage:
        storage.catalogue.add_spacecraft(payload.spacecraft())
        storage.catalogue.put_plan(SC, payload.carriers(), "bench")
        rng = np.random.default_rng(1)
        for first in range(0, rows, _BATCH_ROWS):
            count = min(_BATCH_ROWS, rows - first)
            epochs_us = START_US + S * np.arange(first, first + count)
            batch = plain_batch(SC, START_US, epochs_us, rng.normal(-45.0, 1.0, (count, CARRIERS)))
            assert storage.archive.append_measurements(batch).result(timeout=60).accepted == count
        head = storage.archive.head(SC)
        storage.results.save_outcomes(SC, LIVE, [], head.newest_number, head.newest_epoch_us)


@contextmanager
def _storage(database: Path) -> Iterator[SqlStorage]:
    """Give a migrated archive and close it."""
    storage = SqlStorage(sqlite_url(str(database)))
    storage.prepare()
    yield storage
    storage.close()


def serve_warm() -> None:
    """Serve as ``soo serve``, its filter loaded as in a service that has been up for a while."""
    compile_rows()
    serve()


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        serve_warm()
    else:
        sys.exit(0 if main() else 1)
