"""Claims about motion that nobody announced."""

import numpy as np

from service.core.estimation.filtering.motion_watch import (
    FOLLOWED_MINUTES,
    follow_all,
    forget_shifts,
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


def test_rows_inside_a_minute_wait_for_its_end():
    watch = push_shift(still_watch(0), 10_000_000, np.full(3, 50.0))
    assert not any(watch.is_unannounced)
    assert not any(forget_shifts(watch, 10_000_000).minute.total)


def test_a_jump_is_followed_on_all_axes():
    assert follow_all(still_watch(0)).is_unannounced == (True, True, True)
