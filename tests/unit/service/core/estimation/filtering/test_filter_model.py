"""Measurement model and state vector."""

import filter_models
import numpy as np
from filter_models import reference_states

from service.core.estimation.filtering.filter_model import (
    ATTITUDE,
    carrier_states,
    core_size,
    model_error_component,
    pattern_change,
)
from service.core.estimation.filtering.filter_state import start
from service.core.estimation.filtering.plant import filter_model


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
    np.testing.assert_allclose(calibration_variance_db2(model, attitude_deg), drawn.var(), rtol=0.03)
    assert calibration_variance_db2(model, np.zeros(3)) == 0.0


def calibration_variance_db2(model, attitude_deg):
    """Return the error of the calibration that the filter holds of its only carrier after a second."""
    state = start(model, 0, filter_models.aligned(model))
    state.mean[ATTITUDE] = attitude_deg
    return filter_models.coasted(filter_model(model), state, 1_000_000).carriers["model_variance_db2"][0]


def test_the_calibrations_error_rides_on_the_component_of_about_an_hour():
    model = filter_models.carrier_model(components=3)
    assert model_error_component(model.coloured_tau_s).tolist() == [1] * model.carriers


def test_every_state_has_one_place():
    model = filter_models.carrier_model(carriers=5, components=3, common=2)
    positions = carrier_states(model, np.arange(5))
    assert positions.shape == (4, 5)
    assert sorted(positions.ravel().tolist()) == list(range(core_size(model), core_size(model) + 20))
    assert positions[-1].tolist() == reference_states(model, np.arange(5)).tolist()
    assert len(filter_models.aligned(model).mean) == core_size(model) + 20


def test_an_alignment_sets_attitude_and_stationary_noise():
    model = filter_models.carrier_model(carriers=4, components=2)
    state = filter_models.aligned(model)
    np.testing.assert_allclose(state.attitude_sigma_deg, [0.01, 0.005, 0.005], rtol=1e-12)
    variance = np.diagonal(state.covariance)
    positions = carrier_states(model, np.arange(4))
    np.testing.assert_allclose(np.sqrt(variance[positions[0]]), 0.07, rtol=1e-12)
    np.testing.assert_allclose(np.sqrt(variance[positions[2]]), 0.03, rtol=1e-12)
    assert (variance > 0.0).all()
