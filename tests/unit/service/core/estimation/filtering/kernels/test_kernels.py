"""Kernels of the filter and of its rows."""

import filter_models
import numpy as np
import pytest
from filter_models import aligned, carrier_model

from service.core.estimation.filtering.attitude_filter import start, step
from service.core.estimation.filtering.filter_update import innovate, update
from service.core.estimation.filtering.kernels import state_kernels
from service.core.estimation.filtering.model.filter_model import (
    FilterSettings,
    KnownMotion,
    no_motion,
)
from service.core.estimation.filtering.model.filter_state import core_size
from service.core.estimation.filtering.model.hidden_motion import inserted
from service.core.estimation.filtering.rows.row_kernels import ARRAYS, compiled_kernels
from service.core.estimation.filtering.watches.drift_watch import DriftWatch

#: the first run after a change of the stages compiles them: a minute of an idle processor
MINUTE_US = 60_000_000


@pytest.fixture(scope="module")
def compiled():
    """The compiled set."""
    return compiled_kernels()


def walk(model, kernels, rows, shares=None):
    """Return the steps of some rows with commands, a jump, a gap and carriers that come and go."""
    rng, settings = np.random.default_rng(11), FilterSettings(torque_deg_h2=(0.1, 0.1, 0.2))
    state, epoch_us, steps = start(model, 0, filter_models.aligned(model)), 0, []
    if shares is not None:
        hidden = np.diag(np.concatenate([np.ones(shares), np.full(9, 0.01)]) ** 2)
        state = state._replace(gaussian=inserted(state.gaussian, core_size(model), hidden))
    for row in range(rows):
        known = KnownMotion(*(0.01 * rng.standard_normal((3, 3))))
        known = known._replace(unreported=0.01 * rng.standard_normal((shares or 0, 2, 3)))
        epoch_us += (1 + row % 4) * MINUTE_US // 2
        deviation_db = 0.2 * rng.standard_normal(model.carriers) - 3.0 * (row == rows // 2)
        deviation_db[rng.random(model.carriers) < 0.2] = np.nan
        found = step(model, settings, state, epoch_us, deviation_db, known, kernels=kernels)
        state = found.state
        steps.append(found)
    return steps


def assert_alike(first, second, tolerance):
    for one, other in zip(first, second, strict=True):
        sigma = np.sqrt(np.diagonal(one.state.gaussian.covariance))
        # relative to the sigmas: an element that happens to be near zero has no relative accuracy of its own
        (mean, covariance), (other_mean, other_covariance) = one.state.gaussian, other.state.gaussian
        assert np.abs((mean - other_mean) / sigma).max() <= tolerance
        assert np.abs((covariance - other_covariance) / np.outer(sigma, sigma)).max() <= tolerance
        np.testing.assert_allclose(one.innovation_db, other.innovation_db, rtol=0.0, atol=tolerance)
        np.testing.assert_array_equal(one.used, other.used)
        assert one.is_ordinary is other.is_ordinary


@pytest.mark.parametrize(("components", "common", "shares"), [(1, 0, None), (3, 2, None), (2, 1, 0), (2, 1, 2)])
def test_both_sets_agree(compiled, components, common, shares):
    model = filter_models.carrier_model(components=components, common=common)
    model = model._replace(coefficient_covariance=model.coefficient_covariance + 1e-5)
    arrays, loops = walk(model, ARRAYS, 40, shares), walk(model, compiled, 40, shares)
    assert_alike(arrays, loops, 1e-9)  # 1e-12 of one row, and forty rows build upon one another
    assert_alike(arrays[:1], loops[:1], 1e-12)
    assert {each.is_ordinary for each in arrays} == {True, False}  # the jump is none of the ordinary rows


@pytest.mark.parametrize("name", ["arrays", "compiled"])
def test_a_set_gives_the_same_bits_twice_and_a_covariance_that_stays_one(compiled, name):
    kernels = {"arrays": ARRAYS, "compiled": compiled}[name]
    model = filter_models.carrier_model(common=1)
    first, second = (walk(model, kernels, 60) for _ in range(2))
    for one, other in zip(first, second, strict=True):
        (mean, covariance), (other_mean, other_covariance) = one.state.gaussian, other.state.gaussian
        np.testing.assert_array_equal(mean, other_mean)
        np.testing.assert_array_equal(covariance, other_covariance)
        np.testing.assert_array_equal(covariance, covariance.T)
        scale = np.sqrt(np.diagonal(covariance))
        assert np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min() > 1e-9


def test_a_state_of_other_memory_is_the_same_to_the_compiled_set(compiled):
    """A state that was restored, or cut out of another one, compiles nothing again."""
    model = filter_models.carrier_model(common=1)
    state = start(model, 0, filter_models.aligned(model))
    deviation_db = 0.1 * np.random.default_rng(2).standard_normal(model.carriers)
    covariance = np.asfortranarray(state.gaussian.covariance)
    covariance.setflags(write=False)
    other = state._replace(gaussian=state.gaussian._replace(covariance=covariance))
    first, second = (
        step(model, FilterSettings(), each, MINUTE_US, deviation_db, no_motion(), kernels=compiled)
        for each in (state, other)
    )
    np.testing.assert_array_equal(first.state.gaussian.covariance, second.state.gaussian.covariance)


def _after_precise_rows():
    """Return the covariance after many precise rows on free references."""
    model = filter_models.carrier_model()._replace(white_sigma_db=np.full(12, 1e-4))
    state = filter_models.aligned(model)
    wide = state.covariance.copy()
    wide[-12:, -12:] += 9.0 * (np.eye(12) + 1.0)
    state = state._replace(covariance=wide)
    for _ in range(50):
        row = innovate(model, state, np.zeros(12), np.arange(12), model.white_sigma_db**2)
        state = update(model, state, np.zeros(12), row).state
    return state.covariance


def assert_positive(covariance):
    assert (np.diagonal(covariance) > 0.0).all()
    scale = np.sqrt(np.diagonal(covariance))
    # nothing is added between the rows, which operation never does
    assert np.linalg.eigvalsh(covariance / np.outer(scale, scale)).min() > -1e-12


def test_a_precise_row_on_free_references_leaves_a_positive_covariance():
    assert_positive(_after_precise_rows())


def test_innovations_without_a_covariance_are_refused():
    with pytest.raises(np.linalg.LinAlgError):
        state_kernels.update_state(
            np.zeros(2), np.zeros(2), np.array([[1.0, 2.0], [2.0, 1.0]]), np.zeros(2), np.zeros((2, 2))
        )


CARRIERS = 8


def copied(value):
    """Return a value with arrays of its own that nobody may write to, as a restored state has them."""
    if isinstance(value, np.ndarray):
        array = value.copy()
        array.setflags(write=False)
        return array
    if isinstance(value, tuple):
        parts = [copied(each) for each in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    return value


def bits(value):
    """Return the bytes of all numbers of a state."""
    if isinstance(value, tuple):
        return b"".join(bits(each) for each in value)
    return np.asarray(value).tobytes()


@pytest.fixture(scope="module")
def flown():
    """Return the rows of some minutes, and the states before each and after the last."""
    model, settings = carrier_model(CARRIERS, components=3, common=2), FilterSettings()
    seed = 7
    rows = np.random.default_rng(seed).normal(0.0, 0.1, (40, CARRIERS))
    states = [start(model, 0, aligned(model))]
    for row in rows:
        states.append(taken(model, settings, states[-1], row))
    return model, settings, rows, states


def taken(model, settings, state, row_db):
    """Return the state after a row by the compiled stages."""
    kernels = compiled_kernels()
    return step(model, settings, state, state.epoch_us + MINUTE_US, row_db, no_motion(), kernels=kernels).state


@pytest.mark.timeout(900)
def test_a_restored_state_goes_on_with_the_same_bits(flown):
    model, settings, rows, states = flown
    state = copied(states[25])
    for row_db, before in zip(rows[25:], states[25:], strict=False):
        assert bits(state) == bits(before)
        state = taken(model, settings, state, row_db)
    assert bits(state) == bits(states[-1])


@pytest.mark.timeout(900)
def test_rows_are_taken_again_from_an_earlier_state_and_beside_another_model(flown):
    model, settings, rows, states = flown
    other = carrier_model(CARRIERS, components=3, common=2)
    beside = start(other, 0, aligned(other))
    state = states[30]
    for number in range(30, len(rows)):
        state = taken(model, settings, state, rows[number])
        beside = taken(other, settings, beside, rows[number - 30])
        assert bits(state) == bits(states[number + 1])
        assert bits(beside) == bits(states[number - 29])


@pytest.mark.timeout(900)
def test_models_that_are_no_longer_used_are_let_go(flown):
    model, settings, rows, states = flown
    made = [carrier_model(CARRIERS, components=3, common=2) for _ in range(70)]
    for each in made:
        assert bits(taken(each, settings, states[0], rows[0])) == bits(states[1])
    assert bits(taken(model, settings, states[-2], rows[-1])) == bits(states[-1])


@pytest.mark.timeout(900)
def test_a_state_that_a_sensor_changed_goes_on_from_the_held_one_with_the_same_bits(flown, monkeypatch):
    model, settings, rows, states = flown
    newest = taken(model, settings, states[22], rows[22])
    gaussian = newest.gaussian._replace(mean=newest.gaussian.mean + 0.01)
    sensed = newest._replace(gaussian=gaussian, drift=DriftWatch(0.5))
    row, brought_in = compiled_kernels().ordinary_row, []
    hold = row._hold_state
    monkeypatch.setattr(row, "_hold_state", lambda state: brought_in.append(state) or hold(state))
    found = taken(model, settings, sensed, rows[23])
    assert not brought_in
    assert bits(found) == bits(taken(model, settings, copied(sensed), rows[23]))
    assert len(brought_in) == 1
    assert bits(found) != bits(states[24])
