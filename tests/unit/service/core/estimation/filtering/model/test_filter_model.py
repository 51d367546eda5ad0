"""Claims about the measurement model of the attitude filter."""

import filter_models
import numpy as np

from service.core.estimation.filtering.model.filter_model import (
    model_error_component,
    model_variance_db2,
    no_motion,
    pattern_change,
)


def test_the_pattern_is_the_quadratic_and_its_gradient_the_derivative():
    model = filter_models.carrier_model()
    attitude_deg = np.array([0.3, -0.2, 0.1])
    change = pattern_change(model, attitude_deg)
    expected = model.gradient_db_deg @ attitude_deg + 0.5 * np.einsum(
        "i,nij,j->n", attitude_deg, model.hessian_db_deg2, attitude_deg
    )
    np.testing.assert_allclose(change.deviation_db, expected, rtol=0.0, atol=1e-14)  # rounding
    for axis in range(3):
        turned = attitude_deg + 1e-5 * np.eye(3)[axis]
        slope = (pattern_change(model, turned).deviation_db - change.deviation_db) / 1e-5
        # the second derivative of some 3 dB/deg^2 times half the step of 1e-5 deg
        np.testing.assert_allclose(slope, change.gradient_db_deg[:, axis], rtol=0.0, atol=5e-5)


def test_the_calibrations_error_is_that_of_the_nine_coefficients():
    model = filter_models.carrier_model(carriers=1)
    rng = np.random.default_rng(3)
    attitude_deg = np.array([0.4, -0.3, 0.2])
    errors = rng.multivariate_normal(np.zeros(9), model.coefficient_covariance[0], size=40_000)
    gradient, upper = errors[:, :3], errors[:, 3:]
    hessian = np.empty((len(errors), 3, 3))
    for number, (a, b) in enumerate([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]):
        hessian[:, a, b] = hessian[:, b, a] = upper[:, number]
    drawn = gradient @ attitude_deg + 0.5 * np.einsum("i,nij,j->n", attitude_deg, hessian, attitude_deg)
    # a variance of 40 000 draws is good to 0.7 %
    np.testing.assert_allclose(
        model_variance_db2(model.coefficient_covariance, attitude_deg)[0], drawn.var(), rtol=0.03
    )
    assert model_variance_db2(model.coefficient_covariance, np.zeros(3))[0] == 0.0


def test_the_calibrations_error_rides_on_the_component_of_about_an_hour():
    model = filter_models.carrier_model(components=3)
    assert model_error_component(model.coloured_tau_s).tolist() == [1] * model.carriers


def test_sizes():
    model = filter_models.carrier_model(carriers=12, components=3)
    assert (model.carriers, model.components) == (12, 3)
    assert not any(np.any(part) for part in no_motion())
