"""A spacecraft over a real archive: two quiet days and turns stored, calibrated and aligned, ready for operation.

The archive is prepared once and copied for each test. Powers of a minute are the same whenever they are made, so that
runs of the same day can be compared bit for bit.
"""

import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic_payload as synthetic
from alarm_rig import CARRIERS, INERTIA, Rig
from busy_station import Station, live_morning_of_states, morning
from set_clock import SetClock

from db.storage import SqlStorage
from service.pipeline.config import AlignmentConfig, CalibrationConfig, ChainConfig
from service.ports import LIVE
from service.records.calibration import Window
from service.records.catalogue import Method, Site, Spacecraft
from service.records.inputs import Operation
from service.records.levels.measurement import BatchReceipt, MeasurementBatch
from service.records.operations.work import JobState, Replay
from service.runtime.jobs.alignment_service import Aligner, AlignmentRequest
from service.runtime.jobs.calibration_job import Calibrator, fitted
from service.runtime.jobs.job_runner import JobRunner
from service.runtime.jobs.replay_job import Replayer
from service.runtime.jobs.replay_run import ReplayRun
from service.runtime.live.live_feed import LiveFeed
from service.runtime.live.supervisor import Supervisor

NOISE_DB = 0.05
TRACKER = ("star_tracker",) * 3


def wait_for(is_done: Callable[[], bool], timeout_s: float = 120.0) -> None:
    """Wait until a condition holds."""
    deadline = time.monotonic() + timeout_s
    while not is_done():
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(0.005)


class Ground:
    """The service's runtime over one archive, and short words for what a station and an operator do."""

    def __init__(self, url: str, payload: Any, synthetic: Any) -> None:
        self.payload, self.synthetic, self.id = payload, synthetic, synthetic.SC
        self.storage = SqlStorage(url)
        self.clock = SetClock(1_900_000_000_000_000)
        self.config = ChainConfig()
        self.jobs = JobRunner(self.storage.results, self.clock)
        self.calibrator = Calibrator(self.storage, self.clock, self.jobs, partial(fitted, CalibrationConfig()), 8)
        self.aligner = Aligner(self.storage, self.clock, AlignmentConfig())
        self.replayer = Replayer(self.storage, self.clock, self.jobs, self.run_replay)
        self.operation_us = payload.request.turns.stop_us + synthetic.HOUR
        self.alignment_window = Window(self.operation_us - 30 * synthetic.MINUTE, self.operation_us)

    def close(self) -> None:
        """Let go of everything."""
        self.jobs.stop()
        self.storage.close()

    # ---- what a station sends

    def at(self, minute: int) -> int:
        """Return the epoch of a minute of operation."""
        return int(self.operation_us + minute * self.synthetic.MINUTE)

    def angles(self, minutes: Sequence[int]) -> np.ndarray:
        """Return the true attitude (T, 3): a slow swing about all axes."""
        turn = 2.0 * np.pi * np.asarray(minutes)[:, None] / 180.0
        return np.array([0.2, 0.15, -0.15]) * np.sin(turn + np.array([0.0, 1.0, 2.0]))

    def powers(self, minutes: Sequence[int]) -> np.ndarray:
        """Return powers (T, N), the noise of each minute its own."""
        epochs_us = np.array([self.at(minute) for minute in minutes])
        noise = np.array([np.random.default_rng(minute + 10_000).normal(size=12) for minute in minutes])
        return np.asarray(self.payload.power_dbm(epochs_us, self.angles(minutes)) + NOISE_DB * noise)

    def append(self, minutes: Sequence[int], **changes: Any) -> BatchReceipt:
        """Send rows and return the receipt."""
        epochs_us = [self.at(minute) for minute in minutes]
        return self.append_rows(epochs_us, self.powers(minutes), **changes)

    def append_rows(self, epochs_us: Any, power_dbm: Any, **changes: Any) -> BatchReceipt:
        """Send rows of given powers and return the receipt."""
        rows = len(epochs_us)
        batch = MeasurementBatch(
            self.id,
            "sa-1",
            1,
            self.at(10_000),
            np.arange(rows),
            np.asarray(epochs_us, dtype=np.int64),
            np.asarray(power_dbm, dtype=np.float32),
            (None,) * rows,
            np.zeros(rows, dtype=bool),
        )
        return self.storage.archive.append_measurements(replace(batch, **changes)).result(timeout=120)

    # ---- what an operator does

    def finish(self, job_id: str) -> JobState:
        """Wait for a job and return how it ended."""
        wait_for(lambda: self.storage.results.job(job_id).state in (JobState.DONE, JobState.FAILED))
        return self.storage.results.job(job_id).state

    def calibrate(self) -> int:
        """Calibrate and activate; return the number of the calibration."""
        draft, job = self.calibrator.start(self.id, self.payload.request, "engineer")
        assert self.finish(job.id) is JobState.DONE, self.storage.results.job(job.id).error
        return self.calibrator.activate(self.id, draft.id).id

    def align(self, window: Window | None = None) -> Any:
        """Align to the star tracker over a window."""
        request = AlignmentRequest(window or self.alignment_window, TRACKER, None, None, "operator")
        return self.aligner.align(self.id, request)

    def replay(self, start: int, stop: int, **changes: Any) -> str:
        """Replay some minutes and return the version."""
        wanted = Replay(0, self.at(start), self.at(stop), None, None, 0, "journal", "", 0)
        replay, job = self.replayer.start(self.id, replace(wanted, **changes))
        assert self.finish(job.id) is JobState.DONE, self.storage.results.job(job.id).error
        return replay.version

    def run_replay(self, spacecraft_id: str, version: str, report: Any) -> None:
        """Run a replay, in a thread."""
        ReplayRun(self.storage, self.config, spacecraft_id, version).run(report)

    # ---- the service

    @contextmanager
    def supervised(self, storage: Any = None, feed: LiveFeed | None = None) -> Iterator[Supervisor]:
        """Run a supervisor, and end it."""
        supervisor = Supervisor(storage or self.storage, feed or LiveFeed(), self.config)
        supervisor.start()
        try:
            yield supervisor
        finally:
            supervisor.stop()

    def settle(self, supervisor: Supervisor) -> None:
        """Tell that the journal grew and wait until all of it is consumed."""
        supervisor.notify(self.id)
        wait_for(self.is_settled)

    def is_settled(self) -> bool:
        """Whether the whole journal is consumed."""
        head = self.storage.archive.head(self.id)
        return head.consumed_number == head.newest_number

    def rows(self, version: str = LIVE, start: int = 1, stop: int = 100_000) -> list[Any]:
        """Return the attitude rows of some minutes."""
        window = Window(self.at(start), self.at(stop))
        return self.storage.results.attitude_rows(self.id, version, Method.PAPER, window, 100_000, None)

    def commands(self, version: str = LIVE, start: int = 1, stop: int = 100_000) -> list[Any]:
        """Return the commands of some minutes."""
        window = Window(self.at(start), self.at(stop))
        return self.storage.results.commands(self.id, version, window, 100_000, None)


