"""Rate of the last fixes: a slope over a window, and nothing while the window is too young."""

import numpy as np
import pytest

from service.pipeline.estimation.paper.rate_filter import NO_FIXES, rate_deg_s, remember_fix

S = 1_000_000
WINDOW_S = 1800.0


def history(count, step_s=60, rate=(1e-5, -2e-5, 3e-5), start_us=10**15):
    fixes = NO_FIXES
    for k in range(count):
        angles = np.array([0.1, 0.2, 0.3]) + np.array(rate) * k * step_s
        fixes = remember_fix(fixes, start_us + k * step_s * S, angles, WINDOW_S)
    return fixes


def test_a_steady_turn_gives_its_rate():
    # least squares of a straight line: rounding of angles of 0.3 deg over half an hour
    np.testing.assert_allclose(rate_deg_s(history(31), WINDOW_S), [1e-5, -2e-5, 3e-5], rtol=1e-9)


@pytest.mark.parametrize(("count", "is_known"), [(0, False), (2, False), (10, False), (11, True), (31, True)])
def test_less_than_a_third_of_the_window_gives_none(count, is_known):
    assert (rate_deg_s(history(count), WINDOW_S) is not None) == is_known


def test_two_fixes_far_apart_are_not_enough():
    assert rate_deg_s(history(2, step_s=900), WINDOW_S) is None
    assert np.isfinite(rate_deg_s(history(3, step_s=400), WINDOW_S)).all()


def test_old_fixes_are_forgotten_and_the_former_history_is_left_alone():
    before = history(31)
    after = remember_fix(before, before.epochs_us[-1] + 600 * S, np.zeros(3), WINDOW_S)
    assert (len(before.epochs_us), len(after.epochs_us)) == (30, 21)
    assert after.epochs_us[-1] - after.epochs_us[0] < WINDOW_S * S
