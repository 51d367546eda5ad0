"""Claims about the two sets of kernels: the same arithmetic, once in numpy and once as compiled loops."""

import filter_models
import numpy as np
import pytest

from service.core.estimation.filtering.attitude_filter import start, step
from service.core.estimation.filtering.filter_predict import Weather, predict
from service.core.estimation.filtering.filter_update import innovate, update
from service.core.estimation.filtering.kernels import loop_kernels
from service.core.estimation.filtering.kernels.kernels import ARRAYS, Kernels, compiled_kernels, sources
from service.core.estimation.filtering.model.filter_model import (
    FilterSettings,
    KnownMotion,
    model_variance_db2,
    no_motion,
)
from service.core.estimation.filtering.model.filter_state import core_size
from service.core.estimation.filtering.model.hidden_motion import inserted

#: the first run after a change of the loops compiles them: six seconds of an idle processor
MINUTE_US = 60_000_000
#: the loops as Python runs them: slow, but every line of them is seen by the coverage
UNCOMPILED = Kernels(*sources(loop_kernels))


@pytest.fixture(scope="module")
def compiled():
    """The compiled set."""
    return compiled_kernels()


def walk(model, state, kernels, rows, shares=0):
    """Return the states of some rows with rain, commands, a jump and carriers that come and go."""
    rng, settings, states = np.random.default_rng(11), FilterSettings(torque_deg_h2=(0.1, 0.1, 0.2)), []
    variance = np.zeros(model.carriers)
    for row in range(rows):
        known = KnownMotion(*(0.01 * rng.standard_normal((3, 3))))
        known = known._replace(unreported=0.01 * rng.standard_normal((shares, 2, 3)))
        weather = Weather(row % 5 == 0, (False, row % 3 == 0, False), 1.3, variance)
        step_us = MINUTE_US * (1 + row % 4)
        state, variance = predict(model, settings, state, step_us, known, weather, kernels, 3_600_000_000 * row)
        deviation_db = 0.2 * rng.standard_normal(model.carriers) - 3.0 * (row == rows // 2)
        carriers = np.flatnonzero(rng.random(model.carriers) < 0.8)
        innovation = innovate(model, state, deviation_db, carriers, model.white_sigma_db**2, None, kernels)
        state = update(model, state, deviation_db, innovation, kernels).state
        states.append((state.mean, state.covariance, variance))
    return states


def assert_alike(first, second, tolerance):
    for (mean, covariance, variance), (other_mean, other, other_variance) in zip(first, second, strict=True):
        sigma = np.sqrt(np.diagonal(covariance))
        # relative to the sigmas: an element that happens to be near zero has no relative accuracy of its own
        assert np.abs((mean - other_mean) / sigma).max() <= tolerance
        assert np.abs((covariance - other) / np.outer(sigma, sigma)).max() <= tolerance
        np.testing.assert_allclose(variance, other_variance, rtol=1e-10, atol=1e-20)


@pytest.mark.parametrize(("components", "common"), [(1, 0), (3, 2)])
def test_both_sets_agree(compiled, components, common):
    model = filter_models.carrier_model(components=components, common=common)
    model = model._replace(coefficient_covariance=model.coefficient_covariance + 1e-5)
    start = filter_models.aligned(model)
    arrays, loops = walk(model, start, ARRAYS, 40), walk(model, start, compiled, 40)
    assert_alike(arrays, loops, 1e-10)  # 1e-12 of one row, and forty rows build upon one another
    assert_alike(arrays[:1], loops[:1], 1e-12)


@pytest.mark.parametrize("shares", [0, 2])
def test_both_sets_agree_on_hidden_states(compiled, shares):
    model = filter_models.carrier_model(components=2, common=1)
    hidden = np.concatenate([np.ones(shares), np.full(9, 0.1)])
    state = inserted(filter_models.aligned(model), core_size(model), np.diag(hidden**2))
    arrays, loops = (walk(model, state, kernels, 40, shares) for kernels in (ARRAYS, compiled))
    assert_alike(arrays, loops, 1e-10)
    assert_alike(arrays[:1], loops[:1], 1e-12)
    assert_alike(walk(model, state, UNCOMPILED, 2, shares), walk(model, state, compiled, 2, shares), 1e-12)
    for _, covariance, _ in loops:
        np.testing.assert_array_equal(covariance, covariance.T)


def test_the_loops_are_python_too(compiled):
    model = filter_models.carrier_model(carriers=6, components=2, common=1)
    start = filter_models.aligned(model)
    # the processor's own exponential and root may differ from the library's in the last place
    assert_alike(walk(model, start, UNCOMPILED, 3), walk(model, start, compiled, 3), 1e-12)


@pytest.mark.parametrize("name", ["arrays", "compiled"])
def test_a_set_gives_the_same_bits_twice_and_a_covariance_that_stays_one(compiled, name):
    kernels = {"arrays": ARRAYS, "compiled": compiled}[name]
    model = filter_models.carrier_model(common=1)
    first, second = (walk(model, filter_models.aligned(model), kernels, 60) for _ in range(2))
    for (mean, covariance, _), (other_mean, other, _) in zip(first, second, strict=True):
        np.testing.assert_array_equal(mean, other_mean)
        np.testing.assert_array_equal(covariance, other)
        np.testing.assert_array_equal(covariance, covariance.T)
        scale = np.sqrt(np.diagonal(covariance))
        assert np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min() > 1e-9


@pytest.mark.parametrize("name", ["arrays", "compiled"])
def test_a_precise_row_on_free_references_leaves_a_positive_covariance(compiled, name):
    kernels = {"arrays": ARRAYS, "compiled": compiled}[name]
    model = filter_models.carrier_model()._replace(white_sigma_db=np.full(12, 1e-4))
    state = filter_models.aligned(model)
    wide = state.covariance.copy()
    wide[-12:, -12:] += 9.0 * (np.eye(12) + 1.0)
    state = state._replace(covariance=wide)
    for _ in range(200):
        row = innovate(model, state, np.zeros(12), np.arange(12), model.white_sigma_db**2, None, kernels)
        state = update(model, state, np.zeros(12), row, kernels).state
    assert (np.diagonal(state.covariance) > 0.0).all()
    scale = np.sqrt(np.diagonal(state.covariance))
    # nothing is added between the rows, which operation never does
    assert np.linalg.eigvalsh(state.covariance / np.outer(scale, scale)).min() > -1e-12


@pytest.mark.parametrize("name", ["arrays", "compiled", "uncompiled"])
def test_innovations_without_a_covariance_are_refused(compiled, name):
    kernels = {"arrays": ARRAYS, "compiled": compiled, "uncompiled": UNCOMPILED}[name]
    with pytest.raises(np.linalg.LinAlgError):
        kernels.update_state(
            np.zeros(2), np.zeros(2), np.array([[1.0, 2.0], [2.0, 1.0]]), np.zeros(2), np.zeros((2, 2))
        )


def test_the_error_of_the_calibration_is_that_of_the_model():
    model, attitude_deg = filter_models.carrier_model(), np.array([0.2, -0.1, 0.3])
    expected = model_variance_db2(model.coefficient_covariance, attitude_deg)
    variance = UNCOMPILED.model_variance(model.coefficient_covariance, attitude_deg)
    np.testing.assert_allclose(variance, expected, rtol=1e-13)  # sums of 81 products


@pytest.mark.parametrize("name", ["arrays", "compiled"])
def test_a_step_of_either_set_replays_bit_for_bit(compiled, name):
    kernels = {"arrays": ARRAYS, "compiled": compiled}[name]
    first, second = (driven(filter_models, kernels, 30) for _ in range(2))
    np.testing.assert_array_equal(first.covariance, second.covariance)
    np.testing.assert_array_equal(first.mean, second.mean)


def test_steps_of_both_sets_agree(compiled):
    arrays, loops = driven(filter_models, ARRAYS, 30), driven(filter_models, compiled, 30)
    # thirty rows build upon one another
    np.testing.assert_allclose(arrays.mean, loops.mean, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(arrays.covariance, loops.covariance, rtol=0.0, atol=1e-12)


def driven(filter_models, kernels, rows):
    """Return the state vector after some rows of the whole filter."""
    model, rng = filter_models.carrier_model(), np.random.default_rng(5)
    state = start(model, 0, filter_models.aligned(model))
    for row in range(1, rows + 1):
        deviation_db = 0.2 * rng.standard_normal(model.carriers)
        state = step(model, FilterSettings(), state, row * MINUTE_US, deviation_db, no_motion(), kernels=kernels).state
    return state.gaussian
