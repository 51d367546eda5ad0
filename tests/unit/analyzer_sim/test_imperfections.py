"""Errors of the instrument itself."""

import numpy as np
import pytest

from analyzer_sim.imperfections import IDEAL, Imperfections, LevelErrors

HOUR_US = 3_600_000_000


def errors_db(figures: Imperfections, seed: int, count: int = 2000, step_us: int = 60_000_000) -> np.ndarray:
    errors = LevelErrors(figures, seed)
    return np.array([errors.sweep_error_db(k * step_us, 30e3, 0.0) for k in range(count)])


def test_default_instrument_scatters_by_three_hundredths_of_a_decibel() -> None:
    scatters = [errors_db(Imperfections(), seed).std() for seed in range(6)]
    assert np.mean(scatters) == pytest.approx(0.03, abs=0.006)  # 33 h hold some thirty independent gain values


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


def test_ripple_is_static_and_of_its_size() -> None:
    axis_hz = np.linspace(0.5e9, 2.5e9, 20001)
    ripple_db = LevelErrors(Imperfections(), 2).ripple_db(axis_hz)
    assert ripple_db.std() == pytest.approx(0.05, rel=0.05)  # many periods of each wave
    assert np.array_equal(ripple_db, LevelErrors(Imperfections(), 2).ripple_db(axis_hz))


@pytest.mark.parametrize(
    ("attenuation_db", "is_on", "expected"), [(0.0, False, -150), (10, False, -140), (0, True, -165)]
)
def test_attenuator_raises_and_preamplifier_lowers_the_own_noise(
    attenuation_db: float, is_on: bool, expected: float
) -> None:
    errors = LevelErrors(Imperfections(), 1)
    assert errors.own_noise_dbm_hz(attenuation_db, is_preamplifier_on=is_on) == expected
