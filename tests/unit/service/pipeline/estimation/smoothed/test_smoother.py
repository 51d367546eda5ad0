"""A span leaves block by block in bounded memory, and each row as if all later ones were known."""

from collections import deque

import filter_models
import numpy as np
import pytest

from service.core.estimation.filtering.model.filter_state import ATTITUDE
from service.pipeline.estimation.smoothed import smoother
from service.pipeline.estimation.smoothed.smoother import SpanSmoother, angles_of, lagged_angles

#: a row each ten minutes for thirty hours
ROW_US, ROWS, CARRIERS = 600_000_000, 180, 6
HOUR_US = 3_600_000_000


class Kept:
    """Recorder of rows that are handed to it."""

    def __init__(self):
        self.rows = deque()

    def drop(self, count):
        for _ in range(count):
            self.rows.popleft()


@pytest.fixture(scope="module")
def rows():
    return filter_models.quiet_effective_rows(ROWS, CARRIERS, ROW_US, seed=3)


def left_by(recorder, rows):
    """Return what leaves a smoother with each row, and at the end."""
    span, left = SpanSmoother(recorder), []
    for row in rows:
        recorder.rows.append(row)
        left.append(span.pop())
    return [*left, span.rest()]


def test_every_row_leaves_once_and_in_order(rows):
    left = [each for block in left_by(Kept(), rows) for each in block]
    assert [each.epoch_us for each in left] == [row.epoch_us for row in rows]


def test_a_block_knows_half_a_day_and_is_nearly_the_whole_span(rows):
    recorder = Kept()
    left = left_by(recorder, rows)
    blocks = [block for block in left if block]
    assert [len(block) for block in blocks] == [36, 36, 108]
    assert min(each.lag_us for block in blocks[:-1] for each in block) >= smoother.REACH_H * HOUR_US
    assert blocks[-1][-1].lag_us == 0
    whole = angles_of(rows, ROWS)
    for own, best in zip([each for block in blocks for each in block], whole, strict=True):
        sigma = np.sqrt(np.diag(own.state.covariance))[ATTITUDE]
        best_sigma = np.sqrt(np.diag(best.state.covariance))[ATTITUDE]
        # half a day leaves less than a hundredth of the sigma
        np.testing.assert_allclose(sigma, best_sigma, rtol=0.01)
        assert (np.abs(own.state.mean - best.state.mean)[ATTITUDE] < 0.2 * best_sigma).all()


def test_rows_that_come_fast_leave_before_they_fill_the_memory(rows, monkeypatch):
    monkeypatch.setattr(smoother, "MOST_ROWS", 30)
    recorder, most = Kept(), 0
    span, left = SpanSmoother(recorder), []
    for row in rows:
        recorder.rows.append(row)
        most = max(most, len(recorder.rows))
        left += span.pop()
    assert most == 30
    left += span.rest()
    assert [each.epoch_us for each in left] == [row.epoch_us for row in rows]


def test_a_row_that_left_and_is_taken_again_does_not_leave_again(rows):
    recorder = Kept()
    span, left = SpanSmoother(recorder), []
    for row in [*rows[:120], *rows[30:]]:
        while recorder.rows and recorder.rows[-1].epoch_us >= row.epoch_us:
            recorder.rows.pop()
        recorder.rows.append(row)
        left += span.pop()
    left += span.rest()
    epochs = [each.epoch_us for each in left]
    assert epochs == sorted(set(epochs))


def test_a_fixed_lag_knows_exactly_the_rows_of_that_time(rows):
    found = lagged_angles(rows, 2 * HOUR_US)
    assert (found.epoch_us, found.lag_us) == (rows[-13].epoch_us, 2 * HOUR_US)
    best = angles_of(rows, ROWS)[-13]
    np.testing.assert_allclose(found.state.mean, best.state.mean, rtol=1e-12)
    assert lagged_angles(rows[:12], 2 * HOUR_US) is None
    assert lagged_angles([], HOUR_US) is None
