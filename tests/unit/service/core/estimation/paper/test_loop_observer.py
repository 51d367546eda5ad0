"""The observer of the published loop against a body that is integrated here."""

import math

import numpy as np
import pytest

from service.core.compiled_entry import CompiledEntry
from service.core.estimation.filtering import filter_model, motion, plant
from service.core.estimation.filtering.filter_model import ATTITUDE, FilterSettings, no_carriers, rates_deg_h
from service.core.estimation.paper import downlink_fade, loop_observer
from service.core.estimation.paper.loop_observer import (
    MIN_CARRIERS,
    MOTION,
    TORQUE,
    Commanded,
    initial_estimate,
    lasting_deg2,
    linear_fix,
    loop_slopes,
    turn_to_axes,
    with_other_torque,
)

COUPLING = 0.2625162
MINUTE_US = 60_000_000
RNG = np.random.default_rng(5)
#: stations as the spacecraft sees them, deg
AZIMUTH, ELEVATION = RNG.uniform(-5.0, 5.0, 16), RNG.uniform(5.0, 8.5, 16)
TURNED = np.column_stack([np.full(16, 9.0), RNG.normal(0.0, 1.2, 16), RNG.normal(0.0, 1.0, 16)])
SLOPES = loop_slopes(TURNED, TURNED, AZIMUTH, ELEVATION)
ALL = np.ones(16, dtype=bool)
USED = np.zeros(16, dtype=np.int64)
MODULES = filter_model, plant, motion, downlink_fade, loop_observer
PREDICT, UPDATE = (
    CompiledEntry(each, MODULES) for each in (loop_observer.predict_estimate, loop_observer.update_estimate)
)
UNKNOWN = FilterSettings(
    coupling_per_h=COUPLING, torque_deg_h2=(0.15, 0.15, 0.2), unknown_torque_deg_h2=(0.15, 0.15, 0.2)
)


def motion_of(torque, hours, gained=lambda hour: np.zeros(3), step_h=1.0 / 60.0):
    """Integrate yaw' = -w roll + r, roll' = w yaw + r, r' = torque + what is commanded; a row a minute."""
    angles, rates, rows = np.zeros(3), np.zeros(3), []
    fine = 20
    for k in range(round(hours / step_h)):
        gain = gained(k * step_h)
        for _ in range(fine):
            rates = rates + (torque * step_h + gain) / fine
            exchange = COUPLING * np.array([-angles[1], angles[0], 0.0])
            angles = angles + (rates + exchange) * step_h / fine
        rows.append((angles.copy(), rates.copy(), gain))
    return rows


def flown(rows, settings, noise_db, *, lasting_db=0.0, seed=1):
    """Feed rows to an observer that begins at rest; return its estimates."""
    draw = np.random.default_rng(seed)
    arrays, lasting = plant.filter_model(no_carriers(), settings), lasting_deg2(SLOPES, ALL)
    mean, covariance = initial_estimate(np.zeros(3), np.full(3, 0.02), settings)
    wrong = lasting_db * draw.standard_normal(16)
    estimates = []
    for k, (angles, _, gain) in enumerate(rows):
        times_us = k * MINUTE_US, (k + 1) * MINUTE_US
        commanded = Commanded(np.array([(*times_us, np.zeros(3), gain)], MOTION), np.zeros((2, 3)), 0)
        PREDICT(arrays, lasting, mean, covariance, commanded, *times_us)
        levels = SLOPES @ angles + wrong + noise_db * draw.standard_normal(16)
        fix = linear_fix(levels, SLOPES, USED)
        UPDATE(mean, covariance, fix.angles_deg, noise_db**2 * fix.unit_covariance)
        estimates.append((mean.copy(), covariance.copy()))
    return estimates


def test_yaw_moves_a_station_as_pitch_and_roll_do():
    small = np.radians(ELEVATION) * TURNED[:, 2] - np.radians(AZIMUTH) * TURNED[:, 1]
    np.testing.assert_allclose(SLOPES[:, 0], small, atol=0.02)
    np.testing.assert_array_equal(SLOPES[:, 1:], TURNED[:, 1:])


def test_the_slope_is_the_middle_of_both_signs():
    bent = 0.4 * np.abs(TURNED)
    np.testing.assert_allclose(loop_slopes(TURNED + bent, TURNED - bent, AZIMUTH, ELEVATION), SLOPES, atol=1e-12)


@pytest.mark.parametrize(("known", "left_out"), [(4, 12), (3, 0)])
def test_a_station_without_a_place_takes_no_part_unless_hardly_any_has_one(known, left_out):
    azimuth = np.where(np.arange(16) < known, AZIMUTH, math.nan)
    slopes = loop_slopes(TURNED, TURNED, azimuth, ELEVATION)
    assert np.count_nonzero(np.isnan(slopes[:, 0])) == left_out
    if not left_out:
        np.testing.assert_array_equal(slopes, TURNED)


def test_a_fix_tells_angles_and_hardly_feels_what_all_levels_have_in_common():
    angles = np.array([1.0, 0.2, -0.1])
    np.testing.assert_allclose(linear_fix(SLOPES @ angles, SLOPES, USED).angles_deg, angles, atol=1e-12)
    fade = linear_fix(SLOPES @ angles - 0.35, SLOPES, USED)
    plain = np.linalg.lstsq(SLOPES, np.full(16, 0.35), rcond=None)[0]
    np.testing.assert_array_less(np.abs(fade.angles_deg - angles), 0.4 * np.abs(plain))


