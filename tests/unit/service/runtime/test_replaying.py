"""Live operation, restart, restored archives and replays: the same rows bit for bit."""

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from busy_station import BOTH, PAYLOAD, SC, Station, at, text

from db.maintenance.backup import create_backup, restore_backup, verify_backup
from service.core.control.quaternion_law import GEOSTATIONARY_RATE_RAD_S
from service.errors import InvalidInputError
from service.pipeline.config import ChainConfig
from service.ports.archive import LIVE
from service.records.calibration import CalibrationMethod
from service.records.catalogue import BodyRateSensor, ControlLaw, GyroOrbitantGains, Method, Polarimeter, WheelMomentum
from service.records.inputs import PolarizationRecord, TelemetryRecord
from service.records.levels.attitude import AppliedCommand, Axes
from service.records.operations.work import Replay
from service.records.storage import worst
from service.runtime.jobs import replay as replay_run
from service.runtime.jobs.replay import ReplayRun

RATE_ERRORS = {"bias_deg_h": 0.01, "bias_tau_h": 8.0, "noise_deg_sqrt_h": 0.003}


def test_the_morning_holds_what_its_pieces_promise(busy):
    robust, paper = busy.rows(Method.ROBUST), busy.rows(Method.PAPER)
    assert [row.epoch_us for row in robust] == [row.epoch_us for row in paper]
    reasons = {reason for row in robust for reason in row.inhibitions}
    assert {"late", "redundancy", "operation", "chain_step"} <= reasons
    assert {row.calibration_id for row in robust} == {1, 2}
    assert {row.alignment_id for row in robust} == {1, 2}
    assert any(item.carrier == "c02" for row in robust for item in row.excluded)
    entries = busy.storage.archive.journal(SC, 0, 10_000)
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
def test_a_replay_in_the_order_of_the_journal_is_the_live_run_bit_for_bit(busy, start, stop):
    version = busy.replay(start, stop)
    for method in BOTH:
        live = busy.rows(method, start=start, stop=stop)
        assert len(live) > 15
        assert text(busy.rows(method, version, start, stop)) == text(live)
    assert text(busy.commands(version, start, stop)) == text(busy.commands(start=start, stop=stop))


@pytest.mark.parametrize("method", BOTH, ids=str)
def test_a_replay_of_one_method_is_that_methods_live_run(busy, method):
    version = busy.replay(1, 300, method=method)
    assert text(busy.rows(method, version)) == text(busy.rows(method))
    other = next(one for one in BOTH if one is not method)
    assert busy.rows(other, version) == []
    # the robust method drives control
    assert (busy.commands(version) == []) == (method is Method.PAPER)


def test_a_replay_without_torques_has_the_same_angles(busy):
    version = busy.replay(1, 140, commands=False)
    for method in BOTH:
        assert text(busy.rows(method, version)) == text(busy.rows(method))
    assert busy.commands(version) == []
    assert busy.commands()


def test_in_order_of_epoch_late_rows_stand_in_their_place(busy):
    version = busy.replay(1, 300, order="epoch", alignment_id=1)
    for method in BOTH:
        rows = busy.rows(method, version)
        assert [row.epoch_us for row in rows] == sorted(row.epoch_us for row in rows)
        assert not any("late" in row.inhibitions for row in rows)
        assert {row.alignment_id for row in rows} == {1}
        assert {row.calibration_id for row in rows} == {2}


def test_with_the_first_calibration_its_figures_hold_throughout(busy):
    rows = busy.rows(Method.ROBUST, busy.replay(1, 300, calibration_id=1, alignment_id=1))
    assert {row.calibration_id for row in rows} == {1}
    assert {row.alignment_id for row in rows} == {1}


def test_commanded_motion_is_read_in_pages(busy, monkeypatch):
    monkeypatch.setattr("service.runtime.live.journal_consumer._INPUTS_AT_ONCE", 3)
    version = busy.replay(112, 135)
    live = busy.rows(Method.ROBUST, start=112, stop=135)
    assert text(busy.rows(Method.ROBUST, version)) == text(live)


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


def test_a_calibration_by_geometry_after_the_alignment_waits_for_the_next_one(tmp_path):
    station = Station(tmp_path)
    station.storage.prepare()
    station.enter(PAYLOAD, PAYLOAD.spacecraft())
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
    with pytest.raises(InvalidInputError, match=r"the ephemeris reaches from") as caught:
        station.align(-30, 0)
    assert caught.value.code == "alignment.no_powers"


