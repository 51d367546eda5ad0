"""The chain from ingest to result."""

from dataclasses import replace

import numpy as np
import pytest
import synthetic_payload as synthetic
from geometry_flight import Flight, FlightPayload

from bench.bench_chain import chain_row_s
from service.core import compiled_entry
from service.pipeline.chain import METHODS, Chain
from service.pipeline.config import ChainConfig
from service.pipeline.inputs.knowledge import Knowledge, update
from service.records.catalogue import FlexibleMode, Release
from service.records.inputs import (
    AlignmentSet,
    CalibrationActivation,
    EphemerisChange,
    SpacecraftChange,
    TelemetryRecord,
)
from service.records.levels.attitude import AppliedCommand, Axes, Pulse, ReleasedCommand
from service.records.operations.release import InterlockHold

TRUTH = (0.1, -0.15, 0.2)
CONFIG = ChainConfig()


class ExactFlight:
    """A chain over an exact payload, aligned one hour after the start."""

    def __init__(self, payload, synthetic, *, spacecraft=None, calibration=None, opening=True):
        self.payload, self.synthetic = payload, synthetic
        self.aligned_us = synthetic.START_US + synthetic.HOUR
        self.documents = synthetic.FixedDocuments(payload, self.aligned_us)
        self.chain = Chain(self.documents, CONFIG, calibration)
        if opening:
            for content in synthetic.opening(spacecraft or payload.spacecraft()):
                self.chain.update(content)

    def at(self, minute):
        return self.aligned_us + minute * self.synthetic.MINUTE

    def row(self, minute, angles=TRUTH, **changes):
        return self.payload.measurement(self.at(minute), angles, **changes)

    def step(self, minute, angles=TRUTH, *, is_catch_up=False, **changes):
        return self.chain.step(self.row(minute, angles, **changes), is_catch_up=is_catch_up)

    def run(self, minutes, angles=TRUTH, **changes):
        return [self.step(minute, angles, **changes) for minute in minutes]


@pytest.fixture
def flight(payload):
    """An aligned chain before its first row."""
    return ExactFlight(payload, synthetic)


def test_before_an_alignment_rows_lead_to_nothing(payload):
    flight = ExactFlight(payload, synthetic, opening=False)
    assert flight.chain.carrier_states() is None
    assert flight.step(1) is None
    for content in synthetic.opening(payload.spacecraft())[:-1]:
        flight.chain.update(content)
    assert flight.step(2) is None
    assert not flight.chain.is_running
    measurement, states = flight.chain.carrier_states()
    assert measurement.epoch_us == flight.at(2)
    assert {state.state for state in states} == {"uncalibrated"}
    flight.chain.update(AlignmentSet(1))
    assert flight.chain.is_running
    assert flight.chain.knowledge.alignment.id == 1
    assert flight.step(3) is not None


def test_a_row_of_a_backup_source_does_not_exist_for_the_chain(flight):
    assert flight.step(1, feeds_estimator=False) is None
    assert flight.chain.carrier_states() is None


def test_every_row_has_one_attitude_and_one_command(flight):
    # the alignment said zero: the dynamics follow the powers within hours
    outcomes = flight.run(range(1, 400))
    assert all(len(outcome.rows) == 1 for outcome in outcomes)
    assert outcomes[0].command.inhibitions == ("settling", "no_fix")
    last = outcomes[-1]
    np.testing.assert_allclose(last.rows[0].attitude_deg, TRUTH, atol=1e-9)  # exact payload, rounding
    assert last.command.control_allowed
    assert (last.command.number, last.command.attitude_epoch_us) == (last.rows[0].number, last.rows[0].epoch_us)
    # positive roll is answered by negative torque: summed, for single periods may be without a pulse
    total = sum(np.array(outcome.command.impulse_n_m_s) for outcome in outcomes)
    assert (np.sign(total) == -np.sign(TRUTH)).all()


def test_released_by_itself_a_command_counts_as_applied_in_two_steps_it_does_not(payload):
    automatic = ExactFlight(payload, synthetic).run(range(1, 40))
    assert [outcome.applied is not None for outcome in automatic] == [
        outcome.command.control_allowed for outcome in automatic
    ]
    assert automatic[-1].applied.command is automatic[-1].command
    record = payload.spacecraft(release=Release.TWO_STEP)
    stepped = ExactFlight(payload, synthetic, spacecraft=record).run(range(1, 40))
    assert stepped[-1].command.control_allowed
    assert all(outcome.applied is None for outcome in stepped)


