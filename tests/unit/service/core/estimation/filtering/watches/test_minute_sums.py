"""Claims about values of a minute."""

import numpy as np

from service.core.estimation.filtering.watches.minute_sums import empty_minute, push_minute


def test_rows_a_minute_apart_are_minutes_each():
    minute = push_minute(empty_minute(2, 0), 59_990_000, np.array([1.5, np.nan]))
    np.testing.assert_array_equal(minute.values, [1.5, np.nan])
    assert minute.sums.start_us == 59_990_000


def test_ten_second_rows_are_added_up_with_unit_variance():
    rng, values = np.random.default_rng(1), []
    sums = empty_minute(1, 0)
    for row in range(1, 6 * 2000 + 1):
        sums, is_over, value = push_minute(sums, row * 10_000_000, rng.standard_normal(1))
        if is_over:
            values.append(float(value[0]))
    assert len(values) == 2000
    assert abs(np.std(values) - 1.0) < 0.05  # 2000 draws are good to 1.6 %


def test_a_gap_closes_the_minute():
    sums, is_over, _ = push_minute(empty_minute(1, 0), 5_000_000, np.array([2.0]))
    assert not is_over
    assert push_minute(sums, 9_000_000_000, np.array([2.0])).values[0] == 4.0 / np.sqrt(2.0)
