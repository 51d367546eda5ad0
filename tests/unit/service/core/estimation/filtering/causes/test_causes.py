"""Causes that the filter tells apart: a common change, faults of carriers and rain."""

import filter_models
import numpy as np
import pytest

from service.core.estimation.filtering.carrier_watch import (
    MIN_BACK_MINUTES,
    QUIET_ROWS,
    STANDING_ROWS,
    WET_MINUTES,
    count_row,
    flag_failed,
    healthy,
    release_quiet,
    trusted_white_db2,
    watch_flagged,
)
from service.core.estimation.filtering.common_cause import (
    HOLD_MINUTES,
    Cause,
    choose_cause,
    common_fell,
    common_rose,
    dry_watch,
    is_down,
    is_up,
    pass_hold,
    pass_minutes,
    push_common,
)
from service.core.estimation.filtering.causes.common_change import (
    THRESHOLD,
    common_value,
    push_cusum,
    quiet_cusum,
    reset_cusum,
)
from service.core.estimation.filtering.filter_update import innovate
from service.core.estimation.filtering.filter_model import CHAIN, RAIN, pattern_change, reference_states


def minutes_to_alarm(shift, series, seed, longest):
    rng = np.random.default_rng(seed)
    sums, found = quiet_cusum(series), np.full(series, longest)
    for minute in range(longest):
        sums = push_cusum(sums, rng.standard_normal(series) + shift)
        is_alarm = np.maximum(sums.up, sums.down) > THRESHOLD
        found = np.where(is_alarm, np.minimum(found, minute + 1), found)
        sums = reset_cusum(sums, is_alarm)
    return found


def test_a_change_of_four_sigma_takes_three_minutes_and_one_of_a_sigma_twenty():
    assert np.median(minutes_to_alarm(4.0, 400, 1, 20)) == 3  # 9 / 3.4
    assert 13 <= np.median(minutes_to_alarm(-1.2, 400, 2, 60)) <= 18  # 9 / 0.6


def test_a_dry_series_is_quiet_for_weeks():
    alarms = np.count_nonzero(minutes_to_alarm(0.0, 500, 3, 1440) < 1440)
    # 720 000 values; one alarm in a hundred thousand makes seven, and seven is good to a factor of two
    assert alarms <= 16


def test_absent_values_leave_their_sums():
    sums = push_cusum(quiet_cusum(2), np.array([-3.0, 2.0]))
    after = push_cusum(sums, np.array([np.nan, 2.0]))
    assert after.down[0] == sums.down[0] == 2.4
    np.testing.assert_allclose(after.up[1], 2.8)
    assert reset_cusum(after, np.array([False, True])).up.tolist() == [0.0, 0.0]


def test_the_common_value_has_unit_variance_and_ignores_a_minority():
    rng = np.random.default_rng(5)
    covariance = 0.03 * np.eye(15) + 0.004
    rows = rng.multivariate_normal(np.zeros(15), covariance, size=4000)
    values = np.array([common_value(row, covariance)[1] for row in rows])
    # 4000 draws are good to 1.1 %; the median of 15 is a little better than pi/2 says
    assert 0.9 < values.std() < 1.03
    faded = np.zeros(15)
    faded[:6] = -20.0
    assert common_value(faded, covariance) == (0.0, 0.0)
    assert common_value(np.array([1.0, 3.0]), np.eye(2))[0] == 2.0


CARRIERS = 16
EVERYONE = np.arange(CARRIERS)


@pytest.fixture
def model():
    return filter_models.carrier_model(carriers=CARRIERS, groups=3)


def chosen(filter_models, model, change_db, seed, carriers=EVERYONE):
    noise_db = 0.17 * np.random.default_rng(seed).standard_normal(CARRIERS)
    state = filter_models.aligned(model)
    return choose_cause(model, innovate(model, state, change_db + noise_db, carriers, model.white_sigma_db**2))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("size_db", [-2.0, 0.8])
def test_a_transponders_step_is_its_group(model, seed, size_db):
    change_db = np.where(model.transponder == 1, size_db, 0.0)
    choice = chosen(filter_models, model, change_db, seed)
    assert (choice.cause, choice.transponder) == (Cause.GROUP, 1)


@pytest.mark.parametrize("seed", range(5))
def test_a_step_of_all_is_common(model, seed):
    assert chosen(filter_models, model, np.full(CARRIERS, -1.5), seed).cause is Cause.COMMON


