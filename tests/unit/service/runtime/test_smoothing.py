"""Smoothed rows at a fixed lag: stored in parts, once, bit for bit, whatever ends a process."""

import logging
from dataclasses import replace

import pytest
from busy_station import MINUTE, SC, at, text

from service.errors import StorageError
from service.pipeline.config import ChainConfig, RobustConfig
from service.pipeline.estimation.smoothed import GRID_US, grid_us
from service.ports.archive import SMOOTHED, ListPart
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.operations.work import JobKind, JobState
from service.runtime.jobs import job_runner, smoothing
from service.runtime.jobs.job_runner import JobPieces, JobRunner, Standing
from service.runtime.jobs.smoothing import LaggedRun, SmoothingConfig, SmoothingDue, SmoothingWork

LAG_US = 20 * MINUTE


def part_of(station, after_us, until_number=None, lag_us=LAG_US, config=None):
    """Return what a run makes behind an instant, up to a journal number."""
    until = station.storage.archive.head(SC).consumed_number if until_number is None else until_number
    run = LaggedRun(station.storage, config or ChainConfig(), SC, lag_us, after_us, until)
    return [*run.steps()][-1]


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
    monkeypatch.setattr(smoothing, "_PART_US", minutes * MINUTE)
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
    monkeypatch.setattr(smoothing, "_REACH_US", -1)
    part = part_of(kept, begin_us() + 50 * MINUTE)
    assert part.rows == ()
    assert part.is_skipped


LAG = SmoothingConfig(lag_s=1200.0)


class KilledError(BaseException):
    """The process ends here."""


def smoothed(station):
    return station.rows(Method.ROBUST_SMOOTHED, SMOOTHED)


class Series:
    """The jobs of smoothed rows of a station, done in this process."""

    def __init__(self, station, turn=lambda _: 1):
        self.station, self.error, self.pieces = station, None, 0
        self.due = SmoothingDue(station.storage, LAG, turn)
        work = SmoothingWork(station.storage, ChainConfig(), LAG)
        self._pieces = JobPieces({"smoothing": work})
        standing = [Standing(JobKind.SMOOTHING, self.due.due, self.due.failed)]
        self.runner = JobRunner(station.storage, station.clock, self.advance, turn, standing)

    def advance(self, job, open_ids):
        self.pieces += 1
        if self.error is not None:
            raise self.error
        return self._pieces.advance(job, open_ids)

    def make(self):
        """Make all that is due."""
        while self.runner.poll_once():
            pass


@pytest.fixture(autouse=True)
def _at_once(monkeypatch):
    """The next poll follows at once."""
    monkeypatch.setattr(job_runner, "POLL_S", 0.0)


def made(station, **changes):
    """Return a series after all that was due."""
    series = Series(station, **changes)
    series.make()
    return series


def test_all_that_is_due_is_made_once(busy):
    series = made(busy)
    rows = smoothed(busy)
    assert len(rows) > 15
    assert grid_us(at(139) - 20 * MINUTE) - GRID_US < rows[-1].epoch_us <= at(139) - 20 * MINUTE
    pieces = series.pieces
    series.make()
    assert series.pieces == pieces
    assert text(smoothed(busy)) == text(rows)


def test_live_rows_torques_and_sequences_stay_as_they_are(busy):
    methods = (Method.ROBUST, Method.PAPER)

    def live():
        kept = [text(busy.rows(method)) for method in methods]
        results = busy.storage.results
        # a stream that resumes gets results by their sequences
        return kept, text(busy.commands()), text(results.results_after(SC, 0, 10_000)), results.pending(SC, methods)

    before, head = live(), busy.storage.archive.head(SC)
    made(busy)
    assert smoothed(busy)
    assert live() == before
    assert busy.storage.archive.head(SC) == head


