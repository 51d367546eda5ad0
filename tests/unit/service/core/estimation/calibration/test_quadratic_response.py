"""Quadratic response against the exact rotation, finite differences and brute force."""

import numpy as np
import pytest
from flight_geometry import turned_direction

from service.core.estimation.calibration.quadratic_response import (
    QuadraticResponse,
    displacement_matrix,
    exact_response,
    predict_deviation,
    predict_jacobian,
    response_errors,
    response_monomials,
    response_transform,
    symmetric_matrix,
)
from service.core.geometry.frames import AntennaDirection

SEED = 11
STATIONS = AntennaDirection(np.array([-5.2, 0.1, 5.0]), np.array([6.3, 8.6, 7.0]))


def moved_deg(attitude_deg):
    """Exact displacement (3, 2) of the stations."""
    turned = turned_direction(STATIONS, attitude_deg)
    return np.stack(turned, axis=-1) - np.stack(STATIONS, axis=-1)


def test_displacement_is_the_derivative_of_the_exact_rotation():
    """Central differences of the rotation."""
    step_deg = 0.01
    exact = np.stack([(moved_deg(step_deg * e) - moved_deg(-step_deg * e)) / (2 * step_deg) for e in np.eye(3)], -1)
    # third derivatives are of order 1 / rad^2: (0.01 deg)^2 in rad is 3e-8
    assert displacement_matrix(*STATIONS) == pytest.approx(exact, abs=1e-7)


def test_exact_rotation_would_not_pay():
    """At 0.4 deg about all axes the rotation leaves 0.005 deg beyond its derivative, at 0.3 deg 0.003."""
    for size_deg, most_deg in ((0.4, 0.005), (0.3, 0.003)):
        corners = size_deg * np.array([[y, r, p] for y in (1, -1) for r in (1, -1) for p in (1, -1)])
        left = max(np.abs(moved_deg(c) - displacement_matrix(*STATIONS) @ c).max() for c in corners)
        print(f"{size_deg} deg: {left:.5f} deg beyond the derivative")
        # yaw times roll in rad: 0.4 * 0.4 / 57.3 = 0.0028 deg, and its neighbours
        assert left < most_deg


def random_response(rng, carriers=6, shared=2):
    slope, half = rng.normal(size=(carriers, 3)), rng.normal(size=(carriers, 3, 3))
    root = 0.1 * rng.normal(size=(carriers, 9, 9))
    common = 0.05 * rng.normal(size=(carriers, 9, shared))
    covariance = root @ np.swapaxes(root, 1, 2) + common @ np.swapaxes(common, 1, 2)
    return QuadraticResponse(slope, half + np.swapaxes(half, 1, 2), covariance, common)


def test_prediction_and_derivative_agree():
    """A quadratic's central difference is exact."""
    rng = np.random.default_rng(SEED)
    model, attitude = random_response(rng), rng.uniform(-0.5, 0.5, (4, 3))
    steps = 0.1 * np.eye(3)
    slope = np.stack(
        [(predict_deviation(attitude + s, model) - predict_deviation(attitude - s, model)) / 0.2 for s in steps], -1
    )
    assert predict_jacobian(attitude, model) == pytest.approx(slope, abs=1e-12)  # rounding
    assert predict_deviation(attitude[0], model) == pytest.approx(predict_deviation(attitude, model)[0], abs=1e-14)


def test_monomials_carry_slopes_and_curvature():
    """The nine factors times the nine coefficients are the prediction."""
    rng = np.random.default_rng(SEED)
    model, attitude = random_response(rng), rng.uniform(-0.5, 0.5, 3)
    six = model.curvature[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    nine = np.concatenate([model.slope, six], axis=1)
    assert symmetric_matrix(six) == pytest.approx(model.curvature, abs=0.0)
    assert nine @ response_monomials(attitude) == pytest.approx(predict_deviation(attitude, model), abs=1e-13)


def test_errors_are_those_of_the_coefficients():
    """Variance and common part at one attitude and at many."""
    rng = np.random.default_rng(SEED)
    model, attitude = random_response(rng), rng.uniform(-0.5, 0.5, (5, 3))
    variance, common = response_errors(attitude, model)
    for row, factors in enumerate(response_monomials(attitude)):
        expected = [factors @ one @ factors for one in model.covariance]
        assert variance[row] == pytest.approx(np.array(expected), rel=1e-10)
        assert common[row] == pytest.approx(factors @ model.common_root, rel=1e-10)
    one, _ = response_errors(attitude[2], model)
    assert one == pytest.approx(variance[2], rel=1e-12)


def test_transform_gives_what_the_beam_would():
    """Gradient, Hessian and downlink act on displacements; the collected quadratic gives the same."""
    rng = np.random.default_rng(SEED)
    position = displacement_matrix(*STATIONS)
    site = displacement_matrix(np.array([-3.6]), np.array([7.1]))[0]
    own, downlink = response_transform(position, site)
    beam, gradient = rng.normal(size=(3, 5)), rng.normal(size=2)
    nine = np.einsum("nij,nj->ni", own, beam) + downlink @ gradient
    model = exact_response(nine[:, :3], symmetric_matrix(nine[:, 3:]))
    attitude = rng.uniform(-0.5, 0.5, 3)
    moved = position @ attitude
    az, el = moved.T
    direct = beam[:, 0] * az + beam[:, 1] * el + 0.5 * beam[:, 2] * az**2 + beam[:, 3] * az * el
    direct = direct + 0.5 * beam[:, 4] * el**2 + (site @ attitude - moved) @ gradient
    assert predict_deviation(attitude, model) == pytest.approx(direct, abs=1e-12)  # rounding
