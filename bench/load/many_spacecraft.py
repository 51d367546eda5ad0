"""Many spacecraft in one service on SQLite: each sends ten rows of sixteen carriers a second, in batches of a second.

Run ``python -m bench.load.many_spacecraft``. The service runs in this process but for its interface: writer,
supervisor, alarms, release, jobs; both methods run, and torques are computed. Batches are stored at the pace of the
clock, and the time counts until each has its results: what is kept up with is less than what is sent where the service
falls behind. Beside it stands the processor time of a row, and the chain's own part of that.
"""

import asyncio
import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench import options_of, plain_batch, prepare
from bench.bench_chain import chain_time
from db.storage import SqlStorage
from service.api.context import ApiContext
from service.composition.bootstrap import build_app
from service.composition.settings import Settings
from service.records.catalogue import Release
from service.records.storage import sqlite_url
from tests.fakes.worlds.geometry_flight import HOUR, START_US, FlightPayload

CARRIERS = 16
#: rows of a batch, and time between them, us
ROWS, STEP_US = 10, 100_000
_NOISE_DB = 0.05
#: between two looks at what has its results, s
_LOOK_S = 0.05
GOAL_ROWS_PER_S, GOAL_LAG_S = 1500.0, 3.0


def main() -> bool:
    """Print what is kept up with; return whether the goals are met."""
    options = options_of(__doc__, spacecraft=200, seconds=10)
    with tempfile.TemporaryDirectory() as folder:
        return asyncio.run(_measured(Path(folder), options.spacecraft, options.seconds))


async def _measured(folder: Path, spacecraft: int, seconds: int) -> bool:
    settings = Settings.model_validate({"database_url": sqlite_url(str(folder / "soo.db")), "clock": "data"})
    storage = SqlStorage(settings.database_url, settings.database_timeout_s)
    storage.prepare()
    payload, names = FlightPayload.make(CARRIERS, 5), [f"sc-{number:03d}" for number in range(spacecraft)]
    alignment = payload.alignment(START_US + HOUR, angles_deg=(0.0, 0.0, 0.0))
    for name in names:
        prepare(storage, payload, name, alignment)
        record = storage.catalogue.spacecraft(name)
        # a person releases: no computed command counts as applied by itself
        two_step = replace(record, control=replace(record.control, release=Release.TWO_STEP))
        storage.catalogue.replace_spacecraft(two_step)
    context: ApiContext = build_app(settings, storage).state.context
    await context.on_startup()
    run = _Run(storage, context, payload, names)
    # the compiled functions are loaded, and every chain is there, before the time counts
    await asyncio.to_thread(run.send, 0)
    await asyncio.to_thread(run.wait)
    met = await asyncio.to_thread(run.measure, seconds)
    await context.on_shutdown()
    return met


class _Run:
    """Load of some seconds."""

    def __init__(self, storage: SqlStorage, context: ApiContext, payload: FlightPayload, names: list[str]) -> None:
        self._storage, self._context, self._payload, self._names = storage, context, payload, names
        #: journal number and time of each batch that has no results yet
        self._sent: dict[str, list[tuple[int, float]]] = {name: [] for name in names}
        self._lags_s: list[float] = []

    def send(self, batch: int) -> None:
        """Store a batch of every spacecraft."""
        epochs_us = START_US + HOUR + STEP_US * (1 + ROWS * batch + np.arange(ROWS))
        noise_db = np.random.default_rng(batch).normal(0.0, _NOISE_DB, (ROWS, CARRIERS))
        powers = self._payload.power_dbm(epochs_us, np.zeros((ROWS, 3))) + noise_db
        append, sent_s = self._storage.archive.append_measurements, time.perf_counter()
        waits = [append(plain_batch(name, START_US, epochs_us, powers)) for name in self._names]
        for name, wait in zip(self._names, waits, strict=True):
            receipt = wait.result(timeout=600)
            number = (receipt.first_number or 0) + receipt.accepted - 1
            self._sent[name].append((number, sent_s))
            self._context.on_accepted(name, number)

    def wait(self, until_s: float = float("inf")) -> None:
        """Look for results until an instant, or until every row has them."""
        while time.perf_counter() < until_s and any(self._sent.values()):
            heads, now_s = self._storage.archive.heads(), time.perf_counter()
            for name, sent in self._sent.items():
                while sent and sent[0][0] <= heads[name].consumed_number:
                    self._lags_s.append(now_s - sent.pop(0)[1])
            time.sleep(_LOOK_S)
        time.sleep(max(0.0, min(until_s - time.perf_counter(), 1.0)))

    def measure(self, seconds: int) -> bool:
        """Send a batch of every spacecraft each second, and print what came of it."""
        self._lags_s.clear()
        with chain_time() as spent_s:
            began_s, began_cpu_s = time.perf_counter(), time.process_time()
            for second in range(seconds):
                self.send(1 + second)
                self.wait(began_s + second + 1.0)
            self.wait()
            taken_s, cpu_s = time.perf_counter() - began_s, time.process_time() - began_cpu_s
        rows = seconds * ROWS * len(self._names)
        rate, lag_s = rows / taken_s, float(np.quantile(self._lags_s, 0.99))
        print(f"{len(self._names)} spacecraft, {os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}")
        print(f"  {rate:.0f} of {ROWS * len(self._names)} rows/s kept up with, lag p99 {lag_s:.1f} s")
        print(f"  processor time of a row: {1e3 * cpu_s / rows:.2f} ms, {1e3 * spent_s[0] / rows:.2f} of it the chain")
        met = rate >= GOAL_ROWS_PER_S and lag_s <= GOAL_LAG_S
        print(f"  goals {GOAL_ROWS_PER_S:g} rows/s, {GOAL_LAG_S:g} s: {'PASS' if met else 'MISS'}")
        return met


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
