"""Claims about the places of the state vector and about setting parts of it free."""

import filter_models
import numpy as np

from service.core.estimation.filtering.model.filter_state import (
    ATTITUDE,
    carrier_states,
    core_size,
    freed,
    reference_states,
    reset_carriers,
)


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


def test_what_is_freed_together_keeps_its_differences():
    model = filter_models.carrier_model(carriers=6)
    state = filter_models.aligned(model)
    positions = reference_states(model, np.array([1, 4]))
    wider = freed(state, positions, 4.0)
    one, other = positions
    spread = wider.covariance[one, one] + wider.covariance[other, other] - 2.0 * wider.covariance[one, other]
    np.testing.assert_allclose(spread, 2.0 * 0.03**2, rtol=1e-9)  # 4 dB^2 minus 4 dB^2 loses eight digits at most
    assert wider.covariance[one, one] > 4.0
    assert state.covariance[one, one] < 0.01


def test_a_reset_carrier_knows_nothing_of_the_others():
    model = filter_models.carrier_model(carriers=6)
    state = freed(filter_models.aligned(model), np.arange(core_size(model) + 18), 0.01)
    after = reset_carriers(model, state, np.array([2]), np.array([1.5]), np.array([9.0]))
    positions = carrier_states(model, np.array([2])).ravel()
    others = np.setdiff1d(np.arange(len(state.mean)), positions)
    assert not after.covariance[np.ix_(positions, others)].any()
    assert after.mean[positions[-1]] == 1.5
    assert after.covariance[positions[-1], positions[-1]] == 9.0
    np.testing.assert_array_equal(after.covariance[ATTITUDE, ATTITUDE], state.covariance[ATTITUDE, ATTITUDE])
