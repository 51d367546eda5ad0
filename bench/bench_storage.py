"""Rate of durable ingest, bytes a row and rate of reading: batches of 100 rows of 32 carriers into a SQLite file.

Run ``python -m bench.bench_storage``; ``--help`` tells the options. Every batch counted is committed with
``synchronous=FULL``. Rates depend on disk and minute, so the same rows go through the bare driver in the same run:
one thread, ``executemany``, eight batches a commit, no receipts, no journal numbers, no duplicates. The ratio counts.
Then days of one source are read into arrays as rows, sealed, and read again. ``--url`` takes a PostgreSQL server.
"""

import argparse
import sqlite3
import tempfile
import time
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from db.segments import DAY_US
from db.storage import SqlStorage
from service.records.calibration import Window
from service.records.catalogue import Carrier, Site, Spacecraft
from service.records.measurement import BatchReceipt, MeasurementBatch

START_US = 1_795_000_000_000_000
STEP_US = 100_000
#: rows of one day at a row every ten seconds
DAY_ROWS = 8640
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
    parser.add_argument("--days", type=int, default=8, help="days of 8640 rows to read as rows and sealed")
    parser.add_argument("--decimals", type=int, default=2, help="of the levels, as the analyzer gives them")
    parser.add_argument("--url", help="an empty database to measure instead of a SQLite file")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as folder:
        bare = measure_driver(Path(folder) / "driver.db", options)
        rate = measure(Path(folder) / "bench.db", options)
        print(f"ratio to the bare driver {rate / bare:.2f}")
        measure_reading(options.url or f"sqlite:///{Path(folder) / 'days.db'}", options)


def measure_driver(path: Path, options: argparse.Namespace) -> float:
    """Return batches a second of plain inserts through sqlite3."""
    connection = sqlite3.connect(path, isolation_level=None)
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA synchronous=FULL")
    connection.execute(
        "CREATE TABLE row (source INT, epoch INT, powers BLOB, PRIMARY KEY (source, epoch)) WITHOUT ROWID"
    )
    powers, sent = bytes(4 * options.carriers), 0
    started = time.perf_counter()
    while (elapsed_s := time.perf_counter() - started) < options.seconds:
        connection.execute("BEGIN IMMEDIATE")
        for _ in range(8):
            rows = [(1, START_US + (sent * options.rows + row) * STEP_US, powers) for row in range(options.rows)]
            connection.executemany("INSERT INTO row VALUES (?, ?, ?)", rows)
            sent += 1
        connection.execute("COMMIT")
    connection.close()
    report("driver", sent, elapsed_s, options, path)
    return sent / elapsed_s


def report(name: str, batches: int, elapsed_s: float, options: argparse.Namespace, path: Path) -> None:
    """Print one line of figures."""
    rows = batches * options.rows
    size = path.stat().st_size / rows
    print(f"{name:8} {batches / elapsed_s:8.0f} batches/s {rows / elapsed_s:9.0f} rows/s {size:6.1f} B/row")


def measure(path: Path, options: argparse.Namespace) -> float:
    """Return batches a second through the archive."""
    storage = SqlStorage(f"sqlite:///{path}")
    storage.migrate()
    plan_id = prepare_catalogue(storage, options)
    until = time.perf_counter() + options.seconds

    def feed(worker: int) -> int:
        """Send batches of one front end in order of epoch and return how many."""
        templates = [batch(worker, plan_id, seed, options) for seed in range(16)]
        waiting: deque[Future[BatchReceipt]] = deque()
        sent = 0
        while time.perf_counter() < until:
            epochs_us = START_US + (sent * options.rows + np.arange(options.rows)) * STEP_US
            template = templates[sent % len(templates)]
            waiting.append(storage.archive.append_measurements(replace(template, epochs_us=epochs_us)))
            sent += 1
            if len(waiting) == DEPTH:
                waiting.popleft().result()
        for future in waiting:
            future.result()
        return sent

    started = time.perf_counter()
    with ThreadPoolExecutor(options.threads) as pool:
        batches = sum(pool.map(feed, range(options.threads)))
    elapsed_s = time.perf_counter() - started
    stored = sum(source.rows for source in storage.archive.sources("bench"))
    storage.close()
    assert stored == batches * options.rows, f"{stored} rows stored of {batches * options.rows} acknowledged"
    report("archive", batches, elapsed_s, options, path)
    return batches / elapsed_s


