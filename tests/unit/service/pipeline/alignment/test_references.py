"""References of the levels: alignment of the published and of the robust method."""

from dataclasses import replace

import numpy as np
import pytest
import synthetic_payload as synthetic
from geometry_flight import HOUR, MINUTE, START_US, FlightPayload, S
from paper_rows import expected_dbm, reject

from service.pipeline.alignment.alignment import align_methods, columns_of, reference_powers, robust_references
from service.pipeline.config import AlignmentConfig
from service.pipeline.estimation.paper.paper_model import expected_power, sensitivity_model
from service.pipeline.inputs.sensor_angles import StatedAngles
from service.records.calibration import CalibrationMethod, NoiseComponent, Window
from service.records.catalogue import Method
from service.records.levels.attitude import Axes
from service.records.levels.measurement import MeasurementSeries

ALIGNED_US = START_US + HOUR
WINDOW = Window(ALIGNED_US - 30 * MINUTE, ALIGNED_US + 1)
STATED = StatedAngles(ALIGNED_US, Axes(0.0, 0.0, 0.0), Axes(0.01, 0.005, 0.005))
PAYLOAD = FlightPayload.make(8)


def by_paper(calibration_id=2):
    """Return a calibration of the paper method: the same carriers without a fit by geometry."""
    calibration = PAYLOAD.calibration(calibration_id)
    request = replace(calibration.request, method=CalibrationMethod.PAPER)
    return replace(calibration, request=request, result=replace(calibration.result, geometry=None))


def align(series, *calibrations):
    active = {calibration.request.method: calibration for calibration in calibrations}
    return align_methods(series, STATED, active, PAYLOAD.ephemeris(), AlignmentConfig())


@pytest.mark.parametrize(
    ("calibrations", "by_method"),
    [
        pytest.param((PAYLOAD.calibration(1),), {"robust": 1, "paper": 1}, id="geometry serves both"),
        pytest.param((PAYLOAD.calibration(1), by_paper(2)), {"robust": 1, "paper": 2}, id="each its own"),
        pytest.param((by_paper(2),), {"paper": 2}, id="paper alone"),
    ],
)
def test_each_method_has_references_of_its_calibration(calibrations, by_method):
    powers = align(PAYLOAD.series(WINDOW), *calibrations)
    assert powers.calibration_by_method == by_method
    assert set(powers.references_by_method) == set(by_method)
    first = next(iter(by_method))
    assert powers.calibration.id == by_method[first]
    assert powers.references is powers.references_by_method[first]
    if "robust" in by_method:
        found = [one.reference_dbm for one in powers.references_by_method["robust"]]
        np.testing.assert_allclose(found, PAYLOAD.level_dbm, atol=1e-4)  # exact powers, cubic between knots
    # the paper's mean has one harmonic removed where the day has more: 0.1 dB
    found = [one.reference_dbm for one in powers.references_by_method["paper"]]
    offsets = [PAYLOAD.permuted([k]).harmonic().offset_dbm for k in range(8)]
    np.testing.assert_allclose(found, offsets, atol=0.2)


def test_columns_are_brought_into_the_order_of_a_calibration():
    series = PAYLOAD.series(WINDOW)
    turned = replace(series, carrier_ids=("new", *series.carrier_ids[:0:-1]), power_dbm=series.power_dbm[:, ::-1])
    turned = replace(turned, power_dbm=np.hstack([np.full((31, 1), -99.0), series.power_dbm[:, :0:-1]]))
    columns = columns_of(turned, PAYLOAD.calibration())
    assert columns.carrier_ids == PAYLOAD.ids
    assert np.isnan(columns.power_dbm[:, 0]).all()
    np.testing.assert_array_equal(columns.power_dbm[:, 1:], series.power_dbm[:, 1:])
    powers = align(turned, PAYLOAD.calibration())
    for references in powers.references_by_method.values():
        assert [one.carrier for one in references] == list(PAYLOAD.ids[1:])


