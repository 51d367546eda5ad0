"""Alignment: angles read from sensors, references from powers with the harmonic removed, contradictions found."""

from dataclasses import replace

import numpy as np
import pytest
import synthetic_payload as synthetic

from service.pipeline.alignment.paper_references import reference_powers
from service.pipeline.config import AlignmentConfig, EstimationConfig
from service.pipeline.estimation.paper.harmonic_removal import expected_power, remove_harmonic
from service.pipeline.estimation.paper.snapshot_fix import sensitivity_model, solve_attitude
from service.pipeline.inputs.reference_angles import StatedAngles, smooth_angles
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.levels.attitude import Axes
from service.records.levels.series import MeasurementSeries, ReferenceSeries

S = 1_000_000
TRACKER = ("star_tracker",) * 3
CONFIG = AlignmentConfig()
ZERO = np.zeros(3)


def window(synthetic, after_h=60.0, length_s=1800):
    start_us = synthetic.START_US + int(after_h * synthetic.HOUR)
    return Window(start_us, start_us + length_s * S)


def stated(at_us, angles=(0.0, 0.0, 0.0), sigma=(0.01, 0.01, 0.01)):
    return StatedAngles(at_us, Axes(*angles), Axes(*sigma))


# ---- angles ---------------------------------------------------------------------------------------------------------


def test_the_angles_are_a_straight_line_read_at_the_newest_reference():
    epochs_us = np.arange(30) * 60 * S
    angles = np.array([0.1, -0.2, 0.3]) + np.outer(np.arange(30), [1e-3, 2e-3, -1e-3])
    series = ReferenceSeries("star_tracker", epochs_us, angles, np.full((30, 3), 0.01))
    found, missing = smooth_angles((series,), TRACKER)
    assert missing == ()
    assert found.epoch_us == epochs_us[-1]
    np.testing.assert_allclose(found.attitude_deg, angles[-1], atol=1e-12)  # exact line
    # variance of a line of n points at its end: (4 n - 2) / (n (n + 1)) of one reading's
    np.testing.assert_allclose(found.sigma_deg, 0.01 * np.sqrt(118.0 / (30 * 31)), rtol=1e-9)


def test_few_readings_are_averaged_and_an_unstated_sigma_is_assumed():
    angles = np.array([[0.1, 0.2, 0.3], [0.3, 0.2, 0.1]])
    series = ReferenceSeries("star_tracker", np.array([5, 7]), angles, np.full((2, 3), np.nan))
    found, _ = smooth_angles((series,), TRACKER)
    np.testing.assert_allclose(found.attitude_deg, [0.2, 0.2, 0.2], atol=1e-12)
    np.testing.assert_allclose(found.sigma_deg, 0.05 / np.sqrt(2), rtol=1e-12)


def test_many_readings_of_one_instant_are_averaged():
    series = ReferenceSeries("star_tracker", np.full(9, 5), np.full((9, 3), 0.1), np.full((9, 3), 0.03))
    found, _ = smooth_angles((series,), TRACKER)
    np.testing.assert_allclose(found.attitude_deg, 0.1, rtol=1e-12)
    np.testing.assert_allclose(found.sigma_deg, 0.01, rtol=1e-12)


def test_axes_may_come_from_sensors_of_their_own_and_end_at_different_times():
    nan = np.full((3, 1), np.nan)
    earth = ReferenceSeries(
        "earth_sensor", np.array([1, 2, 3]), np.hstack([nan, np.full((3, 2), 0.2)]), np.full((3, 3), 0.03)
    )
    beacon = ReferenceSeries("radio_beacon", np.array([1, 9]), np.array([[0.4, 9, 9], [0.4, 9, 9]]), np.ones((2, 3)))
    found, _ = smooth_angles((earth, beacon), ("radio_beacon", "earth_sensor", "earth_sensor"))
    assert found.epoch_us == 9
    np.testing.assert_allclose(found.attitude_deg, [0.4, 0.2, 0.2], rtol=1e-12)


def test_axes_that_no_reference_covers_are_named():
    earth = ReferenceSeries("earth_sensor", np.array([1]), np.array([[np.nan, 0.1, 0.2]]), np.full((1, 3), 0.03))
    assert smooth_angles((earth,), ("earth_sensor",) * 3) == (None, ("yaw",))
    assert smooth_angles((earth,), ("earth_sensor", "earth_sensor", "star_tracker")) == (None, ("yaw", "pitch"))
    assert smooth_angles((), TRACKER) == (None, ("yaw", "roll", "pitch"))


# ---- references -----------------------------------------------------------------------------------------------------


