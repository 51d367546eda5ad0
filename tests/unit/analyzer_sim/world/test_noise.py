"""Noise series: spread, memory, prefixes."""

import numpy as np
import pytest

from analyzer_sim.streams import stream
from analyzer_sim.world.noise import daily_wave, first_order


def test_a_first_order_series_has_its_spread_and_memory() -> None:
    series = first_order(stream(1, "x"), 40_000, 60.0, 0.1, 1200.0)
    # 40 000 rows hold some 1000 independent values
    assert float(series.std()) == pytest.approx(0.1, rel=0.1)
    lag_one = float(np.corrcoef(series[:-1], series[1:])[0, 1])
    assert lag_one == pytest.approx(np.exp(-60.0 / 1200.0), abs=0.01)


def test_a_series_starts_in_its_stationary_state() -> None:
    starts = [first_order(stream(seed, "x"), 1, 60.0, 0.1, 36_000.0)[0] for seed in range(400)]
    assert float(np.std(starts)) == pytest.approx(0.1, rel=0.15)  # 400 draws: 3.5 %, four sigmas


def test_no_sigma_gives_zeros_and_draws_as_many_numbers() -> None:
    one, other = stream(1, "x"), stream(1, "x")
    assert not first_order(one, 10, 60.0, 0.0, 1200.0).any()
    first_order(other, 10, 60.0, 0.3, 1200.0)
    assert one.normal() == other.normal()


def test_a_longer_series_begins_with_the_shorter() -> None:
    short, long = (first_order(stream(1, "x"), count, 60.0, 0.1, 1200.0) for count in (50, 80))
    np.testing.assert_array_equal(short, long[:50])


def test_a_daily_wave_repeats_after_a_day() -> None:
    wave = daily_wave(stream(1, "x"), np.array([1000.0, 87_400.0, 44_200.0]), 0.04)
    assert wave[0] == pytest.approx(wave[1], abs=1e-12)
    assert wave[0] == pytest.approx(-wave[2], abs=1e-12)
