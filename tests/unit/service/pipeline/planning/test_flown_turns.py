"""Turns that were flown and turns that are rehearsed."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from foreign_station import flown
from hypothesis import given
from hypothesis import strategies as st

from service.pipeline.calibration.geometry_rows import CalibrationError
from service.pipeline.calibration.minute_rows import minute_rows
from service.pipeline.config import CalibrationConfig
from service.pipeline.planning.assumed_beams import NOISES, AssumedBeam, assume_payload
from service.pipeline.planning.quiet_days import QuietDays, flown_windows, quiet_levels
from service.pipeline.planning.rehearsal import rehearse
from service.records.catalogue import CarrierPlan
from service.study.estimation.flight.world import simulated_world

MINUTE_US, DAY_MIN = 60_000_000, 1440
CONFIG = CalibrationConfig()


@cache
def readings():
    """Return epochs and angles of quiet days, turns and hours after them, with the noise of a sensor."""
    known = list(flown())
    angles_deg = np.array([angles for _, angles in known])
    epochs_us = np.array([round(epoch.timestamp() * 1e6) for epoch, _ in known])
    return epochs_us, angles_deg + np.random.default_rng(3).normal(0.0, 0.005, angles_deg.shape)


def minutes(found, name):
    """Return a window in minutes since the first reading."""
    window = getattr(found, name)
    first_us = int(readings()[0][0])
    return (window.start_us - first_us) / MINUTE_US, (window.stop_us - first_us) / MINUTE_US


def test_turns_are_found_with_the_days_before_and_the_hour_after():
    found = flown_windows(*readings(), CONFIG)
    assert found.shortcomings == ()
    start, stop = minutes(found, "turns")
    # 6 staircases of 64 min, 8 corners of 12 min and a rest of 10 min
    assert 3 * DAY_MIN - 30 < start <= 3 * DAY_MIN
    assert 3 * DAY_MIN + 480 <= stop < 3 * DAY_MIN + 520
    assert minutes(found, "quiet") == (0.0, start)
    assert minutes(found, "align") == (stop, stop + 60)


@given(st.floats(0.0, 0.5), st.integers(0, 2))
def test_a_constant_of_the_sensor_and_absent_readings_move_no_window(offset_deg, axis):
    epochs_us, angles_deg = readings()
    changed = angles_deg[::3].copy()
    changed[:, axis] += offset_deg / 10
    changed[::7] = np.nan
    found = flown_windows(epochs_us[::3], changed, CONFIG)
    start, _ = minutes(found, "turns")
    assert abs(start - 3 * DAY_MIN) <= 30


@pytest.mark.parametrize("axis", range(3))
def test_an_axis_that_was_not_turned_is_named(axis):
    epochs_us, angles_deg = readings()
    changed = angles_deg.copy()
    changed[:, axis] = np.clip(changed[:, axis], -1.0, 0.09)
    found = flown_windows(epochs_us, changed, CONFIG)
    assert (found.quiet, found.turns, found.align) == (None, None, None)
    assert f"lack +{('yaw', 'roll', 'pitch')[axis]}" in found.shortcomings[0]


def test_quiet_days_alone_show_no_turns():
    epochs_us, angles_deg = readings()
    found = flown_windows(epochs_us[: 3 * DAY_MIN], angles_deg[: 3 * DAY_MIN], CONFIG)
    assert found == (None, None, None, ("no turns about all three axes to both sides",))


def test_too_few_readings_before_and_after_the_turns_are_said():
    epochs_us, angles_deg = readings()
    part = slice(2 * DAY_MIN + 300, 3 * DAY_MIN + 490)
    found = flown_windows(epochs_us[part], angles_deg[part], CONFIG)
    assert found.turns is not None
    assert (found.quiet, found.align) == (None, None)
    assert "less than a day of readings without motion" in found.shortcomings[0]
    assert "no readings in the hour after the turns" in found.shortcomings[1]
    part = slice(3 * DAY_MIN, None)
    assert "less than a day of readings" in flown_windows(epochs_us[part], angles_deg[part], CONFIG).shortcomings[0]


def test_the_last_turns_count_and_the_quiet_days_begin_after_those_before():
    epochs_us, angles_deg = readings()
    length_us = epochs_us[-1] - epochs_us[0] + MINUTE_US
    twice = flown_windows(np.r_[epochs_us, epochs_us + length_us], np.vstack([angles_deg, angles_deg]), CONFIG)
    once = flown_windows(epochs_us, angles_deg, CONFIG)
    assert twice.turns.start_us == once.turns.start_us + length_us
    assert minutes(twice, "quiet")[0] == minutes(once, "turns")[1]


#: every fifth row: what is tested here does not need the others
STEP = 5
BEAMS = {
    "Ku1": AssumedBeam(-3.07, 6.81, 4.5, 3.0),
    "Ku2": AssumedBeam(-2.42, 8.60, 4.0, 3.3),
    "Ku3": AssumedBeam(0.07, 8.60, 4.3, 3.2),
    "Ku4": AssumedBeam(3.73, 6.90, 4.5, 3.1),
}


@cache
def world():
    return simulated_world("nominal", 1, 0.05)


def quiet_days(rows=slice(None), extra_db=0.0):
    ground = world().ground
    plan = CarrierPlan(1, "", ground.carriers)
    series = ground.series(ground.phases["quiet"], plan.carrier_ids)
    noise = np.random.default_rng(5).normal(0.0, 1.0, series.power_dbm.shape) * extra_db
    kept = replace(series, epochs_us=series.epochs_us[::STEP][rows], power_dbm=(series.power_dbm + noise)[::STEP][rows])
    return QuietDays(ground.spacecraft, plan, ground.ephemeris, minute_rows([kept], plan.carrier_ids, ()))


def rehearsed(days):
    payload = assume_payload(days.plan.carriers, days.spacecraft.longitude_deg, NOISES["links"], BEAMS)
    return rehearse(days, quiet_levels(days), payload.response)


def test_the_turns_come_back_as_the_beams_that_were_stated():
    days = quiet_days()
    found = rehearsed(days)
    payload = assume_payload(days.plan.carriers, 90.0, NOISES["links"], BEAMS)
    slopes = np.array([carrier.sensitivity_db_per_deg for carrier in found.result.carriers])
    error = np.abs(slopes - payload.response.slope)[:, 1:]
    # five rows of noise in a level of the turns, and slow noise that is fitted with them
    assert error.max() < 0.5
    assert error.mean() < 0.15
    prediction = found.prediction
    assert 0.01 < prediction.usual_sigma_deg.roll < 0.04
    assert (prediction.protection_deg[:, 1] > 2.0 * prediction.sigma_deg[:, 1]).all()
    assert found.turns.stop_us - found.turns.start_us == round(8.5 * 3.6e9)


@pytest.mark.slow
def test_noisier_days_predict_a_larger_sigma():
    quiet, noisy = (rehearsed(quiet_days(extra_db=noise)).prediction.usual_sigma_deg for noise in (0.0, 0.6))
    assert noisy.roll > 1.5 * quiet.roll
    assert noisy.pitch > 1.5 * quiet.pitch


@pytest.mark.slow
def test_carriers_without_a_known_beam_do_not_count():
    days = quiet_days()
    payload = assume_payload(days.plan.carriers, 90.0, NOISES["links"], BEAMS)
    response = payload.response._replace(slope=payload.response.slope.copy())
    response.slope[2] = np.nan
    result = rehearse(days, quiet_levels(days), response).result
    assert [k for k, used in enumerate(result.geometry.is_used) if not used] == [2]


def test_short_days_are_refused():
    with pytest.raises(CalibrationError, match=r"hold 20\.0 h; three days are wanted, 32\.5 h are the least"):
        rehearsed(quiet_days(slice(0, 241)))


def test_too_few_carriers_are_refused():
    days = quiet_days()
    days.rows.series.power_dbm[:, 3:] = np.nan
    with pytest.raises(CalibrationError, match=r"only 3 carriers can be used, 4 are needed"):
        rehearsed(days)
