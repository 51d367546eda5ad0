"""Time of a row of the robust method, compiled beside numpy."""

import pytest

from bench import bench_chain
from service.records.catalogue import Method

pytestmark = [pytest.mark.slow, pytest.mark.alone, pytest.mark.timeout(1200)]


def test_a_compiled_row_costs_at_most_three_quarters_of_one_by_numpy():
    by_numpy, compiled = (
        bench_chain.measure(16, 400, kernels, (Method.ROBUST,), has_commands=False) for kernels in ("numpy", "numba")
    )
    print(f"compiled over numpy {compiled.median_s / by_numpy.median_s:.2f}")
    print(f"compiled {compiled.median_s / compiled.yardstick_s:.2f} of the yardstick")
    assert compiled.median_s < 0.75 * by_numpy.median_s
