"""Claims about motion that nobody announced."""

import numpy as np

from service.core.estimation.filtering.watches.motion_watch import (
    FOLLOWED_MINUTES,
    alarmed_axes,
    follow_all,
    forget_shifts,
    newly_explained,
    pass_motion,
    push_shift,
    still_watch,
    with_alarms,
)

MINUTE_US = 60_000_000


def shifted(watch, epoch_us, shift, *, is_pushed=False):
    """Return the watch after a row, as the filter does it."""
    pushed = push_shift(watch, epoch_us, shift)
    return with_alarms(pushed, is_pushed=is_pushed) if alarmed_axes(pushed).any() else pushed


def test_shifts_of_one_sign_raise_their_axis_for_an_hour():
    watch = still_watch(0)
    for minute in range(1, 20):
        watch = shifted(watch, minute * MINUTE_US, np.array([0.1, -1.6, 0.5]))
        if any(watch.is_unannounced):
            break
    assert minute == 10  # 10 (1.6 - 0.6) > 9
    assert watch.is_unannounced == (False, True, False)
    for _ in range(int(FOLLOWED_MINUTES)):
        assert watch.is_unannounced[1]
        watch = pass_motion(watch, 1.0)
    assert not any(watch.is_unannounced)


def reported_minutes(minutes, **settings):
    """Return for each minute of a steady shift of roll whether it is followed, reported, and newly explained."""
    watch, announced = still_watch(0), []
    for minute in range(1, minutes):
        before = watch
        watch = shifted(pass_motion(watch, 1.0), minute * MINUTE_US, np.array([0.0, 1.6, 0.0]), **settings)
        announced.append((watch.is_followed[1], watch.is_unannounced[1], bool(newly_explained(before, watch)[1])))
    assert not any(watch.is_unannounced[axis] for axis in (0, 2))
    return announced


def test_where_a_torque_acts_the_first_alarm_follows_and_the_second_is_reported():
    announced = reported_minutes(30, is_pushed=True)
    # ten minutes to an alarm: followed, and widened; ten more to the next one, which is reported, and widens again
    assert announced.index((True, False, True)) == 9
    assert [minute for minute, one in enumerate(announced) if one[2]] == [9, 19]
    assert [one[1] for one in announced].index(True) == 19


def test_what_a_torque_may_explain_is_reported_for_a_quarter_of_an_hour():
    """Before: an hour from the second alarm on. Two alarms, then the widened torque explains the shifts."""
    watch, reported = still_watch(0), 0
    for minute in range(1, 120):
        shift = np.array([0.0, 1.6 if minute <= 20 else 0.0, 0.0])
        watch = shifted(pass_motion(watch, 1.0), minute * MINUTE_US, shift, is_pushed=True)
        reported += watch.is_unannounced[1]
    assert reported == 15
    assert not watch.alarms.any()  # still for an hour: the next alarm is a first one


def test_what_no_torque_explains_is_reported_for_an_hour():
    announced = reported_minutes(60, is_pushed=True)
    assert all(one[1] for one in announced[19:])
    jumped = shifted(follow_all(still_watch(0)), MINUTE_US, np.zeros(3), is_pushed=True)
    left = pass_motion(jumped, FOLLOWED_MINUTES - 1.0)
    assert left.is_unannounced == (True, True, True)


def test_rows_inside_a_minute_wait_for_its_end():
    watch = shifted(still_watch(0), 10_000_000, np.full(3, 50.0))
    assert not any(watch.is_unannounced)
    assert not any(forget_shifts(watch, 10_000_000).minute.total)


def test_a_jump_is_followed_on_all_axes():
    assert follow_all(still_watch(0)).is_unannounced == (True, True, True)
