"""Live operation, restart and replay with both methods: the same rows bit for bit, commanded motion included."""

import math
import shutil
import time
from contextlib import contextmanager
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest
from geometry_flight import HOUR, MINUTE, START_US, FlightPayload

from db.storage import SqlStorage
from service.core.control.quaternion_law import GEOSTATIONARY_RATE_RAD_S
from service.errors import InvalidInputError
from service.pipeline.config import AlignmentConfig, ChainConfig
from service.ports import LIVE
from service.records.calibration import CalibrationMethod, Window
from service.records.catalogue import ControlLaw, GyroOrbitantGains, Method, Release
from service.records.inputs import AttitudeReference, Correction, Operation, PlanChange, TelemetryRecord
from service.records.journal import JournalEntry
from service.records.levels.attitude import Axes
from service.records.levels.command import AppliedCommand
from service.records.levels.measurement import MeasurementBatch
from service.records.operations.job import JobState, Replay
from service.runtime.jobs.alignment_service import Aligner, AlignmentRequest
from service.runtime.jobs.job_runner import JobRunner
from service.runtime.jobs.replay_job import Replayer
from service.runtime.live.journal_consumer import update_before
from service.runtime.live.live_feed import LiveFeed
from service.runtime.live.supervisor import Supervisor

PAYLOAD = FlightPayload.make(10)
SC = "yamal-test"
OPERATION_US = START_US + 2 * HOUR
NOISE_DB = 0.05
BOTH = (Method.ROBUST, Method.PAPER)


def wait_for(is_done, timeout_s=120.0):
    deadline = time.monotonic() + timeout_s
    while not is_done():
        assert time.monotonic() < deadline, "did not happen in time"
        time.sleep(0.005)


def at(minute):
    return OPERATION_US + round(minute * MINUTE)


def angles(minutes):
    """Return the true attitude (T, 3): a slow swing."""
    turn = 2.0 * np.pi * np.asarray(minutes, dtype=np.float64)[:, None] / 900.0
    return np.array([0.1, 0.06, -0.06]) * np.sin(turn + np.array([0.0, 1.0, 2.0]))


class Station:
    """The service's runtime over one archive with a calibration by geometry that knows the truth."""

    def __init__(self, directory):
        self.storage = SqlStorage(f"sqlite:///{directory / 'soo.db'}")
        self.jobs = JobRunner(self.storage.results, self)
        self.replayer = Replayer(self.storage, self, self.jobs, ChainConfig())
        self.aligner = Aligner(self.storage, self, AlignmentConfig())

    def system_us(self):
        return 1_900_000_000_000_000

    def close(self):
        self.jobs.stop()
        self.storage.close()

    def open(self):
        """Lay down catalogue, calibration and the half hour before operation."""
        self.storage.migrate()
        record = PAYLOAD.spacecraft(release=Release.AUTOMATIC, coupling=True)
        self.storage.catalogue.add_spacecraft(record)
        self.storage.catalogue.put_plan(SC, PAYLOAD.carriers(), "sha")
        self.storage.catalogue.put_ephemeris(SC, PAYLOAD.ephemeris())
        self.calibrate(PAYLOAD.calibration())
        self.send(range(-30, 1))
        self.refer(range(-30, 1))

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
        minutes = list(minutes)
        power = self.powers(minutes) if power_dbm is None else power_dbm
        batch = MeasurementBatch(
            SC,
            "sa-1",
            1,
            at(10_000),
            np.arange(len(minutes)),
            np.array([at(minute) for minute in minutes], dtype=np.int64),
            np.asarray(power, dtype=np.float32),
            (None,) * len(minutes),
            np.zeros(len(minutes), dtype=bool),
        )
        return self.storage.archive.append_measurements(replace(batch, **changes)).result(timeout=120)

    def tell(self, *records):
        return self.storage.archive.append_inputs(SC, records)

    @contextmanager
    def supervised(self):
        supervisor = Supervisor(self.storage, LiveFeed(), ChainConfig())
        supervisor.start()
        try:
            yield lambda: self.settle(supervisor)
        finally:
            supervisor.stop()

    def settle(self, supervisor):
        supervisor.notify(SC)
        wait_for(self.is_settled)

    def is_settled(self):
        head = self.storage.archive.head(SC)
        return head.consumed_number == head.newest_number

    def rows(self, method, version=LIVE, start=1, stop=100_000):
        window = Window(at(start), at(stop))
        return self.storage.results.attitude_rows(SC, version, method, window, 100_000, None)

    def commands(self, version=LIVE, start=1, stop=100_000):
        return self.storage.results.commands(SC, version, Window(at(start), at(stop)), 100_000, None)

    def replay(self, start, stop, **changes):
        wanted = Replay(0, at(start), at(stop), None, None, 0, "journal", "", 0)
        replay, job = self.replayer.start(SC, replace(wanted, **changes))
        wait_for(lambda: self.storage.results.job(job.id).state in (JobState.DONE, JobState.FAILED))
        assert self.storage.results.job(job.id).error is None
        return replay.version