def test_a_level_that_its_user_changed_hardly_turns_a_fix():
    angles, changed = np.array([0.3, 0.2, -0.1]), np.zeros(16)
    changed[4] = 1.5
    plain = np.linalg.lstsq(SLOPES, changed, rcond=None)[0]
    fix = linear_fix(SLOPES @ angles + changed, SLOPES, USED)
    np.testing.assert_array_less(np.abs(fix.angles_deg - angles), 0.3 * np.abs(plain) + 0.01)


def test_stations_in_one_place_tell_roll_and_pitch_and_no_yaw():
    slopes = loop_slopes(TURNED, TURNED, np.full(16, 3.0), np.full(16, 8.0))
    fix = linear_fix(slopes @ [0.0, 0.2, -0.1], slopes, USED)
    np.testing.assert_allclose(fix.angles_deg, [0.0, 0.2, -0.1], atol=0.05)
    yaw, roll, pitch = np.sqrt(np.diag(fix.unit_covariance))
    assert yaw > 40.0
    assert max(roll, pitch) < 10.0


@pytest.mark.parametrize("carriers", [0, 3])
def test_too_few_carriers_make_no_fix(carriers):
    levels = np.where(np.arange(16) < carriers, 0.1, math.nan)
    fix = linear_fix(levels, SLOPES, USED)
    assert fix.carriers == carriers < MIN_CARRIERS
    assert math.isnan(fix.scatter_db)
    assert not lasting_deg2(SLOPES, np.arange(16) < carriers).any()


@pytest.mark.slow
def test_yaw_follows_from_roll_within_what_the_observer_says():
    torque = np.array([0.04, -0.08, 0.05])
    rows = motion_of(torque, 8.0)
    mean, covariance = flown(rows, UNKNOWN, 0.02)[-1]
    truth, sigma = rows[-1][0], np.sqrt(np.diag(covariance))[ATTITUDE]
    np.testing.assert_array_less(np.abs(mean[ATTITUDE] - truth), 2.0 * sigma)
    # nobody controls, and what yaw does a torque about roll could do too: better than to say zero
    assert truth[0] > 2.0
    assert abs(mean[0] - truth[0]) < 0.6 * truth[0]


@pytest.mark.slow
def test_what_was_commanded_is_known_at_once_and_turns_as_it_does():
    rows = motion_of(np.zeros(3), 1.0, lambda hour: np.array([0.3, -0.2, 0.4]) * (hour == 0.0))
    still = FilterSettings(coupling_per_h=COUPLING)
    estimates = flown(rows, still, 5.0)  # fixes say next to nothing
    for (angles, rates, _), (mean, _) in zip(rows[::10], estimates[::10], strict=True):
        exchange = COUPLING * np.array([-angles[1], angles[0], 0.0])
        # 20 steps of Euler a minute
        np.testing.assert_allclose(rates_deg_h(mean, COUPLING), rates + exchange, atol=0.01)
        np.testing.assert_allclose(mean[ATTITUDE], angles, atol=0.01)


@pytest.mark.slow
def test_levels_that_drift_together_keep_the_angles_uncertain():
    rows = motion_of(np.zeros(3), 24.0)
    _, covariance = flown(rows, UNKNOWN, 0.02)[-1]
    sigma = np.sqrt(np.diag(covariance))[ATTITUDE]
    # a white noise of 0.02 dB alone would leave 0.001 deg after a day
    np.testing.assert_array_less(0.5 * np.sqrt(np.diag(lasting_deg2(SLOPES, ALL)))[1:], sigma[1:])


def test_another_stated_torque_begins_again_and_leaves_the_motion():
    rows = motion_of(np.array([0.0, -0.08, 0.05]), 4.0)
    mean, covariance = flown(rows, UNKNOWN, 0.02)[-1]
    larger = UNKNOWN._replace(torque_deg_h2=(0.6, 0.6, 0.6))
    other_mean, other_covariance = with_other_torque(mean, covariance, larger)
    np.testing.assert_array_equal(other_mean[: TORQUE.start], mean[: TORQUE.start])
    assert not other_mean[TORQUE].any()
    assert (np.linalg.eigvalsh(other_covariance) > -1e-12).all()


def test_an_epoch_that_is_not_later_changes_nothing():
    mean, covariance = initial_estimate(np.zeros(3), np.full(3, 0.02), UNKNOWN)
    before = mean.copy(), covariance.copy()
    nothing = Commanded(np.zeros(0, MOTION), np.ones((2, 3)), 0)
    arrays = plant.filter_model(no_carriers(), UNKNOWN)
    PREDICT(arrays, lasting_deg2(SLOPES, ALL), mean, covariance, nothing, MINUTE_US, MINUTE_US)
    np.testing.assert_array_equal(mean, before[0])
    np.testing.assert_array_equal(covariance, before[1])


@pytest.mark.parametrize("sizes", [(1.0, 1.0, 1.0), (30.0, 20.0, 1e-3), (5.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_principal_axes_are_those_of_the_matrix(sizes):
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    matrix, axes = turn @ np.diag(sizes) @ turn.T, np.eye(3)
    matrix = 0.5 * (matrix + matrix.T)
    turned = matrix.copy()
    turn_to_axes(turned, axes)
    np.testing.assert_allclose(np.sort(np.diag(turned)), np.linalg.eigvalsh(matrix), rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(axes @ np.diag(np.diag(turned)) @ axes.T, matrix, rtol=0.0, atol=1e-13)
