"""Two estimators beside one on PostgreSQL: a light run of `bench.load.fleet`."""

import pytest

from bench.load.fleet import GOAL, pair

pytestmark = [pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(1200)]

SPACECRAFT, ROWS = 8, 60


def test_sharing_costs_little_and_two_are_not_slower(durable_postgresql_cluster):
    one, two = pair(durable_postgresql_cluster, SPACECRAFT, ROWS)
    print(f"rows a second {two.rows_per_s / one.rows_per_s:.2f}, processor time of a row {two.cpu_s / one.cpu_s:.2f}")
    # server and this process want the same processors
    assert two.rows_per_s > GOAL / 2 * one.rows_per_s
    assert two.cpu_s < 1.5 * one.cpu_s