def sensed(minutes: Sequence[int]) -> list[tuple[TelemetryRecord, PolarizationRecord]]:
    """Return what wheels, rate sensor and polarimeter tell of a spacecraft that stands still, a minute each."""
    told = []
    for minute in minutes:
        noise, turn = np.random.default_rng(minute).normal(size=7).tolist(), GEOSTATIONARY_RATE_RAD_S * 60.0 * minute
        momentum = 0.4 * math.cos(turn) + 0.01 * noise[0], -8.0 + 0.01 * noise[1], -0.4 * math.sin(turn)
        rate = Axes(*(1e-6 * one for one in noise[2:4]), 1e-6 * noise[4] - math.degrees(GEOSTATIONARY_RATE_RAD_S))
        record = TelemetryRecord(at(minute), wheel_momentum_n_m_s=momentum, body_rate_deg_s=rate)
        told.append((record, PolarizationRecord("pol", at(minute), angle_deg=0.07 * noise[6], sigma_deg=0.07)))
    return told


@pytest.mark.slow
def test_measured_motion_is_the_same_live_after_restarts_and_in_a_replay(opened_archive, new_station):
    """Momentum of the wheels, rates beside the loop and a polarimeter: every row to the last bit."""
    station = new_station(opened_archive)
    record = station.storage.catalogue.spacecraft(SC)
    onboard = replace(
        record.onboard, momentum=WheelMomentum(), rate_sensor=BodyRateSensor(in_loop=False, **RATE_ERRORS)
    )
    polarimeter = Polarimeter("pol", feed_offset_deg=10.0, frequency_hz=11.2e9)
    station.storage.catalogue.replace_spacecraft(replace(record, onboard=onboard, polarimeters=(polarimeter,)))
    station.align(-30, 0)
    for first in (1, 21, 41):
        told = sensed(range(first, first + 20))
        # some of the records come after rows that are newer, and one comes twice
        for pairs, minutes in ((told[:5] + told[9:14], range(14)), (told[5:9] + told[:1] + told[14:], range(14, 20))):
            station.tell(*(one for pair in pairs for one in pair))
            station.send([first + minute for minute in minutes])
            with station.supervised() as settle:
                settle()
    live = station.rows(Method.ROBUST)
    assert len(live) == 60
    version = station.replay(1, 61, smooth=True)
    assert text(station.rows(Method.ROBUST, version)) == text(live)
    assert text(station.commands(version)) == text(station.commands())
    assert [row.epoch_us for row in station.rows(Method.ROBUST_SMOOTHED, version)] == [row.epoch_us for row in live]
    # the records of each sensor are used, those of a batch before its rows too: without them rows are others
    for name in ("momentum", "rate_sensor"):
        without = replace(record, onboard=replace(onboard, **{name: None}), polarimeters=(polarimeter,))
        assert others(new_station(opened_archive), without, live)
    assert others(new_station(opened_archive), replace(record, onboard=onboard), live)


def others(station, record, live) -> bool:
    """Return whether a spacecraft that is stated otherwise has other rows of the same inputs."""
    station.storage.catalogue.replace_spacecraft(record)
    station.align(-30, 0)
    told = sensed(range(1, 21))
    station.tell(*(one for pair in told[:5] + told[9:14] for one in pair))
    station.send(range(1, 15))
    with station.supervised() as settle:
        settle()
    return text(station.rows(Method.ROBUST)) != text(live[:14])


class KilledError(BaseException):
    """The process ends here."""


def smoothed(busy, version):
    return busy.rows(Method.ROBUST_SMOOTHED, version)


def test_robust_rows_and_torques_are_those_of_the_live_run_bit_for_bit(busy):
    version = busy.replay(1, 300, smooth=True)
    for method in BOTH:
        assert text(busy.rows(method, version)) == text(busy.rows(method))
    assert text(busy.commands(version)) == text(busy.commands())


