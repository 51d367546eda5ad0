"""From a row's POST to its event: how long it takes, and how much of it reaches many clients.

Run ``python -m bench.bench_stream``. The service runs with a durable archive, calibrated and aligned, so that each row
is stored, goes through the chain and gives an attitude and a torque beside the measurement. Rows of 16 carriers come
ten times a second. The first part has one client and tells the time from the first byte of the POST to the event; the
second has 200 clients in a process of their own and tells the share of events that were delivered. The load of the
machine stands beside the figures: they are only as good as it was idle.
"""

import asyncio
import json
import os
import secrets
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench import options_of, prepare
from bench.load.server_process import served
from db.storage import SqlStorage
from service.client.async_service_client import AsyncServiceClient
from service.records.epoch import format_epoch
from service.records.storage import sqlite_url
from tests.fakes.worlds.synthetic_payload import HOUR, MINUTE, SC, START_US, SyntheticPayload

CARRIERS = 16
ROWS_PER_S = 10
GOAL_P50_S, GOAL_P99_S = 0.005, 0.020
GOAL_DELIVERED = 0.95
#: rows before the clock starts: the chain warms up
_WARM_UP = 20


class StreamTimes(NamedTuple):
    """Delays and delivery of one run."""

    #: from POST to event, s: measurement, attitude
    measurement_s: list[float]
    attitude_s: list[float]
    clients: int
    #: events got over events that were to be got
    delivered: float
    #: processor time of the service while many listened, over wall time
    cpu_share: float


def main() -> bool:
    """Print the figures and return whether the goals are met."""
    options = options_of(__doc__, seconds=10.0, clients=200)
    load = os.getloadavg()[0]
    figures = measure(options.seconds, options.clients)
    print(
        f"stream: {ROWS_PER_S} rows/s x {CARRIERS} carriers, load of the machine before {load:.1f} of {os.cpu_count()}"
    )
    is_met = _show("measurement", figures.measurement_s)
    _show("attitude", figures.attitude_s)
    is_delivered = figures.delivered >= GOAL_DELIVERED
    print(
        f"  {figures.clients} clients: {figures.delivered:.3f} of the events delivered, goal {GOAL_DELIVERED}: "
        f"{'PASS' if is_delivered else 'MISS'}; the service took {100 * figures.cpu_share:.0f} % of a core"
    )
    return is_met and is_delivered


def _show(kind: str, delays_s: list[float]) -> bool:
    """Print one line of delays and return whether the goals are met."""
    p50_s, p99_s = (float(np.quantile(delays_s, q)) for q in (0.5, 0.99))
    is_met = p50_s <= GOAL_P50_S and p99_s <= GOAL_P99_S
    print(
        f"  POST to {kind}: p50 {1e3 * p50_s:.1f} ms, p99 {1e3 * p99_s:.1f} ms, goals {1e3 * GOAL_P50_S:.0f} and "
        f"{1e3 * GOAL_P99_S:.0f} ms: {'PASS' if is_met else 'MISS'}"
    )
    return is_met


def measure(seconds: float, clients: int) -> StreamTimes:
    """Return the figures of one run."""
    payload, key = SyntheticPayload.make(CARRIERS, 5), secrets.token_urlsafe(16)
    with tempfile.TemporaryDirectory(dir=Path.cwd(), prefix="bench-") as name:
        database = Path(name) / "stream.db"
        _prepare(database, payload)
        with served("durable", sqlite_url(str(database)), key) as service:
            alone = asyncio.run(_delays(service.url, key, payload, seconds))
            cpu_s, began_s = service.cpu_s(), time.monotonic()
            with _crowd(service.url, key, clients) as crowd:
                sent = asyncio.run(_send(service.url, key, payload, seconds))
                # the last events are on their way
                time.sleep(1.5)
                counts = crowd.counts()
            share = (service.cpu_s() - cpu_s) / (time.monotonic() - began_s)
    delivered = sum(min(count, sent) for count in counts) / (sent * clients)
    return StreamTimes(alone["measurement"], alone["attitude"], clients, delivered, share)


def _prepare(database: Path, payload: SyntheticPayload) -> None:
    """Make an archive with a calibrated and aligned spacecraft."""
    with closing(SqlStorage(sqlite_url(str(database)))) as storage:
        storage.prepare()
        prepare(storage, payload, SC, payload.alignment(START_US + HOUR))


def _row(payload: SyntheticPayload, number: int) -> dict[str, Any]:
    """Return one row as it is sent, a minute of the spacecraft's time after the one before."""
    epoch_us = START_US + HOUR + number * MINUTE
    angles_deg = 0.1 * np.sin(number / np.array([90.0, 70.0, 50.0]))
    (power_dbm,) = payload.power_dbm(np.array([epoch_us]), angles_deg, noise_db=0.05, seed=number)
    return {"epoch": format_epoch(epoch_us), "power_dbm": [round(float(level), 3) for level in power_dbm]}


class _Numbers:
    """Rows are numbered through all parts of a run."""

    sent = 0


async def _send(
    url: str, key: str, payload: SyntheticPayload, seconds: float, sent_s: dict[str, float] | None = None
) -> int:
    """Post rows in time and return how many."""
    count = round(seconds * ROWS_PER_S)
    async with AsyncServiceClient(url, key) as client:
        begin_s = time.perf_counter()
        for position in range(count):
            await asyncio.sleep(max(0.0, begin_s + position / ROWS_PER_S - time.perf_counter()))
            _Numbers.sent += 1
            row = _row(payload, _Numbers.sent)
            if sent_s is not None:
                sent_s[row["epoch"]] = time.perf_counter()
            receipt = await client.post_measurements(SC, 1, [row], source="sa-1")
            assert receipt["accepted"] == 1, receipt
    return count


async def _delays(url: str, key: str, payload: SyntheticPayload, seconds: float) -> dict[str, list[float]]:
    """Return the times from POST to event by kind, with one client."""
    sent_s: dict[str, float] = {}
    found: dict[str, dict[str, float]] = {"measurement": {}, "attitude": {}}
    listening = asyncio.Event()

    async def listen() -> None:
        async with AsyncServiceClient(url, key) as client:
            async for event in client.stream(SC):
                at_s = time.perf_counter()
                listening.set()
                if event.kind in found and event.data.get("method", "paper") == "paper":
                    found[event.kind][event.data["epoch"]] = at_s

    listener = asyncio.create_task(listen())
    await listening.wait()
    await _send(url, key, payload, _WARM_UP / ROWS_PER_S)
    await _send(url, key, payload, seconds, sent_s)
    await asyncio.sleep(0.5)
    listener.cancel()
    await asyncio.gather(listener, return_exceptions=True)
    missing = [epoch for kind in found.values() for epoch in sent_s if epoch not in kind]
    assert not missing, f"no event of {len(missing)} rows"
    return {kind: [at_s[epoch] - began_s for epoch, began_s in sent_s.items()] for kind, at_s in found.items()}


class _Crowd:
    """Many clients in another process."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process

    def counts(self) -> list[int]:
        """End the clients and return what each got."""
        reported, _ = self._process.communicate()
        return list(json.loads(reported.splitlines()[-1]))


@contextmanager
def _crowd(url: str, key: str, clients: int) -> Iterator[_Crowd]:
    """Start many clients and give them when all are connected."""
    command = [sys.executable, "-m", "bench.load.stream_clients", url, key, SC, str(clients)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield _Crowd(process)
        finally:
            if process.poll() is None:
                process.kill()


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