def _prepare(url: str, payload: Any, synthetic: Any) -> None:
    """Store quiet days, turns and the minutes before operation; calibrate and activate."""
    storage = SqlStorage(url)
    storage.prepare()
    storage.catalogue.add_spacecraft(payload.spacecraft())
    storage.catalogue.put_plan(synthetic.SC, payload.carriers(), "sha")
    storage.catalogue.put_ephemeris(synthetic.SC, payload.ephemeris())
    storage.close()
    ground = Ground(url, payload, synthetic)
    data = payload.calibration_input(NOISE_DB)
    for series in (data.quiet, data.turns):
        assert ground.append_rows(series.epochs_us, series.power_dbm).accepted == len(series.epochs_us)
    still = np.arange(-35, 1)
    epochs_us = np.array([ground.at(minute) for minute in still])
    ground.append_rows(epochs_us, payload.power_dbm(epochs_us, np.zeros(3), noise_db=NOISE_DB, seed=3))
    tracked = (data.references[0], payload.references(ground.alignment_window, np.zeros(3)))
    for series in tracked:
        ground.storage.archive.append_inputs(ground.id, synthetic.reference_records(series))
    ground.calibrate()
    ground.close()


def _live_day(ground: Ground) -> None:
    """Run a day in which much happens: late and doubled rows, gaps, holes, changes of everything, a new alignment."""
    storage = ground.storage
    with ground.supervised() as supervisor:
        ground.append([minute for minute in range(1, 51) if minute not in (20, 33)])
        ground.settle(supervisor)
        ground.append([20, 33])
        ground.append(range(40, 56))
        ground.settle(supervisor)
        powers = ground.powers(range(56, 70))
        powers[3:6] = np.nan
        powers[:, 2] -= 6.0
        ground.append_rows([ground.at(minute) for minute in range(56, 70)], powers)
        operation = Operation(0, "eclipse", ground.at(72), ground.at(80), inhibit_control=True)
        storage.archive.add_operation(ground.id, operation)
        ground.append(range(70, 86))
        ground.settle(supervisor)
        ground.calibrate()
        record = storage.catalogue.spacecraft(ground.id)
        storage.catalogue.replace_spacecraft(replace(record, control=replace(record.control, damping=0.7)))
        plan = storage.catalogue.put_plan(ground.id, ground.payload.carriers()[::-1], "turned round")
        minutes = range(130, 161)
        turned = ground.powers(minutes)[:, ::-1]
        ground.append_rows([ground.at(minute) for minute in minutes], turned, plan_id=plan.id)
        ground.settle(supervisor)
        ground.align()
        ground.append(range(161, 200))
        ground.settle(supervisor)
        ground.append([100, 150])
        ground.append(range(200, 220), source="sa-2")
        ground.settle(supervisor)


