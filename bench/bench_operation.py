"""Transcript of years of operation over real processes: catch-up, kill, restart, replays, chart of a year, doctor.

At its end everything is replayed with another calibration, and compared with what was computed live.

Run ``python -m bench.bench_operation --rows 1000000``: that many rows, one a minute, after one alignment, which the
service consumes by itself (``--folder`` keeps the archive, and goes on with one that lies there). Times are those of
the clock and of the processor. Figures only: ratios of what grows with the rows stand in ``tests/growth`` and in
``bench_summaries``.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import urlencode

import httpx
import numpy as np

from bench import plain_batch
from bench.load.server_process import ServedProcess, running
from db.storage import SqlStorage
from service.records.calibration import Window
from service.records.epoch import format_epoch, parse_epoch
from service.records.inputs import AttitudeReference
from service.records.levels.attitude import Axes
from service.records.storage import sqlite_url
from service.runtime.jobs.calibration import AlignmentRequest
from tests.fakes.drivers.busy_station import SC, Station
from tests.fakes.worlds.geometry_flight import MINUTE, PERIOD_S, START_US, FlightPayload, S

CARRIERS = 16
PAYLOAD = FlightPayload.make(CARRIERS)
NOISE_DB = 0.05
DAY_ROWS = 1440
_TRACK_DAYS = 5
#: the alignment's end, so far back that a million minutes end before this program was written, microseconds UTC
_ALIGNED_US = START_US - 760 * DAY_ROWS * MINUTE
_KEY = "key-of-the-benchmark"


class Operated(NamedTuple):
    """A running service and a client of it."""

    process: ServedProcess
    client: httpx.Client
    #: of the monotonic clock, when its process was started, s
    began_s: float

    def timed(self, what: str, work: Callable[[], Any]) -> Any:
        """Do something, print the time and the service's processor time that it took, and return its result."""
        began_s, began_cpu_s = time.perf_counter(), self.process.cpu_s()
        found = work()
        taken_s, cpu_s = time.perf_counter() - began_s, self.process.cpu_s() - began_cpu_s
        print(f"  {what}: {taken_s:.2f} s ({cpu_s:.2f} s of the service's processor time)", flush=True)
        return found

    def get(self, path: str) -> Any:
        """Return an answer below the spacecraft."""
        answer = self.client.get(f"/api/v1/spacecraft/{SC}/{path}")
        assert answer.status_code == 200, answer.text
        return answer.json()

    def post(self, path: str, body: Any) -> Any:
        """Post a document and return the answer."""
        answer = self.client.post(f"/api/v1/spacecraft/{SC}/{path}", json=body)
        assert answer.status_code < 300, answer.text
        return answer.json()


