"""States read from summaries are those of the rows, whenever days are summarised and met by late rows."""

import random
import time
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from sqlalchemy import delete, select, update

from db.encoding.segments import DAY_US
from db.results import state_summaries
from db.results.results import SqlResults
from db.schema.tables import attitude_summary, state_summary
from service.core.rows.row_gaps import GapSearch
from service.core.rows.state_runs import RowState
from service.ports import LIVE, Outcome
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.levels.attitude import Exclusion, Status

#: days of rows in each storage
pytestmark = pytest.mark.slow

ALWAYS = 1 << 60
STEP_US = 300_000_000
DAYS = 4


def states_of(row):
    """Return the states of a row."""
    found = {RowState("status", row.status.value)}
    found |= {RowState("control", "allowed")} if row.control_allowed else set()
    found |= {RowState("inhibition", name) for name in row.inhibitions} | {
        RowState("advice", name) for name in row.advice
    }
    found |= {RowState("fade", "downlink")} if row.downlink_fade else set()
    return found | {RowState("exclusion", each.reason, each.carrier) for each in row.excluded}


def rows_of(setting):
    span = Window(0, DAYS * DAY_US)
    return setting.storage.results.attitude_rows(setting.id, LIVE, Method.ROBUST, span, 99_999, None)


def check(setting):
    """Compare states and gaps of all days with those found row by row."""
    rows = rows_of(setting)
    span = Window(rows[0].epoch_us, rows[-1].epoch_us + 1)
    found = setting.storage.results.state_history(setting.id, Method.ROBUST, span)
    wanted, running = [], {}
    for row in rows:
        held = states_of(row)
        wanted += [(state, *running.pop(state)) for state in set(running) - held]
        for state in held:
            start_us, _, count = running.get(state, (row.epoch_us, 0, 0))
            running[state] = (start_us, row.epoch_us, count + 1)
    wanted += [(state, *ends) for state, ends in running.items()]
    assert [tuple(run) for run in found.runs] == sorted(wanted, key=lambda run: (run[1], run[0]))
    if summaries(setting):
        search = GapSearch()
        # rows have one distance, so that of a day is that of all
        gaps = [*search.add(np.array([row.epoch_us for row in rows])), *search.end()]
        assert found.gaps == gaps


def summaries(setting):
    with setting.storage._database.read() as connection:
        return connection.execute(select(state_summary).order_by(state_summary.c.summary_id)).all()


def change(setting, statement):
    setting.storage._database.write(lambda connection: connection.execute(statement))


def some_rows(setting, make, dice, day):
    """Store rows of some hours of a day, and results of most of them."""
    first = day * 288 + dice.randrange(200)
    epochs_us = [STEP_US * (first + k) for k in range(dice.randint(1, 88)) if dice.random() < 0.9]
    before = setting.storage.archive.head(setting.id).newest_number
    setting.append(epochs_us, np.full(len(epochs_us), -50.0))
    state, outcomes = {}, []
    for entry in setting.storage.archive.journal(setting.id, before, 1000):
        if dice.random() < 0.2:
            state = {
                "status": dice.choice([Status.ACQUIRED, Status.INVALID]),
                "control_allowed": dice.random() < 0.5,
                "inhibitions": tuple(dice.sample(["fade", "sigma", "operation"], dice.randrange(3))),
                "advice": ("realign",) if dice.random() < 0.2 else (),
                "downlink_fade": dice.random() < 0.3,
                "excluded": (Exclusion("c01", "step"),) if dice.random() < 0.3 else (),
            }
        if dice.random() < 0.9:
            outcomes.append(Outcome((replace(make.attitude_row(entry.content), **state),), None))
    setting.consume(outcomes)


@pytest.mark.parametrize("seed", range(3))
def test_states_are_those_of_the_rows(setting, make, seed):
    dice = random.Random(seed)
    for _ in range(8):
        some_rows(setting, make, dice, dice.randrange(DAYS))
        if dice.random() < 0.6:
            list(setting.storage.results.complete_summaries(setting.id, dice.randrange(DAYS + 1) * DAY_US))
        check(setting)
    some_rows(setting, make, dice, DAYS - 1)
    list(setting.storage.results.complete_summaries(setting.id, ALWAYS))
    assert summaries(setting)
    check(setting)


