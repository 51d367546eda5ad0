"""Claims about the two-sided cumulative sum and the common value."""

import numpy as np

from service.core.estimation.filtering.causes.common_change import (
    THRESHOLD,
    common_value,
    push_cusum,
    quiet_cusum,
    reset_cusum,
)


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
