"""Processor time of a replay without commands, a row: read from the archive, through the chain, encoded, stored.

Run ``python -m bench.bench_replay``. An archive of some days of rows a minute is replayed by the robust method as
``POST /replays`` with ``"commands": false`` runs it in its own process, over SQLite. What the chain takes of it is told
beside the rest: reading, encoding, storing and checkpoints. Ratios to the yardstick of `bench_chain`.
"""

import secrets
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench import options_of, plain_batch, prepare
from bench.bench_chain import chain_time, yardstick_s
from db.storage import SqlStorage
from service.pipeline.config import ChainConfig
from service.records.catalogue import Method
from service.records.operations.work import Job, JobState, Replay
from service.records.storage import sqlite_url
from service.runtime.jobs.job_runner import calm_collector
from service.runtime.jobs.replay import ReplayRun
from tests.fakes.worlds.geometry_flight import HOUR, MINUTE, SC, START_US, FlightPayload

CARRIERS = 16
GOAL_YARDSTICKS = 1.2
_BATCH_ROWS = 1440
_NOISE_DB = 0.05


class ReplayTimes(NamedTuple):
    """Processor time of a row, s."""

    whole_s: float
    chain_s: float
    yardstick_s: float


def main() -> bool:
    """Print the figures and return whether the goal is met."""
    options = options_of(__doc__, days=14.0)
    with tempfile.TemporaryDirectory(dir=Path.cwd(), prefix="bench-") as name:
        found = measure(Path(name) / "replay.db", round(options.days * 1440.0))
    whole, chain = found.whole_s / found.yardstick_s, found.chain_s / found.yardstick_s
    print(f"replay of {options.days:g} days at 60 s, robust method, no commands, {CARRIERS} carriers")
    is_met = whole <= GOAL_YARDSTICKS
    verdict = "PASS" if is_met else "MISS"
    print(f"  a row: {whole:.2f} of the yardstick ({1e3 * found.whole_s:.2f} ms), goal {GOAL_YARDSTICKS:g}: {verdict}")
    print(f"  of it in the chain {chain:.2f}, outside {whole - chain:.2f}")
    return is_met


def measure(database: Path, rows: int) -> ReplayTimes:
    """Return the times of a replay of some rows."""
    with closing(SqlStorage(sqlite_url(str(database)))) as storage:
        _fill(storage, rows)
        # as in the process of the jobs
        calm_collector()
        config = ChainConfig()
        _replay(storage, config, 200)
        before_s = yardstick_s()
        whole_s, chain_s = _replay(storage, config, rows)
        return ReplayTimes(whole_s / rows, chain_s / rows, 0.5 * (before_s + yardstick_s()))


def _fill(storage: SqlStorage, rows: int) -> None:
    """Lay down catalogue, calibration and alignment, and rows a minute after it."""
    payload, rng = FlightPayload.make(CARRIERS, 5), np.random.default_rng(1)
    storage.prepare()
    prepare(storage, payload, SC, payload.alignment(START_US + HOUR, angles_deg=(0.0, 0.0, 0.0)))
    for first in range(1, rows + 1, _BATCH_ROWS):
        number = np.arange(first, min(first + _BATCH_ROWS, rows + 1))
        epochs_us = START_US + HOUR + MINUTE * number
        angles_deg = 0.2 * np.sin(number[:, np.newaxis] / np.array([90.0, 70.0, 50.0]))
        power_dbm = payload.power_dbm(epochs_us, angles_deg) + _NOISE_DB * rng.normal(size=(len(number), CARRIERS))
        batch = plain_batch(SC, int(epochs_us[-1]), epochs_us, power_dbm)
        assert storage.archive.append_measurements(batch).result(timeout=60).accepted == len(number)


def _replay(storage: SqlStorage, config: ChainConfig, rows: int) -> tuple[float, float]:
    """Run one replay; return the processor time of all threads, and that of the steps of its chain."""
    start_us = START_US + HOUR
    job = Job(secrets.token_hex(8), "replay", JobState.RUNNING, 0.0, start_us)
    storage.results.add_job(job, "bench")
    stop_us = start_us + (rows + 1) * MINUTE
    wanted = Replay(0, start_us, stop_us, Method.ROBUST, None, 1, "journal", job.id, start_us, commands=False)
    replay = storage.results.add_replay(SC, wanted)
    with chain_time() as spent_s:
        began_s = time.process_time()
        for _ in ReplayRun(storage, config, SC, replay.version).pieces():
            pass
        taken_s = time.process_time() - began_s
    stored = storage.results.replay(SC, replay.version)
    assert (stored.attitude_rows, stored.torque_rows) == (rows, 0)
    return taken_s, spent_s[0]


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
