"""Sweeps, the virtual clock and the pending sweep, without SCPI."""

from collections.abc import Callable
from typing import Any

import pytest

from analyzer_sim.scpi.errors import ScpiError


def test_initiate_is_refused_while_sweeping_continuously(bench: Any) -> None:
    with pytest.raises(ScpiError) as caught:
        bench.instrument.initiate()
    assert caught.value.code == -213
    assert bench.source.row == 0


def test_sweep_waits_for_its_row_and_runs_once(make_bench: Callable[..., Any]) -> None:
    answers = iter([False, False, True])
    bench = make_bench(may_advance=lambda: next(answers))
    instrument = bench.instrument
    instrument.settings.is_continuous = False
    instrument.initiate()
    assert not instrument.complete_pending()
    assert bench.source.row == 0
    assert instrument.complete_pending()
    assert (bench.source.row, instrument.is_pending) == (1, False)
    assert instrument.complete_pending(), "nothing is pending any more and nobody is asked"


def test_setting_changed_while_pending_shapes_the_sweep(make_bench: Callable[..., Any]) -> None:
    allowed: list[bool] = []
    bench = make_bench(may_advance=lambda: bool(allowed))
    bench.instrument.settings.is_continuous = False
    bench.instrument.initiate()
    bench.instrument.settings.points = 201
    bench.instrument.invalidate()
    allowed.append(True)
    bench.instrument.complete_pending()
    assert bench.instrument.trace().level_dbm.shape == (201,)


def test_epoch_is_that_of_the_trace_shown(bench: Any) -> None:
    instrument = bench.instrument
    start_us = instrument.epoch_us()
    instrument.settings.is_continuous = False
    instrument.initiate()
    assert instrument.epoch_us() - start_us == 60_000_000
    assert instrument.trace().epoch_us == instrument.epoch_us()


def test_reset_ends_the_pending_sweep_without_completion(make_bench: Callable[..., Any]) -> None:
    bench = make_bench(may_advance=lambda: False)
    bench.instrument.settings.is_continuous = False
    bench.instrument.initiate()
    bench.instrument.reset()
    assert not bench.instrument.is_pending
    assert bench.instrument.status.operation.condition == 0


def test_count_combines_sweeps_of_one_row(bench: Any) -> None:
    instrument = bench.instrument
    instrument.settings.is_continuous = False
    instrument.settings.count = 20
    instrument.initiate()
    assert bench.source.row == 1
