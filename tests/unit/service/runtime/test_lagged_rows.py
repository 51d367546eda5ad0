"""Smoothed rows at a fixed lag: stored in parts, once, bit for bit, whatever ends a process."""

import logging
from dataclasses import replace

import pytest
from busy_station import MINUTE, SC, at, text

from service.errors import StorageError, UnavailableError
from service.pipeline.config import ChainConfig, RobustConfig
from service.pipeline.estimation.smoothed import GRID_US, grid_us
from service.ports.archive import SMOOTHED
from service.records.calibration import Window
from service.records.catalogue import Method
from service.runtime.jobs import lagged_run
from service.runtime.jobs import lagged_run as lagged_series
from service.runtime.jobs.lagged_run import LaggedOrder, LaggedPart, LaggedRun, LaggedSeries, SmoothingConfig

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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_rows_that_are_made_while_the_journal_grows_are_those_that_are_made_later(kept):
    whole = part_of(kept, begin_us())
    made_us, rows = begin_us(), []
    for number in range(40, kept.storage.archive.head(SC).consumed_number + 1, 7):
        part = part_of(kept, made_us, number)
        rows += part.rows
        made_us = max(made_us, part.made_us)
    rows += part_of(kept, made_us).rows
    assert text(rows) == text(whole.rows)


@pytest.mark.slow
def test_a_row_is_that_of_a_replay_which_ends_at_the_lag_to_the_bit(kept):
    found = {row.epoch_us: row for row in part_of(kept, begin_us()).rows}
    # behind the alignment of minute 104, where no row is late and nothing is told of the past
    for row in [row for epoch_us, row in found.items() if at(106) < epoch_us < at(118)]:
        newest_us = row.epoch_us + round(row.lag_s * 1e6)
        minute = (newest_us - at(0)) / MINUTE
        version = kept.replay(1, minute + 0.1, method=Method.ROBUST, commands=False, smooth=True)
        (own,) = [each for each in kept.rows(Method.ROBUST_SMOOTHED, version) if each.epoch_us == row.epoch_us]
        assert text([own]) == text([row])


@pytest.mark.slow
def test_without_a_checkpoint_a_run_begins_at_the_alignment(kept):
    after_us = begin_us()
    other = replace(ChainConfig(), robust=replace(RobustConfig(), yaw_drift_deg_h=0.041))
    assert part_of(kept, after_us, config=other).rows


