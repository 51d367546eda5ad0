"""The robust method in the chain: flags, commanded motion, memory, what is known of each carrier."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import HOUR, INERTIA, MINUTE, Flight, FlightDocuments, FlightPayload, applied_command

from service.pipeline.config import ChainConfig
from service.pipeline.estimation.robust.runner import RobustRunner
from service.pipeline.inputs.knowledge import Knowledge
from service.records.catalogue import Method
from service.records.inputs import (
    AlignmentSet,
    AttitudeReference,
    CalibrationActivation,
    Correction,
    EphemerisChange,
    SpacecraftChange,
)
from service.records.levels.attitude import Axes, Pulse
from service.records.levels.measurement import QualityFlag

PAYLOAD = FlightPayload.make()
NAN = float("nan")
ZERO = Axes(0.0, 0.0, 0.0)


@pytest.fixture
def flight():
    """A chain just aligned."""
    return Flight(PAYLOAD)


def applied(flight, start, pulses, number=1):
    """Return an applied command of pulses (start in minutes, duration in s, torque)."""
    schedule = tuple(Pulse(flight.at(at), duration_s, Axes(*torque)) for at, duration_s, torque in pulses)
    return applied_command(flight.at(start), schedule, number)


# ---- flags ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "flag",
    [
        QualityFlag.OVERRANGE,
        QualityFlag.UNCAL,
        QualityFlag.NO_CARRIER,
        QualityFlag.INTERFERENCE,
        QualityFlag.EXPIRED,
        QualityFlag.SETTING_MISMATCH,
        QualityFlag.STALE_TRACE,
        QualityFlag.NONFINITE_VALUE,
        QualityFlag.NOT_MEASURED,
    ],
    ids=lambda flag: flag.name,
)
def test_a_level_with_a_flag_against_it_is_absent(flight, flag):
    flags = np.where(np.arange(16) == 4, int(flag), 0)
    change = np.where(np.arange(16) == 4, -7.0, 0.0)
    row = flight.robust(flight.changed(1, change, flags=flags))
    assert {item.carrier: item.reason for item in row.excluded} == {"c04": "absent"}
    np.testing.assert_allclose(flight.error_deg(row), 0.0, atol=0.01)


def test_other_flags_do_not_matter(flight):
    unfit = ("OVERRANGE", "UNCAL", "NO_CARRIER", "INTERFERENCE", "EXPIRED", "SETTING_MISMATCH", "STALE_TRACE")
    unfit += ("NONFINITE_VALUE", "NOT_MEASURED")
    harmless = sum(int(flag) for flag in QualityFlag if flag.name not in unfit)
    row = flight.robust(flight.row(1, flags=np.full(16, harmless)))
    assert row.carriers_used == 16


# ---- corrections ----------------------------------------------------------------------------------------------------


def moved_at(minute, start, stop, change):
    return np.clip((minute - start) / (stop - start), 0.0, 1.0) * np.array(change)


CHANGE = (0.0, 0.12, -0.1)


def test_an_announced_correction_is_followed_without_lag(flight):
    flight.chain.update(Correction(flight.at(20.5), flight.at(40.25), Axes(*CHANGE)))
    for minute in range(1, 80):
        angles = flight.truth_deg + moved_at(minute, 20.5, 40.25, CHANGE)
        row = flight.robust(flight.row(minute, angles))
        # second-order errors of the model through an uncertain scale of 5 %
        np.testing.assert_allclose(row.attitude_deg, angles, atol=0.01)
        assert row.control_allowed


def test_a_correction_astride_the_alignment_counts_from_the_alignment_on():
    flight = Flight(PAYLOAD, is_opened=False)
    opening = flight.opening()
    for content in (*opening[:-1], Correction(flight.at(-30), flight.at(30), Axes(*CHANGE)), opening[-1]):
        flight.chain.update(content)
    for minute in range(1, 60):
        angles = flight.truth_deg + moved_at(minute, -30, 30, CHANGE) - moved_at(0, -30, 30, CHANGE)
        np.testing.assert_allclose(flight.robust(flight.row(minute, angles)).attitude_deg, angles, atol=0.01)


def test_a_correction_that_became_known_late_is_applied_at_once_and_widens_sigma_by_its_size(flight):
    plain = Flight(PAYLOAD)
    plain.run(range(1, 31))
    flight.run(range(1, 31))
    flight.chain.update(Correction(flight.at(20), flight.at(28), Axes(0.0, 0.05, 0.0)))
    row = flight.robust(flight.changed(31, NAN))
    before = plain.robust(plain.changed(31, NAN))
    assert row.attitude_deg.roll - before.attitude_deg.roll == pytest.approx(0.05, abs=1e-9)
    assert row.sigma_deg.roll == pytest.approx(np.hypot(before.sigma_deg.roll, 0.05), rel=1e-6)
    assert row.sigma_deg.pitch == pytest.approx(before.sigma_deg.pitch, rel=1e-6)
    # the powers had told of it: nothing is left of the change once they are seen
    np.testing.assert_allclose(flight.error_deg(flight.run(range(32, 120))[-1])[1:], 0.0, atol=0.01)


def test_a_correction_counts_once_across_a_new_alignment(flight):
    flight.run(range(1, 11))
    flight.chain.update(Correction(flight.at(5), flight.at(45), Axes(*CHANGE)))
    flight.run(range(11, 20))
    start = flight.truth_deg + moved_at(20, 5, 45, CHANGE)
    flight.documents.alignments[2] = PAYLOAD.alignment(flight.at(20), 2, angles_deg=start.tolist())
    flight.chain.update(AlignmentSet(2))
    for minute in range(21, 80):
        angles = flight.truth_deg + moved_at(minute, 5, 45, CHANGE)
        np.testing.assert_allclose(flight.robust(flight.row(minute, angles)).attitude_deg, angles, atol=0.01)


def test_an_alignment_that_reaches_back_takes_corrections_it_had_been_told_of(flight):
    flight.chain.update(Correction(flight.at(10), flight.at(20), Axes(*CHANGE)))
    flight.run(range(1, 40))
    flight.documents.alignments[2] = PAYLOAD.alignment(flight.at(5), 2, angles_deg=flight.truth_deg.tolist())
    flight.chain.update(AlignmentSet(2))
    for minute in range(6, 40):
        angles = flight.truth_deg + moved_at(minute, 10, 20, CHANGE)
        row = flight.robust(flight.row(minute, angles), is_catch_up=True)
        np.testing.assert_allclose(row.attitude_deg, angles, atol=0.01)


def test_motion_of_more_than_a_week_before_an_alignment_is_forgotten(flight):
    runner = flight.chain._runners[0]
    for day in range(12):
        start_us = flight.at(0) + day * 24 * HOUR
        flight.chain.update(Correction(start_us, start_us + MINUTE, ZERO))
    ephemeris = PAYLOAD.ephemeris(2, flight.at(0) + 10 * 24 * HOUR, flight.at(0) + 12 * 24 * HOUR)
    flight.documents.ephemerides[2] = ephemeris
    flight.chain.update(EphemerisChange(2))
    flight.documents.alignments[2] = PAYLOAD.alignment(flight.at(0) + 11 * 24 * HOUR, 2)
    flight.chain.update(AlignmentSet(2))
    assert len(runner._reported) == 8


def test_motion_of_more_than_a_week_before_the_newest_row_is_forgotten_without_an_alignment(flight):
    runner = flight.chain._runners[0]
    for day in range(20):
        flight.robust(flight.changed(1 + day * 1440, NAN))
        flight.chain.update(Correction(flight.at(day * 1440), flight.at(day * 1440 + 1), ZERO))
    assert len(runner._reported) == 7
    assert runner._state.commanded.motions == ()


# ---- applied commands -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("known_at", [0, 20, 33], ids=["in advance", "within the row", "late"])
def test_an_applied_pulse_turns_the_craft_as_a_body_turns(known_at):
    """All carriers absent: the angle is the input's alone, coupling off, exact to rounding."""
    flight, plain = Flight(PAYLOAD), Flight(PAYLOAD)
    # 0.04 N m about roll from 20.3 min for 25 s; -0.02 N m about pitch from 21 min for 130 s, over three rows
    pulses = ((20.3, 25.0, (0.0, 0.04, 0.0)), (21.0, 130.0, (0.0, 0.0, -0.02)))
    for minute in range(1, 60):
        if minute == known_at + 1:
            flight.chain.update(applied(flight, 20, pulses))
        row, before = (one.robust(one.changed(minute, NAN)) for one in (flight, plain))
        if minute <= known_at:
            continue
        elapsed_s = 60.0 * minute - np.array([20.3 * 60.0, 21.0 * 60.0])
        duration_s = np.array([25.0, 130.0])
        acted_s = np.clip(elapsed_s, 0.0, duration_s)
        rate_rad_s = np.array([0.04 / INERTIA[0][0], -0.02 / INERTIA[1][1]]) * acted_s
        turned_rad = rate_rad_s * (0.5 * acted_s + np.maximum(elapsed_s - duration_s, 0.0))
        announced = np.array(row.attitude_deg) - np.array(before.attitude_deg)
        np.testing.assert_allclose(announced, [0.0, *np.degrees(turned_rad)], atol=1e-9)
        rates = np.array(row.rates_deg_s) - np.array(before.rates_deg_s)
        np.testing.assert_allclose(rates, [0.0, *np.degrees(rate_rad_s)], atol=1e-11)
        if minute > 21:
            assert row.sigma_deg.roll > before.sigma_deg.roll