@pytest.mark.parametrize("seed", range(5))
def test_a_turn_is_an_attitude_jump(model, seed):
    change_db = pattern_change(model, np.array([0.0, 0.4, -0.5])).deviation_db
    assert chosen(filter_models, model, change_db, seed).cause is Cause.ATTITUDE


@pytest.mark.parametrize("seed", range(5))
def test_single_faults_stay_single(model, seed):
    change_db = np.zeros(CARRIERS)
    change_db[[0, 1, 2, 5]] = [-3.0, 2.0, -1.5, -4.0]
    assert chosen(filter_models, model, change_db, seed).cause is Cause.INDEPENDENT


def test_a_group_with_a_fault_elsewhere_is_still_a_group(model):
    change_db = np.where(model.transponder == 2, 1.5, 0.0)
    change_db[0] = -5.0
    assert chosen(filter_models, model, change_db, 1).cause is Cause.GROUP


def test_too_few_carriers_of_a_transponder_are_no_group(model):
    carriers = np.array([0, 1, 3, 4, 6, 7, 9, 10])  # none of transponder 2, four each of 0 and 1
    change_db = np.where(model.transponder == 1, 2.0, 0.0)
    assert chosen(filter_models, model, change_db, 1, carriers).transponder == 1
    pairs = np.array([0, 1, 3, 4, 6, 9])  # two of transponder 1
    assert chosen(filter_models, model, change_db, 1, pairs).transponder != 1


SIX = np.arange(6)


@pytest.fixture
def small_model():
    return filter_models.carrier_model(carriers=6)


@pytest.fixture
def state(small_model):
    return filter_models.aligned(small_model)


def count_skips(watch, present, excess, minutes):
    """Return the watch after a row that closes no minute, every carrier measured."""
    return count_row(watch, present, excess, np.ones(6, dtype=bool), minutes, np.full(6, np.nan))


def push_carrier_values(watch, values):
    """Return the watch after a row without an excess that closes a minute."""
    return count_row(watch, SIX, np.zeros(6), np.ones(6, dtype=bool), 1.0, values)


def flagged(small_model, state, carrier=2):
    watch = healthy(np.full(6, 0.05**2))
    watch = watch._replace(skip_minutes=np.where(carrier == SIX, 4.0, 0.0))
    return flag_failed(small_model, state, watch, state)


def test_huber_trusts_less_beyond_two_sigma():
    raised = trusted_white_db2(np.full(4, 0.02), np.array([0.0, 2.0, 3.0, 4.0]))
    np.testing.assert_allclose(raised, [0.02, 0.02, 0.03, 0.04])


def test_four_minutes_of_skips_flag_and_a_good_row_forgives(small_model, state):
    excess = np.array([0.0, 0.0, 5.0, 0.0, 5.0, 0.0])
    watch = healthy(np.full(6, 0.05**2))
    for row in range(4):
        assert flag_failed(small_model, state, watch, state)[1] is watch
        watch = count_skips(watch, SIX, excess if row != 2 else excess * [1, 1, 1, 1, 0, 1], 1.0)
    after, reported = flag_failed(small_model, state, watch, state)
    assert np.flatnonzero(reported.is_flagged).tolist() == [2]
    position = reference_states(small_model, np.array([2]))
    assert after.covariance[position, position] == 9.0
    # absent carriers keep their count
    assert count_skips(watch, np.array([0]), np.zeros(1), 1.0).skip_minutes[2] == 4.0


def test_a_slow_fade_that_is_never_skipped_is_flagged_by_its_sum(small_model, state):
    watch = healthy(np.full(6, 0.05**2))
    minute = 0
    while not watch.is_flagged.any():
        watch = push_carrier_values(watch, np.array([0.0, 0.0, 0.0, -1.8, 0.0, np.nan]))
        watch = flag_failed(small_model, state, watch, state)[1]
        minute += 1
    assert minute == 8  # 8 (1.8 - 0.6) > 9
    assert watch.is_flagged[3]
    assert watch.cusum.down[3] == 0.0


def test_one_impulse_is_no_fault(small_model, state):
    watch = push_carrier_values(healthy(np.full(6, 0.05**2)), np.full(6, 40.0))
    assert flag_failed(small_model, state, watch, state)[1] is watch


