"""Charts, status and stored rows in an archive of ten times the rows: a light run of `bench.bench_summaries`."""

import pytest

from bench.bench_summaries import GOAL_ATTITUDE, GOALS, measure

pytestmark = [pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(1200)]

#: rows of the larger archive: six weeks at a row a minute
ROWS = 60_000
#: how much of a goal a machine that does other things at the same time may take
SLACK = 2.0


def test_ten_times_the_rows_cost_hardly_more(tmp_path):
    tally = measure(tmp_path, ROWS, 3)
    print({name: round(ratio, 2) for name, ratio in tally.ratios.items()}, round(tally.attitude_over_powers, 2))
    # where every row is read, samples of attitude take ten times as long
    assert {name: ratio for name, ratio in tally.ratios.items() if ratio > SLACK * GOALS[name]} == {}
    assert tally.attitude_over_powers <= SLACK * GOAL_ATTITUDE
