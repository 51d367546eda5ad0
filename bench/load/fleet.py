"""Two estimators against one on a PostgreSQL server, forty spacecraft with sixteen carriers, both methods and torque.

Run ``python -m bench.load.fleet``. Estimators run without an interface (``soo serve --no-http``); once they have
shared the spacecraft out, rows of all are stored at once, and the time counts until each has its results. One and two
are measured in turn, each on a database of its own. The server and this program need processors too: with two of them
the ratio says what is left for estimators, and the processor time of a row says what sharing costs.
"""

import os
import statistics
import sys
import time
from collections import Counter
from contextlib import ExitStack
from typing import NamedTuple

import numpy as np

from bench import options_of, plain_batch, prepare
from bench.load.server_process import ServedProcess, running
from db.storage import SqlStorage
from tests.fakes.drivers.postgresql_cluster import NoServerError, PostgresqlCluster
from tests.fakes.worlds.synthetic_payload import HOUR, MINUTE, START_US, SyntheticPayload

CARRIERS = 16
GOAL = 1.6


class Run(NamedTuple):
    """Rows a second over all spacecraft, and processor time of a row in the estimators."""

    rows_per_s: float
    cpu_s: float


def main() -> bool:
    """Print the ratio and return whether the goal is met."""
    options = options_of(__doc__, spacecraft=40, rows=100, repeats=3)
    try:
        cluster = PostgresqlCluster(fsync=True)
    except NoServerError as fault:
        print(f"no PostgreSQL: {fault}")
        return True
    try:
        runs = [pair(cluster, options.spacecraft, options.rows) for _ in range(options.repeats)]
    finally:
        cluster.close()
    ratio = statistics.median(two.rows_per_s / one.rows_per_s for one, two in runs)
    cost = statistics.median(two.cpu_s / one.cpu_s for one, two in runs)
    rate, cpu_s = (statistics.median(getattr(one, name) for one, _ in runs) for name in Run._fields)
    print(f"estimators, {options.spacecraft} spacecraft, {os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}")
    print(f"  one: {rate:.0f} rows/s, {1e3 * cpu_s:.2f} ms of processor time a row")
    print(f"  processor time of a row, two / one: {cost:.2f}")
    print(f"  rows/s, two / one: {ratio:.2f}, goal {GOAL:g}: {'PASS' if ratio >= GOAL else 'MISS'}")
    return ratio >= GOAL


def pair(cluster: PostgresqlCluster, spacecraft: int, rows: int) -> tuple[Run, Run]:
    """Return a run of one estimator and one of two, printed as they end."""
    one, two = (measured(cluster, count, spacecraft, rows) for count in (1, 2))
    print(f"  one {one.rows_per_s:.0f}, two {two.rows_per_s:.0f} rows/s", flush=True)
    return one, two


def measured(cluster: PostgresqlCluster, estimators: int, spacecraft: int, rows: int) -> Run:
    """Return what some estimators do with rows of all spacecraft."""
    url, payload = cluster.new_database(), SyntheticPayload.make(CARRIERS, 5)
    names = [f"sc-{number:02d}" for number in range(spacecraft)]
    storage = SqlStorage(url)
    storage.prepare()
    for name in names:
        prepare(storage, payload, name, payload.alignment(START_US + HOUR))
    # the compiled functions are loaded, and every chain stands, before the time counts
    store(storage, payload, names, 0, 2)
    with ExitStack() as stack:
        command = [sys.executable, "-m", "service", "serve", "--no-http", "--clock", "data", "--database", url]
        processes: list[ServedProcess] = [
            stack.enter_context(running(command, "key-of-the-benchmark", announced="estimator"))
            for _ in range(estimators)
        ]
        await_share(storage, spacecraft, estimators)
        await_results(storage)
        cpu_s, began_s = sum(each.cpu_s() for each in processes), time.perf_counter()
        store(storage, payload, names, 2, rows)
        await_results(storage)
        seconds, cpu_s = time.perf_counter() - began_s, sum(each.cpu_s() for each in processes) - cpu_s
    storage.close()
    cluster.drop(url)
    return Run(spacecraft * rows / seconds, cpu_s / (spacecraft * rows))


def store(storage: SqlStorage, payload: SyntheticPayload, names: list[str], first: int, rows: int) -> None:
    """Store rows of every spacecraft, a minute apart."""
    epochs_us = START_US + HOUR + MINUTE * np.arange(first + 1, first + rows + 1)
    powers = payload.power_dbm(epochs_us, np.zeros((rows, 3)), noise_db=0.05, seed=first)
    waits = [storage.archive.append_measurements(plain_batch(name, START_US, epochs_us, powers)) for name in names]
    assert sum(each.result(timeout=600).accepted for each in waits) == rows * len(names)


def await_share(storage: SqlStorage, spacecraft: int, estimators: int) -> None:
    """Wait until every estimator leads its share."""
    while True:
        led = Counter(process for name, process in storage.leases.leaders().items() if name)
        if led.total() == spacecraft and len(led) == estimators and max(led.values()) <= -(-spacecraft // estimators):
            return
        time.sleep(0.1)


def await_results(storage: SqlStorage) -> None:
    """Wait until every row has its results."""
    while any(head.consumed_number < head.newest_number for head in storage.archive.heads().values()):
        time.sleep(0.05)


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
