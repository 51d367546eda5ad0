"""Occupied bandwidth by percent and by level."""

import math

import numpy as np
import pytest

from analyzer_sim.emission import Emission, Signal
from analyzer_sim.instrument.functions.occupied_bandwidth import (
    decibels_down,
    occupied_by_level,
    occupied_by_percent,
    percent_inside,
    trace_power_dbm,
)
from analyzer_sim.instrument.spectrum import SweepGrid, mean_trace

GRID = SweepGrid(962e6, 982e6, 4001, 10e3)


def trace_dbm(*signals: Signal) -> np.ndarray:
    return 10 * np.log10(mean_trace(Emission(0, signals, -250.0), GRID, -400.0).total_mw)


def raised_cosine_width(percent: float, rate_hz: float, rolloff: float) -> float:
    """Return the width that holds a part of the power of a raised cosine, by quadrature."""
    offset_hz = np.linspace(0.0, 0.5 * (1 + rolloff) * rate_hz, 200001)
    phase = np.clip((offset_hz / rate_hz - 0.5 * (1 - rolloff)) / rolloff, 0.0, 1.0)
    running = np.cumsum(0.5 * (1 + np.cos(math.pi * phase)))
    return float(2 * np.interp(0.01 * percent * running[-1], running, offset_hz))


@pytest.mark.parametrize("percent", [50.0, 90.0, 99.0])
@pytest.mark.parametrize("rate_hz", [1e6, 4.5e6])
@pytest.mark.parametrize("shift_hz", [0.0, 1234.0])
def test_occupied_bandwidth_of_a_carrier(percent: float, rate_hz: float, shift_hz: float) -> None:
    found = occupied_by_percent(trace_dbm(Signal("x", 972e6 + shift_hz, rate_hz, 0.2, -40.0)), GRID, percent)
    # the filter adds the root of the squares of its width and of the flank: below one filter
    assert found.bandwidth_hz == pytest.approx(raised_cosine_width(percent, rate_hz, 0.2), abs=3e3)
    assert found.center_hz == pytest.approx(972e6 + shift_hz, abs=50.0)


def test_edges_lie_between_points() -> None:
    wide = SweepGrid(962e6, 982e6, 401, 100e3)  # points 50 kHz apart
    signal = Signal("x", 972.0123e6, 1e6, 0.2, -40.0)
    levels_dbm = 10 * np.log10(mean_trace(Emission(0, (signal,), -250.0), wide, -400.0).total_mw)
    assert occupied_by_percent(levels_dbm, wide, 90.0).center_hz == pytest.approx(972.0123e6, abs=1e3)


def test_half_of_the_power_of_a_carrier_is_3_db_down_at_its_symbol_rate() -> None:
    found = occupied_by_level(trace_dbm(Signal("x", 972e6, 2e6, 0.2, -40.0)), GRID, 3.0103)
    assert found.bandwidth_hz == pytest.approx(2e6, abs=2e3)  # a raised cosine falls to half at half its rate
    assert found.center_hz == pytest.approx(972e6, abs=50.0)


def test_width_of_a_line_is_that_of_the_filter() -> None:
    levels_dbm = trace_dbm(Signal("x", 972e6, 0.0, 0.0, -40.0))
    assert occupied_by_level(levels_dbm, GRID, -3.0103).bandwidth_hz == pytest.approx(10e3, rel=0.03)  # chords in dB


def test_trace_that_does_not_fall_so_far_has_no_width() -> None:
    found = occupied_by_level(np.zeros(4001), GRID, 3.0)
    assert math.isnan(found.bandwidth_hz)
    assert math.isnan(percent_inside(np.zeros(4001), GRID, found))


def test_percent_and_decibels_answer_each_other() -> None:
    levels_dbm = trace_dbm(Signal("x", 972e6, 2e6, 0.2, -40.0))
    by_percent = occupied_by_percent(levels_dbm, GRID, 95.0)
    assert percent_inside(levels_dbm, GRID, by_percent) == pytest.approx(95.0, abs=0.05)
    down_db = decibels_down(levels_dbm, GRID, by_percent)
    assert occupied_by_level(levels_dbm, GRID, down_db).bandwidth_hz == pytest.approx(by_percent.bandwidth_hz, rel=1e-3)


def test_power_of_the_trace_is_that_of_what_is_in_it() -> None:
    assert trace_power_dbm(trace_dbm(Signal("x", 972e6, 2e6, 0.2, -40.0)), GRID) == pytest.approx(-40.0, abs=1e-3)
