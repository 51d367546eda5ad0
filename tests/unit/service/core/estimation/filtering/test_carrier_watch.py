"""Faults of single carriers: weighed, skipped, flagged, released."""

import filter_models
import numpy as np
import pytest
from filter_models import reference_states

from service.core.estimation.filtering.carrier_watch import (
    MIN_BACK_MINUTES,
    QUIET_ROWS,
    THRESHOLD,
    WET_MINUTES,
    count_row,
    failed,
    pushed_minute,
    pushed_sum,
    release_quiet,
    restart_carrier,
    set_aside,
    trusted,
    watch_flagged,
)
from service.core.estimation.filtering.filter_model import ATTITUDE, carrier_states, core_size
from service.core.estimation.filtering.filter_state import STANDING_ROWS, start
from service.core.estimation.filtering.plant import filter_model

SIX = np.arange(6)
NOTHING = np.full(6, np.nan)


def minutes_to_alarm(shift, series, seed, longest):
    rng, found = np.random.default_rng(seed), []
    for values in rng.standard_normal((series, longest)) + shift:
        up = down = 0.0
        minute = 0
        while max(up, down) <= THRESHOLD and minute < longest:
            up, down = pushed_sum(up, values[minute]), pushed_sum(down, -values[minute])
            minute += 1
        found.append(minute)
    return np.array(found)


def test_a_change_of_four_sigma_takes_three_minutes_and_one_of_a_sigma_twenty():
    assert np.median(minutes_to_alarm(4.0, 400, 1, 20)) == 3  # 9 / 3.4
    assert 13 <= np.median(minutes_to_alarm(-1.2, 400, 2, 60)) <= 18  # 9 / 0.6


def test_a_dry_series_is_quiet_for_weeks():
    alarms = np.count_nonzero(minutes_to_alarm(0.0, 500, 3, 1440) < 1440)
    # 720 000 values; one alarm in a hundred thousand makes seven, and seven is good to a factor of two
    assert alarms <= 16


def test_absent_values_leave_their_sums():
    down = pushed_sum(0.0, 3.0)
    assert pushed_sum(down, np.nan) == down == 2.4
    assert pushed_sum(pushed_sum(0.0, 2.0), 2.0) == pytest.approx(2.8)


def test_the_rows_of_a_minute_are_added_up_with_unit_variance():
    rng, values = np.random.default_rng(1), []
    for _ in range(2000):
        total = rows = 0.0
        for drawn in rng.standard_normal(6):
            total, rows, value = pushed_minute(total, rows, drawn)
        values.append(value)
    assert abs(np.std(values) - 1.0) < 0.05  # 2000 draws are good to 1.6 %
    assert pushed_minute(2.0, 1.0, 2.0)[2] == 4.0 / np.sqrt(2.0)
    assert pushed_minute(2.0, 1.0, np.nan)[2] == 2.0
    assert np.isnan(pushed_minute(0.0, 0.0, np.nan)[2])


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=6)


@pytest.fixture
def compiled(model):
    return filter_model(model)


@pytest.fixture
def state(model):
    return start(model, 0, filter_models.aligned(model))


def reference(model, carrier=2):
    return reference_states(model, np.array([carrier]))[0]


def flag_failed(compiled, state):
    """Set the carriers aside that have failed, as a row does, in place."""
    references = state.mean[-6:].copy(), np.diagonal(state.covariance)[-6:].copy()
    for k in np.flatnonzero(failed(state.carriers)):
        set_aside(compiled, state, k, references[0][k], references[1][k])


def count_skips(compiled, state, present, excess, minutes):
    """Count a row that closes no minute, every carrier measured."""
    innovation = filter_models.innovated(compiled, state.gaussian, np.zeros(6), np.asarray(present))
    count_row(state.carriers, innovation, np.asarray(excess), np.ones(6, dtype=bool), minutes, NOTHING)


def push_values(compiled, state, values):
    """Count a row without an excess that closes a minute."""
    innovation = filter_models.innovated(compiled, state.gaussian, np.zeros(6))
    count_row(state.carriers, innovation, np.zeros(6), np.ones(6, dtype=bool), 1.0, values)


