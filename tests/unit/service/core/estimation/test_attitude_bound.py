"""Bound of the attitude by powers and measured motion: what must hold of it whatever the carriers."""

import numpy as np
import pytest

from service.core.estimation.attitude_bound import DriftStatistics, WheelStatistics, attitude_bound_deg
from service.core.estimation.calibration.coloured_rows import ColouredNoise
from service.core.estimation.filtering.model.filter_model import LearnedFeed, PolarimeterModel

SENSITIVITY = np.random.default_rng(3).normal(0.0, [0.12, 1.0, 0.8], (16, 3))
NOISE = ColouredNoise(np.full(16, 0.15), np.tile([0.08, 0.06], (16, 1)), np.tile([1200.0, 7200.0], (16, 1)))


@pytest.fixture(scope="module")
def powers_deg() -> np.ndarray:
    return attitude_bound_deg(SENSITIVITY, NOISE)


def with_wheels(*figures: float, **more: float) -> np.ndarray:
    return attitude_bound_deg(SENSITIVITY, NOISE, WheelStatistics(*figures, **more))


def test_wheels_without_momentum_along_pitch_tell_nothing(powers_deg: np.ndarray) -> None:
    np.testing.assert_allclose(with_wheels(0.0), powers_deg, rtol=1e-9)


def test_momentum_halves_yaw_and_its_sign_does_not_matter(powers_deg: np.ndarray) -> None:
    bound = with_wheels(8.0)
    assert bound[0] < 0.6 * powers_deg[0]
    assert (bound <= powers_deg).all()
    np.testing.assert_allclose(with_wheels(-8.0), bound, rtol=1e-6)


def test_more_momentum_less_noise_and_more_records_are_never_worse() -> None:
    yaw = [with_wheels(*figures)[0] for figures in ((50.0,), (8.0,), (8.0, 0.01, 3600.0), (8.0, 0.1, 3600.0))]
    assert yaw == sorted(yaw)
    assert with_wheels(8.0, torque_error_n_m=5e-8)[0] < yaw[1]


def test_a_still_spacecraft_is_known_to_the_noise_of_its_references() -> None:
    white = ColouredNoise(np.full(16, 0.15), np.zeros((16, 1)), np.ones((16, 1)))
    bound = attitude_bound_deg(SENSITIVITY, white, None, DriftStatistics((1e-9, 1e-9, 1e-9)))
    assert (bound <= 0.011).all()


def test_a_polarimeter_along_yaw_helps_yaw_and_one_that_wanders_far_tells_nothing(powers_deg: np.ndarray) -> None:
    ordinary, better, useless = (
        attitude_bound_deg(SENSITIVITY, NOISE, polarimeters=(PolarimeterModel((1.0, 0.0, 0.0), *figures),))
        for figures in ((), (0.03, 0.02, 0.02), (0.07, 0.05, 100.0, 0.1))
    )
    assert better[0] < ordinary[0] < 0.8 * powers_deg[0]
    np.testing.assert_allclose(useless, powers_deg, rtol=1e-3)
    two = attitude_bound_deg(SENSITIVITY, NOISE, polarimeters=(PolarimeterModel((1.0, 0.0, 0.0)),) * 2)
    assert better[0] < two[0] < ordinary[0]


def test_a_feed_that_quiet_days_know_is_a_better_polarimeter_and_one_they_do_not_know_the_same() -> None:
    unknown, known, still = (
        attitude_bound_deg(
            SENSITIVITY,
            NOISE,
            polarimeters=(
                PolarimeterModel((1.0, 0.0, 0.0), learned=LearnedFeed((0.0, 0.0, 0.0), _diagonal(*variances))),
            ),
        )
        for variances in ((9.0, 0.05**2, 0.05**2), (4e-4, 7e-4, 7e-4), (4e-4, 1e-8, 1e-8))
    )
    free = attitude_bound_deg(SENSITIVITY, NOISE, polarimeters=(PolarimeterModel((1.0, 0.0, 0.0)),))
    np.testing.assert_array_equal(unknown, free)
    assert still[0] < known[0] < 0.95 * free[0]


def _diagonal(*variances: float) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, np.diag(variances).tolist()))


def test_a_rate_sensor_that_is_better_than_the_drift_helps_and_its_noise_does_not(powers_deg: np.ndarray) -> None:
    quiet, noisy = (
        attitude_bound_deg(SENSITIVITY, NOISE, drift=DriftStatistics((0.01, 0.01, 0.01), 8.0, walk))
        for walk in (0.0, 0.05)
    )
    assert (quiet < powers_deg).all()
    assert (quiet < noisy).all()


def test_everything_together_is_better_than_each(powers_deg: np.ndarray) -> None:
    read, sensor = (PolarimeterModel((0.99, -0.09, -0.13)),), DriftStatistics((0.01, 0.01, 0.01))
    together = attitude_bound_deg(SENSITIVITY, NOISE, WheelStatistics(8.0), sensor, read)
    for alone in (with_wheels(8.0), attitude_bound_deg(SENSITIVITY, NOISE, None, sensor, read)):
        assert together[0] < alone[0] < powers_deg[0]