@pytest.fixture
def summed(setting, make):
    """Four days of rows, three of them summarised."""
    dice = random.Random(7)
    for day in range(DAYS):
        some_rows(setting, make, dice, day)
    list(setting.storage.results.complete_summaries(setting.id, ALWAYS))
    return setting


def test_closed_days_are_read_from_their_summaries(summed, monkeypatch):
    span = Window(rows_of(summed)[0].epoch_us, 3 * DAY_US)
    wanted = summed.storage.results.state_history(summed.id, Method.ROBUST, span)
    assert wanted.runs
    monkeypatch.setattr(SqlResults, "attitude_rows", lambda *_: [])
    assert summed.storage.results.state_history(summed.id, Method.ROBUST, span) == wanted


def test_a_damaged_or_missing_summary_is_passed_over(summed):
    first, second, *_ = summaries(summed)
    damaged = bytes([*first.content[:-1], first.content[-1] ^ 1])
    change(summed, update(state_summary).where(state_summary.c.summary_id == first.summary_id).values(content=damaged))
    change(summed, delete(state_summary).where(state_summary.c.summary_id == second.summary_id))
    check(summed)


def test_states_go_with_the_summary_of_their_day(summed):
    change(summed, delete(attitude_summary))
    assert summaries(summed) == []
    check(summed)


@pytest.mark.parametrize("most", [0, 1, 40, 300])
def test_rows_without_a_summary_are_read_up_to_a_bound_and_the_rest_is_stated(summed, monkeypatch, most):
    """The first and the last day have no summary; what is given is what the given spans hold by themselves."""
    first, *_ = summaries(summed)
    change(summed, delete(state_summary).where(state_summary.c.summary_id == first.summary_id))
    rows = rows_of(summed)
    span = Window(rows[0].epoch_us, rows[-1].epoch_us + 1)
    history = partial(summed.storage.results.state_history, summed.id, Method.ROBUST)
    whole = history(span)
    monkeypatch.setattr(state_summaries, "MOST_ROWS", most)
    found = history(span)
    ends = [span.start_us, *(end for part in found.left_out_us for end in part), span.stop_us]
    given = [Window(*part) for part in zip(ends[::2], ends[1::2], strict=True) if part[0] < part[1]]
    unread = [row for row in rows if not DAY_US <= row.epoch_us < 3 * DAY_US]
    left_out = [row for row in rows if any(start <= row.epoch_us < stop for start, stop in found.left_out_us)]
    assert [row for row in left_out if row not in unread] == []
    # rows of one epoch stand together
    assert len(unread) - len(left_out) <= most
    assert left_out == unread[: len(left_out)]
    monkeypatch.undo()
    parts = [history(part) for part in given]
    assert found.runs == [run for part in parts for run in part.runs]
    assert found.gaps == [gap for part in parts for gap in part.gaps]
    assert whole.left_out_us == []


def test_an_open_day_of_more_rows_costs_no_more_than_the_bound(setting, make, monkeypatch):
    """Four times the rows of the newest day, and one bound: processor time stays, where all rows would cost four."""
    monkeypatch.setattr(state_summaries, "MOST_ROWS", 500)
    taken_s = []
    for day, count in ((0, 1000), (1, 8000)):
        span = Window(day * DAY_US, day * DAY_US + count * 10_000_000)
        before = setting.storage.archive.head(setting.id).newest_number
        setting.append(list(range(span.start_us, span.stop_us, 10_000_000)), np.full(count, -50.0))
        entries = setting.storage.archive.journal(setting.id, before, 10_000)
        setting.consume([Outcome((make.attitude_row(entry.content),), None) for entry in entries])
        found = []
        for _ in range(5):
            began_s = time.process_time()
            history = setting.storage.results.state_history(setting.id, Method.ROBUST, span)
            found.append(time.process_time() - began_s)
            assert history.left_out_us == [(span.start_us, span.stop_us - 5_000_000_000 - 9_999_999)]
        taken_s.append(min(found))
    assert taken_s[1] < 3 * taken_s[0]
