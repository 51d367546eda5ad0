"""Response of rates to the turns: sign, order and scale of the axes, and the rate at rest."""

import numpy as np
import pytest
from turned_wheels import turned_deg

from service.core.estimation.calibration.checks.rate_response import RateResponse, rate_response

W_PER_H = 0.2625162


def response(matrix: np.ndarray, *, rest: float = 0.0, every: int = 1, sensor_deg: float = 0.01) -> RateResponse:
    """Return the response of rates that are a matrix times the truth."""
    rng, angles = np.random.default_rng(5), turned_deg()
    hours = np.arange(len(angles)) / 60.0
    turned = np.diff(angles, axis=0) * 60.0
    yaw, roll, pitch = (0.5 * (angles[1:] + angles[:-1])).T
    turned += W_PER_H * np.column_stack([roll, -yaw, 0.0 * pitch])
    rates = np.vstack([np.zeros(3), turned]) @ matrix.T + rest + rng.normal(0.0, 0.02, angles.shape)
    kept = slice(None, None, every)
    return rate_response(hours[kept], rates[kept], (angles + rng.normal(0.0, sensor_deg, angles.shape))[kept])


def test_true_rates_agree() -> None:
    found = response(np.eye(3))
    print("seed 5", found)
    assert found.is_determined
    np.testing.assert_allclose(found.coefficient, np.eye(3), atol=0.1)
    assert found.deviation(0.01) < 3.5


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([-1.0, 1.0, 1.0]),
        np.diag([1.0, -1.0, 1.0]),
        np.diag([1.0, 1.0, -1.0]),
        np.eye(3)[[1, 0, 2]],
        np.eye(3)[[0, 2, 1]],
        np.eye(3)[[1, 2, 0]],
        3600.0 * np.eye(3),
        np.pi / 180.0 * np.eye(3),
        np.diag([0.75, 1.0, 1.0]),
    ],
)
def test_wrong_rates_are_found(matrix: np.ndarray) -> None:
    assert response(matrix).deviation(0.01) > 3.5


def test_a_rate_at_rest_that_no_bias_explains_is_found() -> None:
    assert response(np.eye(3), rest=1.0).deviation(0.01) > 3.5
    assert response(np.eye(3), rest=1.0).deviation(2.0) < 3.5


def test_rates_that_stand_still_tell_nothing() -> None:
    angles = turned_deg()
    found = rate_response(np.arange(len(angles)) / 60.0, np.full((len(angles), 3), 0.3), angles)
    assert (found.spans, found.is_determined, found.deviation(0.01)) == (0, False, 0.0)