def test_references_are_mean_powers_with_the_harmonic_removed(payload):
    of = window(synthetic)
    powers = reference_powers(
        payload.series(of), stated(of.stop_us), payload.calibration(), payload.ephemeris(), CONFIG
    )
    assert [item.carrier for item in powers.references] == list(payload.ids)
    # rounding of means of 50 dBm
    np.testing.assert_allclose([item.reference_dbm for item in powers.references], payload.level_dbm, atol=1e-12)
    np.testing.assert_allclose([item.change_since_calibration_db for item in powers.references], 0.0, atol=1e-12)
    assert {item.samples for item in powers.references} == {30}
    # 30 rows of 0.05 dB white; every second carrier has 0.02 dB of slow noise on top
    np.testing.assert_allclose([item.sigma_db for item in powers.references][::2], 0.05 / np.sqrt(30), rtol=1e-9)
    assert all(item.sigma_db > 0.012 for item in powers.references[1::2])
    assert powers.consistency.probability == pytest.approx(1.0, abs=1e-6)
    assert powers.changed == ()


def test_a_carrier_with_too_few_rows_gets_no_reference(payload):
    series = payload.series(window(synthetic))
    power = series.power_dbm.copy()
    power[7:, 3] = np.nan
    powers = reference_powers(
        replace(series, power_dbm=power), stated(0), payload.calibration(), payload.ephemeris(), CONFIG
    )
    assert [item.carrier for item in powers.references] == [name for name in payload.ids if name != "c03"]


def test_a_window_without_rows_gives_no_references_and_no_verdict(payload):
    empty = MeasurementSeries(payload.ids, np.zeros(0, dtype=np.int64), np.zeros((0, 12)))
    powers = reference_powers(empty, stated(0), payload.calibration(), payload.ephemeris(), CONFIG)
    assert powers.references == ()
    assert (powers.consistency.carriers_tested, powers.changed) == (0, ())


def test_an_unfinished_calibration_gives_no_references(payload):
    empty = MeasurementSeries((), np.zeros(0, dtype=np.int64), np.zeros((0, 0)))
    powers = reference_powers(
        empty, stated(0), replace(payload.calibration(), result=None), payload.ephemeris(), CONFIG
    )
    assert powers.references == ()


def test_the_phase_at_which_one_aligns_does_not_matter(payload):
    """Alignment at eight phases of the harmonic, noise-free: the same fix afterwards."""
    calibration, ephemeris = payload.calibration(), payload.ephemeris()
    truth = np.array([0.1, -0.12, 0.15])
    later_us = synthetic.START_US + 4 * synthetic.DAY
    power = payload.power_dbm(np.array([later_us]), truth)[0]
    fixes = []
    for k in range(8):
        of = window(synthetic, after_h=60.0 + 3.0 * k, length_s=900)
        found = reference_powers(payload.series(of), stated(of.stop_us), calibration, ephemeris, CONFIG)
        alignment = replace(payload.alignment(of.stop_us), references=found.references)
        expected = expected_power(calibration, alignment, Method.PAPER, ephemeris, calibration)
        deviation = remove_harmonic(power, later_us, expected, ephemeris).deviation_db
        fix = solve_attitude(later_us, deviation, 15, 840.0, sensitivity_model(calibration), EstimationConfig())
        fixes.append(fix.attitude_deg)
    spread = np.ptp(np.array(fixes), axis=0)
    # the stated bound is 1e-3 deg in roll and pitch; without noise it is rounding
    assert spread[1:].max() <= 1e-3
    np.testing.assert_allclose(fixes, np.tile(truth, (8, 1)), atol=1e-9)


@pytest.mark.parametrize("angles", [(0.2, -0.15, 0.2), (-0.3, 0.3, 0.1), (0.0, 0.0, 0.0)])
def test_an_alignment_away_from_zero_reports_the_angles_that_the_craft_has(payload, angles):
    """Held at .2/-.15/.2, means of the window alone gave .013/-.005/.002 at a sigma of .002."""
    calibration, ephemeris, truth = payload.calibration(), payload.ephemeris(), np.array(angles)
    of = window(synthetic)
    found = reference_powers(payload.series(of, truth), stated(of.stop_us, angles), calibration, ephemeris, CONFIG)
    np.testing.assert_allclose([item.reference_dbm for item in found.references], payload.level_dbm, atol=1e-9)
    np.testing.assert_allclose([item.change_since_calibration_db for item in found.references], 0.0, atol=1e-9)
    alignment = replace(payload.alignment(of.stop_us), references=found.references)
    expected = expected_power(calibration, alignment, Method.PAPER, ephemeris, calibration)
    later_us = of.stop_us + 60 * S
    power = payload.power_dbm(np.array([later_us]), truth)[0]
    deviation = remove_harmonic(power, later_us, expected, ephemeris).deviation_db
    fix = solve_attitude(later_us, deviation, 15, 840.0, sensitivity_model(calibration), EstimationConfig())
    np.testing.assert_allclose(fix.attitude_deg, truth, atol=1e-9)


