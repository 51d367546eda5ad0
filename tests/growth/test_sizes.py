"""Bytes of sealed results and memory of a replay: the goals of `bench.bench_storage` and `bench.load.bench_memory`."""

from argparse import Namespace
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import pytest

from bench.bench_storage import measure_results
from bench.load.bench_memory import GOALS_MB, fill_replay, replay_mb

pytestmark = [pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(1200)]

#: of a goal in memory: pages that a library touches for the first time count too
SLACK = 2.0
ROWS = 3000


@pytest.mark.parametrize("has_carriers", [False, True])
def test_results_of_a_measurement_take_no_more_bytes_than_the_goal(tmp_path, has_carriers):
    options = Namespace(carriers=16, rows=100, flags=False, days=1)
    assert measure_results(f"sqlite:///{tmp_path / 'soo.db'}", options, has_carriers=has_carriers)


def test_memory_of_a_replay_does_not_grow_with_its_rows(tmp_path):
    url = f"sqlite:///{tmp_path / 'soo.db'}"
    fill_replay(url, ROWS)
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        growth_mb = pool.submit(replay_mb, url, ROWS).result()
    print(f"{growth_mb:.0f} MB")
    assert growth_mb < SLACK * GOALS_MB["replay"]
