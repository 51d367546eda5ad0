"""Light runs of the benchmarks: what may grow with carriers, rows and estimators, against the goals of `make bench`."""

import statistics
from argparse import Namespace
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

from bench import bench_summaries
from bench.bench_chain import chain_row_s
from bench.bench_ingest import measure as ingest_rates
from bench.bench_storage import measure_results
from bench.load import fleet
from bench.load.bench_memory import GOALS_MB, fill_replay, replay_mb
from bench.load.http_load import Shape
from service.records.catalogue import Method

pytestmark = [pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(1200)]

#: how much of a goal a machine that does other things at the same time may take; memory: pages that a library touches
#: for the first time count too
SLACK = 2.0
CARRIERS = (8, 16, 32, 64)
REPLAY_ROWS = 3000
#: of the larger archive: six weeks at a row a minute
ARCHIVE_ROWS = 60_000
SPACECRAFT, ESTIMATED_ROWS = 8, 60
#: durable ingest over that without storage: half of the goal
LEAST_INGEST = 1 / 6


def test_durable_ingest_reaches_a_sixth_of_the_rate_without_storage(tmp_path):
    shape, options = Shape(rows=100, carriers=32, connections=4), Namespace(repeats=3, seconds=0.7)
    rates = ingest_rates(("none", "durable"), shape, lambda kind: f"sqlite:///{tmp_path / kind}.db", options)
    print(rates)
    pairs = zip(rates["durable"], rates["none"], strict=True)
    assert statistics.median(durable.per_second / none.per_second for durable, none in pairs) >= LEAST_INGEST


def test_a_row_grows_by_at_most_the_square_of_its_carriers():
    rows_s = [chain_row_s(count, 400, (Method.ROBUST,), has_commands=False, rows=1) for count in CARRIERS]
    exponent = np.polyfit(np.log(CARRIERS), np.log(rows_s), 1)[0]
    print(f"{[f'{1e3 * row_s:.2f} ms' for row_s in rows_s]} for {CARRIERS} carriers: exponent {exponent:.2f}")
    assert exponent <= 2.2


@pytest.mark.parametrize("has_carriers", [False, True])
def test_results_of_a_measurement_take_no_more_bytes_than_the_goal(tmp_path, has_carriers):
    options = Namespace(carriers=16, rows=100, days=1)
    assert measure_results(f"sqlite:///{tmp_path / 'soo.db'}", options, has_carriers=has_carriers)


def test_memory_of_a_replay_does_not_grow_with_its_rows(tmp_path):
    url = f"sqlite:///{tmp_path / 'soo.db'}"
    fill_replay(url, REPLAY_ROWS)
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        growth_mb = pool.submit(replay_mb, url, REPLAY_ROWS).result()
    print(f"{growth_mb:.0f} MB")
    assert growth_mb < SLACK * GOALS_MB["replay"]


def test_ten_times_the_rows_cost_hardly_more(tmp_path):
    tally = bench_summaries.measure(tmp_path, ARCHIVE_ROWS, 3)
    print({name: round(ratio, 2) for name, ratio in tally.ratios.items()}, round(tally.attitude_over_powers, 2))
    # where every row is read, samples of attitude take ten times as long
    goals = bench_summaries.GOALS
    assert {name: ratio for name, ratio in tally.ratios.items() if ratio > SLACK * goals[name]} == {}
    assert tally.attitude_over_powers <= SLACK * bench_summaries.GOAL_ATTITUDE


def test_sharing_costs_little_and_two_are_not_slower(durable_postgresql_cluster):
    one, two = fleet.pair(durable_postgresql_cluster, SPACECRAFT, ESTIMATED_ROWS)
    print(f"rows a second {two.rows_per_s / one.rows_per_s:.2f}, processor time of a row {two.cpu_s / one.cpu_s:.2f}")
    # server and this process want the same processors
    assert two.rows_per_s > fleet.GOAL / 2 * one.rows_per_s
    assert two.cpu_s < 1.5 * one.cpu_s