def test_an_attitude_that_moves_over_the_window_is_removed_along_its_line(payload):
    of = window(synthetic)
    epochs_us = payload.series(of).epochs_us
    rate = np.array([2e-5, -1e-5, 5e-5])
    moving = np.array([0.2, -0.15, 0.2]) + np.outer((epochs_us - epochs_us[-1]) / S, rate)
    series = replace(payload.series(of), power_dbm=payload.power_dbm(epochs_us, moving))
    reported = stated(int(epochs_us[-1]), tuple(moving[-1]))._replace(rate_deg_s=Axes(*rate))
    found = reference_powers(series, reported, payload.calibration(), payload.ephemeris(), CONFIG)
    np.testing.assert_allclose([item.reference_dbm for item in found.references], payload.level_dbm, atol=1e-9)


def test_an_axis_that_was_not_turned_leaves_the_references_finite(payload):
    of, calibration = window(synthetic), payload.calibration()
    unturned = tuple(
        replace(
            carrier,
            sensitivity_plus_db_per_deg=carrier.sensitivity_plus_db_per_deg._replace(yaw=float("nan")),
            sensitivity_minus_db_per_deg=carrier.sensitivity_minus_db_per_deg._replace(yaw=float("nan")),
        )
        for carrier in calibration.result.carriers
    )
    calibration = replace(calibration, result=replace(calibration.result, carriers=unturned))
    found = reference_powers(payload.series(of), stated(of.stop_us), calibration, payload.ephemeris(), CONFIG)
    np.testing.assert_allclose([item.reference_dbm for item in found.references], payload.level_dbm, atol=1e-9)


# ---- contradiction --------------------------------------------------------------------------------------------------


def test_powers_at_other_angles_than_stated_are_a_contradiction_and_tell_which(payload):
    of = window(synthetic)
    truth = np.array([0.0, 0.3, -0.3])
    powers = reference_powers(
        payload.series(of, truth), stated(of.stop_us), payload.calibration(), payload.ephemeris(), CONFIG
    )
    assert powers.consistency.probability < CONFIG.min_probability
    # slopes of the other sign are up to 40 % off, so the size is only roughly told
    assert powers.consistency.offset_deg[1] > 0.15
    assert powers.consistency.offset_deg[2] < -0.15


def test_the_same_powers_agree_with_the_angles_they_were_taken_at(payload):
    of = window(synthetic)
    truth = (0.1, 0.3, -0.3)
    powers = reference_powers(
        payload.series(of, truth), stated(of.stop_us, truth), payload.calibration(), payload.ephemeris(), CONFIG
    )
    assert powers.consistency.probability == pytest.approx(1.0, abs=1e-6)  # exact but for rounding


def test_a_user_who_changed_his_level_is_named_and_does_not_contradict(payload):
    of = window(synthetic)
    series = payload.series(of)
    series.power_dbm[:, 5] += 1.5
    powers = reference_powers(series, stated(of.stop_us), payload.calibration(), payload.ephemeris(), CONFIG)
    assert powers.changed == ("c05",)
    assert powers.consistency.probability > 0.99
    assert powers.references[5].change_since_calibration_db == pytest.approx(1.5, abs=1e-9)


def test_an_unstated_sigma_of_an_angle_does_not_switch_the_test_off(payload):
    of = window(synthetic)
    unknown = stated(of.stop_us, sigma=(float("nan"),) * 3)
    powers = reference_powers(
        payload.series(of, np.array([0.0, 0.4, -0.4])), unknown, payload.calibration(), payload.ephemeris(), CONFIG
    )
    assert powers.consistency.carriers_tested == 12
    assert powers.consistency.probability < CONFIG.min_probability


def test_carriers_that_are_not_selected_are_not_asked(payload):
    of = window(synthetic)
    powers = reference_powers(
        payload.series(of, np.array([0.0, 0.3, -0.3])),
        stated(of.stop_us),
        payload.calibration(selected=False),
        payload.ephemeris(),
        CONFIG,
    )
    assert powers.consistency.carriers_tested == 0
    assert len(powers.references) == 12
