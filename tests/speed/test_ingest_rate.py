"""Durable ingest keeps up with the interface: a light run of a part of ``python -m bench.bench_ingest``."""

import argparse
import statistics

import pytest

from bench.bench_ingest import measure
from bench.load.http_load import Shape

pytestmark = [pytest.mark.system, pytest.mark.slow]

#: half of the goal, for a machine that does other things at the same time
LEAST_RATIO = 1 / 6


def test_durable_ingest_reaches_a_sixth_of_the_rate_without_storage(tmp_path):
    shape = Shape(rows=100, carriers=32, connections=4)
    files = (f"sqlite:///{tmp_path / name}.db" for name in ("none", "durable"))
    options = argparse.Namespace(repeats=3, seconds=0.7)
    rates = measure(("none", "durable"), shape, lambda _: next(files), options)
    print(rates)
    pairs = zip(rates["durable"], rates["none"], strict=True)
    ratio = statistics.median(durable.per_second / none.per_second for durable, none in pairs)
    assert ratio >= LEAST_RATIO
