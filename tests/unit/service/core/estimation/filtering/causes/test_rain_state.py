"""Claims about common changes and the ways out of them."""

import filter_models
import numpy as np
import pytest

from service.core.estimation.filtering.causes.rain_state import (
    HOLD_MINUTES,
    common_fell,
    common_rose,
    dry_watch,
    is_down,
    is_up,
    pass_hold,
    pass_minutes,
    push_common,
)
from service.core.estimation.filtering.model.filter_state import CHAIN, RAIN


@pytest.fixture
def state():
    return filter_models.aligned(filter_models.carrier_model())


def with_levels(state, chain_db, rain_db):
    mean = state.mean.copy()
    mean[CHAIN], mean[RAIN] = chain_db, rain_db
    return state._replace(mean=mean)


def test_sums_tell_falls_from_rises():
    watch = dry_watch()
    for value in (-5.0, -6.0):
        watch = push_common(watch, value, 0.1)
    assert is_down(watch)
    assert not is_up(watch)
    for value in (8.0, 9.0):
        watch = push_common(watch, value, 0.1)
    assert is_up(watch)


def test_rain_takes_back_what_the_chain_swallowed_before_the_alarm(state):
    watch = push_common(dry_watch(), 0.3, 0.02)
    for chain_db in (0.0, -0.1, -0.2):
        watch = push_common(watch, -4.0, chain_db)
    fallen = with_levels(state, -0.25, 0.0)
    after, reported = common_fell(fallen, watch, -0.3)
    assert reported.is_raining
    np.testing.assert_allclose(after.mean[[CHAIN, RAIN]], [0.02, 0.27])
    np.testing.assert_allclose(after.covariance[RAIN, RAIN] - state.covariance[RAIN, RAIN], 0.25)
    assert not is_down(reported)


def test_a_further_fall_in_rain_only_frees_the_rain(state):
    raining = dry_watch()._replace(is_raining=True, wet_minutes=7.0)
    after, reported = common_fell(with_levels(state, 0.0, 1.0), raining, -3.0)
    assert after.mean[RAIN] == 1.0
    assert reported.wet_minutes == 7.0
    np.testing.assert_allclose(after.covariance[RAIN, RAIN], 9.0, rtol=1e-3)


def test_a_rise_frees_the_chain_and_holds_control_for_ten_minutes(state):
    after, watch = common_rose(state, dry_watch(), 3.0)
    np.testing.assert_allclose(after.covariance[CHAIN, CHAIN] - state.covariance[CHAIN, CHAIN], 9.0)
    assert watch.hold_minutes == HOLD_MINUTES
    for _ in range(10):
        assert watch.hold_minutes > 0.0
        watch = pass_hold(watch, 1.0)
    assert watch.hold_minutes == 0.0


def test_rain_that_recedes_is_no_step_of_the_chain(state):
    raining = dry_watch()._replace(is_raining=True)
    after, watch = common_rose(with_levels(state, 0.0, 3.0), raining, 3.0)
    assert watch.hold_minutes == 0.0
    assert after.covariance[RAIN, RAIN] > 8.9
    _, stepped = common_rose(with_levels(state, 0.0, 0.5), raining, 3.0)
    assert stepped.hold_minutes == HOLD_MINUTES


def test_rain_ends_after_eight_dry_minutes_and_leaves_the_sum_of_levels(state):
    watch = dry_watch()._replace(is_raining=True)
    _, watch = pass_minutes(with_levels(state, 0.2, 0.1), watch, 1.0)
    _, watch = pass_minutes(with_levels(state, 0.2, 0.4), watch, 1.0)
    assert watch.dry_minutes == 0.0
    minutes, drying = 0, with_levels(state, 0.2, 0.1)
    while watch.is_raining:
        after, watch = pass_minutes(drying, watch, 1.0)
        minutes += 1
    assert minutes == 8
    assert not watch.is_steady
    np.testing.assert_allclose(after.mean[[CHAIN, RAIN]], [0.1, 0.0])
    expected = drying.covariance[CHAIN, CHAIN] + drying.covariance[RAIN, RAIN]
    np.testing.assert_allclose(after.covariance[CHAIN, CHAIN], expected)
    assert np.linalg.eigvalsh(after.covariance).min() > 0.0


def minutes_until_dry(state, rain_db, longest=240):
    watch = dry_watch()._replace(is_raining=True)
    for minute in range(1, longest + 1):
        _, watch = pass_minutes(with_levels(state, 0.0, rain_db(minute)), watch, 1.0)
        if not watch.is_raining:
            return minute, watch.is_steady
    return longest + 1, False


def test_a_small_steady_fall_is_a_step_of_the_chain_after_ninety_minutes(state):
    assert minutes_until_dry(state, lambda _minute: 0.4) == (90, True)
    assert minutes_until_dry(state, lambda _minute: 3.0) == (241, False)
    assert minutes_until_dry(state, lambda minute: 0.6 + 0.3 * (minute % 2)) == (241, False)