@pytest.mark.slow
def test_a_process_that_was_killed_leaves_whole_parts_and_the_next_one_goes_on(new_station, lived_archive, monkeypatch):
    whole, killed = new_station(lived_archive), new_station(lived_archive)
    made(whole)
    monkeypatch.setattr(smoothing, "_PART_US", 25 * MINUTE)
    monkeypatch.setattr(job_runner, "PIECE_S", 0.0)
    save, saves = killed.storage.results.save_outcomes, []

    def save_outcomes(*arguments):
        if len(saves) == 2:
            raise KilledError
        saves.append(arguments)
        return save(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(killed.storage.results, "save_outcomes", save_outcomes)
        with pytest.raises(KilledError):
            made(killed)
    assert 0 < len(smoothed(killed)) < len(smoothed(whole))
    next_one = Series(killed)
    next_one.runner.take_over()
    next_one.make()
    assert text(smoothed(killed)) == text(smoothed(whole))


def test_only_the_process_that_leads_makes_rows(busy):
    assert made(busy, turn=lambda _: 0).pieces == 0
    terms = [1]
    series = made(busy, turn=lambda _: terms[0])
    rows = smoothed(busy)
    # of a new term the archive tells how far the rows reach
    terms[0] = 2
    series.make()
    assert text(smoothed(busy)) == text(rows)


def test_a_run_that_failed_says_why_and_is_made_again(busy):
    series = Series(busy)
    series.error = StorageError("storage.full", "no space")
    assert series.runner.poll_once()
    job = busy.storage.results.job(f"smoothing-{SC}")
    assert (job.state, job.error) == (JobState.FAILED, "storage.full: no space")
    assert smoothed(busy) == []
    series.error = None
    series.make()
    job = busy.storage.results.job(f"smoothing-{SC}")
    assert (job.state, job.error) == (JobState.DONE, None)
    assert len(smoothed(busy)) > 15


def test_a_disk_that_is_full_keeps_nothing_of_a_part(busy, monkeypatch):
    series = Series(busy)

    def refuse(*_args):
        raise StorageError("storage.full", "no space")

    with monkeypatch.context() as patch:
        patch.setattr(busy.storage.results, "save_outcomes", refuse)
        assert series.runner.poll_once()
        assert series.runner.poll_once()
    assert smoothed(busy) == []
    series.make()
    assert len(smoothed(busy)) > 15


def test_before_the_first_alignment_nothing_is_made(new_station, opened_archive):
    station = new_station(opened_archive)
    with station.supervised() as settle:
        station.send(range(1, 60))
        settle()
    assert made(station).pieces == 1, "nobody asks twice"
    assert smoothed(station) == []


def test_rows_that_lie_weeks_back_are_left_out_and_said(busy, caplog, monkeypatch):
    made(busy)
    for _ in busy.storage.archive.drop_before(SC, "attitude", at(0) - 86_400_000_000):
        pass
    monkeypatch.setattr(smoothing, "_MOST_BEHIND_US", 60 * MINUTE)
    with busy.supervised() as settle:
        busy.send(range(260, 300), source="sa-2")
        settle()
    before = len(smoothed(busy))
    with caplog.at_level(logging.INFO, "soo.lagged"):
        made(busy)
    assert "they lie too far back" in caplog.text
    rows = smoothed(busy)[before:]
    assert rows
    assert rows[0].epoch_us > at(299) - 20 * MINUTE - 60 * MINUTE - 2 * GRID_US


@pytest.mark.slow
def test_retention_and_sealing_take_the_series_along(busy):
    made(busy)
    rows = smoothed(busy)
    day_us = 86_400_000_000
    sealed = list(busy.storage.results.seal(SC, at(0) + 3 * day_us))
    assert SMOOTHED in {part.version for part in sealed}
    assert text(smoothed(busy)) == text(rows)
    for _ in busy.storage.archive.drop_before(SC, "attitude", at(0) + 3 * day_us):
        pass
    window = Window(at(-10_000), at(10_000))
    assert busy.storage.results.attitude_rows(SC, SMOOTHED, Method.ROBUST_SMOOTHED, ListPart(window, 10)) == []


@pytest.mark.parametrize("lag_s", [-1.0, 299.0, 43_201.0, float("nan")])
def test_a_lag_that_makes_no_sense_is_refused(lag_s):
    with pytest.raises(ValueError, match="lag_s is 0, or from 300 to 43200 s"):
        SmoothingConfig(lag_s=lag_s)


def test_without_a_lag_there_is_no_series(busy):
    assert list(SmoothingDue(busy.storage, SmoothingConfig(lag_s=0.0)).due()) == []
