"""Time of a row by the number of its carriers."""

import numpy as np
import pytest

from bench.bench_chain import measure
from service.records.catalogue import Method

pytestmark = [pytest.mark.slow, pytest.mark.alone]

CARRIERS = (8, 16, 32, 64)


def test_a_row_grows_by_at_most_the_square_of_its_carriers():
    taken_s = {count: measure(count, 400, "numba", (Method.ROBUST,), has_commands=False).mean_s for count in CARRIERS}
    exponent = np.polyfit(np.log(CARRIERS), np.log(list(taken_s.values())), 1)[0]
    print(f"{ {count: f'{1e3 * each_s:.2f} ms' for count, each_s in taken_s.items()} }: exponent {exponent:.2f}")
    assert exponent <= 2.2