def test_a_slew_by_pulses_is_followed(flight):
    # 0.1 deg about roll in 30 minutes: started and stopped
    rate_deg_s = 0.1 / 1800.0
    torque = np.radians(rate_deg_s) * INERTIA[0][0] / 20.0
    flight.chain.update(applied(flight, 10, ((10.0, 20.0, (0.0, torque, 0.0)), (40.0, 20.0, (0.0, -torque, 0.0)))))
    for minute in range(1, 70):
        elapsed_s = 60.0 * (np.clip(minute, 10, 40) - 10.0) + 10.0 * (int(minute > 40) - int(minute > 10))
        angles = flight.truth_deg + np.array([0.0, rate_deg_s * elapsed_s, 0.0])
        row = flight.robust(flight.row(minute, angles))
        np.testing.assert_allclose(row.attitude_deg, angles, atol=0.01)
        assert row.control_allowed


def test_only_commanded_motion_is_heard(flight):
    runner = flight.chain._runners[0]
    mad = Axes(1e9, 1e9, 1e9)
    flight.chain.update(AttitudeReference("star_tracker", flight.at(3), mad, mad))
    assert runner._reported == []
    assert flight.run([1])[0].control_allowed


# ---- changes --------------------------------------------------------------------------------------------------------


def test_before_it_is_aligned_it_does_not_run_and_refuses_to_step():
    flight = Flight(PAYLOAD, is_opened=False)
    runner = RobustRunner(FlightDocuments(PAYLOAD, flight.aligned_us, (0, 0, 0)), ChainConfig())
    assert (runner.method, runner.is_running, runner.carrier_states()) == (Method.ROBUST, False, {})
    with pytest.raises(ValueError, match="without a model"):
        runner.steps([flight.row(1)], PAYLOAD.plan(), Knowledge(), is_late=False, is_catch_up=False)
    runner.start(Knowledge())
    runner.rebuild(Knowledge())
    assert not runner.is_running


