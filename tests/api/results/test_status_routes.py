"""Status: rows are pending until every method that the alignment started has answered."""

from dataclasses import replace

import pytest

from service.ports import Outcome
from service.records.catalogue import Method
from service.records.levels.attitude import Axes

pytestmark = pytest.mark.anyio


@pytest.mark.parametrize(
    ("methods", "after_paper"), [(("paper",), 0), (("paper", "robust"), 3), (("robust",), 3), ((), 0)]
)
async def test_pending_counts_every_method_that_runs(bench, make, methods, after_paper):
    bench.calibrate([make.carrier_calibration(k, Axes(0.1 * k * k, 1.0, 0.5 * k)) for k in range(6)])
    first = bench.align(make.now_us - 600 * make.s)
    named = dict.fromkeys(methods, first.calibration_id)
    bench.storage.results.add_alignment(make.sc, replace(first, calibration_by_method=named))
    rows = bench.append([make.now_us - (3 - k) * 60 * make.s for k in range(3)])
    assert (await bench.get("/status"))["pending"] == 3
    bench.consume([Outcome((make.row(row),), None) for row in rows])
    assert (await bench.get("/status"))["pending"] == after_paper
    bench.consume([Outcome((make.row(row, method=Method.ROBUST),), None) for row in rows])
    assert (await bench.get("/status"))["pending"] == 0


async def test_nothing_is_pending_before_an_alignment(bench, make):
    bench.append([make.now_us])
    status = await bench.get("/status")
    assert (status["pending"], status["aligned"], status["realignment_advised"]) == (0, False, False)