def test_a_flagged_carrier_at_another_level_returns_when_it_has_stood_for_an_hour(small_model, state):
    _, watch = flagged(small_model, state)
    row = np.array([0.0, 0.0, 1.5, 0.0, 0.0, 0.0])
    minute = 0
    while watch.is_flagged.any():
        watch = watch_flagged(watch, row, 1.0)
        after, watch = release_quiet(small_model, state, watch)
        minute += 1
    assert minute == STANDING_ROWS
    position = reference_states(small_model, np.array([2]))
    assert after.mean[position] == 1.5
    assert after.covariance[position, position] == 9.0
    assert watch.is_relearned.tolist() == [False, False, True, False, False, False]


def test_a_lower_level_is_weather_for_six_hours_and_the_reference_of_the_alignment_is_kept_for_good(small_model, state):
    """Nine of sixteen references were learned wet within a day; then all agreed on a roll that was wrong by 0.2 deg."""
    gaussian, watch = flagged(small_model, state)
    position = reference_states(small_model, np.array([2]))[0]
    minute = 0
    while watch.is_flagged.any():
        watch = watch_flagged(watch, np.array([0.0, 0.0, -1.5, 0.0, 0.0, 0.0]), 1.0)
        gaussian, watch = release_quiet(small_model, gaussian, watch)
        minute += 1
    assert minute == WET_MINUTES
    assert watch.is_relearned[2]
    assert gaussian.mean[position] == -1.5
    # it dries after all: what was learned is forgotten
    watch = watch._replace(skip_minutes=np.array([0.0, 0.0, 4.0, 0.0, 0.0, 0.0]))
    gaussian, watch = flag_failed(small_model, gaussian, watch, gaussian)
    for _ in range(int(MIN_BACK_MINUTES)):
        assert watch.is_flagged[2]
        watch = watch_flagged(watch, np.full(6, 0.1), 1.0)
        gaussian, watch = release_quiet(small_model, gaussian, watch)
    assert not watch.is_flagged.any()
    assert not watch.is_relearned.any()
    assert gaussian.mean[position] == 0.0


def test_an_antenna_that_dries_comes_back_to_its_reference_and_is_not_learned_wet(small_model, state):
    """2 dB of wet antenna, gone to a twentieth in an hour: released once it is within 0.2 dB of what it was."""
    _, watch = flagged(small_model, state)
    minute = 0
    while watch.is_flagged.any():
        loss_db = 2.0 * np.exp(-minute / 20.0)
        watch = watch_flagged(watch, np.array([0.0, 0.0, -loss_db, 0.0, 0.0, 0.0]), 1.0)
        after, watch = release_quiet(small_model, state, watch)
        minute += 1
    assert not watch.is_relearned.any()
    assert loss_db < 0.2
    assert minute >= MIN_BACK_MINUTES
    assert after.mean[reference_states(small_model, np.array([2]))] == watch.saved_reference_db[2]


def test_a_carrier_without_a_reference_is_not_kept_waiting_for_one(small_model, state):
    _, watch = flagged(small_model, state)
    watch = watch._replace(saved_reference_db=np.full(6, np.nan))
    for _ in range(30):
        watch = watch_flagged(watch, np.full(6, 4.0), 1.0)
    _, watch = release_quiet(small_model, state, watch)
    assert not watch.is_flagged.any()
    assert watch.is_relearned[2]


def test_a_carrier_that_comes_back_to_its_level_gets_its_old_reference(small_model, state):
    position = reference_states(small_model, np.array([2]))[0]
    mean = state.mean.copy()
    mean[position] = 0.05
    before = state._replace(mean=mean)
    gaussian, watch = flagged(small_model, before)
    assert watch.saved_reference_db[2] == 0.05
    minute = 0
    while watch.is_flagged.any():
        watch = watch_flagged(watch, np.full(6, 0.15), 1.0)
        after, watch = release_quiet(small_model, gaussian, watch)
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
def test_a_restless_carrier_stays_out(small_model, state, rows):
    _, watch = flagged(small_model, state)
    for value in rows:
        watch = watch_flagged(watch, np.full(6, value), 3.0)
    after, reported = release_quiet(small_model, state, watch)
    assert reported.is_flagged[2]
    assert after is state


@pytest.fixture
def calm():
    return filter_models.aligned(filter_models.carrier_model())


