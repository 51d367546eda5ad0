"""Claims about the trailing mean: what is in it, and that a replay gives the same bits."""

import numpy as np
import pytest

from service.core.estimation.paper.trailing_mean import empty_window, mean, push

MINUTE_US = 60_000_000


def filled(rows, start_us=0, step_us=MINUTE_US, state=None):
    state = empty_window(rows.shape[1]) if state is None else state
    for k, row in enumerate(rows):
        state = push(state, start_us + k * step_us, row)
    return state


def test_it_is_the_mean_of_the_rows_in_the_window():
    rows = np.random.default_rng(1).standard_normal((40, 3))
    expected = rows[-15:].mean(axis=0)  # 900 s at 60 s
    np.testing.assert_allclose(mean(filled(rows)), expected, rtol=0.0, atol=1e-15)  # order of sums


def test_absent_values_are_left_out_and_too_few_give_nan():
    rows = np.ones((15, 2))
    rows[:7, 0] = np.nan
    rows[:8, 1] = np.nan
    result = mean(filled(rows), window_s=900.0, min_rows=8)
    assert result[0] == 1.0
    assert np.isnan(result[1])


def test_the_window_is_open_at_its_old_end():
    rows = np.array([[100.0], [1.0], [3.0]])
    assert mean(filled(rows), window_s=120.0, min_rows=1)[0] == 2.0


def test_an_absent_neighbour_leaves_every_bit_of_a_mean():
    rows = np.random.default_rng(2).standard_normal((40, 3))
    with_gap = rows.copy()
    with_gap[33, 0] = np.nan
    assert np.array_equal(mean(filled(rows))[1:], mean(filled(with_gap))[1:])


def test_an_empty_window_has_no_mean():
    assert np.isnan(mean(empty_window(4), min_rows=0)).all()


def test_a_gap_longer_than_the_window_leaves_only_the_new_rows():
    state = push(filled(np.zeros((15, 1))), 10_000 * MINUTE_US, np.array([5.0]))
    assert mean(state, min_rows=1)[0] == 5.0
    assert np.isnan(mean(state, min_rows=2)[0])
    assert state.epoch_us.tolist() == [10_000 * MINUTE_US]


@pytest.mark.parametrize("epoch_us", [14 * MINUTE_US, 3 * MINUTE_US, -MINUTE_US])
def test_late_and_duplicate_rows_change_nothing(epoch_us):
    state = filled(np.zeros((15, 1)))
    assert push(state, epoch_us, np.array([9.0])) is state


def test_a_state_is_never_changed_by_a_push():
    state = filled(np.zeros((5, 1)))
    push(state, 5 * MINUTE_US, np.array([9.0]))
    assert state.rows.shape == (5, 1)
    with pytest.raises(ValueError, match="read-only"):
        state.rows[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        state.epoch_us[0] = 1


def test_the_state_does_not_hold_on_to_the_callers_row():
    row = np.array([1.0])
    state = push(empty_window(1), 0, row)
    row[0] = 2.0
    assert state.rows[0, 0] == 1.0


def test_the_state_forgets_what_the_horizon_excludes():
    state = filled(np.zeros((200, 2)))
    assert state.rows.shape == (60, 2)


def test_a_replay_from_any_state_gives_the_same_bits():
    rng = np.random.default_rng(4)
    rows = rng.standard_normal((120, 16)) * 10.0 ** rng.integers(-6, 3, (120, 16))
    rows[rng.random((120, 16)) < 0.2] = np.nan
    live = filled(rows)
    for start in (30, 80, 104):
        replayed = filled(rows[start:], start_us=start * MINUTE_US)
        assert mean(live).tobytes() == mean(replayed).tobytes()
    restarted = filled(rows[50:], start_us=50 * MINUTE_US, state=filled(rows[:50]))
    assert mean(live).tobytes() == mean(restarted).tobytes()


def test_a_shorter_horizon_gives_the_same_bits():
    rows = np.random.default_rng(5).standard_normal((120, 16))
    short = filled(rows, state=empty_window(16, horizon_s=900.0))
    assert short.rows.shape == (15, 16)
    assert mean(short).tobytes() == mean(filled(rows)).tobytes()