def test_a_calibration_without_result_has_no_columns():
    assert columns_of(PAYLOAD.series(WINDOW), replace(PAYLOAD.calibration(), result=None)).power_dbm.shape == (31, 0)


CONFIG = AlignmentConfig()


def window(synthetic, after_h=60.0, length_s=1800):
    start_us = synthetic.START_US + int(after_h * synthetic.HOUR)
    return Window(start_us, start_us + length_s * S)


def stated(at_us, angles=(0.0, 0.0, 0.0), sigma=(0.01, 0.01, 0.01)):
    return StatedAngles(at_us, Axes(*angles), Axes(*sigma))


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
        deviation = power - expected_dbm(later_us, expected, ephemeris)
        model = sensitivity_model(calibration)
        fixes.append(reject(model.plus_db_per_deg, model.minus_db_per_deg, deviation).fix.attitude_deg)
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
    deviation = power - expected_dbm(later_us, expected, ephemeris)
    model = sensitivity_model(calibration)
    fix = reject(model.plus_db_per_deg, model.minus_db_per_deg, deviation).fix
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


AT_ZERO = (0.0, 0.0, 0.0)


@pytest.fixture
def twelve():
    """Twelve carriers."""
    return FlightPayload.make(12)


def stated_at(angles=AT_ZERO, rates=AT_ZERO, sigma=(0.01, 0.005, 0.005)):
    return StatedAngles(ALIGNED_US, Axes(*angles), Axes(*sigma), Axes(*rates))


def robust(twelve, series, reported=None, calibration=None, config=CONFIG):
    return robust_references(
        series, reported or stated_at(), calibration or twelve.calibration(), twelve.ephemeris(), config
    )


def moved(series, change_db):
    return replace(series, power_dbm=series.power_dbm + np.asarray(change_db))


def told_of(powers, name="reference_dbm"):
    return np.array([getattr(one, name) for one in powers.references])


@pytest.mark.parametrize("angles", [AT_ZERO, (0.2, -0.3, 0.25)], ids=["at zero", "turned"])
def test_references_are_the_levels_at_zero_attitude(twelve, angles):
    powers = robust(twelve, twelve.series(WINDOW, angles), stated_at(angles))
    # second order of the turn, 0.002 deg at 0.4, times a slope of 3 dB/deg
    np.testing.assert_allclose(told_of(powers), twelve.level_dbm, atol=0.01)
    np.testing.assert_allclose(told_of(powers, "change_since_calibration_db"), 0.0, atol=0.01)
    assert powers.changed == ()
    assert powers.consistency.probability > 0.01
    np.testing.assert_array_equal(told_of(powers, "samples"), 31)


def test_a_craft_that_turns_during_the_window_is_followed(twelve):
    epochs_us = np.arange(WINDOW.start_us, WINDOW.stop_us, 60 * S)
    rates = np.array([1e-5, 1e-4, -5e-5])
    angles = ((epochs_us - ALIGNED_US) / S)[:, None] * rates
    still = twelve.series(WINDOW)
    series = replace(still, power_dbm=twelve.power_dbm(epochs_us, angles))
    followed = robust(twelve, series, stated_at(rates=rates.tolist()))
    np.testing.assert_allclose(told_of(followed), twelve.level_dbm, atol=0.005)
    ignored = robust(twelve, series)
    # 0.09 deg on the mean
    assert np.abs(told_of(ignored) - twelve.level_dbm).max() > 0.02


