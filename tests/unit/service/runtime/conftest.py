"""A spacecraft over a real archive: two quiet days and turns stored, calibrated and aligned, ready for operation.

The archive is prepared once and copied for each test. Powers of a minute are the same whenever they are made, so that
runs of the same day can be compared bit for bit.
"""

import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import synthetic_payload as synthetic
from alarm_rig import CARRIERS, INERTIA, Rig
from busy_station import Station, live_morning_of_states, morning, wait_for

from db.storage import SqlStorage
from service.ports.archive import LIVE
from service.records.calibration import Window
from service.records.catalogue import Method, Site, Spacecraft
from service.records.operations.work import JobState
from service.runtime.jobs.calibration import AlignmentRequest, Calibrator

NOISE_DB = 0.05
TRACKER = ("star_tracker",) * 3


class Ground(Station):
    """A station whose calibration is fitted, and which only the paper method follows."""

    def __init__(self, url: str, payload: Any) -> None:
        super().__init__(None, url)
        self.payload, self.synthetic = payload, synthetic
        self.calibrator = Calibrator(self.storage, self.clock, self.jobs.notify, 8)
        self.operation_us = payload.request.turns.stop_us + synthetic.HOUR
        self.alignment_window = Window(self.operation_us - 30 * synthetic.MINUTE, self.operation_us)

    def at(self, minute: int) -> int:
        """Return the epoch of a minute of operation."""
        return int(self.operation_us + minute * synthetic.MINUTE)

    def angles(self, minutes: Sequence[int]) -> np.ndarray:
        """Return the true attitude (T, 3): a slow swing about all axes."""
        turn = 2.0 * np.pi * np.asarray(minutes)[:, None] / 180.0
        return np.array([0.2, 0.15, -0.15]) * np.sin(turn + np.array([0.0, 1.0, 2.0]))

    def powers(self, minutes: Sequence[int]) -> np.ndarray:
        """Return powers (T, N), the noise of each minute its own."""
        epochs_us = np.array([self.at(minute) for minute in minutes])
        noise = np.array([np.random.default_rng(minute + 10_000).normal(size=12) for minute in minutes])
        return np.asarray(self.payload.power_dbm(epochs_us, self.angles(minutes)) + NOISE_DB * noise)

    append, supervised = Station.send, Station.followed

    def calibrate(self) -> int:
        """Calibrate and activate; return the number of the calibration."""
        draft, job = self.calibrator.start(self.id, self.payload.request, "engineer")
        assert self.finish(job.id) is JobState.DONE, self.storage.results.job(job.id).error
        return self.calibrator.activate(self.id, draft.id).id

    def align(self) -> Any:
        """Align to the star tracker over the window of the alignment."""
        return self.aligner.align(self.id, AlignmentRequest(self.alignment_window, TRACKER, None, None, "operator"))

    def rows(self, version: str = LIVE, start: int = 1, stop: int = 100_000) -> list[Any]:
        """Return the attitude rows of some minutes."""
        return super().rows(Method.PAPER, version, start, stop)


def _prepare(url: str, payload: Any) -> None:
    """Store quiet days, turns and the minutes before operation; calibrate and activate."""
    ground = Ground(url, payload)
    ground.storage.prepare()
    ground.enter(payload, payload.spacecraft())
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


@pytest.fixture(scope="session")
def _prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Directory of an archive that is calibrated but not aligned."""
    directory = tmp_path_factory.mktemp("prepared")
    _prepare(f"sqlite:///{directory / 'soo.db'}", synthetic.SyntheticPayload.make())
    return directory


@pytest.fixture
def new_ground(_prepared: Path, tmp_path: Path, payload: Any) -> Iterator[Callable[[], Ground]]:
    """Return a maker of stations over copies of the prepared archive, calibrated but not aligned."""
    made: list[Ground] = []

    def make() -> Ground:
        directory = tmp_path / f"archive-{len(made)}"
        shutil.copytree(_prepared, directory)
        made.append(Ground(f"sqlite:///{directory / 'soo.db'}", payload))
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