def measure_reading(url: str, options: argparse.Namespace) -> None:
    """Print bytes a row and rows a second read into arrays, as rows and sealed."""
    storage = SqlStorage(url)
    storage.migrate()
    plan_id = prepare_catalogue(storage, options)
    first_us = START_US // DAY_US * DAY_US
    rows = options.days * DAY_ROWS // options.rows * options.rows
    for start in range(0, rows, options.rows):
        epochs_us = first_us + (start + np.arange(options.rows)) * (DAY_US // DAY_ROWS)
        made = replace(batch(0, plan_id, start, options), epochs_us=epochs_us, received_at_us=int(epochs_us[-1]))
        storage.archive.append_measurements(replace(made, first_seq=start)).result()
    by_rows = read_rate(storage, rows)
    hot = size_of_rows(storage)
    started = time.perf_counter()
    sealed = sum(part.rows for part in storage.archive.seal("bench", 1 << 60, 1 << 60))
    sealing_s = time.perf_counter() - started
    assert sealed == rows, f"{sealed} rows sealed of {rows}"
    by_segments = read_rate(storage, rows)
    packed = size_of_segments(storage)
    storage.close()
    report_reading("rows", hot / rows, by_rows, options)
    report_reading("sealed", packed / rows, by_segments, options)
    print(f"sealed are read {by_segments / by_rows:.1f} times as fast; sealed at {rows / sealing_s:.0f} rows/s")


def report_reading(name: str, size: float, rate: float, options: argparse.Namespace) -> None:
    """Print one line of figures."""
    share = size / (4 * options.carriers)
    print(f"{name:8} {size:6.1f} B/row = {share:.2f} of the powers, read {rate:9.0f} rows/s")


def read_rate(storage: SqlStorage, rows: int) -> float:
    """Return rows a second read into arrays, median of five passes that remember nothing of each other."""
    rates = []
    for _ in range(5):
        storage._database.segments.clear()  # noqa: SLF001 - what was read lately must not help
        started = time.perf_counter()
        read = sum(len(block.epochs_us) for block in storage.archive.measurement_blocks("bench", Window(0, 1 << 60)))
        rates.append(read / (time.perf_counter() - started))
        assert read == rows, f"{read} rows read of {rows}"
    return float(np.median(rates))


def size_of_rows(storage: SqlStorage) -> int:
    """Return the bytes of the table of rows with its indexes."""
    return _size(storage, "measurement", "measurement_number")


def size_of_segments(storage: SqlStorage) -> int:
    """Return the bytes of the table of segments with its indexes."""
    names = ("measurement_segment", "measurement_segment_number", "sqlite_autoindex_measurement_segment_1")
    return _size(storage, *names)


def _size(storage: SqlStorage, *names: str) -> int:
    with storage._database.engines.write.connect() as connection:  # noqa: SLF001 - no port tells sizes of tables
        if connection.dialect.name == "postgresql":
            return int(connection.exec_driver_sql("SELECT pg_total_relation_size(%s)", (names[0],)).scalar_one())
        marks = ", ".join("?" * len(names))
        query = f"SELECT sum(pgsize) FROM dbstat WHERE name IN ({marks})"  # noqa: S608 - marks only
        return int(connection.exec_driver_sql(query, names).scalar_one())


def prepare_catalogue(storage: SqlStorage, options: argparse.Namespace) -> int:
    """Store a spacecraft with a plan and return the plan's id."""
    inertia = ((4000.0, 0.0, 0.0), (0.0, 2000.0, 0.0), (0.0, 0.0, 4000.0))
    storage.catalogue.add_spacecraft(Spacecraft("bench", "Bench", 90.0, Site(55.0, 38.0), inertia, 0.05))
    carriers = [Carrier(f"c{k:02}", "C", f"t{k // 2}", 3.7e9 + k * 1e7, 5e6) for k in range(options.carriers)]
    return storage.catalogue.put_plan("bench", carriers, "bench").id


def batch(worker: int, plan_id: int, seed: int, options: argparse.Namespace) -> MeasurementBatch:
    """Return a batch of one front end."""
    rows = options.rows
    random = np.random.default_rng(1000 * worker + seed)
    return MeasurementBatch(
        spacecraft_id="bench",
        source=f"sa-{worker}",
        plan_id=plan_id,
        received_at_us=START_US,
        index=np.arange(rows),
        epochs_us=np.arange(rows),
        power_dbm=np.round(random.normal(-60.0, 0.1, (rows, options.carriers)), options.decimals).astype(np.float32),
        flags=((0,) * options.carriers,) * rows if options.flags else (None,) * rows,
        is_stale=np.zeros(rows, dtype=bool),
        first_seq=0,
    )


if __name__ == "__main__":
    main()