def test_an_ephemeris_that_comes_after_the_alignment_lets_it_begin():
    flight = Flight(PAYLOAD, is_opened=False)
    record, plan, ephemeris, activation, alignment = flight.opening()
    for content in (record, plan, activation, alignment):
        flight.chain.update(content)
    runner = flight.chain._runners[0]
    assert not runner.is_running
    flight.chain.update(Correction(flight.at(2), flight.at(6), Axes(*CHANGE)))
    flight.chain.update(ephemeris)
    assert runner.is_running
    row = flight.robust(flight.row(8, flight.truth_deg + np.array(CHANGE)))
    np.testing.assert_allclose(row.attitude_deg, flight.truth_deg + np.array(CHANGE), atol=0.01)


def test_an_alignment_without_references_of_the_method_silences_it(flight):
    flight.run([1])
    alignment = PAYLOAD.alignment(flight.at(5), 2)
    paper = {"paper": alignment.references_by_method["paper"]}
    flight.documents.alignments[2] = replace(alignment, references_by_method=paper, calibration_by_method={"paper": 1})
    flight.chain.update(AlignmentSet(2))
    runner = flight.chain._runners[0]
    assert (runner.is_running, runner.carrier_states()) == (False, {})


def test_a_change_of_the_craft_keeps_the_state_and_takes_the_new_coupling(flight):
    flight.run(range(1, 20))
    runner = flight.chain._runners[0]
    state = runner._state
    flight.chain.update(SpacecraftChange(PAYLOAD.spacecraft(coupling=True), 2))
    assert runner._state is state
    assert runner._model.settings.coupling_per_h > 0.2


# ---- carriers -------------------------------------------------------------------------------------------------------


def test_what_is_known_of_each_carrier_is_that_of_the_newest_row_in_order(flight):
    used = (True,) * 15 + (False,)
    flight.documents.calibrations[1] = PAYLOAD.calibration(is_used=used)
    flight.chain.update(CalibrationActivation(1, 2))
    flight.chain.update(AlignmentSet(1))
    flight.run(range(1, 10), np.where(np.arange(16) == 3, -5.0, 0.0))
    runner = flight.chain._runners[0]
    known = runner.carrier_states()
    flight.robust(flight.changed(5, 3.0))
    assert repr(runner.carrier_states()) == repr(known)
    assert list(known) == list(PAYLOAD.ids)
    assert {name: one.state for name, one in known.items() if one.state != "used"} == {
        "c03": "excluded",
        "c15": "unselected",
    }
    truth = PAYLOAD.power_dbm([flight.at(9)], np.zeros(3))[0]
    # cubic between knots
    np.testing.assert_allclose([one.expected_dbm for one in known.values()], truth, atol=1e-5)
    assert known["c03"].residual_db == pytest.approx(-5.0, abs=0.01)
    assert known["c00"].deviation_db == pytest.approx(flight.row(9).power_dbm[0] - truth[0], abs=1e-5)
    assert np.isnan(known["c15"].deviation_db)
    assert known["c00"].sigma_db == pytest.approx(np.sqrt(0.05**2 + 0.02**2 + 0.01**2), rel=1e-6)


def test_rows_are_counted_by_whether_something_was_found(flight):
    flight.run(range(1, 6))
    assert flight.chain.rows_by_kind() == {True: 5, False: 0}
    # a receiving chain that loses three decibels in every carrier
    flight.run(range(6, 9), np.full(16, -3.0))
    counts = flight.chain.rows_by_kind()
    assert counts[False] > 0
    assert sum(counts.values()) == 8
    # a late row leaves the state and the counts
    flight.robust(flight.row(2.5, is_late=True))
    assert flight.chain.rows_by_kind() == counts