def with_levels(calm, chain_db, rain_db):
    mean = calm.mean.copy()
    mean[CHAIN], mean[RAIN] = chain_db, rain_db
    return calm._replace(mean=mean)


def test_sums_tell_falls_from_rises():
    watch = dry_watch()
    for value in (-5.0, -6.0):
        watch = push_common(watch, value, 0.1)
    assert is_down(watch)
    assert not is_up(watch)
    for value in (8.0, 9.0):
        watch = push_common(watch, value, 0.1)
    assert is_up(watch)


def test_rain_takes_back_what_the_chain_swallowed_before_the_alarm(calm):
    watch = push_common(dry_watch(), 0.3, 0.02)
    for chain_db in (0.0, -0.1, -0.2):
        watch = push_common(watch, -4.0, chain_db)
    fallen = with_levels(calm, -0.25, 0.0)
    after, reported = common_fell(fallen, watch, -0.3)
    assert reported.is_raining
    np.testing.assert_allclose(after.mean[[CHAIN, RAIN]], [0.02, 0.27])
    np.testing.assert_allclose(after.covariance[RAIN, RAIN] - calm.covariance[RAIN, RAIN], 0.25)
    assert not is_down(reported)


def test_a_further_fall_in_rain_only_frees_the_rain(calm):
    raining = dry_watch()._replace(is_raining=True, wet_minutes=7.0)
    after, reported = common_fell(with_levels(calm, 0.0, 1.0), raining, -3.0)
    assert after.mean[RAIN] == 1.0
    assert reported.wet_minutes == 7.0
    np.testing.assert_allclose(after.covariance[RAIN, RAIN], 9.0, rtol=1e-3)


def test_a_rise_frees_the_chain_and_holds_control_for_ten_minutes(calm):
    after, watch = common_rose(calm, dry_watch(), 3.0)
    np.testing.assert_allclose(after.covariance[CHAIN, CHAIN] - calm.covariance[CHAIN, CHAIN], 9.0)
    assert watch.hold_minutes == HOLD_MINUTES
    for _ in range(10):
        assert watch.hold_minutes > 0.0
        watch = pass_hold(watch, 1.0)
    assert watch.hold_minutes == 0.0


def test_rain_that_recedes_is_no_step_of_the_chain(calm):
    raining = dry_watch()._replace(is_raining=True)
    after, watch = common_rose(with_levels(calm, 0.0, 3.0), raining, 3.0)
    assert watch.hold_minutes == 0.0
    assert after.covariance[RAIN, RAIN] > 8.9
    _, stepped = common_rose(with_levels(calm, 0.0, 0.5), raining, 3.0)
    assert stepped.hold_minutes == HOLD_MINUTES


def test_rain_ends_after_eight_dry_minutes_and_leaves_the_sum_of_levels(calm):
    watch = dry_watch()._replace(is_raining=True)
    _, watch = pass_minutes(with_levels(calm, 0.2, 0.1), watch, 1.0)
    _, watch = pass_minutes(with_levels(calm, 0.2, 0.4), watch, 1.0)
    assert watch.dry_minutes == 0.0
    minutes, drying = 0, with_levels(calm, 0.2, 0.1)
    while watch.is_raining:
        after, watch = pass_minutes(drying, watch, 1.0)
        minutes += 1
    assert minutes == 8
    assert not watch.is_steady
    np.testing.assert_allclose(after.mean[[CHAIN, RAIN]], [0.1, 0.0])
    expected = drying.covariance[CHAIN, CHAIN] + drying.covariance[RAIN, RAIN]
    np.testing.assert_allclose(after.covariance[CHAIN, CHAIN], expected)
    assert np.linalg.eigvalsh(after.covariance).min() > 0.0


def minutes_until_dry(calm, rain_db, longest=240):
    watch = dry_watch()._replace(is_raining=True)
    for minute in range(1, longest + 1):
        _, watch = pass_minutes(with_levels(calm, 0.0, rain_db(minute)), watch, 1.0)
        if not watch.is_raining:
            return minute, watch.is_steady
    return longest + 1, False


def test_a_small_steady_fall_is_a_step_of_the_chain_after_ninety_minutes(calm):
    assert minutes_until_dry(calm, lambda _minute: 0.4) == (90, True)
    assert minutes_until_dry(calm, lambda _minute: 3.0) == (241, False)
    assert minutes_until_dry(calm, lambda minute: 0.6 + 0.3 * (minute % 2)) == (241, False)
