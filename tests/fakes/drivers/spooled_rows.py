"""Rows, sweeps and spools for tests of the front end's disk."""

import sqlite3
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from service.frontend.acquisition.evaluation import MeasuredRow
from service.frontend.spool.file import Bounds, Owner, UploadLane
from service.frontend.spool.row import ARRAYS, SpooledTask
from service.frontend.spool.spool import Spool
from service.records.levels.measurement import Sweep, SweepSettings

OWNER = Owner("sc", "sa-1")
TASK = SpooledTask("f" * 64, ("c00", "c01"))
#: 2026-11-21T00:00:00Z
NOW_US = 1_795_219_200_000_000


class Hands:
    """Clock that moves by hand, s."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def row(number: int, carriers: int = 2) -> MeasuredRow:
    """Return a row with its number as epoch, its last carrier absent."""
    power = np.linspace(-40.0, -41.0, carriers) - number / 7.0
    power[-1] = np.nan
    flags = np.zeros(carriers, dtype=np.int64)
    flags[-1] = 16
    others = {name: np.full(carriers, 0.5) for name in ARRAYS if name not in {"power_dbm", "flags"}}
    return MeasuredRow(number, power_dbm=power, flags=flags, **others)


def sweep(number: int, name: str = "ku", points: int = 11) -> Sweep:
    """Return a sweep with its number as epoch, its last point absent."""
    settings = SweepSettings(950e6, 960e6, points, 30e3, 32e3, 300e3, 1.0, "RMS")
    power = np.full(points, 1e-6)
    power[-1] = np.nan
    return Sweep(name, number, settings, power)


def spool(
    folder: Path,
    bounds: Bounds | None = None,
    elapsed_s: Callable[[], float] = time.monotonic,
    task: SpooledTask = TASK,
    now_us: int = NOW_US,
    **options: Any,
) -> Spool:
    """Return the spool of a folder."""
    return Spool(folder / "sa-1.spool", OWNER, task, lambda: now_us, bounds, elapsed_s=elapsed_s, **options)


def waiting(made: Spool, limit: int = 1000) -> list[tuple[int | None, int]]:
    """Return number and epoch of what waits."""
    return [(each.seq, each.row.epoch_us) for each in made.batch(UploadLane.LIVE, 0, limit)]


def fill_disk(made: Spool) -> None:
    """Let the disk take nothing more."""
    connection = made._disk.file.connection
    pages = connection.execute("PRAGMA page_count").fetchone()[0]
    connection.execute(f"PRAGMA max_page_count={pages}")
    idle = connection.execute("PRAGMA freelist_count").fetchone()[0]
    assert idle == 0


def protect_disk(made: Spool) -> None:
    """Let the file be read only."""

    def refuse(*_: object, **__: object) -> None:
        error = sqlite3.OperationalError("attempt to write a readonly database")
        error.sqlite_errorcode = sqlite3.SQLITE_READONLY
        raise error

    made._disk.file.store = made._disk.file.settle = refuse


def heal_disk(made: Spool) -> None:
    """Let the disk take all again."""
    made._disk.file.connection.execute("PRAGMA max_page_count=1000000")
    for name in {"store", "settle"} & vars(made._disk.file).keys():
        delattr(made._disk.file, name)