@pytest.mark.slow
def test_what_no_state_reaches_is_skipped_and_said(kept):
    early = part_of(kept, at(-600) // GRID_US * GRID_US)
    assert (early.rows, early.is_skipped) == ((), True)
    # from the epoch of the alignment on there are rows
    assert at(-600) < early.made_us <= at(5)
    assert part_of(kept, early.made_us).rows
    # nothing is consumed yet
    nothing = part_of(kept, begin_us(), until_number=1)
    assert (nothing.rows, nothing.made_us, nothing.is_skipped) == ((), begin_us(), False)


@pytest.mark.slow
def test_a_state_of_long_ago_is_no_begin(kept, monkeypatch):
    monkeypatch.setattr(lagged_run, "_REACH_US", -1)
    part = part_of(kept, begin_us() + 50 * MINUTE)
    assert part.rows == ()
    assert part.is_skipped


LAG = SmoothingConfig(lag_s=1200.0)


class KilledError(BaseException):
    """The process ends here."""


class Maker:
    """Makes parts in this process, notes what was ordered, and fails when it should."""

    def __init__(self, station):
        self.station, self.orders, self.error = station, [], None

    def __call__(self, spacecraft_id, order):
        self.orders.append(order)
        if self.error is not None:
            raise self.error
        return LaggedRun(self.station.storage, ChainConfig(), spacecraft_id, order).run()


def smoothed(station):
    return station.rows(Method.ROBUST_SMOOTHED, SMOOTHED)


def made(station, *polls, **changes):
    """Return a series after some polls, and its maker."""
    maker = Maker(station)
    series = LaggedSeries(station.storage, LAG, maker, **changes)
    for _ in polls:
        series.poll_once()
    return series, maker


def test_all_that_is_due_is_made_once(busy):
    series, maker = made(busy, 1, 2)
    rows = smoothed(busy)
    assert len(rows) > 15
    assert grid_us(at(139) - 20 * MINUTE) - GRID_US < rows[-1].epoch_us <= at(139) - 20 * MINUTE
    asked = len(maker.orders)
    series.poll_once()
    assert len(maker.orders) == asked
    assert text(smoothed(busy)) == text(rows)


def test_live_rows_torques_and_sequences_stay_as_they_are(busy):
    methods = (Method.ROBUST, Method.PAPER)

    def live():
        kept = [text(busy.rows(method)) for method in methods]
        results = busy.storage.results
        # a stream that resumes gets results by their sequences
        return kept, text(busy.commands()), text(results.results_after(SC, 0, 10_000)), results.pending(SC, methods)

    before, head = live(), busy.storage.archive.head(SC)
    made(busy, 1, 2)
    assert smoothed(busy)
    assert live() == before
    assert busy.storage.archive.head(SC) == head


def test_a_process_that_was_killed_leaves_whole_parts_and_the_next_one_goes_on(new_station, lived_archive, monkeypatch):
    whole, killed = new_station(lived_archive), new_station(lived_archive)
    made(whole, 1, 2)
    monkeypatch.setattr("service.runtime.jobs.lagged_run._PART_US", 25 * MINUTE)
    series, maker = made(killed, 1, 2)
    stored = smoothed(killed)
    maker.error = KilledError()
    with pytest.raises(KilledError):
        series.poll_once()
    assert text(smoothed(killed)) == text(stored)
    made(killed, 1, 2, 3, 4, 5, 6)
    assert text(smoothed(killed)) == text(smoothed(whole))


def test_only_the_process_that_leads_makes_rows(busy):
    _, maker = made(busy, 1, turn=lambda _: 0)
    assert maker.orders == []
    terms = [1]
    series, maker = made(busy, 1, 2, turn=lambda _: terms[0])
    rows = smoothed(busy)
    # of a new term the archive tells how far the rows reach
    terms[0] = 2
    series.poll_once()
    assert text(smoothed(busy)) == text(rows)


@pytest.mark.parametrize(
    ("error", "is_fault"),
    [(StorageError("storage.full", "no space"), True), (UnavailableError("analysis.ended", "it died"), False)],
)
def test_a_run_that_failed_is_made_again(busy, caplog, error, is_fault):
    series, maker = made(busy)
    maker.error = error
    with caplog.at_level(logging.INFO, "soo.lagged"):
        series.poll_once()
    assert smoothed(busy) == []
    assert any(record.levelno >= logging.ERROR for record in caplog.records) == is_fault
    maker.error = None
    series.poll_once()
    series.poll_once()
    assert len(smoothed(busy)) > 15


def test_a_disk_that_is_full_keeps_nothing_of_a_part(busy, monkeypatch):
    series, _ = made(busy)

    def refuse(*_args):
        raise StorageError("storage.full", "no space")

    with monkeypatch.context() as patch:
        patch.setattr(busy.storage.results, "save_outcomes", refuse)
        series.poll_once()
        series.poll_once()
    assert smoothed(busy) == []
    series.poll_once()
    series.poll_once()
    assert len(smoothed(busy)) > 15


def test_before_the_first_alignment_nothing_is_made_and_nobody_asks_twice(new_station, opened_archive):
    station = new_station(opened_archive)
    with station.supervised() as settle:
        station.send(range(1, 60))
        settle()
    _, maker = made(station, 1, 2, 3)
    assert smoothed(station) == []
    assert maker.orders == []


def test_rows_that_lie_weeks_back_are_left_out_and_said(busy, caplog, monkeypatch):
    monkeypatch.setattr(lagged_series, "_MOST_BEHIND_US", 60 * MINUTE)
    first = LaggedPart((), at(5) // GRID_US * GRID_US, is_skipped=False)
    maker = Maker(busy)
    series = LaggedSeries(busy.storage, LAG, maker)
    series._made[SC] = 1, first.made_us
    with caplog.at_level(logging.INFO, "soo.lagged"):
        series.poll_once()
    assert "they lie too far back" in caplog.text
    rows = smoothed(busy)
    assert rows
    assert rows[0].epoch_us > at(139) - 20 * MINUTE - 60 * MINUTE - 2 * GRID_US


def test_retention_and_sealing_take_the_series_along(busy):
    made(busy, 1, 2)
    rows = smoothed(busy)
    day_us = 86_400_000_000
    sealed = list(busy.storage.results.seal(SC, at(0) + 3 * day_us))
    assert SMOOTHED in {part.version for part in sealed}
    assert text(smoothed(busy)) == text(rows)
    for _ in busy.storage.archive.drop_before(SC, "attitude", at(0) + 3 * day_us):
        pass
    window = Window(at(-10_000), at(10_000))
    assert busy.storage.results.attitude_rows(SC, SMOOTHED, Method.ROBUST_SMOOTHED, window, 10, None) == []


def test_a_spacecraft_that_comes_again_under_its_name_begins_again(busy, monkeypatch):
    series, _ = made(busy)
    # of the one before, whose data reached further
    series._made[SC] = 1, at(10_000)
    series.poll_once()
    assert smoothed(busy) == []
    with monkeypatch.context() as patch:
        patch.setattr(busy.storage.archive, "heads", dict)
        series.poll_once()
    series.poll_once()
    series.poll_once()
    assert len(smoothed(busy)) > 15


@pytest.mark.parametrize("lag_s", [-1.0, 299.0, 43_201.0, float("nan")])
def test_a_lag_that_makes_no_sense_is_refused(lag_s):
    with pytest.raises(ValueError, match="lag_s is 0, or from 300 to 43200 s"):
        SmoothingConfig(lag_s=lag_s)


def test_without_a_lag_there_is_no_series(busy):
    series = LaggedSeries(busy.storage, SmoothingConfig(lag_s=0.0), Maker(busy))
    series.start()
    series.stop()
    assert smoothed(busy) == []


def test_the_thread_makes_rows_and_rests_after_its_work(busy, monkeypatch, wait):
    monkeypatch.setattr(lagged_series, "POLL_S", 0.01)
    monkeypatch.setattr(lagged_series, "_REST", 0.01)
    series = LaggedSeries(busy.storage, LAG, Maker(busy))
    series.start()
    try:
        wait(lambda: len(smoothed(busy)) > 15)
    finally:
        series.stop()