def test_calibration_and_window_are_weighed_by_their_variances(twelve):
    change = 0.04 * np.random.default_rng(5).choice([-1.0, 1.0], 12)
    change -= np.median(change)
    angle_deg = np.array([0.01, 0.005, 0.005])
    powers = robust(twelve, moved(twelve.series(WINDOW), change))
    hours = (ALIGNED_US - twelve.request.quiet.stop_us) / HOUR
    calibration_db2 = 0.02**2 + 0.006**2 * hours
    seen = twelve.power_dbm([ALIGNED_US] * 6, np.vstack([np.eye(3), -np.eye(3)]) * 0.01)
    slope = (seen[:3] - seen[3:]).T / 0.02
    white_db2 = 0.05**2 / 31

    def kept(tau_s, sigma_db):
        x = 1800.0 / tau_s
        return sigma_db**2 * 2.0 * (x - 1.0 + np.exp(-x)) / x**2

    window_db2 = white_db2 + kept(1200.0, 0.02) + kept(7200.0, 0.01) + slope**2 @ angle_deg**2
    weight = window_db2 / (calibration_db2 + window_db2)
    np.testing.assert_allclose(told_of(powers), twelve.level_dbm + (1.0 - weight) * change, atol=2e-4)
    wanted = np.sqrt(calibration_db2 * window_db2 / (calibration_db2 + window_db2))
    np.testing.assert_allclose(told_of(powers, "sigma_db"), wanted, rtol=0.01)
    # both matter in this test
    assert ((weight > 0.1) & (weight < 0.9)).all()


def test_an_older_calibration_counts_less(twelve):
    change = np.where(np.arange(12) % 2, 0.03, -0.03)
    series = moved(twelve.series(WINDOW), change)
    fresh = twelve.calibration()
    quiet = fresh.request.quiet
    month_us = 30 * 24 * HOUR
    aged_window = Window(quiet.start_us - month_us, quiet.stop_us - month_us)
    aged = replace(fresh, request=replace(fresh.request, quiet=aged_window))
    near = np.abs(told_of(robust(twelve, series, calibration=aged)) - twelve.level_dbm - change)
    far = np.abs(told_of(robust(twelve, series, calibration=fresh)) - twelve.level_dbm - change)
    assert (near < far).all()


def test_what_all_carriers_have_in_common_is_the_receiving_chains_and_comes_from_the_window(twelve):
    powers = robust(twelve, moved(twelve.series(WINDOW), 1.7))
    np.testing.assert_allclose(told_of(powers), twelve.level_dbm + 1.7, atol=1e-4)
    assert powers.changed == ()
    assert powers.consistency.probability > 0.5


def test_a_user_who_re_levelled_takes_the_window_and_is_named(twelve):
    change = np.zeros(12)
    change[3], change[8] = 0.8, 1.1
    powers = robust(twelve, moved(twelve.series(WINDOW), change))
    assert powers.changed == ("c03", "c08")
    np.testing.assert_allclose(told_of(powers), twelve.level_dbm + change, atol=1e-4)
    # with the window's own uncertainty, which is more than that of both together
    sigma = told_of(powers, "sigma_db")
    assert sigma[3] > 0.01
    assert powers.consistency.probability > 0.01
    assert powers.consistency.carriers_tested == 10


def test_a_lower_level_is_wet_while_the_calibration_is_young(twelve):
    change = np.where(np.arange(12) == 8, -1.1, 0.0)
    powers = robust(twelve, moved(twelve.series(WINDOW), change))
    assert powers.changed == ("c08",)
    np.testing.assert_allclose(told_of(powers), twelve.level_dbm, atol=1e-3)
    old = robust(twelve, moved(twelve.series(WINDOW), change), config=replace(CONFIG, wet_level_h=0.0))
    np.testing.assert_allclose(told_of(old), twelve.level_dbm + change, atol=1e-3)


def test_powers_of_another_attitude_contradict(twelve):
    powers = robust(twelve, twelve.series(WINDOW, (0.0, 0.15, -0.2)))
    assert powers.consistency.probability < 1e-4
    # the offset is told in degrees; levels walked since the calibration, which weighs carriers unevenly
    np.testing.assert_allclose(powers.consistency.offset_deg[1:], [0.15, -0.2], atol=0.02)


