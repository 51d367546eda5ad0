"""Errors of the instrument itself."""

from dataclasses import replace

import numpy as np
import pytest

from analyzer_sim.instrument.imperfections import IDEAL, Imperfections, LevelErrors

HOUR_US = 3_600_000_000


def errors_db(figures: Imperfections, seed: int, count: int = 2000, step_us: int = 60_000_000) -> np.ndarray:
    errors = LevelErrors(figures, seed)
    return np.array([errors.sweep_error_db(k * step_us, 30e3, 0.0) for k in range(count)])


def test_default_instrument_scatters_by_nine_hundredths_of_a_decibel_over_a_day_and_two_from_sweep_to_sweep() -> None:
    series = [errors_db(Imperfections(), seed, 1440) for seed in range(8)]
    # wander .05, day .1 / sqrt(2), repeatability .02; a day holds some twelve independent gain values
    assert np.mean([one.std() for one in series]) == pytest.approx(0.087, abs=0.008)
    steps = [np.diff(one).std() / np.sqrt(2.0) for one in series]
    assert np.mean(steps) == pytest.approx(0.021, abs=0.002)  # repeatability .02 and a minute of wander .006


def test_absolute_offset_is_drawn_once_per_instrument() -> None:
    figures = Imperfections(repeatability_sigma_db=0, wander_sigma_db=0, daily_swing_deg_c=0, rbw_switching_sigma_db=0,
                            attenuator_sigma_db=0)  # fmt: skip
    offsets = [errors_db(figures, seed, 3) for seed in range(200)]
    assert all(np.ptp(offset) == 0.0 for offset in offsets)
    assert np.std([offset[0] for offset in offsets]) == pytest.approx(0.25, rel=0.15)  # 200 draws: 5 % each sigma


def test_ideal_instrument_has_no_error() -> None:
    assert np.all(errors_db(IDEAL, 1, 10) == 0.0)
    assert np.all(LevelErrors(IDEAL, 1).ripple_db(np.linspace(0, 1e9, 100)) == 0.0)


def test_gain_wanders_with_its_correlation_time_and_stands_while_the_clock_stands() -> None:
    figures = Imperfections(absolute_sigma_db=0, repeatability_sigma_db=0, daily_swing_deg_c=0,
                            rbw_switching_sigma_db=0, attenuator_sigma_db=0, wander_sigma_db=0.05)  # fmt: skip
    series = errors_db(figures, 3, 20000, HOUR_US // 4)
    assert series.std() == pytest.approx(0.05, rel=0.1)  # 5000 correlation times
    lag_hour = np.corrcoef(series[4:], series[:-4])[0, 1]
    assert lag_hour == pytest.approx(np.exp(-1.0), abs=0.05)
    assert np.ptp(errors_db(figures, 3, 10, 0)) == 0.0


def test_switch_positions_err_alike_every_time() -> None:
    figures = Imperfections(absolute_sigma_db=0, repeatability_sigma_db=0, daily_swing_deg_c=0, wander_sigma_db=0)
    errors = LevelErrors(figures, 5)
    first = [errors.sweep_error_db(0, rbw_hz, att_db) for rbw_hz in (1e4, 3e4) for att_db in (0.0, 10.0)]
    again = [errors.sweep_error_db(0, rbw_hz, att_db) for rbw_hz in (1e4, 3e4) for att_db in (0.0, 10.0)]
    assert first == again
    assert len(set(first)) == 4


def test_room_changes_the_level_by_its_coefficient() -> None:
    figures = replace(IDEAL, temperature_db_per_deg_c=-0.02, daily_swing_deg_c=5.0)
    day = errors_db(figures, 1, 24, HOUR_US)
    np.testing.assert_allclose(day, -0.1 * np.sin(2 * np.pi * np.arange(24) / 24), atol=1e-12)  # -.02 dB by 5 deg C


def test_switches_stay_inside_the_bounds_of_the_data_sheet() -> None:
    figures = replace(IDEAL, rbw_switching_sigma_db=0.05, attenuator_sigma_db=0.1)
    errors = LevelErrors(figures, 5)
    filters = [errors.sweep_error_db(0, float(width), 0.0) for width in range(1, 400)]
    steps = [errors.sweep_error_db(0, 1.0, float(step)) for step in range(400)]
    assert np.ptp(filters) <= 0.2 + 1e-12  # +-0.10 dB
    assert np.ptp(steps) <= 0.4 + 1e-12  # +-0.2 dB
    assert np.std(filters) == pytest.approx(0.044, rel=0.15)  # a normal variable cut at two sigmas
    assert np.std(steps) == pytest.approx(0.088, rel=0.15)


def test_ripple_is_static_and_of_its_size() -> None:
    axis_hz = np.linspace(0.5e9, 2.5e9, 20001)
    figures = replace(IDEAL, ripple_sigma_db=0.05)
    ripple_db = LevelErrors(figures, 2).ripple_db(axis_hz)
    assert ripple_db.std() == pytest.approx(0.05, rel=0.05)  # many periods of each wave
    assert np.array_equal(ripple_db, LevelErrors(figures, 2).ripple_db(axis_hz))


def test_flatness_stays_inside_its_bound_and_moves_little_over_a_transponder() -> None:
    axis_hz = np.linspace(0.0, 26.5e9, 100001)
    spans = []
    for seed in range(20):
        flatness_db = LevelErrors(replace(IDEAL, flatness_bound_db=0.3), seed).ripple_db(axis_hz)
        assert np.abs(flatness_db).max() <= 0.3
        spans.append(np.abs(flatness_db).max())
        transponder_db = LevelErrors(replace(IDEAL, flatness_bound_db=0.3), seed).ripple_db(np.array([950e6, 986e6]))
        assert abs(np.diff(transponder_db)[0]) <= 0.0315  # steepest slopes of the three waves, 36 MHz
    assert np.mean(spans) > 0.25


@pytest.mark.parametrize(
    ("attenuation_db", "is_on", "expected"), [(0.0, False, -150), (10, False, -140), (0, True, -165)]
)
def test_attenuator_raises_and_preamplifier_lowers_the_own_noise(
    attenuation_db: float, is_on: bool, expected: float
) -> None:
    errors = LevelErrors(Imperfections(), 1)
    assert errors.own_noise_dbm_hz(attenuation_db, is_preamplifier_on=is_on) == expected
