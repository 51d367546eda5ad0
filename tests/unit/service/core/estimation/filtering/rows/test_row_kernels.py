"""The compiled ordinary row: a state that stays in compiled code gives the bits of one that was brought in."""

import numpy as np
import pytest
from filter_models import aligned, carrier_model

from service.core.estimation.filtering.attitude_filter import start, step
from service.core.estimation.filtering.model.filter_model import FilterSettings, no_motion
from service.core.estimation.filtering.rows.row_kernels import compiled_kernels
from service.core.estimation.filtering.watches.drift_watch import DriftWatch

MINUTE_US = 60_000_000
CARRIERS = 8

pytestmark = pytest.mark.timeout(900)


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
    print("seed", seed)
    rows = np.random.default_rng(seed).normal(0.0, 0.1, (40, CARRIERS))
    states = [start(model, 0, aligned(model))]
    for row in rows:
        states.append(taken(model, settings, states[-1], row))
    return model, settings, rows, states


def taken(model, settings, state, row_db):
    """Return the state after a row by the compiled stages."""
    kernels = compiled_kernels()
    return step(model, settings, state, state.epoch_us + MINUTE_US, row_db, no_motion(), kernels=kernels).state


def test_a_restored_state_goes_on_with_the_same_bits(flown):
    model, settings, rows, states = flown
    state = copied(states[25])
    for row_db, before in zip(rows[25:], states[25:], strict=False):
        assert bits(state) == bits(before)
        state = taken(model, settings, state, row_db)
    assert bits(state) == bits(states[-1])


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


def test_models_that_are_no_longer_used_are_let_go(flown):
    model, settings, rows, states = flown
    made = [carrier_model(CARRIERS, components=3, common=2) for _ in range(70)]
    for each in made:
        assert bits(taken(each, settings, states[0], rows[0])) == bits(states[1])
    assert bits(taken(model, settings, states[-2], rows[-1])) == bits(states[-1])


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