def test_a_spacecraft_that_is_not_known_gets_angles_but_no_command(payload):
    flight = ExactFlight(payload, synthetic, opening=False)
    for content in synthetic.opening(payload.spacecraft())[1:]:
        flight.chain.update(content)
    outcome = flight.run(range(1, 20))[-1]
    assert outcome.command is None
    assert outcome.rows[0].control_allowed


def test_the_command_period_is_the_median_row_period(flight):
    periods = [outcome.command.command_period_s for outcome in flight.run(range(0, 60, 2)[1:])]
    assert periods[0] == 60.0  # the default until there are two rows
    assert set(periods[1:]) == {120.0}


def test_rows_caught_up_with_feed_the_state_but_no_torque(flight):
    outcomes = flight.run(range(1, 40), is_catch_up=True, is_late=True)
    assert {reason for outcome in outcomes[15:] for reason in outcome.command.inhibitions} == {"catch_up"}
    np.testing.assert_allclose(outcomes[-1].rows[0].attitude_deg, TRUTH, atol=1e-9)
    live = flight.step(40)
    assert live.command.control_allowed


def test_of_two_rows_of_one_epoch_caught_up_with_the_second_is_late(flight):
    flight.run(range(1, 30), is_catch_up=True)
    twin = flight.step(29, (0.0, 0.3, 0.3), is_catch_up=True, number=9999)
    assert twin.rows[0].inhibitions == ("late", "catch_up")
    assert twin.command is None
    np.testing.assert_allclose(flight.step(30).rows[0].attitude_deg, TRUTH, atol=1e-9)


def test_an_alignment_starts_anew(flight):
    flight.run(range(1, 40))
    flight.documents.alignments[2] = flight.payload.alignment(flight.at(40), alignment_id=2)
    flight.chain.update(AlignmentSet(2))
    assert flight.step(41).rows[0].inhibitions == ("settling", "no_fix")
    assert flight.step(39).rows[0].inhibitions == ("late",)


def test_an_activation_re_derives_references_and_keeps_the_state(flight, payload):
    flight.run(range(1, 40))
    amplitude = payload.amplitude_db.copy()
    wrong = replace(payload, amplitude_db=0.9 * amplitude)
    flight.documents.calibrations[2] = wrong.calibration(2)
    flight.chain.update(CalibrationActivation(2, 2))
    found = flight.step(40).rows[0]
    assert (found.calibration_id, found.inhibitions) == (2, ())
    # one of fifteen rows with a harmonic that differs by 10 % since an alignment 40 minutes ago
    np.testing.assert_allclose(found.attitude_deg, TRUTH, atol=0.02)


def test_states_of_carriers_survive_an_activation_with_other_carriers(flight, payload):
    flight.run(range(1, 20))
    wider = synthetic.SyntheticPayload.make(14)
    flight.documents.calibrations[2] = wider.calibration(2)
    flight.chain.update(CalibrationActivation(2, 2))
    _, states = flight.chain.carrier_states()
    assert {state.state for state in states} == {"used"}
    assert flight.step(20).rows[0].inhibitions[0] == "settling"


def test_an_ephemeris_with_other_nodes_moves_the_harmonic(flight, payload):
    flight.run(range(1, 40))
    nodes_us = tuple(node + 6 * synthetic.HOUR for node in payload.ephemeris().ascending_nodes_us)
    flight.documents.ephemerides[2] = replace(payload.ephemeris(), id=2, ascending_nodes_us=nodes_us)
    flight.chain.update(EphemerisChange(2))
    flight.run(range(40, 60))
    moved = flight.chain.carrier_states()[1]
    assert max(abs(state.deviation_db) for state in moved) > 0.1


def test_an_ephemeris_after_an_alignment_without_calibration_changes_nothing(payload):
    flight = ExactFlight(payload, synthetic, opening=False)
    flight.chain.update(SpacecraftChange(payload.spacecraft(), 1))
    flight.chain.update(AlignmentSet(1))
    flight.chain.update(EphemerisChange(1))
    assert not flight.chain.is_running
    flight.chain.update(CalibrationActivation(1, 1))
    assert flight.chain.is_running
    assert flight.step(1).rows[0].inhibitions == ("settling", "no_fix")


