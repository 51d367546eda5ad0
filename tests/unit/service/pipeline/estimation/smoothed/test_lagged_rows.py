"""Instants of a grid get their newest row, when the lag has passed or later rows would not fit into memory."""

import filter_models
import pytest

from service.pipeline.estimation.smoothed import lagged_rows
from service.pipeline.estimation.smoothed.lagged_rows import GRID_US, LaggedRows, grid_us
from service.pipeline.estimation.smoothed.smoother import lagged_angles
from service.records.catalogue import Method
from service.records.levels.attitude import row_without_attitude

#: a row each minute for three hours
ROW_US, ROWS, CARRIERS = 60_000_000, 180, 6
HOUR_US = 3_600_000_000


@pytest.fixture(scope="module")
def effective():
    """Effective rows of a quiet filter, by epoch."""
    return filter_models.quiet_effective_rows(ROWS, CARRIERS, ROW_US, seed=7)


def robust(epoch_us, *inhibitions):
    return row_without_attitude(epoch_us, epoch_us, epoch_us // ROW_US, Method.ROBUST, inhibitions)


def made_of(lagged, effective):
    """Return what is made with each row."""
    made = []
    for each in effective:
        lagged.recorder._rows.append(each)
        made.append(lagged.push(each.epoch_us, [robust(each.epoch_us)]))
    return made


def test_the_grid_is_that_of_the_clock():
    assert [grid_us(epoch_us) for epoch_us in (0, GRID_US - 1, GRID_US, GRID_US + 1)] == [0, 0, GRID_US, GRID_US]


def test_each_instant_has_its_row_as_soon_as_the_lag_has_passed(effective):
    lagged = LaggedRows(HOUR_US, 0)
    made = made_of(lagged, effective)
    # rows stand on the instants: that of 5 min is due with that of 65 min
    assert [k + 1 for k, rows in enumerate(made) if rows] == list(range(65, ROWS + 1, 5))
    for k, rows in enumerate(made):
        for row in rows:
            expected = lagged_angles(effective[: k + 1], HOUR_US)
            assert (row.epoch_us, row.lag_s) == (expected.epoch_us, 3600.0)
            assert list(row.attitude_deg) == expected.state.mean[:3].tolist()
    assert lagged.made_us == grid_us(effective[-1].epoch_us - HOUR_US)


def test_memory_holds_no_row_that_no_instant_needs(effective):
    lagged = LaggedRows(HOUR_US, 0)
    made_of(lagged, effective)
    assert len(lagged.recorder.rows) <= 61 + 5


def test_rows_behind_the_filter_and_those_of_other_methods_are_none(effective):
    lagged = LaggedRows(HOUR_US, 0)
    for each in effective[:70]:
        lagged.recorder._rows.append(each)
        late = robust(each.epoch_us, "late")
        other = row_without_attitude(each.epoch_us, each.epoch_us, 1, Method.PAPER, ())
        assert lagged.push(each.epoch_us, [late, other]) == []
    # the instants are passed all the same
    assert lagged.made_us == GRID_US * 2


def test_an_instant_without_rows_has_none_and_what_came_before_a_gap_knows_what_came_after(effective):
    lagged = LaggedRows(HOUR_US, 0)
    rest = [each for each in effective if not 40 * ROW_US < each.epoch_us < 150 * ROW_US]
    made = [row for rows in made_of(lagged, rest) for row in rows]
    instants = [-(-row.epoch_us // GRID_US) for row in made]
    assert instants == [1, 2, 3, 4, 5, 6, 7, 8]
    assert {row.lag_s for row in made} == {150 * 60.0 - 300.0 * k for k in instants}


def test_where_too_many_rows_lie_beyond_a_shorter_lag_must_do(effective, monkeypatch):
    monkeypatch.setattr(lagged_rows, "MOST_LATER", 20)
    lagged = LaggedRows(HOUR_US, 0)
    made = [row for rows in made_of(lagged, effective) for row in rows]
    assert {row.lag_s for row in made} == {20 * 60.0}
    assert len(made) == (ROWS - 20) // 5
