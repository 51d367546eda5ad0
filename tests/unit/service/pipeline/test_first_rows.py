"""The made-up rows compile all that the rows of a spacecraft call."""

import pytest

from bench.bench_chain import measure
from service.pipeline.first_rows import compile_filter
from service.pipeline.kernels import kernels_named
from service.records.catalogue import Method

pytestmark = pytest.mark.slow


def test_rows_of_a_spacecraft_find_their_machine_code():
    compile_filter()
    kernels = kernels_named("numba")
    row = kernels.ordinary_row
    held = (row._hold_model._compiled, row._hold_state._compiled, row._taken._compiled)
    stages = (kernels.move_state._compiled, *held, kernels.anchor.mix, kernels.anchor.levels)
    made = [len(stage.signatures) for stage in stages]
    measure(16, 30, "numba", (Method.ROBUST,), has_commands=False)
    assert [len(stage.signatures) for stage in stages] == made == [1, 1, 1, 1, 1, 1]
