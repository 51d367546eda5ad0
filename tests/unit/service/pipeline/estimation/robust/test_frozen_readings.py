"""Claims about readings that stand still or move in large steps alone."""

import numpy as np
import pytest

from service.pipeline.estimation.robust.frozen_readings import frozen, no_readings, push_readings

MINUTE_US = 60_000_000


def run(rows_dbm, period_us=MINUTE_US):
    """Return which carriers are frozen after each of some rows (T, N)."""
    readings, answers = no_readings(len(rows_dbm[0])), []
    for number, row in enumerate(rows_dbm):
        readings = push_readings(readings, np.asarray(row, dtype=np.float64), number * period_us)
        answers.append(frozen(readings, number * period_us))
    return np.array(answers)


def test_a_reading_that_stands_for_twenty_minutes_is_frozen_until_it_moves():
    rows = [[-40.0 + 0.1 * (k % 2), -50.0] for k in range(30)] + [[-40.0, -50.05]]
    answers = run(rows)
    assert not answers[:, 0].any()
    assert np.flatnonzero(answers[:, 1]).tolist() == list(range(20, 30))


@pytest.mark.parametrize(("period_us", "first"), [(1_000_000, 1200), (300_000_000, 19)])
def test_twenty_rows_and_twenty_minutes_are_both_needed(period_us, first):
    answers = run([[-40.0]] * (first + 2), period_us)[:, 0]
    assert np.flatnonzero(answers).tolist() == [first, first + 1]


def test_steps_of_a_decibel_are_coarse_and_those_of_real_links_are_not():
    rng = np.random.default_rng(11)
    fine_db = np.cumsum(rng.normal(0.0, 0.02, 300)) + rng.normal(0.0, 0.12, 300)
    answers = run(np.column_stack([np.round(fine_db / 0.15) * 0.15, np.round(3.0 * fine_db)]))
    assert not answers[:, 0].any()
    assert answers[60:, 1].all()


def test_six_readings_far_apart_make_a_carrier_coarse_and_a_fade_does_not():
    rows = [[-40.0], [-40.0], [-35.0], [-40.0], [-39.0], [-40.0], [-38.0], [-40.0]]
    assert np.flatnonzero(run(rows)[:, 0]).tolist() == [6, 7]


def test_one_step_of_a_user_leaves_the_carrier_out_for_a_row():
    levels = -40.0 + 0.1 * np.random.default_rng(12).normal(size=60)
    levels[30:] += 2.0
    assert not run(levels[:, None])[31:].any()


def test_an_absent_carrier_keeps_its_last_reading():
    rows = [[-40.0]] * 10 + [[np.nan]] * 30 + [[-40.0]] * 12
    answers = run(rows)[:, 0]
    assert not answers[:49].any()
    assert answers[49:].all()
