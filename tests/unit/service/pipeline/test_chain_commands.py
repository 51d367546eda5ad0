"""Commands of the chain: period, hold of the interlock, momentum of the wheels, what was sent swings the panels."""

from dataclasses import replace

import pytest
from geometry_flight import Flight, FlightPayload

from service.pipeline.inputs.knowledge import Knowledge, update
from service.records.catalogue import FlexibleMode, Release
from service.records.inputs import SpacecraftChange, TelemetryRecord
from service.records.levels.attitude import Axes
from service.records.levels.command import AppliedCommand, Pulse, ReleasedCommand
from service.records.operations.release import InterlockHold

PAYLOAD = FlightPayload.make()
S = 1_000_000


def hold(*, is_withheld: bool, version: int = 1) -> InterlockHold:
    return InterlockHold(0, "TRIPPED" if is_withheld else "INHIBITED", ("response",), is_withheld, version)


@pytest.fixture
def flight():
    """A chain aligned half an hour ago, released by itself."""
    flown = Flight(PAYLOAD, spacecraft=PAYLOAD.spacecraft(release=Release.AUTOMATIC))
    flown.run(range(1, 30))
    return flown


def test_while_the_interlock_withholds_every_command_is_zero_and_says_so(flight):
    assert flight.chain.step(flight.row(30)).command.control_allowed
    flight.chain.update(hold(is_withheld=True))
    for minute in (31, 32):
        outcome = flight.chain.step(flight.row(minute))
        assert outcome.command.inhibitions == ("tripped",)
        assert (outcome.command.schedule, outcome.applied) == ((), None)
        assert all(row.control_allowed for row in outcome.rows if row.method.value == "robust")
    flight.chain.update(hold(is_withheld=False, version=2))
    assert flight.chain.step(flight.row(33)).command.control_allowed


def test_the_period_is_that_of_the_rows_or_that_of_the_catalogue(flight):
    assert flight.chain.step(flight.row(30)).command.command_period_s == 60.0
    record = PAYLOAD.spacecraft(release=Release.TWO_STEP)
    control = replace(record.control, command_period_s=1200.0)
    flight.chain.update(SpacecraftChange(replace(record, control=control), 2))
    command = flight.chain.step(flight.row(31)).command
    assert command.command_period_s == 1200.0
    assert command.valid_until_us == command.epoch_us + 1200 * S


def test_what_was_sent_is_carried_to_the_next_verdict(flight):
    record = replace(PAYLOAD.spacecraft(release=Release.TWO_STEP), modes=(FlexibleMode("roll", 0.6, 1e-4, 0.4),))
    flight.chain.update(SpacecraftChange(record, 2))
    calm = flight.chain.step(flight.row(30)).command
    strong = Pulse(flight.at(30), 2.0, Axes(0.0, 0.05, 0.0))
    flight.chain.update(ReleasedCommand(1, flight.at(30), (strong,)))
    swung = flight.chain.step(flight.row(31)).command
    flight.chain.update(AppliedCommand(replace(calm, schedule=(replace(strong, start_us=flight.at(31)),))))
    again = flight.chain.step(flight.row(32)).command
    peaks = [
        reported.schedule_check.peak_deg for reported in (calm, swung, again) if reported.schedule_check is not None
    ]
    assert len(peaks) == 3
    assert peaks[0] < 0.2 * peaks[1]
    assert peaks[2] != peaks[1]


def test_momentum_and_rate_are_known_while_they_are_fresh_in_whatever_order_they_come():
    rate = Axes(1e-5, -2e-5, 3e-5)
    reported = TelemetryRecord(1000 * S, wheel_momentum_n_m_s=(1.0, 2.0, 3.0), body_rate_deg_s=rate)
    known, zero = update(Knowledge(), reported, None), (0.0,) * 3
    for epoch_s in (2000, 900):
        known = update(known, replace(reported, epoch_us=epoch_s * S, wheel_momentum_n_m_s=zero), None)
    known = update(known, TelemetryRecord(1030 * S), None)
    assert known.body_rate_deg_s(1060 * S, 60.0) == known.body_rate_deg_s(940 * S, 60.0) == rate
    assert known.body_rate_deg_s(1061 * S, 60.0) is None
    assert known.momentum_n_m_s(1000 * S, 60.0) == (1.0, 2.0, 3.0)
    assert known.momentum_n_m_s(1060 * S, 60.0) == (1.0, 2.0, 3.0)
    assert known.momentum_n_m_s(1061 * S, 60.0) is None
    assert known.momentum_n_m_s(999 * S, 60.0) is None
    assert Knowledge().momentum_n_m_s(0, 60.0) is None
    assert not Knowledge().is_withheld
