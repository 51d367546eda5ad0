"""Calibration by the paper method: known figures come back, and what is missing is said in words."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import synthetic_payload as synthetic

from service.core.estimation.paper.selection import CarrierVerdicts
from service.pipeline.calibration.geometry_rows import CalibrationError
from service.pipeline.calibration.paper_calibration import calibrate_paper, observe, select_carriers
from service.pipeline.config import CalibrationConfig, CriteriaConfig
from service.records.calibration import Window

CONFIG = CalibrationConfig()


def without_carrier(series, k):
    power = series.power_dbm.copy()
    power[:, k] = np.nan
    return replace(series, power_dbm=power)


def test_a_noise_free_payload_comes_back(payload):
    result = calibrate_paper(payload.calibration_input(), CONFIG)
    for k, carrier in enumerate(result.carriers):
        # least squares of exact data; powers of 50 dB in double, slopes from turns of half a degree
        assert carrier.harmonic.amplitude_db == pytest.approx(payload.amplitude_db[k], abs=1e-9)
        assert np.exp(1j * (carrier.harmonic.phase_rad - payload.phase_rad[k])) == pytest.approx(1.0, abs=1e-8)
        assert carrier.level_dbm == pytest.approx(payload.level_dbm[k], abs=1e-9)
        np.testing.assert_allclose(carrier.sensitivity_plus_db_per_deg, payload.plus[k], atol=1e-8)
        np.testing.assert_allclose(carrier.sensitivity_minus_db_per_deg, payload.minus[k], atol=1e-8)
        mean = 0.5 * (payload.plus[k] + payload.minus[k])
        np.testing.assert_allclose(carrier.sensitivity_db_per_deg, mean, atol=1e-8)
        assert carrier.harmonic.period_s == payload.ephemeris().nodal_period_s
        assert carrier.harmonic.node_epoch_us in payload.ephemeris().ascending_nodes_us
    assert [carrier.id for carrier in result.carriers] == list(payload.ids)
    assert all(carrier.selected for carrier in result.carriers)


def test_noise_is_found_and_slopes_stay_within_what_it_allows(payload):
    result = calibrate_paper(payload.calibration_input(noise_db=0.15), CONFIG)
    for k, carrier in enumerate(result.carriers):
        # 740 rows: sigma of an rms is 2.6 %, four of them; white noise of that size
        assert carrier.stability_residual_rms_db == pytest.approx(0.15, rel=0.11)
        whole = np.hypot(carrier.sigma_white_db, sum(part.sigma_db for part in carrier.noise))
        assert whole == pytest.approx(carrier.stability_residual_rms_db, rel=0.02)
        # a side has about 80 rows of 0.37 deg rms: 0.15 / (0.37 sqrt 80) = 0.045 dB/deg, four sigma
        np.testing.assert_allclose(carrier.sensitivity_plus_db_per_deg, payload.plus[k], atol=0.2)
        np.testing.assert_allclose(carrier.sensitivity_minus_db_per_deg, payload.minus[k], atol=0.2)
        assert abs(carrier.drift_db_per_day) < 0.05
    assert result.quality["turn_reach_deg"] == 0.5
    assert result.quality["quiet_rows"] == len(payload.calibration_input().quiet.epochs_us)
    assert result.quality["median_residual_rms_db"] == pytest.approx(0.15, rel=0.05)


def test_few_carriers_are_warned_of_and_enough_are_not(payload):
    few = calibrate_paper(payload.calibration_input(0.05), CONFIG)
    assert len(few.warnings) == 1
    assert "only 12 carriers are stable and linear; 16 are advised" in few.warnings[0]
    enough = calibrate_paper(
        payload.calibration_input(0.05), CalibrationConfig(criteria=CriteriaConfig(min_selected=12))
    )
    assert enough.warnings == ()


def test_a_short_quiet_window_is_warned_of(payload):
    data = payload.calibration_input(0.05)
    short = Window(synthetic.START_US, synthetic.START_US + synthetic.DAY)
    found = calibrate_paper(replace(data, quiet=payload.series(short, step_s=240, noise_db=0.05)), CONFIG)
    assert any("quiet window of 23.9 h is shorter than 48.0 h" in warning for warning in found.warnings)


def test_a_carrier_that_was_silent_is_warned_of_and_left_out(payload):
    data = payload.calibration_input(0.05)
    data = replace(data, quiet=without_carrier(data.quiet, 2), turns=without_carrier(data.turns, 2))
    result = calibrate_paper(data, CONFIG)
    assert "no fit for c02: absent in the quiet window" in result.warnings
    silent = result.carriers[2]
    assert not silent.selected
    assert np.isnan(silent.level_dbm)
    assert np.isnan(silent.drift_db_per_day)
    assert any("not stable" in reason for reason in silent.rejected_because)
    assert [carrier.selected for carrier in result.carriers].count(True) == 11


def test_an_archive_without_any_power_makes_a_calibration_that_selects_nothing(payload):
    data = payload.calibration_input()
    empty = np.full_like(data.quiet.power_dbm, np.nan), np.full_like(data.turns.power_dbm, np.nan)
    data = replace(data, quiet=replace(data.quiet, power_dbm=empty[0]), turns=replace(data.turns, power_dbm=empty[1]))
    result = calibrate_paper(data, CONFIG)
    assert result.quality["carriers_selected"] == 0.0
    assert np.isnan(result.quality["median_residual_rms_db"])
    assert np.isnan(result.observability.condition)


def test_an_unusable_carrier_is_measured_but_not_selected_and_says_why(payload):
    data = payload.calibration_input(0.05)
    carriers = (replace(data.plan.carriers[0], uplink_power_control="auto"), *data.plan.carriers[1:])
    result = calibrate_paper(replace(data, plan=replace(data.plan, carriers=carriers)), CONFIG)
    assert not result.carriers[0].selected
    assert "not usable for attitude" in result.carriers[0].rejected_because[0]
    assert np.isfinite(result.carriers[0].sensitivity_db_per_deg).all()


def test_a_noisy_carrier_is_rejected_with_its_figure(payload):
    data = payload.calibration_input(0.05)
    power = data.quiet.power_dbm.copy()
    power[:, 4] += np.random.default_rng(3).normal(0.0, 0.4, len(power))
    result = calibrate_paper(replace(data, quiet=replace(data.quiet, power_dbm=power)), CONFIG)
    assert not result.carriers[4].selected
    assert result.carriers[4].rejected_because[0].startswith("not stable: residual rms 0.3")


# ---- what is missing is said ----------------------------------------------------------------------------------------


def refusal(data):
    with pytest.raises(CalibrationError) as caught:
        calibrate_paper(data, CONFIG)
    return str(caught.value)


@pytest.mark.parametrize("rows", [0, 2])
def test_a_quiet_window_without_rows(payload, rows):
    data = payload.calibration_input()
    cut = replace(data.quiet, epochs_us=data.quiet.epochs_us[:rows], power_dbm=data.quiet.power_dbm[:rows])
    assert f"the quiet window holds {rows} measurements" in refusal(replace(data, quiet=cut))


def test_a_window_of_turns_without_rows(payload):
    data = payload.calibration_input()
    cut = replace(data.turns, epochs_us=data.turns.epochs_us[:59], power_dbm=data.turns.power_dbm[:59])
    assert "the window of turns holds 59 measurements, 60 are needed" in refusal(replace(data, turns=cut))


def test_a_silent_star_tracker(payload):
    data = payload.calibration_input()
    text = refusal(replace(data, references=()))
    assert "only 0 rows of the window of turns have angles of star_tracker" in text
    assert "send the sensor's references or name another source" in text


def test_a_star_tracker_that_saw_one_angle_once(payload):
    data = payload.calibration_input()
    angles = data.references[0].attitude_deg.copy()
    angles[1:, 0] = np.nan
    assert "only 0 rows" in refusal(replace(data, references=(replace(data.references[0], attitude_deg=angles),)))


def test_readings_too_far_from_the_rows_do_not_count(payload):
    data = payload.calibration_input()
    track = data.references[0]
    sparse = replace(
        track, epochs_us=track.epochs_us[::60], attitude_deg=track.attitude_deg[::60], sigma_deg=track.sigma_deg[::60]
    )
    assert "rows of the window of turns have angles" in refusal(replace(data, references=(sparse,)))


@pytest.mark.parametrize(("axis", "side", "name"), [(0, 1, "+yaw"), (1, -1, "-roll"), (2, 1, "+pitch")])
def test_an_axis_that_was_not_turned_to_a_side(payload, axis, side, name):
    data = payload.calibration_input()
    angles = data.references[0].attitude_deg.copy()
    angles[side * angles[:, axis] > 0.0, axis] = 0.0
    text = refusal(replace(data, references=(replace(data.references[0], attitude_deg=angles),)))
    assert f"no turn of at least 0.1 deg towards {name} in the window of turns" in text


def test_each_angle_may_come_from_a_sensor_of_its_own(payload):
    data = payload.calibration_input()
    track = data.references[0]
    beacon, earth = track.attitude_deg.copy(), track.attitude_deg.copy()
    beacon[:, 1:], earth[:, 0] = np.nan, np.nan
    data = replace(
        data,
        request=replace(
            data.request, source_yaw="radio_beacon", source_roll="earth_sensor", source_pitch="earth_sensor"
        ),
        references=(
            replace(track, source="radio_beacon", attitude_deg=beacon),
            replace(track, source="earth_sensor", attitude_deg=earth),
        ),
    )
    result = calibrate_paper(data, CONFIG)
    found = np.array([carrier.sensitivity_plus_db_per_deg for carrier in result.carriers])
    np.testing.assert_allclose(found, payload.plus, atol=1e-8)  # noise-free, as above


# ---- choice of carriers ---------------------------------------------------------------------------------------------


def verdicts(stable, linear, dominant, ratio):
    count = len(ratio)
    nothing = np.zeros(count)
    return CarrierVerdicts(
        np.array(stable, dtype=bool),
        np.array(linear, dtype=bool),
        np.array(dominant, dtype=bool),
        np.zeros(count, dtype=np.int64),
        np.array(ratio, dtype=float),
        *(nothing,) * 5,
    )


def test_all_that_meet_the_criteria_enter_and_mixed_ones_fill_up_most_dominant_first():
    found = verdicts([1] * 6, [1, 1, 1, 1, 0, 1], [1, 0, 0, 0, 1, 1], [3.0, 1.2, 1.9, 1.5, 4.0, np.nan])
    usable = np.ones(6, dtype=bool)
    chosen = [
        np.flatnonzero(select_carriers(found, usable, CriteriaConfig(min_selected=n))).tolist() for n in range(1, 7)
    ]
    assert chosen[:4] == [[0], [0, 2], [0, 2, 3], [0, 1, 2, 3]]
    assert chosen[4] == chosen[5] == [0, 1, 2, 3]
    assert all(set(less) <= set(more) for less, more in pairwise(chosen))


def test_dominant_ones_are_never_left_out_for_being_many():
    found = verdicts([1] * 5, [1] * 5, [1] * 5, [3.0] * 5)
    assert select_carriers(found, np.ones(5, dtype=bool), CriteriaConfig(min_selected=2)).all()


def test_fewer_than_four_carriers_see_nothing():
    seen = observe(np.ones((3, 3)), np.full(3, 0.1))
    assert np.isnan([seen.condition, *seen.dop, *seen.crlb_deg]).all()


def test_what_the_carriers_see_is_the_bound_with_a_common_unknown(payload):
    seen = observe(payload.plus, np.full(12, 0.2))
    design = np.column_stack([payload.plus, np.ones(12)])
    bound = 0.2 * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))[:3]
    np.testing.assert_allclose(seen.crlb_deg, bound, rtol=1e-9)  # the same matrix by another route
    assert seen.condition > 1.0
    assert (np.array(seen.crlb_deg) >= 0.2 * np.array(seen.dop) * (1 - 1e-9)).all()
