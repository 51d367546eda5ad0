"""A station whose spacecraft both methods follow, and a morning in which everything happens that a journal can tell."""

from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from geometry_flight import HOUR, MINUTE, START_US, FlightPayload
from set_clock import SetClock
from waiting import wait_until as wait_for

from db.results import jobs
from db.results.stored_rows import pack_carriers
from db.storage import SqlStorage
from service.pipeline.config import AlignmentConfig, CalibrationConfig, ChainConfig
from service.ports.archive import LIVE, ListPart
from service.records.calibration import Window
from service.records.catalogue import Method, Release
from service.records.inputs import AttitudeReference, Correction, Operation
from service.records.levels.attitude import Axes
from service.records.levels.measurement import MeasurementBatch
from service.records.operations.work import JobKind, JobState, Replay
from service.runtime.jobs.calibration import Aligner, AlignmentRequest, CalibrationWork
from service.runtime.jobs.job_runner import JobPieces, JobRunner
from service.runtime.jobs.replay import Replayer, replay_work
from service.runtime.live import supervisor
from service.runtime.live.live_feed import LiveFeed
from service.runtime.live.supervisor import Supervisor

PAYLOAD = FlightPayload.make(10)
SC = "yamal-test"
OPERATION_US = START_US + 2 * HOUR
NOISE_DB = 0.05
BOTH = (Method.ROBUST, Method.PAPER)


def at(minute):
    return OPERATION_US + round(minute * MINUTE)


def angles(minutes):
    """Return the true attitude (T, 3): a slow swing."""
    turn = 2.0 * np.pi * np.asarray(minutes, dtype=np.float64)[:, None] / 900.0
    return np.array([0.1, 0.06, -0.06]) * np.sin(turn + np.array([0.0, 1.0, 2.0]))


class Station:
    """The service's runtime over one archive with a calibration by geometry that knows the truth."""

    id = SC

    def __init__(self, directory, url=None):
        self.url = url or f"sqlite:///{directory / 'soo.db'}"
        self.storage = SqlStorage(self.url)
        self.clock, self.config = SetClock(1_900_000_000_000_000), ChainConfig()
        works = {
            JobKind.REPLAY: partial(replay_work, self.storage, self.config),
            JobKind.CALIBRATION: CalibrationWork(self.storage, CalibrationConfig()),
        }
        #: its thread is not started: `finish` does the pieces
        self.jobs = JobRunner(self.storage, self.clock, JobPieces(works).advance)
        self.replayer = Replayer(self.storage, self.clock, self.jobs.notify)
        self.aligner = Aligner(self.storage, self.clock, AlignmentConfig())

    def at(self, minute):
        """Return the epoch of a minute of operation."""
        return at(minute)

    def close(self):
        """Let go of everything."""
        self.jobs.stop()
        self.storage.close()

    def open(self):
        """Lay down catalogue, calibration and the half hour before operation."""
        self.storage.prepare()
        self.enter(PAYLOAD, PAYLOAD.spacecraft(release=Release.AUTOMATIC, coupling=True))
        self.calibrate(PAYLOAD.calibration())
        self.send(range(-30, 1))
        self.refer(range(-30, 1))

    def enter(self, payload, record):
        """Enter a spacecraft with the plan and the ephemeris of a payload."""
        self.storage.catalogue.add_spacecraft(record)
        self.storage.catalogue.put_plan(self.id, payload.carriers(), "sha")
        self.storage.catalogue.put_ephemeris(self.id, payload.ephemeris())

    def calibrate(self, calibration):
        request = calibration.request
        draft = self.storage.results.add_calibration(SC, request, 1, 1, 0, "engineer")
        self.storage.results.finish_calibration(SC, draft.id, calibration.result, None)
        self.storage.results.activate_calibration(SC, draft.id)

    def refer(self, minutes):
        sigma = Axes(0.01, 0.005, 0.005)
        reported = [AttitudeReference("st", at(k), Axes(*angles([k])[0]), sigma) for k in minutes]
        self.storage.archive.append_inputs(SC, reported)

    def align(self, start, stop):
        request = AlignmentRequest(Window(at(start), at(stop) + 1), ("st",) * 3, None, None, "operator")
        return self.aligner.align(SC, request)

    def powers(self, minutes):
        """Return powers (T, N), the noise of each minute its own."""
        noise = [np.random.default_rng(round(1000 * minute) + 100_000_000).normal(size=10) for minute in minutes]
        return PAYLOAD.power_dbm([at(minute) for minute in minutes], angles(minutes)) + NOISE_DB * np.array(noise)

    def send(self, minutes, power_dbm=None, **changes):
        """Send rows of some minutes and return the receipt."""
        minutes = list(minutes)
        power = self.powers(minutes) if power_dbm is None else power_dbm
        return self.append_rows([self.at(minute) for minute in minutes], power, **changes)

    def append_rows(self, epochs_us, power_dbm, **changes):
        """Send rows of given epochs and powers and return the receipt."""
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

    def tell(self, *records):
        return self.storage.archive.append_inputs(SC, records)

    @contextmanager
    def followed(self, storage=None, feed=None):
        """Run a supervisor, and end it."""
        self.supervisor = Supervisor(storage or self.storage, feed or LiveFeed(), self.config)
        self.supervisor.start()
        try:
            yield self.supervisor
        finally:
            self.supervisor.stop()

    @contextmanager
    def supervised(self):
        """Run a supervisor and give what lets it come to the end of the journal."""
        with self.followed() as supervisor:
            yield lambda: self.settle(supervisor)

    def settle(self, supervisor):
        """Tell that the journal grew and wait until all of it is consumed."""
        supervisor.notify(self.id)
        wait_for(self.is_settled)

    def is_settled(self):
        """Return whether the whole journal is consumed."""
        head = self.storage.archive.head(self.id)
        return head.consumed_number == head.newest_number

    def window(self, start, stop):
        return Window(self.at(start), self.at(stop))

    def rows(self, method, version=LIVE, start=1, stop=100_000):
        """Return the attitude rows of some minutes."""
        return self.storage.results.attitude_rows(self.id, version, method, ListPart(self.window(start, stop), 100_000))

    def carriers(self, method, version, start, stop):
        found = self.storage.results.carrier_results(SC, version, method, self.window(start, stop))
        return dict(zip(found, pack_carriers(list(found.values())), strict=True))

    def commands(self, version=LIVE, start=1, stop=100_000):
        """Return the commands of some minutes."""
        return self.storage.results.commands(self.id, version, ListPart(self.window(start, stop), 100_000))

    def finish(self, job_id):
        """Do jobs until one has ended, and return how it ended."""
        while (state := self.storage.results.job(job_id).state) not in (JobState.DONE, JobState.FAILED):
            assert self.jobs.poll_once()
        return state

    def replay(self, start, stop, **changes):
        """Replay some minutes and return the version."""
        wanted = Replay(0, self.at(start), self.at(stop), None, None, 0, "journal", "", 0)
        replay, job = self.replayer.start(self.id, replace(wanted, **changes))
        assert self.finish(job.id) is JobState.DONE, self.storage.results.job(job.id).error
        return replay.version


