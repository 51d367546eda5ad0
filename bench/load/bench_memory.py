"""Memory that a calibration and a replay grow by, each in a process of its own.

Run ``python -m bench.load.bench_memory``. The calibration reads quiet days and turns at a row a second with as many
sensor readings (``--days`` 3 are those of the goal and take two minutes to fill). The replay runs the robust method
without torques over ``--rows`` of 60 s; half a million are a year and take a quarter of an hour. Growth is the peak of
the resident memory over what the process holds when its programs are loaded and have run once.
"""

import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from bench import options_of, plain_batch
from db.storage import SqlStorage
from service.pipeline.calibration.geometry_calibration import calibrate_geometry
from service.pipeline.config import AlignmentConfig, CalibrationConfig, ChainConfig
from service.records.calibration import CalibrationRequest, Window
from service.records.catalogue import Method
from service.records.inputs import AttitudeReference
from service.records.levels.attitude import Axes
from service.records.operations.work import JobKind, JobState, Replay
from service.records.storage import sqlite_url
from service.runtime.clock import SystemClock
from service.runtime.jobs.calibration import Aligner, AlignmentRequest, CalibrationWork, Calibrator
from service.runtime.jobs.job_runner import JobPieces, JobRunner, Work
from service.runtime.jobs.replay import Replayer, replay_work
from tests.fakes.worlds.geometry_flight import START_US as FLIGHT_US
from tests.fakes.worlds.geometry_flight import FlightPayload
from tests.fakes.worlds.geometry_payload import HOUR, MINUTE, GeometryPayload, S, turned_angles

CARRIERS = 16
GOALS_MB = {"calibration": 150.0, "replay": 64.0}
_AT_ONCE = 10_000
_RECEIVED_US = 2_000_000_000_000_000


def main() -> bool:
    """Print the figures and return whether the goals are met."""
    options = options_of(__doc__, days=3.0, rows=10_000)
    is_met = []
    with tempfile.TemporaryDirectory(dir=Path.cwd(), prefix="bench-") as name:
        made = sqlite_url(f"{name}/calibration.db"), sqlite_url(f"{name}/replay.db")
        print(f"calibration of {options.days:g} days and the turns at 1 row/s, replay of {options.rows} rows")
        fill_calibration(made[0], options.days)
        fill_replay(made[1], options.rows)
        for what, grown, url in zip(GOALS_MB, (calibration_mb, replay_mb), made, strict=True):
            with ProcessPoolExecutor(1, get_context("spawn")) as pool:
                growth_mb = pool.submit(grown, url, options.days if what == "calibration" else options.rows).result()
            goal_mb = GOALS_MB[what]
            is_met.append(growth_mb <= goal_mb)
            print(f"  {what}: {growth_mb:.0f} MB, goal {goal_mb:g}: {'PASS' if is_met[-1] else 'MISS'}")
    return all(is_met)


def growth_mb(work: Callable[[], object]) -> float:
    """Return by how much the resident memory of this process peaks over what it is now, MB."""
    Path("/proc/self/clear_refs").write_text("5")
    before_kb = _status_kb("VmRSS")
    work()
    return (_status_kb("VmHWM") - before_kb) / 1e3


def _status_kb(name: str) -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name))


# ---- calibration


