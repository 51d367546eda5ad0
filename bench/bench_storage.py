"""Rate of durable ingest: batches of 100 rows of 32 carriers a second into a SQLite file, from a few threads.

Run ``python -m bench.bench_storage``; ``--help`` tells the options. Every batch counted is committed with
``synchronous=FULL``. The rate depends on the disk: compare only figures of one run.
"""

import argparse
import tempfile
import time
from concurrent.futures import Future, ThreadPoolExecutor, wait
from itertools import count
from pathlib import Path

import numpy as np

from db.storage import SqlStorage
from service.records.catalogue import Carrier, Site, Spacecraft
from service.records.measurement import BatchReceipt, MeasurementBatch

START_US = 1_795_000_000_000_000
STEP_US = 100_000
#: batches a thread keeps under way, as a server with several connections does
DEPTH = 4


def main() -> None:
    """Print batches a second, rows a second and bytes a row."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--rows", type=int, default=100)
    parser.add_argument("--carriers", type=int, default=32)
    parser.add_argument("--flags", action="store_true", help="send quality flags with every row")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as folder:
        measure(Path(folder) / "bench.db", options)


def measure(path: Path, options: argparse.Namespace) -> None:
    """Fill one database file for the wanted time."""
    storage = SqlStorage(f"sqlite:///{path}")
    storage.migrate()
    plan_id = prepare_catalogue(storage, options)
    places = count()
    until = time.perf_counter() + options.seconds

    def feed(worker: int) -> int:
        random = np.random.default_rng(worker)
        waiting: set[Future[BatchReceipt]] = set()
        sent = 0
        while time.perf_counter() < until:
            waiting.add(storage.archive.append_measurements(batch(next(places), plan_id, random, options)))
            sent += 1
            if len(waiting) == DEPTH:
                _, waiting = wait(waiting, return_when="FIRST_COMPLETED")
        wait(waiting)
        return sent

    started = time.perf_counter()
    with ThreadPoolExecutor(options.threads) as pool:
        batches = sum(pool.map(feed, range(options.threads)))
    elapsed_s = time.perf_counter() - started
    stored = storage.archive.head("bench").newest_number - 2
    storage.close()
    assert stored == batches * options.rows, f"{stored} rows stored of {batches * options.rows} acknowledged"
    print(
        f"{batches / elapsed_s:8.0f} batches/s  {stored / elapsed_s:9.0f} rows/s  {path.stat().st_size / stored:6.1f} B/row"
    )


def prepare_catalogue(storage: SqlStorage, options: argparse.Namespace) -> int:
    """Store a spacecraft with a plan and return the plan's id."""
    inertia = ((4000.0, 0.0, 0.0), (0.0, 2000.0, 0.0), (0.0, 0.0, 4000.0))
    storage.catalogue.add_spacecraft(Spacecraft("bench", "Bench", 90.0, Site(55.0, 38.0), inertia, 0.05))
    carriers = [Carrier(f"c{k:02}", "C", f"t{k // 2}", 3.7e9 + k * 1e7, 5e6) for k in range(options.carriers)]
    return storage.catalogue.put_plan("bench", carriers, "bench").id


def batch(place: int, plan_id: int, random: np.random.Generator, options: argparse.Namespace) -> MeasurementBatch:
    """Return the batch with a number, later than all before it."""
    rows = options.rows
    power_dbm = np.round(random.normal(-60.0, 0.1, (rows, options.carriers)), 2).astype(np.float32)
    return MeasurementBatch(
        spacecraft_id="bench",
        source="sa-1",
        plan_id=plan_id,
        received_at_us=START_US + (place + 1) * rows * STEP_US,
        index=np.arange(rows),
        epochs_us=START_US + (place * rows + np.arange(rows)) * STEP_US,
        power_dbm=power_dbm,
        flags=((0,) * options.carriers,) * rows if options.flags else (None,) * rows,
        is_stale=np.zeros(rows, dtype=bool),
        first_seq=place * rows,
    )


if __name__ == "__main__":
    main()
