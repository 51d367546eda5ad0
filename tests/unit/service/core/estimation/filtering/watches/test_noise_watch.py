"""Claims about noise that is watched in operation."""

import numpy as np

from service.core.estimation.filtering.watches.noise_watch import SLOW_LIMITS, calm_watch, push_values


def minute_update(values):
    """Return the watch of a filter whose test values follow the factors: a wider sigma makes them smaller."""
    watch = calm_watch(values.shape[1])
    for row in values:
        tested = row / watch.white_scale
        watch = push_values(watch, tested, float(np.nansum(tested**2)), values.shape[1])
    return watch


def test_what_the_model_says_keeps_the_factors_at_one():
    watch = minute_update(np.random.default_rng(1).standard_normal((3000, 16)))
    assert abs(watch.slow_scale - 1.0) < 0.15  # six hours of memory over sixteen carriers
    assert np.abs(watch.white_scale - 1.0).max() < 0.2
    assert abs(watch.nis_ratio - 1.0) < 0.1


def test_louder_white_noise_raises_its_own_carrier_only():
    values = np.random.default_rng(2).standard_normal((1500, 8))
    values[:, 3] *= 1.8
    watch = minute_update(values)
    assert abs(watch.white_scale[3] - 1.8) < 0.25  # four hours of memory, outliers cut
    assert np.delete(watch.white_scale, 3).max() < 1.25


def test_slow_noise_that_the_model_does_not_know_raises_the_slow_factor():
    rng = np.random.default_rng(3)
    values, slow = rng.standard_normal((1500, 8)), np.zeros(8)
    for row in range(1500):
        slow = 0.98 * slow + 0.1 * rng.standard_normal(8)
        values[row] += slow
    watch = minute_update(values)
    assert watch.slow_scale > 1.5
    assert minute_update(values * 9.0).slow_scale <= SLOW_LIMITS[1]


def test_absent_carriers_teach_nothing():
    values = np.full((50, 4), np.nan)
    watch = calm_watch(4)
    for row in values:
        watch = push_values(watch, row, 4.0, 4)
    assert watch.slow_scale == 1.0
    assert (watch.white_scale == 1.0).all()
