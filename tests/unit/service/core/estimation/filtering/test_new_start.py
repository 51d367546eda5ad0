"""Claims about the new start of a filter whose attitude the references of the alignment contradict."""

import filter_models
import numpy as np
import pytest

from service.core.estimation.filtering.anchor.anchor_watch import ERROR_SIGMA_DEG
from service.core.estimation.filtering.anchor.carrier_mixture import Mixture
from service.core.estimation.filtering.filter_records import start
from service.core.estimation.filtering.model.filter_state import ATTITUDE, DRIFT, Gaussian, reference_states
from service.core.estimation.filtering.new_start import start_again

ERROR_DEG = np.array([0.1, -0.2, 0.15])
CARRIERS = 6


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=CARRIERS)


@pytest.fixture
def state(model):
    """Return a filter that learned references: carrier 1 is set aside, 2 has a level of its own."""
    gaussian = filter_models.aligned(model)
    mean = gaussian.mean.copy()
    mean[reference_states(model, np.arange(CARRIERS))] = [0.3, 0.0, 1.5, -0.4, 0.0, 0.0]
    mean[DRIFT] = 0.01
    state = start(model, 0, Gaussian(mean, gaussian.covariance))
    watch = state.carriers._replace(
        is_flagged=np.arange(CARRIERS) == 1, is_relearned=np.isin(np.arange(CARRIERS), [0, 2, 3])
    )
    return state._replace(carriers=watch)


def mixture(likeliest=("dry", "dry", "learned", "rain", "dry", "dry")):
    place = {"dry": 0, "rain": 2, "changed": 3, "learned": 4}
    told = np.full((CARRIERS, 5), 0.025)
    told[np.arange(CARRIERS), [place[each] for each in likeliest]] = 0.9
    return Mixture(np.ones(1), ERROR_DEG[None], np.diag([0.01, 0.0004, 0.0009])[None], told)


def test_the_attitude_moves_by_the_error_and_is_free(model, state):
    after = start_again(model, state, mixture()).gaussian
    np.testing.assert_allclose(after.mean[ATTITUDE], state.gaussian.mean[ATTITUDE] + ERROR_DEG)
    np.testing.assert_allclose(after.covariance[ATTITUDE, ATTITUDE], np.diag(np.square(ERROR_SIGMA_DEG)))
    assert not after.covariance[ATTITUDE, 3:].any()
    np.testing.assert_array_equal(after.mean[DRIFT], state.gaussian.mean[DRIFT])


def test_dry_carriers_have_the_reference_of_the_alignment_again(model, state):
    after = start_again(model, state, mixture())
    positions = reference_states(model, np.array([0, 1, 4]))
    np.testing.assert_array_equal(after.gaussian.mean[positions], 0.0)
    assert not after.carriers.is_flagged[[0, 1, 4]].any()
    assert not after.carriers.is_relearned[[0, 1, 4]].any()


def test_wet_carriers_are_set_aside_and_learned_levels_stay(model, state):
    after = start_again(model, state, mixture())
    assert np.flatnonzero(after.carriers.is_flagged).tolist() == [3]
    # it comes back to the level of the alignment, not to the one that rain taught
    assert after.carriers.saved_reference_db[3] == 0.0
    assert after.gaussian.mean[reference_states(model, np.array([2]))] == 1.5


def test_a_carrier_without_a_reference_of_the_alignment_is_never_given_one(model, state):
    known = np.where(np.arange(CARRIERS) == 4, np.nan, 0.0)
    unknown = state._replace(carriers=state.carriers._replace(aligned_reference_db=known))
    after = start_again(model, unknown, mixture())
    assert after.carriers.is_flagged[4]
    assert np.isfinite(after.gaussian.mean).all()


def test_the_level_is_that_of_the_moved_attitude(model, state):
    after = start_again(model, state, mixture())
    # 3.891 sigma of an error that is expected to be zero now
    np.testing.assert_allclose(after.anchor.level_deg, 3.8906 * np.array([0.1, 0.02, 0.03]), rtol=1e-3)
