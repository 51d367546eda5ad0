"""Claims about faults of single carriers."""

import filter_models
import numpy as np
import pytest

from service.core.estimation.filtering.causes.carrier_faults import (
    QUIET_ROWS,
    STANDING_ROWS,
    count_row,
    flag_failed,
    healthy,
    trusted_white_db2,
    watch_flagged,
)
from service.core.estimation.filtering.causes.carrier_return import MIN_BACK_MINUTES, WET_MINUTES, release_quiet
from service.core.estimation.filtering.model.filter_state import reference_states

EVERYONE = np.arange(6)


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=6)


@pytest.fixture
def state(model):
    return filter_models.aligned(model)


def count_skips(watch, present, excess, minutes):
    """Return the watch after a row that closes no minute, every carrier measured."""
    return count_row(watch, present, excess, np.ones(6, dtype=bool), minutes, np.full(6, np.nan))


def push_carrier_values(watch, values):
    """Return the watch after a row without an excess that closes a minute."""
    return count_row(watch, EVERYONE, np.zeros(6), np.ones(6, dtype=bool), 1.0, values)


def flagged(model, state, carrier=2):
    watch = healthy(np.full(6, 0.05**2))
    watch = watch._replace(skip_minutes=np.where(carrier == EVERYONE, 4.0, 0.0))
    return flag_failed(model, state, watch, state)


def test_huber_trusts_less_beyond_two_sigma():
    raised = trusted_white_db2(np.full(4, 0.02), np.array([0.0, 2.0, 3.0, 4.0]))
    np.testing.assert_allclose(raised, [0.02, 0.02, 0.03, 0.04])


def test_four_minutes_of_skips_flag_and_a_good_row_forgives(model, state):
    excess = np.array([0.0, 0.0, 5.0, 0.0, 5.0, 0.0])
    watch = healthy(np.full(6, 0.05**2))
    for row in range(4):
        assert flag_failed(model, state, watch, state)[1] is watch
        watch = count_skips(watch, EVERYONE, excess if row != 2 else excess * [1, 1, 1, 1, 0, 1], 1.0)
    after, reported = flag_failed(model, state, watch, state)
    assert np.flatnonzero(reported.is_flagged).tolist() == [2]
    position = reference_states(model, np.array([2]))
    assert after.covariance[position, position] == 9.0
    # absent carriers keep their count
    assert count_skips(watch, np.array([0]), np.zeros(1), 1.0).skip_minutes[2] == 4.0


def test_rows_of_ten_seconds_take_the_same_minutes(model, state):
    watch = healthy(np.full(6, 0.05**2))
    for _ in range(24):
        assert not flag_failed(model, state, watch, state)[1].is_flagged.any()
        watch = count_skips(watch, np.array([1]), np.array([9.0]), 10.0 / 60.0)
    assert flag_failed(model, state, watch, state)[1].is_flagged[1]


def test_a_slow_fade_that_is_never_skipped_is_flagged_by_its_sum(model, state):
    watch = healthy(np.full(6, 0.05**2))
    minute = 0
    while not watch.is_flagged.any():
        watch = push_carrier_values(watch, np.array([0.0, 0.0, 0.0, -1.8, 0.0, np.nan]))
        watch = flag_failed(model, state, watch, state)[1]
        minute += 1
    assert minute == 8  # 8 (1.8 - 0.6) > 9
    assert watch.is_flagged[3]
    assert watch.cusum.down[3] == 0.0


def test_one_impulse_is_no_fault(model, state):
    watch = push_carrier_values(healthy(np.full(6, 0.05**2)), np.full(6, 40.0))
    assert flag_failed(model, state, watch, state)[1] is watch


def test_a_flagged_carrier_at_another_level_returns_when_it_has_stood_for_an_hour(model, state):
    _, watch = flagged(model, state)
    row = np.array([0.0, 0.0, 1.5, 0.0, 0.0, 0.0])
    minute = 0
    while watch.is_flagged.any():
        watch = watch_flagged(watch, row, 1.0)
        after, watch = release_quiet(model, state, watch)
        minute += 1
    assert minute == STANDING_ROWS
    position = reference_states(model, np.array([2]))
    assert after.mean[position] == 1.5
    assert after.covariance[position, position] == 9.0
    assert watch.is_relearned.tolist() == [False, False, True, False, False, False]