def test_when_most_levels_moved_all_take_part_in_the_test(twelve):
    change = np.where(np.arange(12) < 5, 1.5, 0.0)
    powers = robust(twelve, moved(twelve.series(WINDOW), change))
    assert len(powers.changed) == 5
    assert powers.consistency.carriers_tested == 12


def test_impulses_do_not_enter_the_mean(twelve):
    series = twelve.series(WINDOW)
    power = series.power_dbm + 0.02 * np.random.default_rng(3).normal(size=series.power_dbm.shape)
    power[::7, 4] += 20.0
    powers = robust(twelve, replace(series, power_dbm=power))
    assert powers.references[4].samples == 26
    np.testing.assert_allclose(told_of(powers), twelve.level_dbm, atol=0.02)


def test_carriers_with_too_few_rows_have_no_reference(twelve):
    series = twelve.series(WINDOW)
    power = series.power_dbm.copy()
    power[:, 1] = np.nan
    power[7:, 2] = np.nan
    power[8:, 5] = np.nan
    powers = robust(twelve, replace(series, power_dbm=power))
    assert [one.carrier for one in powers.references] == [f"c{k:02d}" for k in range(12) if k not in (1, 2)]
    assert next(one.samples for one in powers.references if one.carrier == "c05") == 8


def test_without_rows_or_beyond_the_ephemeris_there_are_no_references(twelve):
    empty = twelve.series(Window(ALIGNED_US, ALIGNED_US))
    powers = robust(twelve, empty)
    assert (powers.references, powers.changed) == ((), ())
    assert powers.consistency.probability == 1.0
    ended = twelve.ephemeris(stop_us=WINDOW.start_us - HOUR)
    beyond = robust_references(twelve.series(WINDOW), stated_at(), twelve.calibration(), ended, CONFIG)
    assert beyond.references == ()


def test_carriers_that_the_method_does_not_use_get_a_reference_but_take_no_part(twelve):
    calibration = twelve.calibration(is_used=(False,) * 3 + (True,) * 9)
    series = moved(twelve.series(WINDOW), np.where(np.arange(12) < 3, 6.0, 0.0))
    powers = robust(twelve, series, calibration=calibration)
    assert len(powers.references) == 12
    assert powers.changed == ()
    assert powers.consistency.carriers_tested == 9


def test_members_of_a_level_control_are_compared_by_their_differences(twelve):
    group = (0, 0, 0) + (-1,) * 9
    level = twelve.level_dbm.copy()
    level[:3] -= level[:3].mean()
    calibration = twelve.calibration(alc_group=group, level_dbm=tuple(level.tolist()))
    series = moved(twelve.series(WINDOW), np.where(np.arange(12) < 3, 2.5, 0.0))
    powers = robust(twelve, series, calibration=calibration)
    # their day is the mean of three days here, a few tenths of a decibel
    assert np.abs(told_of(powers)[:3] - level[:3]).max() < 0.5
    np.testing.assert_allclose(told_of(powers)[3:], level[3:], atol=0.05)


def test_a_calibration_that_is_not_by_geometry_is_refused(twelve):
    calibration = twelve.calibration(7)
    plain = replace(calibration, result=replace(calibration.result, geometry=None))
    for refused in (plain, replace(calibration, result=None)):
        with pytest.raises(ValueError, match="calibration 7 has no part by geometry"):
            robust(twelve, twelve.series(WINDOW), calibration=refused)


def test_noise_of_several_correlation_times_leaves_its_share(twelve):
    calibration = twelve.calibration()
    slow = tuple(replace(one, noise=(NoiseComponent(36_000.0, 0.2),)) for one in calibration.result.carriers)
    noisy = replace(calibration, result=replace(calibration.result, carriers=slow))
    sigma = told_of(robust(twelve, twelve.series(WINDOW), calibration=noisy), "sigma_db")
    quiet = told_of(robust(twelve, twelve.series(WINDOW), calibration=calibration), "sigma_db")
    assert (sigma > quiet).all()