def test_every_robust_row_in_time_has_one_smoothed_row_that_knows_more(busy):
    version = busy.replay(1, 300, smooth=True)
    robust = {row.epoch_us: row for row in busy.rows(Method.ROBUST, version) if "late" not in row.inhibitions}
    rows = smoothed(busy, version)
    assert len(rows) > 60
    assert [row.epoch_us for row in rows] == sorted(robust)
    for row in rows:
        own = robust[row.epoch_us]
        assert (row.number, row.carriers_used, row.excluded) == (own.number, own.carriers_used, own.excluded)
        assert (np.array(row.sigma_deg) <= np.array(own.sigma_deg) * (1.0 + 1e-9)).all()
    better = np.mean([row.sigma_deg.roll < 0.95 * robust[row.epoch_us].sigma_deg.roll for row in rows])
    assert better > 0.5
    # nothing came after the newest row
    assert rows[-1].lag_s == 0.0
    np.testing.assert_allclose(rows[-1].attitude_deg, robust[rows[-1].epoch_us].attitude_deg, rtol=0, atol=0)


def test_a_smoothed_row_allows_no_control_and_no_torque_carries_its_method(busy):
    version = busy.replay(1, 300, smooth=True)
    rows = smoothed(busy, version)
    assert not any(row.control_allowed or any(row.control_allowed_axes) for row in rows)
    assert all(row.inhibitions[-1] == "smoothed" for row in rows)
    commands = busy.commands(version)
    assert commands
    assert "smoothed" not in text(commands)
    assert smoothed(busy, busy.replay(1, 300)) == []


def test_a_replay_of_the_robust_method_alone_keeps_them(busy):
    version = busy.replay(1, 140, method=Method.ROBUST, commands=False, smooth=True)
    assert busy.rows(Method.PAPER, version) == []
    assert len(smoothed(busy, version)) > 60


def test_in_order_of_epoch_late_rows_are_smoothed_in_their_place(busy):
    version = busy.replay(1, 300, order="epoch", alignment_id=1, smooth=True)
    assert [row.epoch_us for row in smoothed(busy, version)] == [
        row.epoch_us for row in busy.rows(Method.ROBUST, version)
    ]


def test_one_that_was_killed_begins_again_and_gives_the_same_rows(busy, monkeypatch):
    monkeypatch.setattr(replay_run, "_CHECKPOINT_S", 0.0)
    monkeypatch.setattr(replay_run, "_OUTCOMES_AT_ONCE", 7)
    whole = busy.replay(1, 300, smooth=True)
    wanted = Replay(0, at(1), at(300), None, None, 0, "journal", "", 0, smooth=True)
    version = busy.replayer.start(SC, wanted)[0].version
    killed = ReplayRun(busy.storage, ChainConfig(), SC, version).pieces()
    for _ in range(5):
        next(killed)
    run = ReplayRun(busy.storage, ChainConfig(), SC, version)
    assert len(run.spans(1)) == 1
    for _ in run.pieces():
        pass
    assert text(smoothed(busy, version)) == text(smoothed(busy, whole))
    assert text(busy.rows(Method.ROBUST, version)) == text(busy.rows(Method.ROBUST, whole))


def ignore(*_):
    """Tell nobody of the progress."""


@pytest.fixture
def target(request, tmp_path):
    """URL of a database without a schema."""
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path / 'restored.db'}"
        return
    cluster = request.getfixturevalue("postgresql_cluster")
    url = cluster.new_database()
    yield url
    cluster.drop(url)


@pytest.mark.parametrize("is_sealed", [False, True], ids=["rows", "sealed"])
@pytest.mark.parametrize("target", ["sqlite", "postgresql"], indirect=True)
def test_a_replay_of_a_restored_archive_is_the_live_run_bit_for_bit(busy, target, tmp_path, is_sealed):
    if is_sealed:
        assert sum(part.rows for part in busy.storage.archive.seal(SC, 1 << 60, 1 << 60)) > 150
    live, commands = [text(busy.rows(method)) for method in BOTH], text(busy.commands())
    entries = repr(busy.storage.archive.journal(SC, 0, 100_000))
    # the archive stays open, as under a running service
    create_backup(str(busy.storage._database.engines.write.url), tmp_path / "backup", 1, ignore)
    assert worst(verify_backup(tmp_path / "backup", ignore)) == "ok"
    restore_backup(tmp_path / "backup", target, "x", ignore, may_replace=False)
    with closing(Station(None, target)) as restored:
        assert repr(restored.storage.archive.journal(SC, 0, 100_000)) == entries
        for version in (LIVE, restored.replay(1, 300)):
            assert [text(restored.rows(method, version)) for method in BOTH] == live
            assert text(restored.commands(version)) == commands
