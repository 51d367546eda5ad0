"""Cost of a row on its way to the front end's disk, against the bare SQLite driver doing the same commit."""

import sqlite3
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from service.frontend.acquisition.evaluation import MeasuredRow
from service.frontend.spool.file import Owner, UploadLane
from service.frontend.spool.row import SpooledTask
from service.frontend.spool.spool import Spool

CARRIERS = 16
ROWS = 500
REPEATS = 5


def row(number: int) -> MeasuredRow:
    """Return a row of sixteen carriers."""
    figures = np.full(CARRIERS, 0.5)
    return MeasuredRow(number, figures - 40.0, np.zeros(CARRIERS, dtype=np.int64), figures, figures, figures, figures)


def timed(work: Callable[[int], object], first: int) -> list[float]:
    """Return the seconds that each call took."""
    taken = []
    for number in range(first, first + ROWS):
        begun = time.perf_counter()
        work(number)
        taken.append(time.perf_counter() - begun)
    return taken


def main() -> None:
    """Measure in turn and print."""
    with tempfile.TemporaryDirectory() as folder:
        bare = sqlite3.connect(Path(folder) / "bare.db", isolation_level=None)
        bare.execute("PRAGMA journal_mode=WAL")
        bare.execute("PRAGMA synchronous=FULL")
        bare.execute("CREATE TABLE bare (seq INTEGER PRIMARY KEY AUTOINCREMENT, epoch INTEGER UNIQUE, powers BLOB)")
        blob = bytes(CARRIERS * 28)
        task = SpooledTask("0" * 64, tuple(f"c{k:02d}" for k in range(CARRIERS)))
        ratios, appended, settled, spent = [], [], [], []
        with Spool(Path(folder) / "x.spool", Owner("sc", "sa"), task, lambda: 0) as spool:
            for repeat in range(REPEATS):
                first = repeat * ROWS
                plain = timed(
                    lambda k: bare.execute("INSERT INTO bare (epoch, powers) VALUES (?, ?)", (k, blob)), first
                )
                begun_s = time.thread_time()
                kept = timed(lambda k: spool.append(row(k)), first)
                spent.append((time.thread_time() - begun_s) / ROWS)
                ratios.append(statistics.median(kept) / statistics.median(plain))
                appended.append(statistics.median(kept))
                begun_s = time.perf_counter()
                while rows := spool.batch(UploadLane.LIVE, 0, 100):
                    spool.settle(rows)
                settled.append((time.perf_counter() - begun_s) / ROWS)
        bare.close()
    print(
        f"spool: append {1e3 * statistics.median(appended):.2f} ms a row (fsync included), of it "
        f"{1e3 * statistics.median(spent):.2f} ms of the processor, {statistics.median(ratios):.2f} of a bare commit; "
        f"read and settle {1e3 * statistics.median(settled):.3f} ms"
    )


if __name__ == "__main__":
    main()