def pass_minute(compiled, state, rows_db, minutes=1.0):
    watch_flagged(state, rows_db, minutes)
    return release_quiet(compiled, state)


@pytest.fixture
def flagged(compiled, state):
    state.carriers["skip_minutes"][2] = 4.0
    flag_failed(compiled, state)
    return state


def minutes_until_released(compiled, state, rows_db):
    """Return how long carrier 2 stays out; `rows_db` tells the levels of a minute."""
    minute = 0
    while state.carriers["is_flagged"].any():
        pass_minute(compiled, state, rows_db(minute))
        minute += 1
    return minute


def test_huber_trusts_less_beyond_two_sigma_and_skips_beyond_four(compiled, state):
    innovation = filter_models.innovated(compiled, state.gaussian, np.zeros(6), SIX[:5])
    kept = trusted(innovation, np.array([0.0, 2.0, 3.0, 4.0, 4.1]))
    np.testing.assert_allclose(kept.white_db2, innovation.white_db2[:4] * [1.0, 1.0, 1.5, 2.0])
    assert kept.carriers.tolist() == [0, 1, 2, 3]
    np.testing.assert_array_equal(kept.predicted_db2, innovation.predicted_db2[:4, :4])


def test_a_carrier_that_begins_again_knows_nothing_of_the_others(model, compiled, state):
    state.covariance[: core_size(model) + 18, : core_size(model) + 18] += 0.01
    attitude = state.covariance[ATTITUDE, ATTITUDE].copy()
    restart_carrier(compiled, state, 2, 1.5, 9.0)
    positions = carrier_states(model, np.array([2])).ravel()
    others = np.setdiff1d(np.arange(len(state.mean)), positions)
    assert not state.covariance[np.ix_(positions, others)].any()
    assert not state.covariance[np.ix_(others, positions)].any()
    assert state.mean[positions[-1]] == 1.5
    np.testing.assert_allclose(np.diag(state.covariance)[positions], [0.07**2, 0.03**2, 9.0])
    np.testing.assert_array_equal(state.covariance[ATTITUDE, ATTITUDE], attitude)


def test_four_minutes_of_skips_flag_and_a_good_row_forgives(model, compiled, state):
    excess = np.array([0.0, 0.0, 5.0, 0.0, 5.0, 0.0])
    for row in range(4):
        assert not failed(state.carriers).any()
        count_skips(compiled, state, SIX, excess if row != 2 else excess * [1, 1, 1, 1, 0, 1], 1.0)
    # absent carriers keep their count
    absent = filter_models.copied(state)
    count_skips(compiled, absent, [0], [0.0], 1.0)
    assert absent.carriers["skip_minutes"][2] == 4.0
    flag_failed(compiled, state)
    assert np.flatnonzero(state.carriers["is_flagged"]).tolist() == [2]
    assert state.covariance[reference(model), reference(model)] == 9.0


def test_a_slow_fade_that_is_never_skipped_is_flagged_by_its_sum(compiled, state):
    minute = 0
    while not state.carriers["is_flagged"].any():
        push_values(compiled, state, np.array([0.0, 0.0, 0.0, -1.8, 0.0, np.nan]))
        flag_failed(compiled, state)
        minute += 1
    assert minute == 8  # 8 (1.8 - 0.6) > 9
    assert state.carriers["is_flagged"][3]
    assert state.carriers["down"][3] == 0.0


def test_one_impulse_is_no_fault(compiled, state):
    push_values(compiled, state, np.full(6, 40.0))
    assert not failed(state.carriers).any()


def test_a_flagged_carrier_at_another_level_returns_when_it_has_stood_for_an_hour(model, compiled, flagged):
    level_db = np.where(SIX == 2, 1.5, 0.0)
    assert minutes_until_released(compiled, flagged, lambda _minute: level_db) == STANDING_ROWS
    assert flagged.mean[reference(model)] == 1.5
    assert flagged.covariance[reference(model), reference(model)] == 9.0
    assert flagged.carriers["is_relearned"].tolist() == [False, False, True, False, False, False]


