"""Claims about motion that nobody announced."""

import numpy as np

from service.core.estimation.filtering.motion_watch import (
    FOLLOWED_MINUTES,
    follow_all,
    forget_shifts,
    newly_excused,
    pass_motion,
    push_shift,
    still_watch,
)

MINUTE_US = 60_000_000


def test_shifts_of_one_sign_raise_their_axis_for_an_hour():
    watch = still_watch(0)
    for minute in range(1, 20):
        watch = push_shift(watch, minute * MINUTE_US, np.array([0.1, -1.6, 0.5]))
        if any(watch.is_unannounced):
            break
    assert minute == 10  # 10 (1.6 - 0.6) > 9
    assert watch.is_unannounced == (False, True, False)
    for _ in range(int(FOLLOWED_MINUTES)):
        assert watch.is_unannounced[1]
        watch = pass_motion(watch, 1.0)
    assert not any(watch.is_unannounced)


def test_where_a_torque_acts_the_first_alarm_follows_and_the_second_is_told():
    watch, told = still_watch(0), []
    for minute in range(1, 40):
        before = watch
        watch = push_shift(pass_motion(watch, 1.0), minute * MINUTE_US, np.array([0.0, 1.6, 0.0]), is_pushed=True)
        told.append((watch.is_followed[1], watch.is_unannounced[1], bool(newly_excused(before, watch)[1])))
    # ten minutes to an alarm: followed, and widened once; ten more to what no torque explains
    assert told.index((True, False, True)) == 9
    assert [one[2] for one in told].count(True) == 1
    assert [one[1] for one in told].index(True) == 19
    assert not any(watch.is_unannounced[axis] for axis in (0, 2))


def test_rows_inside_a_minute_wait_for_its_end():
    watch = push_shift(still_watch(0), 10_000_000, np.full(3, 50.0))
    assert not any(watch.is_unannounced)
    assert not any(forget_shifts(watch, 10_000_000).minute.total)


def test_a_jump_is_followed_on_all_axes():
    assert follow_all(still_watch(0)).is_unannounced == (True, True, True)
