"""Rows that follow records of wheels, a polarimeter and a rate sensor: one past, however they are recorded."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import MINUTE
from stepped_robust import ALIGNED_US, CONFIG, PAYLOAD, Stepped

from service.core.estimation.filtering.model.filter_state import ATTITUDE, DRIFT, RATE
from service.pipeline.estimation.robust.momentum_records import step_with_record
from service.pipeline.estimation.robust.row_recorder import RowRecorder
from service.pipeline.estimation.smoothed.smoother import angles_of, lagged_angles
from service.records.catalogue import BodyRateSensor, Polarimeter, WheelMomentum
from service.records.inputs import PolarizationRecord, TelemetryRecord
from service.records.levels.attitude import Axes

ROWS, JOINED, LAG_MIN = 40, 8, 20
#: of a body that turns with the orbit, deg/s
STILL = Axes(yaw=0.0, roll=0.0, pitch=-15.0411 / 3600.0)
SENSOR = BodyRateSensor(in_loop=False, bias_deg_h=0.01, bias_tau_h=8.0, noise_deg_sqrt_h=0.003)


@pytest.fixture(scope="module")
def recorded():
    """Return recorders from the first row on, and from a later one, with the filter's sigma (3,) of each row."""
    print("seed 20261126")
    rng, craft = np.random.default_rng(20261126), PAYLOAD.spacecraft()
    onboard = replace(craft.onboard, momentum=WheelMomentum(), rate_sensor=SENSOR)
    flight = Stepped(spacecraft=replace(craft, onboard=onboard, polarimeters=(Polarimeter("p", 10.0, 11e9),)))
    whole, joined, state, sigma_deg, angles, rates = RowRecorder(ROWS), RowRecorder(ROWS), flight.state, [], [], []
    for minute in range(1, ROWS + 1):
        at_us = ALIGNED_US + minute * MINUTE
        wheels = tuple((np.array([0.2, -8.0, 0.1]) + rng.normal(0.0, 0.01, 3)).tolist())
        telemetry = TelemetryRecord(at_us - MINUTE, wheel_momentum_n_m_s=wheels, thrusters_active=minute == 25)
        angles.append(PolarizationRecord("p", at_us, angle_deg=1.0 + rng.normal(0.0, 0.05), sigma_deg=0.05))
        noise = rng.normal(0.0, 1e-6, 3)
        rates.append(TelemetryRecord(at_us, body_rate_deg_s=Axes(*(np.array([*STILL]) + noise).tolist())))
        heard = replace(
            flight.knowledge,
            momenta=(telemetry,),
            polarization={"p": tuple(angles)},
            rates=tuple(rates),
        )
        measurement = PAYLOAD.measurement(at_us, np.zeros(3))
        power_dbm = measurement.power_dbm + rng.normal(0.0, 0.05, len(measurement.power_dbm))
        for recorder in (whole, joined) if minute >= JOINED else (whole,):
            outcome = step_with_record(
                state,
                model=flight.model,
                knowledge=heard,
                measurement=measurement,
                power_dbm=power_dbm,
                is_late=False,
                is_catch_up=False,
                config=CONFIG,
                recorder=recorder,
            )
        state = outcome.state
        sigma_deg.append(state.filter.gaussian.attitude_sigma_deg)
    assert not state.momentum.is_refused
    assert state.rates.is_measured
    assert state.polarimeters[0].blocks > 0.0
    return whole.rows, joined.rows, np.array(sigma_deg)


def test_records_leave_no_gap_in_the_past_and_are_all_kept(recorded):
    whole, joined, _ = recorded
    assert [row.origin is None for row in whole] == [True] + [False] * (ROWS - 1)
    assert [row.origin is None for row in joined] == [True] + [False] * (ROWS - JOINED)
    taken = [len(record.update.residual) for row in whole for record in row.sensed if record.update is not None]
    assert taken.count(3) == ROWS
    assert taken.count(1) > ROWS // 6
    # a measured rate takes the place of the rate before it
    moving = set(range(DRIFT.start, RATE.stop))
    assert all(set(row.sensed[-1].restarted.tolist()) <= moving for row in whole)
    assert all(set(range(RATE.start, RATE.stop)) <= set(row.sensed[-1].restarted.tolist()) for row in whole)


def test_smoothed_sigma_is_below_the_filters(recorded):
    whole, _, sigma_deg = recorded
    smoothed = [np.sqrt(np.diag(each.state.covariance)[ATTITUDE]) for each in angles_of(list(whole), ROWS)]
    assert (smoothed[:-1] < sigma_deg[:-1]).all()


def test_a_fixed_lag_gives_the_rows_of_the_whole_span_that_ends_with_it(recorded):
    whole, joined, _ = recorded
    for newest in range(JOINED + LAG_MIN, ROWS + 1):
        found = lagged_angles(list(joined)[: newest - JOINED + 1], LAG_MIN * MINUTE)
        expected = angles_of(list(whole)[:newest], newest)[newest - LAG_MIN - 1]
        np.testing.assert_array_equal(found.state.mean, expected.state.mean)
        np.testing.assert_array_equal(found.state.covariance, expected.state.covariance)