def main() -> bool:
    """Print the transcript."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=20_000)
    parser.add_argument("--folder", type=Path, default=None)
    options, _ = parser.parse_known_args()
    with tempfile.TemporaryDirectory(dir=Path.cwd(), prefix="bench-") as name:
        folder = options.folder or Path(name)
        database = folder / "soo.db"
        if not database.exists():
            folder.mkdir(exist_ok=True)
            fill(folder, options.rows)
        days = options.rows / DAY_ROWS
        print(f"{options.rows} rows of {CARRIERS} carriers after an alignment, {days:.0f} days at a row a minute")
        with operated(database) as service:
            service.timed("the service consumes what waits", lambda: await_consumed(database))
        _ask_doctor(database)
        for is_killed in (True, False):
            _restart(database, is_killed=is_killed)
        _fail_over(database)
        with operated(database) as service:
            _ask(service)
            _replay(service)
        other = add_calibration(folder)
        with operated(database) as service:
            _compare(service, other, folder / "differences.png")
        _ask_doctor(database)
    return True


def at(minute: float) -> int:
    """Return the epoch of a minute, microseconds UTC; the alignment ends at 0."""
    return round(_ALIGNED_US + minute * MINUTE)


def angles_deg(minutes: Any) -> np.ndarray:
    """Return the true attitude (T, 3): a slow swing."""
    turn = 2.0 * np.pi * np.asarray(minutes, dtype=np.float64)[:, None] / 900.0
    return np.array([0.1, 0.06, -0.06]) * np.sin(turn + np.array([0.0, 1.0, 2.0]))


def fill(folder: Path, rows: int) -> None:
    """Make an archive whose rows wait for the service: catalogue, calibration, alignment, rows."""
    with closing(Station(folder)) as station:
        storage = station.storage
        storage.prepare()
        storage.catalogue.add_spacecraft(PAYLOAD.spacecraft(coupling=True))
        storage.catalogue.put_plan(SC, PAYLOAD.carriers(), "bench")
        _put_track(station, 0)
        station.calibrate(PAYLOAD.calibration())
        _append(station, range(-30, 1))
        known = Axes(0.01, 0.005, 0.005)
        references = [AttitudeReference("st", at(k), Axes(*angles_deg([k])[0]), known) for k in range(-30, 1)]
        storage.archive.append_inputs(SC, references)
        with station.supervised() as settle:
            station.aligner.align(SC, AlignmentRequest(Window(at(-30), at(0) + 1), ("st",) * 3, None, None, "bench"))
            settle()
        for first in range(1, rows + 1, _TRACK_DAYS * DAY_ROWS):
            _put_track(station, first)
            _append(station, range(first, min(first + _TRACK_DAYS * DAY_ROWS, rows + 1)))


def _put_track(station: Station, minute: int) -> None:
    """Put the ephemeris that holds from a minute on for some days."""
    known = PAYLOAD.ephemeris(start_us=at(minute - 60), stop_us=at(minute + (_TRACK_DAYS + 1) * DAY_ROWS))
    turns = (known.ascending_nodes_us[0] - at(minute)) // round(PERIOD_S * S) + 1
    nodes_us = tuple(node_us - turns * round(PERIOD_S * S) for node_us in known.ascending_nodes_us)
    station.storage.catalogue.put_ephemeris(SC, replace(known, ascending_nodes_us=nodes_us))


def _append(station: Station, minutes: range) -> None:
    """Store rows of some minutes, at most ten thousand."""
    epochs_us = np.array([at(minute) for minute in minutes], dtype=np.int64)
    noise_db = NOISE_DB * np.random.default_rng(minutes.start + 1_000_000).normal(size=(len(minutes), CARRIERS))
    power_dbm = PAYLOAD.power_dbm(epochs_us, angles_deg(minutes)) + noise_db
    batch = plain_batch(SC, int(epochs_us[-1]) + S, epochs_us, power_dbm)
    station.storage.archive.append_measurements(batch).result(timeout=600)


@contextmanager
def operated(database: Path) -> Iterator[Operated]:
    """Start the service, and stop it where it lives yet."""
    command = [sys.executable, "-m", "service", "serve", "--database", sqlite_url(str(database)), "--port", "0"]
    began_s = time.perf_counter()
    with running([*command, "--clock", "data"], _KEY) as process:
        headers = {"Authorization": f"Bearer {_KEY}"}
        with httpx.Client(base_url=process.url, headers=headers, timeout=600) as client:
            yield Operated(process, client, began_s)


def await_consumed(database: Path) -> None:
    """Wait until the service has computed every row."""
    with closing(SqlStorage(sqlite_url(str(database)))) as storage:
        while (head := storage.archive.head(SC)).consumed_number < head.newest_number:
            time.sleep(0.05)


def _restart(database: Path, *, is_killed: bool) -> None:
    """End a service that has just computed rows, start the next, and print when it gives its first new estimate."""
    with operated(database) as service:
        _estimate(service, database)
        if is_killed:
            os.kill(service.process.pid, signal.SIGKILL)
    with operated(database) as service:
        _estimate(service, database)
        taken_s, cpu_s = time.perf_counter() - service.began_s, service.process.cpu_s()
        how = "kill -9" if is_killed else "a clean stop"
        print(
            f"  {how}, start to the first new estimate: {taken_s:.2f} s ({cpu_s:.2f} s of processor time)", flush=True
        )


def _fail_over(database: Path) -> None:
    """Kill a service beside a second one, and print when that gives its first new estimate."""
    with operated(database) as leading, operated(database) as waiting:
        _estimate(leading, database)
        os.kill(leading.process.pid, signal.SIGKILL)
        waiting.timed(
            "kill -9 of the service that leads, until another gives a new estimate",
            lambda: _estimate(waiting, database),
        )


def _estimate(service: Operated, database: Path) -> None:
    """Post a row and wait for its attitude."""
    await_estimate(service, post_row(service, next_minute(database)))


def next_minute(database: Path) -> int:
    """Return the minute after the newest row."""
    with closing(SqlStorage(sqlite_url(str(database)))) as storage:
        newest_us = storage.archive.head(SC).newest_epoch_us
    assert newest_us is not None
    return round((newest_us - at(0)) / MINUTE) + 1


def post_row(service: Operated, minute: int) -> str:
    """Post the row of a minute and return its epoch."""
    epoch = format_epoch(at(minute))
    power = PAYLOAD.power_dbm([at(minute)], angles_deg([minute]))[0].round(3)
    row = {"epoch": epoch, "power_dbm": power.tolist()}
    service.post("measurements:batch", {"plan_id": 1, "source": "sa-1", "measurements": [row]})
    return epoch


def await_estimate(service: Operated, epoch: str) -> None:
    """Wait until the attitude of an epoch is answered."""
    while service.get("attitude")["epoch"] != epoch:
        time.sleep(0.01)


def _ask(service: Operated) -> None:
    """Print what the first questions of a shift take."""
    service.timed("first status", lambda: service.get("status"))
    service.timed("second status", lambda: service.get("status"))
    for name, quantities in (("powers", ("power_dbm",)), ("attitude", ("yaw_deg", "roll_deg", "pitch_deg"))):
        path = f"samples?count=1000&{urlencode({'quantity': quantities}, doseq=True)}"
        answer = service.timed(f"chart of it all, {name}, 1000 intervals", partial(service.get, path))
        print(f"    {len(str(answer)) / 1e6:.1f} MB of text")


def _replay(service: Operated) -> None:
    """Print what replays of an hour and of thirty days take."""
    newest_us = parse_epoch(service.get("attitude")["epoch"])
    last = round((newest_us - at(0)) / MINUTE)
    spans = {
        "the last hour": (last - 60, last),
        "an hour ten days ago": (last - 10 * DAY_ROWS, last - 10 * DAY_ROWS + 60),
        "the first hour of the last thirty days": (last - 30 * DAY_ROWS, last - 30 * DAY_ROWS + 60),
        "the last thirty days": (last - 30 * DAY_ROWS, last),
    }
    for name, (first, end) in spans.items():
        if first > 0:
            body = {"start": format_epoch(at(first)), "stop": format_epoch(at(end))}
            service.timed(f"replay of {name}, {end - first} rows", partial(_replayed, service, body))


def add_calibration(folder: Path) -> int:
    """Add a calibration that does not become active, of sensitivities by five percent too large; return its number."""
    other = replace(PAYLOAD, gradient=1.05 * PAYLOAD.gradient).calibration()
    with closing(Station(folder)) as station:
        results = station.storage.results
        draft = results.add_calibration(SC, other.request, 1, 1, 0, "bench")
        results.finish_calibration(SC, draft.id, other.result, None)
    return draft.id


def _compare(service: Operated, calibration_id: int, figure: Path) -> None:
    """Print what a replay of everything with a calibration takes, and what its comparison with the live rows says."""
    stop = format_epoch(parse_epoch(service.get("attitude")["epoch"]) + S)
    chosen = ["--calibration", str(calibration_id), "--method", "robust", "--no-commands"]
    with_other = [*chosen, "--start", format_epoch(at(1)), "--stop", stop]
    service.timed(
        "replay of everything with another calibration", lambda: _printed_answer(service, "replay", *with_other)
    )
    version = service.get("replays")["rows"][-1]["version"]
    drawn = ["live", version, "--figure", str(figure)]
    service.timed("comparison with the live rows", lambda: _printed_answer(service, "compare", *drawn))


def _printed_answer(service: Operated, *words: str) -> None:
    """Run a command of the terminal and print what it says."""
    command = [sys.executable, "-m", "service", *words, "--spacecraft", SC, "--service", service.process.url]
    ran = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, "SOO_KEY": _KEY})
    print("    " + (ran.stdout + ran.stderr).strip().replace("\n", "\n    "), flush=True)
    assert ran.returncode == 0, ran.returncode


def _replayed(service: Operated, body: Any) -> None:
    job = service.post("replays", body)["job"]
    while (state := service.client.get(f"/api/v1/jobs/{job}").json())["state"] not in ("done", "failed"):
        time.sleep(0.02)
    assert state["state"] == "done", state


def _ask_doctor(database: Path) -> None:
    """Print what the doctor finds, and how long it looks."""
    began_s = time.perf_counter()
    command = [sys.executable, "-m", "service", "doctor", "--database", sqlite_url(str(database))]
    found = subprocess.run(command, capture_output=True, text=True, check=False)
    print(f"  doctor ({time.perf_counter() - began_s:.1f} s, exit code {found.returncode}):")
    print("    " + found.stdout.strip().replace("\n", "\n    "), flush=True)


if __name__ == "__main__":
    main()
