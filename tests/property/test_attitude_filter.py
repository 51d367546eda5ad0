"""Properties of the attitude filter that must hold for any rows."""

import filter_models
import numpy as np
import pytest
from example_counts import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from service.core.estimation.filtering.attitude_filter import start, step
from service.core.estimation.filtering.model.filter_model import FilterSettings, KnownMotion, no_motion

SEEDS = st.integers(0, 2**32 - 1)
steady = settings(derandomize=True, deadline=None, max_examples=examples(12))


def assert_sound(state):
    covariance = state.gaussian.covariance
    np.testing.assert_array_equal(covariance, covariance.T)
    assert np.isfinite(state.gaussian.mean).all()
    # the smallest variance is that of a rate nobody commanded, 1e-8; rounding of the largest, 9 dB^2, is 1e-15
    assert np.linalg.eigvalsh(covariance).min() > 0.0


@steady
@given(SEEDS)
def test_any_rows_leave_a_sound_state(seed):
    """Jumps, absences, gaps of hours, rows of a second, commands of any size."""
    rng = np.random.default_rng(seed)
    model = filter_models.carrier_model(carriers=int(rng.integers(6, 20)), components=2, common=int(rng.integers(0, 2)))
    state = start(model, 0, filter_models.aligned(model))
    level_db = np.zeros(model.carriers)
    for _ in range(120):
        level_db += np.where(rng.random(model.carriers) < 0.02, rng.normal(0.0, 3.0, model.carriers), 0.0)
        level_db += rng.normal(0.0, 2.0) * (rng.random() < 0.03)
        row = level_db + 0.15 * rng.standard_normal(model.carriers)
        row[rng.random(model.carriers) < rng.choice([0.0, 0.05, 0.9])] = np.nan
        epoch_us = state.epoch_us + int(rng.choice([1, 10, 60, 300, 14_400], p=[0.2, 0.2, 0.4, 0.15, 0.05])) * 1_000_000
        motion = [rng.normal(0.0, 0.02, 3) * (rng.random() < 0.2) for _ in range(3)]
        state = step(model, FilterSettings(), state, epoch_us, row, KnownMotion(*motion)).state
    assert_sound(state)


@pytest.mark.slow
def test_two_weeks_of_rows_leave_a_sound_state():
    """14 days at five minutes a row, one carrier in ten absent at any time; seed 11."""
    rng = np.random.default_rng(11)
    model = filter_models.carrier_model(carriers=8, components=2)
    state = start(model, 0, filter_models.aligned(model))
    for number in range(1, 14 * 288 + 1):
        row = 0.15 * rng.standard_normal(8)
        row[rng.random(8) < 0.1] = np.nan
        state = step(model, FilterSettings(), state, number * 300_000_000, row, no_motion()).state
    assert_sound(state)
    assert np.abs(state.gaussian.mean[:3]).max() < 0.5


@steady
@given(SEEDS)
def test_the_order_of_the_carriers_does_not_matter(seed):
    """Shuffled carriers give the same attitude to 1e-9 deg."""
    rng = np.random.default_rng(seed)
    model = filter_models.carrier_model(carriers=12)
    order = rng.permutation(12)
    shuffled = type(model)(*(part[order] if len(part) == 12 else part for part in model))
    one, other = start(model, 0, filter_models.aligned(model)), start(shuffled, 0, filter_models.aligned(shuffled))
    for number in range(1, 40):
        row = 0.15 * rng.standard_normal(12) - 2.0 * (number > 20) * (np.arange(12) == 3)
        one = step(model, FilterSettings(), one, number * 60_000_000, row, no_motion()).state
        other = step(shuffled, FilterSettings(), other, number * 60_000_000, row[order], no_motion()).state
    np.testing.assert_allclose(one.gaussian.mean[:3], other.gaussian.mean[:3], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(one.gaussian.covariance[:3, :3], other.gaussian.covariance[:3, :3], rtol=1e-7)