def test_a_lower_level_is_weather_for_six_hours_and_the_reference_of_the_alignment_is_kept_for_good(
    model, compiled, flagged
):
    """Nine of sixteen references were learned wet within a day; then all agreed on a roll that was wrong by 0.2 deg."""
    level_db = np.where(SIX == 2, -1.5, 0.0)
    assert minutes_until_released(compiled, flagged, lambda _minute: level_db) == WET_MINUTES
    assert flagged.carriers["is_relearned"][2]
    assert flagged.mean[reference(model)] == -1.5
    # it dries after all: what was learned is forgotten
    flagged.carriers["skip_minutes"][2] = 4.0
    flag_failed(compiled, flagged)
    assert minutes_until_released(compiled, flagged, lambda _minute: np.full(6, 0.1)) == MIN_BACK_MINUTES
    assert not flagged.carriers["is_relearned"].any()
    assert flagged.mean[reference(model)] == 0.0


def test_an_antenna_that_dries_comes_back_to_its_reference_and_is_not_learned_wet(model, compiled, flagged):
    """2 dB of wet antenna, gone to a twentieth in an hour: released once it is within 0.2 dB of what it was."""
    loss_db = 2.0 * np.exp(-np.arange(400) / 20.0)
    minute = minutes_until_released(compiled, flagged, lambda minute: np.where(SIX == 2, -loss_db[minute], 0.0))
    assert not flagged.carriers["is_relearned"].any()
    assert loss_db[minute - 1] < 0.2
    assert minute >= MIN_BACK_MINUTES
    assert flagged.mean[reference(model)] == flagged.carriers["saved_reference_db"][2]


def test_a_carrier_without_a_reference_is_not_kept_waiting_for_one(compiled, flagged):
    flagged.carriers["saved_reference_db"] = flagged.carriers["aligned_reference_db"] = np.nan
    for _ in range(30):
        assert flagged.carriers["is_flagged"][2]
        pass_minute(compiled, flagged, np.full(6, 4.0))
    assert not flagged.carriers["is_flagged"].any()
    assert flagged.carriers["is_relearned"][2]


def test_a_carrier_that_comes_back_to_its_level_gets_its_old_reference(model, compiled, state):
    state.mean[reference(model)] = 0.05
    state.carriers["skip_minutes"][2] = 4.0
    flag_failed(compiled, state)
    assert state.carriers["saved_reference_db"][2] == 0.05
    assert minutes_until_released(compiled, state, lambda _minute: np.full(6, 0.15)) == MIN_BACK_MINUTES
    assert not state.carriers["is_relearned"].any()
    assert state.mean[reference(model)] == 0.05
    np.testing.assert_allclose(state.covariance[reference(model), reference(model)], 0.03**2 + 0.1**2, rtol=1e-9)


@pytest.mark.parametrize(
    "rows",
    [
        np.linspace(0.0, 1.0, QUIET_ROWS),
        np.tile([-0.4, 0.4], QUIET_ROWS // 2),
        np.append(np.zeros(QUIET_ROWS - 1), np.nan),
    ],
    ids=["shifting", "noisy", "absent"],
)
def test_a_restless_carrier_stays_out(compiled, flagged, rows):
    for value in rows:
        watch_flagged(flagged, np.full(6, value), 3.0)
    before = filter_models.bits(flagged)
    assert not release_quiet(compiled, flagged)
    assert filter_models.bits(flagged) == before
    assert flagged.carriers["is_flagged"][2]


def test_a_carrier_that_was_off_for_half_an_hour_shows_its_level_first(compiled, state):
    for _ in range(30):
        assert not failed(state.carriers).any()
        innovation = filter_models.innovated(compiled, state.gaussian, np.zeros(6), SIX[:5])
        count_row(state.carriers, innovation, np.zeros(5), SIX < 5, 1.0, NOTHING)
    assert np.flatnonzero(failed(state.carriers)).tolist() == [5]