def test_a_lower_level_is_weather_for_six_hours_and_the_reference_of_the_alignment_is_kept_for_good(model, state):
    """Nine of sixteen references were learned wet within a day; then all agreed on a roll that was wrong by 0.2 deg."""
    gaussian, watch = flagged(model, state)
    position = reference_states(model, np.array([2]))[0]
    minute = 0
    while watch.is_flagged.any():
        watch = watch_flagged(watch, np.array([0.0, 0.0, -1.5, 0.0, 0.0, 0.0]), 1.0)
        gaussian, watch = release_quiet(model, gaussian, watch)
        minute += 1
    assert minute == WET_MINUTES
    assert watch.is_relearned[2]
    assert gaussian.mean[position] == -1.5
    # it dries after all: what was learned is forgotten
    watch = watch._replace(skip_minutes=np.array([0.0, 0.0, 4.0, 0.0, 0.0, 0.0]))
    gaussian, watch = flag_failed(model, gaussian, watch, gaussian)
    for _ in range(int(MIN_BACK_MINUTES)):
        assert watch.is_flagged[2]
        watch = watch_flagged(watch, np.full(6, 0.1), 1.0)
        gaussian, watch = release_quiet(model, gaussian, watch)
    assert not watch.is_flagged.any()
    assert not watch.is_relearned.any()
    assert gaussian.mean[position] == 0.0


def test_an_antenna_that_dries_comes_back_to_its_reference_and_is_not_learned_wet(model, state):
    """2 dB of wet antenna, gone to a twentieth in an hour: released once it is within 0.2 dB of what it was."""
    _, watch = flagged(model, state)
    minute = 0
    while watch.is_flagged.any():
        loss_db = 2.0 * np.exp(-minute / 20.0)
        watch = watch_flagged(watch, np.array([0.0, 0.0, -loss_db, 0.0, 0.0, 0.0]), 1.0)
        after, watch = release_quiet(model, state, watch)
        minute += 1
    assert not watch.is_relearned.any()
    assert loss_db < 0.2
    assert minute >= MIN_BACK_MINUTES
    assert after.mean[reference_states(model, np.array([2]))] == watch.saved_reference_db[2]


def test_a_carrier_without_a_reference_is_not_kept_waiting_for_one(model, state):
    _, watch = flagged(model, state)
    watch = watch._replace(saved_reference_db=np.full(6, np.nan))
    for _ in range(30):
        watch = watch_flagged(watch, np.full(6, 4.0), 1.0)
    _, watch = release_quiet(model, state, watch)
    assert not watch.is_flagged.any()
    assert watch.is_relearned[2]


def test_a_carrier_that_comes_back_to_its_level_gets_its_old_reference(model, state):
    position = reference_states(model, np.array([2]))[0]
    mean = state.mean.copy()
    mean[position] = 0.05
    before = state._replace(mean=mean)
    gaussian, watch = flagged(model, before)
    assert watch.saved_reference_db[2] == 0.05
    minute = 0
    while watch.is_flagged.any():
        watch = watch_flagged(watch, np.full(6, 0.15), 1.0)
        after, watch = release_quiet(model, gaussian, watch)
        minute += 1
    assert minute == MIN_BACK_MINUTES
    assert not watch.is_flagged.any()
    assert not watch.is_relearned.any()
    assert after.mean[position] == 0.05
    np.testing.assert_allclose(after.covariance[position, position], 0.03**2 + 0.1**2, rtol=1e-9)


@pytest.mark.parametrize(
    "rows",
    [
        np.linspace(0.0, 1.0, QUIET_ROWS),
        np.tile([-0.4, 0.4], QUIET_ROWS // 2),
        np.append(np.zeros(QUIET_ROWS - 1), np.nan),
    ],
    ids=["shifting", "noisy", "absent"],
)
def test_a_restless_carrier_stays_out(model, state, rows):
    _, watch = flagged(model, state)
    for value in rows:
        watch = watch_flagged(watch, np.full(6, value), 3.0)
    after, reported = release_quiet(model, state, watch)
    assert reported.is_flagged[2]
    assert after is state
