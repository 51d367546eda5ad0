"""Smoothed rows at a fixed lag: the same to the bit from any state and in any parts."""

from dataclasses import replace

import pytest
from busy_station import MINUTE, SC, at, text

from service.pipeline.config import ChainConfig, RobustConfig
from service.pipeline.estimation.smoothed.lagged_rows import GRID_US, grid_us
from service.records.catalogue import Method
from service.runtime.jobs import lagged_run
from service.runtime.jobs.lagged_run import LaggedOrder, LaggedRun

#: replays and smoothing of hours
pytestmark = pytest.mark.slow

LAG_US = 20 * MINUTE


def part_of(station, after_us, until_number=None, lag_us=LAG_US, config=None):
    """Return what a run makes behind an instant, up to a journal number."""
    until = station.storage.archive.head(SC).consumed_number if until_number is None else until_number
    return LaggedRun(station.storage, config or ChainConfig(), SC, LaggedOrder(after_us, until, lag_us)).run()


@pytest.fixture
def kept(archive_of_states, new_station):
    return new_station(archive_of_states)


def begin_us():
    """Return the first instant of the grid that is not before the first alignment."""
    return grid_us(at(0) + GRID_US - 1)


def test_each_five_minutes_have_the_newest_of_their_robust_rows(kept):
    part = part_of(kept, begin_us())
    robust = {row.epoch_us: row for row in kept.rows(Method.ROBUST)}
    assert len(part.rows) > 15
    assert part.made_us == grid_us(at(139) - LAG_US)
    assert not part.is_skipped
    instants = [-(-row.epoch_us // GRID_US) for row in part.rows]
    assert instants == sorted(set(instants))
    for row in part.rows:
        assert row.method is Method.ROBUST_SMOOTHED
        assert not row.control_allowed
        assert row.number == robust[row.epoch_us].number
        # rows come each minute, and a gap makes a row wait for the next one behind it
        assert row.lag_s >= LAG_US / 1e6
        assert all(
            own <= 1.000001 * filtered
            for own, filtered in zip(row.sigma_deg, robust[row.epoch_us].sigma_deg, strict=True)
        )


@pytest.mark.parametrize("minutes", [5, 15, 35])
def test_parts_give_the_rows_of_one_run_to_the_bit(kept, monkeypatch, minutes):
    whole = part_of(kept, begin_us())
    monkeypatch.setattr(lagged_run, "_PART_US", minutes * MINUTE)
    made_us, rows, runs = begin_us(), [], 0
    while made_us < whole.made_us:
        part = part_of(kept, made_us)
        rows += part.rows
        made_us, runs = part.made_us, runs + 1
    assert runs >= 119 // minutes - 1
    assert text(rows) == text(whole.rows)


def test_rows_that_are_made_while_the_journal_grows_are_those_that_are_made_later(kept):
    whole = part_of(kept, begin_us())
    made_us, rows = begin_us(), []
    for number in range(40, kept.storage.archive.head(SC).consumed_number + 1, 7):
        part = part_of(kept, made_us, number)
        rows += part.rows
        made_us = max(made_us, part.made_us)
    rows += part_of(kept, made_us).rows
    assert text(rows) == text(whole.rows)


def test_a_row_is_that_of_a_replay_which_ends_at_the_lag_to_the_bit(kept):
    found = {row.epoch_us: row for row in part_of(kept, begin_us()).rows}
    # behind the alignment of minute 104, where no row is late and nothing is told of the past
    for row in [row for epoch_us, row in found.items() if at(106) < epoch_us < at(118)]:
        newest_us = row.epoch_us + round(row.lag_s * 1e6)
        minute = (newest_us - at(0)) / MINUTE
        version = kept.replay(1, minute + 0.1, method=Method.ROBUST, commands=False, smooth=True)
        (own,) = [each for each in kept.rows(Method.ROBUST_SMOOTHED, version) if each.epoch_us == row.epoch_us]
        assert text([own]) == text([row])


def test_without_a_checkpoint_a_run_begins_at_the_alignment(kept):
    after_us = begin_us()
    other = replace(ChainConfig(), robust=replace(RobustConfig(), yaw_drift_deg_h=0.041))
    assert part_of(kept, after_us, config=other).rows


def test_what_no_state_reaches_is_skipped_and_said(kept):
    early = part_of(kept, at(-600) // GRID_US * GRID_US)
    assert (early.rows, early.is_skipped) == ((), True)
    # from the epoch of the alignment on there are rows
    assert at(-600) < early.made_us <= at(5)
    assert part_of(kept, early.made_us).rows
    # nothing is consumed yet
    nothing = part_of(kept, begin_us(), until_number=1)
    assert (nothing.rows, nothing.made_us, nothing.is_skipped) == ((), begin_us(), False)


def test_a_state_of_long_ago_is_no_begin(kept, monkeypatch):
    monkeypatch.setattr(lagged_run, "_REACH_US", -1)
    part = part_of(kept, begin_us() + 50 * MINUTE)
    assert part.rows == ()
    assert part.is_skipped