def test_states_of_carriers_tell_what_became_of_each(flight, payload):
    flight.documents.calibrations[1] = payload.calibration()
    carriers = flight.documents.calibrations[1].result.carriers
    result = replace(
        flight.documents.calibrations[1].result, carriers=(replace(carriers[0], selected=False), *carriers[1:])
    )
    flight.documents.calibrations[1] = replace(flight.documents.calibrations[1], result=result)
    flight.chain.update(CalibrationActivation(1, 2))
    for minute in range(1, 30):
        row = flight.row(minute)
        power = row.power_dbm.copy()
        power[1], power[2] = np.nan, power[2] - 5.0
        flight.chain.step(replace(row, power_dbm=power, flags=np.arange(12)))
    measurement, states = flight.chain.carrier_states()
    words = {state.carrier: state.state for state in states}
    assert words == {**dict.fromkeys(payload.ids, "used"), "c00": "unselected", "c01": "absent", "c02": "excluded"}
    assert [state.flags for state in states] == list(range(12))
    np.testing.assert_array_equal([state.power_dbm for state in states], measurement.power_dbm)
    assert states[3].deviation_db == pytest.approx(measurement.power_dbm[3] - states[3].expected_dbm, abs=1e-12)


PAYLOAD = FlightPayload.make()
S = 1_000_000


def hold(*, is_withheld, version=1):
    return InterlockHold(0, "TRIPPED" if is_withheld else "INHIBITED", ("response",), is_withheld, version)


@pytest.fixture
def flown():
    """A chain aligned half an hour ago, released by itself."""
    flown = Flight(PAYLOAD, spacecraft=PAYLOAD.spacecraft(release=Release.AUTOMATIC))
    flown.run(range(1, 30))
    return flown


def test_while_the_interlock_withholds_every_command_is_zero_and_says_so(flown):
    assert flown.chain.step(flown.row(30)).command.control_allowed
    flown.chain.update(hold(is_withheld=True))
    for minute in (31, 32):
        outcome = flown.chain.step(flown.row(minute))
        assert outcome.command.inhibitions == ("tripped",)
        assert (outcome.command.schedule, outcome.applied) == ((), None)
        assert all(row.control_allowed for row in outcome.rows if row.method.value == "robust")
    flown.chain.update(hold(is_withheld=False, version=2))
    assert flown.chain.step(flown.row(33)).command.control_allowed


def test_the_period_is_that_of_the_rows_or_that_of_the_catalogue(flown):
    assert flown.chain.step(flown.row(30)).command.command_period_s == 60.0
    record = PAYLOAD.spacecraft(release=Release.TWO_STEP)
    control = replace(record.control, command_period_s=1200.0)
    flown.chain.update(SpacecraftChange(replace(record, control=control), 2))
    command = flown.chain.step(flown.row(31)).command
    assert command.command_period_s == 1200.0
    assert command.valid_until_us == command.epoch_us + 1200 * S


def test_what_was_sent_is_carried_to_the_next_verdict(flown):
    record = replace(PAYLOAD.spacecraft(release=Release.TWO_STEP), modes=(FlexibleMode("roll", 0.6, 1e-4, 0.4),))
    flown.chain.update(SpacecraftChange(record, 2))
    calm = flown.chain.step(flown.row(30)).command
    strong = Pulse(flown.at(30), 2.0, Axes(0.0, 0.05, 0.0))
    flown.chain.update(ReleasedCommand(1, flown.at(30), (strong,)))
    swung = flown.chain.step(flown.row(31)).command
    flown.chain.update(AppliedCommand(replace(calm, schedule=(replace(strong, start_us=flown.at(31)),))))
    again = flown.chain.step(flown.row(32)).command
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


@pytest.mark.slow
@pytest.mark.parametrize("rows", [1, 8])
def test_rows_of_a_spacecraft_find_their_machine_code(monkeypatch, rows):
    # the first call of an entry brings its arguments into the plain form to compile them
    chain_row_s(16, 30, METHODS, has_commands=True, rows=rows)
    copied, plain = [], compiled_entry._plain
    monkeypatch.setattr(compiled_entry, "_plain", lambda value: copied.append(value) or plain(value))
    chain_row_s(16, 30, METHODS, has_commands=True, rows=rows)
    assert copied == []
