"""Claims about the watch on the drift of the inertial model."""

import numpy as np
import pytest

from service.core.estimation.filtering.model.filter_model import FilterSettings
from service.core.estimation.filtering.model.filter_state import DRIFT, Gaussian
from service.core.estimation.filtering.watches.drift_watch import (
    LARGEST,
    DriftWatch,
    push_drift,
    scaled_settings,
    usual_drift,
)

SETTINGS = FilterSettings()
SIGMA = np.array(SETTINGS.drift_deg_h)


def drifting(drift_deg_h, known_share=0.75):
    """Return a state of 12 places that knows its drift to some share of the variance."""
    variance = np.full(12, 1e-4)
    variance[DRIFT] = (1.0 - known_share) * SIGMA**2
    mean = np.zeros(12)
    mean[DRIFT] = drift_deg_h
    return Gaussian(mean, np.diag(variance))


def pushed(ratio, minutes, known_share=0.75):
    watch, state = usual_drift(), drifting(ratio * SIGMA, known_share)
    for _ in range(minutes):
        watch, _ = push_drift(watch, SETTINGS.drift_deg_h, state, 1.0)
    return watch


def test_a_usual_drift_leaves_the_settings_as_they_are():
    watch = pushed(np.sqrt(0.75), 600)  # exactly what the model expects of the estimate
    assert watch.scale == 1.0
    assert scaled_settings(SETTINGS, watch) is SETTINGS


def test_a_small_drift_never_narrows_it():
    assert pushed(0.0, 600) == usual_drift()


def test_three_times_the_drift_is_learned_within_half_a_day():
    scale = pushed(3.0, 720).scale
    assert 2.0 <= scale <= LARGEST
    np.testing.assert_allclose(
        scaled_settings(SETTINGS, DriftWatch(np.log(scale) + 1e-6)).drift_deg_h, scale * SIGMA, rtol=1e-12
    )


def test_the_factor_has_a_limit():
    assert pushed(50.0, 3000).scale == pytest.approx(LARGEST)


def test_an_unknown_drift_says_nothing():
    assert pushed(3.0, 600, known_share=0.01) == usual_drift()


def test_a_step_of_the_factor_widens_the_drift_and_nothing_else():
    watch, state = DriftWatch(0.0866), drifting(3.0 * SIGMA)  # just below the first step of 2^(1/8)
    after, wider = push_drift(watch, SETTINGS.drift_deg_h, state, 1.0)
    assert after.scale > watch.scale
    growth = wider.covariance - state.covariance
    np.testing.assert_allclose(np.diagonal(growth)[DRIFT], (2.0**0.25 - 1.0) * SIGMA**2, rtol=1e-9)
    growth[DRIFT, DRIFT] = 0.0
    assert not growth.any()


def test_the_factor_follows_time_and_not_rows():
    state = drifting(3.0 * SIGMA)
    one, many = usual_drift(), usual_drift()
    one, _ = push_drift(one, SETTINGS.drift_deg_h, state, 1.0)
    for _ in range(6):
        many, _ = push_drift(many, SETTINGS.drift_deg_h, state, 1.0 / 6.0)
    assert many.log_scale == pytest.approx(one.log_scale, rel=1e-12)