def morning(station):
    """Yield after each of some pieces of a morning; all that a piece tells stands in the journal.

    Rows that may be commanded come last in their piece: a service that looks meanwhile writes its commands behind them.
    """
    station.align(-30, 0)
    station.tell(Correction(at(10), at(30), Axes(0.0, 0.0, 0.0)), Correction(at(-20), at(20), Axes(0.02, 0.0, 0.0)))
    station.send([minute for minute in range(1, 25) if minute not in (7, 12)])
    yield
    station.send([7, 12])
    # one in time, one that is over, one within its interval
    station.tell(Correction(at(26), at(40), Axes(0.0, 0.02, 0.0)), Correction(at(15), at(20), Axes(0.0, 0.0, 0.01)))
    station.tell(Correction(at(20), at(44), Axes(0.0, 0.0, -0.01)))
    station.send(range(20, 40))
    yield
    faded = station.powers(range(40, 56))
    faded[:, 2] -= 5.0
    faded[4:7] = np.nan
    station.send(range(40, 56), faded)
    yield
    station.storage.archive.add_operation(SC, Operation(0, "momentum_unloading", at(58), at(64), inhibit_control=True))
    station.send(range(56, 70))
    yield
    station.storage.catalogue.put_ephemeris(SC, PAYLOAD.ephemeris(start_us=at(0) - HOUR // 2))
    other = replace(PAYLOAD, level_dbm=PAYLOAD.level_dbm + 0.1, gradient=1.02 * PAYLOAD.gradient)
    station.calibrate(other.calibration())
    record = station.storage.catalogue.spacecraft(SC)
    station.storage.catalogue.replace_spacecraft(replace(record, control=replace(record.control, damping=0.7)))
    station.send(range(70, 80))
    yield
    plan = station.storage.catalogue.put_plan(SC, PAYLOAD.carriers()[::-1], "turned round")
    station.send(range(80, 95), station.powers(range(80, 95))[:, ::-1], plan_id=plan.id)
    yield
    station.send(range(95, 97), source="sa-2")
    station.storage.archive.select_source(SC, "sa-2")
    station.send(range(97, 110), source="sa-2")
    yield
    station.refer(range(80, 105))
    station.tell(Correction(at(100), at(140), Axes(0.0, 0.0, 0.02)))
    station.align(80, 104)
    station.send(range(110, 130), source="sa-2")
    yield
    station.tell(Correction(at(90), at(120), Axes(0.01, 0.0, 0.0)))
    station.send([60.5, 96.5], source="sa-2")
    station.send(range(130, 140), source="sa-2")
    yield


def live_morning_of_states(directory):
    """Live a morning with a state of the chain after nearly every entry of the journal, all of them kept."""
    station = Station(directory)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(supervisor, "PERIOD_US", MINUTE)
        patch.setattr(supervisor, "_STEP_S", 0.0)
        patch.setattr(supervisor, "_ENTRIES_AT_ONCE", 3)
        patch.setattr(jobs, "LATEST", 1000)
        with station.supervised() as settle:
            for _ in morning(station):
                settle()
    station.close()


def everything(station, version):
    """Return all that a version holds, as text with every digit."""
    found = station.storage.results.replay(SC, version)
    carriers = [station.carriers(method, version, 0, 400) for method in BOTH]
    rows = [text(station.rows(method, version)) for method in BOTH]
    return found.attitude_rows, found.torque_rows, rows, text(station.commands(version)), carriers


def text(results):
    """Return results as text, which holds every digit of every float and tells NaN and -0.0."""
    return [repr(result) for result in results]