def fill_calibration(url: str, days: float) -> None:
    """Store quiet days and turns at a row a second, with a reading of the sensor for each row."""
    payload = GeometryPayload.make(CARRIERS, quiet_days=days)
    quiet, turns = payload.request.quiet, payload.request.turns
    turned, rng = turned_angles(), np.random.default_rng(1)
    with closing(SqlStorage(url)) as storage:
        storage.prepare()
        spacecraft = payload.spacecraft
        storage.catalogue.add_spacecraft(spacecraft)
        storage.catalogue.put_plan(spacecraft.id, payload.carriers, "bench")
        storage.catalogue.put_ephemeris(spacecraft.id, payload.ephemeris())
        for start_us in range(quiet.start_us, turns.stop_us, _AT_ONCE * S):
            epochs_us = np.arange(start_us, min(start_us + _AT_ONCE * S, turns.stop_us), S)
            waves = 2.0 * np.pi * epochs_us[:, None] / MINUTE / np.array([900.0, 1100.0, 700.0])
            angles = np.array([0.06, 0.04, 0.04]) * np.sin(waves + np.array([0.0, 1.0, 2.0]))
            is_turn = epochs_us >= turns.start_us
            angles[is_turn] += turned[(epochs_us[is_turn] - turns.start_us) // MINUTE]
            power_dbm = payload.power_dbm(epochs_us, angles) + 0.05 * rng.normal(size=(len(epochs_us), CARRIERS))
            _append(storage, spacecraft.id, epochs_us, power_dbm)
            _refer(storage, spacecraft.id, epochs_us, angles + 0.005 * rng.normal(size=angles.shape))


def _jobs(storage: SqlStorage, kind: JobKind, work: Work) -> JobRunner:
    """Return what runs the jobs of a kind in this process."""
    return JobRunner(storage, SystemClock(), JobPieces({kind: work}).advance)


def calibration_mb(url: str, days: float) -> float:
    """Return the growth by a calibration of the archive."""
    config, request = CalibrationConfig(), GeometryPayload.make(CARRIERS, quiet_days=days).request
    calibrate_geometry(GeometryPayload.make(8, quiet_days=1.0).data(), config)
    with closing(SqlStorage(url)) as storage:

        def calibrate() -> None:
            jobs = _jobs(storage, JobKind.CALIBRATION, CalibrationWork(storage, config))
            _draft, job = Calibrator(storage, SystemClock(), jobs.notify, 1).start("yamal-test", request, "bench")
            while jobs.poll_once():
                pass
            assert storage.results.job(job.id).state is JobState.DONE, storage.results.job(job.id).error

        return growth_mb(calibrate)


# ---- replay


def fill_replay(url: str, rows: int) -> None:
    """Store an aligned spacecraft and rows of a minute."""
    payload, rng = FlightPayload.make(CARRIERS), np.random.default_rng(1)
    with closing(SqlStorage(url)) as storage:
        storage.prepare()
        storage.catalogue.add_spacecraft(payload.spacecraft())
        storage.catalogue.put_plan("yamal-test", payload.carriers(), "bench")
        storage.catalogue.put_ephemeris("yamal-test", payload.ephemeris())
        calibration = payload.calibration()
        request: CalibrationRequest = calibration.request
        draft = storage.results.add_calibration("yamal-test", request, 1, 1, 0, "bench")
        storage.results.finish_calibration("yamal-test", draft.id, calibration.result, None)
        storage.results.activate_calibration("yamal-test", draft.id)
        aligned_us = FLIGHT_US + HOUR
        for start_us in range(FLIGHT_US, aligned_us + rows * MINUTE, _AT_ONCE * MINUTE):
            stop_us = min(start_us + _AT_ONCE * MINUTE, aligned_us + rows * MINUTE)
            epochs_us = np.arange(start_us, stop_us, MINUTE)
            angles = np.zeros((len(epochs_us), 3))
            power_dbm = payload.power_dbm(epochs_us, angles) + 0.05 * rng.normal(size=(len(epochs_us), CARRIERS))
            _append(storage, "yamal-test", epochs_us, power_dbm)
            if start_us == FLIGHT_US:
                _refer(storage, "yamal-test", epochs_us[:60], angles[:60])
        sensors, window = ("star_tracker",) * 3, Window(FLIGHT_US, aligned_us)
        aligner = Aligner(storage, SystemClock(), AlignmentConfig())
        aligner.align("yamal-test", AlignmentRequest(window, sensors, None, None, "bench"))


def replay_mb(url: str, rows: int) -> float:
    """Return the growth by a replay of the archive."""
    with closing(SqlStorage(url)) as storage:
        config = ChainConfig()

        jobs = _jobs(storage, JobKind.REPLAY, partial(replay_work, storage, config))
        replayer = Replayer(storage, SystemClock(), jobs.notify)

        def replay(minutes: int) -> None:
            start_us = FLIGHT_US + HOUR
            wanted = Replay(
                0, start_us, start_us + minutes * MINUTE, Method.ROBUST, None, 0, "journal", "", 0, commands=False
            )
            _replay, job = replayer.start("yamal-test", wanted)
            while jobs.poll_once():
                pass
            assert storage.results.job(job.id).state is JobState.DONE, storage.results.job(job.id).error

        replay(300)
        return growth_mb(lambda: replay(rows))


def _append(storage: SqlStorage, spacecraft_id: str, epochs_us: np.ndarray, power_dbm: np.ndarray) -> None:
    batch = plain_batch(spacecraft_id, _RECEIVED_US, epochs_us, power_dbm)
    assert storage.archive.append_measurements(batch).result(timeout=600).accepted == len(epochs_us)


def _refer(storage: SqlStorage, spacecraft_id: str, epochs_us: np.ndarray, angles_deg: np.ndarray) -> None:
    sigma = Axes(0.005, 0.005, 0.005)
    rows = zip(epochs_us.tolist(), angles_deg.tolist(), strict=True)
    storage.archive.append_inputs(
        spacecraft_id, [AttitudeReference("star_tracker", epoch_us, Axes(*angles), sigma) for epoch_us, angles in rows]
    )


if __name__ == "__main__":
    sys.exit(0 if main() else 1)