def morning(station):
    """Yield after each of some pieces of a morning; all that a piece tells stands in the journal."""
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
    station.storage.archive.add_operation(SC, Operation(0, "momentum_unloading", at(58), at(64), inhibit_control=True))
    station.send(range(56, 70))
    yield
    station.storage.catalogue.put_ephemeris(SC, PAYLOAD.ephemeris(start_us=at(0) - HOUR // 2))
    other = replace(PAYLOAD, level_dbm=PAYLOAD.level_dbm + 0.1, gradient=1.02 * PAYLOAD.gradient)
    station.calibrate(other.calibration())
    station.send(range(70, 80))
    yield
    plan = station.storage.catalogue.put_plan(SC, PAYLOAD.carriers()[::-1], "turned round")
    station.send(range(80, 95), station.powers(range(80, 95))[:, ::-1], plan_id=plan.id)
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


@pytest.fixture(scope="module")
def opened_archive(tmp_path_factory):
    """Directory of an archive with a calibration and no alignment."""
    directory = tmp_path_factory.mktemp("opened")
    station = Station(directory)
    station.open()
    station.close()
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
def lived(lived_archive, new_station):
    """A station after the morning."""
    return new_station(lived_archive)


def text(results):
    """Return results as text, which holds every digit of every float and tells NaN and -0.0."""
    return [repr(result) for result in results]


def test_the_morning_holds_what_its_pieces_promise(lived):
    robust, paper = lived.rows(Method.ROBUST), lived.rows(Method.PAPER)
    assert [row.epoch_us for row in robust] == [row.epoch_us for row in paper]
    reasons = {reason for row in robust for reason in row.inhibitions}
    assert {"late", "redundancy", "operation", "chain_step"} <= reasons
    assert {row.calibration_id for row in robust} == {1, 2}
    assert {row.alignment_id for row in robust} == {1, 2}
    assert any(item.carrier == "c02" for row in robust for item in row.excluded)
    entries = lived.storage.archive.journal(SC, 0, 10_000)
    applied = [entry for entry in entries if isinstance(entry.content, AppliedCommand)]
    assert any(entry.content.command.schedule for entry in applied)
    controlled = [row for row in robust if row.control_allowed]
    assert len(controlled) > 60


@pytest.mark.parametrize(
    ("start", "stop"),
    [
        pytest.param(1, 300, id="the whole morning"),
        pytest.param(33, 75, id="from the middle"),
        pytest.param(112, 135, id="rows of the second alignment only"),
    ],
)
def test_a_replay_in_the_order_of_the_journal_is_the_live_run_bit_for_bit(lived, start, stop):
    version = lived.replay(start, stop)
    for method in BOTH:
        live = lived.rows(method, start=start, stop=stop)
        assert len(live) > 15
        assert text(lived.rows(method, version, start, stop)) == text(live)
    assert text(lived.commands(version, start, stop)) == text(lived.commands(start=start, stop=stop))


@pytest.mark.parametrize("method", BOTH, ids=str)
def test_a_replay_of_one_method_is_that_methods_live_run(lived, method):
    version = lived.replay(1, 300, method=method)
    assert text(lived.rows(method, version)) == text(lived.rows(method))
    other = next(one for one in BOTH if one is not method)
    assert lived.rows(other, version) == []
    # the robust method drives control
    assert (lived.commands(version) == []) == (method is Method.PAPER)


def test_in_order_of_epoch_late_rows_stand_in_their_place(lived):
    version = lived.replay(1, 300, order="epoch", alignment_id=1)
    for method in BOTH:
        rows = lived.rows(method, version)
        assert [row.epoch_us for row in rows] == sorted(row.epoch_us for row in rows)
        assert not any("late" in row.inhibitions for row in rows)
        assert {row.alignment_id for row in rows} == {1}
        assert {row.calibration_id for row in rows} == {2}


def test_with_the_first_calibration_its_figures_hold_throughout(lived):
    rows = lived.rows(Method.ROBUST, lived.replay(1, 300, calibration_id=1, alignment_id=1))
    assert {row.calibration_id for row in rows} == {1}
    assert {row.alignment_id for row in rows} == {1}


def test_a_restart_after_each_piece_changes_no_row(lived_archive, opened_archive, new_station):
    through, broken = new_station(lived_archive), new_station(opened_archive)
    chunks = morning(broken)
    is_over = False
    while not is_over:
        with broken.supervised() as settle:
            is_over = next(chunks, chunks) is chunks
            settle()
    for method in BOTH:
        assert text(broken.rows(method)) == text(through.rows(method))
    assert text(broken.commands()) == text(through.commands())


def test_commanded_motion_is_read_in_pages(lived, monkeypatch):
    monkeypatch.setattr("service.runtime.live.journal_consumer._INPUTS_AT_ONCE", 3)
    version = lived.replay(112, 135)
    live = lived.rows(Method.ROBUST, start=112, stop=135)
    assert text(lived.rows(Method.ROBUST, version)) == text(live)


def test_pages_of_anything_but_commanded_motion_are_refused(monkeypatch):
    monkeypatch.setattr("service.runtime.live.journal_consumer._INPUTS_AT_ONCE", 1)
    archive = Mock()
    archive.slow_inputs_before.return_value = []
    archive.inputs.return_value = [JournalEntry(7, PlanChange(1))]
    with pytest.raises(TypeError, match="journal entry 7 is no commanded motion"):
        update_before(Mock(), archive, SC, 50, 0)


def test_what_telemetry_told_before_an_alignment_holds_after_a_restart_and_in_a_replay(opened_archive, new_station):
    """Rates of the body and momenta of the wheels: commands of the gyro-orbitant law to the last bit."""
    station = new_station(opened_archive)
    record, rate = station.storage.catalogue.spacecraft(SC), Axes(1e-5, -2e-5, -math.degrees(GEOSTATIONARY_RATE_RAD_S))
    gains = GyroOrbitantGains(0.02, 6.0, 0.01, 3.0, 2e-3, 6.0)
    control = replace(record.control, law=ControlLaw.GYRO_ORBITANT, gyro_orbitant=gains)
    station.storage.catalogue.replace_spacecraft(replace(record, control=control))
    station.tell(TelemetryRecord(at(0), wheel_momentum_n_m_s=(1.0, 0.5, 0.2), body_rate_deg_s=rate))
    station.align(-30, 0)
    for minutes in (range(1, 3), range(3, 8)):
        station.send(minutes)
        with station.supervised() as settle:
            settle()
    live = station.commands()
    assert [command.inhibitions for command in live] == [()] * 3 + [("no_body_rate",)] * 4
    assert live[2].schedule
    assert text(station.commands(station.replay(1, 8))) == text(live)


def test_before_an_alignment_rows_say_why_they_have_no_angles(opened_archive, new_station):
    station = new_station(opened_archive)
    with station.supervised() as settle:
        station.send(range(1, 5))
        settle()
    for method in BOTH:
        assert {row.inhibitions for row in station.rows(method)} == {("not_aligned",)}


def test_a_calibration_by_geometry_after_the_alignment_waits_for_the_next_one(tmp_path):
    station = Station(tmp_path)
    station.storage.migrate()
    station.storage.catalogue.add_spacecraft(PAYLOAD.spacecraft())
    station.storage.catalogue.put_plan(SC, PAYLOAD.carriers(), "sha")
    station.storage.catalogue.put_ephemeris(SC, PAYLOAD.ephemeris())
    plain = PAYLOAD.calibration()
    request = replace(plain.request, method=CalibrationMethod.PAPER)
    station.calibrate(replace(plain, request=request, result=replace(plain.result, geometry=None)))
    station.send(range(-30, 1))
    station.refer(range(-30, 1))
    station.align(-30, 0)
    with station.supervised() as settle:
        station.send(range(1, 11))
        settle()
        station.calibrate(plain)
        station.send(range(11, 21))
        settle()
        rows = station.rows(Method.ROBUST)
        assert [row.inhibitions for row in rows] == [("no_calibration",)] * 10 + [("not_aligned",)] * 10
        assert [command.inhibitions for command in station.commands()] == [row.inhibitions for row in rows]
        assert {row.calibration_id for row in station.rows(Method.PAPER)} == {1}
        station.refer(range(5, 21))
        station.align(5, 20)
        station.send(range(21, 25))
        settle()
        assert all(row.attitude_deg.roll == row.attitude_deg.roll for row in station.rows(Method.ROBUST, start=21))
        assert {row.calibration_id for row in station.rows(Method.ROBUST, start=21)} == {2}
    station.close()


def test_a_window_that_the_track_does_not_reach_is_refused_with_the_reason(opened_archive, new_station):
    station = new_station(opened_archive)
    station.storage.catalogue.put_ephemeris(SC, PAYLOAD.ephemeris(start_us=at(600)))
    with pytest.raises(
        InvalidInputError, match=r"the ephemeris reaches from .* send one that covers the window"
    ) as caught:
        station.align(-30, 0)
    assert caught.value.code == "alignment.no_powers"