@pytest.fixture(scope="session")
def _prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory of an archive that is calibrated but not aligned."""
    directory = tmp_path_factory.mktemp("prepared")
    _prepare(f"sqlite:///{directory / 'soo.db'}", synthetic.SyntheticPayload.make(), synthetic)
    return directory


@pytest.fixture
def new_ground(_prepared: Path, tmp_path: Path, payload: Any) -> Iterator[Callable[[], Ground]]:
    """Return a maker of stations over copies of the prepared archive, calibrated but not aligned."""
    made: list[Ground] = []

    def make() -> Ground:
        directory = tmp_path / f"archive-{len(made)}"
        shutil.copytree(_prepared, directory)
        made.append(Ground(f"sqlite:///{directory / 'soo.db'}", payload, synthetic))
        return made[-1]

    yield make
    for ground in made:
        ground.close()


@pytest.fixture
def ground(new_ground: Callable[[], Ground]) -> Ground:
    """One station, calibrated and aligned."""
    made = new_ground()
    made.align()
    return made


@pytest.fixture(scope="session")
def _lived(_prepared: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory of an archive in which a day of operation was lived."""
    directory = tmp_path_factory.mktemp("day") / "archive"
    shutil.copytree(_prepared, directory)
    ground = Ground(f"sqlite:///{directory / 'soo.db'}", synthetic.SyntheticPayload.make(), synthetic)
    ground.align()
    _live_day(ground)
    ground.close()
    return directory


@pytest.fixture
def lived(_lived: Path, tmp_path: Path, payload: Any) -> Iterator[Ground]:
    """One station after a day in which much happened."""
    shutil.copytree(_lived, tmp_path / "lived")
    ground = Ground(f"sqlite:///{tmp_path / 'lived' / 'soo.db'}", payload, synthetic)
    yield ground
    ground.close()


@pytest.fixture
def wait() -> Callable[..., None]:
    """Return what waits until a condition holds."""
    return wait_for


@pytest.fixture(scope="module")
def alarm_archive(tmp_path_factory):
    """An archive with one spacecraft; every test gets a copy."""
    path = tmp_path_factory.mktemp("archive") / "soo.db"
    storage = SqlStorage(f"sqlite:///{path}")
    storage.prepare()
    storage.catalogue.add_spacecraft(Spacecraft("craft", "craft", 90.0, Site(55.0, 38.0), INERTIA, 0.05))
    storage.catalogue.put_plan("craft", CARRIERS, "sha")
    storage.close()
    return path


@pytest.fixture
def rig(alarm_archive, tmp_path):
    shutil.copy(alarm_archive, tmp_path / "soo.db")
    rig = Rig(tmp_path / "soo.db")
    yield rig
    rig.storage.close()


@pytest.fixture(scope="module")
def opened_archive(tmp_path_factory):
    """Directory of an archive with a calibration and no alignment."""
    directory = tmp_path_factory.mktemp("opened")
    station = Station(directory)
    station.open()
    station.close()
    return directory


@pytest.fixture(scope="module")
def archive_of_states(opened_archive, tmp_path_factory):
    """Directory of an archive in which a morning was lived, with a state of the chain after nearly every entry."""
    directory = tmp_path_factory.mktemp("states") / "archive"
    shutil.copytree(opened_archive, directory)
    live_morning_of_states(directory)
    return directory


@pytest.fixture(scope="module")
def lived_archive(opened_archive, tmp_path_factory):
    """Directory of an archive in which a morning was lived."""
    directory = tmp_path_factory.mktemp("lived") / "archive"
    shutil.copytree(opened_archive, directory)
    station = Station(directory)
    with station.supervised() as settle:
        for _ in morning(station):
            settle()
    station.close()
    return directory


@pytest.fixture
def new_station(tmp_path):
    """Maker of stations over copies of an archive."""
    made = []

    def make(directory):
        copy = tmp_path / f"copy-{len(made)}"
        shutil.copytree(directory, copy)
        made.append(Station(copy))
        return made[-1]

    yield make
    for station in made:
        station.close()


@pytest.fixture
def busy(lived_archive, new_station):
    """A station after the morning."""
    return new_station(lived_archive)
