"""References of the robust method: calibration and window weighed, re-levelled users named, contradictions tested."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import HOUR, MINUTE, START_US, FlightPayload, S

from service.pipeline.alignment.robust_references import robust_references
from service.pipeline.config import AlignmentConfig
from service.pipeline.inputs.reference_angles import StatedAngles
from service.records.calibration import Window
from service.records.levels.attitude import Axes
from service.records.noise import NoiseComponent

CONFIG = AlignmentConfig()
ALIGNED_US = START_US + HOUR
WINDOW = Window(ALIGNED_US - 30 * MINUTE, ALIGNED_US + 1)
ZERO = (0.0, 0.0, 0.0)


@pytest.fixture
def payload():
    """Twelve carriers."""
    return FlightPayload.make(12)


def stated(angles=ZERO, rates=ZERO, sigma=(0.01, 0.005, 0.005)):
    return StatedAngles(ALIGNED_US, Axes(*angles), Axes(*sigma), Axes(*rates))


def align(payload, series, reported=None, calibration=None, config=CONFIG):
    return robust_references(
        series, reported or stated(), calibration or payload.calibration(), payload.ephemeris(), config
    )


def moved(series, change_db):
    return replace(series, power_dbm=series.power_dbm + np.asarray(change_db))


def told_of(powers, name="reference_dbm"):
    return np.array([getattr(one, name) for one in powers.references])


@pytest.mark.parametrize("angles", [ZERO, (0.2, -0.3, 0.25)], ids=["at zero", "turned"])
def test_references_are_the_levels_at_zero_attitude(payload, angles):
    powers = align(payload, payload.series(WINDOW, angles), stated(angles))
    # second order of the turn, 0.002 deg at 0.4, times a slope of 3 dB/deg
    np.testing.assert_allclose(told_of(powers), payload.level_dbm, atol=0.01)
    np.testing.assert_allclose(told_of(powers, "change_since_calibration_db"), 0.0, atol=0.01)
    assert powers.changed == ()
    assert powers.consistency.probability > 0.01
    np.testing.assert_array_equal(told_of(powers, "samples"), 31)


def test_a_craft_that_turns_during_the_window_is_followed(payload):
    epochs_us = np.arange(WINDOW.start_us, WINDOW.stop_us, 60 * S)
    rates = np.array([1e-5, 1e-4, -5e-5])
    angles = ((epochs_us - ALIGNED_US) / S)[:, None] * rates
    still = payload.series(WINDOW)
    series = replace(still, power_dbm=payload.power_dbm(epochs_us, angles))
    followed = align(payload, series, stated(rates=rates.tolist()))
    np.testing.assert_allclose(told_of(followed), payload.level_dbm, atol=0.005)
    ignored = align(payload, series)
    # 0.09 deg on the mean
    assert np.abs(told_of(ignored) - payload.level_dbm).max() > 0.02


def test_calibration_and_window_are_weighed_by_their_variances(payload):
    change = 0.04 * np.random.default_rng(5).choice([-1.0, 1.0], 12)
    change -= np.median(change)
    angle_deg = np.array([0.01, 0.005, 0.005])
    powers = align(payload, moved(payload.series(WINDOW), change))
    hours = (ALIGNED_US - payload.request.quiet.stop_us) / HOUR
    calibration_db2 = 0.02**2 + 0.006**2 * hours
    seen = payload.power_dbm([ALIGNED_US] * 6, np.vstack([np.eye(3), -np.eye(3)]) * 0.01)
    slope = (seen[:3] - seen[3:]).T / 0.02
    white_db2 = 0.05**2 / 31

    def kept(tau_s, sigma_db):
        x = 1800.0 / tau_s
        return sigma_db**2 * 2.0 * (x - 1.0 + np.exp(-x)) / x**2

    window_db2 = white_db2 + kept(1200.0, 0.02) + kept(7200.0, 0.01) + slope**2 @ angle_deg**2
    weight = window_db2 / (calibration_db2 + window_db2)
    np.testing.assert_allclose(told_of(powers), payload.level_dbm + (1.0 - weight) * change, atol=2e-4)
    wanted = np.sqrt(calibration_db2 * window_db2 / (calibration_db2 + window_db2))
    np.testing.assert_allclose(told_of(powers, "sigma_db"), wanted, rtol=0.01)
    # both matter in this test
    assert ((weight > 0.1) & (weight < 0.9)).all()


def test_an_older_calibration_counts_less(payload):
    change = np.where(np.arange(12) % 2, 0.03, -0.03)
    series = moved(payload.series(WINDOW), change)
    fresh = payload.calibration()
    quiet = fresh.request.quiet
    month_us = 30 * 24 * HOUR
    aged_window = Window(quiet.start_us - month_us, quiet.stop_us - month_us)
    aged = replace(fresh, request=replace(fresh.request, quiet=aged_window))
    near = np.abs(told_of(align(payload, series, calibration=aged)) - payload.level_dbm - change)
    far = np.abs(told_of(align(payload, series, calibration=fresh)) - payload.level_dbm - change)
    assert (near < far).all()


def test_what_all_carriers_have_in_common_is_the_receiving_chains_and_comes_from_the_window(payload):
    powers = align(payload, moved(payload.series(WINDOW), 1.7))
    np.testing.assert_allclose(told_of(powers), payload.level_dbm + 1.7, atol=1e-4)
    assert powers.changed == ()
    assert powers.consistency.probability > 0.5


def test_a_user_who_re_levelled_takes_the_window_and_is_named(payload):
    change = np.zeros(12)
    change[3], change[8] = 0.8, 1.1
    powers = align(payload, moved(payload.series(WINDOW), change))
    assert powers.changed == ("c03", "c08")
    np.testing.assert_allclose(told_of(powers), payload.level_dbm + change, atol=1e-4)
    # with the window's own uncertainty, which is more than that of both together
    sigma = told_of(powers, "sigma_db")
    assert sigma[3] > 0.01
    assert powers.consistency.probability > 0.01
    assert powers.consistency.carriers_tested == 10


def test_a_lower_level_is_wet_while_the_calibration_is_young(payload):
    change = np.where(np.arange(12) == 8, -1.1, 0.0)
    powers = align(payload, moved(payload.series(WINDOW), change))
    assert powers.changed == ("c08",)
    np.testing.assert_allclose(told_of(powers), payload.level_dbm, atol=1e-3)
    old = align(payload, moved(payload.series(WINDOW), change), config=replace(CONFIG, wet_level_h=0.0))
    np.testing.assert_allclose(told_of(old), payload.level_dbm + change, atol=1e-3)


def test_powers_of_another_attitude_contradict(payload):
    powers = align(payload, payload.series(WINDOW, (0.0, 0.15, -0.2)))
    assert powers.consistency.probability < 1e-4
    # the offset is told in degrees; levels walked since the calibration, which weighs carriers unevenly
    np.testing.assert_allclose(powers.consistency.offset_deg[1:], [0.15, -0.2], atol=0.02)


def test_when_most_levels_moved_all_take_part_in_the_test(payload):
    change = np.where(np.arange(12) < 5, 1.5, 0.0)
    powers = align(payload, moved(payload.series(WINDOW), change))
    assert len(powers.changed) == 5
    assert powers.consistency.carriers_tested == 12


def test_impulses_do_not_enter_the_mean(payload):
    series = payload.series(WINDOW)
    power = series.power_dbm + 0.02 * np.random.default_rng(3).normal(size=series.power_dbm.shape)
    power[::7, 4] += 20.0
    powers = align(payload, replace(series, power_dbm=power))
    assert powers.references[4].samples == 26
    np.testing.assert_allclose(told_of(powers), payload.level_dbm, atol=0.02)


def test_carriers_with_too_few_rows_have_no_reference(payload):
    series = payload.series(WINDOW)
    power = series.power_dbm.copy()
    power[:, 1] = np.nan
    power[7:, 2] = np.nan
    power[8:, 5] = np.nan
    powers = align(payload, replace(series, power_dbm=power))
    assert [one.carrier for one in powers.references] == [f"c{k:02d}" for k in range(12) if k not in (1, 2)]
    assert next(one.samples for one in powers.references if one.carrier == "c05") == 8


def test_without_rows_or_beyond_the_ephemeris_there_are_no_references(payload):
    empty = payload.series(Window(ALIGNED_US, ALIGNED_US))
    powers = align(payload, empty)
    assert (powers.references, powers.changed) == ((), ())
    assert powers.consistency.probability == 1.0
    ended = payload.ephemeris(stop_us=WINDOW.start_us - HOUR)
    beyond = robust_references(payload.series(WINDOW), stated(), payload.calibration(), ended, CONFIG)
    assert beyond.references == ()


def test_carriers_that_the_method_does_not_use_get_a_reference_but_take_no_part(payload):
    calibration = payload.calibration(is_used=(False,) * 3 + (True,) * 9)
    series = moved(payload.series(WINDOW), np.where(np.arange(12) < 3, 6.0, 0.0))
    powers = align(payload, series, calibration=calibration)
    assert len(powers.references) == 12
    assert powers.changed == ()
    assert powers.consistency.carriers_tested == 9


def test_members_of_a_level_control_are_compared_by_their_differences(payload):
    group = (0, 0, 0) + (-1,) * 9
    level = payload.level_dbm.copy()
    level[:3] -= level[:3].mean()
    calibration = payload.calibration(alc_group=group, level_dbm=tuple(level.tolist()))
    series = moved(payload.series(WINDOW), np.where(np.arange(12) < 3, 2.5, 0.0))
    powers = align(payload, series, calibration=calibration)
    # their day is the mean of three days here, a few tenths of a decibel
    assert np.abs(told_of(powers)[:3] - level[:3]).max() < 0.5
    np.testing.assert_allclose(told_of(powers)[3:], level[3:], atol=0.05)


def test_a_calibration_that_is_not_by_geometry_is_refused(payload):
    calibration = payload.calibration(7)
    plain = replace(calibration, result=replace(calibration.result, geometry=None))
    for refused in (plain, replace(calibration, result=None)):
        with pytest.raises(ValueError, match="calibration 7 has no part by geometry"):
            align(payload, payload.series(WINDOW), calibration=refused)


def test_noise_of_several_correlation_times_leaves_its_share(payload):
    calibration = payload.calibration()
    slow = tuple(replace(one, noise=(NoiseComponent(36_000.0, 0.2),)) for one in calibration.result.carriers)
    noisy = replace(calibration, result=replace(calibration.result, carriers=slow))
    sigma = told_of(align(payload, payload.series(WINDOW), calibration=noisy), "sigma_db")
    quiet = told_of(align(payload, payload.series(WINDOW), calibration=calibration), "sigma_db")
    assert (sigma > quiet).all()
