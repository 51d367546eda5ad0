"""Time of a row of the robust method, compiled beside numpy."""

import pytest

from bench import bench_chain
from service.records.catalogue import Method

pytestmark = [pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(1200)]


def row_s(kernels):
    return bench_chain.measure(16, 400, kernels, (Method.ROBUST,), has_commands=False).median_s


def test_a_compiled_row_costs_at_most_three_quarters_of_one_by_numpy():
    # in pairs, for the machine may be slower for some seconds: a single pair met it twice
    ratios = sorted(row_s("numba") / row_s("numpy") for _ in range(5))
    print(f"compiled over numpy {', '.join(f'{ratio:.2f}' for ratio in ratios)}")
    assert ratios[2] < 0.75
